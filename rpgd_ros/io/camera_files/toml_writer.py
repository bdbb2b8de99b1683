# SPDX-License-Identifier: Apache-2.0
"""Writes calibrations in TOML as aniposelib and Pose2Sim read them."""

from __future__ import annotations

import json
from collections.abc import Sequence

from rpgd_ros.core.camera import Camera
from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import Array, so3_log

FEWEST_COEFFICIENTS = 4  # that Pose2Sim takes out of a list
HEADER = """\
# Cameras in the frame {frame}, metres: x_camera = R(rotation) x + translation, rotation vectors in
# radians, lens coefficients in the order of OpenCV.
"""


def toml_text(cameras: Sequence[Camera], frame: str) -> str:
    """Return cameras as TOML.

    Args:
        cameras: Their `camera_T_world` maps from the frame.
        frame: Name of the frame, for the reader.

    Raises:
        InputError: NO_EXTRINSICS. A camera has no pose.

    """
    tables = [_table(camera) for camera in cameras]
    metadata = '[metadata]\nadjusted = false\nerror = 0.0\n'
    return '\n'.join([HEADER.format(frame=json.dumps(frame)), *tables, metadata])


def _table(camera: Camera) -> str:
    pose = camera.camera_T_world
    if pose is None:
        msg = f'camera {camera.name} has no pose: it cannot be written to TOML'
        raise InputError(Reason.NO_EXTRINSICS, msg)
    padding = [0.0] * (FEWEST_COEFFICIENTS - camera.distortion.size)
    entries = {
        'name': json.dumps(camera.name),
        'size': [float(n) for n in camera.size],
        'matrix': camera.matrix.tolist(),
        'distortions': [*camera.distortion.tolist(), *padding],
        'rotation': _list(so3_log(pose.rotation)),
        'translation': _list(pose.translation),
        'fisheye': 'true' if camera.model == 'equidistant' else 'false',
    }
    return ''.join(
        [f'[{camera.name}]\n', *(f'{key} = {value}\n' for key, value in entries.items())]
    )


def _list(values: Array) -> list[float]:
    out: list[float] = values.tolist()
    return out
