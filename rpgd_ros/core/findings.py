# SPDX-License-Identifier: Apache-2.0
"""What was found out beside the pose, for the result."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np

from rpgd_ros.core.adjust import look, prior
from rpgd_ros.core.geometry import Array
from rpgd_ros.core.synchronise import sigmas

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from rpgd_ros.core.settle import Details
    from rpgd_ros.core.unknowns import System


class JointOffset(NamedTuple):
    """Where the detector sees a joint, from where MoCap says it is.

    Attributes:
        offset_m: (x, y, z) in the frame of the body's heading, metres.
        sigma_m: Standard deviation per axis, metres.

    """

    offset_m: tuple[float, float, float]
    sigma_m: tuple[float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Findings:
    """Clocks and joints as estimated; nothing where they were not asked for.

    Attributes:
        system: Sums by all unknowns, and the precision of their priors.
        time_offset_s: {camera: (offset, sigma)}, seconds.
        clock_rate: {camera: (rate, sigma)} of the cameras whose clock runs wrong.
        joint_offset: (J, 3) metres; (J, 3) standard deviations.
        warnings: Sentences for people.

    """

    system: tuple[System, Array] | None = None
    time_offset_s: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    clock_rate: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    joint_offset: tuple[Array, Array] | None = None
    warnings: tuple[str, ...] = ()

    @classmethod
    def of(cls, details: Details) -> Self:
        """Collect what was settled."""
        state, unknowns = details.at.state, details.at.unknowns
        system = look(details.problem, state, unknowns, details.at.noise)
        precision, _ = prior(unknowns, state)
        sigma = sigmas(system, precision)
        names = [s.camera.name for s in details.problem.sights]
        offsets, rates = sigma[unknowns.offsets], sigma[unknowns.rates]
        joints = None
        if unknowns.n_joints:
            joints = (state.joint_offset, sigma[unknowns.joints].reshape(-1, 3))
        return cls(
            (system, precision),
            {
                n: (float(o), float(offsets[c]))
                for n, o, c in zip(names, state.offset_s, unknowns.offset, strict=True)
                if c >= 0
            },
            {
                n: (float(r), float(rates[c]))
                for n, r, c in zip(names, state.rate, unknowns.rate, strict=True)
                if c >= 0
            },
            joints,
            details.warnings,
        )

    def joint_offset_m(self, names: Sequence[str]) -> dict[str, JointOffset]:
        """Offset by joint, where estimated."""
        if self.joint_offset is None:
            return {}
        rows = zip(names, *(np.round(a, 9).tolist() for a in self.joint_offset), strict=True)
        return {name: JointOffset(tuple(offset), tuple(sigma)) for name, offset, sigma in rows}
