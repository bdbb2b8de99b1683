# SPDX-License-Identifier: Apache-2.0
"""Finds out the format of a skeleton file by its content, and reads it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from rpgd_ros.importing.bvh import read_bvh
from rpgd_ros.importing.c3d import MAGIC, read_c3d
from rpgd_ros.importing.skeleton import SkeletonFile, without_subject
from rpgd_ros.importing.table import LAYOUT, read_csv
from rpgd_ros.importing.text import refuse
from rpgd_ros.importing.trc import read_trc


def read_skeleton(path: Path, fps: float | None = None) -> SkeletonFile:
    """Read a TRC, BVH, C3D or CSV file.

    The name of the subject before a colon is taken off where all joints have the same.

    Args:
        path: The file.
        fps: Its true frame rate, where the file states none or a wrong one.

    Raises:
        InputError: BAD_INPUT or WRONG_UNIT, naming file and, in text, the line.

    """
    file = _read(path, fps)
    return replace(file, joints=without_subject(file.joints))


def _read(path: Path, fps: float | None) -> SkeletonFile:
    try:
        with path.open('rb') as file:
            start = file.read(256)
    except OSError as error:
        refuse(path, None, f'cannot be read: {error.strerror or error}')
    start = start.removeprefix(b'\xef\xbb\xbf').lstrip()
    if path.suffix.lower() == '.c3d' or (start[1:2] == bytes([MAGIC]) and b'\0' in start):
        return read_c3d(path)
    if start.startswith(b'HIERARCHY'):
        return read_bvh(path)
    if start.lower().startswith((b'#', b'time', b'frame', b'"time', b'"frame')):
        return read_csv(path, fps)
    if not start.startswith(b'PathFileType'):
        refuse(path, 1, f'no TRC, BVH or C3D file, and no CSV file, which needs {LAYOUT}')
    return read_trc(path, check_rate=fps is None)
