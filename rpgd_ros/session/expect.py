# SPDX-License-Identifier: Apache-2.0
"""How well a pose would be known if the recording stopped now, without another solve.

The sums that the covariance of a calibration is made of are kept running at a pose that is about
right: that of the last run. What one more second adds to them does not depend on where exactly
within the noise the pose is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rpgd_ros.core.covariance import covariances
from rpgd_ros.core.errors import CalibrationError
from rpgd_ros.core.examine import TIME_BLOCKS, Examination, Tally, examine
from rpgd_ros.core.geometry import Array, RigidTransform, skew
from rpgd_ros.core.linearise import Sight
from rpgd_ros.core.noise import NoiseModel, noise_at
from rpgd_ros.core.normal import Normal, normal_equations
from rpgd_ros.core.refine import Descent
from rpgd_ros.session.recent import Pairs

FIT_POINTS = 2000  # keypoints that the noise is fitted to: its scale is then known to 2 %
# Of keypoints that a broad spread must explain. Below it the pose explains nothing, and what it
# would be known to has no meaning.
LEAST_SHARE = 0.6
MIN_BLOCKS = 3  # stretches of time below which their spread says nothing
MIN_JOINTS = 4
BLOCK_S = 1.0  # of one stretch at first; two become one whenever there are too many


@dataclass(frozen=True, slots=True)
class Expected:
    """What a calibration from all pairs so far would be known to.

    Attributes:
        sigma_deg: Of the rotation, degrees; NaN where it cannot be told yet.
        sigma_m: Of the body's position, metres.

    """

    sigma_deg: float = math.nan
    sigma_m: float = math.nan

    @property
    def is_known(self) -> bool:
        """Whether it can be told."""
        return math.isfinite(self.sigma_deg) and math.isfinite(self.sigma_m)


class Expectation:
    """Running sums of the pose's covariance. May be made in one thread and used in another."""

    def __init__(self, pose: RigidTransform, centroid_mocap: Array) -> None:
        """Start without data.

        Args:
            pose: world_T_mocap, about right.
            centroid_mocap: (3,) middle of the body's places, metres.

        """
        self._pose = pose
        self._centroid = centroid_mocap
        self._pivot = pose @ centroid_mocap
        self._noise: NoiseModel | None = None
        self._waiting: list[Sight] = []
        self._hessian, self._information = np.zeros((2, 6, 6))
        self._by_joint = np.zeros((0, 6))
        self._by_time: dict[int, Array] = {}
        self._tally: Tally | None = None
        self._block_ns = round(BLOCK_S * 1e9)

    def emptied(self) -> Expectation:
        """Return one of the same pose without data."""
        return Expectation(self._pose, self._centroid)

    def add(self, pairs: Sequence[Pairs]) -> None:
        """Take what came since the last time."""
        self.add_sights([Sight(new.camera, new.view) for new in pairs])

    def add_sights(self, sights: Sequence[Sight], *, weight: float = 1.0) -> None:
        """Take cameras with what they saw, with stamps.

        Args:
            sights: The cameras.
            weight: Frames that each of theirs stands for.

        """
        self._waiting += [s for s in sights if s.view.n_frames]
        if self._noise is None:
            if sum(int(s.view.seen().sum()) for s in self._waiting) < FIT_POINTS:
                return
            try:
                noise = noise_at(self._waiting, self._pose)
            except CalibrationError:
                self._waiting.clear()
                return
            if not noise.is_sharp and noise.share < LEAST_SHARE:
                self._waiting.clear()
                return
            self._noise = noise
        waiting, self._waiting = self._waiting, []
        if waiting:
            self._enter(waiting, self._noise, weight)

    def expected(self) -> Expected:
        """Return what is known so far."""
        n_joints = int(np.any(self._by_joint != 0.0, axis=1).sum())
        if self._tally is None or len(self._by_time) < MIN_BLOCKS or n_joints < MIN_JOINTS:
            return Expected()
        by_time = np.stack(list(self._by_time.values()))
        here = (self._hessian, self._information)
        end = Descent(
            self._pose,
            Normal(*here, self._by_joint.sum(0), 0.0, here[0][None], here[1][None]),
            Examination(0.0, self._by_joint[None], by_time[None], self._tally),
            is_converged=True,
        )
        both = covariances(end, self._centroid)
        degrees, metres = zip(*(self._sigmas(covariance) for covariance in both), strict=True)
        return Expected(max(degrees), max(metres))

    def _sigmas(self, covariance: Array) -> tuple[float, float]:
        """Roots of the summed variances: rotation in degrees, the body's middle in metres."""
        lever = -skew(self._pose.rotation @ self._centroid)
        jacobian = np.hstack([lever, np.eye(3)])
        turn, shift = np.trace(covariance[:3, :3]), np.trace(jacobian @ covariance @ jacobian.T)
        return math.degrees(math.sqrt(max(turn, 0.0))), math.sqrt(max(shift, 0.0))

    def _enter(self, sights: Sequence[Sight], noise: NoiseModel, weight: float) -> None:
        normal = normal_equations(sights, self._pose, self._pivot, noise)
        self._hessian += weight * normal.hessian
        self._information += weight * normal.information
        for sight in sights:
            for part in _blocks(sight, self._block_ns):
                seen = examine(
                    [part], self._pose, self._pivot, noise, threshold_px=noise.threshold_px
                )
                self._tally, scores = seen.tally, weight * seen.joint_scores
                if not len(self._by_joint):
                    self._by_joint = np.zeros_like(scores)
                self._by_joint += scores
                block = _block(part, self._block_ns)
                self._by_time[block] = self._by_time.get(block, 0.0) + scores.sum(0)
        while len(self._by_time) >= 2 * TIME_BLOCKS:
            self._merge_blocks()

    def _merge_blocks(self) -> None:
        """Make one stretch of time of two, so that they are about as long as those of a solve."""
        merged: dict[int, Array] = {}
        for block, scores in self._by_time.items():
            merged[block // 2] = merged.get(block // 2, 0.0) + scores
        self._by_time, self._block_ns = merged, 2 * self._block_ns


def _block(sight: Sight, block_ns: int) -> int:
    return 0 if sight.view.stamp_ns is None else int(sight.view.stamp_ns[0]) // block_ns


def _blocks(sight: Sight, block_ns: int) -> list[Sight]:
    """Cut what a camera saw at the ends of stretches of time."""
    if sight.view.stamp_ns is None:
        return [sight]
    number = sight.view.stamp_ns // block_ns
    return [sight.at_frames(np.flatnonzero(number == n)) for n in np.unique(number)]
