# SPDX-License-Identifier: Apache-2.0
"""Whatever the bytes are, no adapter raises, and none believes a count."""

from __future__ import annotations

import tracemalloc
from typing import Any, Literal

import drivers
import numpy as np
import pytest
from drivers import NO_TURN
from hypothesis import example, given, settings
from hypothesis import strategies as st

from rpgd_ros.messages import (
    JOINT_TYPES,
    KEYPOINT_TYPES,
    MAX_MESSAGE_BYTES,
    PARTIAL_TYPES,
    SKELETON_TYPES,
    TF_MESSAGE,
    decode,
    decode_parts,
)

# Not even a warning of numpy, at whatever number.
pytestmark = pytest.mark.filterwarnings('error')

NAMES = {'3': (1.0, 2.0, 3.0), 'b.c': (4.0, 5.0, 6.0)}
POSES: dict[str, Any] = {name: (xyz, NO_TURN) for name, xyz in NAMES.items()}
MARKERS = [drivers.marker(name, xyz, index=9) for name, xyz in NAMES.items()]
GOOD = {
    message.__msgtype__: drivers.serialise(message)
    for message in (
        drivers.markers(MARKERS),
        drivers.rigid_bodies(POSES, MARKERS),
        drivers.named_poses(POSES),
        drivers.link_states(POSES),
        drivers.link_states(POSES, package='xsens_mvn_ros_msgs'),
        drivers.marker_array([drivers.rviz_marker(100 + j, (1, 2, 3)) for j in range(2)]),
        drivers.objects([drivers.zed_object(np.ones((18, 2)), np.ones((18, 3)))]),
        drivers.objects(
            [drivers.zed_object(np.ones((18, 2)), package='zed_interfaces')],
            package='zed_interfaces',
        ),
        drivers.skeleton_2d(np.full((18, 3), 0.5)),
        drivers.detections([drivers.detection({1: (5, 6, 0.5)}, n_border=2)]),
        drivers.detections(
            [drivers.detection({1: (5, 6, 0.5)}, package='yolov8_msgs')], package='yolov8_msgs'
        ),
        drivers.openpose_list([np.ones((18, 3))]),
        drivers.pose_stamped((1, 2, 3)),
        drivers.tf_message([drivers.transform('map', 'hip', (1, 2, 3))]),
    )
}
JOINTS = {18: tuple(str(j) for j in range(18)), 2: tuple(NAMES)}


def attempt(msgtype: str, payload: bytes) -> int:
    """Decode bytes as everything they might be; return how often they could be used.

    Each time, the message was either used or counted under one reason; numbers that came out are
    finite places, or missing as a whole.
    """
    n_used = 0
    if msgtype in PARTIAL_TYPES:
        parts, dropped = decode_parts(msgtype, [payload])
        assert len(parts.index) == 0 or not dropped
        assert len(parts.names) == len(parts.values) == len(parts.stamp_ns)
        return len(parts.index)
    dimensions: tuple[Literal[2, 3], ...] = (2, 3)
    for n_values in dimensions:
        for joints in JOINTS.values():
            decoded = decode(msgtype, [payload], joints=joints, n_values=n_values, receive_ns=[1])
            assert sum(decoded.dropped.values()) + (decoded.batch is not None) == 1
            if decoded.batch is not None:
                values = decoded.batch.values
                assert values.shape == (1, len(joints), n_values)
                assert np.array_equal(np.isfinite(values).all(-1), np.isfinite(values).any(-1))
                n_used += 1
    return n_used


def test_there_is_a_good_message_of_every_type() -> None:
    """So that what follows speaks of all of them; and each of them can be used."""
    assert GOOD.keys() == {*SKELETON_TYPES, *KEYPOINT_TYPES} - {*JOINT_TYPES}
    for msgtype, payload in GOOD.items():
        assert attempt(msgtype, payload) > 0, msgtype


@settings(max_examples=300, deadline=None)
@given(st.sampled_from(sorted(GOOD)), st.binary(max_size=400))
def test_random_bytes_are_dropped_without_a_word(msgtype: str, tail: bytes) -> None:
    """Bare, and behind a valid encapsulation."""
    assert attempt(msgtype, tail) == 0
    attempt(msgtype, b'\x00\x01\x00\x00' + tail)


@settings(max_examples=400, deadline=None)
@given(
    msgtype=st.sampled_from(sorted(GOOD)),
    edits=st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)), min_size=1, max_size=5),
)
@example(msgtype='tf2_msgs/msg/TFMessage', edits=[(4, 255), (5, 255), (6, 255), (7, 255)])
def test_changed_bytes_never_raise(msgtype: str, edits: list[tuple[int, int]]) -> None:
    """Counts, lengths of names, stamps and numbers among them."""
    payload = bytearray(GOOD[msgtype])
    for place, value in edits:
        payload[place % len(payload)] = value
    attempt(msgtype, bytes(payload))


@settings(max_examples=400, deadline=None)
@given(
    msgtype=st.sampled_from(sorted(GOOD)),
    edits=st.lists(
        st.tuples(
            st.integers(0, 10**6),
            st.sampled_from([0, 1, 2, 17, 18, 2**31, 2**32 - 1]),
            st.integers(-8, 8),
        ),
        min_size=1,
        max_size=4,
    ),
)
def test_changed_counts_and_moved_bytes_never_raise(
    msgtype: str, edits: list[tuple[int, int, int]]
) -> None:
    """A word is replaced, and what follows moves by some bytes."""
    payload = GOOD[msgtype]
    for place, word, shift in edits:
        at = place % len(payload) // 4 * 4
        tail = payload[at + 4 :]
        tail = bytes(shift) + tail if shift > 0 else tail[-shift:]
        payload = payload[:at] + word.to_bytes(4, 'little') + tail
    attempt(msgtype, payload)


@pytest.mark.parametrize('msgtype', sorted(GOOD))
def test_a_cut_or_lengthened_message_is_dropped(msgtype: str) -> None:
    """No message is complete before its last byte, or goes on after it."""
    payload = GOOD[msgtype]
    for cut in {*range(0, len(payload), max(1, len(payload) // 150)), len(payload) - 1}:
        assert attempt(msgtype, payload[:cut]) == 0, cut
    if msgtype != TF_MESSAGE:  # whose decoder, as tf2, does not look at what follows
        assert attempt(msgtype, payload + bytes(8)) == 0
    assert attempt(msgtype, payload + bytes(MAX_MESSAGE_BYTES)) == 0


@pytest.mark.parametrize('msgtype', sorted(GOOD))
def test_counts_that_lie_allocate_nothing(msgtype: str) -> None:
    """Four billion of anything are refused before anything is built from them."""
    payload = GOOD[msgtype]
    places = range(4, min(len(payload), 600) - 4, 4)
    tracemalloc.start()
    for place in places:
        for claim in (2**28, 2**31, 2**32 - 1):
            lie = payload[:place] + claim.to_bytes(4, 'little') + payload[place + 4 :]
            attempt(msgtype, lie)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 2_000_000


@pytest.mark.parametrize('msgtype', sorted(GOOD))
def test_a_message_of_full_size_is_bounded_in_memory(msgtype: str) -> None:
    """As many elements of the smallest kind as 256 KiB hold, or zeros of that length."""
    tracemalloc.start()
    for filler in (b'\x00', b'\x01', b'\xff'):
        attempt(msgtype, GOOD[msgtype][:24] + filler * (MAX_MESSAGE_BYTES - 24))
        attempt(msgtype, b'\x00\x01\x00\x00\xff\x0f\x00\x00' + filler * (MAX_MESSAGE_BYTES - 8))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 16_000_000
