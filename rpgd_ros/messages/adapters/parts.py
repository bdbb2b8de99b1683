# SPDX-License-Identifier: Apache-2.0
"""Messages that hold one joint of a skeleton, or some of its links."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rpgd_ros.core.errors import InputError
from rpgd_ros.core.geometry import Array, IntArray
from rpgd_ros.messages.adapters.cursor import Cursor
from rpgd_ros.messages.adapters.types import POSE_STAMPED
from rpgd_ros.messages.cdr import MAX_MESSAGE_BYTES, CdrError
from rpgd_ros.messages.layout import Drop, DropError
from rpgd_ros.messages.tf import TF_MESSAGE, decode_tf

LINK_VALUES = 12  # the rotation row by row, then the translation
POSITION_VALUES = 3


@dataclass(frozen=True, slots=True, eq=False)
class PartBatch:
    """N parts of skeletons, in the order they came.

    Attributes:
        index: (N,) position of each one's message among the payloads.
        stamp_ns: (N,) from their headers.
        names: Frames; '' where the topic says whose pose it is.
        parents: Frames that they are given in.
        values: (N, 3) positions, or (N, 12) rotation and translation; NaN = not seen.

    """

    index: IntArray
    stamp_ns: IntArray
    names: tuple[str, ...]
    parents: tuple[str, ...]
    values: Array


_Part = tuple[int, str, str, Array]  # stamp, name, parent, values


def decode_parts(msgtype: str, payloads: Sequence[bytes]) -> tuple[PartBatch, Mapping[str, int]]:
    """Decode serialised messages of parts.

    Args:
        msgtype: PoseStamped or TFMessage; anything else is dropped as `wrong_type`.
        payloads: As on the wire.

    Returns:
        The parts, and the number of messages dropped by reason. Nothing in the bytes raises.

    """
    dropped: dict[str, int] = {}
    index: list[int] = []
    parts: list[_Part] = []
    for i, payload in enumerate(payloads):
        try:
            found = _read(msgtype, payload)
        except DropError as error:
            dropped[error.drop] = dropped.get(error.drop, 0) + 1
            continue
        parts += found
        index += [i] * len(found)
    width = POSITION_VALUES if msgtype == POSE_STAMPED else LINK_VALUES
    values = np.array([part[3] for part in parts]).reshape(-1, width)
    batch = PartBatch(
        np.array(index, np.int64),
        np.array([part[0] for part in parts], np.int64),
        tuple(part[1] for part in parts),
        tuple(part[2] for part in parts),
        values,
    )
    return batch, dropped


def _read(msgtype: str, payload: bytes) -> list[_Part]:
    if len(payload) > MAX_MESSAGE_BYTES:
        raise DropError(Drop.OVERSIZED)
    try:
        if msgtype == POSE_STAMPED:
            return [_read_pose(Cursor(payload))]
        if msgtype == TF_MESSAGE:
            return _read_links(payload)
    except (CdrError, struct.error, InputError) as error:
        raise DropError(Drop.MALFORMED) from error
    raise DropError(Drop.WRONG_TYPE)


def _read_pose(cursor: Cursor) -> _Part:
    """Read a geometry_msgs/PoseStamped."""
    stamp_ns, frame_id = cursor.header()
    place, is_missing = cursor.pose()
    cursor.end()
    return stamp_ns, '', frame_id, np.full(3, np.nan) if is_missing else np.array(place)


def _read_links(payload: bytes) -> list[_Part]:
    """Read a tf2_msgs/TFMessage; what is no transform is left out, so an occluded segment is."""
    parts: list[_Part] = []
    for link in decode_tf(payload):
        pose = link.parent_T_child
        numbers = np.concatenate([pose.rotation.ravel(), pose.translation])
        parts.append((link.stamp_ns, link.child, link.parent, numbers))
    return parts
