# SPDX-License-Identifier: Apache-2.0
"""The noise of the 3D joints is estimated, and no longer biases the pose."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
import scenes

from rpgd_ros.core import CalibrationConfig, calibrate
from rpgd_ros.core import normal as module
from rpgd_ros.core.config import RefineConfig
from rpgd_ros.core.geometry import Array
from rpgd_ros.core.linearise import Sight, linearise
from rpgd_ros.core.noise import NoiseModel
from rpgd_ros.core.noise_fit import noise_at
from rpgd_ros.core.normal import apply_delta, normal_equations
from rpgd_ros.simulation import Twin

WEIGHED = CalibrationConfig(refine=RefineConfig(joint_noise=True))


def sights_of(case: Twin) -> list[Sight]:
    """Return cameras with their views."""
    return [Sight(c, v) for c, v in zip(case.cameras, case.observations.views, strict=True)]


def test_the_gradient_knows_that_the_weights_move_with_the_pose(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It is that term which takes the bias out."""
    monkeypatch.setattr(module, 'linearise', partial(linearise, dtype=np.float64))
    case = scenes.scene('kinect', frames=30, seed=1)
    sights, pose = sights_of(case), case.truth.world_T_mocap
    pivot = pose @ np.nanmean(case.observations.views[0].x_mocap, axis=(0, 1))
    loss = NoiseModel(sigma_px=3.0, nu=8.0, share=0.9, background=1e-6, joint_sigma_m=0.02)
    gradient = normal_equations(sights, pose, pivot, loss).gradient

    def cost(step: Array) -> float:
        return normal_equations(sights, apply_delta(pose, step, pivot), pivot, loss).cost

    for k in range(6):
        step = np.zeros(6)
        step[k] = 1e-5
        numeric = (cost(step) - cost(-step)) / 2e-5
        assert numeric == pytest.approx(gradient[k], rel=1e-5, abs=1e-6 * abs(gradient).max())


def test_both_noises_of_a_kinect_are_told_apart() -> None:
    """The twin has 15 mm per axis in 3D and 3 px in the picture."""
    case = scenes.scene('kinect', frames=1500, seed=2)
    noise = noise_at(sights_of(case), case.truth.world_T_mocap, with_joints=True)
    assert noise.joint_sigma_m == pytest.approx(0.015, rel=0.25)
    assert noise.sigma_px == pytest.approx(3.0, rel=0.5)


def test_exact_joints_are_not_called_noisy() -> None:
    """Where the spread does not grow with nearness, nothing is estimated."""
    case = scenes.scene('human36m', frames=600, seed=2)
    noise = noise_at(sights_of(case), case.truth.world_T_mocap, with_joints=True)
    assert noise.joint_sigma_m == 0.0


def test_gross_keypoints_make_no_exact_joint_noisy() -> None:
    """A person who stays in place before one camera gives the two noises little to differ by."""
    for seed in range(3):
        case = scenes.scene(
            'human36m', frames=900, seed=seed, outlier_ratio=0.3, motion='turn_in_place'
        )
        for sight in sights_of(case):
            noise = noise_at([sight], case.truth.world_T_mocap, with_joints=True)
            assert noise.joint_sigma_m == 0.0


def test_a_noisy_skeleton_no_longer_biases_the_pose() -> None:
    """Least squares stays millimetres off however long the recording is."""
    plain: list[float] = []
    weighed: list[float] = []
    for seed in range(4):
        case = scenes.scene('kinect', frames=1500, seed=seed)
        truth = case.truth.world_T_mocap
        for errors, config in ((plain, CalibrationConfig()), (weighed, WEIGHED)):
            found = calibrate(case.cameras, case.observations, config=config)
            errors.append(scenes.errors(found.world_T_mocap, truth, case.observations)[1])
    assert np.mean(weighed) < 0.4 * np.mean(plain)


def test_the_clock_of_a_noisy_skeleton_is_not_pulled_to_half_a_frame() -> None:
    """Interpolated noise is smaller there, and an offset of 17 ms would seem to fit better."""
    for seed in range(3):
        case = scenes.scene('kinect', frames=900, seed=seed)
        found = calibrate(case.cameras, case.observations, config=CalibrationConfig.thorough())
        for offset, sigma in found.time_offset_s.values():
            assert abs(offset) < max(0.001, 4.0 * sigma)
