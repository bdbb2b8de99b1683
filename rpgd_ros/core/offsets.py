# SPDX-License-Identifier: Apache-2.0
"""Offsets between the clocks of video and MoCap, estimated jointly with the pose.

A video that is stamped late shows the body where it has been: MoCap time = video stamp - offset.
At walking speed 5 ms are as much as the whole rest of the error, and the reprojection error hides
them. Parameters: the six of the pose (see `linearise`), then per camera its offset in seconds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from rpgd_ros.core.examine import TIME_BLOCKS, per_block, time_blocks
from rpgd_ros.core.geometry import Array, RigidTransform
from rpgd_ros.core.linearise import Sight, linearise
from rpgd_ros.core.noise import Loss, NoiseModel
from rpgd_ros.core.normal import apply_delta, twist_from_delta
from rpgd_ros.core.refine import newton_step

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rpgd_ros.core.timeline import Timeline

STEPS = 12
CONVERGED = 1e-6  # Newton decrement, as in `refine`
LARGEST_STEP_S = 0.1  # beyond it velocities have changed


@dataclass(frozen=True, slots=True, eq=False)
class TimedNormal:
    """Sums of one pass by the parameters of pose and offsets, p = 6 + number of offsets.

    Attributes:
        hessian: (p, p).
        information: (p, p) its positive part.
        gradient: (p,).
        cost: Sum of the loss.
        joint_scores: (J, p) gradient per joint.
        time_scores: (TIME_BLOCKS, p) gradient per stretch of time.

    """

    hessian: Array
    information: Array
    gradient: Array
    cost: float
    joint_scores: Array
    time_scores: Array


def shifted(
    sights: Sequence[Sight], timeline: Timeline, offset_s: Array | Sequence[float]
) -> tuple[list[Sight], list[Array]]:
    """Give each camera the skeletons of its stamps less its offset, and their velocities.

    Args:
        sights: Cameras with their data; all have stamps.
        timeline: The MoCap track.
        offset_s: (V,) seconds.

    Returns:
        Sights, and per sight (F, J, 3) m/s in the MoCap frame.

    """
    moved, velocities = [], []
    for sight, offset in zip(sights, offset_s, strict=True):
        stamp_ns = sight.view.stamp_ns
        if stamp_ns is None:
            msg = 'a view without stamps has no offset'
            raise ValueError(msg)
        x, v = timeline.at(timeline.seconds(stamp_ns) - offset)
        moved.append(Sight(sight.camera, replace(sight.view, x_mocap=x)))
        velocities.append(v)
    return moved, velocities


def timed_equations(
    sights: Sequence[Sight], velocities: Sequence[Array], pose: RigidTransform,
    centroid_mocap: Array, loss: Loss, column: Sequence[int],
) -> TimedNormal:  # fmt: skip
    """Sum cost, gradient and Hessian by pose and offsets.

    Args:
        sights: Cameras, their skeletons taken at the present offsets.
        velocities: Per sight (F, J, 3), m/s, MoCap frame.
        pose: world_T_mocap.
        centroid_mocap: (3,) pivot of the pose's parameters, metres.
        loss: Loss of the squared residual.
        column: Per sight the number of its offset, or -1 where it is not estimated.

    """
    p = 6 + max([*column, -1]) + 1
    n_joints = sights[0].view.n_joints
    hessian, information = np.zeros((p, p)), np.zeros((p, p))
    joint_scores, time_scores, cost = np.zeros((n_joints, p)), np.zeros((TIME_BLOCKS, p)), 0.0
    cameras = zip(sights, velocities, column, time_blocks(sights), strict=True)
    for sight, velocity, number, block in cameras:
        camera_T_mocap = sight.camera_T_world @ pose
        joint_noise = loss.joint_noise(sight.camera.focal_px)
        info, bend = np.zeros((7, 7)), np.zeros((7, 7))
        scores, later = np.zeros((n_joints, 7)), np.zeros((TIME_BLOCKS, 7))
        for frames, (x, uv) in zip(sight.slices(), sight.chunks(), strict=True):
            res, slopes = linearise(sight.camera, camera_T_mocap, x, uv)
            if joint_noise:
                res, slopes = slopes.whitened(res, joint_noise)
            added, weight, bending = loss.evaluate(res)
            cost += added
            drift = (camera_T_mocap.rotation @ velocity[frames].reshape(-1, 3).T).astype(
                np.float32
            )
            # A later offset takes an earlier skeleton: minus the velocity.
            rows = [np.vstack([r, -(r[3:] * drift).sum(0)]) for r in slopes.rows()]
            pull = rows[0] * res.du + rows[1] * res.dv
            weighted = (pull * weight).reshape(7, -1, n_joints)
            scores += weighted.sum(1).T
            later += per_block(weighted.sum(2), block[frames])
            root = np.sqrt(weight)
            for scaled in (rows[0] * root, rows[1] * root):
                info += scaled @ scaled.T
            if bending is not None:
                pull *= np.sqrt(bending)
                bend += pull @ pull.T
        local = np.zeros((7, p))
        local[:6, :6] = twist_from_delta(sight.camera_T_world, pose @ centroid_mocap)
        if number >= 0:
            local[6, 6 + number] = 1.0
        information += local.T @ info @ local
        hessian += local.T @ (info - bend) @ local
        joint_scores += scores @ local
        time_scores += later @ local
    gradient = joint_scores.sum(0)
    return TimedNormal(hessian, information, gradient, cost, joint_scores, time_scores)


def descend_in_time(
    sights: Sequence[Sight], timeline: Timeline, pose: RigidTransform, offset_s: Array,
    *, centroid_mocap: Array, loss: NoiseModel, column: Sequence[int], max_steps: int,
    check: Callable[[float], None],
) -> tuple[RigidTransform, Array, TimedNormal]:  # fmt: skip
    """Go to the nearest optimum of pose and offsets by Newton's method; the cost never rises.

    Returns:
        Pose, offsets (V,) seconds, and the sums where the last step began.

    """
    here = _look(sights, timeline, pose, offset_s, centroid_mocap, loss, column)
    shrink = 1.0
    for step in range(1, max_steps + 1):
        check(step / max_steps)
        delta, decrement = newton_step(here.hessian, here.information, here.gradient)
        delta = shrink * delta
        longest = np.abs(delta[6:]).max(initial=0.0)
        delta *= min(1.0, LARGEST_STEP_S / max(longest, 1e-12))
        moved = apply_delta(pose, delta[:6], pose @ centroid_mocap)
        later = offset_s + [delta[6 + c] if c >= 0 else 0.0 for c in column]
        if decrement < CONVERGED or step == max_steps:
            return moved, later, here
        there = _look(sights, timeline, moved, later, centroid_mocap, loss, column)
        if there.cost <= here.cost * (1.0 + 1e-7):
            pose, offset_s, here, shrink = moved, later, there, 1.0
        else:
            shrink *= 0.5
            if shrink < 1e-3:
                break
    return pose, offset_s, here


def _look(
    sights: Sequence[Sight], timeline: Timeline, pose: RigidTransform, offset_s: Array,
    centroid_mocap: Array, loss: Loss, column: Sequence[int],
) -> TimedNormal:  # fmt: skip
    moved, velocities = shifted(sights, timeline, offset_s)
    return timed_equations(moved, velocities, pose, centroid_mocap, loss, column)
