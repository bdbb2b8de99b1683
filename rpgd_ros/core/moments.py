# SPDX-License-Identifier: Apache-2.0
"""One pass over the data that answers every question beyond the pose.

Whatever else may be unknown (a late clock, a joint that the detector sees elsewhere, a focal
length) moves a projected point along a few directions that are known at that point. The products
of these directions, summed per camera and joint, are all that a solve for any of them needs:
`unknowns` picks its parameters out of them by linear maps, without another look at the data.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rpgd_ros.core.examine import TIME_BLOCKS, time_blocks
from rpgd_ros.core.geometry import Array, Column, IntArray, RigidTransform
from rpgd_ros.core.linearise import Residuals, Sight, Slopes, linearise
from rpgd_ros.core.observations import is_there

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rpgd_ros.core.noise import Loss

# Directions at a point, in the camera's frame or units.
TWIST = slice(0, 6)  # of the camera's frame, rad and m
PUSH = slice(3, 6)  # of it: a shift of the point
LATE = 6  # s by which the video is stamped late
RATE = 7  # the same per second from the middle of the recording
JOINT = slice(8, 11)  # m, the body's frame
FOCAL = 11  # share of the focal length
SCALE = 12  # share of the skeleton's size, about a given centre
RADIAL = 13  # radial distortion k1 of the lens
N_ESTIMATED, N_ALL = 11, 14  # columns of the first three, and of all
LEAST_CURVATURE = 0.1  # of the loss, mean over the points by that of the weights


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Cameras with skeletons at their present clocks, and how these may move.

    Attributes:
        sights: Cameras with their data.
        velocity: Per camera (F, J, 3), m/s, MoCap frame; None where no time is known.
        body: Per camera (F, 3, 3) mocap_R_body; None where there is no frame of the body.
        seconds: Per camera (F,) from the middle of the recording; zero where no time is known.
        centre_mocap: (3,) about which the skeleton's size is changed, metres.

    """

    sights: Sequence[Sight]
    velocity: Sequence[Array] | None
    body: Sequence[Array] | None
    seconds: Sequence[Array]
    centre_mocap: Array


@dataclass(frozen=True, slots=True, eq=False)
class Moments:
    """Sums of one pass: V cameras, J joints, L directions.

    Attributes:
        information: (V, J, L, L) sum of w z z^T, times the curvature of the loss over its weight,
            mean over the camera's points: residuals point in all directions alike, so this is the
            Hessian.
        gradient: (V, TIME_BLOCKS, J, L) of the cost.
        cost: Sum of the loss.

    """

    information: Array
    gradient: Array
    cost: float


def sum_moments(scene: Scene, pose: RigidTransform, loss: Loss, *, n: int = N_ALL) -> Moments:
    """Sum the moments of all directions, or of the first n.

    Args:
        scene: The data.
        pose: world_T_mocap.
        loss: Loss of the squared residual.
        n: `N_ESTIMATED` or `N_ALL`.

    """
    n_views, n_joints = len(scene.sights), scene.sights[0].view.n_joints
    information = np.zeros((n_views, n_joints, n, n))
    gradient = np.zeros((n_views, TIME_BLOCKS, n_joints, n))
    cost = 0.0
    for v, (sight, block) in enumerate(zip(scene.sights, time_blocks(scene.sights), strict=True)):
        camera_T_mocap = sight.camera_T_world @ pose
        joint_noise = loss.joint_noise(sight.camera.focal_px)
        weights = curves = 0.0
        for frames in sight.slices():
            # Joint by joint, so that the sums of each are products of whole matrices.
            x = sight.view.x_mocap[frames].transpose(1, 0, 2).reshape(-1, 3)
            uv = sight.view.uv[frames].transpose(1, 0, 2).reshape(-1, 2)
            res, slopes = linearise(sight.camera, camera_T_mocap, x, uv)
            larger = _enlarged(sight, uv, res, slopes, joint_noise) if n == N_ALL else None
            if joint_noise:
                res, slopes = slopes.whitened(res, joint_noise)
            added, weight, bending = loss.evaluate(res)
            cost += added
            weights += float(weight.sum(dtype=np.float64))
            if bending is not None:
                curves += 0.5 * float(bending @ res.squared)
            z = _directions(scene, v, frames, camera_T_mocap, slopes, x, larger, n)
            _add(z, res, weight, block[frames], information[v], gradient[v])
        information[v] *= np.clip(1.0 - curves / max(weights, 1e-30), LEAST_CURVATURE, 1.0)
    return Moments(information, gradient, cost)


def _directions(
    scene: Scene, v: int, frames: slice, camera_T_mocap: RigidTransform, slopes: Slopes, x: Array,
    larger: _Enlarged | None, n: int,
) -> Column:  # fmt: skip
    """(n, J, 2, F) derivatives of (du, dv) by each direction."""
    n_joints = scene.sights[v].view.n_joints
    z = np.zeros((n, n_joints, 2, len(x) // n_joints), np.float32)
    shape = (6, n_joints, z.shape[3])
    for side, rows in enumerate(slopes.rows()):
        z[TWIST, :, side] = rows.reshape(shape)
    push = z[PUSH]
    rotation = camera_T_mocap.rotation
    seconds = scene.seconds[v][frames].astype(np.float32)
    if scene.velocity is not None:
        velocity = scene.velocity[v][frames].transpose(1, 0, 2).reshape(-1, 3)
        # A later offset takes an earlier skeleton: minus the velocity.
        z[LATE] = _along(push, -rotation @ velocity.T)
        z[RATE] = z[LATE] * seconds
    if scene.body is not None:
        turned = (rotation @ scene.body[v][frames]).astype(np.float32)
        for axis in range(3):
            z[8 + axis] = sum(push[i] * turned[:, i, axis] for i in range(3))
    if larger is not None:
        out = np.where(is_there(x)[:, None], x - scene.centre_mocap, 0.0)
        z[SCALE] = _along(push, rotation @ out.T)
        for side in (0, 1):
            z[FOCAL, :, side] = larger.lens[side].reshape(shape[1:])
            z[RADIAL, :, side] = larger.bent[side].reshape(shape[1:])
            z[SCALE, :, side] += larger.noise[side].reshape(shape[1:])
    return z


def _along(push: Column, direction: Array) -> Column:
    """(J, 2, F) derivatives by a shift of each point along its own direction (3, J F)."""
    _, n_joints, _, n_frames = push.shape
    d = direction.astype(np.float32).reshape(3, n_joints, 1, n_frames)
    out: Column = push[0] * d[0] + push[1] * d[1] + push[2] * d[2]
    return out


class _Enlarged(NamedTuple):
    """What another lens does to (du, dv), and what any enlargement does through the noise."""

    lens: tuple[Column, Column]
    bent: tuple[Column, Column]
    noise: tuple[Column, Column]


def _enlarged(
    sight: Sight, uv: Array, res: Residuals, slopes: Slopes, joint_noise: float
) -> _Enlarged:
    """A longer focal length moves a projection away from the principal point; k1 by r^2 as much.

    A focal length also enlarges the noise of the 3D joints, as a larger skeleton does, by which
    residuals are divided: without that term noisy joints would make every lens seem too long.
    """
    fx, fy, cx, cy = sight.camera.pinhole
    added, _ = slopes.joint_variance(joint_noise)
    root = 1.0 / np.sqrt(1.0 + added)
    share = added / (1.0 + added) * root
    with np.errstate(invalid='ignore'):
        away_u = np.where(res.in_view, uv[:, 0] - cx + res.du, 0.0) * root
        away_v = np.where(res.in_view, uv[:, 1] - cy + res.dv, 0.0) * root
    noise = -share * res.du, -share * res.dv
    # k1 enlarges by 1 + 3 r^2 k1 along the radius and by 1 + r^2 k1 across it.
    along_u, along_v = away_u / (root * fx), away_v / (root * fy)
    r2 = along_u**2 + along_v**2
    radial = 2.0 * (along_u * noise[0] + along_v * noise[1])
    bent = (
        r2 * (away_u + noise[0]) + radial * along_u,
        r2 * (away_v + noise[1]) + radial * along_v,
    )
    return _Enlarged((away_u + noise[0], away_v + noise[1]), bent, noise)


def _add(
    z: Column, res: Residuals, weight: Column, block: IntArray, information: Array, gradient: Array
) -> None:
    """Add one chunk to the sums of its camera."""
    n, n_joints, _, n_frames = z.shape
    shape = (n_joints, n_frames)
    pull = z[:, :, 0] * (weight * res.du).reshape(shape)
    pull += z[:, :, 1] * (weight * res.dv).reshape(shape)
    first = np.flatnonzero(np.diff(block, prepend=block[0] - 1))
    gradient[block[first]] += np.add.reduceat(pull, first, axis=2).transpose(2, 1, 0)
    z *= np.sqrt(weight).reshape(n_joints, 1, n_frames)
    flat = z.reshape(n, n_joints, -1).transpose(1, 0, 2)
    information += flat @ flat.transpose(0, 2, 1)
