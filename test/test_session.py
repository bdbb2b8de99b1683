# SPDX-License-Identifier: Apache-2.0
"""The whole job without ROS: bytes in, observations and a calibration out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from studio import (
    CAMERA_PERIOD,
    JOINTS,
    MOCAP_PERIOD,
    PAIRS,
    SECONDS,
    START,
    WORLD_T_MOCAP,
    Studio,
    bits,
    body_at,
    errors,
    feed,
    make_studio,
    with_camera,
)

from rpgd_ros.core import (
    Calibration,
    CalibrationConfig,
    InputError,
)
from rpgd_ros.messages import (
    POINT_CLOUD2,
    POSE_ARRAY,
    encode_point_cloud2,
    encode_pose_array,
)
from rpgd_ros.pairing import BufferConfig
from rpgd_ros.session import MOCAP, Session, SessionConfig, snapshot, solve


@pytest.fixture(scope='module')
def studio() -> Studio:
    """Two cameras, twelve seconds."""
    return make_studio()


def test_bytes_of_a_walk_give_the_transform(studio: Studio) -> None:
    """The main job: messages in, world_T_mocap out."""
    session = feed(Session(studio.rig), studio.messages)
    calibration = solve(session.snapshot())
    degrees, metres = errors(calibration)
    assert degrees < 0.1
    assert metres < 0.005
    assert set(calibration.per_camera) == {'cam0', 'cam1'}
    assert session.mocap_frame == 'vicon'


def test_replay_in_batches_gives_the_bits_of_the_live_run(studio: Studio) -> None:
    """One by one, in batches, shuffled or doubled: the same observations, the same pose."""
    live = feed(Session(studio.rig), studio.messages).snapshot()
    order = np.argsort(
        np.arange(len(studio.messages))
        + np.random.default_rng(3).uniform(0, 9, len(studio.messages))
    )
    shuffled = [studio.messages[i] for i in order]
    doubled = [m for i, m in enumerate(shuffled) for _ in range(1 + (i % 5 == 0))]
    for messages, together in ((studio.messages, 50), (studio.messages, 10**6), (doubled, 64)):
        replay = feed(Session(studio.rig), messages, together=together).snapshot()
        assert bits(replay) == bits(live)
    calibrations = [solve(taken) for taken in (live, replay)]
    first, second = (c.world_T_mocap.matrix.tobytes() for c in calibrations)
    assert first == second


def test_pose_arrays_are_read_as_well(studio: Studio) -> None:
    """A skeleton as PoseArray, keypoints as PointCloud2."""
    session = Session(studio.rig)
    stamps = [START + i * MOCAP_PERIOD for i in range(600)]
    x = WORLD_T_MOCAP.inverse() @ body_at(stamps)
    payloads = [encode_pose_array(s, 'vicon', p) for s, p in zip(stamps, x, strict=True)]
    session.add(MOCAP, POSE_ARRAY, payloads, stamps)
    feed(session, studio.of('cam0'), together=100)
    view = session.snapshot().observations.views[0]
    assert view.n_frames == 150
    np.testing.assert_allclose(view.x_mocap[0], x[0], atol=0.02)


@pytest.mark.parametrize(
    ('units', 'per_metre'), [('mm', 1000.0), ('cm', 100.0), ('inch', 1 / 0.0254)]
)
def test_units_are_turned_to_metres(units: str, per_metre: float) -> None:
    """What the rig file says of the skeleton's unit."""
    studio = make_studio(1, scale=per_metre)
    rig = replace(studio.rig, mocap=replace(studio.rig.mocap, units=units))  # type: ignore[arg-type]
    session = feed(Session(rig), studio.messages, together=500)
    assert errors(solve(session.snapshot()))[0] < 0.5


def test_columns_are_the_joints_that_some_camera_sees(studio: Studio) -> None:
    """In the MoCap's order; a camera has NaN in the columns of others."""
    rig = with_camera(studio.rig, 0, pairs=PAIRS[:5])
    rig = with_camera(rig, 1, pairs=PAIRS[3:8])
    taken = feed(Session(rig), studio.messages, together=1000).snapshot()
    columns = sorted({j for j, _ in PAIRS[:8]})
    assert taken.observations.joint_names == tuple(JOINTS[j] for j in columns)
    for view, pairs in zip(taken.observations.views, (PAIRS[:5], PAIRS[3:8]), strict=True):
        seen = ~np.isnan(view.uv[..., 0]).all(0)
        assert [columns[c] for c in np.flatnonzero(seen)] == sorted(j for j, _ in pairs)
        assert view.confidence is not None
        np.testing.assert_array_equal(np.isnan(view.confidence[0]), ~seen)


def test_keypoints_below_the_confidence_are_missing(studio: Studio) -> None:
    """Counted when they come, taken out of the snapshot; a new limit holds for all."""
    rig = with_camera(studio.rig, 0, min_confidence=0.45)
    session = feed(Session(rig), studio.messages, together=100)
    uv = session.snapshot().observations.views[0].uv
    # Scores rise with the keypoint's number: 5 and 6, the shoulders, are below 0.45.
    shoulders = [j for j, k in PAIRS if k in {5, 6}]
    assert np.isnan(uv[:, shoulders]).all()
    assert np.isfinite(np.delete(uv, shoulders, axis=1)).all()
    assert session.counts('cam0')['low_confidence'] == 2 * SECONDS * 30
    session.update_camera('cam0', time_offset_s=0.0, min_confidence=0.0)
    assert np.isfinite(session.snapshot().observations.views[0].uv).all()
    low = feed(Session(with_camera(studio.rig, 0, min_confidence=0.05)), studio.of('cam0')[:9])
    assert 'low_confidence' not in low.counts('cam0')


@pytest.mark.parametrize('units', ['normalized', 'auto', 'pixels'])
def test_keypoints_may_be_shares_of_the_image(studio: Studio, units: str) -> None:
    """Said so, or told by their size; pixels stay pixels."""
    rig = with_camera(studio.rig, 0, units=units)
    session = feed(Session(rig), studio.of(MOCAP), together=1000)
    sent = np.full((17, 2), [0.5, 0.25])
    payloads = [encode_point_cloud2(START + i * CAMERA_PERIOD, 'c', sent, None) for i in range(30)]
    session.add('cam0', POINT_CLOUD2, payloads, [0] * 30)
    view = session.snapshot().observations.views[0]
    expected = [0.5, 0.25] if units == 'pixels' else [640.0, 180.0]
    np.testing.assert_allclose(view.uv, np.broadcast_to(expected, view.uv.shape))
    assert view.confidence is None


def test_known_offset_moves_the_video(monkeypatch: pytest.MonkeyPatch) -> None:
    """Views stand on the MoCap's clock; estimated offsets are told of the stamps as sent."""
    studio = make_studio(1, late_ns=50_000_000)
    rig = with_camera(studio.rig, 0, time_offset_s=0.07)
    rig = replace(rig, mocap=replace(rig.mocap, time_offset_s=0.02))
    taken = feed(Session(rig), studio.messages, together=500).snapshot()
    (view,) = taken.observations.views
    assert view.stamp_ns is not None
    assert (view.stamp_ns - START).tolist()[:2] == [0, CAMERA_PERIOD]
    calibration = solve(taken)
    assert errors(calibration)[0] < 0.5

    def estimate(*arguments: object, **keywords: object) -> Calibration:
        del arguments, keywords
        return replace(calibration, time_offset_s={'cam0': (0.001, 0.0005)})

    monkeypatch.setattr(snapshot, 'calibrate', estimate)
    offset_s, sigma_s = solve(taken).time_offset_s['cam0']
    assert offset_s == pytest.approx(0.051)
    assert sigma_s == 0.0005


def test_zero_is_a_place_where_the_user_says_so(studio: Studio) -> None:
    """With zero_is_missing off, a joint at the origin is a joint."""
    x = np.ones((12, 3))
    x[1] = 0.0
    for is_missing in (True, False):
        session = Session(studio.rig, SessionConfig(zero_is_missing=is_missing))
        payloads = [encode_point_cloud2(START + i, 'vicon', x, None) for i in range(10)]
        session.add(MOCAP, POINT_CLOUD2, payloads, [0] * 10)
        assert session.counts(MOCAP).get('zero', 0) == 10 * is_missing


@pytest.mark.fault(13)
def test_looped_bag_starts_over_once(studio: Studio) -> None:
    """After the loop only the new side is there, in all streams, and nothing of it is lost."""
    session = Session(studio.rig)
    feed(session, studio.messages, together=12)
    expected = bits(session.snapshot())
    feed(session, studio.messages, together=12)
    assert session.n_epochs == 1
    assert bits(session.snapshot()) == expected


def test_snapshot_is_not_touched_by_what_comes_later(studio: Studio) -> None:
    """Late, doubled and further messages, a reset: the pairs are those of its moment."""
    half = len(studio.messages) // 2
    early = feed(Session(studio.rig), studio.messages[:half], together=100)
    expected = bits(early.snapshot())
    taken = early.snapshot()
    feed(early, studio.messages[half - 30 :], together=10)
    early.reset()
    feed(early, studio.messages[::-1], together=10)
    assert bits(taken) == expected


def test_reset_drops_messages_and_keeps_the_cameras(studio: Studio) -> None:
    """The next walk may even be in another frame."""
    session = feed(Session(studio.rig), studio.messages, together=1000)
    session.reset()
    assert session.counts(MOCAP)['kept'] == 0
    assert session.motion_m() == 0.0
    assert session.mocap_frame == ''
    feed(session, studio.messages, together=1000)
    assert session.counts(MOCAP)['kept'] == SECONDS * 120


def test_new_settings_hold_from_the_next_snapshot_on(studio: Studio) -> None:
    """Also the bounds of the buffers."""
    session = feed(Session(studio.rig), studio.messages, together=1000)
    before = session.snapshot()
    config = SessionConfig(
        calibration=CalibrationConfig.paper(), buffer=BufferConfig(max_frames=100)
    )
    session.update_config(config)
    assert session.counts(MOCAP)['kept'] == 100
    after = session.snapshot()
    assert after.config == config.calibration
    assert before.config == SessionConfig().calibration
    assert before.observations.views[0].n_frames == SECONDS * 30


def test_motion_is_the_way_of_the_body(studio: Studio) -> None:
    """A walk over 3 by 2.4 m; a standing person does not move, whatever is missing."""
    assert 2.5 < feed(Session(studio.rig), studio.of(MOCAP), together=100).motion_m() < 4.5
    session = Session(studio.rig)
    rng = np.random.default_rng(0)
    payloads = []
    for i in range(200):
        x = np.ones((12, 3)) * np.arange(1, 13)[:, None] / 6.0
        x[rng.integers(12)] = np.nan
        payloads.append(encode_point_cloud2(START + i * MOCAP_PERIOD, 'v', x, None))
    session.add(MOCAP, POINT_CLOUD2, payloads, [0] * 200)
    assert session.motion_m() < 0.2


def test_streams_and_topics_are_those_of_the_rig(studio: Studio) -> None:
    """Names for the node's subscriptions."""
    session = Session(studio.rig)
    assert session.streams == (MOCAP, 'cam0', 'cam1')
    assert session.topics() == {
        'mocap/skeleton': MOCAP,
        'cam0/kp': 'cam0',
        'cam1/kp': 'cam1',
    }
    with pytest.raises(InputError, match="no stream 'cam7'; there are mocap, cam0, cam1"):
        session.add('cam7', POINT_CLOUD2, [], [])
