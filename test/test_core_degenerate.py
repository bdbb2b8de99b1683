# SPDX-License-Identifier: Apache-2.0
"""Motions and shapes that do not fix a pose, or fix two, are never accepted as one."""

from __future__ import annotations

import numpy as np
import pytest
from core_cases import far_away, flat_figure, flattened
from scenes import errors, mpjpe_px, scene

from rpgd_ros.core import Calibration, CalibrationConfig, CalibrationError, Reason, calibrate
from rpgd_ros.simulation import Twin
from rpgd_ros.simulation.motion import MotionName


def outcome(case: Twin, config: CalibrationConfig | None = None) -> Calibration | CalibrationError:
    """Return the calibration, or why it was refused; any other error fails the test."""
    try:
        return calibrate(case.cameras, case.observations, config=config)
    except CalibrationError as refused:
        return refused


def is_beyond_its_sigma(found: Calibration, case: Twin) -> bool:
    """Whether it is wrong by more than three times what it claims."""
    angle_deg, shift_m = errors(found.world_T_mocap, case.truth.world_T_mocap, case.observations)
    sigma_deg, sigma_m = found.worst_sigma
    return angle_deg > 3.0 * sigma_deg or shift_m > 3.0 * sigma_m


@pytest.mark.fault(26)
@pytest.mark.parametrize('motion', ['still', 'sway'])
@pytest.mark.parametrize(('distance_m', 'bias_px'), [(5.0, 0.0), (5.0, 3.0), (10.0, 3.0)])
def test_a_person_who_stands_is_refused_although_the_pixels_fit(
    motion: MotionName, distance_m: float, bias_px: float
) -> None:
    """The mean error is that of a walker; the pose is not."""
    for seed in range(5):
        case = far_away(seed, distance_m, motion=motion, bias_px=bias_px)
        found = outcome(case)
        assert isinstance(found, CalibrationError)
        assert found.reason is Reason.DEGENERATE_MOTION
        assert found.calibration is not None
        assert found.calibration.mpjpe_px < 7.0
        assert 'Walk through the room' in found.message


@pytest.mark.fault(26)
@pytest.mark.parametrize('motion', ['turn_in_place', 'walk'])
@pytest.mark.parametrize(('distance_m', 'bias_px'), [(5.0, 0.0), (5.0, 3.0), (10.0, 3.0)])
def test_one_far_camera_is_never_surer_than_right(
    motion: MotionName, distance_m: float, bias_px: float
) -> None:
    """Whatever it accepts is right within three sigma, with biased joints as well."""
    for seed in range(6):
        case = far_away(seed, distance_m, motion=motion, bias_px=bias_px)
        found = outcome(case)
        assert isinstance(found, CalibrationError) or not is_beyond_its_sigma(found, case)


@pytest.mark.fault(26)
@pytest.mark.parametrize('shape', ['studio', 'human36m'])
def test_a_minute_of_walking_through_the_room_is_enough(shape: str) -> None:
    """Four cameras, 4 x 4 m: within 0.25 deg and 20 mm at every point of the body."""
    for seed in range(2):
        case = scene(shape, 1800, seed)
        found = outcome(case)
        assert isinstance(found, Calibration)
        x = case.observations.views[0].x_mocap
        x = x[np.isfinite(x).all(-1)]
        apart = (found.world_T_mocap @ x) - (case.truth.world_T_mocap @ x)
        assert np.sqrt((apart**2).sum(-1).mean()) < 0.02
        assert errors(found.world_T_mocap, case.truth.world_T_mocap, case.observations)[0] < 0.25


@pytest.mark.fault(27)
@pytest.mark.parametrize('onto', ['line', 'point'])
@pytest.mark.parametrize('config', [CalibrationConfig(), CalibrationConfig.paper()])
def test_joints_on_a_line_or_a_point_are_refused(onto: str, config: CalibrationConfig) -> None:
    """No data of that kind fix a rotation, whichever method is asked."""
    for seed in range(10):
        for shape in ('human36m', 'kinect'):
            found = outcome(flattened(shape, seed, onto=onto, noise_px=seed % 2), config)
            assert isinstance(found, CalibrationError)
            assert found.reason is Reason.DEGENERATE_GEOMETRY
            assert f'on one {onto}' in found.message


@pytest.mark.fault(27)
@pytest.mark.parametrize('shape', ['human36m', 'kinect'])
def test_joints_on_a_plane_are_right_or_refused(shape: str) -> None:
    """Exact keypoints: within 0.1 deg, whatever the plane."""
    n_right = 0
    for seed in range(10):
        case = flattened(shape, seed, onto='plane')
        found = outcome(case)
        if isinstance(found, CalibrationError):
            assert found.reason in {Reason.AMBIGUOUS, Reason.DEGENERATE_MOTION, Reason.UNCERTAIN}
            continue
        n_right += 1
        assert errors(found.world_T_mocap, case.truth.world_T_mocap, case.observations)[0] < 0.1
    assert n_right >= 5


@pytest.mark.fault(28)
@pytest.mark.parametrize(
    ('distance_m', 'tilt_deg'), [(3, 5), (5, 20), (10, 5), (10, 20), (10, 40)]
)
def test_a_flat_figure_is_right_or_refused(distance_m: float, tilt_deg: float) -> None:
    """Seen from far it may lean either way: uncertain, ambiguous, or right, never wrong."""
    reasons = set()
    for seed in range(10):
        case = flat_figure(seed, distance_m, tilt_deg)
        found = outcome(case)
        if isinstance(found, CalibrationError):
            reasons.add(found.reason)
        else:
            assert not is_beyond_its_sigma(found, case)
    assert reasons <= {Reason.AMBIGUOUS, Reason.UNCERTAIN}


@pytest.mark.fault(28)
def test_a_flat_figure_far_away_is_named_ambiguous() -> None:
    """Both leanings fit; the message says by how little one fits better."""
    found = [outcome(flat_figure(seed, 10.0, 20.0)) for seed in range(10)]
    ambiguous = [
        f for f in found if isinstance(f, CalibrationError) and 'two different' in f.message
    ]
    assert ambiguous
    assert all(f.reason is Reason.AMBIGUOUS for f in ambiguous)


def test_the_mean_error_does_not_tell_a_useless_pose_from_a_good_one() -> None:
    """What the gates are for: the refused pose fits its pixels as well as the true one."""
    case = far_away(0, 10.0, motion='still', bias_px=3.0)
    found = outcome(case)
    assert isinstance(found, CalibrationError)
    assert found.calibration is not None
    at_truth = mpjpe_px(case.cameras, case.observations, case.truth.world_T_mocap)
    assert found.calibration.mpjpe_px < at_truth


@pytest.mark.parametrize('seed', [2, 3, 5])
def test_another_person_in_all_cameras_is_no_uncertain_pose(seed: int) -> None:
    """Any pose explains some of it within a tenth of the image: the reason is that none does."""
    case = scene('human36m', 300, seed, outlier_ratio=0.97, kind='person')
    for config in (CalibrationConfig(), CalibrationConfig.thorough()):
        with pytest.raises(CalibrationError) as refused:
            calibrate(case.cameras, case.observations, config=config)
        assert refused.value.reason is Reason.TOO_FEW_INLIERS
