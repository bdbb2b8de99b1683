# SPDX-License-Identifier: Apache-2.0
"""What was found out beside the pose, for the result."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np

from rpgd_ros.core.adjust import solved_at
from rpgd_ros.core.drift import Drift, find_drift
from rpgd_ros.core.geometry import Array
from rpgd_ros.core.questions import (
    Questions,
    focal_sentences,
    radial_sentences,
    size_sentence,
)
from rpgd_ros.core.synchronise import sigmas
from rpgd_ros.core.thin import thin

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from rpgd_ros.core.geometry import RigidTransform
    from rpgd_ros.core.linearise import Sight
    from rpgd_ros.core.noise import NoiseModel
    from rpgd_ros.core.settle import Details
    from rpgd_ros.core.unknowns import Solution


DRIFT_POINTS = 32_768  # that the drift is sought on


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
    """Clocks, joints, lenses and sizes; nothing where they were not asked for.

    Attributes:
        systematic: (6, 6) of how far the pose may be off for reasons that were not mended.
        solution: Sums by all unknowns, solved.
        time_offset_s: {camera: (offset, sigma)}, seconds.
        clock_rate: {camera: (rate, sigma)} of the cameras whose clock runs wrong.
        joint_offset: (J, 3) metres; (J, 3) standard deviations.
        focal_error: {camera: (error, sigma)}, shares of the focal length.
        scale: Error of the skeleton's size and its sigma, shares.
        drift: How fast the pose changes, where it does beyond doubt.
        warnings: Sentences for people.

    """

    systematic: Array
    solution: Solution | None = None
    time_offset_s: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    clock_rate: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    joint_offset: tuple[Array, Array] | None = None
    focal_error: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    scale: tuple[float, float] | None = None
    drift: Drift | None = None
    warnings: tuple[str, ...] = ()

    @classmethod
    def of_pose(
        cls, sights: Sequence[Sight], pose: RigidTransform, centroid: Array, noise: NoiseModel
    ) -> Self:
        """Ask what can be asked where only the pose was estimated."""
        lenses = Questions.of_pose(sights, pose, centroid, noise).lenses(is_common=True)
        told = focal_sentences(lenses.focal, ()) + radial_sentences(lenses.radial, ())
        return cls(lenses.both.pose_spread, warnings=tuple(told))

    @classmethod
    def of(cls, details: Details) -> Self:
        """Collect what was settled, and ask for the rest."""
        problem, unknowns, (state, _, noise) = details.problem, details.unknowns, details.at
        solution = solved_at(problem, state, unknowns, noise)
        sigma = sigmas(solution)
        names = [s.camera.name for s in problem.sights]
        joints = None
        if unknowns.n_joints:
            joints = (state.joint_offset, sigma[unknowns.joints].reshape(-1, 3))
        explained = details.explained
        lenses = details.lenses
        told = [*details.warnings, *radial_sentences(lenses.radial, names)]
        if unknowns.focal:
            systematic = lenses.radial.pose_spread
        else:
            systematic = lenses.both.pose_spread
            if explained is None or explained.unknowns.focal:
                told += focal_sentences(lenses.focal, names)
        size = details.size
        if size is not None and not unknowns.with_scale:
            systematic += size.pose_spread
            if explained is not None and explained.unknowns.with_scale and size.wrong:
                told.append(size_sentence(size))
        few = replace(problem, sights=thin(problem.sights, DRIFT_POINTS))
        drift = find_drift(few.scene(state).sights, state.pose, problem.centroid_mocap, noise)
        if drift is not None and not drift.is_certain:
            drift = None
        if drift is not None:
            told = [*details.warnings, drift.sentence()]  # it bends what was said of the rest
        focal_error = lenses.focal.error
        found_size = None if size is None else (float(size.error[0]), float(size.sigma[0]))
        if explained is not None:  # several steps know better than one
            focal_error = explained.state.focal if explained.unknowns.focal else focal_error
            if found_size is not None and explained.unknowns.with_scale:
                found_size = (explained.state.scale, found_size[1])
        return cls(
            systematic,
            solution,
            _known(names, state.offset_s, sigma[unknowns.offsets], unknowns.offset),
            _known(names, state.rate, sigma[unknowns.rates], unknowns.rate),
            joints,
            _known(names, focal_error, lenses.focal.sigma, range(len(names))),
            found_size,
            drift,
            tuple(told),
        )

    def joint_offset_m(self, names: Sequence[str]) -> dict[str, JointOffset]:
        """Offset by joint, where estimated."""
        if self.joint_offset is None:
            return {}
        rows = zip(names, *(np.round(a, 9).tolist() for a in self.joint_offset), strict=True)
        return {name: JointOffset(tuple(offset), tuple(sigma)) for name, offset, sigma in rows}


def _known(
    names: Sequence[str], values: Array, sigma: Array, numbers: Sequence[int]
) -> dict[str, tuple[float, float]]:
    """Value and sigma by camera, of those that have one."""
    rows = zip(names, values.tolist(), numbers, strict=True)
    return {name: (value, float(sigma[n])) for name, value, n in rows if n >= 0}
