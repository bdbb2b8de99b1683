# SPDX-License-Identifier: Apache-2.0
"""Lines, names and figures for RViz and Foxglove, written without ROS."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from rpgd_ros.core.geometry import Array, RigidTransform
from rpgd_ros.messages.cdr import CdrWriter

MARKER_ARRAY: Final = 'visualization_msgs/msg/MarkerArray'
TRANSFORM_STAMPED: Final = 'geometry_msgs/msg/TransformStamped'
POSE_WITH_COVARIANCE: Final = 'geometry_msgs/msg/PoseWithCovarianceStamped'
STRING: Final = 'std_msgs/msg/String'
FLOAT64: Final = 'std_msgs/msg/Float64'
LINE_LIST: Final = 5
TEXT: Final = 9
ADD: Final = 0

Colour = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Marker:
    """One set of lines, or one text.

    Attributes:
        namespace: Group that a viewer may switch off.
        number: Within the group.
        points: (2 N, 3) ends of lines, metres; (1, 3) the place of a text.
        colour: Red, green, blue, opacity; 0 to 1.
        size: Width of lines, or height of letters, metres.
        text: '' = lines.

    """

    namespace: str
    number: int
    points: Array
    colour: Colour
    size: float
    text: str = ''


def encode_markers(stamp_ns: int, frame_id: str, markers: Sequence[Marker]) -> bytes:
    """Serialise a visualization_msgs/MarkerArray; points that are missing are left out.

    Args:
        stamp_ns: Of all markers.
        frame_id: In which their points are.
        markers: What to show.

    Raises:
        InputError: A stamp or a frame that cannot be sent.

    """
    writer = CdrWriter().numbers('I', len(markers))
    for marker in markers:
        _write(writer.header(stamp_ns, frame_id), marker)
    return writer.done()


def encode_transform(
    stamp_ns: int, parent: str, child: str, parent_T_child: RigidTransform
) -> bytes:
    """Serialise a geometry_msgs/TransformStamped.

    Raises:
        InputError: A stamp or a frame that cannot be sent.

    """
    writer = CdrWriter().header(stamp_ns, parent).string(child)
    writer.numbers('d', *parent_T_child.translation.tolist())
    return writer.numbers('d', *parent_T_child.quat_xyzw.tolist()).done()


def encode_pose(stamp_ns: int, parent: str, pose: RigidTransform, covariance: Array) -> bytes:
    """Serialise a geometry_msgs/PoseWithCovarianceStamped.

    Args:
        stamp_ns: Stamp.
        parent: Frame that the pose is in.
        pose: The pose.
        covariance: (6, 6) of (d_rot [rad], d_t [m]), axes of the parent frame.

    Raises:
        InputError: A stamp or a frame that cannot be sent.

    """
    writer = CdrWriter().header(stamp_ns, parent).numbers('d', *pose.translation.tolist())
    writer.numbers('d', *pose.quat_xyzw.tolist())
    return writer.numbers('d', *ros_covariance(covariance)).done()


def ros_covariance(covariance: Array) -> list[float]:
    """Return a pose's covariance as ROS has it: 36 numbers, x y z rotX rotY rotZ.

    Both turn about the fixed axes of the parent frame; ours, (6, 6), is rotation first.
    """
    order = [3, 4, 5, 0, 1, 2]
    out: list[float] = covariance[np.ix_(order, order)].ravel().tolist()
    return out


def encode_text(text: str) -> bytes:
    """Serialise a std_msgs/String."""
    return CdrWriter().string(text).done()


def encode_number(value: float) -> bytes:
    """Serialise a std_msgs/Float64."""
    return CdrWriter().numbers('d', value).done()


def _write(writer: CdrWriter, marker: Marker) -> None:
    """Append everything of a visualization_msgs/Marker after its header."""
    is_text = bool(marker.text)
    pairs = marker.points.reshape(-1, 1 if is_text else 2, 3)
    points = pairs[np.isfinite(pairs).all((1, 2))].reshape(-1, 3)
    place = points[0].tolist() if is_text and len(points) else [0.0, 0.0, 0.0]
    kind = TEXT if is_text else LINE_LIST
    writer.string(marker.namespace).numbers('i', marker.number, kind, ADD)
    writer.numbers('d', *place, 0.0, 0.0, 0.0, 1.0)
    # Lines take their width from x, letters their height from z.
    writer.numbers('d', *((0.0, 0.0, marker.size) if is_text else (marker.size, 0.0, 0.0)))
    writer.numbers('f', *marker.colour).numbers('i', 0).numbers('I', 0).numbers('B', 0)
    corners = [] if is_text else points.ravel().tolist()
    writer.numbers('I', len(corners) // 3).numbers('d', *corners)
    writer.numbers('I', 0).string('')  # colours of points, texture
    writer.header(0, '').string('').numbers('I', 0, 0)  # texture's image, its coordinates
    writer.string(marker.text).string('')  # and of a mesh nothing
    writer.string('').numbers('I', 0).numbers('B', 0)
