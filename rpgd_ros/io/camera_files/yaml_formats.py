# SPDX-License-Identifier: Apache-2.0
"""Calibrations in YAML: ROS camera_info, OpenCV FileStorage, Kalibr camchain."""

from __future__ import annotations

import re
from typing import Final

import numpy as np

from rpgd_ros.core.camera import Camera
from rpgd_ros.core.geometry import Array, RigidTransform
from rpgd_ros.core.lens import Model
from rpgd_ros.io.camera_files.fields import (
    build_camera,
    coefficients,
    entries_of,
    matrix,
    need,
    number,
    numbers,
    rigid,
    size_of,
    whole,
)
from rpgd_ros.io.strict import Node, shown

ROS_MODELS: Final[dict[str, Model]] = {
    'plumb_bob': 'pinhole',
    'rational_polynomial': 'pinhole',
    'equidistant': 'equidistant',
    'fisheye': 'equidistant',
}
KALIBR_LENSES: Final[dict[str, tuple[Model, int]]] = {
    'radtan': ('pinhole', 4),
    'equidistant': ('equidistant', 4),
    'none': ('pinhole', 0),
}
# FileStorage writes %YAML:1.0, which no YAML reader takes, and tags of its own.
_DIRECTIVE: Final = re.compile(r'\A\ufeff?%YAML[: ]1\.0[^\n]*\n')
_TAG: Final = re.compile(r'!!opencv-(nd-)?matrix')


def plain_yaml(text: str) -> str:
    """Return the text of an OpenCV FileStorage as plain YAML with the same lines."""
    return _TAG.sub('', _DIRECTIVE.sub('\n', text))


def read_camera_info(root: Node, stem: str) -> tuple[Camera, ...]:
    """Read what ROS camera_calibration writes (camera_info_manager, camera_calibration_parsers).

    It has no pose.
    """
    entries = entries_of(root)
    name = entries['camera_name'].text() if 'camera_name' in entries else stem
    model_node = need(root, 'distortion_model')
    model = ROS_MODELS[model_node.choice(ROS_MODELS)]
    k_node = need(root, 'camera_matrix')
    for key in ('binning_x', 'binning_y'):
        if key in entries and number(entries[key]) > 1.0:
            entries[key].refuse('binned images: calibrate at the size that the detector saw')
    return (
        build_camera(
            k_node,
            name,
            matrix(k_node, (3, 3)),
            coefficients(need(root, 'distortion_coefficients')),
            (whole(need(root, 'image_width')), whole(need(root, 'image_height'))),
            model=model,
        ),
    )


def read_opencv(root: Node, stem: str) -> tuple[Camera, ...]:
    """Read what OpenCV's calibration programs write with cv::FileStorage.

    The poses in such a file are those of the board in each image, so that none is taken over.
    """
    entries = entries_of(root)
    k_node = need(root, 'camera_matrix', 'Camera_Matrix', 'cameraMatrix', 'K')
    d_node = need(
        root, 'distortion_coefficients', 'Distortion_Coefficients', 'distCoeffs', 'dist', 'D'
    )
    is_fisheye = 'fisheye_model' in entries and number(entries['fisheye_model']) != 0.0
    width = need(root, 'image_width', 'image_Width', 'width')
    height = need(root, 'image_height', 'image_Height', 'height')
    name = entries['camera_name'].text() if 'camera_name' in entries else stem
    return (
        build_camera(
            k_node,
            name,
            matrix(k_node, (3, 3)),
            coefficients(d_node),
            (whole(width), whole(height)),
            model='equidistant' if is_fisheye else 'pinhole',
        ),
    )


def read_kalibr(root: Node, _stem: str) -> tuple[Camera, ...]:
    """Read a Kalibr camchain; the world is its first camera, or the IMU where only that is given.

    A single camera gets no pose.
    `T_cn_cnm1` maps the camera before to this one, `T_cam_imu` the IMU to the camera.
    """
    chain = [(name, node) for name, node in root.items() if re.fullmatch(r'cam\d+', name)]
    poses = _chained_poses(chain)
    return tuple(
        _kalibr_camera(name, node, pose) for (name, node), pose in zip(chain, poses, strict=True)
    )


def _chained_poses(chain: list[tuple[str, Node]]) -> list[RigidTransform | None]:
    entries = [entries_of(node) for _, node in chain]
    if len(chain) == 1:
        return [None]
    if all('T_cam_imu' in e for e in entries) and not all('T_cn_cnm1' in e for e in entries[1:]):
        return [_pose(e['T_cam_imu']) for e in entries]
    poses = [RigidTransform.identity()]
    for _, node in chain[1:]:
        poses.append(_pose(need(node, 'T_cn_cnm1')) @ poses[-1])
    return [*poses]


def _pose(node: Node) -> RigidTransform:
    m: Array = matrix(node, (4, 4))
    if not np.allclose(m[3], [0.0, 0.0, 0.0, 1.0]):
        node.refuse('the last row must be 0 0 0 1')
    return rigid(node, m[:3, :3], m[:3, 3])


def _kalibr_camera(name: str, node: Node, pose: RigidTransform | None) -> Camera:
    kind = need(node, 'camera_model')
    if kind.value != 'pinhole':
        kind.refuse(f'{shown(kind.value)} is not taken: calibrate with --models pinhole-radtan')
    lens = need(node, 'distortion_model')
    model, length = KALIBR_LENSES[lens.choice(KALIBR_LENSES)]
    distortion = numbers(need(node, 'distortion_coeffs'), length) if length else []
    k_node = need(node, 'intrinsics')
    fx, fy, cx, cy = numbers(k_node, 4)
    intrinsics = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    size = size_of(need(node, 'resolution'))
    return build_camera(k_node, name, intrinsics, np.array(distortion), size, pose, model=model)
