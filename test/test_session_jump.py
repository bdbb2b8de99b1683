# SPDX-License-Identifier: Apache-2.0
"""The gate that keeps automatic calibrations from moving a transform in use."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from studio import feed, make_studio

from rpgd_ros.core import Calibration, CalibrationError, Reason, RigidTransform
from rpgd_ros.core.config import AcceptConfig
from rpgd_ros.core.geometry import so3_exp
from rpgd_ros.session import Session, solve
from rpgd_ros.session.jump import refuse_jump

EXACT = 1e-10 * np.eye(6)


@pytest.fixture(scope='module')
def found() -> Calibration:
    """Return a calibration from two cameras, as exact as can be."""
    studio = make_studio()
    calibration = solve(feed(Session(studio.rig), studio.messages, together=1000).snapshot())
    return replace(calibration, covariance=EXACT, covariance_over_time=EXACT)


def published(found: Calibration, *, turn_deg: float = 0.0, move_m: float = 0.0) -> RigidTransform:
    """Return the pose found, turned about the body's middle and moved."""
    middle = found.world_T_mocap @ found.centroid_mocap
    turn = so3_exp(np.radians([0.0, turn_deg, 0.0]))
    about = RigidTransform(turn, middle - turn @ middle + np.array([move_m, 0.0, 0.0]))
    return about @ found.world_T_mocap


@pytest.mark.parametrize(
    ('turn_deg', 'move_m'), [(0.0, 0.0), (1.9, 0.0), (0.0, 0.09), (1.9, 0.09)]
)
def test_small_steps_pass(found: Calibration, turn_deg: float, move_m: float) -> None:
    """Runs on one walk differ a little."""
    before = published(found, turn_deg=turn_deg, move_m=move_m)
    refuse_jump(found, before, EXACT, AcceptConfig())


@pytest.mark.parametrize(('turn_deg', 'move_m'), [(2.1, 0.0), (0.0, 0.11), (90.0, 3.0)])
def test_jump_is_refused_with_both_figures(
    found: Calibration, turn_deg: float, move_m: float
) -> None:
    """The message tells how far, and what to do if it is meant."""
    before = published(found, turn_deg=turn_deg, move_m=move_m)
    with pytest.raises(CalibrationError, match='~/calibrate') as refused:
        refuse_jump(found, before, EXACT, AcceptConfig())
    assert refused.value.reason is Reason.JUMP
    assert refused.value.calibration is found
    assert f'{turn_deg:.2f} deg and {1e3 * move_m:.0f} mm' in refused.value.message


def test_mocap_origin_far_away_does_not_make_a_jump_of_a_turn(found: Calibration) -> None:
    """A degree about the body moves an origin at 100 m by 1.7 m, and nothing in the room."""
    moved = RigidTransform(np.eye(3), np.array([100.0, 0.0, 0.0]))
    far = replace(
        found,
        world_T_mocap=found.world_T_mocap @ moved.inverse(),
        centroid_mocap=moved @ found.centroid_mocap,
    )
    refuse_jump(far, published(far, turn_deg=1.0), EXACT, AcceptConfig())


def test_uncertain_pose_may_be_left_behind(found: Calibration) -> None:
    """What was known to a degree may be three degrees wrong: the better one replaces it."""
    before = published(found, turn_deg=2.8)
    with pytest.raises(CalibrationError):
        refuse_jump(found, before, EXACT, AcceptConfig())
    coarse = EXACT.copy()
    coarse[0, 0] = np.radians(1.0) ** 2
    refuse_jump(found, before, coarse, AcceptConfig())


def test_limits_are_those_of_the_parameters(found: Calibration) -> None:
    """Wider ones let more pass, zero lets nothing pass that is certain."""
    before = published(found, turn_deg=3.0, move_m=0.2)
    refuse_jump(found, before, EXACT, AcceptConfig(max_jump_deg=5.0, max_jump_m=0.3))
    with pytest.raises(CalibrationError):
        refuse_jump(
            found,
            published(found, turn_deg=0.1),
            EXACT,
            AcceptConfig(max_jump_deg=0.0, max_jump_m=0.0),
        )
