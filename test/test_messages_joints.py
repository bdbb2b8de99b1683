# SPDX-License-Identifier: Apache-2.0
"""Skeletons and keypoints as rosbags and rclpy write them come out of the decoder."""

from __future__ import annotations

import time
from typing import Any, Literal

import numpy as np
import peers
import pytest

from rpgd_ros.core.geometry import Array
from rpgd_ros.messages import (
    POINT_CLOUD2,
    POSE_ARRAY,
    Decoded,
    JointBatch,
    decode_joints,
    encode_point_cloud2,
    encode_pose_array,
)

XYZ = np.array([[0.1, -0.2, 1.5], [np.nan, np.nan, np.nan], [0.0, 0.0, 0.0], [1.0, 0.0, 2.0]])
STAMP_NS = 1_500_000_000


def table(dtype: Any, **columns: Any) -> np.ndarray[Any, Any]:
    """Make a structured array of columns."""
    rows = np.zeros(len(next(iter(columns.values()))), np.dtype(dtype))
    for name, values in columns.items():
        rows[name] = values
    return rows


def decode(
    payloads: list[bytes], msgtype: str = POINT_CLOUD2, *, n_joints: int = 4, **keywords: Any
) -> Decoded:
    """Decode, a skeleton of four joints unless said."""
    return decode_joints(msgtype, payloads, n_joints=n_joints, **{'n_values': 3, **keywords})


def batch_of(decoded: Decoded) -> JointBatch:
    """Return the batch, of which there must be one."""
    assert decoded.batch is not None
    return decoded.batch


def assert_same(values: Array, expected: Any) -> None:
    """Equal to float32, NaN where NaN."""
    np.testing.assert_allclose(values, expected, rtol=1e-7)


@pytest.mark.parametrize('little_endian', [True, False])
@pytest.mark.parametrize('mark', ['<', '>'])
@pytest.mark.parametrize(
    ('names', 'formats', 'offsets', 'itemsize'),
    [
        (['x', 'y', 'z'], ['f4', 'f4', 'f4'], [0, 4, 8], 12),
        (['x', 'y', 'z'], ['f8', 'f8', 'f8'], [0, 8, 16], 24),
        (['z', 'x', 'y'], ['f4', 'f4', 'f4'], [8, 0, 4], 16),
        (['x', 'y', 'z'], ['f4', 'f4', 'f4'], [8, 4, 0], 12),
        (['a', 'y', 'x', 'z'], ['f4', 'f8', 'f4', 'f4'], [0, 5, 13, 17], 32),
        (['x', 'y', 'z', 'rgb'], ['f4', 'f4', 'f4', 'u4'], [0, 4, 8, 16], 32),
    ],
)
def test_a_skeleton_is_read_whatever_the_order_type_and_place_of_its_fields(
    names: list[str],
    formats: list[str],
    offsets: list[int],
    itemsize: int,
    *,
    mark: str,
    little_endian: bool,
) -> None:
    """Order of fields, float type, padding and both byte orders are the publisher's choice."""
    dtype = np.dtype({
        'names': names,
        'formats': [mark + f for f in formats],
        'offsets': offsets,
        'itemsize': itemsize,
    })  # fmt: skip
    rows = table(dtype, x=XYZ[:, 0], y=XYZ[:, 1], z=XYZ[:, 2])
    message = peers.point_cloud2(rows, is_bigendian=mark == '>')
    batch = batch_of(decode([peers.serialise(message, little_endian=little_endian)]))
    expected = XYZ.copy()
    expected[2] = np.nan
    assert_same(batch.values, expected[None])
    assert batch.stamp_ns.tolist() == [STAMP_NS]
    assert batch.frame_id == 'mocap'
    assert batch.confidence is None


@pytest.mark.parametrize('names', [('u', 'v'), ('x', 'y')])
def test_keypoints_are_read_with_their_scores(names: tuple[str, str]) -> None:
    """2D fields are u v or x y; confidence is a column of its own."""
    rows = table(
        [(names[0], '<f4'), ('confidence', '<f8'), (names[1], '<f4')],
        **{names[0]: [1.5, 640.0], names[1]: [2.5, 480.0], 'confidence': [0.25, 1.0]},
    )
    payload = peers.serialise(peers.point_cloud2(rows))
    batch = batch_of(decode([payload], n_joints=2, n_values=2))
    assert_same(batch.values, [[[1.5, 2.5], [640.0, 480.0]]])
    assert_same(np.asarray(batch.confidence), [[0.25, 1.0]])


@pytest.mark.parametrize('little_endian', [True, False])
@pytest.mark.parametrize('frame_id', ['', 'a', 'mocap', 'frame_of_the_studio'])
def test_poses_give_their_positions(frame_id: str, *, little_endian: bool) -> None:
    """Orientations are ignored; the frame's length moves the alignment of the doubles."""
    poses = np.column_stack([XYZ, np.full((4, 4), 0.5)])
    message = peers.pose_array(poses, frame_id=frame_id)
    payload = peers.serialise(message, little_endian=little_endian)
    batch = batch_of(decode([payload], POSE_ARRAY))
    np.testing.assert_array_equal(batch.values[0, [0, 3]], XYZ[[0, 3]])
    assert np.isnan(batch.values[0, 1:3]).all()
    assert batch.frame_id == frame_id
    flat = batch_of(decode([payload], POSE_ARRAY, n_values=2))
    np.testing.assert_array_equal(flat.values[0, 0], XYZ[0, :2])


def test_a_zero_pose_is_missing_only_with_a_zero_quaternion_where_zeros_are_allowed() -> None:
    """An occluded segment is sent as zeros with a zero quaternion by Vicon's driver."""
    poses = np.zeros((4, 7))
    poses[1:, 6] = 1.0
    payload = peers.serialise(peers.pose_array(poses))
    allowed = decode([payload], POSE_ARRAY, zero_is_missing=False)
    np.testing.assert_array_equal(
        np.isnan(batch_of(allowed).values[0, :, 0]), [True] + 3 * [False]
    )
    assert allowed.missing == {'zero': 1}
    assert decode([payload], POSE_ARRAY).missing == {'zero': 4}


def test_zero_points_are_joints_where_zeros_are_allowed() -> None:
    """A cloud has no quaternion: without `zero_is_missing` only NaN is missing."""
    decoded = decode([encode_point_cloud2(STAMP_NS, 'mocap', XYZ)], zero_is_missing=False)
    np.testing.assert_array_equal(batch_of(decoded).values[0, 2], [0.0, 0.0, 0.0])
    assert decoded.missing == {'nan': 1}


@pytest.mark.fault(11)
@pytest.mark.parametrize('bad', [np.nan, np.inf, -np.inf, 1e300, -2e6])
def test_one_bad_coordinate_makes_its_joint_missing(bad: float) -> None:
    """Half a joint is none; the others stay."""
    values = np.arange(12.0).reshape(4, 3)
    values[2, 1] = bad
    payload = encode_point_cloud2(STAMP_NS, 'mocap', values, dtype='float64')
    decoded = decode([payload])
    values[2] = np.nan
    np.testing.assert_array_equal(batch_of(decoded).values[0], values)
    assert decoded.missing == {'nan': 1}


@pytest.mark.filterwarnings('error')
def test_signalling_nan_is_missing_without_a_warning() -> None:
    """Numpy warns when it widens such a NaN; the log is no place for that."""
    payload = bytearray(encode_point_cloud2(STAMP_NS, 'mocap', np.ones((1, 3))))
    payload[-13:-9] = (0x7FA00000).to_bytes(4, 'little')
    assert decode([bytes(payload)], n_joints=1).missing == {'nan': 1}


def mixed_payloads() -> list[bytes]:
    """Make usable messages of four layouts, in turn."""
    rng = np.random.default_rng(1)
    payloads = []
    for i in range(12):
        values = rng.normal(size=(4, 3))
        scores = rng.random(4) if i % 4 == 1 else None
        stamp_ns = STAMP_NS + i
        if i % 4 < 3:
            dtype: Literal['float32', 'float64'] = 'float64' if i % 4 == 2 else 'float32'
            payloads.append(encode_point_cloud2(stamp_ns, 'mocap', values, scores, dtype=dtype))
        else:
            rows = table([('z', '>f4'), ('y', '>f4'), ('x', '>f4')], x=values[:, 0], y=1, z=2)
            cloud = peers.point_cloud2(rows, stamp_ns=stamp_ns, is_bigendian=True)
            payloads.append(peers.serialise(cloud))
    return payloads


def test_a_batch_gives_what_its_messages_give_one_by_one() -> None:
    """Live is a batch of one; changing layouts cost time, not order or values."""
    payloads = mixed_payloads()
    payloads.insert(5, b'damaged')
    together = batch_of(decode(payloads))
    assert together.confidence is not None
    assert together.index.tolist() == [i for i in range(13) if i != 5]
    for row, i in enumerate(together.index):
        alone = batch_of(decode([payloads[i]]))
        np.testing.assert_array_equal(together.values[row], alone.values[0])
        assert together.stamp_ns[row] == alone.stamp_ns[0]
        scores = np.full(4, np.nan) if alone.confidence is None else alone.confidence[0]
        np.testing.assert_array_equal(together.confidence[row], scores)


def test_what_a_sender_leaves_in_the_padding_changes_nothing() -> None:
    """Fast CDR does not clear the bytes between fields."""
    payload = encode_point_cloud2(STAMP_NS, 'abcd', XYZ)
    noisy = bytearray(payload)
    for start, end in ((2, 4), (21, 24), (42, 44), (49, 52)):
        assert not any(noisy[start:end])
        noisy[start:end] = b'\xa5' * (end - start)
    decoded = decode([payload, bytes(noisy), payload])
    assert not decoded.dropped
    values = batch_of(decoded).values
    np.testing.assert_array_equal(values[0], values[1])


def test_the_frame_of_the_first_message_counts_unless_one_is_given() -> None:
    """A stream has one frame; what comes in another is refused."""
    payloads = [encode_point_cloud2(STAMP_NS, name, XYZ) for name in ('a', 'a', 'b')]
    free = decode(payloads)
    assert (batch_of(free).frame_id, free.dropped) == ('a', {'frame_changed': 1})
    given_b = decode(payloads, frame_id='b')
    assert (batch_of(given_b).index.tolist(), given_b.dropped) == ([2], {'frame_changed': 2})


def test_a_dropped_message_does_not_choose_the_frame() -> None:
    """Only usable messages count, as they do one by one."""
    payloads = [encode_point_cloud2(0, 'a', XYZ), encode_point_cloud2(STAMP_NS, 'b', XYZ)]
    decoded = decode(payloads)
    assert (batch_of(decoded).frame_id, decoded.dropped) == ('b', {'zero_stamp': 1})


def test_zero_stamps_are_used_where_the_stamp_is_not_needed() -> None:
    """With arrival times, header-less drivers are welcome."""
    decoded = decode([encode_point_cloud2(0, 'mocap', XYZ)], needs_stamp=False)
    assert batch_of(decoded).stamp_ns.tolist() == [0]


def test_messages_of_rclpy_are_read() -> None:
    """The middleware's own serialiser, where it is installed."""
    serialization = pytest.importorskip('rclpy.serialization')
    geometry_msgs = pytest.importorskip('geometry_msgs.msg')
    message = geometry_msgs.PoseArray()
    message.header.stamp.sec, message.header.frame_id = 7, 'mocap'
    message.poses = [geometry_msgs.Pose() for _ in XYZ]
    for pose, xyz in zip(message.poses, XYZ, strict=True):
        pose.position.x, pose.position.y, pose.position.z = map(float, xyz)
    poses = batch_of(decode([serialization.serialize_message(message)], POSE_ARRAY))
    sensor_msgs = pytest.importorskip('sensor_msgs.msg')
    cloud = sensor_msgs.PointCloud2(height=1, width=4, point_step=12, row_step=48)
    cloud.header = message.header
    cloud.fields = [
        sensor_msgs.PointField(name=name, offset=4 * i, datatype=7, count=1)
        for i, name in enumerate('xyz')
    ]
    cloud.data = XYZ.astype('<f4').tobytes()
    points = batch_of(decode([serialization.serialize_message(cloud)]))
    assert_same(points.values, poses.values)
    assert (points.stamp_ns.tolist(), points.frame_id) == ([7 * 10**9], 'mocap')


def seconds_per_message(function: Any, payloads: list[bytes]) -> float:
    """Time a function of payloads, the best of five."""
    times = []
    for _ in range(5):
        start = time.perf_counter()
        function(payloads)
        times.append(time.perf_counter() - start)
    return min(times) / len(payloads)


def test_a_batch_is_decoded_five_times_faster_than_message_by_message_in_python() -> None:
    """Why the bytes are read by numpy; side by side, because machines differ."""
    values = np.random.default_rng(0).normal(size=(28, 3))
    payloads = [encode_pose_array(STAMP_NS + i, 'mocap', values) for i in range(100)]
    ours = seconds_per_message(lambda p: decode(p, POSE_ARRAY, n_joints=28), payloads)
    theirs = seconds_per_message(
        lambda p: [peers.read(payload, POSE_ARRAY) for payload in p], payloads
    )
    assert ours < 0.2 * theirs
