# SPDX-License-Identifier: Apache-2.0
"""Serialised skeletons and keypoints to arrays: one decoder for live topics and for bags.

Live messages come one by one, bags in batches: messages of equal layout are decoded by one numpy
operation on their joined bytes. Batches of about 100 are best: large temporaries are given back to
the system after each use, which costs more than the arithmetic. What cannot be used is dropped and
counted; no bytes whatsoever raise.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, Literal

import numpy as np

from rpgd_ros.core.geometry import Array
from rpgd_ros.core.observations import LARGEST_COORDINATE
from rpgd_ros.messages.batch import Decoded, JointBatch, crowd_batch, merge
from rpgd_ros.messages.cdr import NS_PER_S, STAMP_OFFSET
from rpgd_ros.messages.layout import (
    Drop,
    DropError,
    Known,
    Layout,
    Run,
    Wanted,
)
from rpgd_ros.messages.parse import MAX_PERSONS, find_layout

BEYOND: Final = f'persons_beyond_{MAX_PERSONS}'
_Message = tuple[int, int, bytes]  # position among the payloads, stamp, bytes


def decode_joints(
    msgtype: str,
    payloads: Sequence[bytes],
    *,
    n_joints: int,
    n_values: Literal[2, 3],
    zero_is_missing: bool = True,
    frame_id: str | None = None,
    needs_stamp: bool = True,
) -> Decoded:
    """Decode serialised messages of one stream.

    Args:
        msgtype: One of `JOINT_TYPES`; anything else is dropped as `wrong_type`.
        payloads: Messages as on the wire, encapsulation included.
        n_joints: Joints that a message must have.
        n_values: 3 for a skeleton (x y z), 2 for keypoints (u v, or x y).
        zero_is_missing: Whether a joint at exactly zero is missing. Without it, a pose is missing
            where its position and its quaternion are zero.
        frame_id: Frame that the messages must be in; None = that of the first usable one.
        needs_stamp: Whether a zero stamp makes a message useless.

    Returns:
        The usable messages, and the number of the others by reason. Nothing in the bytes raises.

    """
    dropped: dict[str, int] = {}
    missing: dict[str, int] = {}
    groups = _group(
        Wanted(msgtype, n_joints, n_values),
        payloads,
        frame_id,
        needs_stamp=needs_stamp,
        dropped=dropped,
    )
    parts = [
        _decode_group(layout, messages, zero_is_missing=zero_is_missing, missing=missing)
        for layout, messages in groups.items()
        if messages
    ]
    return Decoded(merge(parts) if parts else None, dropped, missing)


def _group(
    wanted: Wanted,
    payloads: Sequence[bytes],
    frame_id: str | None,
    *,
    needs_stamp: bool,
    dropped: dict[str, int],
) -> dict[Layout, list[_Message]]:
    """Sort usable messages by layout, and count the others."""
    groups: dict[Layout, list[_Message]] = {}
    known: Known | None = None
    for index, payload in enumerate(payloads):
        if known is None or not known.fits(payload):
            try:
                known = find_layout(wanted, payload)
            except DropError as error:
                _count(dropped, error.drop, 1)
                continue
            layout = known.layout
            read_stamp = layout.order.stamp.unpack_from
            messages = groups.setdefault(layout, [])
        sec, nanosec = read_stamp(payload, STAMP_OFFSET)
        stamp_ns = sec * NS_PER_S + nanosec
        if sec < 0 or nanosec >= NS_PER_S:
            _count(dropped, Drop.BAD_STAMP, 1)
        elif not stamp_ns and needs_stamp:
            _count(dropped, Drop.ZERO_STAMP, 1)
        elif frame_id is not None and frame_id != layout.frame_id:
            _count(dropped, Drop.FRAME_CHANGED, 1)
        else:
            frame_id = layout.frame_id
            messages.append((index, stamp_ns, payload))
    return groups


def _decode_group(
    layout: Layout, messages: list[_Message], *, zero_is_missing: bool, missing: dict[str, int]
) -> JointBatch:
    """Decode messages of one layout together."""
    index, stamp_ns, payloads = zip(*messages, strict=True)
    data = payloads[0] if len(payloads) == 1 else b''.join(payloads)
    planes = _read(layout, layout.numbers, data, len(payloads))
    values, scores = planes[: layout.n_values], planes[layout.n_values :]
    must_also_be_zero = None
    if layout.orientation and not zero_is_missing:
        must_also_be_zero = _read(layout, layout.orientation, data, len(payloads))
        zero_is_missing = True
    _clear_missing(
        values,
        zero_is_missing=zero_is_missing,
        must_also_be_zero=must_also_be_zero,
        missing=missing,
    )
    head = np.array(index), np.array(stamp_ns), layout.frame_id
    if layout.n_persons > 1:
        _count(missing, BEYOND, layout.n_beyond * len(payloads))
        return crowd_batch(head, np.moveaxis(values, 0, -1), scores[0] if len(scores) else None)
    return JointBatch(*head, values.transpose(1, 2, 0), scores[0] if len(scores) else None)


@np.errstate(invalid='ignore')  # widening a signalling NaN
def _read(layout: Layout, runs: tuple[Run, ...], data: bytes, n_messages: int) -> Array:
    """Gather numbers of all messages, one plane (B, J) for each; (B, P, J) of several persons."""
    planes = []
    for dtype, offset, n in runs:
        shape: tuple[int, ...] = (n, n_messages, layout.n_joints)
        strides: tuple[int, ...] = (dtype.itemsize, layout.length, layout.step)
        if layout.n_persons > 1:
            shape = (*shape[:2], layout.n_persons, layout.n_joints)
            strides = (*strides[:2], layout.row, layout.step)
        raw = np.ndarray(shape, dtype, data, layout.start + offset, strides)
        planes.append(raw.astype(np.float64, order='C'))
    return planes[0] if len(planes) == 1 else np.concatenate(planes)


def _clear_missing(
    values: Array,
    *,
    zero_is_missing: bool,
    must_also_be_zero: Array | None,
    missing: dict[str, int],
) -> None:
    """Make joints missing as a whole that are zero or no plausible numbers; count them.

    Args:
        values: (C, B, J) or (C, B, P, J), changed in place.
        zero_is_missing: Whether zero is missing.
        must_also_be_zero: (N, B, J) further numbers that a missing joint has zero, or None.
        missing: Counts, changed in place.

    """
    largest = np.maximum.reduce(np.abs(values))  # NaN stays NaN
    is_good = largest <= LARGEST_COORDINATE  # False for NaN
    n_nan = largest.size - int(np.count_nonzero(is_good))
    n_zero = 0
    if zero_is_missing and np.count_nonzero(largest) < largest.size:
        is_zero = largest == 0.0
        if must_also_be_zero is not None:
            is_zero &= ~must_also_be_zero.any(0)
        is_good &= ~is_zero
        n_zero = int(np.count_nonzero(is_zero))
    if n_nan or n_zero:
        np.copyto(values, np.nan, where=~is_good)
        _count(missing, 'nan', n_nan)
        _count(missing, 'zero', n_zero)


def _count(counts: dict[str, int], reason: str, n: int) -> None:
    if n:
        counts[reason] = counts.get(reason, 0) + n
