# SPDX-License-Identifier: Apache-2.0
"""A reader of nested messages: skips what is of no use, believes no count."""

from __future__ import annotations

import struct
from typing import Final, NoReturn

import numpy as np

from rpgd_ros.core.geometry import Array
from rpgd_ros.messages.cdr import (
    ENCAPSULATION_BYTES,
    MAX_FRAME_ID,
    MAX_PADDING,
    NS_PER_S,
    CdrError,
    CdrReader,
    aligned,
)
from rpgd_ros.messages.layout import Drop, DropError

LONGEST_NAME: Final = MAX_FRAME_ID
Place = tuple[float, float, float]
_DOUBLES: Final = {
    (mark, n): struct.Struct(f'{mark}{n}d').unpack_from for mark in '<>' for n in (1, 3, 7)
}


class Cursor(CdrReader):
    """Reads a message from front to back.

    A message has hundreds of fields: the methods that most of them take do their own arithmetic.
    """

    def __init__(self, payload: bytes) -> None:
        """Start after the encapsulation.

        Raises:
            CdrError: Too long, or not plain CDR.

        """
        super().__init__(payload)
        self._size = len(payload)
        self._read_u32 = self.order.u32.unpack_from

    def skip(self, size: int, count: int) -> None:
        """Step over `count` numbers of `size` bytes each.

        Raises:
            CdrError: The message ends before.

        """
        if count:
            position = self.position
            self.position = position + (ENCAPSULATION_BYTES - position) % size + count * size
            if self.position > self._size:
                self._refuse(count * size)

    def u32(self) -> int:
        """Read one uint32.

        Raises:
            CdrError: The message ends before.

        """
        position = self.position + -self.position % 4
        self.position = position + 4
        if self.position > self._size:
            self._refuse(4)
        value: int = self._read_u32(self.payload, position)[0]
        return value

    def skip_sequence(self, size: int, per_element: int = 1) -> None:
        """Step over a sequence whose elements have some numbers of `size` bytes each.

        Raises:
            CdrError: The message ends before.

        """
        self.skip(size, per_element * self.u32())

    def _refuse(self, n_bytes: int) -> NoReturn:
        msg = f'{n_bytes} bytes up to {self.position} reach beyond the {self._size} bytes'
        raise CdrError(msg)

    def doubles(self, count: int) -> tuple[float, ...]:
        """Read a few float64; for many, `numbers` is faster.

        Raises:
            CdrError: The message ends before.

        """
        self.skip(8, count)
        read = _DOUBLES[self.order.mark, count]
        values: tuple[float, ...] = read(self.payload, self.position - 8 * count)
        return values

    def pose(self) -> tuple[Place, bool]:
        """Read a geometry_msgs/Pose: the place, and whether the body was not seen.

        No rotation has a quaternion of zeros: Vicon's drivers send it of occluded segments, and
        with an offset configured in the driver the place is not zero then.
        """
        x, y, z, *quat_xyzw = self.doubles(7)
        return (x, y, z), not any(quat_xyzw)

    def i32(self) -> int:
        """Read one int32."""
        value = self.u32()
        return value - 2**32 if value >= 2**31 else value

    def byte(self) -> int:
        """Read one byte."""
        payload, start = self._take(1, 1)
        return payload[start]

    def floats(self, count: int) -> Array:
        """Read (count,) float32 as float64."""
        payload, start = self._take(4, count)
        with np.errstate(invalid='ignore'):  # widening a signalling NaN
            return np.frombuffer(payload, f'{self.order.mark}f4', count, start).astype(np.float64)

    def name(self) -> str:
        """Read a name, of a joint or a frame."""
        return self.string(LONGEST_NAME)

    def skip_string(self) -> None:
        """Step over a string of any length."""
        self.skip_sequence(1)

    def count(self, least_bytes: int) -> int:
        """Read the length of a sequence whose elements have at least some bytes each.

        Raises:
            CdrError: So many cannot follow.

        """
        n = self.u32()
        if n * least_bytes > len(self.payload) - self.position:
            msg = f'{n} elements in {len(self.payload) - self.position} bytes'
            raise CdrError(msg)
        return n

    def stamp(self) -> int:
        """Read a builtin_interfaces/Time, in ns.

        Raises:
            DropError: BAD_STAMP. No clock gives such a time.

        """
        sec, nanosec = self.i32(), self.u32()
        if sec < 0 or nanosec >= NS_PER_S:
            raise DropError(Drop.BAD_STAMP)
        return sec * NS_PER_S + nanosec

    def header(self) -> tuple[int, str]:
        """Read a std_msgs/Header: stamp in ns, frame."""
        return self.stamp(), self.name()

    def end(self) -> None:
        """Check that the message ends here, but for the padding of some vendors.

        Raises:
            CdrError: More follows.

        """
        if len(self.payload) - self.position > MAX_PADDING:
            msg = f'{len(self.payload) - self.position} bytes too many'
            raise CdrError(msg)

    def skip_repeated(self, blocks: dict[int, bytes], size_of_count: int = 4) -> bool:
        """Step over a block that was read before, where the same bytes stand here.

        Args:
            blocks: Blocks by the phase of their start within eight bytes, which their padding
                depends on.
            size_of_count: Alignment of the block's first number.

        """
        start = aligned(self.position, size_of_count)
        block = blocks.get(start % 8)
        if block is None or not self.payload.startswith(block, start):
            return False
        self.position = start + len(block)
        return True
