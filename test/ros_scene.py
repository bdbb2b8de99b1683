# SPDX-License-Identifier: Apache-2.0
"""Small simulated recordings as a rig file and serialised messages, for the node's tests."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rpgd_ros.core.geometry import RigidTransform
from rpgd_ros.io.rig import write_rig
from rpgd_ros.messages import CAMERA_INFO
from rpgd_ros.simulation import SimulatedRecording, build_scene, preset, simulate
from rpgd_ros.simulation.export import messages_of, rig_of
from rpgd_ros.simulation.motion import MotionName

WORLD_FRAME, MOCAP_FRAME = 'world', 'mocap'


@dataclass(frozen=True, eq=False)
class Scene:
    """What a test plays, and the truth.

    Attributes:
        rig: Path of the rig file.
        topics: Type by topic.
        messages: Topic, time and payload, in the order of their arrival.
        recording: Where they come from.

    """

    rig: Path
    topics: dict[str, str]
    messages: list[tuple[str, int, bytes]]
    recording: SimulatedRecording

    @property
    def world_T_mocap(self) -> RigidTransform:
        """What is to be found."""
        return self.recording.truth.world_T_mocap


def make_scene(
    folder: Path, *, seconds: float = 8.0, motion: MotionName = 'walk', seed: int = 3
) -> Scene:
    """Simulate a person in the studio; the rig file goes into a folder."""
    recording = simulate(build_scene(preset('studio'), seed, seconds=seconds, motion=motion))
    rig = folder / 'rig.yaml'
    write_rig(rig, rig_of(recording))
    # PoseArray for the skeletons: both message types of joints are played.
    sent = [m for m in messages_of(recording, 'PoseArray') if m.msgtype != CAMERA_INFO]
    topics = {message.topic: message.msgtype for message in sent}
    messages = [(message.topic, message.receive_ns, message.payload) for message in sent]
    return Scene(rig, topics, messages, recording)
