# SPDX-License-Identifier: Apache-2.0
"""Lenses, cameras and small scenes that the tests of the solver share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rpgd_ros.core import Camera, Observations, RigidTransform, View
from rpgd_ros.core.geometry import Array, so3_exp
from rpgd_ros.core.lens import Model
from rpgd_ros.core.linearise import Sight
from rpgd_ros.simulation import (
    Corruption,
    Faults,
    Twin,
    build_scene,
    preset,
    simulate,
    twin,
)
from rpgd_ros.simulation.motion import MotionName

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


def far_away(
    seed: int, distance_m: float, *, motion: MotionName, bias_px: float, seconds: float = 5.0
) -> Twin:
    """Return what one camera saw of a person at a distance, the skeleton without noise."""
    settings = replace(preset('kinect'), joint_noise_m=0.0)
    faults = Faults(Corruption(bias_px=bias_px))
    place = (0.0, distance_m + settings.rig.mounts[0][1])
    recording = simulate(
        build_scene(settings, seed, seconds=seconds, motion=motion, centre=place, faults=faults)
    )
    return Twin(recording.cameras, recording.observations(), recording.truth)


def flattened(shape: str, seed: int, *, onto: str, noise_px: float = 0.0) -> Twin:
    """Return a scene whose joints all lie on a plane, a line or a point of the room."""
    case = twin(shape, 60, seed)
    rng = np.random.default_rng(seed)
    truth = case.truth.world_T_mocap
    x_world = truth @ case.observations.views[0].x_mocap
    centre, axis = x_world.mean((0, 1)), so3_exp(rng.normal(0.0, 2.0, 3))[:, :1]
    along = {'plane': np.eye(3) - axis @ axis.T, 'line': axis @ axis.T, 'point': np.zeros((3, 3))}
    x_world = centre + (x_world - centre) @ along[onto]
    views = []
    for camera in case.cameras:
        uv = camera.project(x_world)
        uv[~((uv > 0.0) & (uv < camera.size)).all(-1)] = np.nan
        uv += noise_px * rng.standard_normal(uv.shape)
        views.append(View(None, truth.inverse() @ x_world, uv))
    return case._replace(observations=Observations(tuple(views)))


def flat_figure(seed: int, distance_m: float, tilt_deg: float, noise_px: float = 3.0) -> Twin:
    """Return what one camera saw of a flat figure that moves a metre sideways in its plane."""
    rng = np.random.default_rng(seed)
    figure = np.column_stack([rng.uniform(-0.25, 0.25, 17), rng.uniform(-0.85, 0.85, 17)])
    x = np.zeros((60, 17, 3))
    x[..., :2] = figure
    x[..., 0] += np.linspace(-0.5, 0.5, 60)[:, None]
    direction = rng.uniform(0.0, 2.0 * np.pi)
    tilt = np.radians(tilt_deg) * np.array([np.cos(direction), np.sin(direction), 0.0])
    mocap_T_figure = RigidTransform(so3_exp(rng.normal(0.0, 1.5, 3)), rng.normal(0.0, 3.0, 3))
    camera_T_figure = RigidTransform(so3_exp(tilt), np.array([0.0, 0.0, distance_m]))
    camera = camera_with('none')
    uv = camera.project(camera_T_figure @ x) + rng.normal(0.0, noise_px, (60, 17, 2))
    base = twin('kinect', 2, 0)
    truth = replace(base.truth, world_T_mocap=camera_T_figure @ mocap_T_figure.inverse())
    view = View(None, mocap_T_figure @ x, uv)
    return Twin((camera,), Observations((view,)), truth)
