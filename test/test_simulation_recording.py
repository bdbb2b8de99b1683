# SPDX-License-Identifier: Apache-2.0
"""Recordings turn into observations as the session would pair them."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import errors, only, perfect, scene

from rpgd_ros.core import calibrate
from rpgd_ros.simulation import build_scene, preset, simulate, twin


@pytest.mark.parametrize(
    ('shape', 'cameras', 'joints'),
    [
        ('mpi_inf_3dhp', 14, 28),
        ('human36m', 4, 32),
        ('aistpp', 9, 17),
        ('kinect', 1, 20),
        ('studio', 4, 12),
    ],
)
def test_twin_has_the_shape_of_its_dataset(shape: str, cameras: int, joints: int) -> None:
    """Cameras, frames, joints; the studio's MoCap and detector share twelve joints."""
    case = twin(shape, 40, 0)
    assert len(case.cameras) == len(case.observations.views) == cameras
    for view in case.observations.views:
        assert view.uv.shape == (40, joints, 2)
        assert view.x_mocap.shape == (40, joints, 3)
        assert view.confidence is not None
        assert view.confidence.shape == (40, joints)
    assert case.truth.inlier.shape == (cameras, 40, joints)
    assert case.observations.joint_names is not None
    assert len(case.observations.joint_names) == joints


def test_synchronous_views_share_the_mocap_track() -> None:
    """One clock: the skeleton at the camera's stamps is the MoCap's own array."""
    observations = twin('human36m', 30, 0).observations
    assert observations.mocap is not None
    for view in observations.views:
        assert view.x_mocap is observations.mocap.x_mocap
        np.testing.assert_array_equal(view.stamp_ns, observations.mocap.stamp_ns)


def test_free_clocks_are_met_by_interpolation() -> None:
    """At 120 Hz the straight line between two skeletons is within a millimetre of the body."""
    recording = simulate(build_scene(preset('studio'), 3, seconds=5.0))
    observations = recording.observations()
    scene_ = build_scene(preset('studio'), 3, seconds=5.0)
    landmark = {'LAnkleJC': 'left_ankle', 'RWristJC': 'right_wrist'}
    names = list(observations.joint_names or ())
    for view in observations.views:
        assert view.stamp_ns is not None
        t = (view.stamp_ns - recording.mocap.stamp_ns[0]) / 1e9
        inside = np.isfinite(view.x_mocap).all((1, 2))
        assert inside.mean() > 0.97
        x_world = recording.truth.world_T_mocap @ view.x_mocap[inside]
        for joint, mark in landmark.items():
            x_body = scene_.body.at(t[inside]).place((mark,))[:, 0]
            gap = np.linalg.norm(x_world[:, names.index(joint)] - x_body, axis=-1)
            assert np.median(gap) < 0.003  # noise of 1 mm per axis, jitter of 0.2 ms


def test_frames_outside_the_mocap_track_have_no_skeleton() -> None:
    """Nothing is extrapolated."""
    recording = simulate(build_scene(preset('studio'), 3, seconds=2.0))
    last = recording.mocap.stamp_ns[-1]
    for view in recording.observations().views:
        assert view.stamp_ns is not None
        outside = (view.stamp_ns > last) | (view.stamp_ns < recording.mocap.stamp_ns[0])
        assert np.isnan(view.x_mocap[outside]).all()
        assert np.isfinite(view.x_mocap[~outside]).all()


@pytest.mark.parametrize('shape', ['human36m', 'studio'])
def test_solver_finds_the_truth_of_a_simulated_scene(shape: str) -> None:
    """The whole circle: scene, observations, solve."""
    case = scene(shape, 300, seed=1)
    found = calibrate(case.cameras, case.observations).world_T_mocap
    angle_deg, distance_m = errors(found, case.truth.world_T_mocap, case.observations)
    assert angle_deg < 0.1
    assert distance_m < 0.005


def test_perfect_scene_has_no_error() -> None:
    """Every reported keypoint lies where the truth projects its joint."""
    case = perfect('mpi_inf_3dhp', 20)
    for camera, view in zip(case.cameras, case.observations.views, strict=True):
        error = camera.project(case.truth.world_T_mocap @ view.x_mocap) - view.uv
        assert np.nanmax(np.abs(error)) < 1e-12


def test_scene_can_be_cut_down_to_some_cameras() -> None:
    """Cameras, views and truth stay together."""
    case = scene('human36m', 20)
    cut = only(case, 2, 0)
    assert [c.name for c in cut.cameras] == ['cam2', 'cam0']
    assert cut.observations.views[0] is case.observations.views[2]
    np.testing.assert_array_equal(cut.truth.inlier[1], case.truth.inlier[0])
