# SPDX-License-Identifier: Apache-2.0
"""Lens models: ideal to distorted normalised image coordinates, the derivatives, and back.

OpenCV's plumb_bob and rational_polynomial (`pinhole`) and fisheye (`equidistant`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from rpgd_ros.core.geometry import Array, Column

Model = Literal['pinhole', 'equidistant']
Coefficients = tuple[float, ...]

UNDISTORT_STEPS = 8  # Newton: digits double, five steps reach 1e-12 inside every lens tried
UNDISTORT_DONE = 1e-12
UNDISTORT_TOLERANCE = 1e-6  # normalised: 0.001 px at a focal length of 1000 px
FOLD_SEARCH_RADIUS = 10.0  # normalised: 84 deg off the axis, where no lens of these models sees


class Distorted(NamedTuple):
    """Distorted normalised coordinates and their derivatives by the ideal ones, each (n,)."""

    x: Column
    y: Column
    dx_dx: Column
    dx_dy: Column
    dy_dx: Column
    dy_dy: Column


@dataclass(frozen=True, slots=True)
class Lens:
    """A lens model with its numbers.

    Attributes:
        model: `pinhole` or `equidistant`.
        coefficients: Filled with zeros to k1 k2 p1 p2 k3 k4 k5 k6 (`pinhole`), k1 k2 k3 k4
            (`equidistant`): Python floats, which leave single-precision columns single.
        is_distorted: Whether it differs from the ideal pinhole.
        max_radius: Largest ideal normalised radius at which the distortion is still invertible
            (at most 10; infinite without distortion). Beyond it the polynomial folds back and
            would put far points into the image.

    """

    model: Model
    coefficients: Coefficients
    is_distorted: bool = field(init=False)
    max_radius: float = field(init=False)

    def __post_init__(self) -> None:
        """Find where the model ends."""
        is_distorted = self.model == 'equidistant' or any(self.coefficients)
        object.__setattr__(self, 'is_distorted', is_distorted)
        object.__setattr__(self, 'max_radius', _fold_radius(self))


def distort(lens: Lens, x: Column, y: Column) -> tuple[Column, Column]:
    """Apply the lens model to ideal normalised coordinates of any one shape."""
    if not lens.is_distorted:
        return x, y
    if lens.model == 'equidistant':
        r = np.hypot(x, y)
        theta = np.arctan(r)
        scale = _equidistant_angle(lens.coefficients, theta) / np.where(r > 1e-9, r, 1.0)
        scale = np.where(r > 1e-9, scale, 1.0)
        return x * scale, y * scale
    p1, p2 = lens.coefficients[2:4]
    r2 = x * x + y * y
    radial = _radial(lens.coefficients, r2)
    xy2 = 2.0 * x * y
    return (
        x * radial + p1 * xy2 + p2 * (r2 + 2.0 * x * x),
        y * radial + p1 * (r2 + 2.0 * y * y) + p2 * xy2,
    )


def distort_with_derivatives(lens: Lens, x: Column, y: Column) -> Distorted:
    """Apply the lens model and differentiate it; x, y (n,) ideal normalised coordinates."""
    if not lens.is_distorted:
        one, zero = np.ones_like(x), np.zeros_like(x)
        return Distorted(x, y, one, zero, zero, one)
    if lens.model == 'equidistant':
        return _equidistant_with_derivatives(lens.coefficients, x, y)
    p1, p2 = lens.coefficients[2:4]
    xx, yy, xy2 = x * x, y * y, 2.0 * x * y
    r2 = xx + yy
    radial = _radial(lens.coefficients, r2)
    slope2 = 2.0 * _radial_slope(lens.coefficients, r2)
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


def _radial(d: Coefficients, r2: Column) -> Column:
    """Radial factor of plumb_bob or, where the last three are not zero, rational_polynomial."""
    factor: Column = 1.0 + r2 * (d[0] + r2 * (d[1] + r2 * d[4]))
    if any(d[5:]):
        factor = factor / (1.0 + r2 * (d[5] + r2 * (d[6] + r2 * d[7])))
    return factor


def _radial_slope(d: Coefficients, r2: Column) -> Column:
    """Derivative of the radial factor by the squared radius."""
    slope: Column = d[0] + r2 * (2.0 * d[1] + 3.0 * d[4] * r2)
    if any(d[5:]):
        below = 1.0 + r2 * (d[5] + r2 * (d[6] + r2 * d[7]))
        slope_below = d[5] + r2 * (2.0 * d[6] + 3.0 * d[7] * r2)
        slope = (slope - _radial(d, r2) * slope_below) / below
    return slope


def _equidistant_angle(d: Coefficients, theta: Column) -> Column:
    """Distorted angle of OpenCV's fisheye model."""
    t2 = theta * theta
    angle: Column = theta * (1.0 + t2 * (d[0] + t2 * (d[1] + t2 * (d[2] + t2 * d[3]))))
    return angle


def _equidistant_slope(d: Coefficients, theta: Column) -> Column:
    """Derivative of the distorted angle by the angle."""
    t2 = theta * theta
    slope: Column = 1.0 + t2 * (3 * d[0] + t2 * (5 * d[1] + t2 * (7 * d[2] + t2 * 9 * d[3])))
    return slope


def _equidistant_with_derivatives(d: Coefficients, x: Column, y: Column) -> Distorted:
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


def undistort(lens: Lens, seen: Array) -> Array:
    """Invert `distort` by Newton's method: (n, 2) to (n, 2), NaN where it does not converge."""
    if not lens.is_distorted:
        return seen.copy()
    if lens.model == 'equidistant':
        return _undistort_equidistant(lens.coefficients, seen)
    ideal = seen.copy()
    with np.errstate(all='ignore'):  # points outside the lens model run away; they end as NaN
        for _ in range(UNDISTORT_STEPS):
            at = distort_with_derivatives(lens, ideal[:, 0], ideal[:, 1])
            ex, ey = seen[:, 0] - at.x, seen[:, 1] - at.y
            det = at.dx_dx * at.dy_dy - at.dx_dy * at.dy_dx
            if not np.nanmax(np.abs(ex) + np.abs(ey), initial=0.0) > UNDISTORT_DONE:
                break
            ideal[:, 0] += (at.dy_dy * ex - at.dx_dy * ey) / det
            ideal[:, 1] += (at.dx_dx * ey - at.dy_dx * ex) / det
        x, y = distort(lens, ideal[:, 0], ideal[:, 1])
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
    return np.where(good[:, None], seen, np.nan) * scale[:, None]


def _fold_radius(lens: Lens) -> float:
    """Return the ideal radius up to which the distorted radius grows."""
    if not lens.is_distorted:
        return np.inf
    r = np.linspace(0.0, FOLD_SEARCH_RADIUS, 20001)
    if lens.model == 'equidistant':
        distorted = _equidistant_angle(lens.coefficients, np.arctan(r))
    else:
        with np.errstate(divide='ignore', invalid='ignore'):
            distorted = r * _radial(lens.coefficients, r * r)
    folds = np.flatnonzero(~(np.diff(distorted) > 0.0))
    return float(r[folds[0]]) if folds.size else FOLD_SEARCH_RADIUS
