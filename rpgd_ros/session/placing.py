# SPDX-License-Identifier: Apache-2.0
"""Which cameras have a pose, which wait for one, and which are to be placed by the solve."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import NamedTuple

from rpgd_ros.core.camera import Camera
from rpgd_ros.core.errors import CalibrationError, Reason
from rpgd_ros.core.geometry import RigidTransform
from rpgd_ros.session.inputs import CameraInput

# How drivers name the frame whose z axis looks forward (REP 103); others have other axes.
OPTICAL = re.compile(r'.*optical(_frame)?')


class Usable(NamedTuple):
    """The cameras that a solve can use.

    Attributes:
        cameras: With intrinsics; without a pose where the solve is to place them.
        turns: Of the latter, optical frame to camera: a rectified image is turned against it.

    """

    cameras: tuple[Camera, ...]
    turns: Mapping[str, RigidTransform]


def usable_cameras(inputs: Mapping[str, CameraInput], info_topics: Iterable[str]) -> Usable:
    """Return the cameras that have intrinsics.

    A rig's only camera is the world itself. Of several, those that neither the rig file nor TF
    shall place are placed by the solve. Those that TF was to place and did not are left out where
    another has a pose in the world.

    Args:
        inputs: All cameras of the rig.
        info_topics: Topics of the CameraInfo that are listened to.

    Raises:
        CalibrationError: MISSING_INTRINSICS of all cameras; NO_EXTRINSICS where TF was to give
            them, and no camera has any.

    """
    cameras = {name: source.camera for name, source in inputs.items() if source.camera is not None}
    if not cameras:
        topics = ', '.join(info_topics)
        msg = f'no intrinsics of any camera: no usable CameraInfo arrived on {topics}'
        raise CalibrationError(Reason.MISSING_INTRINSICS, msg)
    if len(inputs) == 1:
        # The only camera may be the world itself; rectified, it is turned against it.
        (camera,) = cameras.values()
        pose = camera.camera_T_world or RigidTransform.identity()
        return Usable((replace(camera, camera_T_world=pose),), {})
    without = [name for name in cameras if not inputs[name].has_pose]
    waiting = [name for name in without if inputs[name].rig.frame_id]
    if len(without) < len(cameras):
        cameras = {name: c for name, c in cameras.items() if name not in waiting}
        without = [name for name in without if name not in waiting]
    elif waiting:
        named = ', '.join(f'{n} ({inputs[n].rig.frame_id[:80]!r})' for n in waiting)
        msg = (
            f'no extrinsics of {named}: TF was to give the pose of its frame_id. '
            'Publish it, give camera_T_world in the rig file, or neither: then the calibration '
            'finds the pose, too'
        )
        raise CalibrationError(Reason.NO_EXTRINSICS, msg)
    turns = {n: cameras[n].camera_T_world or RigidTransform.identity() for n in without}
    placed = (
        replace(c, camera_T_world=None) if name in turns else c for name, c in cameras.items()
    )
    return Usable(tuple(placed), turns)


def optical_frames(inputs: Mapping[str, CameraInput], taken: Iterable[str]) -> dict[str, str]:
    """Return the name of each camera's optical frame, for TF.

    That of the rig file, of its CameraInfo or of its keypoints, if it sounds like an optical frame
    and nothing else has it; else the camera's name and `_optical_frame`.

    Args:
        inputs: All cameras of the rig.
        taken: Names of other frames.

    """
    said = {name: source.frame_names for name, source in inputs.items()}
    frames: dict[str, str] = {}
    for name in inputs:
        used = {*taken, *frames.values(), *(f for n in said if n != name for f in said[n])}
        good = [f for f in said[name] if OPTICAL.fullmatch(f) and f not in used]
        frames[name] = good[0] if good else f'{name}_optical_frame'
    return frames
