# SPDX-License-Identifier: Apache-2.0
"""Images of bags: where their bytes lie. What they look like is told by `report.images`."""

from __future__ import annotations

import struct
from typing import Final, NamedTuple

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.messages.cdr import (
    FRAME_OFFSET,
    MAX_FRAME_ID,
    NS_PER_S,
    STAMP_OFFSET,
    CdrError,
    CdrWriter,
    Order,
    aligned,
    byte_order,
    read_string,
)

IMAGE: Final = 'sensor_msgs/msg/Image'
COMPRESSED_IMAGE: Final = 'sensor_msgs/msg/CompressedImage'
IMAGE_TYPES: Final = (IMAGE, COMPRESSED_IMAGE)
MAX_IMAGE_BYTES: Final = 64 * 2**20  # 4 k by 4 k in colour
MAX_ENCODING: Final = 128  # characters


class ImageMessage(NamedTuple):
    """One image as it was sent.

    Attributes:
        stamp_ns: Acquisition.
        encoding: Of the pixels, as bgr8; of a compressed image, what its sender says.
        size: Width and height, pixels; (0, 0) where only the compressed bytes tell.
        step: Bytes of a row.
        is_big: Whether numbers of several bytes begin with the largest.
        data: Pixels row by row, or the bytes of a JPEG or PNG.

    """

    stamp_ns: int
    encoding: str
    size: tuple[int, int]
    step: int
    is_big: bool
    data: memoryview


def decode_image(msgtype: str, payload: bytes) -> ImageMessage:
    """Read a serialised Image or CompressedImage without copying its pixels.

    Raises:
        InputError: BAD_MESSAGE. Not such a message, cut off, or larger than 64 MiB.

    """
    try:
        return _read(msgtype, payload)
    except (CdrError, struct.error) as error:
        raise InputError(Reason.BAD_MESSAGE, f'not a {msgtype}: {error}') from error


def image_stamp(payload: bytes) -> int:
    """Return the stamp of an Image or CompressedImage; its end may be cut off.

    Raises:
        InputError: BAD_MESSAGE.

    """
    try:
        seconds, nanoseconds = byte_order(payload).stamp.unpack_from(payload, STAMP_OFFSET)
    except (CdrError, struct.error) as error:
        raise InputError(Reason.BAD_MESSAGE, f'not an image: {error}') from error
    return int(seconds) * NS_PER_S + int(nanoseconds)


def encode_image(
    stamp_ns: int, frame_id: str, size: tuple[int, int], data: bytes, encoding: str = 'bgr8'
) -> bytes:
    """Serialise a sensor_msgs/Image of 8-bit pixels, row by row without gaps.

    Raises:
        InputError: A stamp or a frame that cannot be sent.

    """
    width, height = size
    writer = CdrWriter().header(stamp_ns, frame_id).numbers('I', height, width).string(encoding)
    writer.numbers('B', 0).numbers('I', len(data) // max(height, 1), len(data))
    return writer.done() + data


def encode_compressed_image(stamp_ns: int, frame_id: str, data: bytes, format_: str) -> bytes:
    """Serialise a sensor_msgs/CompressedImage: the bytes of a JPEG or PNG.

    Raises:
        InputError: A stamp or a frame that cannot be sent.

    """
    writer = CdrWriter().header(stamp_ns, frame_id).string(format_)
    return writer.numbers('I', len(data)).done() + data


def _read(msgtype: str, payload: bytes) -> ImageMessage:
    if len(payload) > MAX_IMAGE_BYTES:
        msg = f'{len(payload)} bytes, at most {MAX_IMAGE_BYTES}'
        raise CdrError(msg)
    order = byte_order(payload)
    seconds, nanoseconds = order.stamp.unpack_from(payload, STAMP_OFFSET)
    stamp_ns = int(seconds) * NS_PER_S + int(nanoseconds)
    _, position = read_string(payload, FRAME_OFFSET, order, longest=MAX_FRAME_ID)
    size, step, is_big = (0, 0), 0, False
    position = aligned(position, 4)
    if msgtype == IMAGE:
        height, position = _u32(payload, position, order)
        width, position = _u32(payload, position, order)
        size = width, height
    encoding, position = read_string(payload, position, order, longest=MAX_ENCODING)
    if msgtype == IMAGE:
        is_big = payload[position : position + 1] == b'\x01'
        step, position = _u32(payload, aligned(position + 1, 4), order)
    n_bytes, position = _u32(payload, aligned(position, 4), order)
    if position + n_bytes > len(payload):
        msg = f'{n_bytes} bytes of pixels at {position} of {len(payload)}'
        raise CdrError(msg)
    data = memoryview(payload)[position : position + n_bytes]
    return ImageMessage(stamp_ns, encoding, size, step, is_big, data)


def _u32(payload: bytes, position: int, order: Order) -> tuple[int, int]:
    (value,) = order.u32.unpack_from(payload, position)
    return int(value), position + 4
