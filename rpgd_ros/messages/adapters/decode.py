# SPDX-License-Identifier: Apache-2.0
"""Any message type of whole skeletons or keypoints to a batch of joints."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from functools import lru_cache
from types import MappingProxyType
from typing import Final, Literal, NamedTuple

import numpy as np

from rpgd_ros.core.geometry import Array, IntArray
from rpgd_ros.core.observations import LARGEST_COORDINATE
from rpgd_ros.messages.adapters import types
from rpgd_ros.messages.adapters.cursor import Cursor
from rpgd_ros.messages.adapters.detectors import (
    Dimensions,
    Reader,
    read_detections,
    read_marker_array,
    read_objects,
    read_openpose_list,
    read_skeleton_2d,
)
from rpgd_ros.messages.adapters.mocap import (
    read_link_states,
    read_markers,
    read_named_poses,
    read_rigid_bodies,
)
from rpgd_ros.messages.adapters.people import Asked, People, Person
from rpgd_ros.messages.batch import Decoded, JointBatch, crowd_batch
from rpgd_ros.messages.cdr import MAX_MESSAGE_BYTES, CdrError
from rpgd_ros.messages.joints import BEYOND, decode_joints
from rpgd_ros.messages.layout import JOINT_TYPES, Drop, DropError
from rpgd_ros.messages.parse import MAX_PERSONS

# An empty sequence: all there is of a message that begins with its list and has nobody in it.
EMPTY: Final = bytes(4)
LISTS: Final = frozenset({types.MARKER_ARRAY, types.OPENPOSE_LIST})
NO_HEADER: Final = 'no_header'  # counted: messages stamped with their arrival


class _Adapter(NamedTuple):
    """How a type is read, and what it can give."""

    read: Reader
    dimensions: Dimensions


_3D: Final[Dimensions] = frozenset({3})
_2D: Final[Dimensions] = frozenset({2})
ADAPTERS: Final[Mapping[str, _Adapter]] = MappingProxyType({
    types.MARKERS: _Adapter(read_markers, _3D),
    types.RIGID_BODIES: _Adapter(read_rigid_bodies, _3D),
    types.NAMED_POSE_ARRAY: _Adapter(read_named_poses, _3D),
    types.LINK_STATE_ARRAY: _Adapter(read_link_states, _3D),
    types.LINK_STATE_ARRAY_OLD: _Adapter(read_link_states, _3D),
    types.MARKER_ARRAY: _Adapter(read_marker_array, _3D),
    types.OBJECTS: _Adapter(read_objects, _2D | _3D),
    types.OBJECTS_OLD: _Adapter(read_objects, _2D | _3D),
    types.SKELETON_2D: _Adapter(read_skeleton_2d, _2D),
    types.DETECTIONS: _Adapter(read_detections, _2D),
    types.DETECTIONS_OLD: _Adapter(read_detections, _2D),
    types.OPENPOSE_LIST: _Adapter(read_openpose_list, _2D),
})  # fmt: skip


def decode_people(msgtype: str, payload: bytes, asked: Asked) -> People:
    """Decode one message of a driver.

    Args:
        msgtype: Any type of `ADAPTERS`.
        payload: As on the wire.
        asked: Joints and their dimension.

    Raises:
        DropError: The message cannot be used.

    """
    adapter = ADAPTERS.get(msgtype)
    if adapter is None or asked.n_values not in adapter.dimensions:
        raise DropError(Drop.WRONG_TYPE)
    if len(payload) > MAX_MESSAGE_BYTES:
        raise DropError(Drop.OVERSIZED)
    if msgtype in LISTS and payload[4:] == EMPTY:
        raise DropError(Drop.NOBODY)
    try:
        return adapter.read(Cursor(payload), asked)
    except (CdrError, struct.error) as error:
        raise DropError(Drop.MALFORMED) from error


def decode(
    msgtype: str,
    payloads: Sequence[bytes],
    *,
    joints: Sequence[str],
    n_values: Literal[2, 3],
    receive_ns: Sequence[int],
    zero_is_missing: bool = True,
    frame_id: str | None = None,
    needs_stamp: bool = True,
) -> Decoded:
    """Decode serialised messages of one stream, whatever their type.

    Args:
        msgtype: Any of `SKELETON_TYPES` or `KEYPOINT_TYPES` but those of parts; anything else is
            dropped as `wrong_type`.
        payloads: Messages as on the wire.
        joints: (J,) what the messages call the joints; types without names go by the order.
        n_values: 3 for a skeleton, 2 for keypoints.
        receive_ns: When each arrived: the stamp of a type that has no header.
        zero_is_missing: Whether a joint at exactly zero is missing.
        frame_id: Frame that the messages must be in; None = that of the first usable one.
        needs_stamp: Whether a zero stamp makes a message useless.

    Returns:
        The usable messages, and the number of the others by reason. Nothing in the bytes raises.

    """
    if msgtype in JOINT_TYPES:
        return decode_joints(
            msgtype,
            payloads,
            n_joints=len(joints),
            n_values=n_values,
            zero_is_missing=zero_is_missing,
            frame_id=frame_id,
            needs_stamp=needs_stamp,
        )
    return _decode_crowds(
        msgtype,
        payloads,
        _asked(tuple(joints), n_values),
        receive_ns,
        frame_id,
        zero_is_missing=zero_is_missing,
        needs_stamp=needs_stamp,
    )


@lru_cache(maxsize=64)
def _asked(names: tuple[str, ...], n_values: Literal[2, 3]) -> Asked:
    return Asked(names, n_values)


def _decode_crowds(
    msgtype: str,
    payloads: Sequence[bytes],
    asked: Asked,
    receive_ns: Sequence[int],
    frame_id: str | None,
    *,
    zero_is_missing: bool,
    needs_stamp: bool,
) -> Decoded:
    """Decode messages one by one; see `decode`."""
    dropped: dict[str, int] = {}
    index: list[int] = []
    stamps: list[int] = []
    crowds: list[tuple[Person, ...]] = []
    n_headless = 0
    for i, payload in enumerate(payloads):
        try:
            people = decode_people(msgtype, payload, asked)
            _check(people, frame_id, needs_stamp=needs_stamp)
        except DropError as error:
            dropped[error.drop] = dropped.get(error.drop, 0) + 1
            continue
        frame_id = people.frame_id
        n_headless += not people.has_header
        index.append(i)
        stamps.append(people.stamp_ns if people.has_header else int(receive_ns[i]))
        crowds.append(people.persons)
    missing = {NO_HEADER: n_headless} if n_headless else {}
    head = np.array(index), np.array(stamps), frame_id or ''
    batch = _batch(head, crowds, missing, zero_is_missing=zero_is_missing) if crowds else None
    return Decoded(batch, dropped, missing)


def _batch(
    head: tuple[IntArray, IntArray, str],
    crowds: Sequence[tuple[Person, ...]],
    missing: dict[str, int],
    *,
    zero_is_missing: bool,
) -> JointBatch:
    """Put the persons of all messages together; `missing` is changed in place."""
    values, scores = _stacked(crowds)
    _clear_missing(values, zero_is_missing=zero_is_missing, missing=missing)
    if values.shape[1] == 1:
        return JointBatch(*head, values[:, 0], None if scores is None else scores[:, 0])
    n_read = sum(min(len(crowd), MAX_PERSONS) for crowd in crowds)
    # Places of persons who are not there are no missing joints.
    missing['nan'] = missing.get('nan', 0) - (values[..., 0].size - n_read * values.shape[2])
    for reason, n in (('nan', missing['nan']), (BEYOND, sum(map(len, crowds)) - n_read)):
        missing[reason] = n
        if not n:
            del missing[reason]
    return crowd_batch(head, values, scores)


def _stacked(crowds: Sequence[tuple[Person, ...]]) -> tuple[Array, Array | None]:
    """Return values (B, P, J, C) and scores (B, P, J), NaN where a message has fewer persons."""
    n_persons = min(max(len(crowd) for crowd in crowds), MAX_PERSONS)
    first = crowds[0][0]
    values = np.full((len(crowds), n_persons, *first.values.shape), np.nan)
    scores = np.full(values.shape[:3], np.nan)
    for i, crowd in enumerate(crowds):
        for p, person in enumerate(crowd[:n_persons]):
            values[i, p] = person.values
            if person.confidence is not None:
                scores[i, p] = person.confidence
    return values, None if first.confidence is None else scores


def _check(people: People, frame_id: str | None, *, needs_stamp: bool) -> None:
    if needs_stamp and people.has_header and not people.stamp_ns:
        raise DropError(Drop.ZERO_STAMP)
    if frame_id is not None and people.frame_id != frame_id:
        raise DropError(Drop.FRAME_CHANGED)


def _clear_missing(values: Array, *, zero_is_missing: bool, missing: dict[str, int]) -> None:
    """Make joints missing as a whole that are absent, damaged or zero; count them.

    Args:
        values: (B, P, J, C), changed in place.
        zero_is_missing: Whether zero is missing.
        missing: Counts, changed in place.

    """
    with np.errstate(invalid='ignore'):
        largest = np.abs(values).max(-1)
        is_bad = ~(largest <= LARGEST_COORDINATE)
    is_zero = largest == 0.0 if zero_is_missing else np.zeros_like(is_bad)
    for reason, where in (('nan', is_bad), ('zero', is_zero)):
        if n := int(np.count_nonzero(where)):
            missing[reason] = n
    values[is_bad | is_zero] = np.nan
