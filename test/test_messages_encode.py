# SPDX-License-Identifier: Apache-2.0
"""What the encoders write, rosbags and the decoder read."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import peers
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from rpgd_ros.core import InputError, Reason
from rpgd_ros.messages import (
    MAX_JOINTS,
    POINT_CLOUD2,
    POSE_ARRAY,
    decode_joints,
    encode_point_cloud2,
    encode_pose_array,
)

STAMP_NS = 1_700_000_000_123_456_789
VALUES = np.array([[0.5, -1.25, 2.0], [np.nan, np.nan, np.nan]])


@pytest.mark.parametrize('frame_id', ['', 'a', 'mocap', 'größe'])
@pytest.mark.parametrize('scores', [None, np.array([0.5, 0.25])])
@pytest.mark.parametrize('dtype', ['float32', 'float64'])
@pytest.mark.parametrize('n_values', [2, 3])
def test_rosbags_reads_the_point_cloud_and_writes_the_same_bytes(
    n_values: Literal[2, 3],
    dtype: Literal['float32', 'float64'],
    scores: np.ndarray[Any, Any] | None,
    frame_id: str,
) -> None:
    """Names, offsets, sizes and the data itself; and not a byte differs on the way back."""
    values = VALUES[:, :n_values]
    payload = encode_point_cloud2(STAMP_NS, frame_id, values, scores, dtype=dtype)
    message = peers.read(payload, POINT_CLOUD2)
    names = ['uv', 'xyz'][n_values - 2]
    assert ''.join(f.name for f in message.fields) == names + (
        '' if scores is None else 'confidence'
    )
    size = np.dtype(dtype).itemsize
    assert [f.offset for f in message.fields] == [size * i for i in range(len(message.fields))]
    assert (message.height, message.width, message.is_dense) == (1, 2, False)
    assert message.header.frame_id == frame_id
    table = message.data.view(dtype).reshape(2, -1)
    np.testing.assert_array_equal(table[:, :n_values], values)
    assert peers.serialise(message) == payload
    batch = decode_joints(POINT_CLOUD2, [payload], n_joints=2, n_values=n_values).batch
    assert batch is not None
    np.testing.assert_array_equal(batch.values[0], values)
    if scores is not None:
        np.testing.assert_array_equal(batch.confidence, scores[None])


@pytest.mark.parametrize('frame_id', ['', 'a', 'mocap'])
def test_rosbags_reads_the_poses_and_writes_the_same_bytes(frame_id: str) -> None:
    """Positions with the identity as orientation."""
    payload = encode_pose_array(STAMP_NS, frame_id, VALUES)
    message = peers.read(payload, POSE_ARRAY)
    assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == STAMP_NS
    position, orientation = message.poses[0].position, message.poses[0].orientation
    assert (position.x, position.y, position.z) == (0.5, -1.25, 2.0)
    assert (orientation.x, orientation.y, orientation.z, orientation.w) == (0.0, 0.0, 0.0, 1.0)
    assert peers.serialise(message) == payload


@settings(max_examples=100)
@example(2**31 * 10**9 - 1, '', [1.0, 2.0, 3.0])
@given(
    st.integers(1, 2**31 * 10**9 - 1),
    st.text(max_size=20).filter(lambda text: '\0' not in text),
    st.lists(st.floats(-1e6, 1e6).filter(bool), min_size=3, max_size=12),
)
def test_a_round_trip_changes_nothing(stamp_ns: int, frame_id: str, numbers: list[float]) -> None:
    """Stamp, frame and values, as a cloud of float64 and as poses."""
    if any('\ud800' <= letter <= '\udfff' for letter in frame_id):
        return
    values = np.array(numbers[: len(numbers) // 3 * 3]).reshape(-1, 3)
    for msgtype, payload in (
        (POINT_CLOUD2, encode_point_cloud2(stamp_ns, frame_id, values, dtype='float64')),
        (POSE_ARRAY, encode_pose_array(stamp_ns, frame_id, values)),
    ):
        batch = decode_joints(msgtype, [payload], n_joints=len(values), n_values=3).batch
        assert batch is not None
        assert (batch.stamp_ns.tolist(), batch.frame_id) == ([stamp_ns], frame_id)
        np.testing.assert_array_equal(batch.values[0], values)


def test_a_full_cloud_is_called_dense() -> None:
    """The flag says whether every number is one."""
    assert peers.read(encode_point_cloud2(1, 'a', np.ones((2, 2))), POINT_CLOUD2).is_dense


@pytest.mark.parametrize(
    ('stamp_ns', 'frame_id', 'values', 'scores', 'message'),
    [
        (-1, 'a', np.ones((2, 3)), None, 'stamp -1 ns'),
        (2**31 * 10**9, 'a', np.ones((2, 3)), None, 'stamp'),
        (1, 'a' * 129, np.ones((2, 3)), None, 'at most 128 characters'),
        (1, 'a\0b', np.ones((2, 3)), None, 'without NUL'),
        (1, 'a', np.ones((2, 4)), None, r'got \(2, 4\)'),
        (1, 'a', np.ones(3), None, r'got \(3,\)'),
        (1, 'a', np.ones((0, 3)), None, '1 to 256 joints'),
        (1, 'a', np.ones((MAX_JOINTS + 1, 3)), None, '1 to 256 joints'),
        (1, 'a', np.ones((2, 3)), np.ones(3), r'scores of shape \(3,\)'),
    ],
)
def test_what_no_decoder_would_read_is_not_written(
    stamp_ns: int,
    frame_id: str,
    values: np.ndarray[Any, Any],
    scores: np.ndarray[Any, Any] | None,
    message: str,
) -> None:
    """The caller hears of it, not the reader of the bag."""
    with pytest.raises(InputError, match=message) as refused:
        encode_point_cloud2(stamp_ns, frame_id, values, scores)
    assert refused.value.reason is Reason.BAD_INPUT
