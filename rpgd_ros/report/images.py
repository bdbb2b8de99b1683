# SPDX-License-Identifier: Apache-2.0
"""Image messages to pictures: blue, green, red, 8 bit."""

from __future__ import annotations

import struct
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.messages.image import ImageMessage

Image = NDArray[np.uint8]

# Encodings of sensor_msgs/image_encodings: bytes per pixel, OpenCV's conversion (None = as is).
ENCODINGS: Final[dict[str, tuple[int, int | None]]] = {
    'bgr8': (3, None),
    '8UC3': (3, None),
    'rgb8': (3, cv2.COLOR_RGB2BGR),
    'bgra8': (4, cv2.COLOR_BGRA2BGR),
    '8UC4': (4, cv2.COLOR_BGRA2BGR),
    'rgba8': (4, cv2.COLOR_RGBA2BGR),
    'mono8': (1, cv2.COLOR_GRAY2BGR),
    '8UC1': (1, cv2.COLOR_GRAY2BGR),
    # OpenCV names the Bayer patterns by their second row.
    'bayer_rggb8': (1, cv2.COLOR_BayerBG2BGR),
    'bayer_bggr8': (1, cv2.COLOR_BayerRG2BGR),
    'bayer_gbrg8': (1, cv2.COLOR_BayerGR2BGR),
    'bayer_grbg8': (1, cv2.COLOR_BayerGB2BGR),
    'yuv422': (2, cv2.COLOR_YUV2BGR_UYVY),
    'uyvy': (2, cv2.COLOR_YUV2BGR_UYVY),
    'yuv422_yuy2': (2, cv2.COLOR_YUV2BGR_YUY2),
    'yuyv': (2, cv2.COLOR_YUV2BGR_YUY2),
}
WIDE: Final = {'mono16': 8, '16UC1': 8}  # encodings of 16 bit, and the bits that are shifted out
MAX_PIXELS: Final = 64 * 2**20  # of a compressed image, which a few bytes may claim
PNG: Final = b'\x89PNG\r\n\x1a\n'
JPEG: Final = b'\xff\xd8'
JPEG_FRAMES: Final = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}  # markers with the size


def to_bgr(message: ImageMessage) -> Image:
    """Return the picture of a message.

    Returns:
        (height, width, 3) blue, green, red; a view of the message where nothing is converted.

    Raises:
        InputError: BAD_MESSAGE. An encoding that is not known, fewer bytes than pixels, or no
            JPEG or PNG.

    """
    return _compressed(message) if message.size == (0, 0) else _raw(message)


def _raw(message: ImageMessage) -> Image:
    width, height = message.size
    shift = WIDE.get(message.encoding)
    n_bytes, conversion = (
        (2, cv2.COLOR_GRAY2BGR) if shift else ENCODINGS.get(message.encoding, (0, None))
    )
    if not n_bytes:
        msg = (
            f'images have encoding {message.encoding[:80]!r}; known: '
            f'{", ".join([*ENCODINGS, *WIDE])}'
        )
        raise InputError(Reason.BAD_MESSAGE, msg)
    step = message.step or width * n_bytes
    if step < width * n_bytes or len(message.data) < step * height or not width * height:
        msg = f'an image of {width} x {height} pixels has {len(message.data)} bytes'
        raise InputError(Reason.BAD_MESSAGE, msg)
    rows = np.frombuffer(message.data, np.uint8, step * height).reshape(height, step)
    pixels = rows[:, : width * n_bytes].reshape(height, width, n_bytes)
    if shift:
        wide = np.ascontiguousarray(pixels).view('>u2' if message.is_big else '<u2')
        pixels = (wide >> shift).astype(np.uint8)
    if conversion is None:
        return pixels
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(pixels), conversion), np.uint8)


def _compressed(message: ImageMessage) -> Image:
    """Decode a JPEG or PNG whose size was looked at before."""
    data = bytes(message.data)
    size = _png_size(data) if data.startswith(PNG) else _jpeg_size(data)
    if size is None or not 0 < size[0] * size[1] <= MAX_PIXELS:
        msg = f'a compressed image ({message.encoding[:80]!r}) is no JPEG or PNG of usual size'
        raise InputError(Reason.BAD_MESSAGE, msg)
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        raise InputError(Reason.BAD_MESSAGE, 'a compressed image is damaged')
    return np.asarray(image, np.uint8)


def _png_size(data: bytes) -> tuple[int, int] | None:
    if len(data) < 24:
        return None
    width, height = struct.unpack_from('>II', data, 16)
    return int(width), int(height)


def _jpeg_size(data: bytes) -> tuple[int, int] | None:
    """Width and height from the frame header of a JPEG, None where there is none."""
    position = 2
    while data.startswith(JPEG) and position + 9 <= len(data) and data[position] == 0xFF:
        if data[position + 1] in JPEG_FRAMES:
            height, width = struct.unpack_from('>HH', data, position + 5)
            return int(width), int(height)
        position += 2 + int.from_bytes(data[position + 2 : position + 4], 'big')
    return None
