# SPDX-License-Identifier: Apache-2.0
"""Lens models: their derivatives, their inverse, and where they end."""

from __future__ import annotations

import numpy as np
import pytest
from core_cases import LENSES
from hypothesis import given, settings
from hypothesis import strategies as st
from numeric import jacobian, relative_error

from rpgd_ros.core.geometry import Array
from rpgd_ros.core.lens import Lens, distort, distort_with_derivatives, undistort


def lens_named(name: str) -> Lens:
    """Return one of the shared lenses with its coefficients filled up."""
    model, coefficients = LENSES[name]
    length = 4 if model == 'equidistant' else 8
    return Lens(model, tuple(coefficients + [0.0] * (length - len(coefficients))))


def shown(lens: Lens, ideal: Array) -> Array:
    """Return the distorted coordinates (n, 2) of ideal ones."""
    x, y = distort(lens, ideal[:, 0], ideal[:, 1])
    return np.stack([x, y], 1).astype(np.float64)


def points_inside(lens: Lens, n: int = 400, *, reach: float = 0.97) -> Array:
    """Draw ideal coordinates (n, 2) over the part of the plane that the lens sees."""
    rng = np.random.default_rng(1)
    radius = reach * min(lens.max_radius, 1.5) * np.sqrt(rng.uniform(0.0, 1.0, n))
    angle = rng.uniform(0.0, 2.0 * np.pi, n)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], 1)


@pytest.mark.parametrize('name', LENSES)
def test_derivatives_are_those_of_the_model(name: str) -> None:
    """Every derivative by both coordinates agrees with a numeric one, all over the image."""
    lens = lens_named(name)
    for point in np.vstack([points_inside(lens, 60), [[0.0, 0.0], [1e-10, 0.0], [1e-5, -1e-5]]]):
        numeric = jacobian(lambda p: distort(lens, p[:1], p[1:]), point)[:, 0]
        out = distort_with_derivatives(lens, point[:1], point[1:])
        analytic = np.array([[out.dx_dx[0], out.dx_dy[0]], [out.dy_dx[0], out.dy_dy[0]]])
        assert relative_error(analytic, numeric) < 1e-8
        np.testing.assert_allclose((out.x, out.y), distort(lens, point[:1], point[1:]), atol=1e-15)


@pytest.mark.parametrize('name', LENSES)
def test_columns_stay_in_their_precision(name: str) -> None:
    """Single-precision columns come out single and within their rounding of the double ones."""
    lens = lens_named(name)
    x, y = points_inside(lens).T
    double = distort_with_derivatives(lens, x, y)
    single = distort_with_derivatives(lens, x.astype(np.float32), y.astype(np.float32))
    for a, b in zip(single, double, strict=True):
        assert a.dtype == np.float32
        np.testing.assert_allclose(a, b, rtol=1e-5, atol=2e-5)


@pytest.mark.parametrize('name', LENSES)
def test_undistort_undoes_distort(name: str) -> None:
    """What the lens shows is traced back to where it came from."""
    lens = lens_named(name)
    ideal = points_inside(lens)
    seen = shown(lens, ideal)
    np.testing.assert_allclose(undistort(lens, seen), ideal, atol=1e-9)


@settings(max_examples=100)
@given(
    k1=st.floats(-0.4, 0.3), k2=st.floats(-0.1, 0.3), k3=st.floats(-0.1, 0.1),
    p1=st.floats(-1e-3, 1e-3), p2=st.floats(-1e-3, 1e-3),
    radius=st.floats(0.0, 0.95), angle=st.floats(0.0, 6.3),
)  # fmt: skip
def test_any_plausible_lens_can_be_undone(
    k1: float, k2: float, k3: float, p1: float, p2: float, radius: float, angle: float
) -> None:
    """Wherever the model is invertible, the inverse finds the point, or says that it cannot."""
    lens = Lens('pinhole', (k1, k2, p1, p2, k3, 0.0, 0.0, 0.0))
    length = radius * min(lens.max_radius, 1.2)
    ideal = length * np.array([[np.cos(angle), np.sin(angle)]])
    seen = shown(lens, ideal)
    np.testing.assert_allclose(undistort(lens, seen), ideal, atol=1e-6)


def test_the_lens_ends_where_it_folds() -> None:
    """With k1 = -0.3 the distorted radius r - 0.3 r^3 turns back at r = 1 / sqrt(0.9)."""
    lens = Lens('pinhole', (-0.3, *[0.0] * 7))
    assert lens.max_radius == pytest.approx(1.0 / np.sqrt(0.9), abs=1e-3)
    assert Lens('pinhole', (0.0,) * 8).max_radius == np.inf
    assert Lens('pinhole', (0.1, *[0.0] * 7)).max_radius == pytest.approx(10.0)


def test_a_lens_with_a_pole_ends_before_it() -> None:
    """A rational model whose denominator has a root is of no use from there on."""
    lens = Lens('pinhole', (0.0, 0.0, 0.0, 0.0, 0.0, -0.25, 0.0, 0.0))  # pole at r = 2
    assert 1.9 < lens.max_radius <= 2.0


@pytest.mark.parametrize('name', LENSES)
def test_no_points_are_no_trouble(name: str) -> None:
    """Empty columns give empty columns."""
    assert undistort(lens_named(name), np.empty((0, 2))).shape == (0, 2)
