# SPDX-License-Identifier: Apache-2.0
"""A reader of nested messages: skips what is of no use, believes no count."""

from __future__ import annotations

import struct
from typing import Final

import numpy as np

from rpgd_ros.core.geometry import Array
from rpgd_ros.messages.cdr import (
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


class Cursor(CdrReader):
    """Reads a message from front to back."""

    def skip(self, size: int, count: int) -> None:
        """Step over `count` numbers of `size` bytes each.

        Raises:
            CdrError: The message ends before.

        """
        self._take(size, count)

    def doubles(self, count: int) -> tuple[float, ...]:
        """Read a few float64; for many, `numbers` is faster."""
        return struct.unpack_from(f'{self.order.mark}{count}d', *self._take(8, count))

    def pose(self) -> tuple[Place, bool]:
        """Read a geometry_msgs/Pose: the place, and whether the body was not seen.

        No rotation has a quaternion of zeros: Vicon's drivers send it of occluded segments, and
        with an offset configured in the driver the place is not zero then.
        """
        x, y, z, *quat_xyzw = self.doubles(7)
        return (x, y, z), not any(quat_xyzw)

    def i32(self) -> int:
        """Read one int32."""
        return self.integers('i', 1)[0]

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
        self.skip(1, self.u32())

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
