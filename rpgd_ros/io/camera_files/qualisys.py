# SPDX-License-Identifier: Apache-2.0
"""Qualisys calibrations (.qca.txt, XML) as QTM exports them."""

from __future__ import annotations

import re
from typing import Final
from xml.etree import ElementTree as ET

import numpy as np

from rpgd_ros.core.camera import Camera
from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.io.camera_files.fields import build_camera, number, rigid, whole
from rpgd_ros.io.strict import Node, shown

SUBPIXELS: Final = 64.0  # focal lengths and centres are counted in 1/64 pixel
METRES: Final = 0.001  # positions in millimetres
# QTM's camera looks along -z with y up, OpenCV's along z with y down.
OPENCV_R_QTM: Final = np.diag([1.0, -1.0, -1.0])
RADIAL: Final = ('radialDistortion1', 'radialDistortion2')
TANGENTIAL: Final = ('tangentalDistortion1', 'tangentalDistortion2')  # QTM's own spelling
MAX_CAMERAS: Final = 128
# Whatever the resolution of the video, QTM counts the pixels of the sensor, as Pose2Sim reads it.
SENSOR_LINES: Final = 1080


def read_qualisys(root: ET.Element, source: str) -> tuple[Camera, ...]:
    """Read the active cameras of a QTM calibration, named by their serial numbers.

    The distortion has no unit (Brown-Conrady in normalised coordinates) and is not scaled.

    Raises:
        InputError: BAD_INPUT, naming element and attribute.

    """
    active = [e for e in root.findall('cameras/camera') if e.get('active', '1') != '0']
    # A marker camera that hangs upside down has no video whose turn would matter.
    elements = [e for e in active if _turn(e) == '0' or _has_video(e)] or active
    if not 0 < len(elements) <= MAX_CAMERAS:
        msg = f'{source}: need 1 to {MAX_CAMERAS} active cameras, got {len(elements)}'
        raise InputError(Reason.BAD_INPUT, msg)
    return tuple(_camera(e, source, i) for i, e in enumerate(elements))


def _turn(element: ET.Element) -> str:
    return element.get('viewrotation', '0')


def _has_video(element: ET.Element) -> bool:
    """Whether a camera films, by its model: Miqus Video, or `none` where Pose2Sim wrote it."""
    model = element.get('model', 'none').lower()
    return 'video' in model or model == 'none'


def _scale(element: ET.Element, here: Node) -> float:
    """Return the pixels of the video by those of the sensor."""
    text = element.get('video_resolution', 'N/A')
    if text == 'N/A':
        return 1.0
    lines = re.fullmatch(r'(\d{3,4})p', text)
    if lines is None or int(lines[1]) > SENSOR_LINES:
        here.refuse(f'video_resolution {shown(text)} is unknown, need 1080p, 720p, 540p or N/A')
    return int(lines[1]) / SENSOR_LINES


def _camera(element: ET.Element, source: str, index: int) -> Camera:
    serial = element.get('serial') or str(index + 1)
    here = Node(None, source, Reason.BAD_INPUT, f'camera {serial[:80]}')
    turn = _turn(element)
    if turn != '0':
        here.refuse(
            f'viewrotation {shown(turn)}: the video may be turned or not. Turn the view in QTM to '
            '0 and export again, or write 0 here if the keypoints are of unturned images'
        )
    lens = _Attributes(element, 'intrinsic', here)
    fov = _Attributes(element, 'fov_video', here)
    left, top = fov['left'], fov['top']
    scale = _scale(element, here)
    size = (
        whole(fov.at('right', round((fov['right'] - left + 1.0) * scale, 6))),
        whole(fov.at('bottom', round((fov['bottom'] - top + 1.0) * scale, 6))),
    )
    fx, fy, cx, cy = (
        lens[key] / SUBPIXELS
        for key in ('focalLengthU', 'focalLengthV', 'centerPointU', 'centerPointV')
    )
    intrinsics = np.array([[fx, 0.0, cx - left], [0.0, fy, cy - top], [0.0, 0.0, 1.0]])
    intrinsics[:2] *= scale
    distortion = [lens[key] for key in (*RADIAL, *TANGENTIAL)]
    if lens.get('radialDistortion3'):
        distortion.append(lens['radialDistortion3'])
    place = _Attributes(element, 'transform', here)
    camera_R_world = OPENCV_R_QTM @ np.array(
        [[place[f'r{i}{j}'] for j in (1, 2, 3)] for i in (1, 2, 3)]
    )
    position = METRES * np.array([place[axis] for axis in 'xyz'])
    pose = rigid(place.node, camera_R_world, -camera_R_world @ position)
    return build_camera(lens.node, serial, intrinsics, np.array(distortion), size, pose)


class _Attributes:
    """The numbers that an element gives as attributes."""

    def __init__(self, parent: ET.Element, tag: str, here: Node) -> None:
        element = parent.find(tag)
        if element is None:
            here.refuse(f'<{tag}> is missing')
        self._element = element
        self.node = Node(element.attrib, here.source, here.reason, f'{here.path}.{tag}')

    def at(self, key: str, value: object) -> Node:
        """Return a value with the place of an attribute."""
        return Node(value, self.node.source, self.node.reason, f'{self.node.path}.{key}')

    def get(self, key: str) -> float:
        """Return a number, 0 where there is none."""
        return self[key] if key in self._element.attrib else 0.0

    def __getitem__(self, key: str) -> float:
        value = self._element.get(key)
        if value is None:
            self.node.refuse(f'{key} is missing')
        return number(self.at(key, value))
