# SPDX-License-Identifier: Apache-2.0
"""Rigid transforms between named frames, and the rotations they are made of.

Right-handed, active, column vectors, Hamilton quaternions. `a_T_b` maps points of frame b to
frame a: `x_a = a_T_b @ x_b`. The publication's (R_m, t_m) is `world_T_mocap`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Column = NDArray[np.floating[Any]]  # single or double precision
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

ORTHONORMAL_TOLERANCE = 3e-6  # a rotation of six decimals is off by up to 1.7e-6
ORTHONORMAL_ROUNDING = 1e-12  # beyond it the nearest rotation is taken: products must stay ones


@dataclass(frozen=True, slots=True, eq=False)
class RigidTransform:
    """Maps points of the right-hand frame to the left-hand frame: `x_a = a_T_b @ x_b`.

    Attributes:
        rotation: (3, 3) proper rotation.
        translation: (3,) metres, in the left-hand frame.

    Raises:
        ValueError: Wrong shape, not finite, not orthonormal, or a reflection.

    """

    rotation: Array
    translation: Array

    def __post_init__(self) -> None:
        """Check once, at the border, so that no later product needs to."""
        rotation = np.array(self.rotation, dtype=np.float64)
        translation = np.array(self.translation, dtype=np.float64).reshape(-1)
        if rotation.shape != (3, 3) or translation.shape != (3,):
            msg = f'need shapes (3, 3) and (3,), got {rotation.shape} and {translation.shape}'
            raise ValueError(msg)
        if not (np.isfinite(rotation).all() and np.isfinite(translation).all()):
            msg = 'rotation and translation must be finite'
            raise ValueError(msg)
        error = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
        if error > ORTHONORMAL_TOLERANCE:
            msg = f'rotation is not orthonormal: R R^T differs from the identity by {error:.2g}'
            raise ValueError(msg)
        if np.linalg.det(rotation) < 0.0:
            msg = 'rotation is a reflection (det < 0): are the axes left-handed?'
            raise ValueError(msg)
        if error > ORTHONORMAL_ROUNDING:
            rotation = nearest_rotation(rotation)
        rotation.setflags(write=False)
        translation.setflags(write=False)
        object.__setattr__(self, 'rotation', rotation)
        object.__setattr__(self, 'translation', translation)

    @classmethod
    def identity(cls) -> RigidTransform:
        """Return the transform between two equal frames."""
        return cls(np.eye(3), np.zeros(3))

    @classmethod
    def from_matrix(cls, matrix: ArrayLike) -> RigidTransform:
        """Build from a homogeneous (4, 4) or (3, 4) matrix."""
        m = np.asarray(matrix, dtype=np.float64)
        if m.shape not in {(4, 4), (3, 4)}:
            msg = f'need a (4, 4) or (3, 4) matrix, got {m.shape}'
            raise ValueError(msg)
        return cls(m[:3, :3], m[:3, 3])

    @classmethod
    def from_quat_xyzw(cls, translation: ArrayLike, quat_xyzw: ArrayLike) -> RigidTransform:
        """Build from metres and a Hamilton quaternion x, y, z, w (normalised here)."""
        return cls(rotation_from_quat_xyzw(quat_xyzw), np.asarray(translation, dtype=np.float64))

    @property
    def matrix(self) -> Array:
        """The homogeneous (4, 4) matrix."""
        m = np.eye(4)
        m[:3, :3], m[:3, 3] = self.rotation, self.translation
        return m

    @property
    def quat_xyzw(self) -> Array:
        """(4,) Hamilton quaternion x, y, z, w of unit length, w >= 0."""
        return quat_xyzw_from_rotation(self.rotation)

    def inverse(self) -> RigidTransform:
        """Return `b_T_a`."""
        return _trusted(self.rotation.T, -self.rotation.T @ self.translation)

    @overload
    def __matmul__(self, other: RigidTransform) -> RigidTransform: ...
    @overload
    def __matmul__(self, other: Array) -> Array: ...
    def __matmul__(self, other: RigidTransform | Array) -> RigidTransform | Array:
        """Compose with another transform, or move points of shape (..., 3)."""
        if isinstance(other, RigidTransform):
            return _trusted(
                self.rotation @ other.rotation,
                self.rotation @ other.translation + self.translation,
            )
        return other @ self.rotation.T + self.translation


def _trusted(rotation: Array, translation: Array) -> RigidTransform:
    """Build from parts known to be valid: the checks cost more than the product itself."""
    out = object.__new__(RigidTransform)
    rotation.setflags(write=False)
    translation.setflags(write=False)
    object.__setattr__(out, 'rotation', rotation)
    object.__setattr__(out, 'translation', translation)
    return out


def skew(v: ArrayLike) -> Array:
    """Return the (3, 3) matrix with `skew(v) @ x = v cross x`."""
    x, y, z = np.asarray(v, dtype=np.float64)
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def so3_exp(rotvec: ArrayLike) -> Array:
    """Return the rotation (..., 3, 3) of a rotation vector (..., 3), radians (Rodrigues)."""
    v = np.asarray(rotvec, dtype=np.float64)
    angle2 = (v * v).sum(-1)[..., None, None]
    angle = np.sqrt(angle2)
    # np.sinc is sin(pi x) / (pi x): exact through zero, where the quotients lose all digits.
    a = np.sinc(angle / np.pi)
    b = 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2
    k = np.zeros((*v.shape, 3))
    k[..., 0, 1], k[..., 0, 2], k[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    k -= np.swapaxes(k, -1, -2)
    rotation: Array = np.eye(3) + a * k + b * (k @ k)
    return rotation


def so3_log(rotation: Array) -> Array:
    """Return the rotation vector (3,), radians, of length at most pi."""
    x, y, z, w = quat_xyzw_from_rotation(rotation)
    v = np.array([x, y, z])
    n = float(np.linalg.norm(v))
    return 2.0 * v if n < 1e-12 else v * (2.0 * np.arctan2(n, w) / n)


def rotation_angle(rotation: Array) -> float:
    """Return the angle of a rotation, radians, 0 to pi."""
    return float(np.linalg.norm(so3_log(rotation)))


def nearest_rotation(matrix: Array) -> Array:
    """Return the proper rotation closest to a (3, 3) matrix (Frobenius)."""
    u, _, vt = np.linalg.svd(matrix)
    rotation: Array = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return rotation


def rotation_from_quat_xyzw(quat_xyzw: ArrayLike) -> Array:
    """Return the (3, 3) rotation of a Hamilton quaternion x, y, z, w of any length but zero."""
    q = np.asarray(quat_xyzw, dtype=np.float64)
    norm = float(np.linalg.norm(q))
    if q.shape != (4,) or not np.isfinite(norm) or norm < 1e-9:
        msg = f'need a finite quaternion x, y, z, w that is not zero, got {q.tolist()}'
        raise ValueError(msg)
    x, y, z, w = q / norm
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def quat_xyzw_from_rotation(rotation: Array) -> Array:
    """Return the (4,) unit Hamilton quaternion x, y, z, w with w >= 0."""
    r = rotation
    # Each row holds 4 q_i q_k for one i; the row with the largest 4 q_i^2 divides safely.
    products = np.array(
        [
            [
                1 + r[0, 0] - r[1, 1] - r[2, 2],
                r[0, 1] + r[1, 0],
                r[0, 2] + r[2, 0],
                r[2, 1] - r[1, 2],
            ],
            [
                r[0, 1] + r[1, 0],
                1 - r[0, 0] + r[1, 1] - r[2, 2],
                r[1, 2] + r[2, 1],
                r[0, 2] - r[2, 0],
            ],
            [
                r[0, 2] + r[2, 0],
                r[1, 2] + r[2, 1],
                1 - r[0, 0] - r[1, 1] + r[2, 2],
                r[1, 0] - r[0, 1],
            ],
            [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], 1 + np.trace(r)],
        ]
    )
    q = products[int(np.argmax(np.diag(products)))]
    unit: Array = q / np.linalg.norm(q)
    return -unit if unit[3] < 0.0 else unit


def rotation_from_euler_zyx(angles: ArrayLike) -> Array:
    """Return `Z(gamma) Y(beta) X(alpha)` of angles (alpha, beta, gamma), radians."""
    return euler_zyx_with_derivatives(angles)[0]


def euler_zyx_with_derivatives(angles: ArrayLike) -> tuple[Array, Array]:
    """Return `R = Z(gamma) Y(beta) X(alpha)` and its derivatives by the angles, (3, 3, 3)."""
    a, b, g = np.asarray(angles, dtype=np.float64)
    (sa, sb, sg), (ca, cb, cg) = np.sin([a, b, g]), np.cos([a, b, g])
    x = np.array([[1, 0, 0], [0, ca, -sa], [0, sa, ca]])
    y = np.array([[cb, 0, sb], [0, 1, 0], [-sb, 0, cb]])
    z = np.array([[cg, -sg, 0], [sg, cg, 0], [0, 0, 1]])
    dx = np.array([[0, 0, 0], [0, -sa, -ca], [0, ca, -sa]])
    dy = np.array([[-sb, 0, cb], [0, 0, 0], [-cb, 0, -sb]])
    dz = np.array([[-sg, -cg, 0], [cg, -sg, 0], [0, 0, 0]])
    return z @ y @ x, np.stack([z @ y @ dx, z @ dy @ x, dz @ y @ x])


def euler_zyx_from_rotation(rotation: Array) -> Array:
    """Return (alpha, beta, gamma) of `Z(gamma) Y(beta) X(alpha)`, radians; 0 at the gimbal."""
    r = rotation
    c = float(np.hypot(r[0, 0], r[1, 0]))
    beta = np.arctan2(-r[2, 0], c)
    if c < 1e-9:
        # Only alpha -+ gamma is determined there: put all of it into alpha.
        return np.array([np.arctan2(-r[1, 2], r[1, 1]), beta, 0.0])
    return np.array([np.arctan2(r[2, 1], r[2, 2]), beta, np.arctan2(r[1, 0], r[0, 0])])
