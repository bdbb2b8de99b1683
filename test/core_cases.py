# SPDX-License-Identifier: Apache-2.0
"""Lenses, cameras and small scenes that the tests of the solver share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rpgd_ros.core import Camera, RigidTransform, View
from rpgd_ros.core.geometry import Array, so3_exp
from rpgd_ros.core.lens import Model
from rpgd_ros.core.linearise import Sight
from rpgd_ros.simulation import Twin

# Name: model and coefficients as calibrations of real lenses gave them.
LENSES: dict[str, tuple[Model, list[float]]] = {
    'none': ('pinhole', []),
    'four': ('pinhole', [-0.28, 0.07, 0.0004, -0.0007]),  # an action camera
    'five': ('pinhole', [-0.20, 0.24, -0.0017, -0.0009, -0.0027]),  # Human3.6M
    'eight': (
        'pinhole',
        [0.52, -2.61, 0.0004, -0.0002, 1.52, 0.40, -2.42, 1.44],
    ),  # a depth sensor
    'fisheye': ('equidistant', [-0.011, 0.035, -0.032, 0.007]),
    'ideal_fisheye': ('equidistant', []),
}
MATRIX = np.array([[1145.0, 0.0, 951.0], [0.0, 1138.0, 541.0], [0.0, 0.0, 1.0]])


def camera_with(lens: str, camera_T_world: RigidTransform | None = None) -> Camera:
    """Return an HD camera with one of the `LENSES`."""
    model, coefficients = LENSES[lens]
    return Camera(lens, MATRIX, np.array(coefficients), (1920, 1080), camera_T_world, model)


def sights_of(case: Twin) -> list[Sight]:
    """Pair the cameras of a scene with what they saw."""
    pairs = zip(case.cameras, case.observations.views, strict=True)
    return [Sight(camera, view) for camera, view in pairs]


def make_sight(
    camera: Camera, world_T_mocap: RigidTransform, x_mocap: Array, noise_px: Array | float = 0.0
) -> Sight:
    """Let a camera see points (F, J, 3), metres, MoCap frame, with some noise."""
    uv = camera.project(world_T_mocap @ x_mocap) + noise_px
    return Sight(camera, View(None, x_mocap, uv))


def small_rig(lenses: Sequence[str] = ('five', 'eight', 'fisheye')) -> list[Camera]:
    """Return cameras in a circle of 4 m, each turned a little at random, looking inwards."""
    rng = np.random.default_rng(3)
    cameras = []
    for k, lens in enumerate(lenses):
        yaw = so3_exp([0.0, 2.0 * np.pi * k / len(lenses), 0.0])
        turn = so3_exp(rng.normal(0.0, 0.05, 3)) @ yaw
        cameras.append(camera_with(lens, RigidTransform(turn, np.array([0.1, -0.2, 4.0]))))
    return cameras


def small_problem(seed: int = 0, noise_px: float = 0.0) -> tuple[list[Sight], RigidTransform]:
    """Return three cameras of different models that saw 20 x 8 points, and the true pose."""
    rng = np.random.default_rng(seed)
    truth = RigidTransform(so3_exp(rng.normal(0.0, 1.0, 3)), rng.normal(0.0, 2.0, 3))
    x_mocap = truth.inverse() @ rng.uniform(-0.7, 0.7, (20, 8, 3))
    sights = [
        make_sight(camera, truth, x_mocap, noise_px * rng.standard_normal((20, 8, 2)))
        for camera in small_rig()
    ]
    return sights, truth
