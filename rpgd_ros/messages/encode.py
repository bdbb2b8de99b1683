# SPDX-License-Identifier: Apache-2.0
"""Arrays to serialised messages: for simulated recordings and annotated bags."""

from __future__ import annotations

from functools import lru_cache
from typing import Literal

import numpy as np

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import Array
from rpgd_ros.messages.cdr import FRAME_OFFSET, CdrWriter, split_stamp
from rpgd_ros.messages.parse import CONFIDENCE, FIELD_NAMES, MAX_PERSONS

MAX_JOINTS = 256

FloatName = Literal['float32', 'float64']
_DATATYPE = {'float32': 7, 'float64': 8}  # of sensor_msgs/PointField


def encode_point_cloud2(
    stamp_ns: int,
    frame_id: str,
    values: Array,
    confidence: Array | None = None,
    *,
    dtype: FloatName = 'float32',
) -> bytes:
    """Serialise skeletons or keypoints as sensor_msgs/PointCloud2, one row per person.

    Args:
        stamp_ns: Acquisition stamp.
        frame_id: Frame of the header.
        values: (J, 3) written as x y z, or (J, 2) written as u v; NaN = missing. Of several
            persons (P, J, 3) or (P, J, 2).
        confidence: (J,) or (P, J) scores, or None.
        dtype: Type of the numbers on the wire. float32 is what drivers send: 0.06 um at 1 m,
            0.0001 px at 2000 px.

    Raises:
        InputError: Shapes, stamp or frame that cannot be sent.

    """
    values = np.asarray(values, dtype=np.float64)
    n_persons, shape = 1, values.shape[:-1]
    if values.ndim == 3 and 0 < len(values) <= MAX_PERSONS and values.size:
        n_persons, values = len(values), values.reshape(-1, values.shape[2])
    values = _checked(values, n_persons)
    names = FIELD_NAMES[values.shape[1]][0]
    table = values
    if confidence is not None:
        if np.shape(confidence) != shape:
            msg = f'joints of shape {shape} but scores of shape {np.shape(confidence)}'
            raise InputError(Reason.BAD_INPUT, msg)
        names = (*names, CONFIDENCE)
        table = np.column_stack([values, np.ravel(confidence)])
    data = table.astype(f'<{"f4" if dtype == "float32" else "f8"}').tobytes()
    is_dense = bool(np.isfinite(table).all())
    head = _point_cloud_head(frame_id, n_persons, len(values) // n_persons, names, dtype)
    return _with_stamp(head, stamp_ns, data + bytes([is_dense]))


def encode_pose_array(stamp_ns: int, frame_id: str, values: Array) -> bytes:
    """Serialise one skeleton or one set of keypoints as geometry_msgs/PoseArray.

    Args:
        stamp_ns: Acquisition stamp.
        frame_id: Frame of the header.
        values: (J, 3) positions, or (J, 2) with z = 0; NaN = missing. Orientations are the
            identity.

    Raises:
        InputError: Shapes, stamp or frame that cannot be sent.

    """
    values = _checked(values)
    poses = np.zeros((len(values), 7), '<f8')
    poses[:, : values.shape[1]] = values
    poses[:, 6] = 1.0
    return _with_stamp(_pose_array_head(frame_id, len(values)), stamp_ns, poses.tobytes())


def _with_stamp(head: bytes, stamp_ns: int, data: bytes) -> bytes:
    stamp = CdrWriter().numbers('I', *split_stamp(stamp_ns)).done()
    return stamp + head + data


def _checked(values: Array, n_persons: int = 1) -> Array:
    values = np.asarray(values, dtype=np.float64)
    most = MAX_JOINTS * n_persons
    if values.ndim != 2 or values.shape[1] not in FIELD_NAMES or not 0 < len(values) <= most:
        msg = f'need (J, 2) or (J, 3) values of 1 to {MAX_JOINTS} joints, got {values.shape}'
        raise InputError(Reason.BAD_INPUT, msg)
    return values


@lru_cache(maxsize=64)
def _point_cloud_head(
    frame_id: str, n_persons: int, n_joints: int, names: tuple[str, ...], dtype: FloatName
) -> bytes:
    """Everything between the stamp and the joints, the same in a whole stream."""
    size = np.dtype(dtype).itemsize
    writer = CdrWriter().header(0, frame_id).numbers('I', n_persons, n_joints, len(names))
    for i, name in enumerate(names):
        writer.string(name).numbers('I', i * size).numbers('B', _DATATYPE[dtype]).numbers('I', 1)
    step = size * len(names)
    row = step * n_joints
    writer.numbers('B', 0).numbers('I', step, row, row * n_persons)
    return writer.done()[FRAME_OFFSET:]


@lru_cache(maxsize=64)
def _pose_array_head(frame_id: str, n_joints: int) -> bytes:
    return CdrWriter().header(0, frame_id).numbers('I', n_joints).align(8).done()[FRAME_OFFSET:]
