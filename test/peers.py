# SPDX-License-Identifier: Apache-2.0
"""Messages as the rosbags library writes and reads them: an implementation beside ours."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_typestore

DATATYPES = {'f4': 7, 'f8': 8}  # of sensor_msgs/PointField


@lru_cache(maxsize=1)
def store() -> Any:
    """Return the message types of Jazzy."""
    return get_typestore(Stores.ROS2_JAZZY)


def make(name: str, *values: object) -> Any:
    """Make a message, its fields in the order of the definition."""
    return store().types[name](*values)


def serialise(message: Any, *, little_endian: bool = True) -> bytes:
    """Return the CDR bytes of a message."""
    return bytes(store().serialize_cdr(message, message.__msgtype__, little_endian=little_endian))


def read(payload: bytes, name: str) -> Any:
    """Return the message of some CDR bytes."""
    return store().deserialize_cdr(payload, name)


def header(stamp_ns: int, frame_id: str) -> Any:
    """Make a std_msgs/Header."""
    stamp = make('builtin_interfaces/msg/Time', *divmod(stamp_ns, 10**9))
    return make('std_msgs/msg/Header', stamp, frame_id)


def point_cloud2(
    rows: np.ndarray[Any, Any],
    *,
    stamp_ns: int = 1_500_000_000,
    frame_id: str = 'mocap',
    height: int = 1,
    is_bigendian: bool = False,
    is_dense: bool = False,
) -> Any:
    """Make a sensor_msgs/PointCloud2 of a structured array, one row for each joint."""
    fields = []
    for name in rows.dtype.names or ():
        dtype, offset = (rows.dtype.fields or {})[name][:2]
        datatype = DATATYPES.get(dtype.base.str[1:], 4)
        count = int(np.prod(dtype.shape, dtype=int))
        fields.append(make('sensor_msgs/msg/PointField', name, offset, datatype, count))
    step, width = rows.dtype.itemsize, len(rows) // height
    return make(
        'sensor_msgs/msg/PointCloud2', header(stamp_ns, frame_id), height, width, fields,
        is_bigendian, step, step * width, np.frombuffer(rows.tobytes(), np.uint8), is_dense,
    )  # fmt: skip


def pose_array(
    poses: np.ndarray[Any, Any], *, stamp_ns: int = 1_500_000_000, frame_id: str = 'mocap'
) -> Any:
    """Make a geometry_msgs/PoseArray of (J, 7) numbers, position before quaternion."""
    return make(
        'geometry_msgs/msg/PoseArray',
        header(stamp_ns, frame_id),
        [
            make(
                'geometry_msgs/msg/Pose',
                make('geometry_msgs/msg/Point', *map(float, pose[:3])),
                make('geometry_msgs/msg/Quaternion', *map(float, pose[3:])),
            )
            for pose in poses
        ],
    )
