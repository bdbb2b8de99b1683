# SPDX-License-Identifier: Apache-2.0
"""The rig file: which topics, joints and cameras there are. The user's main input."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from rpgd_ros.core.camera import Camera
from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import RigidTransform
from rpgd_ros.io.atomic import write_atomic
from rpgd_ros.io.rig_reader import rig_from_node
from rpgd_ros.io.rig_types import JOINT, METRES_PER, SCHEMA, MocapSource, Rig, RigCamera
from rpgd_ros.io.strict import parse_yaml, read_yaml
from rpgd_ros.skeletons import CONVENTIONS, match_joints

__all__ = [
    'METRES_PER',
    'MocapSource',
    'Rig',
    'RigCamera',
    'parse_rig',
    'read_rig',
    'rig_text',
    'with_poses',
    'write_rig',
]


def read_rig(path: Path | str) -> Rig:
    """Read a rig file.

    Raises:
        InputError: BAD_RIG or MISSING_INTRINSICS. The message names file, key, what was found and
            what is needed.

    """
    return rig_from_node(read_yaml(path, Reason.BAD_RIG))


def parse_rig(text: str, source: str = 'rig') -> Rig:
    """Read the text of a rig file.

    Args:
        text: YAML.
        source: What messages call it.

    Raises:
        InputError: As `read_rig`.

    """
    return rig_from_node(parse_yaml(text, source, Reason.BAD_RIG))


def write_rig(path: Path | str, rig: Rig) -> None:
    """Write a rig file that reads back as the same rig.

    Raises:
        InputError: NOT_WRITABLE.

    """
    write_atomic(path, rig_text(rig))


def with_poses(rig: Rig, poses: Mapping[str, RigidTransform]) -> Rig:
    """Return a rig in which cameras have the extrinsics that were found for them.

    Args:
        rig: With or without extrinsics.
        poses: camera_T_world of the optical frames, by camera.

    """
    cameras = []
    for c in rig.cameras:
        pose = poses.get(c.name, c.extrinsics)
        camera = c.camera if c.camera is None else replace(c.camera, camera_T_world=pose)
        cameras.append(replace(c, extrinsics=pose, camera=camera))
    return replace(rig, cameras=tuple(cameras))


def rig_text(rig: Rig) -> str:
    """Return a rig as the text of a rig file."""
    mocap = rig.mocap
    tree = {
        'schema': SCHEMA,
        'world_frame': rig.world_frame,
        'mocap': {
            'topic': mocap.topic,
            'joints': _joints(mocap.joints),
            'units': mocap.units,
            **_given(frame=mocap.frame, type=mocap.type, time_offset=mocap.time_offset_s),
            **_given(names=mocap.names if mocap.names != JOINT else ''),
        },
        'cameras': [_camera(camera, mocap.joints) for camera in rig.cameras],
    }
    return yaml.safe_dump(tree, sort_keys=False, default_flow_style=None, allow_unicode=True)


def _camera(camera: RigCamera, mocap_joints: tuple[str, ...]) -> dict[str, Any]:
    tree: dict[str, Any] = {
        'name': camera.name,
        'keypoints_topic': camera.keypoints_topic,
        'keypoints': _joints(camera.keypoint_joints),
        **_given(
            joint_map=_joint_map(camera, mocap_joints),
            camera_info_topic=camera.camera_info_topic,
            frame_id=camera.frame_id,
            rectified=camera.rectified,
            time_offset=camera.time_offset_s,
            min_confidence=camera.min_confidence,
            type=camera.type,
        ),
    }
    if camera.units != 'pixels':
        tree['units'] = camera.units
    if camera.camera is not None:
        tree |= _intrinsics(camera.camera)
    if camera.extrinsics is not None:
        pose = camera.extrinsics
        tree['camera_T_world'] = {
            'xyz': pose.translation.tolist(),
            'quat_xyzw': pose.quat_xyzw.tolist(),
        }
    return tree


def _intrinsics(camera: Camera) -> dict[str, Any]:
    model = 'equidistant' if camera.model == 'equidistant' else 'plumb_bob'
    if camera.distortion.size == 8:
        model = 'rational_polynomial'
    return {
        'size': list(camera.size),
        'matrix': camera.matrix.ravel().tolist(),
        'distortion_model': model,
        'distortion': camera.distortion.tolist(),
    }


def _joint_map(camera: RigCamera, mocap_joints: tuple[str, ...]) -> dict[str, str | None]:
    """Return what the pairs of a camera add to, or take from, those found by name."""
    names = camera.keypoint_joints
    mapped: dict[str, str | None] = {names[k]: mocap_joints[j] for j, k in camera.pairs}
    try:
        by_name = match_joints(mocap_joints, names)
    except InputError:
        return mapped
    if by_name == camera.pairs:
        return {}
    return {names[k]: None for _, k in by_name} | mapped


def _joints(joints: tuple[str, ...]) -> str | list[str]:
    """Return the name of a convention, or the list."""
    return next((name for name, known in CONVENTIONS.items() if known == joints), list(joints))


def _given(**entries: Any) -> dict[str, Any]:
    """Return the entries that are not empty, zero or false, which are the defaults."""
    return {key: value for key, value in entries.items() if value}
