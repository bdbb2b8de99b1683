# SPDX-License-Identifier: Apache-2.0
"""Cameras: intrinsics, lens and extrinsics.

Pixel centres are at integers: (0, 0) is the middle of the top left pixel, as in OpenCV. The
camera frame is the optical one: x right, y down, z forward.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from rpgd_ros.core.geometry import Array, RigidTransform
from rpgd_ros.core.lens import Lens, Model, distort, undistort

# OpenCV's orders: k1 k2 p1 p2 [k3 [k4 k5 k6]] (plumb_bob, rational_polynomial); k1 k2 k3 k4.
PINHOLE_LENGTHS = (0, 4, 5, 8)
EQUIDISTANT_LENGTHS = (0, 4)
MIN_DEPTH = 1e-6  # metres in front of the camera: nearer, the quotient x / z has no digits left
# Beyond all lenses and images, yet far from where the numbers of a solve would overflow.
MIN_FOCAL_PX, MAX_MATRIX_PX, MAX_COEFFICIENT = 1e-3, 1e7, 1e6
LARGEST_RADIUS2 = 1e24  # of x / z and y / z, squared: 1000 km at that depth; beyond it is damage


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
        lens: The lens model.

    Raises:
        ValueError: Wrong shapes, not finite, a focal length that is not positive, skew.

    """

    name: str
    matrix: Array
    distortion: Array
    size: tuple[int, int]
    camera_T_world: RigidTransform | None = None
    model: Model = 'pinhole'
    lens: Lens = field(init=False, repr=False)

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
        object.__setattr__(self, 'lens', Lens(self.model, padded))

    def with_focal(self, factor: float) -> Camera:
        """Return the camera with its focal lengths multiplied."""
        matrix = np.array(self.matrix)
        matrix[[0, 1], [0, 1]] *= factor
        return replace(self, matrix=matrix)

    @property
    def focal_px(self) -> float:
        """Geometric mean of the two focal lengths, pixels."""
        return float(np.sqrt(self.matrix[0, 0] * self.matrix[1, 1]))

    def project_camera(self, x_camera: Array) -> Array:
        """Project points of the camera frame.

        Args:
            x_camera: (..., 3) metres.

        Returns:
            (..., 2) pixels; NaN behind the camera and beyond the lens model.

        """
        z = x_camera[..., 2]
        in_front = z > MIN_DEPTH
        with np.errstate(over='ignore', invalid='ignore'):  # damaged numbers end as NaN
            iz = 1.0 / np.where(in_front, z, 1.0)
            x, y = x_camera[..., 0] * iz, x_camera[..., 1] * iz
            radius2 = x * x + y * y
        in_front &= radius2 < min(self.lens.max_radius**2, LARGEST_RADIUS2)
        x, y = np.where(in_front, x, np.nan), np.where(in_front, y, np.nan)
        ud, vd = distort(self.lens, x, y)
        fx, fy, cx, cy = self.pinhole
        return np.stack([fx * ud + cx, fy * vd + cy], -1)

    def project(self, x_world: Array) -> Array:
        """Project world points (..., 3), metres, to pixels (..., 2) (eq. 1); NaN out of view."""
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
        ideal = undistort(self.lens, (uv - [cx, cy]) / [fx, fy])
        ideal[~((ideal**2).sum(-1) < self.lens.max_radius**2)] = np.nan
        return ideal


def _check_intrinsics(name: str, model: str, matrix: Array, distortion: Array) -> None:
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
        msg = f'camera {name}: need a finite (3, 3) intrinsic matrix, got shape {matrix.shape}'
        raise ValueError(msg)
    if matrix[0, 0] <= 0.0 or matrix[1, 1] <= 0.0:
        msg = f'camera {name}: focal lengths must be positive: is the camera calibrated?'
        raise ValueError(msg)
    if min(matrix[0, 0], matrix[1, 1]) < MIN_FOCAL_PX or np.abs(matrix).max() > MAX_MATRIX_PX:
        msg = (
            f'camera {name}: the intrinsic matrix is of no camera: {np.diag(matrix)[:2]} px focal'
        )
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
    if np.abs(distortion).max(initial=0.0) > MAX_COEFFICIENT:
        msg = f'camera {name}: a distortion of {np.abs(distortion).max():.3g} is of no lens'
        raise ValueError(msg)
