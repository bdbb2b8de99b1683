# SPDX-License-Identifier: Apache-2.0
"""Message headers to layouts: PointCloud2 with fields in any order, and PoseArray."""

from __future__ import annotations

import struct
from functools import lru_cache
from typing import Any, Final

import numpy as np

from rpgd_ros.messages.cdr import (
    FRAME_OFFSET,
    MAX_FRAME_ID,
    MAX_MESSAGE_BYTES,
    MAX_PADDING,
    CdrError,
    Order,
    aligned,
    byte_order,
    read_string,
)
from rpgd_ros.messages.layout import (
    POINT_CLOUD2,
    POSE_ARRAY,
    Drop,
    DropError,
    Known,
    Layout,
    Run,
    Wanted,
)

CONFIDENCE: Final = 'confidence'
FIELD_NAMES: Final = {3: (('x', 'y', 'z'),), 2: (('u', 'v'), ('x', 'y'))}
MAX_PERSONS: Final = 20  # per message: more than any detector tells apart in a room
MAX_FIELDS: Final = 32
MAX_FIELD_NAME: Final = 64
POSE_BYTES: Final = 56  # float64: position x y z, orientation x y z w
_POSE_ORIENTATION: Final = 24
_FLOATS: Final[dict[tuple[int, str], np.dtype[Any]]] = {
    (7, '<'): np.dtype('<f4'),
    (7, '>'): np.dtype('>f4'),
    (8, '<'): np.dtype('<f8'),
    (8, '>'): np.dtype('>f8'),
}  # sensor_msgs/PointField: FLOAT32 = 7, FLOAT64 = 8


class _Recent:
    """The layout that a message of one kind and length had last."""

    __slots__ = ('known',)

    def __init__(self) -> None:
        self.known: Known | None = None


@lru_cache(maxsize=64)
def _recent(wanted: Wanted, length: int) -> _Recent:  # noqa: ARG001
    return _Recent()


def find_layout(wanted: Wanted, payload: bytes) -> Known:
    """Return where the joints lie, having checked that they are there.

    Parsing takes as long as the rest of a message; streams hardly ever change their layout, so
    the last ones are remembered.

    Raises:
        DropError: The message cannot be used.

    """
    recent = _recent(wanted, len(payload))
    known = recent.known
    if known is None or not known.fits(payload):
        layout = read_layout(wanted, payload)
        mask = layout.mask()
        signature = int.from_bytes(payload[: layout.start], 'little') & mask
        known = recent.known = Known(layout, mask, signature)
    return known


def read_layout(wanted: Wanted, payload: bytes) -> Layout:
    """Parse where the joints lie, and check that they are there.

    Raises:
        DropError: The message cannot be used.

    """
    if len(payload) > MAX_MESSAGE_BYTES:
        raise DropError(Drop.OVERSIZED)
    read = {POINT_CLOUD2: _read_point_cloud, POSE_ARRAY: _read_pose_array}.get(wanted.msgtype)
    if read is None:
        raise DropError(Drop.WRONG_TYPE)
    try:
        return read(payload, wanted)
    except (CdrError, struct.error) as error:
        raise DropError(Drop.MALFORMED) from error


def _read_pose_array(payload: bytes, wanted: Wanted) -> Layout:
    order = byte_order(payload)
    frame_id, frame_end = read_string(payload, FRAME_OFFSET, order, longest=MAX_FRAME_ID)
    position = aligned(frame_end, 4)
    (n_poses,) = order.u32.unpack_from(payload, position)
    position += 4
    start = aligned(position, 8) if n_poses else position
    _check_end(payload, start + n_poses * POSE_BYTES)
    _check_joints(1, n_poses, wanted.n_joints)
    dtype = _FLOATS[8, order.mark]
    return Layout(
        order=order,
        length=len(payload),
        frame_id=frame_id,
        start=start,
        n_joints=wanted.n_joints,
        n_values=wanted.n_values,
        step=POSE_BYTES,
        numbers=(Run(dtype, 0, wanted.n_values),),
        orientation=(Run(dtype, _POSE_ORIENTATION, 4),),
        padding=((frame_end, aligned(frame_end, 4)), (position, start)),
    )


def _read_point_cloud(payload: bytes, wanted: Wanted) -> Layout:
    order = byte_order(payload)
    frame_id, frame_end = read_string(payload, FRAME_OFFSET, order, longest=MAX_FRAME_ID)
    position = aligned(frame_end, 4)
    padding = [(frame_end, position)]
    height, width, n_fields = order.shape.unpack_from(payload, position)
    fields, position = _read_fields(payload, position + 12, order, n_fields, padding)
    is_bigendian, step, row_step, size = order.cloud.unpack_from(payload, position)
    start = position + 16
    padding.append((position + 1, position + 4))
    _check_end(payload, start + size + 1)  # is_dense follows the data
    # row_step only matters from the second row on; some drivers leave it zero.
    row = (row_step or width * step) if height > 1 else 0
    if (height - 1) * row + width * step > size or (height > 1 and row < width * step):
        raise DropError(Drop.MALFORMED)
    _check_joints(height, width, wanted.n_joints)
    n_persons = min(height, MAX_PERSONS)
    return Layout(
        order=order,
        length=len(payload),
        frame_id=frame_id,
        start=start,
        n_joints=wanted.n_joints,
        n_values=wanted.n_values,
        step=step,
        numbers=_find_numbers(fields, step, '>' if is_bigendian else '<', wanted.n_values),
        orientation=(),
        padding=tuple(padding),
        n_persons=n_persons,
        row=row,
        n_beyond=height - n_persons,
    )


def _read_fields(
    payload: bytes, position: int, order: Order, n_fields: int, padding: list[tuple[int, int]]
) -> tuple[dict[str, tuple[int, int, int]], int]:
    """Read the fields: name -> (offset, datatype, count), and the position after them."""
    if n_fields > MAX_FIELDS:
        raise DropError(Drop.WRONG_FIELDS)
    fields = {}
    for _ in range(n_fields):
        name, end = read_string(payload, position, order, longest=MAX_FIELD_NAME)
        start = aligned(end, 4)
        fields[name] = order.field.unpack_from(payload, start)
        position = start + 12
        padding += [(end, start), (start + 5, start + 8)]
    if len(fields) < n_fields:  # two fields of one name: which one is meant?
        raise DropError(Drop.WRONG_FIELDS)
    return fields, position


def _find_numbers(
    fields: dict[str, tuple[int, int, int]], step: int, mark: str, n_values: int
) -> tuple[Run, ...]:
    """Find x y z or u v, then the score; refuse types and places that cannot be."""
    for names in FIELD_NAMES[n_values]:
        if all(name in fields for name in names):
            break
    else:
        raise DropError(Drop.WRONG_FIELDS)
    runs: list[Run] = []
    for name in (*names, CONFIDENCE) if CONFIDENCE in fields else names:
        offset, datatype, count = fields[name]
        dtype = _FLOATS.get((datatype, mark))
        # A count of 0 is what hand-written publishers leave; it means one, as in PCL.
        if dtype is None or count > 1 or offset + dtype.itemsize > step:
            raise DropError(Drop.WRONG_FIELDS)
        last = runs[-1] if runs else None
        if last and last.dtype == dtype and offset == last.offset + last.n * dtype.itemsize:
            runs[-1] = last._replace(n=last.n + 1)
        else:
            runs.append(Run(dtype, offset, 1))
    return tuple(runs)


def _check_end(payload: bytes, end: int) -> None:
    if not end <= len(payload) <= end + MAX_PADDING:
        raise DropError(Drop.MALFORMED)


def _check_joints(n_persons: int, n_found: int, n_joints: int) -> None:
    if not n_persons * n_found:
        raise DropError(Drop.NOBODY)
    if n_found != n_joints:
        raise DropError(Drop.WRONG_JOINTS)
