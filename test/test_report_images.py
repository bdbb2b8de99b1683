# SPDX-License-Identifier: Apache-2.0
"""Images of bags become pictures, whatever encoding they come in; damage becomes a sentence."""

from __future__ import annotations

import struct

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.messages.image import (
    COMPRESSED_IMAGE,
    IMAGE,
    IMAGE_TYPES,
    ImageMessage,
    decode_image,
    encode_compressed_image,
    encode_image,
    image_stamp,
)
from rpgd_ros.report.images import ENCODINGS, to_bgr

STAMP_NS = 1_700_000_000_123_456_789


def picture() -> NDArray[np.uint8]:
    """Make 6 x 8 pixels: left half blue, right half red."""
    image = np.zeros((6, 8, 3), np.uint8)
    image[:, :4] = 250, 20, 10
    image[:, 4:] = 10, 30, 240
    return image


@pytest.mark.parametrize(
    ('encoding', 'conversion'),
    [
        ('bgr8', None),
        ('rgb8', cv2.COLOR_BGR2RGB),
        ('bgra8', cv2.COLOR_BGR2BGRA),
        ('rgba8', cv2.COLOR_BGR2RGBA),
    ],
)
def test_colours_arrive_as_they_were_sent(encoding: str, conversion: int | None) -> None:
    """Blue stays blue, whatever the order on the wire."""
    image = picture()
    sent = image if conversion is None else cv2.cvtColor(image, conversion)
    payload = encode_image(STAMP_NS, 'cam0', (8, 6), sent.tobytes(), encoding)
    message = decode_image(IMAGE, payload)
    assert (message.stamp_ns, message.size) == (STAMP_NS, (8, 6))
    np.testing.assert_array_equal(to_bgr(message), image)


def test_grey_images_become_grey_pictures() -> None:
    """Of 8 and of 16 bit, either end first."""
    grey = np.arange(48, dtype=np.uint8).reshape(6, 8) * 5
    message = decode_image(IMAGE, encode_image(1, '', (8, 6), grey.tobytes(), 'mono8'))
    np.testing.assert_array_equal(to_bgr(message), np.repeat(grey[..., None], 3, 2))
    for is_big, order in ((False, '<u2'), (True, '>u2')):
        data = memoryview((grey.astype(np.uint16) << 8).astype(order).tobytes())
        wide = ImageMessage(1, 'mono16', (8, 6), 16, is_big, data)
        np.testing.assert_array_equal(to_bgr(wide)[..., 0], grey)


def test_rows_may_be_longer_than_their_pixels() -> None:
    """Drivers pad them."""
    padded = np.zeros((6, 32), np.uint8)
    padded[:, :24] = picture().reshape(6, 24)
    message = ImageMessage(1, 'bgr8', (8, 6), 32, is_big=False, data=memoryview(padded.tobytes()))
    np.testing.assert_array_equal(to_bgr(message), picture())


@pytest.mark.parametrize('pattern', ['rggb', 'bggr', 'gbrg', 'grbg'])
def test_a_bayer_pattern_keeps_its_colour(pattern: str) -> None:
    """A red wall is red."""
    wall = np.zeros((16, 16), np.uint8)
    for i, colour in enumerate(pattern):
        wall[i // 2 :: 2, i % 2 :: 2] = 200 if colour == 'r' else 20
    payload = encode_image(1, '', (16, 16), wall.tobytes(), f'bayer_{pattern}8')
    blue, green, red = to_bgr(decode_image(IMAGE, payload))[4:-4, 4:-4].reshape(-1, 3).mean(0)
    assert red > 150
    assert max(blue, green) < 60


@pytest.mark.parametrize('name', ['yuv422', 'yuv422_yuy2'])
def test_a_grey_wall_is_grey_in_both_orders_of_yuv(name: str) -> None:
    """Brightness and colour are told apart."""
    pair = [128, 180, 128, 180] if name == 'yuv422' else [180, 128, 180, 128]
    data = bytes(pair) * (4 * 6)
    image = to_bgr(decode_image(IMAGE, encode_image(1, '', (8, 6), data, name)))
    assert np.ptp(image.reshape(-1, 3).mean(0)) < 3
    assert 160 < image.mean() < 220


@pytest.mark.parametrize('ending', ['.png', '.jpg'])
def test_compressed_images_are_unpacked(ending: str) -> None:
    """PNG to the bit, JPEG to the eye."""
    image = np.repeat(np.repeat(picture(), 8, 0), 8, 1)
    _, data = cv2.imencode(ending, image)
    payload = encode_compressed_image(STAMP_NS, 'cam0', data.tobytes(), ending[1:])
    assert image_stamp(payload) == STAMP_NS
    found = to_bgr(decode_image(COMPRESSED_IMAGE, payload))
    np.testing.assert_allclose(
        found[8:40, 8:24], image[8:40, 8:24], atol=0 if 'png' in ending else 12
    )


def test_an_unknown_encoding_is_named_with_those_that_are_known() -> None:
    """A depth image is no picture."""
    payload = encode_image(1, '', (8, 6), bytes(8 * 6 * 4), '32FC1')
    with pytest.raises(InputError, match="encoding '32FC1'; known: bgr8") as refused:
        to_bgr(decode_image(IMAGE, payload))
    assert refused.value.reason is Reason.BAD_MESSAGE
    assert all(name in refused.value.message for name in ENCODINGS)


def test_a_small_file_that_claims_a_huge_picture_is_not_unpacked() -> None:
    """Looked at before anything is decoded."""
    header = b'\x89PNG\r\n\x1a\n' + struct.pack('>I4sII', 13, b'IHDR', 60_000, 60_000)
    bomb = encode_compressed_image(1, '', header + bytes(40), 'png')
    with pytest.raises(InputError, match='no JPEG or PNG of usual size'):
        to_bgr(decode_image(COMPRESSED_IMAGE, bomb))


def test_fewer_bytes_than_pixels_are_refused() -> None:
    """Whatever the head says."""
    payload = encode_image(1, '', (800, 600), bytes(100), 'bgr8')
    with pytest.raises(InputError, match='800 x 600 pixels has 100 bytes'):
        to_bgr(decode_image(IMAGE, payload))


@settings(derandomize=True, max_examples=150, deadline=None)
@given(st.sampled_from(IMAGE_TYPES), st.integers(0, 200), st.integers(0, 255), st.integers(0, 150))
def test_damaged_messages_give_a_picture_or_our_error(
    msgtype: str, at: int, value: int, length: int
) -> None:
    """Never anything else."""
    _, data = cv2.imencode('.jpg', picture())
    payload = bytearray(
        encode_image(1, 'c', (8, 6), picture().tobytes())
        if msgtype == IMAGE
        else encode_compressed_image(1, 'c', data.tobytes(), 'jpeg')
    )
    payload[at % len(payload)] = value
    try:
        image = to_bgr(decode_image(msgtype, bytes(payload[: len(payload) - length // 2])))
    except InputError as error:
        assert error.reason is Reason.BAD_MESSAGE  # noqa: PT017
    else:
        assert image.ndim == 3
