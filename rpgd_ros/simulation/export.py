# SPDX-License-Identifier: Apache-2.0
"""A simulated recording as files: a bag, its rig file, and the truth beside them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import yaml

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import Array
from rpgd_ros.io.atomic import write_atomic
from rpgd_ros.io.bag import BagWriter, absolute_name
from rpgd_ros.io.rig import MocapSource, Rig, RigCamera, write_rig
from rpgd_ros.messages import (
    CAMERA_INFO,
    POINT_CLOUD2,
    POSE_ARRAY,
    encode_camera_info,
    encode_point_cloud2,
    encode_pose_array,
)
from rpgd_ros.simulation.recording import SimulatedRecording
from rpgd_ros.skeletons import joint_names, match_joints

MocapType = Literal['PointCloud2', 'PoseArray']
Storage = Literal['mcap', 'sqlite3']

WORLD_FRAME = 'world'
MOCAP_FRAME = 'mocap'
MOCAP_TOPIC = 'mocap/skeleton'
BAG, RIG, TRUTH = 'bag', 'rig.yaml', 'truth.yaml'
CONVENTION = (
    'x_world = matrix @ [x_mocap, 1]; xyz is the MoCap origin in the world, metres; quat_xyzw is '
    'a Hamilton quaternion x y z w'
)
PROGRESS_EVERY = 500  # messages: a tenth of a second


class Message(NamedTuple):
    """One message of a bag.

    Attributes:
        topic: Relative name, as the node's.
        msgtype: ROS type.
        receive_ns: Arrival.
        payload: CDR bytes.

    """

    topic: str
    msgtype: str
    receive_ns: int
    payload: bytes


def write_recording(
    recording: SimulatedRecording,
    folder: Path,
    *,
    storage: Storage = 'mcap',
    mocap_type: MocapType = 'PointCloud2',
    blind: Collection[str] = (),
    progress: Callable[[str, float], None] | None = None,
) -> None:
    """Write `bag`, `rig.yaml` and `truth.yaml` into an existing, empty folder.

    Args:
        recording: What to write.
        folder: Where.
        storage: Format of the bag.
        mocap_type: Message type of the skeletons.
        blind: Cameras whose extrinsics the rig file does not give.
        progress: Called with a stage and the fraction of it that is done.

    Raises:
        InputError: NOT_WRITABLE; several subjects in a message type that holds one.

    """
    if mocap_type == 'PoseArray' and recording.n_subjects > 1:
        msg = 'a PoseArray holds one skeleton: take PointCloud2 for several subjects'
        raise InputError(Reason.BAD_INPUT, msg)
    total = count_messages(recording)
    with BagWriter(folder / BAG, storage=storage) as bag:
        for number, message in enumerate(messages_of(recording, mocap_type)):
            topic = absolute_name(message.topic)
            bag.write(topic, message.msgtype, message.receive_ns, message.payload)
            if progress and number % PROGRESS_EVERY == 0:
                progress('writing', number / total)
    write_rig(folder / RIG, rig_of(recording, blind))
    write_atomic(folder / TRUTH, truth_text(recording))
    if progress:
        progress('writing', 1.0)


def count_messages(recording: SimulatedRecording) -> int:
    """Return how many messages the bag of a recording holds."""
    detections = sum(int(recording.is_sent(v).sum()) for v in range(len(recording.streams)))
    return len(recording.mocap.stamp_ns) + detections + len(recording.cameras)


def messages_of(
    recording: SimulatedRecording, mocap_type: MocapType = 'PointCloud2'
) -> Iterator[Message]:
    """Yield the messages in the order of their arrival; intrinsics first, once per camera."""
    arrivals = [recording.mocap.receive_ns, *(s.receive_ns for s in recording.streams)]
    stream_of = np.repeat(np.arange(len(arrivals)), [len(a) for a in arrivals])
    row_of = np.concatenate([np.arange(len(a)) for a in arrivals])
    order = np.lexsort((stream_of, np.concatenate(arrivals)))
    first_ns = int(min(a[0] for a in arrivals))
    for camera in recording.cameras:
        payload = encode_camera_info(camera, first_ns, _optical_frame(camera.name))
        yield Message(f'{camera.name}/camera_info', CAMERA_INFO, first_ns, payload)
    sent = [recording.is_sent(v) for v in range(len(recording.streams))]
    for stream, row in zip(stream_of[order].tolist(), row_of[order].tolist(), strict=True):
        if stream == 0:
            yield _skeleton(recording, row, mocap_type)
        elif sent[stream - 1][row]:
            yield _keypoints(recording, stream - 1, row)


def _skeleton(recording: SimulatedRecording, row: int, mocap_type: MocapType) -> Message:
    mocap = recording.mocap
    stamp_ns, receive_ns = int(mocap.stamp_ns[row]), int(mocap.receive_ns[row])
    joints = recording.skeletons(row)
    if mocap_type == 'PoseArray':
        payload = encode_pose_array(stamp_ns, MOCAP_FRAME, joints)
        return Message(MOCAP_TOPIC, POSE_ARRAY, receive_ns, payload)
    payload = encode_point_cloud2(stamp_ns, MOCAP_FRAME, joints)
    return Message(MOCAP_TOPIC, POINT_CLOUD2, receive_ns, payload)


def _keypoints(recording: SimulatedRecording, camera: int, row: int) -> Message:
    stream, name = recording.streams[camera], recording.cameras[camera].name
    payload = encode_point_cloud2(
        int(stream.stamp_ns[row]), _optical_frame(name), *recording.detections(camera, row)
    )
    return Message(f'{name}/keypoints', POINT_CLOUD2, int(stream.receive_ns[row]), payload)


def _optical_frame(camera: str) -> str:
    return f'{camera}_optical_frame'


def rig_of(recording: SimulatedRecording, blind: Collection[str] = ()) -> Rig:
    """Return what a user would have to write about the recording.

    Args:
        recording: What was filmed.
        blind: Cameras of which the user does not know the extrinsics.

    """
    mocap_joints = joint_names(recording.preset.mocap_joints)
    keypoints = joint_names(recording.preset.keypoint_joints)
    pairs = match_joints(mocap_joints, keypoints)
    return Rig(
        world_frame=WORLD_FRAME,
        mocap=MocapSource(topic=MOCAP_TOPIC, joints=mocap_joints),
        cameras=tuple(
            RigCamera(
                name=camera.name,
                keypoints_topic=f'{camera.name}/keypoints',
                keypoint_joints=keypoints,
                pairs=pairs,
                camera=camera,
                extrinsics=camera.camera_T_world,
            )
            for camera in (
                replace(c, camera_T_world=None) if c.name in blind else c
                for c in recording.cameras
            )
        ),
    )


def truth_text(recording: SimulatedRecording) -> str:
    """Return the truth as YAML: the drawn transform, and points known in both frames."""
    truth = recording.truth
    faults = truth.faults
    tree = {
        'schema': 1,
        'convention': CONVENTION,
        'world_frame': WORLD_FRAME,
        'mocap_frame': MOCAP_FRAME,
        'world_T_mocap': {
            'xyz': truth.world_T_mocap.translation.tolist(),
            'quat_xyzw': truth.world_T_mocap.quat_xyzw.tolist(),
            'matrix': truth.world_T_mocap.matrix.tolist(),
        },
        'camera_T_world': {
            camera.name: {
                'xyz': camera.camera_T_world.translation.tolist(),
                'quat_xyzw': camera.camera_T_world.quat_xyzw.tolist(),
            }
            for camera in recording.cameras
            if camera.camera_T_world is not None
        },
        'control_points': _control_points(truth.control_mocap, truth.control_world),
        'time_offset_s': {
            camera.name: lag for camera, lag in zip(recording.cameras, truth.lags_s, strict=True)
        },
        'keypoint_noise': {'sigma_px': truth.sigma_px, 'student_nu': truth.student_nu},
        'joint_noise_m': truth.sigma_m,
        'outliers': {'ratio': faults.corruption.ratio, 'kind': faults.corruption.kind},
        'joint_bias': {'sigma_m': faults.bias_m, 'frame': faults.bias_frame},
        'persons': recording.n_persons,
        'subjects': recording.n_subjects,
        'preset': recording.preset.name,
        'seed': recording.seed,
    }
    return yaml.safe_dump(tree, sort_keys=False, default_flow_style=None)


def _control_points(mocap: Array, world: Array) -> list[dict[str, Any]]:
    return [{'mocap': m, 'world': w} for m, w in zip(mocap.tolist(), world.tolist(), strict=True)]
