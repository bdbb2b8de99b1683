# SPDX-License-Identifier: Apache-2.0
"""A running solve can be watched, stopped, and limited in time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import scene

from rpgd_ros.core import (
    Calibration,
    CalibrationConfig,
    CalibrationError,
    Reason,
    RigidTransform,
    calibrate,
)
from rpgd_ros.core.config import RefineConfig, RigConfig
from rpgd_ros.core.geometry import so3_exp
from rpgd_ros.simulation import Twin


class Stopwatch:
    """A clock that ticks whenever it is read."""

    def __init__(self, step: float) -> None:
        """Advance by `step` seconds per look."""
        self.now, self.step = 0.0, step

    def __call__(self) -> float:
        """Return the time, seconds."""
        self.now += self.step
        return self.now


CONFIGS = [
    CalibrationConfig(),
    CalibrationConfig.paper(),
    CalibrationConfig(refine=RefineConfig(method='adam')),
]


def case_to_stop() -> Twin:
    """Return a recording on which every method succeeds."""
    return scene('human36m', 60, 4)


def bumped_case() -> Twin:
    """Return a recording of a rig of which one camera was moved."""
    case = scene('human36m', 300, 1)
    pose = case.cameras[2].camera_T_world
    assert pose is not None
    bumped = RigidTransform(so3_exp([0.05, 0.0, 0.0]), np.array([0.0, 0.1, 0.0])) @ pose
    cameras = list(case.cameras)
    cameras[2] = replace(cameras[2], camera_T_world=bumped)
    return case._replace(cameras=tuple(cameras))


@pytest.mark.parametrize('config', CONFIGS, ids=['default', 'paper', 'adam'])
@pytest.mark.parametrize('after', [0, 1, 3])
def test_a_run_can_be_cancelled_at_each_step(config: CalibrationConfig, after: int) -> None:
    """Once asked to stop it ends at once: no further step is begun."""
    case, asked = case_to_stop(), 0

    def should_stop() -> bool:
        nonlocal asked
        asked += 1
        return asked > after

    with pytest.raises(CalibrationError, match='cancelled during ') as refused:
        calibrate(case.cameras, case.observations, config=config, should_stop=should_stop)
    assert refused.value.reason is Reason.CANCELLED
    assert asked == after + 1


@pytest.mark.parametrize('config', CONFIGS, ids=['default', 'paper', 'adam'])
def test_the_time_limit_is_kept(config: CalibrationConfig) -> None:
    """By the clock that was passed in, at the next step after the limit."""
    case, clock = case_to_stop(), Stopwatch(1.0)
    with pytest.raises(CalibrationError, match='the time limit of 2 s ended the run') as refused:
        calibrate(
            case.cameras, case.observations, config=replace(config, max_seconds=2.0), clock=clock
        )
    assert refused.value.reason is Reason.CANCELLED
    assert clock.now <= 5.0


def test_no_time_limit_means_none() -> None:
    """Zero seconds is no limit."""
    case = scene('human36m', 60, 2)
    found = calibrate(case.cameras, case.observations, clock=Stopwatch(1000.0))
    assert found.seconds >= 1000.0


@pytest.mark.parametrize('config', CONFIGS, ids=['default', 'paper', 'adam'])
def test_progress_only_grows(config: CalibrationConfig) -> None:
    """Stage by stage, each from 0 to 1."""
    case = case_to_stop()
    check_progress(case, config)


def test_progress_does_not_fall_back_when_a_camera_is_left_out() -> None:
    """The second solve, without the camera that was moved, goes on where the first ended."""
    config = CalibrationConfig(rig=RigConfig(on_bumped_camera='exclude'))
    found = check_progress(bumped_case(), config)
    assert 'not used' in ' '.join(found.warnings)


def check_progress(case: Twin, config: CalibrationConfig) -> Calibration:
    """Calibrate, and watch what is told meanwhile."""
    told: list[tuple[str, float]] = []
    found = calibrate(
        case.cameras, case.observations, config=config,
        progress=lambda stage, fraction: told.append((stage, fraction)),
    )  # fmt: skip
    stages = list(dict.fromkeys(stage for stage, _ in told))
    assert stages[:2] == ['start', 'refinement']
    for stage in stages:
        fractions = [fraction for name, fraction in told if name == stage]
        assert fractions == sorted(fractions)
        assert fractions[0] >= 0.0
        assert fractions[-1] <= 1.0
    return found


def test_placing_a_moved_camera_again_can_be_cancelled() -> None:
    """The solve of the camera alone is a part of the run, and its end is the run's."""
    case = bumped_case()
    asked, n_asked = 0, {'exclude': 0, 're-estimate': 0}
    for choice in ('exclude', 're-estimate'):
        asked = 0

        def count() -> bool:
            nonlocal asked
            asked += 1
            return False

        config = CalibrationConfig(rig=RigConfig(on_bumped_camera=choice))
        calibrate(case.cameras, case.observations, config=config, should_stop=count)
        n_asked[choice] = asked
    assert n_asked['re-estimate'] > n_asked['exclude'] + 2
    asked = 0

    def should_stop() -> bool:
        nonlocal asked
        asked += 1
        return asked > n_asked['exclude'] + 1

    with pytest.raises(CalibrationError) as refused:
        calibrate(case.cameras, case.observations, config=config, should_stop=should_stop)
    assert refused.value.reason is Reason.CANCELLED


def test_result_names_the_seed_that_was_used() -> None:
    """Whether it came with the settings or beside them."""
    case = scene('human36m', 60, 2)
    found = calibrate(case.cameras, case.observations, seed=7)
    assert found.config.ransac.seed == 7
    again = calibrate(case.cameras, case.observations, config=found.config)
    np.testing.assert_array_equal(again.world_T_mocap.matrix, found.world_T_mocap.matrix)
