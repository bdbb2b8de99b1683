# SPDX-License-Identifier: Apache-2.0
"""Rigs: cameras look where they should, and their frames are optical ones."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rpgd_ros.core.errors import InputError
from rpgd_ros.simulation import PRESETS, preset
from rpgd_ros.simulation.rigs import build_rig, look_at, ring

coordinate = st.floats(-5.0, 5.0)


@settings(max_examples=50, derandomize=True, deadline=None)
@given(st.tuples(coordinate, coordinate, st.floats(0.2, 4.0)))
def test_camera_looks_at_its_target_with_the_horizon_level(
    position: tuple[float, float, float],
) -> None:
    """The target lies on the optical axis; what is above it lies above it in the image."""
    target = np.array([0.3, -0.2, 5.0])
    camera_T_world = look_at(position, target)
    distance = float(np.linalg.norm(target - position))
    np.testing.assert_allclose(camera_T_world @ target, [0.0, 0.0, distance], atol=1e-9)
    above = camera_T_world @ (target + np.array([0.0, 0.0, 0.1]))
    assert abs(above[0]) < 1e-9
    assert above[1] < 0.0
    np.testing.assert_allclose(camera_T_world @ np.array(position), np.zeros(3), atol=1e-9)


def test_camera_that_looks_straight_down_has_a_pose() -> None:
    """Without a horizon the image's top points along world y."""
    camera_T_world = look_at([0.0, 0.0, 3.0], [0.0, 0.0, 0.0])
    np.testing.assert_allclose(camera_T_world @ np.array([0.0, 0.5, 0.0]), [0.0, -0.5, 3.0])


def test_camera_in_its_target_is_refused() -> None:
    """There is no direction to look in."""
    with pytest.raises(ValueError, match='cannot look at itself'):
        look_at([1.0, 0.0, 1.0], [1.0, 0.0, 1.0])


def test_ring_is_evenly_spread() -> None:
    """Positions share radius and height."""
    places = np.array(ring(5, radius=2.0, height=1.5))
    np.testing.assert_allclose(np.hypot(places[:, 0], places[:, 1]), 2.0)
    assert (places[:, 2] == 1.5).all()
    np.testing.assert_allclose(places[:, :2].mean(0), 0.0, atol=1e-12)


@pytest.mark.parametrize(
    ('name', 'count', 'size', 'n_coefficients'),
    [
        ('studio', 4, (1920, 1080), 5),
        ('mpi_inf_3dhp', 14, (2048, 2048), 0),
        ('human36m', 4, (1000, 1000), 5),
        ('aistpp', 9, (1920, 1080), 5),
        ('kinect', 1, (1920, 1080), 5),
    ],
)
def test_rig_has_the_cameras_of_its_dataset(
    name: str, count: int, size: tuple[int, int], n_coefficients: int
) -> None:
    """Number, image size and distortion as published."""
    cameras = build_rig(preset(name).rig, np.random.default_rng(0))
    assert [c.name for c in cameras] == [f'cam{n}' for n in range(count)]
    assert {c.size for c in cameras} == {size}
    assert {len(c.distortion) for c in cameras} == {n_coefficients}
    assert all(c.camera_T_world is not None for c in cameras)


@pytest.mark.parametrize('name', PRESETS)
def test_lens_model_holds_over_the_whole_image(name: str) -> None:
    """Every pixel of the image can be undistorted: no lens folds back inside it."""
    for seed in range(5):
        for camera in build_rig(preset(name).rig, np.random.default_rng(seed)):
            width, height = camera.size
            u, v = np.meshgrid(np.linspace(0, width - 1, 30), np.linspace(0, height - 1, 30))
            pixels = np.stack([u.ravel(), v.ravel()], -1)
            assert np.isfinite(camera.normalise(pixels)).all()


def test_unknown_preset_is_refused() -> None:
    """The message lists the presets."""
    with pytest.raises(InputError, match=r"unknown preset 'studios'; known: studio, mpi"):
        preset('studios')
