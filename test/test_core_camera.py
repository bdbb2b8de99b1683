# SPDX-License-Identifier: Apache-2.0
"""Cameras project as OpenCV's do, and say NaN where they see nothing."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from core_cases import LENSES, MATRIX, camera_with
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from rpgd_ros.core import Camera, RigidTransform
from rpgd_ros.core.geometry import Array, so3_exp

# The radius grows up to 1 / sqrt(0.9) only.
FOLDING = np.array([-0.3, 0.0, 0.0, 0.0])


def points_in_view(camera: Camera, n: int = 500) -> Array:
    """Draw points (n, 3) of the camera frame, metres, 0.5 to 20 m before the camera."""
    rng = np.random.default_rng(2)
    radius = 0.97 * min(camera.lens.max_radius, 1.5) * np.sqrt(rng.uniform(0.0, 1.0, n))
    angle, depth = rng.uniform(0.0, 2.0 * np.pi, n), rng.uniform(0.5, 20.0, n)
    ones = np.ones(n)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), ones], 1) * depth[:, None]


@pytest.mark.parametrize('lens', LENSES)
def test_projection_is_that_of_opencv(lens: str) -> None:
    """Every model agrees with cv2 to a billionth of a pixel, extrinsics included."""
    turn, shift = np.array([0.4, -1.1, 0.3]), np.array([0.5, -0.2, 3.0])
    camera = camera_with(lens, RigidTransform(so3_exp(turn), shift))
    x_world = RigidTransform(so3_exp(turn), shift).inverse() @ points_in_view(camera)
    if camera.model == 'equidistant':
        coefficients = camera.distortion if camera.distortion.size else np.zeros(4)
        uv, _ = cv2.fisheye.projectPoints(x_world[:, None], turn, shift, MATRIX, coefficients)
    else:
        uv, _ = cv2.projectPoints(x_world[:, None], turn, shift, MATRIX, camera.distortion)
    np.testing.assert_allclose(camera.project(x_world), uv[:, 0], rtol=0.0, atol=1e-9)


@pytest.mark.parametrize('lens', LENSES)
def test_normalise_undoes_projection(lens: str) -> None:
    """From pixels back to x / z and y / z."""
    camera = camera_with(lens)
    x = points_in_view(camera)
    ideal = camera.normalise(camera.project_camera(x))
    np.testing.assert_allclose(ideal, x[:, :2] / x[:, 2:], atol=1e-9)


@pytest.mark.parametrize('lens', LENSES)
def test_points_behind_a_camera_are_not_seen(lens: str) -> None:
    """Behind the camera, in its plane, and at its centre there is no pixel."""
    x = np.array([[0.1, 0.2, -3.0], [0.1, 0.2, 0.0], [0.0, 0.0, 0.0], [0.1, 0.2, 3.0]])
    uv = camera_with(lens).project_camera(x)
    np.testing.assert_array_equal(np.isnan(uv).all(1), [True, True, True, False])


def test_points_beyond_the_fold_do_not_come_back_into_the_image() -> None:
    """OpenCV's polynomial puts a point 56 deg off the axis into the image; it is not there."""
    camera = Camera('c', MATRIX, FOLDING, (1920, 1080))
    x = np.array([[1.5, 0.0, 1.0]])
    uv, _ = cv2.projectPoints(x, np.zeros(3), np.zeros(3), MATRIX, FOLDING)
    assert 0.0 < uv[0, 0, 0] < camera.size[0]
    assert np.isnan(camera.project_camera(x)).all()


def test_pixels_beyond_the_lens_have_no_direction() -> None:
    """The radius r - 0.3 r^3 ends at 0.70: pixels farther out come from nowhere."""
    camera = Camera('c', MATRIX, FOLDING, (1920, 1080))
    uv = np.array([[951.0 + 0.69 * 1145.0, 541.0], [951.0 + 0.72 * 1145.0, 541.0]])
    np.testing.assert_array_equal(np.isnan(camera.normalise(uv)).any(1), [False, True])


@pytest.mark.parametrize('lens', [name for name in LENSES if name != 'none'])
@pytest.mark.parametrize('uv', [[1e6, 1e6], [np.nan, 0.0], [np.inf, 0.0], [1e300, -1e300]])
def test_pixels_that_no_lens_can_show_have_no_direction(lens: str, uv: list[float]) -> None:
    """Far outside the image, or no number at all: NaN, without a warning."""
    with np.errstate(all='raise'):
        assert np.isnan(camera_with(lens).normalise(np.array([uv]))).all()


@pytest.mark.parametrize('lens', LENSES)
@settings(max_examples=100)
@given(x=hnp.arrays(np.float64, (3, 3), elements=st.floats(allow_nan=True, allow_infinity=True)))
def test_any_number_at_all_can_be_projected(lens: str, x: Array) -> None:
    """Damaged coordinates give pixels or NaN, never a warning."""
    with np.errstate(divide='raise', over='raise', invalid='raise'):
        uv = camera_with(lens).project_camera(x)
    assert not np.isinf(uv).any()
    np.testing.assert_array_equal(np.isnan(uv[:, 0]), np.isnan(uv[:, 1]))


def test_projection_keeps_the_axes_of_its_input() -> None:
    """(frame, joint, coordinate) in, (frame, joint, pixel) out."""
    assert camera_with('five').project_camera(np.ones((4, 7, 3))).shape == (4, 7, 2)


@pytest.mark.parametrize(
    ('change', 'words'),
    [
        ({'matrix': np.full((3, 3), np.nan)}, r'finite \(3, 3\) intrinsic matrix'),
        ({'matrix': np.eye(4)}, r'got shape \(4, 4\)'),
        ({'matrix': np.zeros((3, 3))}, 'focal lengths must be positive: is the camera calibrated'),
        ({'matrix': MATRIX * [[-1], [1], [1]]}, 'focal lengths must be positive'),
        ({'matrix': MATRIX + np.diag([1.0, 0.0], 1)}, 'no skew'),
        ({'matrix': 2.0 * MATRIX}, r'must be \[fx 0 cx; 0 fy cy; 0 0 1\]'),
        ({'matrix': MATRIX.T}, r'must be \[fx 0 cx; 0 fy cy; 0 0 1\]'),
        ({'distortion': np.zeros(3)}, 'takes 0 or 4 or 5 or 8 finite .*, got 3'),
        ({'distortion': np.array([np.inf, 0, 0, 0])}, 'finite'),
        ({'distortion': np.zeros(5), 'model': 'equidistant'}, 'takes 0 or 4 finite .*, got 5'),
        ({'distortion': np.array([1e7, 0, 0, 0])}, 'a distortion of 1e.07 is of no lens'),
        ({'matrix': np.diag([1e200, 1e200, 1.0])}, 'is of no camera'),
        ({'matrix': np.diag([1e-9, 900.0, 1.0])}, 'is of no camera'),
        ({'model': 'omni'}, "unknown model 'omni'; known: pinhole, equidistant"),
        ({'size': (0, 1080)}, 'image size must be positive'),
    ],
)
def test_bad_intrinsics_are_refused_with_words(change: dict[str, Any], words: str) -> None:
    """Each message names the camera and what is wrong with it."""
    good: dict[str, Any] = {'matrix': MATRIX, 'distortion': np.zeros(4), 'size': (1920, 1080)}
    with pytest.raises(ValueError, match=f'camera hall: .*{words}'):
        Camera(name='hall', **(good | change))


def test_a_camera_cannot_be_changed_from_outside() -> None:
    """It copies its arrays, and they cannot be written."""
    matrix = MATRIX.copy()
    camera = Camera('c', matrix, np.zeros(4), (1920, 1080))
    matrix[0, 0] = 1.0
    assert camera.matrix[0, 0] == MATRIX[0, 0]
    with pytest.raises(ValueError, match='read-only'):
        camera.matrix[0, 0] = 1.0
    assert camera.focal_px == pytest.approx(np.sqrt(1145.0 * 1138.0))
