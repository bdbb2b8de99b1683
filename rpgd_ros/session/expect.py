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
from rpgd_ros.core.noise import NoiseModel
from rpgd_ros.core.noise_fit import noise_at
from rpgd_ros.core.normal import Normal, normal_equations
from rpgd_ros.core.observations import NS_PER_S, View
from rpgd_ros.core.refine import Descent
from rpgd_ros.session.recent import Pairs

FIT_POINTS = 2000  # keypoints that the noise is fitted to: its scale is then known to 2 %
# Of keypoints that a broad spread must explain. Below it the pose explains nothing, and what it
# would be known to has no meaning.
LEAST_SHARE = 0.6
MIN_BLOCKS = 3  # stretches of time below which their spread says nothing
MIN_JOINTS = 4
LARGEST_SCALE = 10.0  # between a run's sigma and the sums'; beyond it one of them is damaged
GATHER_S = 2.0  # of a camera at once: a second call costs as much as hundred more frames
BLOCK_S = 2.0  # of one stretch at first; two become one whenever there are too many


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
        self._waiting: dict[str, list[Sight]] = {}
        self._unfitted: list[Sight] = []
        self._hessian, self._information = np.zeros((2, 6, 6))
        self._by_joint = np.zeros((0, 6))
        self._by_time: dict[int, Array] = {}
        self._tally: Tally | None = None
        self._scale = (1.0, 1.0)
        self._block_ns = round(BLOCK_S * 1e9)

    def emptied(self) -> Expectation:
        """Return one of the same pose without data."""
        empty = Expectation(self._pose, self._centroid)
        empty._scale = self._scale
        return empty

    def add(self, pairs: Sequence[Pairs]) -> None:
        """Take what came since the last time.

        It counts once a camera has some seconds of it, one camera at a call.
        """
        for new in (new for new in pairs if new.is_placed):
            self._waiting.setdefault(new.camera.name, []).append(Sight(new.camera, new.view))
        spans = {name: _span_s(waiting) for name, waiting in self._waiting.items()}
        name = max(spans, key=lambda name: spans[name], default='')
        if spans.get(name, 0.0) >= GATHER_S:
            self.add_sights([_joined(self._waiting.pop(name))])

    def add_sights(self, sights: Sequence[Sight], *, weight: float = 1.0) -> None:
        """Take cameras with what they saw, with stamps.

        Args:
            sights: The cameras.
            weight: Frames that each of theirs stands for.

        """
        self._unfitted += [s for s in sights if s.view.n_frames]
        if self._noise is None:
            self._fit()
        if self._noise is not None and self._unfitted:
            unfitted, self._unfitted = self._unfitted, []
            self._enter(unfitted, self._noise, weight)

    def _fit(self) -> None:
        """Fit the noise as soon as there are enough keypoints; start anew where none fits."""
        if sum(int(s.view.seen().sum()) for s in self._unfitted) < FIT_POINTS:
            return
        try:
            noise = noise_at(self._unfitted, self._pose)
        except CalibrationError:
            self._unfitted.clear()
            return
        if noise.is_sharp or noise.share >= LEAST_SHARE:
            self._noise = noise
        else:
            self._unfitted.clear()

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
        return Expected(self._scale[0] * max(degrees), self._scale[1] * max(metres))

    def settle(self, sigma_deg: float, sigma_m: float) -> None:
        """Take over what a run on the same data has found, and go on from there.

        A run may estimate more than the pose, and so know the pose less, or better.

        Args:
            sigma_deg: Of the rotation, degrees.
            sigma_m: Of the body's position, metres.

        """
        now = self.expected()
        if now.is_known and now.sigma_deg > 0.0 and now.sigma_m > 0.0:
            scale = (sigma_deg / now.sigma_deg, sigma_m / now.sigma_m)
            if all(1.0 / LARGEST_SCALE < s < LARGEST_SCALE for s in scale):  # False for NaN
                self._scale = scale

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
    return int(sight.view.known_stamp_ns[0]) // block_ns


def _blocks(sight: Sight, block_ns: int) -> list[Sight]:
    """Cut what a camera saw at the ends of stretches of time."""
    number = sight.view.known_stamp_ns // block_ns
    return [sight.at_frames(np.flatnonzero(number == n)) for n in np.unique(number)]


def _span_s(sights: Sequence[Sight]) -> float:
    first, last = sights[0].view.known_stamp_ns, sights[-1].view.known_stamp_ns
    return float(last[-1] - first[0]) / NS_PER_S


def _joined(sights: Sequence[Sight]) -> Sight:
    """Join what one camera saw, piece after piece, into one."""
    views = [s.view for s in sights]
    return Sight(
        sights[-1].camera,
        View(
            np.concatenate([v.known_stamp_ns for v in views]),
            np.concatenate([v.x_mocap for v in views]),
            np.concatenate([v.uv for v in views]),
        ),
    )
