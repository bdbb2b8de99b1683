# SPDX-License-Identifier: Apache-2.0
"""What a session cannot use is counted, and what it lacks is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from studio import (
    CAMERA_PERIOD,
    MOCAP_PERIOD,
    SECONDS,
    START,
    S,
    Studio,
    errors,
    feed,
    make_studio,
)

from rpgd_ros.core import (
    CalibrationError,
    Reason,
)
from rpgd_ros.messages import (
    POINT_CLOUD2,
    encode_point_cloud2,
)
from rpgd_ros.pairing import PairCounts, SyncConfig
from rpgd_ros.session import MOCAP, Session, SessionConfig, solve


@pytest.fixture(scope='module')
def studio() -> Studio:
    """Two cameras, twelve seconds."""
    return make_studio()


def test_time_of_arrival_stands_in_for_missing_stamps(studio: Studio) -> None:
    """With use_receive_time, messages without a stamp are paired by their arrival."""
    stamps = [START + i * CAMERA_PERIOD for i in range(60)]
    x = np.zeros((12, 3)) + 1.0
    uv = np.zeros((17, 2)) + 100.0
    config = SessionConfig(sync=SyncConfig(use_receive_time=True))
    for chosen, kept in ((config, 60), (SessionConfig(), 0)):
        session = Session(studio.rig, chosen)
        session.add(MOCAP, POINT_CLOUD2, [encode_point_cloud2(0, 'm', x, None)] * 60, stamps)
        session.add('cam0', POINT_CLOUD2, [encode_point_cloud2(0, 'c', uv, None)] * 60, stamps)
        assert session.counts(MOCAP)['kept'] == kept
        assert session.counts(MOCAP).get('zero_stamp', 0) == 60 - kept
        assert session.pair_counts()['cam0'] == PairCounts(kept, 0)


def test_every_message_is_counted_under_one_reason(studio: Studio) -> None:
    """Received is the sum of kept and dropped; missing joints are counted beside."""
    session = Session(studio.rig)
    x = np.ones((12, 3))
    x[0], x[1] = np.nan, 0.0
    good = [encode_point_cloud2(START + i * MOCAP_PERIOD, 'vicon', x, None) for i in range(10)]
    cut = good[3][:-20]
    few = encode_point_cloud2(START, 'vicon', x[:11], None)
    other = encode_point_cloud2(START, 'vicon2', x, None)
    unstamped = encode_point_cloud2(0, 'vicon', x, None)
    far = encode_point_cloud2(START + 3600 * S, 'vicon', x, None)
    payloads = [*good, cut, b'', few, other, unstamped, far, good[4]]
    session.add(MOCAP, POINT_CLOUD2, payloads, [0] * len(payloads))
    session.add(MOCAP, 'std_msgs/msg/String', [b'abc'], [0])
    counts = dict(session.counts(MOCAP))
    assert counts.pop('nan') == 12
    assert counts.pop('zero') == 12
    assert counts.pop('received') == len(payloads) + 1 == sum(counts.values())
    assert counts['kept'] == 10
    for reason, n in {
        'malformed': 2,
        'wrong_joints': 1,
        'frame_changed': 1,
        'zero_stamp': 1,
        'jump_held': 1,
        'duplicate': 1,
        'wrong_type': 1,
    }.items():
        assert counts[reason] == n, reason


def test_empty_session_names_what_is_silent(studio: Studio) -> None:
    """Each silent stream with its topic, and what became of its messages."""
    session = Session(studio.rig)
    with pytest.raises(CalibrationError, match=r'mocap \(mocap/skeleton; 0 received\)') as refused:
        session.snapshot()
    assert refused.value.reason is Reason.NO_DATA
    feed(session, studio.of(MOCAP), together=100)
    few = encode_point_cloud2(START, 'c', np.ones((5, 2)), None)
    session.add('cam1', POINT_CLOUD2, [few] * 3, [0] * 3)
    with pytest.raises(
        CalibrationError, match=r'cam1 \(cam1/kp; 3 received: 3 wrong_joints'
    ) as refused:
        session.snapshot()
    assert 'mocap' not in refused.value.message
    assert session.motion_m() > 1.0


@pytest.mark.fault(16)
def test_one_silent_camera_does_not_stop_the_others(studio: Studio) -> None:
    """Its view is empty."""
    messages = studio.of(MOCAP) + studio.of('cam1')
    taken = feed(Session(studio.rig), messages, together=1000).snapshot()
    assert [view.n_frames for view in taken.observations.views] == [0, SECONDS * 30]
    assert taken.pair_counts['cam0'] == PairCounts(0, 0)
    assert errors(solve(taken))[0] < 0.5


def test_clocks_that_never_meet_are_named_with_their_distance() -> None:
    """An unsynchronised camera: how far apart, and what to do."""
    studio = make_studio(1, late_ns=-100 * S)
    session = feed(Session(studio.rig), studio.messages, together=1000)
    with pytest.raises(
        CalibrationError, match=r'cam0 88\.0\d\d s\. Synchronise the clocks'
    ) as refused:
        session.snapshot()
    assert refused.value.reason is Reason.NO_DATA


def test_camera_that_sent_nothing_has_no_distance_in_time() -> None:
    """Of two whose clocks were to be compared, one is silent."""
    studio = make_studio(2, late_ns=-100 * S)
    messages = studio.of(MOCAP) + studio.of('cam1')
    session = feed(Session(studio.rig), messages, together=1000)
    with pytest.raises(CalibrationError, match=r'skeleton: cam1 88\.0\d\d s\. Sync'):
        session.snapshot()


def test_skeletons_in_the_world_frame_are_refused(studio: Studio) -> None:
    """A driver that calls its root like the rig's world: no transform could be published."""
    rig = replace(studio.rig, world_frame='vicon')
    session = feed(Session(rig), studio.messages, together=1000)
    with pytest.raises(CalibrationError, match="'vicon', which is also world_frame") as refused:
        session.snapshot()
    assert refused.value.reason is Reason.BAD_RIG
    renamed = replace(rig, mocap=replace(rig.mocap, frame='mocap_root'))
    session = feed(Session(renamed), studio.messages, together=1000)
    assert session.mocap_frame == 'mocap_root'
    assert session.snapshot().cameras


@pytest.mark.fault(10)
def test_no_bytes_make_the_session_fail(studio: Studio) -> None:
    """Mutations of good messages are counted, and the good ones stay as they are."""
    session = feed(Session(studio.rig), studio.messages, together=500)
    rng = np.random.default_rng(0)
    n_bad = 0
    for stream in session.streams:
        for _, payload, receive_ns in studio.of(stream)[:60]:
            bad = bytearray(payload)
            for at in rng.integers(0, 60, 6):  # header, frame, layout
                bad[at] = rng.integers(256)
            n_before = session.counts(stream)['received'] - session.counts(stream)['kept']
            session.add(stream, POINT_CLOUD2, [bytes(bad)], [receive_ns])
            counts = session.counts(stream)
            n_bad += (counts['received'] - counts['kept']) > n_before
    assert n_bad >= 100
    assert session.snapshot().observations.views[0].n_frames >= SECONDS * 30
