# SPDX-License-Identifier: Apache-2.0
"""Every gate closes for its own reason, and the figures are those of the residuals."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from core_cases import small_problem
from scenes import mpjpe_px, scene

from rpgd_ros.core import (
    Calibration,
    CalibrationConfig,
    CalibrationError,
    Reason,
    View,
    calibrate,
)
from rpgd_ros.core.config import AcceptConfig, RefineConfig
from rpgd_ros.core.examine import QUANTILE_SAMPLE, examine
from rpgd_ros.core.linearise import Sight
from rpgd_ros.core.noise import SquaredLoss
from rpgd_ros.core.quality import refuse
from rpgd_ros.simulation import Twin

OPEN = AcceptConfig(min_inlier_ratio=0.0, max_sigma_deg=180.0, max_sigma_m=100.0)


@pytest.fixture(scope='module')
def case() -> Twin:
    """Return a clean recording."""
    return scene('human36m', 150, 1)


@pytest.fixture(scope='module')
def good(case: Twin) -> Calibration:
    """Return an accepted calibration."""
    return calibrate(case.cameras, case.observations)


@pytest.mark.parametrize(
    ('gate', 'reason', 'words'),
    [
        (
            {'min_motion_m': 50.0},
            Reason.DEGENERATE_MOTION,
            r'moved \d\.\d\d m, need 50.00 m. Walk',
        ),
        ({'min_inlier_ratio': 1.0}, Reason.TOO_FEW_INLIERS, r'%\) agree with .* need 100 %'),
        ({'min_pairs': 10**7}, Reason.TOO_FEW_INLIERS, 'need 10000000 keypoints. Record for long'),
        ({'min_frames': 10**6}, Reason.TOO_FEW_FRAMES, '150 frames .* need 1000000. Record for'),
        ({'max_sigma_deg': 1e-9}, Reason.UNCERTAIN, 'rotation is known to 0.01 deg only'),
        ({'max_sigma_m': 1e-9}, Reason.UNCERTAIN, 'position is known to 0 mm only, need 0 mm'),
    ],
)
def test_each_gate_refuses_by_its_name(
    case: Twin, gate: dict[str, Any], reason: Reason, words: str
) -> None:
    """What was found, what was needed, what to do; the refused pose travels along."""
    config = CalibrationConfig(accept=AcceptConfig(**gate))
    with pytest.raises(CalibrationError, match=words) as refused:
        calibrate(case.cameras, case.observations, config=config)
    assert refused.value.reason is reason
    assert refused.value.calibration is not None
    assert refused.value.calibration.inlier_ratio > 0.9


def test_open_gates_let_everything_through(good: Calibration) -> None:
    """A good calibration passes the gates as they come."""
    refuse(good, AcceptConfig(), 1.0)


def test_a_few_steps_are_enough_and_swaying_is_not(good: Calibration) -> None:
    """Who stands moves by less than 0.1 m; who takes a few steps in 5 s, by 0.25 m and more."""
    refuse(good, AcceptConfig(), 0.25)
    with pytest.raises(CalibrationError, match=r'moved 0\.10 m, need 0\.20 m'):
        refuse(good, AcceptConfig(), 0.1)


@pytest.mark.parametrize('value', [np.nan, -1.0])
def test_a_sigma_that_is_no_number_is_refused(good: Calibration, value: float) -> None:
    """Not knowing how uncertain a pose is counts as uncertain."""
    with pytest.raises(CalibrationError) as refused:
        refuse(replace(good, covariance=np.full((6, 6), value)), AcceptConfig(), 1.0)
    assert refused.value.reason is Reason.UNCERTAIN


def test_the_worse_of_both_sigmas_decides(good: Calibration) -> None:
    """Errors that last show in the spread over time only."""
    lasting = replace(good, covariance_over_time=1e4 * good.covariance)
    assert lasting.worst_sigma[0] == pytest.approx(100.0 * good.sigma_rotation_deg)
    assert lasting.worst_sigma[1] == pytest.approx(100.0 * good.sigma_position_m)


def test_the_mean_error_is_that_of_equation_seven(case: Twin, good: Calibration) -> None:
    """Over all correspondences before a camera, as an independent projection gives it."""
    by_hand = mpjpe_px(case.cameras, case.observations, good.world_T_mocap)
    assert good.mpjpe_px == pytest.approx(by_hand, rel=1e-4)
    assert good.correspondences == sum(int(v.seen().sum()) for v in case.observations.views)


def test_figures_per_camera_and_per_joint_are_those_of_their_residuals(
    case: Twin, good: Calibration
) -> None:
    """Means, counts and bias, each against a plain sum."""
    residuals = [
        camera.project(good.world_T_mocap @ view.x_mocap) - view.uv
        for camera, view in zip(case.cameras, case.observations.views, strict=True)
    ]
    everything = np.stack(residuals)
    names = case.observations.joint_names
    assert names is not None
    groups = [(good.per_camera[c.name], everything[v]) for v, c in enumerate(case.cameras)]
    groups += [(good.per_joint[name], everything[:, :, j]) for j, name in enumerate(names)]
    for fit, part in groups:
        r = part.reshape(-1, 2)[np.isfinite(part.reshape(-1, 2)).all(1)]
        length = np.linalg.norm(r, axis=1)
        near = length < good.threshold_px
        assert fit.correspondences == len(r)
        assert abs(fit.inliers - near.sum()) <= 1  # one may lie on the threshold
        assert fit.mpjpe_px == pytest.approx(length.mean(), rel=1e-3)
        assert fit.inlier_mpjpe_px == pytest.approx(length[near].mean(), rel=1e-2)
        assert fit.bias_px == pytest.approx(r[near].mean(0), abs=0.01)
    assert sum(fit.inliers for fit in good.per_camera.values()) == good.inliers


def test_quantiles_are_those_of_all_residuals(case: Twin, good: Calibration) -> None:
    """Median and 95th percentile."""
    r = [
        np.linalg.norm(c.project(good.world_T_mocap @ v.x_mocap) - v.uv, axis=-1)
        for c, v in zip(case.cameras, case.observations.views, strict=True)
    ]
    expected = np.nanquantile(np.stack(r), [0.5, 0.95])
    assert (good.median_px, good.p95_px) == pytest.approx(expected, rel=0.01)


def test_a_camera_that_saw_nothing_has_figures_that_say_so(case: Twin) -> None:
    """No keypoints: zero correspondences, NaN for the mean, and the others carry on."""
    views = list(case.observations.views)
    views[2] = replace(views[2], uv=np.full_like(views[2].uv, np.nan))
    found = calibrate(case.cameras, replace(case.observations, views=tuple(views)))
    blind = found.per_camera[case.cameras[2].name]
    assert (blind.correspondences, blind.inliers, blind.inlier_ratio) == (0, 0, 0.0)
    assert np.isnan([blind.mpjpe_px, blind.inlier_mpjpe_px, *blind.bias_px]).all()
    assert found.inlier_ratio > 0.9


def test_the_report_names_the_camera_that_agrees_least() -> None:
    """One camera shows somebody else all the time; the refusal points to it."""
    case = scene('human36m', 150, 1)
    views = list(case.observations.views)
    rng = np.random.default_rng(0)
    for k in (0, 1, 3):
        views[k] = replace(views[k], uv=rng.uniform(0.0, 1000.0, views[k].uv.shape))
    config = CalibrationConfig(accept=AcceptConfig(min_inlier_ratio=0.5))
    with pytest.raises(CalibrationError, match=r'least in camera cam[013]: 0\.\d %'):
        calibrate(case.cameras, replace(case.observations, views=tuple(views)), config=config)


def test_median_residual_is_that_of_all_joints() -> None:
    """However the number of joints divides that of the frames, of which not all are looked at."""
    sights, pose = small_problem(noise_px=1.0)
    view = sights[0].view
    often = (QUANTILE_SAMPLE // view.n_frames, 1, 1)  # every n_joints-th residual is looked at
    uv = np.tile(view.uv, often)
    uv[:, 0] += 100.0
    many = View(None, np.tile(view.x_mocap, often), uv)
    seen = examine(
        [Sight(sights[0].camera, many)], pose, np.zeros(3), SquaredLoss(), threshold_px=5.0
    )
    assert float(np.median(seen.tally.sample_px)) < 2.0
    assert float(np.quantile(seen.tally.sample_px, 0.95)) > 50.0


def test_refinement_that_ran_out_of_steps_is_said(good: Calibration) -> None:
    """The pose is usable where the gates say so, but it is not the optimum."""
    assert not good.warnings
    short = CalibrationConfig(refine=RefineConfig(loss='squared', iterations=1), accept=OPEN)
    far = scene('aistpp', 150, 1, outlier_ratio=0.5, kind='mixed')
    found = calibrate(far.cameras, far.observations, config=short)
    assert 'Raise `refine.iterations`' in ' '.join(found.warnings)
