# SPDX-License-Identifier: Apache-2.0
"""Residuals of the reprojection and their derivatives, in one pass over the data.

A pass walks through chunks that fit the processor's cache and works on whole columns (structure
of arrays). Columns are single precision: rounding adds 1e-4 px to a residual, a thousandth of the
noise of the best detector; sums are double. The derivative is taken by a twist (w, v) of the
camera frame, which moves its points by `w cross x + v` and needs few operations per point; a 6x6
matrix per camera carries the sums over to the parameters of the solve, see `normal`.
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
)
from rpgd_ros.core.lens import distort, distort_with_derivatives
from rpgd_ros.core.observations import LARGEST_COORDINATE, View

if TYPE_CHECKING:
    from collections.abc import Iterator

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
        du_dz: Derivative by the logarithm of the depth, where weights depend on it.
        dv_dz: The same.

    """

    a: Column
    b: Column
    iz: Column
    du_da: Column
    du_db: Column
    dv_da: Column
    dv_db: Column
    du_dz: Column | None = None
    dv_dz: Column | None = None

    def rows(self) -> tuple[Column, Column]:
        """Derivatives of du and dv by the twist, (6, n) each."""
        return (
            self._row(self.du_da, self.du_db, self.du_dz),
            self._row(self.dv_da, self.dv_db, self.dv_dz),
        )

    def _row(self, by_a: Column, by_b: Column, by_z: Column | None) -> Column:
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
        if by_z is not None:
            out[0] += by_z * self.b
            out[1] -= by_z * self.a
            out[5] += by_z * self.iz
        return out

    def pull(self, du: Column, dv: Column) -> Column:
        """(6, n) J^T r by the twist: what `rows` gives, without making them."""
        g_a = self.du_da * du + self.dv_da * dv
        g_b = self.du_db * du + self.dv_db * dv
        if self.du_dz is None or self.dv_dz is None:
            return self._row(g_a, g_b, None)
        return self._row(g_a, g_b, self.du_dz * du + self.dv_dz * dv)

    def joint_variance(self, joint_noise: float) -> tuple[Column, Column]:
        """(n,) variance that noisy joints add to a residual, over that of the keypoints.

        Noise n of a 3D point moves its ideal coordinates by (n_x - a n_z, n_y - b n_z) / z: mean
        of both `(1 + (a^2 + b^2) / 2) / z^2`. The second result is that bracket.

        Args:
            joint_noise: Metres times focal length over the pixel noise: sigma_3D f / sigma.

        """
        spread = 1.0 + 0.5 * (self.a * self.a + self.b * self.b)
        return (joint_noise * self.iz) ** 2 * spread, spread

    def whitened(self, res: Residuals, joint_noise: float) -> tuple[Residuals, Slopes]:
        """Divide residuals by how much the noise of the 3D joints adds at their depth.

        var(r) = sigma^2 (1 + `joint_variance`). The divisor moves with the pose, and so do these
        derivatives: that term takes out the bias that noisy 3D points give to least squares
        (errors in variables).

        Args:
            res: Residuals.
            joint_noise: Metres times focal length over the pixel noise: sigma_3D f / sigma.

        """
        added, spread = self.joint_variance(joint_noise)
        root = 1.0 / np.sqrt(1.0 + added)
        share = added / (1.0 + added)
        du, dv = res.du * root, res.dv * root
        lean_a, lean_b = (0.5 * share / spread * x for x in (self.a, self.b))
        slopes = Slopes(
            self.a, self.b, self.iz,
            self.du_da * root - du * lean_a, self.du_db * root - du * lean_b,
            self.dv_da * root - dv * lean_a, self.dv_db * root - dv * lean_b,
            share * du, share * dv,
        )  # fmt: skip
        return res._replace(du=du, dv=dv), slopes


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
