# SPDX-License-Identifier: Apache-2.0
"""Where the joints of a message lie: the part of a message that stays the same in a stream."""

from __future__ import annotations

from enum import StrEnum
from typing import Any, Final, NamedTuple

import numpy as np

from rpgd_ros.messages.cdr import FRAME_OFFSET, Order

POINT_CLOUD2: Final = 'sensor_msgs/msg/PointCloud2'
POSE_ARRAY: Final = 'geometry_msgs/msg/PoseArray'
JOINT_TYPES: Final = (POINT_CLOUD2, POSE_ARRAY)


class Drop(StrEnum):
    """Why a message was dropped."""

    MALFORMED = 'malformed'
    OVERSIZED = 'oversized'
    WRONG_TYPE = 'wrong_type'
    WRONG_FIELDS = 'wrong_fields'
    WRONG_JOINTS = 'wrong_joints'
    NOBODY = 'nobody'
    SEVERAL_PERSONS = 'several_persons'
    FRAME_CHANGED = 'frame_changed'
    ZERO_STAMP = 'zero_stamp'
    BAD_STAMP = 'bad_stamp'


class DropError(Exception):
    """A message that cannot be used.

    Attributes:
        drop: Why.

    """

    def __init__(self, drop: Drop) -> None:
        """Keep the reason."""
        super().__init__(drop)
        self.drop = drop


class Run(NamedTuple):
    """Numbers of a joint that have one type and follow each other.

    Attributes:
        dtype: Their type on the wire.
        offset: Of the first, from the joint's first byte.
        n: How many.

    """

    dtype: np.dtype[Any]
    offset: int
    n: int


class Layout(NamedTuple):
    """Where everything lies; messages of equal layout are decoded together.

    Attributes:
        order: Byte order of the message.
        length: Bytes of the whole message.
        frame_id: From the header.
        start: First byte of the first joint.
        n_joints: Number of joints.
        n_values: Number of coordinates.
        step: Bytes from joint to joint.
        numbers: x y z or u v, then the score where there is one.
        orientation: The quaternion x y z w, where there is one.
        padding: Ranges before `start` that carry no meaning.
        n_persons: Number of skeletons that are read.
        row: Bytes from person to person.
        n_beyond: Further persons, which are not.

    """

    order: Order
    length: int
    frame_id: str
    start: int
    n_joints: int
    n_values: int
    step: int
    numbers: tuple[Run, ...]
    orientation: tuple[Run, ...]
    padding: tuple[tuple[int, int], ...]
    n_persons: int = 1
    row: int = 0
    n_beyond: int = 0

    def mask(self) -> int:
        """Return which bytes before `start` are the same in every message of this layout.

        The stamp is not, and padding holds whatever the sender's memory held: Fast CDR does not
        clear it. To be compared as numbers, `int.from_bytes(payload[:start], 'little') & mask`.
        """
        mask = bytearray(b'\xff' * self.start)
        for first, end in ((2, FRAME_OFFSET), *self.padding):
            mask[first:end] = bytes(end - first)
        return int.from_bytes(mask, 'little')


class Wanted(NamedTuple):
    """What the messages of a stream must hold.

    Attributes:
        msgtype: One of `JOINT_TYPES`.
        n_joints: Number of joints.
        n_values: 3 for a skeleton, 2 for keypoints.

    """

    msgtype: str
    n_joints: int
    n_values: int


class Known(NamedTuple):
    """A layout, and how to see without parsing that another message has it too."""

    layout: Layout
    mask: int
    signature: int

    def fits(self, payload: bytes) -> bool:
        """Tell whether a message has this layout."""
        layout = self.layout
        return len(payload) == layout.length and (
            int.from_bytes(payload[: layout.start], 'little') & self.mask == self.signature
        )
