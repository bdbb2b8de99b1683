# SPDX-License-Identifier: Apache-2.0
"""Skeletons of MoCap drivers, whose joints come under names."""

from __future__ import annotations

from typing import Final

from rpgd_ros.messages.adapters.cursor import Cursor, Place
from rpgd_ros.messages.adapters.people import Asked, Named, People

# Least bytes of an element, which the count of a sequence is checked against.
_MARKER: Final = 36
_RIGID_BODY: Final = 64
_NAMED_POSE: Final = 61
_LINK_STATE: Final = 160


def read_markers(cursor: Cursor, asked: Asked) -> People:
    """Read mocap4r2_msgs/Markers.

    `id_type` says which of name and index counts, but Qualisys leaves it at "name" beside empty
    names: a marker without a name is called by its index, as text.
    """
    stamp_ns, frame_id = cursor.header()
    cursor.skip(4, 1)  # frame_number
    joints = Named(asked)
    for _ in range(cursor.count(_MARKER)):
        joints.put(*_marker(cursor))
    cursor.end()
    return People(stamp_ns, frame_id, (joints.person(),))


def _marker(cursor: Cursor) -> tuple[str, Place]:
    cursor.skip(1, 1)  # id_type
    index = cursor.i32()
    name = cursor.name() or str(index)
    x, y, z = cursor.doubles(3)
    return name, (x, y, z)


def read_rigid_bodies(cursor: Cursor, asked: Asked) -> People:
    """Read mocap4r2_msgs/RigidBodies, whose names are `subject.segment` for Vicon.

    Every body repeats all markers of the subject, a hundred times as many bytes as its pose:
    equal blocks are compared, not read.
    """
    stamp_ns, frame_id = cursor.header()
    cursor.skip(4, 1)  # frame_number
    joints = Named(asked)
    blocks: dict[int, bytes] = {}
    for _ in range(cursor.count(_RIGID_BODY)):
        name = cursor.name()
        if not cursor.skip_repeated(blocks):
            _skip_markers(cursor, blocks)
        joints.put(name, *cursor.pose())
    cursor.end()
    return People(stamp_ns, frame_id, (joints.person(),))


def _skip_markers(cursor: Cursor, blocks: dict[int, bytes]) -> None:
    """Step over the markers of a body, and remember their bytes."""
    n_markers = cursor.count(_MARKER)
    start = cursor.position - 4
    for _ in range(n_markers):
        cursor.skip(1, 1)
        cursor.skip(4, 1)
        cursor.skip_string()
        cursor.skip(8, 3)
    blocks[start % 8] = cursor.payload[start : cursor.position]


def read_named_poses(cursor: Cursor, asked: Asked) -> People:
    """Read motion_capture_tracking_interfaces/NamedPoseArray.

    A lost body is left out, so that places in the list mean nothing; a body of one marker has NaN
    for its quaternion and a position all the same.
    """
    stamp_ns, frame_id = cursor.header()
    joints = Named(asked)
    for _ in range(cursor.count(_NAMED_POSE)):
        joints.put(cursor.name(), *cursor.pose())
    cursor.end()
    return People(stamp_ns, frame_id, (joints.person(),))


def read_link_states(cursor: Cursor, asked: Asked) -> People:
    """Read xsens_mvn_msgs/LinkStateArray.

    The segment's name is the frame of its header. The order of the segments is that of a hash
    table. Earlier drivers leave the header of the array empty and stamp every segment.
    """
    stamp_ns, frame_id = cursor.header()
    joints = Named(asked)
    for _ in range(cursor.count(_LINK_STATE)):
        own_stamp_ns, name = cursor.header()
        stamp_ns = stamp_ns or own_stamp_ns
        joints.put(name, *cursor.pose())
        cursor.skip(8, 12)  # twist, accel
    cursor.end()
    return People(stamp_ns, frame_id, (joints.person(),))
