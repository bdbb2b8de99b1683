# SPDX-License-Identifier: Apache-2.0
"""Whether the focal lengths that were given fit the film.

A focal length that is 1 % wrong moves the transform by millimetres, and the residuals hardly show
it. So it is freed for a moment beside everything else, with the prior of a good calibration: where
the film wants another one beyond doubt, that is said, and the covariance takes in how far the pose
would move. A single camera that sees a body at one distance cannot tell the two apart: then it is
the prior that speaks.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np

from rpgd_ros.core.adjust import FOCAL_PRIOR
from rpgd_ros.core.geometry import Array

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rpgd_ros.core.unknowns import System

SIGMAS = 5.0  # beyond doubt; clean recordings reach 3.5 in a hundred
LEAST_ERROR = 0.001  # of the focal length: better than a chessboard does


@dataclass(frozen=True, slots=True, eq=False)
class FocalCheck:
    """What the film says of the focal lengths: of each camera, or of all alike.

    Attributes:
        error: (n,) share by which they are too short (positive) or too long.
        covariance: (n, n).
        pose_by_focal: (6, n) how far the pose moves with each, about the pivot.

    """

    error: Array
    covariance: Array
    pose_by_focal: Array

    @classmethod
    def of(cls, system: System, precision: Array) -> Self:
        """Ask the sums of a solve that has focal lengths among its unknowns.

        Args:
            system: At the optimum of the others.
            precision: (p,) of the priors of the others.

        """
        columns = system.unknowns.focals
        without = precision.copy()
        without[columns] = 0.0
        covariance = system.covariance(without)
        inverse = system.inverse(without)
        step, _ = system.step(without, np.zeros_like(without))
        held = inverse[:6, columns] @ np.linalg.inv(inverse[columns, columns])
        return cls(step[columns], covariance[columns, columns], held)

    @property
    def sigma(self) -> Array:
        """(n,) standard deviations of the errors."""
        sigma: Array = np.sqrt(np.diag(self.covariance))
        return sigma

    @property
    def pose_spread(self) -> Array:
        """(6, 6) of how far the pose may be off, about the pivot: film and prior together."""
        n = len(self.error)
        kept = np.linalg.inv(np.linalg.inv(self.covariance) + np.eye(n) / FOCAL_PRIOR**2)
        likely = kept @ np.linalg.solve(self.covariance, self.error)
        spread: Array = (
            self.pose_by_focal @ (kept + np.outer(likely, likely)) @ self.pose_by_focal.T
        )
        return spread

    @property
    def is_wrong(self) -> tuple[bool, ...]:
        """Which of the given focal lengths are wrong beyond doubt."""
        return tuple(
            abs(e) > max(LEAST_ERROR, SIGMAS * s)
            for e, s in zip(self.error.tolist(), self.sigma.tolist(), strict=True)
        )

    def sentences(self, names: Sequence[str]) -> list[str]:
        """Say to a person what is wrong; the names are those of the cameras asked one by one."""
        out = []
        for k, wrong in enumerate(self.is_wrong):
            if wrong:
                error, sigma = float(self.error[k]), float(self.sigma[k])
                whose = (
                    f'focal length of camera {names[k]} looks' if names else 'focal lengths look'
                )
                out.append(
                    f'the {whose} {100 * abs(error):.1f} +- {100 * sigma:.1f} % too '
                    f'{"short" if error > 0.0 else "long"}: the intrinsics do not fit the film. '
                    'Calibrate them again; the reported sigma holds what that may move'
                )
        return out
