# SPDX-License-Identifier: Apache-2.0
"""Rig file and parameters together: what the node is to do. Needs no ROS."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.io.rig import Rig, RigCamera, read_rig
from rpgd_ros.io.rig_reader import FRAME
from rpgd_ros.ros.parameters import check_names, read_config, shown
from rpgd_ros.ros.settings import CameraSettings, MocapSettings, NodeConfig, NodeSettings

NO_RIG_FILE = (
    'no rig file: parameter rig_file is not set. Start with --ros-args -p rig_file:=<path>, or '
    'with a parameter file whose first key is /**: or the name of this node'
)


def read_setup(given: Mapping[str, object]) -> tuple[Rig, NodeConfig]:
    """Read the rig file that the parameters name, and let parameters override it.

    Args:
        given: Parameter values by full name.

    Returns:
        The rig with the cameras that are to be used, and the configuration.

    Raises:
        InputError: No rig file or one that cannot be used, or bad parameters.

    """
    check_names(given, cameras=None)
    path = given.get('rig_file', '')
    if not isinstance(path, str) or not path:
        raise InputError(Reason.BAD_PARAMETER, NO_RIG_FILE)
    rig = read_rig(Path(path).expanduser())
    names = [camera.name for camera in rig.cameras]
    config = read_config(given, names, base=config_of(rig))
    return overridden(rig, config), config


def config_of(rig: Rig) -> NodeConfig:
    """Return the defaults, with what the rig file says."""
    mocap = rig.mocap
    return NodeConfig(
        node=NodeSettings(world_frame=rig.world_frame, mocap_frame=mocap.frame),
        mocap=MocapSettings(
            topic=mocap.topic,
            type=mocap.type,
            units=mocap.units,
            time_offset=mocap.time_offset_s,
        ),
        cameras={
            camera.name: CameraSettings(
                keypoints_topic=camera.keypoints_topic,
                type=camera.type,
                camera_info_topic=camera.camera_info_topic,
                frame_id=camera.frame_id,
                units=camera.units,
                rectified=camera.rectified,
                time_offset=camera.time_offset_s,
                min_confidence=camera.min_confidence,
            )
            for camera in rig.cameras
        },
    )


def overridden(rig: Rig, config: NodeConfig) -> Rig:
    """Return the rig as the parameters have it, with the cameras that are wanted.

    Raises:
        InputError: BAD_PARAMETER. A name that no frame may have, or both frames have the same.

    """
    frames = {'world_frame': config.node.world_frame, 'mocap_frame': config.node.mocap_frame}
    frames |= {f'camera.{name}.frame_id': c.frame_id for name, c in config.cameras.items()}
    for name, frame in frames.items():
        if not FRAME.fullmatch(frame) and (frame or name == 'world_frame'):
            msg = f'{name}: need a frame without blanks and without / in front, got {shown(frame)}'
            raise InputError(Reason.BAD_PARAMETER, msg)
    if config.node.mocap_frame == config.node.world_frame:
        msg = (
            f'world_frame and mocap_frame are both {shown(config.node.world_frame)}: '
            'the transform between them needs two names'
        )
        raise InputError(Reason.BAD_PARAMETER, msg)
    wanted = config.node.cameras
    cameras = (c for c in rig.cameras if not wanted or c.name in wanted)
    return Rig(
        world_frame=config.node.world_frame,
        mocap=replace(
            rig.mocap,
            topic=config.mocap.topic,
            type=config.mocap.type,
            units=config.mocap.units,
            frame=config.node.mocap_frame,
            time_offset_s=config.mocap.time_offset,
        ),
        cameras=tuple(_overridden(camera, config.cameras[camera.name]) for camera in cameras),
    )


def _overridden(camera: RigCamera, settings: CameraSettings) -> RigCamera:
    extrinsics, intrinsics = camera.extrinsics, camera.camera
    if settings.frame_id != camera.frame_id:
        # The parameter goes before the rig file: the pose is that of TF.
        extrinsics = None
        intrinsics = None if intrinsics is None else replace(intrinsics, camera_T_world=None)
    return replace(
        camera,
        camera=intrinsics,
        keypoints_topic=settings.keypoints_topic,
        type=settings.type,
        camera_info_topic=settings.camera_info_topic,
        frame_id=settings.frame_id,
        extrinsics=extrinsics,
        units=settings.units,
        rectified=settings.rectified,
        time_offset_s=settings.time_offset,
        min_confidence=settings.min_confidence,
    )
