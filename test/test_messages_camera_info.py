# SPDX-License-Identifier: Apache-2.0
"""CameraInfo to cameras: models, rectification, binning and regions of interest."""

from __future__ import annotations

import contextlib
import struct
from typing import Any

import cv2
import numpy as np
import peers
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rpgd_ros.core import Camera, InputError, Reason, RigidTransform
from rpgd_ros.core.geometry import so3_exp
from rpgd_ros.messages import CAMERA_INFO, decode_camera_info, encode_camera_info

K = np.array([[1100.0, 0.0, 960.0], [0.0, 1090.0, 540.0], [0.0, 0.0, 1.0]])
PLUMB_BOB = [-0.2, 0.1, 0.001, -0.002, 0.01]
R = so3_exp([0.01, -0.02, 0.03])
P = np.column_stack([np.diag([0.9, 0.9, 1.0]) @ K, np.zeros(3)])


def camera_info(**changes: Any) -> Any:
    """Make a CameraInfo as rosbags knows it."""
    fields = {
        'header': peers.header(5, 'cam0_optical_frame'), 'height': 1080, 'width': 1920,
        'distortion_model': 'plumb_bob', 'd': PLUMB_BOB, 'k': K, 'r': np.eye(3),
        'p': P, 'binning_x': 0, 'binning_y': 0,
        'roi': (0, 0, 0, 0), 'do_rectify': False,
    } | changes  # fmt: skip
    for name in 'dkrp':
        fields[name] = np.asarray(fields[name], dtype=np.float64).reshape(-1)
    roi = peers.make(
        'sensor_msgs/msg/RegionOfInterest', *fields.pop('roi'), fields.pop('do_rectify')
    )
    return peers.make(CAMERA_INFO, *fields.values(), roi)


def payload(**changes: Any) -> bytes:
    """Serialise a CameraInfo."""
    return peers.serialise(camera_info(**changes))


@pytest.mark.parametrize(
    ('model', 'd', 'expected', 'length'),
    [
        ('plumb_bob', PLUMB_BOB, 'pinhole', 5),
        ('plumb_bob', PLUMB_BOB[:4], 'pinhole', 4),
        ('plumb_bob', [], 'pinhole', 0),
        ('', [], 'pinhole', 0),
        ('', [0.0] * 5, 'pinhole', 0),
        ('rational_polynomial', [0.1] * 8, 'pinhole', 8),
        ('rational_polynomial', [0.1] * 8 + [0.0] * 6, 'pinhole', 8),
        ('rational_polynomial', [0.1] * 3 + [0.0] * 5, 'pinhole', 4),
        ('equidistant', [0.1, 0.01, 0.001, 0.0], 'equidistant', 4),
        ('fisheye', [0.1], 'equidistant', 4),
    ],
)
@pytest.mark.parametrize('little_endian', [True, False])
def test_the_models_of_ros_are_those_of_opencv(
    model: str, d: list[float], expected: str, length: int, *, little_endian: bool
) -> None:
    """Coefficients keep their order; zeros at the end may be left out."""
    message = camera_info(distortion_model=model, d=d)
    info = decode_camera_info(peers.serialise(message, little_endian=little_endian))
    assert (info.model, info.distortion.size) == (expected, length)
    np.testing.assert_array_equal(info.distortion[: len(d)], d[:length])
    np.testing.assert_array_equal(info.matrix, K)
    assert (info.size, info.frame_id, info.stamp_ns) == ((1920, 1080), 'cam0_optical_frame', 5)


@pytest.mark.parametrize(
    ('distortion', 'model'),
    [([], 'pinhole'), (PLUMB_BOB[:4], 'pinhole'), (PLUMB_BOB, 'pinhole'),
     ([0.1, 0.02, 0.0, 0.0, 0.0, 0.05, 0.0, 0.0], 'pinhole'),
     ([0.1, 0.01, 0.0, 0.0], 'equidistant')],
)  # fmt: skip
def test_a_camera_that_was_sent_projects_as_before(distortion: list[float], model: Any) -> None:
    """Encoded, read by rosbags, serialised by it, decoded."""
    camera = Camera('cam0', K, np.array(distortion), (1920, 1080), model=model)
    sent = encode_camera_info(camera, 7, 'cam0_optical_frame')
    message = peers.read(sent, CAMERA_INFO)
    assert peers.serialise(message) == sent
    received = decode_camera_info(sent).camera('cam0', None)
    x_camera = np.random.default_rng(0).uniform([-1, -1, 2], [1, 1, 4], (50, 3))
    np.testing.assert_allclose(
        received.project_camera(x_camera), camera.project_camera(x_camera), rtol=1e-14
    )


def test_rectified_keypoints_take_p_without_distortion_and_axes_turned_by_r() -> None:
    """As OpenCV undistorts: R and P are what `undistortPoints` is given."""
    pose = RigidTransform(so3_exp([0.3, 0.2, -0.1]), np.array([0.1, 0.2, 3.0]))
    info = decode_camera_info(payload(r=R))
    x_world = np.random.default_rng(1).uniform(-0.5, 0.5, (20, 3))
    raw = info.camera('cam0', pose).project(x_world)
    expected = cv2.undistortPoints(raw[:, None], K, np.array(PLUMB_BOB), None, R, P)
    rectified = info.camera('cam0', pose, is_rectified=True)
    assert not rectified.distortion.any()
    np.testing.assert_allclose(rectified.project(x_world), expected[:, 0], atol=0.01)


def test_a_rectification_of_zeros_turns_nothing() -> None:
    """Drivers without one leave R at zero."""
    info = decode_camera_info(payload(r=np.zeros(9)))
    np.testing.assert_array_equal(info.rectification, np.eye(3))


def test_binning_and_region_of_interest_move_the_pixels() -> None:
    """K speaks of the full image; keypoints were found in the one delivered."""
    message = payload(roi=(100, 50, 800, 1000), binning_x=2, binning_y=4)
    info = decode_camera_info(message)
    whole = decode_camera_info(payload())
    assert info.size == (500, 200)
    x_camera = np.array([[0.1, 0.2, 2.0]])
    uv = whole.camera('a', None).project_camera(x_camera)
    delivered = info.camera('a', None).project_camera(x_camera)
    # The region is x_offset, y_offset, height, width: 100 px from the left, 50 px from the top.
    np.testing.assert_allclose(delivered, (uv - [100.0, 50.0]) / [2.0, 4.0])


@pytest.mark.parametrize('do_rectify', [False, True])
def test_rectified_images_are_cropped_and_binned_as_well(*, do_rectify: bool) -> None:
    """P moves like K, whether or not the driver wants a region of its own for them."""
    changes = {'r': R, 'roi': (100, 50, 800, 1000), 'binning_x': 2, 'binning_y': 4}
    info = decode_camera_info(payload(**changes, do_rectify=do_rectify))
    whole = decode_camera_info(payload(r=R))
    x_camera = np.array([[0.1, 0.2, 2.0]])
    uv = whole.camera('a', None, is_rectified=True).project(x_camera)
    delivered = info.camera('a', None, is_rectified=True).project(x_camera)
    np.testing.assert_allclose(delivered, (uv - [100.0, 50.0]) / [2.0, 4.0])


def test_a_rectified_fisheye_is_a_pinhole() -> None:
    """As OpenCV's fisheye undistorts: R and P are what its `undistortPoints` is given."""
    d = [0.1, 0.01, 0.001, 0.0]
    info = decode_camera_info(payload(distortion_model='equidistant', d=d, r=R))
    x_camera = np.random.default_rng(2).uniform([-1, -1, 2], [1, 1, 3], (20, 3))
    raw = info.camera('cam0', None).project(x_camera)
    expected = cv2.fisheye.undistortPoints(raw[:, None], K, np.array(d), None, R, P[:, :3])
    rectified = info.camera('cam0', None, is_rectified=True)
    assert rectified.model == 'pinhole'
    np.testing.assert_allclose(rectified.project(x_camera), expected[:, 0], atol=0.01)


@pytest.mark.parametrize(
    ('changes', 'reason', 'message'),
    [
        ({'k': np.zeros(9)}, Reason.MISSING_INTRINSICS, "'cam0_optical_frame' is uncalibrated"),
        ({'distortion_model': 'brown'}, Reason.BAD_MESSAGE, "'brown'; known: plumb_bob"),
        ({'d': [0.1] * 8}, Reason.BAD_MESSAGE, 'plumb_bob takes 5 finite coefficients'),
        ({'d': [0.1, np.nan]}, Reason.BAD_MESSAGE, 'finite'),
        ({'d': [0.1] * 15}, Reason.BAD_MESSAGE, '15 distortion coefficients, at most 14'),
        ({'k': [-1.0, *K.flat[1:]]}, Reason.BAD_MESSAGE, 'focal lengths must be positive'),
        ({'k': [np.nan, *K.flat[1:]]}, Reason.BAD_MESSAGE, 'K of CameraInfo'),
        ({'width': 0}, Reason.BAD_MESSAGE, 'image size must be positive'),
    ],
)
def test_intrinsics_that_cannot_be_are_refused(
    changes: dict[str, Any], reason: Reason, message: str
) -> None:
    """An uncalibrated camera is said to be one."""
    with pytest.raises(InputError, match=message) as refused:
        decode_camera_info(payload(**changes)).camera('cam0', None)
    assert refused.value.reason is reason


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('field', ['d', 'k', 'r', 'p'])
@pytest.mark.parametrize('little_endian', [True, False])
def test_signalling_nan_is_refused_without_a_warning(field: str, *, little_endian: bool) -> None:
    """Numpy warns where it asks such a NaN for anything; the log is no place for that."""
    whole: dict[str, Any] = {'d': PLUMB_BOB, 'k': K, 'r': R, 'p': P}
    marked, mark = np.array(whole[field]).ravel(), 123.456
    marked[1] = mark
    message = peers.serialise(camera_info(**{field: marked}), little_endian=little_endian)
    order = '<' if little_endian else '>'
    nan = struct.pack(f'{order}Q', 0x7FF4000000000000)
    assert message.count(struct.pack(f'{order}d', mark)) == 1
    with pytest.raises(InputError, match='finite'):
        decode_camera_info(message.replace(struct.pack(f'{order}d', mark), nan))


def test_rectified_keypoints_need_a_rectification() -> None:
    """P of zeros is none."""
    info = decode_camera_info(payload(p=np.zeros(12)))
    with pytest.raises(InputError, match='P of CameraInfo is zero') as refused:
        info.camera('cam0', None, is_rectified=True)
    assert refused.value.reason is Reason.MISSING_INTRINSICS


@pytest.mark.filterwarnings('error')
@settings(max_examples=200)
@given(
    st.lists(st.tuples(st.integers(0, 400), st.integers(0, 255)), max_size=5),
    st.integers(0, 400) | st.none(),
)
def test_damaged_bytes_give_a_camera_or_a_reason(
    edits: list[tuple[int, int]], cut: int | None
) -> None:
    """No other error leaves the decoder."""
    damaged = bytearray(payload(r=R))
    for position, value in edits:
        damaged[position % len(damaged)] = value
    with contextlib.suppress(InputError):
        info = decode_camera_info(bytes(damaged)[:cut])
        info.camera('cam0', None)
        info.camera('cam0', None, is_rectified=True)
