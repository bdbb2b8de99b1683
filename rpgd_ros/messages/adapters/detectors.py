# SPDX-License-Identifier: Apache-2.0
"""Skeletons and keypoints of body trackers and detectors, whose joints come by number."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Literal

import numpy as np

from rpgd_ros.messages.adapters.cursor import Cursor
from rpgd_ros.messages.adapters.people import Asked, People, Person
from rpgd_ros.messages.cdr import CdrError
from rpgd_ros.messages.layout import Drop, DropError

# Least bytes of an element, which the count of a sequence is checked against.
_MARKER: Final = 150
_OBJECT: Final = 1700
_DETECTION: Final = 150
_KEYPOINT: Final = 28

IDS_PER_BODY: Final = 100  # of Azure Kinect's markers
MARKER_ADDED: Final = 0  # visualization_msgs/Marker.ADD; the others take markers away
HRI_JOINTS: Final = 18
ZED_SLOTS: Final = 70  # of which a body format uses the first
ZED_JOINTS: Final = {0: 18, 1: 34, 2: 38}  # by body_format
MAX_BODIES: Final = 64  # in one message; a crowd is no subject of a calibration


def read_marker_array(cursor: Cursor, asked: Asked) -> People:
    """Read visualization_msgs/MarkerArray as Azure Kinect's `body_tracking_data`.

    A marker's id is `body * 100 + joint`. There are no scores. An empty array, which has no stamp
    either, means that nobody is there.
    """
    stamp_ns, frame_id = 0, ''
    bodies: dict[int, Person] = {}
    for _ in range(cursor.count(_MARKER)):
        stamp_ns, frame_id = cursor.header()
        cursor.skip_string()  # ns
        number = cursor.i32()
        cursor.skip(4, 1)  # type
        action = cursor.i32()
        xyz = cursor.doubles(7)[:3]
        _skip_rest_of_marker(cursor)
        if action != MARKER_ADDED:
            continue
        body, joint = divmod(number, IDS_PER_BODY)
        if body < 0 or joint >= asked.n_joints:
            raise DropError(Drop.WRONG_JOINTS)
        if body not in bodies:
            _check_crowd(len(bodies) + 1)
            bodies[body] = Person(asked.empty())
        bodies[body].values[joint] = xyz
    cursor.end()
    return People(stamp_ns, frame_id, _present([bodies[body] for body in sorted(bodies)]))


def _skip_rest_of_marker(cursor: Cursor) -> None:
    """Step over what follows the pose of a marker."""
    cursor.skip(1, 24 + 16 + 8 + 1)  # scale, colour, lifetime, frame_locked
    cursor.skip_sequence(8, 3)  # points
    cursor.skip_sequence(4, 4)  # colours
    cursor.skip_string()  # texture_resource
    cursor.skip(4, 2)  # texture: a CompressedImage
    cursor.skip_string()
    cursor.skip_string()
    cursor.skip_sequence(1)
    cursor.skip_sequence(4, 2)  # uv_coordinates
    cursor.skip_string()  # text
    cursor.skip_string()  # mesh_resource
    cursor.skip_string()  # mesh_file
    cursor.skip_sequence(1)
    cursor.skip(1, 1)  # mesh_use_embedded_materials


def read_objects(cursor: Cursor, asked: Asked) -> People:
    """Read zed_msgs/ObjectsStamped: the 3D skeletons, or the 2D ones for keypoints.

    Slots beyond the body format's joints are unused. Joints that were not found are NaN in 3D
    and zero or negative in 2D.
    """
    stamp_ns, frame_id = cursor.header()
    persons = []
    for _ in range(cursor.count(_OBJECT)):
        cursor.skip_string()  # label
        cursor.skip(2, 1)  # label_id
        cursor.skip_string()  # sublabel
        cursor.skip(4, 13)  # confidence, position, its covariance, velocity
        cursor.skip(1, 3)  # tracking_available, tracking_state, action_state
        cursor.skip(4, 35)  # boxes in 2D and 3D, dimensions
        has_skeleton, body_format = cursor.byte(), cursor.byte()
        cursor.skip(4, 35)  # boxes of the head, its position
        uv = cursor.floats(2 * ZED_SLOTS).reshape(ZED_SLOTS, 2)
        xyz = cursor.floats(3 * ZED_SLOTS).reshape(ZED_SLOTS, 3)
        if not has_skeleton:
            continue
        if ZED_JOINTS.get(body_format) != asked.n_joints:
            raise DropError(Drop.WRONG_JOINTS)
        values = (uv if asked.n_values == 2 else xyz)[: asked.n_joints].copy()
        if asked.n_values == 2:
            values[(values < 0.0).any(1)] = np.nan
        persons.append(Person(values))
    cursor.end()
    return People(stamp_ns, frame_id, _present(persons))


def read_skeleton_2d(cursor: Cursor, asked: Asked) -> People:
    """Read hri_msgs/Skeleton2D: one body, in shares of the image.

    All zero, score included, means not seen; a place outside the image is a guess.
    """
    if asked.n_joints != HRI_JOINTS:
        raise DropError(Drop.WRONG_JOINTS)
    stamp_ns, frame_id = cursor.header()
    rows = cursor.floats(3 * HRI_JOINTS).reshape(HRI_JOINTS, 3)
    cursor.end()
    rows[~rows.any(1)] = np.nan
    rows[~((rows[:, :2] >= 0.0) & (rows[:, :2] <= 1.0)).all(1), :2] = np.nan
    return People(stamp_ns, frame_id, (Person(rows[:, :2], rows[:, 2]),))


def read_detections(cursor: Cursor, asked: Asked) -> People:
    """Read yolo_msgs/DetectionArray: the detections that have keypoints.

    A keypoint's id is its index + 1; those of a low score are left out.
    """
    stamp_ns, frame_id = cursor.header()
    persons = []
    for _ in range(cursor.count(_DETECTION)):
        cursor.skip(4, 1)  # class_id
        cursor.skip_string()  # class_name
        cursor.skip(8, 1)  # score
        cursor.skip_string()  # id
        cursor.skip(8, 5 + 10)  # bbox, bbox3d
        cursor.skip_string()
        cursor.skip(4, 2)  # mask
        cursor.skip_sequence(8, 2)
        person = _keypoints(cursor, asked)
        for _ in range(cursor.count(_KEYPOINT)):  # keypoints3d
            cursor.skip(4, 1)
            cursor.skip(8, 4)
        cursor.skip_string()
        if person is not None:
            persons.append(person)
    cursor.end()
    return People(stamp_ns, frame_id, _present(persons))


def _keypoints(cursor: Cursor, asked: Asked) -> Person | None:
    """Read a yolo_msgs/KeyPoint2DArray, None = without any.

    Raises:
        DropError: WRONG_JOINTS. There is no such keypoint.

    """
    n_keypoints = cursor.count(_KEYPOINT)
    if not n_keypoints:
        return None
    values, confidence = asked.empty(), np.full(asked.n_joints, np.nan)
    for _ in range(n_keypoints):
        j = cursor.i32() - 1
        u, v, score = cursor.doubles(3)
        if not 0 <= j < asked.n_joints:
            raise DropError(Drop.WRONG_JOINTS)
        values[j] = u, v
        confidence[j] = score
    return Person(values, confidence)


def read_openpose_list(cursor: Cursor, asked: Asked) -> People:
    """Read openpose_ros2_msgs/PoseKeyPointsList, with a header or, as formerly, without.

    Joints that were not found are zeros.
    """
    try:
        stamp_ns, frame_id = cursor.header()
        return People(stamp_ns, frame_id, _openpose_persons(cursor, asked))
    except CdrError as error:
        start = Cursor(cursor.payload)
        try:
            return People(0, '', _openpose_persons(start, asked), has_header=False)
        except CdrError:
            raise error from None


def _openpose_persons(cursor: Cursor, asked: Asked) -> tuple[Person, ...]:
    counts, rows = [], []
    for _ in range(cursor.count(4)):
        counts.append(cursor.count(12))
        rows.append(cursor.floats(3 * counts[-1]).reshape(-1, 3))
    cursor.end()
    if any(n != asked.n_joints for n in counts):
        raise DropError(Drop.WRONG_JOINTS)
    return _present([Person(row[:, :2], row[:, 2]) for row in rows])


def _present(persons: list[Person]) -> tuple[Person, ...]:
    _check_crowd(len(persons))
    if not persons:
        raise DropError(Drop.NOBODY)
    return tuple(persons)


def _check_crowd(n_persons: int) -> None:
    if n_persons > MAX_BODIES:
        raise DropError(Drop.SEVERAL_PERSONS)


Reader = Callable[[Cursor, Asked], People]
Dimensions = frozenset[Literal[2, 3]]
