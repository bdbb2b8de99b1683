# SPDX-License-Identifier: Apache-2.0
"""Cameras: the OpenCV models, their projection, its derivatives and its inverse.

Pixel centres are at integers: (0, 0) is the middle of the top left pixel, as in OpenCV. The
camera frame is the optical one: x right, y down, z forward.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from rpgd_ros.core.geometry import Array, BoolArray, RigidTransform

Model = Literal['pinhole', 'equidistant']
Coefficients = tuple[float, ...]

# OpenCV's orders: k1 k2 p1 p2 [k3 [k4 k5 k6]] (plumb_bob, rational_polynomial); k1 k2 k3 k4.
PINHOLE_LENGTHS = (0, 4, 5, 8)
EQUIDISTANT_LENGTHS = (0, 4)
MIN_DEPTH = 1e-6  # metres in front of the camera: nearer, the quotient x / z has no digits left
UNDISTORT_STEPS = 8  # Newton: digits double, five steps reach 1e-12 inside every lens tried
UNDISTORT_DONE = 1e-12
UNDISTORT_TOLERANCE = 1e-6  # normalised: 0.001 px at a focal length of 1000 px
FOLD_SEARCH_RADIUS = 10.0  # normalised image radius, 84 deg off the axis: no lens of this model sees it


class Distorted(NamedTuple):
    """Distorted normalised image coordinates and their derivatives by the ideal ones, each (n,)."""

    x: Array
    y: Array
    dx_dx: Array
    dx_dy: Array
    dy_dx: Array
    dy_dy: Array


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """One calibrated camera.

    Attributes:
        name: What people and topics call it.
        matrix: (3, 3) intrinsics K, pixels.
        distortion: OpenCV coefficients: 0, 4, 5 or 8 of them (`pinhole`), 0 or 4 (`equidistant`).
        size: Width and height of the image, pixels.
        camera_T_world: World to camera; None where unknown.
        model: `pinhole` (plumb_bob, rational_polynomial) or `equidistant` (fisheye).
        max_radius: Largest ideal normalised radius at which the distortion is still invertible
            (at most 10; infinite without distortion). Beyond it the polynomial folds back and
            would put far points into the image.
        is_distorted: Whether the lens model differs from the ideal pinhole.
        coefficients: The distortion, filled with zeros to 8 (`pinhole`) or 4 Python floats, which
            leave single-precision columns single.

    Raises:
        ValueError: Wrong shapes, not finite, a focal length that is not positive, skew.

    """

    name: str
    matrix: Array
    distortion: Array
    size: tuple[int, int]
    camera_T_world: RigidTransform | None = None
    model: Model = 'pinhole'
    max_radius: float = field(init=False)
    is_distorted: bool = field(init=False)
    coefficients: tuple[float, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Check and copy the arrays, and find where the lens model ends."""
        matrix = np.array(self.matrix, dtype=np.float64)
        distortion = np.array(self.distortion, dtype=np.float64).reshape(-1)
        _check_intrinsics(self.name, self.model, matrix, distortion)
        width, height = (int(n) for n in self.size)
        if width <= 0 or height <= 0:
            msg = f'camera {self.name}: image size must be positive, got {self.size}'
            raise ValueError(msg)
        matrix.setflags(write=False)
        distortion.setflags(write=False)
        object.__setattr__(self, 'matrix', matrix)
        object.__setattr__(self, 'distortion', distortion)
        object.__setattr__(self, 'size', (width, height))
        length = 4 if self.model == 'equidistant' else 8
        padded = (*distortion.tolist(), *[0.0] * (length - distortion.size))
        object.__setattr__(self, 'coefficients', padded)
        is_distorted = self.model == 'equidistant' or any(padded)
        object.__setattr__(self, 'is_distorted', is_distorted)
        object.__setattr__(self, 'max_radius', _fold_radius(self))

    @property
    def focal_px(self) -> float:
        """Geometric mean of the two focal lengths, pixels."""
        return float(np.sqrt(self.matrix[0, 0] * self.matrix[1, 1]))

    def project_camera(self, x_camera: Array) -> Array:
        """Project points of the camera frame.

        Args:
            x_camera: (..., 3) metres.

        Returns:
            (..., 2) pixels; NaN behind the camera and beyond `max_radius`.

        """
        z = x_camera[..., 2]
        in_front = z > MIN_DEPTH
        iz = 1.0 / np.where(in_front, z, 1.0)
        x, y = x_camera[..., 0] * iz, x_camera[..., 1] * iz
        in_front &= x * x + y * y < self.max_radius**2
        x, y = np.where(in_front, x, np.nan), np.where(in_front, y, np.nan)
        lens = distort(self, x, y)
        fx, fy, cx, cy = self.pinhole
        return np.stack([fx * lens[0] + cx, fy * lens[1] + cy], -1)

    def project(self, x_world: Array) -> Array:
        """Project world points (..., 3), metres, to pixels (..., 2); NaN where not in view (eq. 1)."""
        camera_T_world = self.camera_T_world or RigidTransform.identity()
        return self.project_camera(camera_T_world @ x_world)

    @property
    def pinhole(self) -> tuple[float, float, float, float]:
        """The four numbers fx, fy, cx, cy, pixels."""
        k = self.matrix
        return float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2])

    def normalise(self, uv: Array) -> Array:
        """Undo intrinsics and distortion.

        Args:
            uv: (n, 2) pixels, NaN allowed.

        Returns:
            (n, 2) ideal normalised coordinates (x / z, y / z); NaN where the lens model cannot
            have produced the pixel.

        """
        fx, fy, cx, cy = self.pinhole
        seen = (uv - [cx, cy]) / [fx, fy]
        ideal = _undistort(self, seen) if self.is_distorted else seen
        ideal[~((ideal**2).sum(-1) < self.max_radius**2)] = np.nan
        return ideal


def in_view(camera: Camera, x: Array, y: Array, z: Array) -> BoolArray:
    """Whether points are before the camera and inside its lens model; x, y normalised, z metres."""
    return (z > MIN_DEPTH) & (x * x + y * y < camera.max_radius**2)


def distort(camera: Camera, x: Array, y: Array) -> tuple[Array, Array]:
    """Apply the lens model to ideal normalised coordinates of any one shape."""
    if not camera.is_distorted:
        return x, y
    if camera.model == 'equidistant':
        r = np.hypot(x, y)
        theta = np.arctan(r)
        scale = _equidistant_angle(camera.coefficients, theta) / np.where(r > 1e-9, r, 1.0)
        scale = np.where(r > 1e-9, scale, 1.0)
        return x * scale, y * scale
    p1, p2 = camera.coefficients[2:4]
    r2 = x * x + y * y
    radial = _radial(camera.coefficients, r2)
    xy2 = 2.0 * x * y
    return (
        x * radial + p1 * xy2 + p2 * (r2 + 2.0 * x * x),
        y * radial + p1 * (r2 + 2.0 * y * y) + p2 * xy2,
    )


def distort_with_derivatives(camera: Camera, x: Array, y: Array) -> Distorted:
    """Apply the lens model and differentiate it; x, y (n,) ideal normalised coordinates."""
    if not camera.is_distorted:
        one, zero = np.ones_like(x), np.zeros_like(x)
        return Distorted(x, y, one, zero, zero, one)
    if camera.model == 'equidistant':
        return _equidistant_with_derivatives(camera.coefficients, x, y)
    p1, p2 = camera.coefficients[2:4]
    xx, yy, xy2 = x * x, y * y, 2.0 * x * y
    r2 = xx + yy
    radial = _radial(camera.coefficients, r2)
    slope2 = 2.0 * _radial_slope(camera.coefficients, r2)
    # Both cross derivatives are equal: the lens model is the gradient of a potential.
    cross = 0.5 * xy2 * slope2 + 2.0 * (p1 * x + p2 * y)
    return Distorted(
        x * radial + p1 * xy2 + p2 * (r2 + 2.0 * xx),
        y * radial + p1 * (r2 + 2.0 * yy) + p2 * xy2,
        radial + xx * slope2 + 2.0 * p1 * y + 6.0 * p2 * x,
        cross,
        cross,
        radial + yy * slope2 + 6.0 * p1 * y + 2.0 * p2 * x,
    )


def _radial(d: Coefficients, r2: Array) -> Array:
    """Radial factor of plumb_bob or, where the last three are not zero, rational_polynomial."""
    factor: Array = 1.0 + r2 * (d[0] + r2 * (d[1] + r2 * d[4]))
    if any(d[5:]):
        factor = factor / (1.0 + r2 * (d[5] + r2 * (d[6] + r2 * d[7])))
    return factor


def _radial_slope(d: Coefficients, r2: Array) -> Array:
    """Derivative of the radial factor by the squared radius."""
    slope: Array = d[0] + r2 * (2.0 * d[1] + 3.0 * d[4] * r2)
    if any(d[5:]):
        below = 1.0 + r2 * (d[5] + r2 * (d[6] + r2 * d[7]))
        slope_below = d[5] + r2 * (2.0 * d[6] + 3.0 * d[7] * r2)
        slope = (slope - _radial(d, r2) * slope_below) / below
    return slope


def _equidistant_angle(d: Coefficients, theta: Array) -> Array:
    """Distorted angle of OpenCV's fisheye model."""
    t2 = theta * theta
    angle: Array = theta * (1.0 + t2 * (d[0] + t2 * (d[1] + t2 * (d[2] + t2 * d[3]))))
    return angle


def _equidistant_slope(d: Coefficients, theta: Array) -> Array:
    """Derivative of the distorted angle by the angle."""
    t2 = theta * theta
    slope: Array = 1.0 + t2 * (3 * d[0] + t2 * (5 * d[1] + t2 * (7 * d[2] + t2 * 9 * d[3])))
    return slope


def _equidistant_with_derivatives(d: Coefficients, x: Array, y: Array) -> Distorted:
    """Fisheye model: the radius r becomes theta_d(atan r), the direction stays."""
    r = np.hypot(x, y)
    near = r < 1e-9  # the limit on the axis: the identity
    safe = np.where(near, 1.0, r)
    theta = np.arctan(r)
    slope = _equidistant_slope(d, theta)
    scale = np.where(near, 1.0, _equidistant_angle(d, theta) / safe)
    # d(scale) / dr / r, so that d(x scale) = scale dx + x (x dx + y dy) growth.
    growth = np.where(near, 0.0, (slope / (1.0 + r * r) - scale) / (safe * safe))
    cross = x * y * growth
    return Distorted(
        x * scale, y * scale, scale + x * x * growth, cross, cross, scale + y * y * growth
    )


def _undistort(camera: Camera, seen: Array) -> Array:
    """Invert `distort` by Newton's method: (n, 2) to (n, 2), NaN where it does not converge."""
    if camera.model == 'equidistant':
        return _undistort_equidistant(camera.coefficients, seen)
    ideal = seen.copy()
    with np.errstate(all='ignore'):  # points outside the lens model run away; they end as NaN
        for _ in range(UNDISTORT_STEPS):
            lens = distort_with_derivatives(camera, ideal[:, 0], ideal[:, 1])
            ex, ey = seen[:, 0] - lens.x, seen[:, 1] - lens.y
            det = lens.dx_dx * lens.dy_dy - lens.dx_dy * lens.dy_dx
            if not np.nanmax(np.abs(ex) + np.abs(ey), initial=0.0) > UNDISTORT_DONE:
                break
            ideal[:, 0] += (lens.dy_dy * ex - lens.dx_dy * ey) / det
            ideal[:, 1] += (lens.dx_dx * ey - lens.dy_dx * ex) / det
        x, y = distort(camera, ideal[:, 0], ideal[:, 1])
        ideal[~(np.hypot(x - seen[:, 0], y - seen[:, 1]) < UNDISTORT_TOLERANCE)] = np.nan
    return ideal


def _undistort_equidistant(d: Coefficients, seen: Array) -> Array:
    """Invert the fisheye model: Newton's method on the angle from the optical axis."""
    theta_seen = np.hypot(seen[:, 0], seen[:, 1])
    theta = theta_seen.copy()
    with np.errstate(all='ignore'):
        for _ in range(UNDISTORT_STEPS):
            theta -= (_equidistant_angle(d, theta) - theta_seen) / _equidistant_slope(d, theta)
        good = np.abs(_equidistant_angle(d, theta) - theta_seen) < UNDISTORT_TOLERANCE
    good &= (theta >= 0.0) & (theta < 0.5 * np.pi)  # behind the image plane x / z has no meaning
    scale = np.tan(np.where(good, theta, 0.0)) / np.maximum(theta_seen, 1e-12)
    scale[theta_seen < 1e-12] = 1.0
    return np.where(good[:, None], seen * scale[:, None], np.nan)


def _check_intrinsics(name: str, model: str, matrix: Array, distortion: Array) -> None:
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
        msg = f'camera {name}: need a finite (3, 3) intrinsic matrix, got shape {matrix.shape}'
        raise ValueError(msg)
    if matrix[0, 0] <= 0.0 or matrix[1, 1] <= 0.0:
        msg = f'camera {name}: focal lengths must be positive: is the camera calibrated?'
        raise ValueError(msg)
    if matrix[0, 1] != 0.0 or not np.array_equal(matrix[2], [0.0, 0.0, 1.0]):
        msg = f'camera {name}: the intrinsic matrix must be [fx 0 cx; 0 fy cy; 0 0 1] (no skew)'
        raise ValueError(msg)
    lengths = {'pinhole': PINHOLE_LENGTHS, 'equidistant': EQUIDISTANT_LENGTHS}.get(model)
    if lengths is None:
        msg = f'camera {name}: unknown model {model!r}; known: pinhole, equidistant'
        raise ValueError(msg)
    if distortion.size not in lengths or not np.isfinite(distortion).all():
        msg = (
            f'camera {name}: model {model} takes {" or ".join(map(str, lengths))} finite '
            f'distortion coefficients, got {distortion.size}'
        )
        raise ValueError(msg)


def _fold_radius(camera: Camera) -> float:
    """Return the ideal radius up to which the distorted radius grows."""
    if not camera.is_distorted:
        return np.inf
    r = np.linspace(0.0, FOLD_SEARCH_RADIUS, 20001)
    if camera.model == 'equidistant':
        distorted = _equidistant_angle(camera.coefficients, np.arctan(r))
    else:
        with np.errstate(divide='ignore', invalid='ignore'):
            distorted = r * _radial(camera.coefficients, r * r)
    folds = np.flatnonzero(~(np.diff(distorted) > 0.0))
    return float(r[folds[0]]) if folds.size else FOLD_SEARCH_RADIUS
