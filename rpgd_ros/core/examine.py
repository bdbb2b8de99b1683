# SPDX-License-Identifier: Apache-2.0
"""A look at a pose: its cost, the pull of each joint, and the figures per camera and joint."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rpgd_ros.core.geometry import Array, BoolArray, Column, IntArray, RigidTransform
from rpgd_ros.core.linearise import Residuals, Sight, linearise
from rpgd_ros.core.normal import twist_from_delta
from rpgd_ros.core.observations import NS_PER_S, real_ns

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rpgd_ros.core.noise import Loss

# Stretches of time that errors are summed over: long enough to hold a turn of the body and a slip
# of the detector, and enough of them to estimate six numbers.
TIME_BLOCKS = 12
QUANTILE_SAMPLE = 100_000  # residuals that median and percentile are taken from: 0.3 % accurate
# Beyond this many thresholds a keypoint is not of this person. A threshold that was given may lie
# below the noise of a detector that follows the right one.
LOST_FACTOR = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Tally:
    """Sums over all correspondences, per camera and joint: (V, J) each.

    Attributes:
        correspondences: Those before a camera (S of eq. 4).
        inliers: Those below the threshold (eq. 3).
        error_px: Summed residuals of the correspondences, pixels.
        inlier_error_px: Summed residuals of the inliers, pixels.
        bias_px: (V, J, 2) summed residual vectors of the inliers, pixels.
        frames: (V,) instants with an inlier.
        seen_frames: (V,) instants with a correspondence.
        lost_frames: (V,) instants of which most correspondences are far from any inlier.
        sample_px: Residuals, evenly spread, for quantiles.

    """

    correspondences: IntArray
    inliers: IntArray
    error_px: Array
    inlier_error_px: Array
    bias_px: Array
    frames: IntArray
    seen_frames: IntArray
    lost_frames: IntArray
    sample_px: Array


@dataclass(frozen=True, slots=True, eq=False)
class Examination:
    """Outcome of one pass at a pose.

    Attributes:
        cost: Summed loss.
        camera_scores: (V, J, 6) gradient of the loss, summed per camera and joint.
        camera_time_scores: (V, TIME_BLOCKS, 6) the same per camera and stretch of time.
        tally: Sums for the figures.

    """

    cost: float
    camera_scores: Array
    camera_time_scores: Array
    tally: Tally

    @property
    def joint_scores(self) -> Array:
        """(J, 6) gradient of the loss, summed per joint."""
        scores: Array = self.camera_scores.sum(0)
        return scores

    @property
    def time_scores(self) -> Array:
        """(TIME_BLOCKS, 6) gradient of the loss, summed per stretch of time."""
        scores: Array = self.camera_time_scores.sum(0)
        return scores

    @property
    def gradient(self) -> Array:
        """(6,) gradient of the loss."""
        gradient: Array = self.joint_scores.sum(0)
        return gradient


def examine(
    sights: Sequence[Sight], pose: RigidTransform, pivot_world: Array, loss: Loss,
    *, threshold_px: float,
) -> Examination:  # fmt: skip
    """Count and sum the residuals of a pose (eq. 2, 3, 7), and its gradient per joint.

    Args:
        sights: Cameras with their data.
        pose: world_T_mocap.
        pivot_world: (3,) pivot of the parameters, metres, see `normal`.
        loss: Loss of the squared residual.
        threshold_px: Residual below which a correspondence is an inlier, beside what the noise
            of its 3D joint adds.

    """
    total = sum(s.view.n_frames * s.view.n_joints for s in sights)
    book = _Book(len(sights), sights[0].view.n_joints, max(1, total // QUANTILE_SAMPLE))
    n_joints = sights[0].view.n_joints
    by_joint: list[Array] = []
    by_time: list[Array] = []
    cost = 0.0
    for v, (sight, block) in enumerate(zip(sights, time_blocks(sights), strict=True)):
        camera_T_mocap = sight.camera_T_world @ pose
        joint_noise = loss.joint_noise(sight.camera.focal_px)
        of_joint, of_time = np.zeros((n_joints, 6)), np.zeros((TIME_BLOCKS, 6))
        for frames, (x, uv) in zip(sight.slices(), sight.chunks(), strict=True):
            res, slopes = linearise(sight.camera, camera_T_mocap, x, uv)
            white = res
            if joint_noise:
                white, slopes = slopes.whitened(res, joint_noise)
            added, weight, _ = loss.evaluate(white)
            cost += added
            pull = slopes.pull(white.du * weight, white.dv * weight)
            pull = pull.reshape(6, -1, n_joints)
            of_joint += np.einsum('pfj->jp', pull)
            of_time += per_block(np.einsum('pfj->pf', pull), block[frames])
            squared = white.squared
            near = res.in_view & (squared < threshold_px**2)
            book.enter(v, res, near, squared > (LOST_FACTOR * threshold_px) ** 2)
        to_twist = twist_from_delta(sight.camera_T_world, pivot_world)
        by_joint.append(of_joint @ to_twist)
        by_time.append(of_time @ to_twist)
    return Examination(cost, np.stack(by_joint), np.stack(by_time), book.close())


def per_block(of_frame: Column, block: IntArray) -> Array:
    """Sum (p, F) over the frames of each stretch of time: (TIME_BLOCKS, p)."""
    return np.stack([np.bincount(block, row, TIME_BLOCKS) for row in of_frame], 1)


def time_blocks(sights: Sequence[Sight]) -> list[IntArray]:
    """Number each camera's frames by stretch of time, common to all: (F,), below TIME_BLOCKS."""
    times = times_s(sights)
    start = min(t.min() for t in times)
    length = max(float(t.max() - start) for t in times)
    scale = TIME_BLOCKS / length if length > 0.0 else 0.0
    return [np.minimum((t - start) * scale, TIME_BLOCKS - 1).astype(np.int64) for t in times]


def times_s(sights: Sequence[Sight]) -> list[Array]:
    """(F,) seconds of each camera's frames since some instant; from 0 to 1 where none is known."""
    known = [s.view.stamp_ns for s in sights if s.view.stamp_ns is not None]
    return [
        np.linspace(0.0, 1.0, s.view.n_frames)
        if s.view.stamp_ns is None
        else real_ns(s.view.stamp_ns, int(known[0][0])) / NS_PER_S
        for s in sights
    ]


class _Book:
    """Running sums of a `Tally`.

    `einsum` adds up columns several times as fast as `add.reduce`, and the same whatever the
    number of threads, unlike a product of matrices. Counts of a chunk are exact as floats.
    """

    def __init__(self, n_cameras: int, n_joints: int, stride: int) -> None:
        self._sums = np.zeros((6, n_cameras, n_joints))
        self._frames = np.zeros((3, n_cameras), np.int64)
        self._sample: list[Column] = []
        self._stride = stride

    def enter(self, camera: int, res: Residuals, near: BoolArray, far: BoolArray) -> None:
        """Add one chunk of whole frames, with its inliers and those far from being one."""
        frames = (-1, self._sums.shape[2])
        errors = [x.reshape(frames) for x in (np.sqrt(res.squared), res.du, res.dv)]
        # Whole frames: a stride over points would meet some of the joints only.
        kept = slice(None, None, self._stride)
        self._sample.append(errors[0][kept][res.in_view.reshape(frames)[kept]])
        is_seen, is_near, is_far = (
            m.reshape(frames).astype(np.float32) for m in (res.in_view, near, res.in_view & far)
        )
        n_seen, n_near, n_far = (np.einsum('fj->f', m) for m in (is_seen, is_near, is_far))
        self._frames[:, camera] += [
            np.count_nonzero(n_near),
            np.count_nonzero(n_seen),
            np.count_nonzero(2 * n_far > n_seen),
        ]
        self._sums[:, camera] += [
            np.einsum('fj->j', is_seen),
            np.einsum('fj->j', is_near),
            np.einsum('fj->j', errors[0]),  # zero where not in view
            *(np.einsum('fj,fj->j', column, is_near) for column in errors),
        ]

    def close(self) -> Tally:
        """Return the sums."""
        sample = np.concatenate(self._sample).astype(np.float64)
        n, n_in = self._sums[:2].astype(np.int64)
        error, error_in = self._sums[2:4]
        bias = np.stack([self._sums[4], self._sums[5]], -1)
        near, seen, lost = self._frames
        return Tally(n, n_in, error, error_in, bias, near, seen, lost, sample)
