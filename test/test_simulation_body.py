# SPDX-License-Identifier: Apache-2.0
"""The simulated body: bones keep their length, feet stand, and nothing jumps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rpgd_ros.core.errors import InputError
from rpgd_ros.core.geometry import Array
from rpgd_ros.simulation.body import LANDMARKS, SEGMENTS, Body
from rpgd_ros.simulation.motion import MOTIONS, MotionName

HZ = 200.0
SECONDS = 20.0
ALL = tuple(LANDMARKS)

seeds = st.integers(0, 2**31 - 1)
motions = st.sampled_from(MOTIONS)


def instants() -> Array:
    """Return the times at which the bodies of these tests are looked at."""
    return np.arange(0.0, SECONDS, 1.0 / HZ)


def body(seed: int = 0, motion: MotionName = 'walk', area_m: float = 4.0) -> Body:
    """Draw a person."""
    return Body.draw(np.random.default_rng(seed), motion, seconds=SECONDS, area_m=area_m)


@settings(max_examples=8, derandomize=True, deadline=None)
@given(seeds, motions)
def test_bones_keep_their_length(seed: int, motion: MotionName) -> None:
    """A body is a chain of rigid segments: legs included, which are solved from the feet."""
    pose = body(seed, motion).at(instants())
    for name, (parent, offset) in SEGMENTS.items():
        length = np.linalg.norm(pose.hinge[name] - pose.hinge[parent], axis=1)
        np.testing.assert_allclose(length, pose.scale * np.linalg.norm(offset), atol=1e-9)


@settings(max_examples=8, derandomize=True, deadline=None)
@given(seeds, motions)
def test_segments_are_turned_by_proper_rotations(seed: int, motion: MotionName) -> None:
    """No segment is ever mirrored or sheared."""
    pose = body(seed, motion).at(instants()[::20])
    for rotation in pose.rotation.values():
        identity = rotation @ np.swapaxes(rotation, -1, -2)
        np.testing.assert_allclose(identity, np.broadcast_to(np.eye(3), identity.shape), atol=1e-9)
        np.testing.assert_allclose(np.linalg.det(rotation), 1.0, atol=1e-9)


@settings(max_examples=8, derandomize=True, deadline=None)
@given(seeds, motions)
def test_velocities_are_continuous(seed: int, motion: MotionName) -> None:
    """Between two samples of 5 ms no landmark changes its velocity by more than a kick does."""
    x = body(seed, motion).at(instants()).place(ALL)
    velocity = np.diff(x, axis=0) * HZ
    change = np.abs(np.diff(velocity, axis=0)).max()
    assert change < 120.0 / HZ  # 12 g, the peak of a heel; a jump of 5 mm would show as 1 m/s
    assert np.abs(velocity).max() < 9.0  # a fast hand


@settings(max_examples=8, derandomize=True, deadline=None)
@given(seeds)
def test_walker_stays_in_the_room_and_above_the_floor(seed: int) -> None:
    """The pelvis keeps inside the area asked for, and no toe goes underground."""
    x = body(seed).at(instants()).place(ALL)
    assert np.abs(x[:, ALL.index('pelvis'), :2]).max() <= 2.0
    assert 0.0 < x[..., 2].min() < 0.02
    assert 1.0 < x[:, ALL.index('head_top'), 2].max() < 1.95


def test_walker_crosses_the_room() -> None:
    """A minute of walking covers most of the room and turns to all sides."""
    walker = Body.draw(np.random.default_rng(3), seconds=60.0, area_m=4.0)
    pose = walker.at(np.arange(0.0, 60.0, 0.1))
    on_floor = pose.hinge['pelvis'][:, :2]
    assert (np.ptp(on_floor, axis=0) > 2.0).all()
    quadrant = np.floor((pose.heading + np.pi) / (0.5 * np.pi)).astype(int) % 4
    assert set(quadrant.tolist()) == {0, 1, 2, 3}


def test_standing_foot_does_not_slide() -> None:
    """In mid-stance the ball of the foot is slower than a tenth of the body, turns aside."""
    walker = body(1)
    t = instants()
    now = walker.course.at(t)
    x = walker.at(t).place(('left_toe_base',))[:, 0, :2]
    speed = np.linalg.norm(np.gradient(x, axis=0) * HZ, axis=1)
    cycle = now.phase % 1.0
    turning = np.abs(np.gradient(np.unwrap(now.heading))) * HZ
    stands = (cycle > 0.1) & (cycle < 0.5) & (turning < 0.1) & (now.speed > 0.5)
    assert stands.sum() > 50
    assert speed[stands].mean() < 0.1 * now.speed[stands].mean()


def test_walker_faces_where_it_goes() -> None:
    """The nose leads: forward is x of the body, and left is left."""
    pose = body(2).at(instants())
    x = pose.place(('nose', 'head', 'left_hip', 'right_hip'))
    forward = np.stack([np.cos(pose.heading), np.sin(pose.heading)], -1)
    left = np.stack([-forward[:, 1], forward[:, 0]], -1)
    going = np.gradient(pose.hinge['pelvis'][:, :2], axis=0)
    assert ((going * forward).sum(-1) > 0.0).mean() > 0.99
    assert (((x[:, 0] - x[:, 1])[:, :2] * forward).sum(-1) > 0.0).mean() > 0.95
    assert (((x[:, 2] - x[:, 3])[:, :2] * left).sum(-1) > 0.0).all()


def test_arms_swing_against_the_legs() -> None:
    """The left wrist goes back when the left foot goes forward."""
    pose = body(5).at(instants())
    x = pose.place(('left_wrist', 'left_ankle', 'pelvis'))
    forward = np.stack([np.cos(pose.heading), np.sin(pose.heading)], -1)
    wrist, ankle = (((x[:, j] - x[:, 2])[:, :2] * forward).sum(-1) for j in (0, 1))
    calm = x[:, 0, 2] < x[:, 2, 2] + 0.05  # not while the arm reaches out
    assert np.corrcoef(wrist[calm], ankle[calm])[0, 1] < -0.3


def test_body_crouches_and_reaches_within_a_minute() -> None:
    """A walk shows more of a body than walking: knees bend, hands rise above the head."""
    walker = Body.draw(np.random.default_rng(4), seconds=60.0)
    x = walker.at(np.arange(0.0, 60.0, 0.05)).place(
        ('pelvis', 'head', 'left_wrist', 'right_wrist')
    )
    assert x[:, 0, 2].min() < 0.65 * x[:, 0, 2].max()
    assert (x[:, 2:, 2].max(1) > x[:, 1, 2]).any()


def test_still_body_does_not_move_at_all() -> None:
    """`still` is the degenerate case: every landmark stays where it is."""
    assert np.ptp(body(0, 'still').at(instants()).place(ALL), axis=0).max() == 0.0


def test_swaying_body_moves_by_millimetres_on_feet_that_stand() -> None:
    """Quiet standing: 5 to 10 mm of the pelvis, none of the feet."""
    x = body(0, 'sway').at(np.arange(0.0, SECONDS, 0.05)).place(('pelvis', 'left_heel'))
    radius = np.linalg.norm(x[:, 0, :2] - x[:, 0, :2].mean(0), axis=1)
    assert 0.003 < float(np.sqrt((radius**2).mean())) < 0.012
    assert np.ptp(x[:, 1], axis=0).max() < 1e-9


def test_turning_body_turns_round_on_its_place() -> None:
    """`turn_in_place` shows all sides, within an arm's length."""
    pose = body(0, 'turn_in_place').at(instants())
    assert np.ptp(np.unwrap(pose.heading)) > 2.0 * np.pi
    assert np.ptp(pose.hinge['pelvis'][:, :2], axis=0).max() < 0.05


def test_same_seed_gives_the_same_body() -> None:
    """Everything comes from the generator that is passed in."""
    np.testing.assert_array_equal(
        body(7).at(instants()).place(ALL), body(7).at(instants()).place(ALL)
    )


def test_any_clock_may_sample_the_body() -> None:
    """The body is a function of time: a coarse sampling is a part of a fine one."""
    walker = body(8)
    fine, coarse = walker.at(instants()).place(ALL), walker.at(instants()[::7]).place(ALL)
    np.testing.assert_allclose(fine[::7], coarse, atol=1e-12)


def test_unknown_landmark_is_refused() -> None:
    """The message names what the body has not, and what it has."""
    with pytest.raises(InputError, match=r"no landmark 'tail'; known: pelvis"):
        body().at(np.zeros(1)).place(('tail',))


def test_unknown_motion_is_refused() -> None:
    """The message lists the motions."""
    with pytest.raises(InputError, match=r"unknown motion 'fly'; known: walk, sway"):
        Body.draw(np.random.default_rng(0), 'fly', seconds=1.0)  # type: ignore[arg-type]
