# SPDX-License-Identifier: Apache-2.0
"""Whatever the bytes are, the decoder counts and goes on."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from typing import Any

import numpy as np
import peers
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from rosbags.serde import SerdeError

from rpgd_ros.core import InputError, Reason
from rpgd_ros.messages import (
    JOINT_TYPES,
    MAX_MESSAGE_BYTES,
    POINT_CLOUD2,
    POSE_ARRAY,
    Decoded,
    Drop,
    decode_camera_info,
    decode_joints,
    decode_tf,
    encode_point_cloud2,
    encode_pose_array,
)

STAMP_NS = 1_500_000_000
XYZ = np.array([[0.1, -0.2, 1.5], [np.nan, np.nan, np.nan], [0.0, 0.0, 0.0], [1.0, 0.0, 2.0]])
F4XYZ = [('x', '<f4'), ('y', '<f4'), ('z', '<f4')]
UV = [('u', '<f4'), ('v', '<f4')]
GOOD_CLOUD = encode_point_cloud2(STAMP_NS, 'mocap', XYZ, np.ones(4))
GOOD_POSES = encode_pose_array(STAMP_NS, 'mocap', XYZ)


def decode(payloads: list[bytes], msgtype: str = POINT_CLOUD2) -> Decoded:
    """Decode a skeleton of four joints."""
    return decode_joints(msgtype, payloads, n_joints=4, n_values=3)


def cloud(rows: np.ndarray[Any, Any], **keywords: Any) -> bytes:
    """Serialise rows of a cloud."""
    return peers.serialise(peers.point_cloud2(rows, **keywords))


def stamped(sec: int, nanosec: int) -> bytes:
    """Make a message with a stamp that no clock gives."""
    payload = encode_pose_array(STAMP_NS, 'mocap', XYZ)
    return (
        payload[:4] + sec.to_bytes(4, 'little', signed=True) + nanosec.to_bytes(4, 'little')
        + payload[12:]
    )  # fmt: skip


@pytest.mark.fault(10)
@pytest.mark.parametrize(
    ('reason', 'msgtype', 'payload'),
    [
        ('malformed', POINT_CLOUD2, b''),
        ('malformed', POINT_CLOUD2, b'\x00\x01\x00\x00'),
        ('malformed', POINT_CLOUD2, b'\x00\x07' + GOOD_CLOUD[2:]),
        ('malformed', POINT_CLOUD2, GOOD_CLOUD[:-1]),
        ('malformed', POINT_CLOUD2, GOOD_CLOUD + bytes(4)),
        ('malformed', POINT_CLOUD2, cloud(np.zeros(4, F4XYZ), frame_id='f' * 129)),
        ('malformed', POINT_CLOUD2, GOOD_CLOUD.replace(b'mocap', b'moc\xffp')),
        ('malformed', POINT_CLOUD2, GOOD_CLOUD.replace(b'mocap\0', b'mocap.')),
        ('malformed', POSE_ARRAY, GOOD_CLOUD),
        ('malformed', POSE_ARRAY, GOOD_POSES[:-56]),
        ('malformed', POSE_ARRAY, GOOD_POSES[:16] + b'\xff' + GOOD_POSES[17:]),
        ('oversized', POSE_ARRAY, GOOD_POSES + bytes(MAX_MESSAGE_BYTES)),
        ('wrong_type', 'std_msgs/msg/String', GOOD_CLOUD),
        ('wrong_joints', POINT_CLOUD2, cloud(np.zeros(3, F4XYZ))),
        ('wrong_joints', POSE_ARRAY, peers.serialise(peers.pose_array(np.zeros((5, 7))))),
        ('nobody', POINT_CLOUD2, cloud(np.zeros(0, F4XYZ))),
        ('nobody', POSE_ARRAY, peers.serialise(peers.pose_array(np.zeros((0, 7))))),
        ('wrong_joints', POINT_CLOUD2, cloud(np.zeros(6, F4XYZ), height=2)),
        ('wrong_fields', POINT_CLOUD2, cloud(np.zeros(4, UV))),
        ('wrong_fields', POINT_CLOUD2, cloud(np.zeros(4, [(n, '<u4') for n in 'xyz']))),
        ('wrong_fields', POINT_CLOUD2, cloud(np.zeros(4, [(n, '<f4', (2,)) for n in 'xyz']))),
        ('wrong_fields', POINT_CLOUD2, cloud(np.zeros(4, [(f'a{i}', '<f4') for i in range(33)]))),
        ('bad_stamp', POSE_ARRAY, stamped(-1, 0)),
        ('bad_stamp', POSE_ARRAY, stamped(1, 10**9)),
        ('zero_stamp', POSE_ARRAY, stamped(0, 0)),
    ],
)
def test_what_cannot_be_used_is_counted_by_reason(
    reason: str, msgtype: str, payload: bytes
) -> None:
    """Each fault has its name, and good neighbours are used all the same."""
    good = {POINT_CLOUD2: GOOD_CLOUD, POSE_ARRAY: GOOD_POSES}.get(msgtype)
    decoded = decode([payload, *([good] if good else [])], msgtype)
    assert decoded.dropped == {reason: 1}
    if good is not None:
        assert decoded.batch is not None
        assert decoded.batch.index.tolist() == [1]


def test_two_fields_of_one_name_are_refused() -> None:
    """Nobody can know which of them is meant."""
    message = peers.point_cloud2(np.zeros(4, [*F4XYZ, ('w', '<f4')]))
    message.fields[3].name = 'x'
    assert decode([peers.serialise(message)]).dropped == {'wrong_fields': 1}


def test_a_field_beyond_its_point_is_refused() -> None:
    """Joints do not overlap."""
    message = peers.point_cloud2(np.zeros(4, F4XYZ))
    message.fields[2].offset = 10
    assert decode([peers.serialise(message)]).dropped == {'wrong_fields': 1}


def test_data_shorter_than_its_joints_is_malformed() -> None:
    """The last joint may not reach beyond the data."""
    message = peers.point_cloud2(np.zeros(4, F4XYZ))
    message.data = message.data[:-1]
    assert decode([peers.serialise(message)]).dropped == {'malformed': 1}


@pytest.mark.fault(10)
@settings(max_examples=200)
@given(
    is_cloud=st.booleans(),
    edits=st.lists(st.tuples(st.integers(0, 400), st.integers(0, 255)), min_size=1, max_size=6),
    cut=st.integers(0, 400) | st.none(),
)
@example(is_cloud=True, edits=[(24, 2)], cut=None)
@example(is_cloud=False, edits=[(28, 255)], cut=None)
def test_damaged_bytes_are_read_as_rosbags_reads_them_or_dropped(
    *, is_cloud: bool, edits: list[tuple[int, int]], cut: int | None
) -> None:
    """Nothing raises, and what is decoded is what another implementation decodes."""
    msgtype = POINT_CLOUD2 if is_cloud else POSE_ARRAY
    damaged = bytearray(GOOD_CLOUD if is_cloud else GOOD_POSES)
    for position, value in edits:
        damaged[position % len(damaged)] = value
    payload = bytes(damaged)[:cut]
    decoded = decode([payload], msgtype)
    if decoded.batch is None:
        assert len(decoded.dropped) == 1
        assert set(decoded.dropped) <= set(Drop)
        return
    message = peers.read(payload, msgtype)
    assert decoded.batch.frame_id == message.header.frame_id
    stamp = message.header.stamp
    assert decoded.batch.stamp_ns.tolist() == [stamp.sec * 10**9 + stamp.nanosec]
    np.testing.assert_array_equal(decoded.batch.values[0], plausible(positions(message)))


def positions(message: Any) -> np.ndarray[Any, Any]:
    """Return (4, 3) positions of a message as rosbags has read it."""
    if hasattr(message, 'poses'):
        return np.array([[p.position.x, p.position.y, p.position.z] for p in message.poses])
    order = '>' if message.is_bigendian else '<'
    offsets = {field.name: (field.offset, field.datatype) for field in message.fields}
    xyz = np.empty((4, 3))
    for j in range(4):
        for i, name in enumerate('xyz'):
            offset, datatype = offsets[name]
            dtype = np.dtype(f'{order}f{4 if datatype == 7 else 8}')
            start = j * message.point_step + offset
            raw = message.data[start : start + dtype.itemsize].tobytes()
            with np.errstate(invalid='ignore'):
                xyz[j, i] = np.frombuffer(raw, dtype)[0]
    return xyz


def plausible(xyz: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Say of (J, 3) positions what the decoder says, joint by joint."""
    is_good = (np.abs(xyz) <= 1e6).all(1) & (xyz != 0.0).any(1)
    return np.where(is_good[:, None], xyz, np.nan)


@pytest.mark.fault(10)
@settings(max_examples=200)
@given(st.binary(max_size=300), st.sampled_from(JOINT_TYPES))
def test_random_bytes_are_dropped(tail: bytes, msgtype: str) -> None:
    """Even behind a valid encapsulation."""
    decoded = decode([tail, b'\x00\x01\x00\x00' + tail], msgtype)
    assert decoded.batch is None
    assert sum(decoded.dropped.values()) == 2


@settings(max_examples=100)
@given(st.integers(0, len(GOOD_CLOUD) - 1))
def test_a_cut_message_is_refused_by_both(cut: int) -> None:
    """No message is complete before its last byte."""
    assert decode([GOOD_CLOUD[:cut]]).dropped == {'malformed': 1}
    with pytest.raises(SerdeError):
        peers.read(GOOD_CLOUD[:cut], POINT_CLOUD2)


@pytest.mark.threat('S8')
@pytest.mark.parametrize('read', [decode_camera_info, decode_tf])
def test_long_messages_of_facts_are_refused_by_their_length(read: Callable[[bytes], Any]) -> None:
    """A CameraInfo, or a tree of frames, of more than a quarter of a megabyte."""
    with pytest.raises(InputError, match=f'{MAX_MESSAGE_BYTES + 1} bytes, at most') as refused:
        read(b'\x00\x01\x00\x00' + bytes(MAX_MESSAGE_BYTES - 3))
    assert refused.value.reason is Reason.BAD_MESSAGE


@pytest.mark.threat('S8')
def test_counts_that_lie_allocate_nothing() -> None:
    """Four billion fields, poses, characters or bytes are refused before anything is built."""
    lies = []
    for good, places in ((GOOD_CLOUD, (12, 24, 28, 32, 36, 140, 144)), (GOOD_POSES, (12, 24))):
        for place in places:
            for claim in (2**31, 2**32 - 1):
                lie = good[:place] + claim.to_bytes(4, 'little') + good[place + 4 :]
                lies.append((POINT_CLOUD2 if good is GOOD_CLOUD else POSE_ARRAY, lie))
    tracemalloc.start()
    for msgtype, lie in lies:
        decode([lie], msgtype)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1_000_000
