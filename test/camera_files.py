# SPDX-License-Identifier: Apache-2.0
"""Calibration files in the layouts of other tools, written from cameras."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import yaml

from rpgd_ros.core.camera import Camera
from rpgd_ros.core.geometry import Array, RigidTransform, so3_log


def pose_of(camera: Camera) -> RigidTransform:
    """Return the pose that a test gave the camera."""
    assert camera.camera_T_world is not None
    return camera.camera_T_world


def toml_text(cameras: Sequence[Camera], metres_per_unit: float = 1.0) -> str:
    """Write as Pose2Sim does (Calib_*.toml)."""
    lines: list[str] = []
    for i, camera in enumerate(cameras):
        rows = [row.tolist() for row in camera.matrix]
        rotation = so3_log(pose_of(camera).rotation).tolist()
        translation = (pose_of(camera).translation / metres_per_unit).tolist()
        lines += [
            f'[cam_{i + 1}]',
            f'name = "{camera.name}"',
            f'size = [ {float(camera.size[0])}, {float(camera.size[1])}]',
            f'matrix = {rows}',
            f'distortions = {camera.distortion.tolist()}',
            f'rotation = {rotation}',
            f'translation = {translation}',
            f'fisheye = {"true" if camera.model == "equidistant" else "false"}',
            '',
        ]
    return '\n'.join([*lines, '[metadata]', 'adjusted = false', 'error = 0.0', ''])


def camera_info_text(camera: Camera) -> str:
    """Write as ROS camera_calibration does."""
    model = 'equidistant' if camera.model == 'equidistant' else 'plumb_bob'
    if camera.distortion.size == 8:
        model = 'rational_polynomial'
    tree = {
        'image_width': camera.size[0],
        'image_height': camera.size[1],
        'camera_name': camera.name,
        'camera_matrix': _sized(camera.matrix),
        'distortion_model': model,
        'distortion_coefficients': _sized(camera.distortion[None]),
        'rectification_matrix': _sized(np.eye(3)),
        'projection_matrix': _sized(np.eye(3, 4)),
    }
    return yaml.safe_dump(tree, sort_keys=False)


def _sized(matrix: Array) -> dict[str, object]:
    return {
        'rows': matrix.shape[0],
        'cols': matrix.shape[1],
        'data': matrix.ravel().tolist(),
    }


def kalibr_text(cameras: Sequence[Camera]) -> str:
    """Write as Kalibr does; its world is the first camera."""
    tree = {}
    for i, camera in enumerate(cameras):
        fx, fy, cx, cy = camera.pinhole
        entry = {
            'cam_overlaps': [],
            'camera_model': 'pinhole',
            'distortion_coeffs': camera.distortion.tolist(),
            'distortion_model': 'equidistant' if camera.model == 'equidistant' else 'radtan',
            'intrinsics': [fx, fy, cx, cy],
            'resolution': list(camera.size),
            'rostopic': f'/cam{i}/image_raw',
        }
        if i:
            step = pose_of(camera) @ pose_of(cameras[i - 1]).inverse()
            entry['T_cn_cnm1'] = step.matrix.tolist()
        tree[f'cam{i}'] = entry
    return yaml.safe_dump(tree)


def qualisys_text(cameras: Sequence[Camera]) -> str:
    """Write as QTM does (.qca.txt): millimetres, 1/64 pixels, cameras that look along -z."""
    elements = []
    for camera in cameras:
        fx, fy, cx, cy = (64.0 * v for v in camera.pinhole)
        k1, k2, p1, p2, *k3 = camera.distortion.tolist()
        world_T_camera = pose_of(camera).inverse()
        r = np.diag([1.0, -1.0, -1.0]) @ pose_of(camera).rotation
        x, y, z = (1000.0 * world_T_camera.translation).tolist()
        turn = ' '.join(f'r{i + 1}{j + 1}="{r[i, j]:.17g}"' for i in range(3) for j in range(3))
        right, bottom = camera.size[0] - 1, camera.size[1] - 1
        elements.append(
            f"""<camera active="1" avg-residual="0.4" serial="{camera.name}" model="Miqus Video"
 viewrotation="0"><fov_marker left="0" top="0" right="{right}" bottom="{bottom}"/>
<fov_video left="0" top="0" right="{right}" bottom="{bottom}"/>
<transform x="{x}" y="{y}" z="{z}" {turn}/>
<intrinsic focallength="9.3" sensorMinU="0.0" sensorMaxU="{64 * right}" sensorMinV="0.0"
 sensorMaxV="{64 * bottom}" focalLengthU="{fx}" focalLengthV="{fy}" centerPointU="{cx}"
 centerPointV="{cy}" skew="0.0" radialDistortion1="{k1}" radialDistortion2="{k2}"
 radialDistortion3="{k3[0] if k3 else 0.0}" tangentalDistortion1="{p1}"
 tangentalDistortion2="{p2}"/></camera>"""
        )
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<calibration type="regular" qtm-version="2021.2" wandLength="601.9" maximumFrames="100">
<results std-dev="0.5"/><cameras>{''.join(elements)}</cameras></calibration>
"""


def opencv_text(camera: Camera) -> str:
    """Write as cv::FileStorage does in OpenCV's calibration sample."""
    k = ', '.join(map(repr, camera.matrix.ravel().tolist()))
    d = ', '.join(map(repr, camera.distortion.tolist()))
    return f"""%YAML:1.0
---
calibration_time: "Thu 01 Jan 1970"
image_width: {camera.size[0]}
image_height: {camera.size[1]}
flags: 0
fisheye_model: {int(camera.model == 'equidistant')}
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ {k} ]
distortion_coefficients: !!opencv-matrix
   rows: {camera.distortion.size}
   cols: 1
   dt: d
   data: [ {d} ]
avg_reprojection_error: 3.1e-01
"""
