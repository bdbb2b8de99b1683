# SPDX-License-Identifier: Apache-2.0
"""tf2_msgs/TFMessage to transforms and back, without tf2."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import RigidTransform
from rpgd_ros.messages.cdr import MAX_FRAME_ID, NS_PER_S, CdrError, CdrReader, CdrWriter

TF_MESSAGE: Final = 'tf2_msgs/msg/TFMessage'

LEAST_BYTES: Final = 80  # of a transform with two empty names: the count is checked against it
FARTHEST_M: Final = 1e7  # a translation beyond it is damage; the Earth is as large
UNIT_NORM_TOLERANCE: Final = 0.01  # a quaternion written with two decimals


@dataclass(frozen=True, slots=True, eq=False)
class Link:
    """One edge of the tree of frames.

    Attributes:
        parent: `header.frame_id`.
        child: `child_frame_id`.
        parent_T_child: Pose of the child's origin in the parent.
        stamp_ns: From the header.

    """

    parent: str
    child: str
    parent_T_child: RigidTransform
    stamp_ns: int = 0


def decode_tf(payload: bytes) -> tuple[Link, ...]:
    """Read a serialised tf2_msgs/TFMessage.

    Names lose the leading slash that drivers of other times gave them. A transform that is none
    (no unit quaternion, not finite, a frame that is its own parent or has no name) is left out, as
    by tf2; the others of the message count.

    Raises:
        InputError: BAD_MESSAGE. Not a TFMessage.

    """
    try:
        links = _read_links(CdrReader(payload))
    except (CdrError, struct.error) as error:
        msg = f'not a {TF_MESSAGE}: {error}'
        raise InputError(Reason.BAD_MESSAGE, msg) from error
    return tuple(link for link in links if link is not None)


def _read_links(reader: CdrReader) -> list[Link | None]:
    n_transforms = reader.u32()
    if n_transforms * LEAST_BYTES > len(reader.payload):
        msg = f'{n_transforms} transforms in {len(reader.payload)} bytes'
        raise CdrError(msg)
    return [_read_link(reader) for _ in range(n_transforms)]


def _read_link(reader: CdrReader) -> Link | None:
    sec, nanosec = reader.integers('i', 1)[0], reader.u32()
    parent = reader.string(MAX_FRAME_ID).removeprefix('/')
    child = reader.string(MAX_FRAME_ID).removeprefix('/')
    numbers = reader.numbers(7)
    xyz, quat_xyzw = numbers[:3], numbers[3:]
    with np.errstate(over='ignore', invalid='ignore'):  # damaged numbers compare as False
        is_rigid = abs(float(np.linalg.norm(quat_xyzw)) - 1.0) <= UNIT_NORM_TOLERANCE
        is_rigid &= bool(np.abs(xyz).max() <= FARTHEST_M)
    if not is_rigid or not parent or not child or parent == child:
        return None
    pose = RigidTransform.from_quat_xyzw(xyz, quat_xyzw)
    return Link(parent, child, pose, sec * NS_PER_S + nanosec)


def encode_tf(links: Sequence[Link]) -> bytes:
    """Serialise a tf2_msgs/TFMessage.

    Raises:
        InputError: A stamp or a frame that cannot be sent.

    """
    writer = CdrWriter().numbers('I', len(links))
    for link in links:
        writer.header(link.stamp_ns, link.parent).string(link.child)
        writer.numbers('d', *link.parent_T_child.translation.tolist())
        writer.numbers('d', *link.parent_T_child.quat_xyzw.tolist())
    return writer.done()
