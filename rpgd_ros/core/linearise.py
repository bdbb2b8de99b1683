# SPDX-License-Identifier: Apache-2.0
"""Residuals of the reprojection, and their normal equations, in one pass over the data.

A pass walks through chunks that fit the processor's cache and works on whole columns (structure
of arrays). The derivative is taken by a twist of the camera frame, which needs few operations per
point; a 6x6 matrix per camera carries the sums over to the parameters of the solve.

Parameters: delta = (w, d), world frame, with `x_world' = exp([w]x) (x_world - c) + c + d` about a
pivot c, the body's centroid. There, rotation and translation are nearly independent.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rpgd_ros.core.camera import Camera, distort, distort_with_derivatives, in_view
from rpgd_ros.core.geometry import Array, BoolArray, RigidTransform, skew, so3_exp
from rpgd_ros.core.observations import LARGEST_COORDINATE, View

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rpgd_ros.core.noise import Loss

CHUNK = 8192  # points: some 30 columns of 64 KiB stay in a 2 MiB cache (4k and 16k are slower)


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """One camera and what it saw."""

    camera: Camera
    view: View

    @property
    def camera_T_world(self) -> RigidTransform:
        """Extrinsics; the world is the camera itself where none are given."""
        return self.camera.camera_T_world or RigidTransform.identity()

    def chunks(self) -> Iterator[tuple[slice, Array, Array]]:
        """Yield (frames, x_mocap (n, 3), uv (n, 2)) of whole frames, about CHUNK points each."""
        n_joints = self.view.uv.shape[1]
        step = max(1, CHUNK // max(1, n_joints))
        for start in range(0, self.view.n_frames, step):
            frames = slice(start, start + step)
            yield frames, self.view.x_mocap[frames].reshape(-1, 3), self.view.uv[frames].reshape(-1, 2)

    def at_frames(self, frames: slice | Array) -> Sight:
        """Return the same camera with a selection of its frames."""
        v = self.view
        stamp_ns = None if v.stamp_ns is None else v.stamp_ns[frames]
        confidence = None if v.confidence is None else v.confidence[frames]
        return Sight(self.camera, View(stamp_ns, v.x_mocap[frames], v.uv[frames], confidence))


class Residuals(NamedTuple):
    """Reprojection minus keypoint (eq. 2) of n points.

    Attributes:
        du: (n,) pixels; 0 where not in view.
        dv: (n,) pixels; 0 where not in view.
        seen: (n,) whether both sides of the correspondence exist.
        in_view: (n,) whether it is seen and projects with depth > 0 (S of eq. 4).

    """

    du: Array
    dv: Array
    seen: BoolArray
    in_view: BoolArray


class Normal(NamedTuple):
    """Sums of one pass, by the parameters of the solve.

    Attributes:
        hessian: (6, 6) second derivative of the cost.
        information: (6, 6) its positive part, `sum w J^T J` (Gauss-Newton).
        gradient: (6,) first derivative of the cost.
        cost: Sum of the loss over all seen correspondences.

    """

    hessian: Array
    information: Array
    gradient: Array
    cost: float


def residuals(camera: Camera, camera_T_mocap: RigidTransform, x_mocap: Array, uv: Array) -> Residuals:
    """Project and compare (eq. 1, 2): x_mocap (n, 3) metres, uv (n, 2) pixels, NaN = missing."""
    a, b, _, seen, inside = _ideal(camera, camera_T_mocap, x_mocap, uv)
    ud, vd = distort(camera, a, b)
    fx, fy, cx, cy = camera.pinhole
    with np.errstate(invalid='ignore', over='ignore'):
        du, dv = fx * ud + (cx - uv[:, 0]), fy * vd + (cy - uv[:, 1])
    du[~inside], dv[~inside] = 0.0, 0.0
    return Residuals(du, dv, seen, inside)


def linearise(
    camera: Camera, camera_T_mocap: RigidTransform, x_mocap: Array, uv: Array
) -> tuple[Residuals, Array, Array]:
    """Residuals and their derivatives by a twist (w, v) of the camera frame.

    The twist moves a point of the camera frame by `w cross x + v`.

    Returns:
        Residuals, d du / d twist (6, n), d dv / d twist (6, n).

    """
    a, b, iz, seen, inside = _ideal(camera, camera_T_mocap, x_mocap, uv)
    lens = distort_with_derivatives(camera, a, b)
    fx, fy, cx, cy = camera.pinhole
    with np.errstate(invalid='ignore', over='ignore'):
        du, dv = fx * lens.x + (cx - uv[:, 0]), fy * lens.y + (cy - uv[:, 1])
    du[~inside], dv[~inside] = 0.0, 0.0
    rows_u = _twist_rows(fx * lens.dx_dx, fx * lens.dx_dy, a, b, iz)
    rows_v = _twist_rows(fy * lens.dy_dx, fy * lens.dy_dy, a, b, iz)
    return Residuals(du, dv, seen, inside), rows_u, rows_v


def twist_from_delta(camera_T_world: RigidTransform, pivot_world: Array) -> Array:
    """Return (6, 6): the camera's twist that a step (w, d) of the solve means."""
    r = camera_T_world.rotation
    out = np.zeros((6, 6))
    out[:3, :3] = out[3:, 3:] = r
    out[3:, :3] = skew(camera_T_world @ pivot_world) @ r
    return out


def apply_delta(world_T_mocap: RigidTransform, delta: Array, pivot_world: Array) -> RigidTransform:
    """Move a pose by a step (w, d) about the pivot."""
    turn = so3_exp(delta[:3])
    t = turn @ (world_T_mocap.translation - pivot_world) + pivot_world + delta[3:]
    return RigidTransform(np.eye(3), t) @ RigidTransform(turn @ world_T_mocap.rotation, np.zeros(3))


def normal_equations(
    sights: Sequence[Sight], world_T_mocap: RigidTransform, pivot_world: Array, loss: Loss,
    *, joint_scores: Array | None = None,
) -> Normal:  # fmt: skip
    """Sum cost, gradient and Hessian of a loss over all correspondences.

    Args:
        sights: Cameras with their data.
        world_T_mocap: Where to linearise.
        pivot_world: (3,) pivot of the parameters, metres.
        loss: Loss of the squared residual.
        joint_scores: (J, 6), zeros: receives the gradient summed per joint.

    """
    hessian, information = np.zeros((6, 6)), np.zeros((6, 6))
    gradient, cost = np.zeros(6), 0.0
    for sight in sights:
        camera_T_mocap = sight.camera_T_world @ world_T_mocap
        info, bend, grad = np.zeros((6, 6)), np.zeros((6, 6)), np.zeros(6)
        scores = None if joint_scores is None else np.zeros_like(joint_scores)
        for _, x, uv in sight.chunks():
            cost += _accumulate(sight.camera, camera_T_mocap, x, uv, loss, info, bend, grad, scores)
        to_twist = twist_from_delta(sight.camera_T_world, pivot_world)
        information += to_twist.T @ info @ to_twist
        hessian += to_twist.T @ (info - bend) @ to_twist
        gradient += to_twist.T @ grad
        if joint_scores is not None and scores is not None:
            joint_scores += scores @ to_twist
    return Normal(hessian, information, gradient, cost)


def _ideal(
    camera: Camera, camera_T_mocap: RigidTransform, x_mocap: Array, uv: Array
) -> tuple[Array, Array, Array, BoolArray, BoolArray]:
    """Return ideal image coordinates a, b, inverse depth, seen, in view; finite everywhere."""
    with np.errstate(invalid='ignore', over='ignore'):
        x, y, z = camera_T_mocap.rotation @ x_mocap.T + camera_T_mocap.translation[:, None]
        u, v = uv[:, 0], uv[:, 1]
        limit = LARGEST_COORDINATE**2
        seen = (u * u + v * v < limit) & (x * x + y * y + z * z < limit)  # False for NaN
        iz = 1.0 / np.where(z > 0.0, z, 1.0)
        a, b = x * iz, y * iz
        inside = seen & in_view(camera, a, b, z)
    outside = ~inside
    for column in (a, b, iz):
        column[outside] = 0.0
    return a, b, iz, seen, inside


def _twist_rows(ua: Array, ub: Array, a: Array, b: Array, iz: Array) -> Array:
    """Chain the derivative by (a, b) = (x / z, y / z) with that of the point by the twist."""
    rows = np.empty((6, len(a)))
    k = ua * a + ub * b
    np.multiply(k, -b, out=rows[0])
    rows[0] -= ub
    np.multiply(k, a, out=rows[1])
    rows[1] += ua
    np.multiply(ub, a, out=rows[2])
    rows[2] -= ua * b
    np.multiply(ua, iz, out=rows[3])
    np.multiply(ub, iz, out=rows[4])
    np.multiply(k, -iz, out=rows[5])
    return rows


def _accumulate(
    camera: Camera, camera_T_mocap: RigidTransform, x: Array, uv: Array, loss: Loss,
    info: Array, bend: Array, grad: Array, scores: Array | None,
) -> float:  # fmt: skip
    """Add one chunk to the sums (by the camera's twist) and return its cost."""
    res, rows_u, rows_v = linearise(camera, camera_T_mocap, x, uv)
    squared = res.du * res.du + res.dv * res.dv
    cost, weight, bending = loss.evaluate(squared, res.in_view, res.seen)
    pull = rows_u * res.du
    pull += rows_v * res.dv
    grad += pull @ weight
    if scores is not None:
        scores += (pull * weight).reshape(6, -1, len(scores)).sum(1).T
    root = np.sqrt(weight)
    rows_u *= root
    rows_v *= root
    info += rows_u @ rows_u.T
    info += rows_v @ rows_v.T
    if bending is not None:
        pull *= np.sqrt(bending)
        bend += pull @ pull.T
    return cost
