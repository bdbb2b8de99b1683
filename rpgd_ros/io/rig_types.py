# SPDX-License-Identifier: Apache-2.0
"""What a rig file says, as types."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

from rpgd_ros.core.camera import Camera
from rpgd_ros.core.geometry import RigidTransform

SCHEMA: Final = 1
Units = Literal['m', 'cm', 'mm', 'inch']
METRES_PER: Final[dict[str, float]] = {'m': 1.0, 'cm': 0.01, 'mm': 0.001, 'inch': 0.0254}
KeypointUnits = Literal['pixels', 'normalized', 'auto']
KEYPOINT_UNITS: Final = ('pixels', 'normalized', 'auto')
JOINT: Final = '{joint}'  # stands for the joint in a pattern of names or topics


@dataclass(frozen=True, slots=True)
class MocapSource:
    """The MoCap system.

    Attributes:
        topic: Of the skeleton; with `{joint}` in it, each joint has a topic of its own.
        joints: (J,) in message order.
        units: Of the positions.
        frame: MoCap frame; '' = that of the messages.
        type: Message type; '' = what the publisher says.
        time_offset_s: How late the skeleton is stamped: true time = stamp - offset.
        names: What the messages call the joints, where they come by name: a text with `{joint}`.

    """

    topic: str
    joints: tuple[str, ...]
    units: Units = 'm'
    frame: str = ''
    type: str = ''
    time_offset_s: float = 0.0
    names: str = JOINT

    @property
    def sent_names(self) -> tuple[str, ...]:
        """What the messages call the joints."""
        return tuple(self.names.replace(JOINT, joint) for joint in self.joints)


@dataclass(frozen=True, slots=True, eq=False)
class RigCamera:
    """One camera and its detector.

    Attributes:
        name: Of the camera.
        keypoints_topic: Of the detector's keypoints.
        keypoint_joints: (K,) keypoints in message order.
        pairs: (MoCap joint, keypoint) indices.
        camera: Intrinsics of the file, with the extrinsics; None where CameraInfo gives them.
        camera_info_topic: Of the CameraInfo; '' where the file has the intrinsics.
        frame_id: Optical frame whose pose TF gives; '' = none.
        units: pixels; normalized: 0 to 1 over the image; auto: told by the size of the numbers.
        rectified: Whether the keypoints were found in rectified images.
        time_offset_s: How late the video is stamped: true time = stamp - offset.
        min_confidence: Keypoints with a lower score are missing.
        extrinsics: camera_T_world of the file, or None.
        type: Message type of the keypoints; '' = what the publisher says.

    """

    name: str
    keypoints_topic: str
    keypoint_joints: tuple[str, ...]
    pairs: tuple[tuple[int, int], ...]
    camera: Camera | None = None
    camera_info_topic: str = ''
    frame_id: str = ''
    units: KeypointUnits = 'pixels'
    rectified: bool = False
    time_offset_s: float = 0.0
    min_confidence: float = 0.0
    extrinsics: RigidTransform | None = None
    type: str = ''


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """Everything a rig file says.

    Attributes:
        world_frame: Parent frame of the transform that is sought.
        mocap: The MoCap system.
        cameras: In the order of the file.

    """

    world_frame: str
    mocap: MocapSource
    cameras: tuple[RigCamera, ...]

    @property
    def used_joints(self) -> tuple[int, ...]:
        """Joints of the MoCap that some camera sees, in order."""
        return tuple(sorted({j for camera in self.cameras for j, _ in camera.pairs}))

    @property
    def mocap_topics(self) -> dict[str, str]:
        """Topics of the skeleton, and the name of the joint that each carries; '' = all."""
        mocap = self.mocap
        if JOINT not in mocap.topic:
            return {mocap.topic: ''}
        joints = [(mocap.joints[j], mocap.sent_names[j]) for j in self.used_joints]
        return {mocap.topic.replace(JOINT, joint): name for joint, name in joints}
