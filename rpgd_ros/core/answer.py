# SPDX-License-Identifier: Apache-2.0
"""What the film says of something that was given and may be wrong: a focal length, a size.

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

from rpgd_ros.core.covariance import invert
from rpgd_ros.core.geometry import Array, BoolArray

if TYPE_CHECKING:
    from rpgd_ros.core.unknowns import Solution

SIGMAS = 4.0  # beyond doubt; 167 clean recordings, with joint biases too, reach 3.6
DOUBT_SIGMAS = 3.0  # from here on the film is believed, not what was given


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """Errors of n given numbers.

    Attributes:
        error: (n,) by how much what was given is too small.
        covariance: (n, n).
        pose_by_error: (6, n) how far the pose moves with each, about the pivot.
        gain: By how much the errors explain the data better than none (log likelihood).
        prior: (n,) standard deviations of the errors before the film was seen.
        least: (n,) errors that nobody needs to hear of.

    """

    error: Array
    covariance: Array
    pose_by_error: Array
    gain: float
    prior: Array
    least: Array

    @classmethod
    def of(
        cls, solution: Solution, columns: slice, value: Array, *, prior: Array, least: Array
    ) -> Self:
        """Ask the sums of a solve that has the numbers among its unknowns.

        Args:
            solution: At the optimum of the others, without a prior of the numbers.
            columns: Where the numbers stand.
            value: (p,) present values of those with a prior.
            prior: See the attribute.
            least: See the attribute.

        """
        step, _ = solution.step(value)
        own = invert(solution.inverse[columns, columns])
        error = step[columns]
        return cls(
            error,
            solution.covariance[columns, columns],
            solution.inverse[:6, columns] @ own,
            0.5 * float(error @ own @ error),
            prior,
            least,
        )

    @property
    def sigma(self) -> Array:
        """(n,) standard deviations of the errors."""
        sigma: Array = np.sqrt(np.diag(self.covariance))
        return sigma

    @property
    def pose_spread(self) -> Array:
        """(6, 6) of how far the pose may be off, about the pivot: film and prior together."""
        known = invert(self.covariance)
        kept = invert(known + np.diag(np.where(self.doubted, 0.0, self.prior**-2)))
        likely = kept @ known @ self.error
        spread: Array = (
            self.pose_by_error @ (kept + np.outer(likely, likely)) @ self.pose_by_error.T
        )
        return spread

    @property
    def doubted(self) -> BoolArray:
        """(n,) whether the film contradicts what was given."""
        out: BoolArray = np.abs(self.error) > DOUBT_SIGMAS * self.sigma
        return out

    @property
    def wrong(self) -> tuple[int, ...]:
        """Numbers of the errors that are beyond doubt."""
        enough = np.maximum(self.least, SIGMAS * self.sigma)
        return tuple(np.flatnonzero(np.abs(self.error) > enough).tolist())

    def percent(self, k: int) -> str:
        """Say how large an error is, without its sign."""
        return f'{100 * abs(float(self.error[k])):.1f} +- {100 * float(self.sigma[k]):.1f} %'
