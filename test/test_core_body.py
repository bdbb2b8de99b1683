# SPDX-License-Identifier: Apache-2.0
"""Size, unit and motion of the body are read from wherever somebody is in view."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from core_cases import sights_of
from scenes import errors, scene

from rpgd_ros.core import (
    CalibrationConfig,
    CalibrationError,
    Observations,
    Reason,
    View,
    calibrate,
)
from rpgd_ros.core.body import Body
from rpgd_ros.core.geometry import Array
from rpgd_ros.core.linearise import Sight
from rpgd_ros.simulation import Twin


def scaled(case: Twin, factor: float) -> list[Sight]:
    """Return the sights with skeletons in another unit."""
    return [
        Sight(s.camera, replace(s.view, x_mocap=factor * s.view.x_mocap)) for s in sights_of(case)
    ]


@pytest.mark.fault(17)
@pytest.mark.parametrize('shape', ['human36m', 'kinect', 'aistpp'])
@pytest.mark.parametrize(
    ('factor', 'unit'), [(1000.0, 'millimetres'), (100.0, 'centimetres'), (39.37, 'inches')]
)
def test_another_unit_is_named(shape: str, factor: float, unit: str) -> None:
    """No person spans 70 m; the message says what to set."""
    with pytest.raises(CalibrationError, match=f'looks like {unit}: set `mocap.units`') as refused:
        Body.of(scaled(scene(shape, 100, 3), factor)).check()
    assert refused.value.reason is Reason.WRONG_UNIT


def test_a_skeleton_of_a_few_centimetres_is_no_person() -> None:
    """Metres read as kilometres, or a toy."""
    with pytest.raises(CalibrationError, match=r'spans .* m, a person 0.5 to 2.5 m') as refused:
        Body.of(scaled(scene('human36m', 100, 3), 0.01)).check()
    assert refused.value.reason is Reason.WRONG_UNIT


@pytest.mark.parametrize('factor', [0.6, 1.0, 1.3])
def test_children_and_giants_are_persons(factor: float) -> None:
    """A body of 1.0 to 2.3 m passes."""
    Body.of(scaled(scene('human36m', 100, 3), factor)).check()


def test_one_joint_far_off_does_not_change_the_unit() -> None:
    """The size is a median over frames: single damaged markers do not make a giant."""
    sights = sights_of(scene('human36m', 200, 3))
    for sight in sights:
        sight.view.x_mocap[::5, 3] = 900.0
    Body.of(sights).check()


def test_one_joint_kilometres_away_does_not_make_the_rest_a_line() -> None:
    """A marker gone wild for a frame hides no shape."""
    sights = sights_of(scene('human36m', 20, 3))
    for sight in sights:
        sight.view.x_mocap[0, 3] = [13_818.0, 0.0, 0.0]
    Body.of(sights).check()


def test_motion_is_what_the_centre_of_the_body_covers() -> None:
    """A straight walk of 3 m, whatever the limbs do; a stray frame does not count."""
    rng = np.random.default_rng(0)
    x = rng.normal(0.0, 0.3, (1, 17, 3)) + np.zeros((200, 17, 3))
    x[:, :, 0] += np.linspace(0.0, 3.0, 200)[:, None]
    x[77] += 40.0
    sight = Sight(
        sights_of(scene('kinect', 30, 0))[0].camera, View(None, x, np.ones((200, 17, 2)))
    )
    assert Body.of([sight]).motion_m == pytest.approx(0.96 * 3.0, rel=0.02)


def test_nobody_seen_has_not_moved() -> None:
    """There is no way to measure, of no length."""
    (sight, *_) = sights_of(scene('human36m', 100, 3))
    blind = replace(sight.view, uv=np.full_like(sight.view.uv, np.nan))
    assert Body.of([Sight(sight.camera, blind)]).motion_m == 0.0


def test_a_motion_that_nobody_saw_does_not_count() -> None:
    """Walking out of view adds nothing."""
    case = scene('kinect', 200, 0)
    sight = sights_of(case)[0]
    uv = np.where(np.arange(200)[:, None, None] < 5, sight.view.uv, np.nan)
    unseen = Sight(sight.camera, replace(sight.view, uv=uv))
    assert Body.of([unseen]).motion_m < 0.2 < Body.of([sight]).motion_m


def with_skeleton_in(case: Twin, frames: Array | slice) -> Observations:
    """Return the observations with a skeleton in some frames only."""
    keep = np.zeros(case.observations.views[0].n_frames, bool)
    keep[frames] = True
    views = tuple(
        replace(v, x_mocap=np.where(keep[:, None, None], v.x_mocap, np.nan))
        for v in case.observations.views
    )
    return replace(case.observations, views=views)


@pytest.mark.parametrize(
    'frames',
    [slice(2003, 2323), slice(3, None, 7), np.setdiff1d(range(4000), range(0, 4000, 4))],
    ids=['a stretch', 'every seventh', 'those between'],
)
def test_somebody_who_is_there_some_of_the_time_is_found(frames: Array | slice) -> None:
    """Skeletons in a part of a long recording calibrate as that part alone would."""
    case = scene('human36m', 4000, 1)
    part = with_skeleton_in(case, frames)
    found = calibrate(case.cameras, part)
    truth = case.truth.world_T_mocap
    assert np.isfinite(found.centroid_mocap).all()
    apart = found.world_T_mocap @ found.centroid_mocap - truth @ found.centroid_mocap
    assert np.linalg.norm(apart) < 1e-3


def test_nobody_at_all_is_said_plainly() -> None:
    """Not one keypoint with a skeleton beside it."""
    case = scene('human36m', 100, 1)
    with pytest.raises(
        CalibrationError, match='no joint was seen by MoCap and camera at the same'
    ):
        calibrate(case.cameras, with_skeleton_in(case, slice(0, 0)))


def test_short_visit_in_a_long_recording_is_found() -> None:
    """A second of a walk, between the frames that are looked at of an empty film."""
    case, start, n_frames = scene('human36m', 60, 1), 10_040, 20_000
    views = []
    for view in case.observations.views:
        x = np.full((n_frames, *view.x_mocap.shape[1:]), np.nan)
        uv = np.full((n_frames, *view.uv.shape[1:]), np.nan)
        x[start : start + 60], uv[start : start + 60] = view.x_mocap, view.uv
        views.append(View(None, x, uv))
    for config in (CalibrationConfig(), CalibrationConfig.paper()):
        found = calibrate(case.cameras, Observations(tuple(views)), config=config)
        _, error_m = errors(found.world_T_mocap, case.truth.world_T_mocap, case.observations)
        assert error_m < 0.003
