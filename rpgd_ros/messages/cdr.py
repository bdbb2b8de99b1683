# SPDX-License-Identifier: Apache-2.0
"""Plain CDR, the wire format of ROS 2: a bounds-checked reader and a writer.

Four bytes of encapsulation say the byte order; alignment counts from the byte after them.
Strings carry their length with the closing NUL, sequences their number of elements.
"""

from __future__ import annotations

import struct
from typing import Final, NamedTuple

import numpy as np

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import Array

ENCAPSULATION_BYTES: Final = 4
STAMP_OFFSET: Final = 4
FRAME_OFFSET: Final = 12
MAX_PADDING: Final = 3  # some vendors fill a message up to a multiple of four bytes
MAX_MESSAGE_BYTES: Final = 256 * 1024
MAX_FRAME_ID: Final = 128
NS_PER_S: Final = 1_000_000_000
_MAX_STAMP_NS: Final = 2**31 * NS_PER_S - 1  # builtin_interfaces/Time counts seconds in an int32


class CdrError(Exception):
    """The bytes are not what the type says."""


class Order(NamedTuple):
    """What one byte order needs.

    Attributes:
        mark: '<' or '>', as struct and numpy write it.
        u32: Reads one uint32 of a buffer at an offset.
        stamp: Reads sec (int32) and nanosec (uint32).
        shape: Reads height, width and number of fields of a PointCloud2.
        field: Reads offset, datatype and count of a PointField.
        cloud: Reads is_bigendian, point_step, row_step and the data's size of a PointCloud2.

    """

    mark: str
    u32: struct.Struct
    stamp: struct.Struct
    shape: struct.Struct
    field: struct.Struct
    cloud: struct.Struct


_ORDERS: Final = {
    bytes([0, little]): Order(
        mark, *(struct.Struct(mark + code) for code in ('I', 'iI', '3I', 'IB3xI', 'B3x3I'))
    )
    for little, mark in enumerate('><')
}


def byte_order(payload: bytes) -> Order:
    """Return the byte order that the encapsulation declares.

    Raises:
        CdrError: Too short, or another encoding than plain CDR.

    """
    order = _ORDERS.get(payload[:2])
    if order is None or len(payload) < FRAME_OFFSET:
        msg = f'not plain CDR: encapsulation {payload[:4].hex()!r}, {len(payload)} bytes'
        raise CdrError(msg)
    return order


def read_string(payload: bytes, position: int, order: Order, *, longest: int) -> tuple[str, int]:
    """Read a string of at most `longest` characters at an aligned position.

    Returns:
        The string and the position after it.

    Raises:
        CdrError: Too long, cut off, without its NUL, or not UTF-8.

    """
    (size,) = order.u32.unpack_from(payload, position)
    start, end = position + 4, position + 4 + size
    # UTF-8 takes four bytes a character at most.
    if not 1 <= size <= 4 * longest + 1 or end > len(payload) or payload[end - 1]:
        msg = f'string of {size} bytes at {position}'
        raise CdrError(msg)
    try:
        text = payload[start : end - 1].decode()
    except UnicodeDecodeError as error:
        msg = f'string at {position} is not UTF-8'
        raise CdrError(msg) from error
    if len(text) > longest:
        msg = f'string of {len(text)} characters at {position}, at most {longest}'
        raise CdrError(msg)
    return text, end


def aligned(position: int, size: int) -> int:
    """Return the next position that holds a number of `size` bytes."""
    return position + (ENCAPSULATION_BYTES - position) % size


class CdrReader:
    """Reads field after field.

    Attributes:
        payload: The whole message.
        order: Byte order.
        position: Of the next byte.

    """

    def __init__(self, payload: bytes) -> None:
        """Start after the encapsulation.

        Raises:
            CdrError: Too long, or not plain CDR.

        """
        if len(payload) > MAX_MESSAGE_BYTES:
            msg = f'{len(payload)} bytes, at most {MAX_MESSAGE_BYTES}'
            raise CdrError(msg)
        self.order = byte_order(payload)
        self.payload = payload
        self.position = ENCAPSULATION_BYTES

    def integers(self, code: str, count: int) -> tuple[int, ...]:
        """Read `count` integers of one struct format code ('i' or 'I').

        Raises:
            CdrError: The message ends before.

        """
        return struct.unpack_from(f'{self.order.mark}{count}{code}', *self._take(4, count))

    def u32(self) -> int:
        """Read one uint32.

        Raises:
            CdrError: The message ends before.

        """
        return self.integers('I', 1)[0]

    def numbers(self, count: int) -> Array:
        """Read (count,) float64.

        Raises:
            CdrError: The message ends before.

        """
        payload, start = self._take(8, count)
        return np.frombuffer(payload, f'{self.order.mark}f8', count, start).astype(np.float64)

    def _take(self, size: int, count: int) -> tuple[bytes, int]:
        """Step over `count` numbers of `size` bytes; return the payload and where they start."""
        start = aligned(self.position, size) if count else self.position
        self.position = start + count * size
        # Compared before anything is built: the count may be any uint32.
        if self.position > len(self.payload):
            msg = f'{count} numbers at {start} reach beyond the {len(self.payload)} bytes'
            raise CdrError(msg)
        return self.payload, start

    def string(self, longest: int) -> str:
        """Read a string.

        Raises:
            CdrError: As `read_string`, or the message ends before.

        """
        start = aligned(self.position, 4)
        if start + 4 > len(self.payload):
            msg = f'string at {start} reaches beyond the {len(self.payload)} bytes'
            raise CdrError(msg)
        text, self.position = read_string(self.payload, start, self.order, longest=longest)
        return text


class CdrWriter:
    """Writes field after field, little endian."""

    def __init__(self) -> None:
        """Start with the encapsulation."""
        self._bytes = bytearray(b'\x00\x01\x00\x00')

    def numbers(self, code: str, *values: float) -> CdrWriter:
        """Append numbers of one struct format code ('I', 'd', ...)."""
        if values:
            self.align(struct.calcsize(f'={code}'))
            self._bytes += struct.pack(f'<{len(values)}{code}', *values)
        return self

    def string(self, text: str) -> CdrWriter:
        """Append a string."""
        raw = text.encode()
        self.numbers('I', len(raw) + 1)
        self._bytes += raw + b'\x00'
        return self

    def header(self, stamp_ns: int, frame_id: str) -> CdrWriter:
        """Append a std_msgs/Header.

        Raises:
            InputError: The stamp or the frame cannot be sent.

        """
        check_frame_id(frame_id)
        return self.numbers('I', *split_stamp(stamp_ns)).string(frame_id)

    def align(self, size: int) -> CdrWriter:
        """Append padding up to where a number of `size` bytes may stand."""
        self._bytes += bytes(aligned(len(self._bytes), size) - len(self._bytes))
        return self

    def done(self) -> bytes:
        """Return the message."""
        return bytes(self._bytes)


def split_stamp(stamp_ns: int) -> tuple[int, int]:
    """Split a stamp into sec and nanosec.

    Raises:
        InputError: Outside what the message type holds.

    """
    if not 0 <= stamp_ns <= _MAX_STAMP_NS:
        msg = f'stamp {stamp_ns} ns is outside 0 to {_MAX_STAMP_NS} ns'
        raise InputError(Reason.BAD_INPUT, msg)
    return divmod(int(stamp_ns), NS_PER_S)


def check_frame_id(frame_id: str) -> None:
    """Refuse a frame name that the decoder would not read back.

    Raises:
        InputError: Longer than `MAX_FRAME_ID`, or with a NUL.

    """
    if len(frame_id) > MAX_FRAME_ID or '\0' in frame_id:
        msg = f'frame {frame_id[:80]!r}: need at most {MAX_FRAME_ID} characters without NUL'
        raise InputError(Reason.BAD_INPUT, msg)
