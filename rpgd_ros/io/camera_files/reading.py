# SPDX-License-Identifier: Apache-2.0
"""Finds out which tool wrote a calibration file, and reads it."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Final, NamedTuple

from rpgd_ros.core.camera import Camera
from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.io.camera_files.fields import entries_of
from rpgd_ros.io.camera_files.qualisys import read_qualisys
from rpgd_ros.io.camera_files.toml_format import parse_toml, read_toml
from rpgd_ros.io.camera_files.xml_text import opencv_node, parse_xml
from rpgd_ros.io.camera_files.yaml_formats import (
    plain_yaml,
    read_camera_info,
    read_kalibr,
    read_opencv,
)
from rpgd_ros.io.rig_reader import rig_from_node
from rpgd_ros.io.rig_types import Units
from rpgd_ros.io.strict import MAX_BYTES, Node, parse_yaml

TOML: Final = 'aniposelib/Pose2Sim TOML'
QUALISYS: Final = 'Qualisys calibration'
OPENCV: Final = 'OpenCV FileStorage'
CAMERA_INFO: Final = 'ROS camera_info YAML'
KALIBR: Final = 'Kalibr camchain'
RIG: Final = 'rig file'
FORMATS: Final = (CAMERA_INFO, KALIBR, TOML, QUALISYS, OPENCV, RIG)

_TABLE: Final = re.compile(r'^[ \t]*\[[^\[\]\n]+\][ \t]*(#.*)?$', re.MULTILINE)
_ASSIGNMENT: Final = re.compile(r'^[ \t]*[\w".-]+[ \t]*=', re.MULTILINE)


class CameraFile(NamedTuple):
    """What a calibration file holds.

    Attributes:
        format: One of `FORMATS`.
        cameras: In the order of the file; without a pose where the file gives none.

    """

    format: str
    cameras: tuple[Camera, ...]


def read_cameras(path: Path | str, units: Units | None = None) -> CameraFile:
    """Read the cameras of a calibration file, whichever of the known tools wrote it.

    Args:
        path: The file.
        units: Of positions, where the format states none (TOML); None = metres.

    Raises:
        InputError: BAD_INPUT or WRONG_UNIT. The message names file, key, what was found and what
            is needed.

    """
    try:
        with Path(path).open('rb') as file:
            data = file.read(MAX_BYTES + 1)
    except OSError as error:
        msg = f'{path} cannot be read: {error.strerror or error}'
        raise InputError(Reason.BAD_INPUT, msg) from error
    if len(data) > MAX_BYTES:
        msg = f'{path}: more than {MAX_BYTES} bytes: is it a calibration file?'
        raise InputError(Reason.BAD_INPUT, msg)
    try:
        text = data.decode()
    except UnicodeDecodeError as error:
        msg = f'{path} is not UTF-8 text (byte {error.start})'
        raise InputError(Reason.BAD_INPUT, msg) from error
    return parse_cameras(text, str(path), units)


def parse_cameras(text: str, source: str, units: Units | None = None) -> CameraFile:
    """Read the text of a calibration file.

    Args:
        text: Of the file.
        source: Its path: names a camera that the file gives no name.
        units: As `read_cameras`.

    Raises:
        InputError: As `read_cameras`.

    """
    found = _read(text.lstrip('\ufeff'), source, units)
    if units is not None and found.format != TOML:
        msg = f'{source} is a {found.format}, which has its own unit: leave --camera-units out'
        raise InputError(Reason.BAD_INPUT, msg)
    names = [camera.name for camera in found.cameras]
    for name in names:
        if names.count(name) > 1:
            msg = f'{source}: camera {name} comes twice: give each a name of its own'
            raise InputError(Reason.BAD_INPUT, msg)
    return found


def _read(text: str, source: str, units: Units | None) -> CameraFile:
    if text.lstrip().startswith('<'):
        return _read_xml(text.lstrip(), source)
    if _TABLE.search(text) and _ASSIGNMENT.search(text):
        return CameraFile(TOML, read_toml(parse_toml(text, source), units))
    is_opencv = text.startswith('%YAML:1.0') or '!!opencv-matrix' in text
    root = parse_yaml(plain_yaml(text) if is_opencv else text, source, Reason.BAD_INPUT)
    known = _YAML_FORMATS if isinstance(root.value, dict) else ()
    found = next(((n, read) for n, belongs, read in known if belongs(root, is_opencv)), None)
    if found is None:
        root.refuse(f'no known calibration; known are {", ".join(FORMATS)}')
    return CameraFile(found[0], found[1](root, Path(source).stem))


def _read_xml(text: str, source: str) -> CameraFile:
    root = parse_xml(text, source)
    if root.tag == 'opencv_storage':
        return CameraFile(OPENCV, read_opencv(opencv_node(root, source), Path(source).stem))
    if root.tag != 'calibration':
        msg = f'{source}: need <calibration> (QTM) or <opencv_storage>, got <{root.tag[:80]}>'
        raise InputError(Reason.BAD_INPUT, msg)
    return CameraFile(QUALISYS, read_qualisys(root, source))


def _is_kalibr(root: Node, _is_opencv: bool) -> bool:  # noqa: FBT001
    cameras = [node for name, node in root.items() if re.fullmatch(r'cam\d+', name)]
    return any(isinstance(c.value, dict) and 'camera_model' in c.value for c in cameras)


def _is_camera_info(root: Node, _is_opencv: bool) -> bool:  # noqa: FBT001
    return 'camera_matrix' in entries_of(root) and 'distortion_model' in entries_of(root)


def _read_rig(root: Node, _stem: str) -> tuple[Camera, ...]:
    cameras = tuple(c.camera for c in rig_from_node(root).cameras if c.camera is not None)
    if not cameras:
        root.refuse('the rig file gives no intrinsics: its cameras need matrix and size')
    return cameras


_YAML_FORMATS: Final[
    tuple[tuple[str, Callable[[Node, bool], bool], Callable[[Node, str], tuple[Camera, ...]]], ...]
] = (
    (RIG, lambda root, _: 'schema' in root.value and 'cameras' in root.value, _read_rig),
    (KALIBR, _is_kalibr, read_kalibr),
    (CAMERA_INFO, _is_camera_info, read_camera_info),
    (OPENCV, lambda _, is_opencv: is_opencv, read_opencv),
)
