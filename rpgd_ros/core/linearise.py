# SPDX-License-Identifier: Apache-2.0
"""Residuals of the reprojection and their derivatives, in one pass over the data.

A pass walks through chunks that fit the processor's cache and works on whole columns (structure
of arrays). Columns are single precision: rounding adds 1e-4 px to a residual, a thousandth of the
noise of the best detector; sums are double. The derivative is taken by a twist (w, v) of the
camera frame, which moves its points by `w cross x + v` and needs few operations per point; a 6x6
matrix per camera carries the sums over to the parameters of the solve.

Parameters: delta = (w, d), world frame, with `x_world' = exp([w]x) (x_world - c) + c + d` about a
pivot c, the body's centroid. There, rotation and translation are nearly independent.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rpgd_ros.core.camera import MIN_DEPTH, Camera
from rpgd_ros.core.geometry import (
    Array,
    BoolArray,
    Column,
    IntArray,
    RigidTransform,
    nearest_rotation,
    skew,
    so3_exp,
)
from rpgd_ros.core.lens import distort, distort_with_derivatives
from rpgd_ros.core.observations import LARGEST_COORDINATE, View

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rpgd_ros.core.noise import Loss

Precision = type[np.float32] | type[np.float64]

CHUNK = 16384  # points: some 30 columns of 64 KiB stay in a 2 MiB cache


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """One camera and what it saw."""

    camera: Camera
    view: View

    @property
    def camera_T_world(self) -> RigidTransform:
        """Extrinsics; the world is the camera itself where none are given."""
        return self.camera.camera_T_world or RigidTransform.identity()

    def chunks(self) -> Iterator[tuple[Array, Array]]:
        """Yield x_mocap (n, 3) and uv (n, 2) of whole frames, about CHUNK points each."""
        for frames in self.slices():
            yield self.view.x_mocap[frames].reshape(-1, 3), self.view.uv[frames].reshape(-1, 2)

    def slices(self) -> Iterator[slice]:
        """Yield the frames of each chunk."""
        step = max(1, CHUNK // max(1, self.view.n_joints))
        for start in range(0, self.view.n_frames, step):
            yield slice(start, start + step)

    def at_frames(self, frames: IntArray) -> Sight:
        """Return the same camera with a selection of its frames."""
        v = self.view
        stamp_ns = None if v.stamp_ns is None else v.stamp_ns[frames]
        confidence = None if v.confidence is None else v.confidence[frames]
        return Sight(self.camera, View(stamp_ns, v.x_mocap[frames], v.uv[frames], confidence))


class Residuals(NamedTuple):
    """Reprojection minus keypoint (eq. 2) of n points; zero where not in view.

    Attributes:
        du: (n,) pixels.
        dv: (n,) pixels.
        seen: (n,) whether both sides of the correspondence exist.
        in_view: (n,) whether it is seen and projects with depth > 0 (S of eq. 4).

    """

    du: Column
    dv: Column
    seen: BoolArray
    in_view: BoolArray

    @property
    def squared(self) -> Column:
        """(n,) squared lengths, px^2."""
        return self.du * self.du + self.dv * self.dv


class Slopes(NamedTuple):
    """What the derivatives of n residuals are made of, each (n,).

    Attributes:
        a: Ideal image coordinate x / z.
        b: Ideal image coordinate y / z.
        iz: Inverse depth, 1 / m.
        du_da: Pixels per ideal coordinate.
        du_db: The same.
        dv_da: The same.
        dv_db: The same.

    """

    a: Column
    b: Column
    iz: Column
    du_da: Column
    du_db: Column
    dv_da: Column
    dv_db: Column

    def rows(self) -> tuple[Column, Column]:
        """Derivatives of du and dv by the twist, (6, n) each."""
        return self._row(self.du_da, self.du_db), self._row(self.dv_da, self.dv_db)

    def _row(self, by_a: Column, by_b: Column) -> Column:
        out = np.empty((6, len(by_a)), by_a.dtype)
        k = by_a * self.a + by_b * self.b
        np.multiply(k, -self.b, out=out[0])
        out[0] -= by_b
        np.multiply(k, self.a, out=out[1])
        out[1] += by_a
        np.multiply(by_b, self.a, out=out[2])
        out[2] -= by_a * self.b
        np.multiply(by_a, self.iz, out=out[3])
        np.multiply(by_b, self.iz, out=out[4])
        np.multiply(k, -self.iz, out=out[5])
        return out

    def pull(self, du: Column, dv: Column) -> Column:
        """(6, n) J^T r by the twist: what `rows` gives, without making them."""
        g_a = self.du_da * du + self.dv_da * dv
        g_b = self.du_db * du + self.dv_db * dv
        return self._row(g_a, g_b)


class Normal(NamedTuple):
    """Sums of one pass, by the parameters of the solve.

    Attributes:
        hessian: (6, 6) second derivative of the cost.
        information: (6, 6) its positive part, `sum w J^T J` (Gauss-Newton).
        gradient: (6,) first derivative of the cost.
        cost: Sum of the loss over all seen correspondences.
        camera_hessian: (V, 6, 6) each camera's part of the Hessian.
        camera_information: (V, 6, 6) each camera's part of the information.

    """

    hessian: Array
    information: Array
    gradient: Array
    cost: float
    camera_hessian: Array
    camera_information: Array


def residuals(
    camera: Camera, camera_T_mocap: RigidTransform, x_mocap: Array, uv: Array,
    dtype: Precision = np.float32,
) -> Residuals:  # fmt: skip
    """Project and compare (eq. 1, 2): x_mocap (n, 3) metres, uv (n, 2) pixels, NaN = missing."""
    a, b, _, seen, inside = _ideal(camera, camera_T_mocap, x_mocap, uv, dtype)
    ud, vd = distort(camera.lens, a, b)
    return _compare(camera, ud, vd, uv, seen, inside)


def linearise(
    camera: Camera, camera_T_mocap: RigidTransform, x_mocap: Array, uv: Array,
    dtype: Precision = np.float32,
) -> tuple[Residuals, Slopes]:  # fmt: skip
    """Residuals, and what their derivatives are made of; arguments as for `residuals`."""
    a, b, iz, seen, inside = _ideal(camera, camera_T_mocap, x_mocap, uv, dtype)
    lens = distort_with_derivatives(camera.lens, a, b)
    res = _compare(camera, lens.x, lens.y, uv, seen, inside)
    fx, fy, _, _ = camera.pinhole
    slopes = Slopes(a, b, iz, fx * lens.dx_dx, fx * lens.dx_dy, fy * lens.dy_dx, fy * lens.dy_dy)
    return res, slopes


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
    translation = turn @ (world_T_mocap.translation - pivot_world) + pivot_world + delta[3:]
    # Steps add up: without this the rotation would slowly cease to be one.
    return RigidTransform(nearest_rotation(turn @ world_T_mocap.rotation), translation)


def normal_equations(
    sights: Sequence[Sight], world_T_mocap: RigidTransform, pivot_world: Array, loss: Loss
) -> Normal:
    """Sum cost, gradient and Hessian of a loss over all correspondences.

    Args:
        sights: Cameras with their data.
        world_T_mocap: Where to linearise.
        pivot_world: (3,) pivot of the parameters, metres.
        loss: Loss of the squared residual.

    """
    hessian, information = np.zeros((2, len(sights), 6, 6))
    gradient, cost = np.zeros(6), 0.0
    for v, sight in enumerate(sights):
        camera_T_mocap = sight.camera_T_world @ world_T_mocap
        info, bend, grad = np.zeros((6, 6)), np.zeros((6, 6)), np.zeros(6)
        for x, uv in sight.chunks():
            res, slopes = linearise(sight.camera, camera_T_mocap, x, uv)
            added, weight, bending = loss.evaluate(res)
            cost += added
            _accumulate(res, slopes, weight, bending, info, bend, grad)
        to_twist = twist_from_delta(sight.camera_T_world, pivot_world)
        information[v] = to_twist.T @ info @ to_twist
        hessian[v] = to_twist.T @ (info - bend) @ to_twist
        gradient += to_twist.T @ grad
    return Normal(hessian.sum(0), information.sum(0), gradient, cost, hessian, information)


def _accumulate(
    res: Residuals, slopes: Slopes, weight: Column, bending: Column | None,
    info: Array, bend: Array, grad: Array,
) -> None:  # fmt: skip
    """Add one chunk to the sums, by the camera's twist."""
    rows_u, rows_v = slopes.rows()
    pull = rows_u * res.du
    pull += rows_v * res.dv
    grad += pull @ weight
    root = np.sqrt(weight)
    rows_u *= root
    rows_v *= root
    info += rows_u @ rows_u.T
    info += rows_v @ rows_v.T
    if bending is not None:
        pull *= np.sqrt(bending)
        bend += pull @ pull.T


def _ideal(
    camera: Camera, camera_T_mocap: RigidTransform, x_mocap: Array, uv: Array, dtype: Precision
) -> tuple[Column, Column, Column, BoolArray, BoolArray]:
    """Return ideal image coordinates a, b, inverse depth, seen, in view; finite everywhere."""
    limit = LARGEST_COORDINATE**2
    with np.errstate(all='ignore'):  # damaged numbers are sorted out by the comparisons below
        moved = camera_T_mocap.rotation @ x_mocap.T
        x, y, z = (moved + camera_T_mocap.translation[:, None]).astype(dtype)
        u, v = uv.astype(dtype).T
        seen = (u * u + v * v < limit) & (x * x + y * y + z * z < limit)  # False for NaN
        iz = 1.0 / z
        a, b = x * iz, y * iz
        inside = seen & (z > MIN_DEPTH)
        if np.isfinite(camera.lens.max_radius):
            inside &= a * a + b * b < camera.lens.max_radius**2
    if not inside.all():
        outside = ~inside
        for column in (a, b, iz):
            column[outside] = 0.0
    return a, b, iz, seen, inside


def _compare(
    camera: Camera, ud: Column, vd: Column, uv: Array, seen: BoolArray, inside: BoolArray
) -> Residuals:
    fx, fy, cx, cy = camera.pinhole
    with np.errstate(invalid='ignore', over='ignore'):
        # The difference to the principal point in double, so that only small numbers are rounded.
        du = fx * ud - (uv[:, 0] - cx).astype(ud.dtype)
        dv = fy * vd - (uv[:, 1] - cy).astype(vd.dtype)
    if not inside.all():
        outside = ~inside
        du[outside], dv[outside] = 0.0, 0.0
    return Residuals(du, dv, seen, inside)
