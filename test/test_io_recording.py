# SPDX-License-Identifier: Apache-2.0
"""A rig and a bag make a recording, or it is said what is missing."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bags import KEYPOINTS, SKELETON, START_NS, Message, walk, write_bag

from rpgd_ros.core import Camera, InputError, Reason
from rpgd_ros.io.recording import WINDOW, open_recording
from rpgd_ros.io.rig import Rig, parse_rig
from rpgd_ros.messages import CAMERA_INFO, POINT_CLOUD2, decode_camera_info, encode_camera_info

POSE = 'camera_T_world: {xyz: [0, 0, 5], quat_xyzw: [0, 0, 0, 1]}'
INTRINSICS = 'size: [64, 48], matrix: [50, 0, 32, 0, 50, 24, 0, 0, 1]'
RIG = """
schema: 1
world_frame: studio
mocap: {{joints: [a, b, c, d]{mocap}}}
cameras:
  - {{name: cam0, keypoints: [a, b, c, d], {cam0}, {pose}}}
{more}
"""
CAM1 = f'  - {{name: cam1, keypoints: [a, b, c, d], {INTRINSICS}, {POSE}}}'

MakeBag = Callable[[list[Message]], Path]


def rig(cam0: str = INTRINSICS, *, mocap: str = '', more: str = '') -> Rig:
    """Make a rig of one camera, and more."""
    return parse_rig(RIG.format(cam0=cam0, mocap=mocap, more=more, pose=POSE))


@pytest.fixture
def bag(tmp_path: Path) -> MakeBag:
    """Return a function that writes messages to a bag."""
    return lambda messages: write_bag(tmp_path / 'walk', messages)


def camera_info(receive_ns: int, focal_px: float = 50.0) -> Message:
    """Make the intrinsics of cam0 as a message."""
    camera = Camera('cam0', np.diag([focal_px, focal_px, 1.0]), np.zeros(0), (64, 48))
    payload = encode_camera_info(camera, receive_ns, 'cam0')
    return Message('/cam0/camera_info', CAMERA_INFO, receive_ns, payload)


def test_all_messages_come_by_topic_in_their_order(bag: MakeBag) -> None:
    """Batches are for speed: nothing is lost, doubled or turned around."""
    messages = walk(WINDOW)
    with open_recording(bag(messages), rig()) as recording:
        batches = list(recording.batches())
        assert recording.n_messages == 2 * WINDOW
        assert recording.source.problem == ''
    assert {batch.topic for batch in batches} == {'mocap/skeleton', 'cam0/keypoints'}
    assert {batch.msgtype for batch in batches} == {POINT_CLOUD2}
    assert max(len(batch.payloads) for batch in batches) == WINDOW // 2
    for topic, name in ((SKELETON, 'mocap/skeleton'), (KEYPOINTS, 'cam0/keypoints')):
        expected = [(m.receive_ns, m.payload) for m in messages if m.topic == topic]
        got = [
            pair
            for batch in batches
            if batch.topic == name
            for pair in zip(batch.receive_ns, batch.payloads, strict=True)
        ]
        assert got == expected


def test_what_is_new_of_a_camera_stands_between_the_keypoints_of_before_and_after(
    bag: MakeBag,
) -> None:
    """Repeated CameraInfos are passed over; another one parts the batches."""
    messages = walk(30)
    middle = messages[20].receive_ns
    infos = [camera_info(START_NS), camera_info(START_NS + 5), camera_info(middle, 60.0)]
    wanting = rig('camera_info_topic: cam0/camera_info')
    with open_recording(
        bag(sorted([*messages, *infos], key=lambda m: m.receive_ns)), wanting
    ) as recording:
        batches = list(recording.batches(['cam0/camera_info']))
    focal = [
        decode_camera_info(b.payloads[0]).matrix[0, 0] if b.msgtype == CAMERA_INFO else None
        for b in batches
    ]
    assert [f for f in focal if f] == [50.0, 60.0]
    cut = focal.index(60.0)
    before = [t for b, f in zip(batches[:cut], focal[:cut], strict=True) if not f for t in b[2]]
    after = [t for b in batches[cut + 1 :] for t in b.receive_ns]
    assert max(before) <= middle <= min(after)
    assert len(before) + len(after) == len(messages)


def test_facts_are_read_alone(bag: MakeBag) -> None:
    """In their order; topics that the bag has not are no error."""
    infos = [camera_info(START_NS + 10**9), camera_info(START_NS + 2 * 10**9, 60.0)]
    wanting = rig('camera_info_topic: cam0/camera_info')
    with open_recording(bag([*walk(), *infos]), wanting) as recording:
        found = list(recording.facts(['cam0/camera_info', '/tf_static']))
    assert [topic for topic, _ in found] == ['cam0/camera_info'] * 2
    assert [decode_camera_info(p).matrix[0, 0] for _, p in found] == [50.0, 60.0]


def test_a_silent_camera_is_a_warning_while_another_speaks(bag: MakeBag) -> None:
    """The others still give a calibration."""
    with open_recording(bag(walk()), rig(more=CAM1)) as recording:
        (warning,) = recording.warnings
        assert "camera cam1: no messages on '/cam1/keypoints'" in warning
        assert set(recording.topics) == {SKELETON, KEYPOINTS}


def refusal(path: Path, wanting: Rig) -> InputError:
    """Open a recording that must be refused."""
    with pytest.raises(InputError) as refused, open_recording(path, wanting):
        pytest.fail('accepted')
    return refused.value


def test_a_bag_without_the_skeleton_says_which_topics_it_has(bag: MakeBag) -> None:
    """Found, needed: the user sees the typing error."""
    error = refusal(bag(walk(3)), rig(mocap=', topic: mocap/skeletons'))
    assert error.reason is Reason.MISSING_TOPIC
    assert "looked for '/mocap/skeletons'" in error.message
    assert f'{SKELETON} ({POINT_CLOUD2}, 3 messages)' in error.message
    assert KEYPOINTS in error.message


def test_a_bag_without_any_keypoints_names_all_it_looked_for(bag: MakeBag) -> None:
    """One camera may be silent, not all."""
    skeletons = [m for m in walk(3) if m.topic == SKELETON]
    error = refusal(bag(skeletons), rig(more=CAM1))
    assert error.reason is Reason.MISSING_TOPIC
    assert "'/cam0/keypoints', '/cam1/keypoints'" in error.message


def test_an_empty_bag_is_called_empty(bag: MakeBag) -> None:
    """Not 'missing topic', which would send the user to the rig file."""
    error = refusal(bag([]), rig())
    assert error.reason is Reason.BAD_BAG
    assert 'holds no messages at all' in error.message


def test_a_camera_without_intrinsics_anywhere_is_named(bag: MakeBag) -> None:
    """The rig file has none, and the bag neither."""
    error = refusal(bag(walk(3)), rig('camera_info_topic: cam0/info'))
    assert error.reason is Reason.MISSING_INTRINSICS
    assert 'camera cam0' in error.message
    assert "'/cam0/info'" in error.message


@pytest.mark.parametrize('given', ['', ', type: geometry_msgs/msg/PoseArray'])
def test_a_topic_of_another_type_is_refused(bag: MakeBag, given: str) -> None:
    """Camera images under the name of keypoints, or not the type that the rig file says."""
    messages = walk(3)
    if not given:
        messages = [m._replace(msgtype='std_msgs/msg/String') for m in messages]
    error = refusal(bag(messages), rig(mocap=given))
    assert error.reason is Reason.BAD_BAG
    assert messages[0].msgtype in error.message
    assert 'PoseArray' in error.message


def test_a_long_list_of_topics_is_cut(bag: MakeBag) -> None:
    """A robot records hundreds."""
    message = walk(1)[0]
    error = refusal(bag([message._replace(topic=f'/t{i:02}') for i in range(25)]), rig())
    assert '/t19' in error.message
    assert '/t20' not in error.message
    assert error.message.endswith('and 5 more')


def test_the_bag_is_closed_after_a_refusal(bag: MakeBag) -> None:
    """No file stays open."""
    path = bag(walk(1))
    fds = Path('/proc/self/fd')
    before = len(list(fds.iterdir()))
    refusal(path, rig(mocap=', topic: other'))
    assert len(list(fds.iterdir())) == before
