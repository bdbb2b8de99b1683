# SPDX-License-Identifier: Apache-2.0
"""The transform in every form that somebody may paste somewhere."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace

import yaml

from rpgd_ros.core import Camera, RigidTransform
from rpgd_ros.io.camera_files import toml_text
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
            cameras_toml(cameras, world_T_mocap, mocap_frame),
            'The cameras in the MoCap frame, for Pose2Sim, Anipose and their kin.',
        ),
    )


def cameras_toml(
    cameras: Sequence[Camera], world_T_mocap: RigidTransform, mocap_frame: str
) -> str:
    """Return the cameras in the MoCap's frame, as aniposelib and Pose2Sim read them."""
    identity = RigidTransform.identity()
    moved = [
        replace(camera, camera_T_world=(camera.camera_T_world or identity) @ world_T_mocap)
        for camera in cameras
    ]
    return toml_text(moved, mocap_frame).rstrip()


def _yaml(tree: object) -> str:
    text: str = yaml.safe_dump(tree, sort_keys=False, default_flow_style=None, width=99)
    return text.rstrip()
