# SPDX-License-Identifier: Apache-2.0
"""Offsets between the clocks of video and MoCap are found, or said to be unknown."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scenes

from rpgd_ros.core import CalibrationConfig, MocapTrack, Observations, calibrate
from rpgd_ros.core.config import TimeConfig
from rpgd_ros.core.timeline import Timeline

TIMED = CalibrationConfig(time=TimeConfig(estimate_offset='per_camera'))


def test_a_timeline_passes_through_its_samples_and_follows_a_parabola_between() -> None:
    """Free fall is what a limb does at its worst; a straight line would miss it by 3 mm."""
    t = np.arange(20) * 0.05
    x = np.stack([t, 0.5 * 9.81 * t**2, np.ones_like(t)], -1)[:, None]
    timeline = Timeline(MocapTrack(np.round(t * 1e9).astype(np.int64) + 10**18, x))
    at = np.array([0.1, 0.125, 0.431, 0.9])
    seen, velocity = timeline.at(at)
    assert np.allclose(seen[:, 0, 1], 0.5 * 9.81 * at**2, atol=1e-6)
    assert np.allclose(velocity[:, 0, 1], 9.81 * at, atol=1e-4)
    assert np.allclose(velocity[:, 0, 0], 1.0)


def test_a_timeline_invents_nothing_outside_its_track_or_across_a_gap() -> None:
    """There is no skeleton before the first sample, after the last, or while it was away."""
    stamp_ns = np.round(np.r_[0:10, 40:50] * 0.02 * 1e9).astype(np.int64)
    timeline = Timeline(MocapTrack(stamp_ns, np.zeros((20, 1, 3))))
    x, velocity = timeline.at(np.array([-0.01, 0.1, 0.5, 0.9, 1.2]))
    assert np.array_equal(np.isnan(x[:, 0, 0]), [True, False, True, False, True])
    assert np.isfinite(velocity).all()


@pytest.mark.fault(14)
@pytest.mark.parametrize('lag_ms', [0.0, 5.0, 20.0, 40.0])
def test_a_late_video_costs_nothing_once_its_offset_is_estimated(lag_ms: float) -> None:
    """Of the solvers in use none sees it, and the reprojection error hides it."""
    case = scenes.scene(frames=1500, seed=2, lag_s=1e-3 * lag_ms)
    found = calibrate(case.cameras, case.observations, config=TIMED)
    for offset, sigma in found.time_offset_s.values():
        assert abs(1e3 * offset - lag_ms) < 0.3
        assert sigma < 3e-4
    turned, moved = scenes.errors(found.world_T_mocap, case.truth.world_T_mocap, case.observations)
    assert turned < 0.01
    assert moved < 2e-4


@pytest.mark.fault(14)
def test_videos_that_were_never_synchronised_are_found_to_a_fraction_of_a_frame() -> None:
    """Each camera has its own second of delay, and a third of the keypoints is gross."""
    lags = (0.9, -1.2, 0.35, -0.6)
    case = scenes.scene(frames=1200, seed=4, lag_s=lags, outlier_ratio=0.3, kind='mixed')
    found = calibrate(case.cameras, case.observations, config=TIMED)
    for camera, lag in zip(case.cameras, lags, strict=True):
        assert found.time_offset_s[camera.name][0] == pytest.approx(lag, abs=0.002)


def test_one_common_offset_is_better_known_than_one_per_camera() -> None:
    """Four cameras of one recorder tell one delay."""
    case = scenes.scene(frames=600, seed=1, lag_s=0.03)
    common = replace(TIMED, time=TimeConfig(estimate_offset='common'))
    one = calibrate(case.cameras, case.observations, config=common).time_offset_s
    each = calibrate(case.cameras, case.observations, config=TIMED).time_offset_s
    assert len({offset for offset, _ in one.values()}) == 1
    for name, (offset, sigma) in one.items():
        assert offset == pytest.approx(0.03, abs=5e-4)
        assert sigma < each[name][1]


@pytest.mark.fault(14)
def test_one_common_offset_of_most_of_a_second_is_found() -> None:
    """Four cameras pull the same way, so that one number is exact to 2 ms."""
    case = scenes.scene(frames=400, seed=1, lag_s=0.8)
    common = replace(TIMED, time=TimeConfig(estimate_offset='common'))
    found = calibrate(case.cameras, case.observations, config=common).time_offset_s
    assert len({offset for offset, _ in found.values()}) == 1
    assert next(iter(found.values()))[0] == pytest.approx(0.8, abs=2e-3)


def test_what_is_not_known_of_the_clocks_is_not_known_of_the_pose() -> None:
    """The covariance grows by what the offsets leave open."""
    case = scenes.scene(frames=300, seed=3)
    plain = calibrate(case.cameras, case.observations)
    timed = calibrate(case.cameras, case.observations, config=TIMED)
    assert timed.sigma_rotation_deg > plain.sigma_rotation_deg
    assert timed.sigma_rotation_deg < 10.0 * plain.sigma_rotation_deg


def test_without_time_no_offset_is_guessed() -> None:
    """Frames are no clock."""
    case = scenes.scene(frames=200)
    views = tuple(replace(v, stamp_ns=None) for v in case.observations.views)
    found = calibrate(case.cameras, Observations(views), config=TIMED)
    assert found.time_offset_s == {}
    assert 'no time is known' in found.warnings[0]


def test_the_default_gives_the_same_bits_whether_time_is_known_or_not() -> None:
    """Nothing beyond the pose is estimated unless asked for."""
    case = scenes.scene(frames=200)
    timeless = replace(case.observations, mocap=None)
    a = calibrate(case.cameras, case.observations).world_T_mocap.matrix
    b = calibrate(case.cameras, timeless).world_T_mocap.matrix
    assert np.array_equal(a, b)
