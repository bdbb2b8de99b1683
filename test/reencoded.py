# SPDX-License-Identifier: Apache-2.0
"""A simulated recording as the drivers of real systems would have left it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import drivers
import numpy as np
from bags import Message
from drivers import NO_TURN, ZEROS

from rpgd_ros.core.geometry import Array
from rpgd_ros.io.rig import Rig
from rpgd_ros.simulation import SimulatedRecording
from rpgd_ros.skeletons import joint_names

STEP_NS = 50_000  # between two segments that vicon_receiver publishes

Encode = Callable[[int, Array], Iterator[tuple[str, int, Any]]]  # topic, stamp, message


def skeletons(recording: SimulatedRecording, encode: Encode) -> list[Message]:
    """Return the skeletons, each as the messages that a driver sends of it."""
    mocap = recording.mocap
    return [
        Message(topic, message.__msgtype__, stamp_ns + 2_000_000, drivers.serialise(message))
        for row, x in enumerate(mocap.x_mocap)
        for topic, stamp_ns, message in encode(int(mocap.stamp_ns[row]), x)
    ]


def keypoints(
    recording: SimulatedRecording, camera: int, encode: Callable[[int, Array, Array], Any]
) -> list[Message]:
    """Return the keypoints of one camera, as a detector sends them."""
    stream, name = recording.streams[camera], recording.cameras[camera].name
    messages = []
    for row in np.flatnonzero(stream.is_sent):
        message = encode(int(stream.stamp_ns[row]), stream.uv[row], stream.confidence[row])
        payload = message if isinstance(message, bytes) else drivers.serialise(message)
        kind = 'openpose_ros2_msgs/msg/PoseKeyPointsList'
        msgtype = kind if isinstance(message, bytes) else message.__msgtype__
        at_ns = int(stream.receive_ns[row])
        messages.append(Message(f'/{name}/keypoints', msgtype, at_ns, payload))
    return messages


def names_of(recording: SimulatedRecording) -> tuple[str, ...]:
    """Return the MoCap's joints."""
    return joint_names(recording.preset.mocap_joints)


def named(
    recording: SimulatedRecording, make: Callable[..., Any], pattern: str, topic: str
) -> Encode:
    """Encode skeletons in a type of named poses; zeros, quaternion included, are missing."""
    names = [pattern.replace('{joint}', name) for name in names_of(recording)]

    def encode(stamp_ns: int, x: Array) -> Iterator[tuple[str, int, Any]]:
        poses = {
            name: (xyz, NO_TURN) if np.isfinite(xyz).all() else ((0.0, 0.0, 0.0), ZEROS)
            for name, xyz in zip(names, x, strict=True)
        }
        yield topic, stamp_ns, make(poses, stamp_ns=stamp_ns)

    return encode


def per_segment(recording: SimulatedRecording) -> Encode:
    """Encode skeletons as vicon_receiver does: a topic and a stamp for each segment."""
    names = names_of(recording)

    def encode(stamp_ns: int, x: Array) -> Iterator[tuple[str, int, Any]]:
        for j, (name, xyz) in enumerate(zip(names, x, strict=True)):
            seen = bool(np.isfinite(xyz).all())
            at_ns = stamp_ns + j * STEP_NS
            place, turn = (xyz, NO_TURN) if seen else ((0.0, 0.0, 0.0), ZEROS)
            message = drivers.pose_stamped(place, turn, stamp_ns=at_ns, frame_id='vicon')
            yield f'/vicon/bob/{name}', at_ns, message

    return encode


def tf_tree(recording: SimulatedRecording, root: str = 'mocap') -> Encode:
    """Encode skeletons as Xsens does: a message per segment, each relative to the one before.

    Every link is turned, so that a chain that leaves out a rotation goes astray.
    """
    names = [f'bob_{name}' for name in names_of(recording)]
    turn = np.array([0.5, 0.5, 0.5, 0.5])  # a third of a turn about (1, 1, 1): x to y to z
    to_parent = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])

    def encode(stamp_ns: int, x: Array) -> Iterator[tuple[str, int, Any]]:
        root_R_parent, parent, at = np.eye(3), root, np.zeros(3)
        for name, xyz in zip(names, x, strict=True):
            link = drivers.transform(
                parent, name, root_R_parent.T @ (xyz - at), turn, stamp_ns=stamp_ns
            )
            yield '/tf', stamp_ns, drivers.tf_message([link])
            root_R_parent, parent, at = root_R_parent @ to_parent, name, xyz

    return encode


def with_mocap(rig: Rig, **changes: Any) -> Rig:
    """Return a rig whose MoCap source says something else."""
    return replace(rig, mocap=replace(rig.mocap, **changes))


def with_camera(rig: Rig, index: int, **changes: Any) -> Rig:
    """Return a rig of which one camera says something else."""
    cameras = list(rig.cameras)
    cameras[index] = replace(cameras[index], **changes)
    return replace(rig, cameras=tuple(cameras))


def in_order(*streams: Sequence[Message]) -> list[Message]:
    """Return messages by their arrival."""
    return sorted((m for stream in streams for m in stream), key=lambda m: m.receive_ns)
