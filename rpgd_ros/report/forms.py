# SPDX-License-Identifier: Apache-2.0
"""The transform in every form that somebody may paste somewhere."""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np
import yaml

from rpgd_ros.core import Camera, RigidTransform
from rpgd_ros.core.geometry import Array, so3_log
from rpgd_ros.io.result_file import for_other_tools
from rpgd_ros.report.blocks import Code


def forms(
    world_T_mocap: RigidTransform,
    cameras: Sequence[Camera],
    *,
    world_frame: str,
    mocap_frame: str,
) -> tuple[Code, ...]:
    """Return the transform for people and programs, ready to paste.

    Args:
        world_T_mocap: The transform.
        cameras: Of the rig, for programs that take the cameras in the MoCap's frame.
        world_frame: Parent frame.
        mocap_frame: Child frame.

    """
    others = for_other_tools(world_T_mocap, world_frame, mocap_frame)
    matrix = world_T_mocap.matrix.tolist()
    tree = {
        'world_frame': world_frame,
        'mocap_frame': mocap_frame,
        'world_T_mocap': {
            'xyz': world_T_mocap.translation.tolist(),
            'quat_xyzw': world_T_mocap.quat_xyzw.tolist(),
        },
    }
    vicon = {'vicon_receiver': {'ros__parameters': others['vicon_receiver']}}
    rows = ',\n '.join(json.dumps(row) for row in matrix)
    return (
        Code('TF', others['static_transform_publisher'], 'Run it, or put it into a launch file.'),
        Code('YAML', _yaml(tree), 'Translation in metres, quaternion x y z w.'),
        Code('Matrix', f'[{rows}]', 'Homogeneous, row by row: x_world = M x_mocap.'),
        Code('URDF', others['urdf_origin'], 'The <origin> of a joint from world to MoCap.'),
        Code('vicon_receiver', _yaml(vicon), 'Its parameters: it then publishes in the world.'),
        Code(
            'TOML',
            cameras_toml(cameras, world_T_mocap),
            'The cameras in the MoCap frame, for Pose2Sim, Anipose and their kin.',
        ),
    )


def cameras_toml(cameras: Sequence[Camera], world_T_mocap: RigidTransform) -> str:
    """Return the cameras in the MoCap's frame as aniposelib and Pose2Sim read them.

    Args:
        cameras: Of the rig; one without a pose is the world itself.
        world_T_mocap: The transform.

    Returns:
        TOML; rotations as Rodrigues vectors of `camera_T_mocap`, translations in metres.

    """
    parts = []
    for i, camera in enumerate(cameras):
        camera_T_mocap = (camera.camera_T_world or RigidTransform.identity()) @ world_T_mocap
        distortion = camera.distortion if camera.distortion.size else np.zeros(4)
        parts.append(
            f'[cam_{i}]\n'
            f'name = {json.dumps(camera.name)}\n'
            f'size = {json.dumps(list(camera.size))}\n'
            f'matrix = [{", ".join(_list(row) for row in camera.matrix)}]\n'
            f'distortions = {_list(distortion)}\n'
            f'rotation = {_list(so3_log(camera_T_mocap.rotation))}\n'
            f'translation = {_list(camera_T_mocap.translation)}\n'
            f'fisheye = {json.dumps(camera.model == "equidistant")}\n'
        )
    return '\n'.join([*parts, '[metadata]\nadjusted = false\nerror = 0.0'])


def _list(values: Array) -> str:
    return json.dumps(np.asarray(values, np.float64).tolist())


def _yaml(tree: object) -> str:
    text: str = yaml.safe_dump(tree, sort_keys=False, default_flow_style=None, width=99)
    return text.rstrip()
