# SPDX-License-Identifier: Apache-2.0
"""Small simulated recordings as a rig file and serialised messages, for the node's tests."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rpgd_ros.core.geometry import Array, RigidTransform, rotation_angle
from rpgd_ros.io.rig import MocapSource, Rig, RigCamera, write_rig
from rpgd_ros.messages import POINT_CLOUD2, POSE_ARRAY, encode_point_cloud2, encode_pose_array
from rpgd_ros.ros.player import Timed
from rpgd_ros.simulation import SimulatedRecording, build_scene, preset, simulate
from rpgd_ros.skeletons import joint_names

MOCAP_TOPIC = 'mocap/skeleton'
WORLD, MOCAP = 'studio', 'vicon'


@dataclass(frozen=True, eq=False)
class Recording:
    """What a test plays, and the truth.

    Attributes:
        rig: Path of the rig file.
        topics: Type by topic.
        messages: In the order of their stamps.
        world_T_mocap: What is to be found.
        x_mocap: (M, J, 3) metres, the skeletons.

    """

    rig: Path
    topics: dict[str, str]
    messages: list[Timed]
    world_T_mocap: RigidTransform
    x_mocap: Array

    def error_deg(self, found: RigidTransform) -> float:
        """Return the angle between a found rotation and the true one."""
        return float(57.29578 * rotation_angle(found.rotation.T @ self.world_T_mocap.rotation))

    def error_m(self, found: RigidTransform) -> float:
        """Return the distance between the body's mean place under both transforms."""
        centre = self.x_mocap.reshape(-1, 3).mean(0)
        return float(abs(found @ centre - self.world_T_mocap @ centre).max())


def rig_of(recording: SimulatedRecording) -> Rig:
    """Return the rig of a simulated recording."""
    scene = recording.preset
    return Rig(
        world_frame=WORLD,
        mocap=MocapSource(MOCAP_TOPIC, joint_names(scene.mocap_joints)),
        cameras=tuple(
            RigCamera(
                name=camera.name,
                keypoints_topic=f'{camera.name}/keypoints',
                keypoint_joints=joint_names(scene.keypoint_joints),
                pairs=recording.pairs,
                camera=camera,
                extrinsics=camera.camera_T_world,
            )
            for camera in recording.cameras
        ),
    )


def record(folder: Path, *, seconds: float = 8.0, still: bool = False, seed: int = 3) -> Recording:
    """Simulate a person in the studio, as a rig file in a folder and messages."""
    scene = build_scene(preset('studio'), seed, seconds=seconds, motion='still' if still else 'walk')
    recording = simulate(scene)
    rig = folder / 'rig.yaml'
    write_rig(rig, rig_of(recording))
    messages = [
        Timed(MOCAP_TOPIC, int(stamp), encode_pose_array(int(stamp), MOCAP, x))
        for stamp, x in zip(recording.mocap.stamp_ns, recording.mocap.x_mocap, strict=True)
    ]
    topics = {MOCAP_TOPIC: POSE_ARRAY}
    for camera, stream in zip(recording.cameras, recording.streams, strict=True):
        topic = f'{camera.name}/keypoints'
        topics[topic] = POINT_CLOUD2
        messages += [
            Timed(topic, int(stamp), encode_point_cloud2(int(stamp), camera.name, uv, scores))
            for stamp, uv, scores in zip(
                stream.stamp_ns, stream.uv, stream.confidence, strict=True
            )
        ]
    messages.sort(key=lambda message: message.stamp_ns)
    truth = recording.truth.world_T_mocap
    return Recording(rig, topics, messages, truth, recording.mocap.x_mocap)
