# SPDX-License-Identifier: Apache-2.0
"""Calibrations in TOML, as aniposelib, Pose2Sim, Anipose and FreeMoCap write them."""

from __future__ import annotations

import re
import tomllib
from typing import Final

import numpy as np

from rpgd_ros.core.camera import Camera
from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import so3_exp
from rpgd_ros.io.camera_files.fields import (
    build_camera,
    coefficients,
    entries_of,
    matrix,
    need,
    numbers,
    rigid,
    size_of,
)
from rpgd_ros.io.rig_types import METRES_PER
from rpgd_ros.io.strict import Node

# The format states no unit: Pose2Sim writes metres, aniposelib the unit of the board.
MAX_DISTANCE_M: Final = 100.0
# tomllib takes seconds for a key of some thousand parts, and the square of that for more.
MAX_PARTS: Final = 32
_QUOTED: Final = r"""\"(?:[^"\\\n]|\\.){0,99}\"|'[^'\n]{0,99}'"""
_LONG_KEY: Final = re.compile(
    rf'(?<![\w-])(?:(?:[\w-]+|{_QUOTED})[ \t]*\.[ \t]*){{{MAX_PARTS}}}', re.ASCII
)


def parse_toml(text: str, source: str) -> Node:
    """Parse TOML text.

    Raises:
        InputError: BAD_INPUT, naming the line.

    """
    long_key = _LONG_KEY.search(text)
    if long_key is not None:
        line = text.count('\n', 0, long_key.start()) + 1
        msg = f'{source}: line {line}: a key of more than {MAX_PARTS} parts is not taken'
        raise InputError(Reason.BAD_INPUT, msg)
    try:
        return Node(tomllib.loads(text), source, Reason.BAD_INPUT)
    except (ValueError, RecursionError) as error:
        msg = f'{source} is not TOML: {str(error)[:200]}'
        raise InputError(Reason.BAD_INPUT, msg) from error


def read_toml(root: Node, units: str | None) -> tuple[Camera, ...]:
    """Read the cameras of a TOML file: each table with a `matrix`.

    Args:
        root: Of the file.
        units: Of the translations; None = metres.

    """
    tables = [
        (key, node)
        for key, node in root.items()
        if isinstance(node.value, dict) and key != 'metadata'
    ]
    if not tables:
        root.refuse('no camera: need tables such as [cam_1] with matrix, distortions, rotation')
    return tuple(_camera(key, node, units) for key, node in tables)


def _camera(key: str, node: Node, units: str | None) -> Camera:
    entries = entries_of(node)
    name = entries['name'].text() if 'name' in entries else key
    k_node = need(node, 'matrix')
    translation = need(node, 'translation')
    t = np.array(numbers(translation, 3)) * METRES_PER[units or 'm']
    distance = float(np.linalg.norm(t))
    if distance > MAX_DISTANCE_M:
        msg = (
            f'the camera stands {distance:.4g} m from the origin, need at most {MAX_DISTANCE_M:g};'
            ' the file states no unit: give --camera-units mm (or cm)'
        )
        Node(t, translation.source, Reason.WRONG_UNIT, translation.path).refuse(msg)
    rotation = need(node, 'rotation')
    r = np.array(numbers(rotation, 3, 9))
    pose = rigid(rotation, so3_exp(r) if r.size == 3 else r.reshape(3, 3), t)
    is_fisheye = 'fisheye' in entries and entries['fisheye'].flag()
    return build_camera(
        k_node,
        name,
        matrix(k_node, (3, 3)),
        coefficients(need(node, 'distortions')),
        size_of(need(node, 'size')),
        pose,
        model='equidistant' if is_fisheye else 'pinhole',
    )
