# SPDX-License-Identifier: Apache-2.0
"""Skeletons that come in parts: which belong together, and what happens when one does not."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import drivers
import numpy as np
import pytest
from drivers import NO_TURN, STAMP_NS, ZEROS
from hypothesis import given, settings
from hypothesis import strategies as st

from rpgd_ros.core import InputError
from rpgd_ros.core.geometry import IntArray
from rpgd_ros.io.rig import Rig, parse_rig
from rpgd_ros.messages import (
    POINT_CLOUD2,
    POSE_STAMPED,
    TF_MESSAGE,
    decode_parts,
    encode_point_cloud2,
)
from rpgd_ros.pairing import BufferConfig, SyncConfig
from rpgd_ros.session import MOCAP, Session, SessionConfig
from rpgd_ros.session.gather import GAP_NS, MAX_PARTS, gather

MS = 1_000_000
FRAME_NS = 5 * MS  # 200 Hz
N_FRAMES = 20
JOINTS = ('LHipJC', 'RHipJC', 'LKneeJC', 'RKneeJC')
RIG = """
schema: 1
world_frame: studio
mocap: {{joints: [LHipJC, RHipJC, LKneeJC, RKneeJC], {mocap}}}
cameras:
  - {{name: cam0, keypoints: coco17, size: [64, 48], matrix: [50, 0, 32, 0, 50, 24, 0, 0, 1]}}
"""
SEGMENTS = 'topic: "vicon/bob/{joint}"'
TREE = 'topic: /tf, frame: mocap, names: "bob_{joint}"'


def rig(mocap: str) -> Rig:
    """Make a rig of four joints."""
    return parse_rig(RIG.format(mocap=mocap))


def place(frame: int, joint: int) -> tuple[float, float, float]:
    """Return a place that tells its frame and joint."""
    return (frame + 1.0, joint + 1.0, 1.0)


def segment(frame: int, joint: int, *, late_ns: int = 0, **keywords: Any) -> tuple[str, bytes]:
    """Make the pose of a segment as vicon_receiver sends it: stream and payload."""
    stamp_ns = STAMP_NS + frame * FRAME_NS + joint * 60_000 + late_ns
    message = drivers.pose_stamped(
        keywords.pop('xyz', place(frame, joint)), stamp_ns=stamp_ns, **keywords
    )
    return f'{MOCAP}/{JOINTS[joint]}', drivers.serialise(message)


def walk(n_frames: int = N_FRAMES) -> list[tuple[str, bytes]]:
    """Make the poses of all segments."""
    return [segment(i, j) for i in range(n_frames) for j in range(len(JOINTS))]


def fed(
    messages: list[tuple[str, bytes]],
    msgtype: str = POSE_STAMPED,
    mocap: str = SEGMENTS,
    config: SessionConfig | None = None,
) -> Session:
    """Return a session that took messages one by one."""
    session = Session(rig(mocap), config)
    for i, (stream, payload) in enumerate(messages):
        session.add(stream, msgtype, [payload], [i + 1])
    return session


def skeletons(session: Session) -> tuple[IntArray, Any]:
    """Return the stamps and joints that a session has gathered."""
    samples = session.parts()[2].store.arrays()
    return samples.stamp_ns, samples.values


def whole(n_frames: int = N_FRAMES) -> Any:
    """Return the skeletons of the walk."""
    return np.array([[place(i, j) for j in range(len(JOINTS))] for i in range(n_frames)])


def link(frame: int, parent: str, child: str, xyz: Any, turn: Any = NO_TURN) -> tuple[str, bytes]:
    """Make a message of one transform: stream and payload."""
    item = drivers.transform(parent, child, xyz, turn, stamp_ns=STAMP_NS + frame * FRAME_NS)
    return MOCAP, drivers.serialise(drivers.tf_message([item]))


def test_segments_with_stamps_of_their_own_make_skeletons() -> None:
    """One per frame, stamped with the mean."""
    stamp_ns, joints = skeletons(fed(walk()))
    np.testing.assert_array_equal(joints, whole())
    np.testing.assert_array_equal(stamp_ns, STAMP_NS + np.arange(N_FRAMES) * FRAME_NS + 90_000)


def test_the_topics_of_segments_are_those_that_some_camera_needs() -> None:
    """A topic for each joint that is paired, with its stream."""
    session = Session(rig('topic: "vicon/bob/{joint}", joint_map: {left_knee: null}'))
    assert session.topics() == {
        'vicon/bob/LHipJC': 'mocap/LHipJC',
        'vicon/bob/RHipJC': 'mocap/RHipJC',
        'vicon/bob/RKneeJC': 'mocap/RKneeJC',
        'cam0/keypoints': 'cam0',
    }
    assert session.streams == ('mocap', 'cam0')
    assert session.counts('mocap/LHipJC') == session.counts('mocap')


@settings(max_examples=25, deadline=None)
@given(st.randoms(use_true_random=False))
def test_skeletons_are_a_function_of_the_set_of_messages(random: Any) -> None:
    """Neither order nor duplicates nor the number taken at once change a bit."""
    messages = walk(8)
    shuffled = messages + messages[:9]
    random.shuffle(shuffled)
    first, second = fed(messages), fed(shuffled)
    for a, b in zip(skeletons(first), skeletons(second), strict=True):
        np.testing.assert_array_equal(a, b)
    together = Session(rig(SEGMENTS))
    for name in JOINTS:
        payloads = [p for stream, p in shuffled if stream == f'{MOCAP}/{name}']
        together.add(f'{MOCAP}/{name}', POSE_STAMPED, payloads, [1] * len(payloads))
    for a, b in zip(skeletons(first), skeletons(together), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize('late', [0, 3, 40])
def test_looking_in_between_changes_nothing(late: int) -> None:
    """What was put together before stays, unless a message comes for it after all."""
    messages = walk(800)  # 4 s
    held = messages[100 : 100 + late]
    messages = messages[:100] + messages[100 + late :] + held
    watched = Session(rig(SEGMENTS))
    for i, (stream, payload) in enumerate(messages):
        watched.add(stream, POSE_STAMPED, [payload], [1])
        if i % 37 == 0:
            skeletons(watched)
    for a, b in zip(skeletons(watched), skeletons(fed(messages)), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize('pause', [0, 300])
def test_a_part_that_lags_does_not_make_each_look_gather_everything(
    pause: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One comes 1.5 s after the others, or falls silent for longer; the skeletons are the same."""
    n_frames, lag = 2400, 300  # 12 s
    messages = []
    for i in range(n_frames + lag):
        messages += [segment(i, j) for j in range(3) if i < n_frames]
        if i >= lag and not 600 <= i - lag < 600 + pause:
            messages.append(segment(i - lag, 3))
    n_gathered = []

    def counted(stamps: Sequence[IntArray]) -> tuple[IntArray, Any]:
        n_gathered.append(sum(len(s) for s in stamps))
        return gather(stamps)

    monkeypatch.setattr('rpgd_ros.session.gather.gather', counted)
    watched = Session(rig(SEGMENTS))
    for i, (stream, payload) in enumerate(messages):
        watched.add(stream, POSE_STAMPED, [payload], [1])
        if i % 80 == 79:  # 0.1 s
            skeletons(watched)
    late = np.array(n_gathered[len(n_gathered) // 2 :])
    assert np.median(late) < 4 * 200 * 3.0  # 3 s of the others
    for a, b in zip(skeletons(watched), skeletons(fed(messages)), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize('n_silent', [1, 2])
def test_a_part_that_has_stopped_does_not_hold_the_others(
    n_silent: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A marker was lost for good: what is old is put together once all the same."""
    messages = [
        segment(i, j) for i in range(2400) for j in range(4) if i < 300 or j < 4 - n_silent
    ]
    n_gathered = []

    def counted(stamps: Sequence[IntArray]) -> tuple[IntArray, Any]:
        n_gathered.append(sum(len(s) for s in stamps))
        return gather(stamps)

    monkeypatch.setattr('rpgd_ros.session.gather.gather', counted)
    watched = Session(rig(SEGMENTS))
    for i, (stream, payload) in enumerate(messages):
        watched.add(stream, POSE_STAMPED, [payload], [1])
        if i % 80 == 79:
            skeletons(watched)
    assert n_gathered[-1] < 2 * 200 * 4


def test_a_lost_message_is_one_missing_joint() -> None:
    """Best-effort publishers lose some; the skeletons after it stay whole."""
    messages = walk()
    del messages[40]  # the first segment of frame 10
    _, joints = skeletons(fed(messages))
    expected = whole()
    expected[10, 0] = np.nan
    np.testing.assert_array_equal(joints, expected)


def test_an_occluded_segment_is_missing_whatever_place_it_claims() -> None:
    """A quaternion of zeros; with `map_xyz` in the driver, the place is that offset."""
    messages = walk()
    messages[41] = segment(10, 1, xyz=(2.0, 0.0, 0.0), quat_xyzw=ZEROS)
    messages[42] = segment(10, 2, xyz=(0.0, 0.0, 0.0))
    session = fed(messages)
    _, joints = skeletons(session)
    expected = whole()
    expected[10, 1:3] = np.nan
    np.testing.assert_array_equal(joints, expected)
    counts = session.counts(MOCAP)
    assert (counts['nan'], counts['zero']) == (1, 1)
    assert counts['skeletons'] == N_FRAMES


def test_a_pause_within_a_frame_divides_it() -> None:
    """What comes 3 ms later is of another instant: the skeleton of a moving body would shear."""
    messages = walk()
    messages[42:44] = [segment(10, 2, late_ns=3 * MS), segment(10, 3, late_ns=3 * MS)]
    _, joints = skeletons(fed(messages))
    assert len(joints) == N_FRAMES + 1
    assert np.isnan(joints[10, 2:]).all()
    assert np.isnan(joints[11, :2]).all()


def test_frames_without_a_pause_between_them_are_told_apart_by_their_joints() -> None:
    """At 1000 Hz the gaps between frames are as small as those within."""
    stamps = [np.arange(30) * MS + j * 200_000 for j in range(4)]
    stamp_ns, rows = gather(stamps)
    np.testing.assert_array_equal(rows, np.arange(30)[:, None] * np.ones(4, int))
    assert (np.diff(stamp_ns) > 0).all()


@settings(max_examples=100)
@given(
    st.lists(
        st.lists(st.integers(0, 40), max_size=12, unique=True).map(sorted), min_size=1, max_size=5
    )
)
def test_every_sample_is_of_exactly_one_instant(ticks: list[list[int]]) -> None:
    """None is lost but where a later one of its stream takes its place; stamps increase."""
    stamps = [np.array(t, np.int64) * (GAP_NS // 4) + STAMP_NS for t in ticks]
    stamp_ns, rows = gather(stamps)
    assert (np.diff(stamp_ns) > 0).all()
    for k, own in enumerate(stamps):
        used = rows[rows[:, k] >= 0, k]
        assert (np.diff(used) > 0).all()
        assert len(used) <= len(own)
    assert len(stamp_ns) <= sum(map(len, stamps))
    if len(stamps) == 1:
        np.testing.assert_array_equal(rows[:, 0], np.arange(len(stamps[0])))


def test_nothing_gathers_to_nothing() -> None:
    """A session without messages has no skeletons, and no error."""
    stamp_ns, rows = gather([])
    assert len(stamp_ns) == len(rows) == 0
    session = fed([segment(0, 0)])  # held back until four more agree
    assert len(skeletons(session)[0]) == 0
    assert session.motion_m() == 0.0


def test_a_tree_of_frames_is_composed() -> None:
    """Each link relative to its parent, rotations included, root and root's parent left out."""
    quarter = (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5))  # x to y
    messages = []
    for i in range(N_FRAMES):
        messages += [
            link(i, 'bob_LHipJC', 'bob_LKneeJC', (0.0, 0.0, -0.4)),
            link(i, 'bob_pelvis', 'bob_LHipJC', (0.1, 0.0, 0.0)),
            link(i, 'mocap', 'bob_pelvis', (i, 0.0, 1.0), quarter),
            link(i, 'map', 'mocap', (100.0, 0.0, 0.0)),
            link(i, 'map', 'robot', (5.0, 0.0, 0.0)),
        ]
    session = fed(messages, TF_MESSAGE, TREE)
    _, joints = skeletons(session)
    assert session.mocap_frame == 'mocap'
    # What lies between joint and root is learnt from the first frames.
    for row in joints[-15:]:
        np.testing.assert_allclose(row[0] - [row[0, 0], 0.1, 1.0], 0.0, atol=1e-12)
        np.testing.assert_allclose(row[2] - row[0], [0.0, 0.0, -0.4], atol=1e-12)
    assert np.ptp(np.diff(joints[-15:, 0, 0])) < 1e-9
    assert np.isnan(joints[:, 1]).all()


def test_all_frames_in_one_message_are_learnt_at_once() -> None:
    """A robot_state_publisher sends the whole tree together."""

    def tree(i: int) -> tuple[str, bytes]:
        at = STAMP_NS + i * FRAME_NS
        items = [
            drivers.transform('bob_pelvis', 'bob_LHipJC', (0.1, 0.0, 0.0), stamp_ns=at),
            drivers.transform('mocap', 'bob_pelvis', (i + 1.0, 0.0, 1.0), stamp_ns=at),
        ]
        return MOCAP, drivers.serialise(drivers.tf_message(items))

    _, joints = skeletons(fed([tree(i) for i in range(N_FRAMES)], TF_MESSAGE, TREE))
    np.testing.assert_allclose(joints[:, 0, 0], np.arange(N_FRAMES) + 1.1)


def test_frames_that_hang_on_nothing_known_are_no_skeletons() -> None:
    """A tree that does not reach the MoCap frame, and one that runs in a circle."""
    loose = [link(i, 'elsewhere', 'bob_LHipJC', (1, 2, 3)) for i in range(N_FRAMES)]
    counts = fed(loose, TF_MESSAGE, TREE).counts(MOCAP)
    assert (counts['kept'], counts['unlinked'], counts['skeletons']) == (0, N_FRAMES, 0)
    circle = [
        message
        for i in range(N_FRAMES)
        for message in (
            link(i, 'a', 'bob_LHipJC', (1, 2, 3)), link(i, 'b', 'a', (1, 2, 3)),
            link(i, 'a', 'b', (1, 2, 3)),
        )
    ]  # fmt: skip
    assert fed(circle, TF_MESSAGE, TREE).counts(MOCAP)['skeletons'] == 0


def test_without_a_frame_all_joints_must_hang_on_one() -> None:
    """Else nobody knows which frame the skeleton is wanted in: the rig file has to say."""
    flat = [
        link(i, 'vicon', f'bob_{name}', (1, 2, 3)) for i in range(N_FRAMES) for name in JOINTS[:3]
    ]
    chained = [link(i, 'bob_LHipJC', 'bob_RKneeJC', (1, 2, 3)) for i in range(N_FRAMES)]
    session = fed(flat + chained, TF_MESSAGE, 'topic: /tf, names: "bob_{joint}"')
    assert session.mocap_frame == 'vicon'
    assert session.counts(MOCAP)['skeletons'] == N_FRAMES
    assert session.counts(MOCAP)['needs_mocap_frame'] == N_FRAMES


def test_a_frame_that_changes_its_parent_is_refused() -> None:
    """As a skeleton in another frame is."""
    messages = [link(i, 'mocap', 'bob_LHipJC', (i + 1, 2, 3)) for i in range(N_FRAMES)]
    moved = [link(i, 'map', 'bob_LHipJC', (9, 9, 9)) for i in range(N_FRAMES)]
    session = fed(messages + moved, TF_MESSAGE, TREE)
    assert session.counts(MOCAP)['frame_changed'] == N_FRAMES
    np.testing.assert_array_equal(skeletons(session)[1][:, 0, 0], np.arange(N_FRAMES) + 1.0)
    other = [segment(i, 1, frame_id='other') for i in range(N_FRAMES)]
    assert fed(walk() + other).counts(MOCAP)['frame_changed'] == N_FRAMES


def test_a_flood_of_frames_ends_at_a_bound() -> None:
    """A chain of thousands of parents is not followed."""
    names = [f'f{i}' for i in range(2 * MAX_PARTS)]
    messages = [link(0, 'bob_LHipJC', 'x', (1, 1, 1)), link(0, names[0], 'bob_LHipJC', (1, 1, 1))]
    messages += [link(0, b, a, (1, 1, 1)) for a, b in pairwise(names)]
    session = fed(messages, TF_MESSAGE, TREE)
    assert session.counts(MOCAP)['received'] == len(messages)
    assert session.counts(MOCAP).get('too_many_frames', 0) >= 1


def test_a_bag_that_loops_starts_over() -> None:
    """One backward jump is one new epoch for all parts and all cameras."""
    later = [segment(i + 4000, j) for i in range(N_FRAMES) for j in range(len(JOINTS))]
    session = fed(later + walk())
    stamp_ns, joints = skeletons(session)
    assert session.n_epochs == 1
    assert stamp_ns[-1] < STAMP_NS + N_FRAMES * FRAME_NS
    assert len(stamp_ns) >= N_FRAMES - 5
    assert not np.isnan(joints[5:]).any()


def test_a_camera_whose_clock_jumps_back_ends_the_skeletons_of_before() -> None:
    """Parts and cameras are of one epoch, whichever of them tells of the new one."""
    session = fed([segment(i + 4000, j) for i in range(N_FRAMES) for j in range(len(JOINTS))])
    assert len(skeletons(session)[0]) == N_FRAMES
    for i in [*range(4000, 4009), *range(9)]:
        payload = encode_point_cloud2(STAMP_NS + i * FRAME_NS, 'cam0', np.ones((17, 2)), None)
        session.add('cam0', POINT_CLOUD2, [payload], [i + 1])
    assert session.n_epochs == 1
    assert len(skeletons(session)[0]) == 0
    for stream, payload in walk():
        session.add(stream, POSE_STAMPED, [payload], [1])
    np.testing.assert_array_equal(skeletons(session)[1], whole())


def test_the_store_of_parts_is_bounded_and_can_be_emptied() -> None:
    """By the same numbers as that of whole skeletons."""
    config = SessionConfig(buffer=BufferConfig(max_frames=10))
    session = fed(walk(), config=config)
    assert len(skeletons(session)[0]) == 10
    session.update_config(SessionConfig(buffer=BufferConfig(max_frames=12)))
    for stream, payload in [segment(i, j) for i in range(20, 40) for j in range(4)]:
        session.add(stream, POSE_STAMPED, [payload], [1])
    assert len(skeletons(session)[0]) == 12
    session.reset()
    assert len(skeletons(session)[0]) == 0


def test_after_a_reset_a_driver_may_send_another_frame() -> None:
    """Another root, and places in which poses were: no part of them is refused."""
    session = fed(walk())
    assert session.mocap_frame == 'map'
    session.reset()
    assert session.mocap_frame == ''
    for i in range(N_FRAMES):
        for j in range(len(JOINTS)):
            stream, payload = segment(i, j, frame_id='studio_2')
            session.add(stream, POSE_STAMPED, [payload], [1])
    assert session.mocap_frame == 'studio_2'
    np.testing.assert_array_equal(skeletons(session)[1], whole())
    counts = session.counts(MOCAP)
    assert 'frame_changed' not in counts
    assert counts['cleared'] == counts['kept'] == N_FRAMES * len(JOINTS)
    assert counts['received'] == 2 * N_FRAMES * len(JOINTS)


def test_after_a_reset_a_driver_may_send_whole_skeletons() -> None:
    """And before it may not: which of the two is meant, nobody can tell."""
    links = [link(i, 'mocap', f'bob_{j}', (i, 1, 2)) for i in range(N_FRAMES) for j in JOINTS]
    session = fed(links, TF_MESSAGE, TREE)
    payloads = [
        encode_point_cloud2(STAMP_NS + i * FRAME_NS, 'mocap', x) for i, x in enumerate(whole())
    ]
    session.add(MOCAP, POINT_CLOUD2, payloads, [1] * N_FRAMES)
    assert session.counts(MOCAP)['wrong_type'] == N_FRAMES
    session.reset()
    session.add(MOCAP, POINT_CLOUD2, payloads, [1] * N_FRAMES)
    counts = session.counts(MOCAP)
    assert (counts['kept'], counts['cleared']) == (N_FRAMES, len(links))
    assert counts['received'] == len(links) + 2 * N_FRAMES
    np.testing.assert_array_equal(skeletons(session)[1], whole())


def test_poses_need_a_topic_that_tells_the_joint_and_trees_must_not_have_one() -> None:
    """Otherwise nobody knows whose pose it is; the messages are counted as of a wrong type."""
    bare = Session(rig('topic: /pose'))
    bare.add(MOCAP, POSE_STAMPED, [segment(0, 0)[1]], [1])
    assert bare.counts(MOCAP)['wrong_type'] == 1
    session = Session(rig(SEGMENTS))
    session.add(f'{MOCAP}/LHipJC', TF_MESSAGE, [link(0, 'a', 'b', (1, 2, 3))[1]], [1])
    assert session.counts(MOCAP)['wrong_type'] == 1


def test_units_and_receive_time_hold_for_parts_too() -> None:
    """Millimetres become metres; drivers without stamps are stamped with the arrival."""
    session = fed(walk(), mocap=f'{SEGMENTS}, units: mm')
    np.testing.assert_allclose(skeletons(session)[1], whole() / 1000.0)
    messages = [segment(i, 0, late_ns=-STAMP_NS - i * FRAME_NS) for i in range(9)]
    assert fed(messages).counts(MOCAP)['zero_stamp'] == 9
    config = SessionConfig(sync=SyncConfig(use_receive_time=True))
    session = Session(rig(SEGMENTS), config)
    for i in range(9):
        for j in range(len(JOINTS)):
            stream, payload = segment(i, j, late_ns=-STAMP_NS - i * FRAME_NS - j * 60_000)
            session.add(stream, POSE_STAMPED, [payload], [STAMP_NS + i * FRAME_NS])
    stamp_ns, joints = skeletons(session)
    assert stamp_ns.tolist() == [STAMP_NS + i * FRAME_NS for i in range(9)]
    np.testing.assert_array_equal(joints, whole(9))


@pytest.mark.parametrize(
    ('mocap', 'complaint'),
    [
        (
            'type: geometry_msgs/msg/PoseStamped',
            r'PoseStamped is one joint: give the topic with \{joint\}',
        ),
        (
            'topic: "v/{joint}", type: tf2_msgs/msg/TFMessage',
            r'a topic for each \{joint\} carries',
        ),
        ('topic: "v/{joint}/{joint}"', 'need a topic'),
        ('topic: "v/{join}"', 'need a topic'),
        ('names: bob', r'need a text with \{joint\} once'),
        ('names: "{joint}{joint}"', r'need a text with \{joint\} once'),
        ('type: hri_msgs/msg/Skeleton2D', 'is unknown'),
    ],
)
def test_a_rig_file_that_cannot_be_meant_is_refused(mocap: str, complaint: str) -> None:
    """Each complaint says what is needed."""
    with pytest.raises(InputError, match=complaint):
        rig(mocap)


def test_joint_whose_name_cannot_stand_in_a_topic_is_refused() -> None:
    """The key of the pattern is named, and the topic that it would make."""
    text = RIG.format(mocap=f'{SEGMENTS}, joint_map: {{right_knee: R knee}}')
    with pytest.raises(InputError, match=r"mocap\.topic: 'vicon/bob/R knee' cannot be the topic"):
        parse_rig(text.replace('RKneeJC', 'R knee'))


def test_messages_that_are_no_parts_are_counted() -> None:
    """By reason, as elsewhere."""
    good = segment(0, 0)[1]
    batch, dropped = decode_parts(POSE_STAMPED, [good, good[:-1], b'', good + bytes(300_000)])
    assert batch.index.tolist() == [0]
    assert dropped == {'malformed': 2, 'oversized': 1}
    assert decode_parts('std_msgs/msg/String', [good])[1] == {'wrong_type': 1}
