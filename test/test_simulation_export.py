# SPDX-License-Identifier: Apache-2.0
"""Simulated recordings as messages and files: what is written is what was simulated."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import pytest
import yaml
from rosbags.highlevel import AnyReader

from rpgd_ros.io.rig import parse_rig, rig_text
from rpgd_ros.messages import (
    CAMERA_INFO,
    POINT_CLOUD2,
    POSE_ARRAY,
    JointBatch,
    decode_camera_info,
    decode_joints,
)
from rpgd_ros.simulation import (
    Corruption,
    Faults,
    SimulatedRecording,
    build_scene,
    preset,
    simulate,
)
from rpgd_ros.simulation.export import (
    MOCAP_TOPIC,
    Message,
    Storage,
    count_messages,
    messages_of,
    rig_of,
    truth_text,
    write_recording,
)


@pytest.fixture(scope='module')
def recording() -> SimulatedRecording:
    """Three seconds in the studio, with faults that the truth has to tell."""
    faults = Faults(Corruption(0.1, 'swap'), bias_m=0.02, lag_s=(0.0, 0.01, 0.02, -0.01))
    return simulate(build_scene(preset('studio'), 7, seconds=3.0, faults=faults))


@pytest.fixture(scope='module')
def messages(recording: SimulatedRecording) -> list[Message]:
    """All messages of the recording."""
    return list(messages_of(recording))


def decoded(messages: list[Message], topic: str, n_joints: int) -> JointBatch:
    """Read the messages of one topic back."""
    of_topic = [m for m in messages if m.topic == topic]
    n_values: Literal[2, 3] = 3 if topic == MOCAP_TOPIC else 2
    batch = decode_joints(
        of_topic[0].msgtype, [m.payload for m in of_topic], n_joints=n_joints, n_values=n_values
    ).batch
    assert batch is not None
    assert len(batch.stamp_ns) == len(of_topic)
    return batch


def test_messages_come_in_the_order_of_their_arrival(messages: list[Message]) -> None:
    """Detections arrive 0.1 s late, between skeletons that were stamped after them."""
    arrival = [m.receive_ns for m in messages]
    assert arrival == sorted(arrival)
    assert len({m.topic for m in messages[100:140]}) > 3


def test_intrinsics_come_first_and_once(
    recording: SimulatedRecording, messages: list[Message]
) -> None:
    """As a latched topic that was there before the recording began."""
    first = messages[: len(recording.cameras)]
    for camera, message in zip(recording.cameras, first, strict=True):
        assert message.topic == f'{camera.name}/camera_info'
        info = decode_camera_info(message.payload)
        np.testing.assert_array_equal(info.matrix, camera.matrix)
        np.testing.assert_array_equal(info.distortion, camera.distortion)
        assert info.size == camera.size
    assert sum(m.msgtype == CAMERA_INFO for m in messages) == len(recording.cameras)


def test_messages_are_counted_without_making_them(
    recording: SimulatedRecording, messages: list[Message]
) -> None:
    """The progress bar's total."""
    assert count_messages(recording) == len(messages)


@pytest.mark.parametrize(('mocap_type', 'digits'), [('PointCloud2', 1e-6), ('PoseArray', 0.0)])
def test_skeletons_read_back_as_they_were(
    recording: SimulatedRecording, mocap_type: str, digits: float
) -> None:
    """PointCloud2 carries float32, as drivers send; PoseArray float64."""
    sent = list(messages_of(recording, mocap_type))  # type: ignore[arg-type]
    types = {m.msgtype for m in sent if m.topic == MOCAP_TOPIC}
    assert types == {POSE_ARRAY if mocap_type == 'PoseArray' else POINT_CLOUD2}
    batch = decoded(sent, MOCAP_TOPIC, 12)
    assert batch.frame_id == 'mocap'
    np.testing.assert_array_equal(batch.stamp_ns, recording.mocap.stamp_ns)
    np.testing.assert_allclose(batch.values, recording.mocap.x_mocap, atol=digits, rtol=0.0)


def test_keypoints_read_back_as_they_were(
    recording: SimulatedRecording, messages: list[Message]
) -> None:
    """Missing keypoints stay missing, and frames that saw nobody are not sent."""
    n_unsent = 0
    for camera, stream in zip(recording.cameras, recording.streams, strict=True):
        batch = decoded(messages, f'{camera.name}/keypoints', 17)
        assert batch.frame_id == f'{camera.name}_optical_frame'
        np.testing.assert_array_equal(batch.stamp_ns, stream.stamp_ns[stream.is_sent])
        np.testing.assert_allclose(batch.values, stream.uv[stream.is_sent], atol=2e-4, rtol=0.0)
        assert batch.confidence is not None
        np.testing.assert_allclose(batch.confidence, stream.confidence[stream.is_sent], atol=1e-6)
        n_unsent += int((~stream.is_sent).sum())
    assert n_unsent > 0


def test_rig_file_reads_back_as_the_rig(recording: SimulatedRecording) -> None:
    """Cameras to the last bit, poses to rounding, joints by the names of their conventions."""
    text = rig_text(rig_of(recording))
    assert 'joints: plug_in_gait' in text
    assert 'keypoints: coco17' in text
    assert 'joint_map' not in text
    rig = parse_rig(text)
    assert rig.mocap.topic == MOCAP_TOPIC
    assert sorted(rig.cameras[0].pairs) == sorted(recording.pairs)
    for camera, read in zip(recording.cameras, rig.cameras, strict=True):
        assert read.camera is not None
        assert read.extrinsics is not None
        assert camera.camera_T_world is not None
        np.testing.assert_array_equal(read.camera.matrix, camera.matrix)
        np.testing.assert_array_equal(read.camera.distortion, camera.distortion)
        np.testing.assert_allclose(
            read.extrinsics.matrix, camera.camera_T_world.matrix, atol=1e-12
        )


def test_truth_file_agrees_with_itself(recording: SimulatedRecording) -> None:
    """Matrix, quaternion and control points say the same transform, read by hand."""
    truth = yaml.safe_load(truth_text(recording))
    pose = truth['world_T_mocap']
    matrix = np.array(pose['matrix'])
    np.testing.assert_allclose(matrix[:3, 3], pose['xyz'])
    x, y, z, w = pose['quat_xyzw']
    axis = np.array([x, y, z]) / np.linalg.norm([x, y, z])
    rotation = cv2.Rodrigues(2.0 * np.arctan2(np.linalg.norm([x, y, z]), w) * axis)[0]
    np.testing.assert_allclose(matrix[:3, :3], rotation, atol=1e-12)
    for point in truth['control_points']:
        moved = matrix @ [*point['mocap'], 1.0]
        np.testing.assert_allclose(moved[:3], point['world'], atol=1e-12)


def test_truth_file_tells_what_was_done_to_the_data(recording: SimulatedRecording) -> None:
    """Lags by camera, outliers, bias, seed."""
    truth = yaml.safe_load(truth_text(recording))
    assert truth['time_offset_s'] == {'cam0': 0.0, 'cam1': 0.01, 'cam2': 0.02, 'cam3': -0.01}
    assert truth['outliers'] == {'ratio': 0.1, 'kind': 'swap'}
    assert truth['joint_bias'] == {'sigma_m': 0.02, 'frame': 'heading'}
    assert (truth['preset'], truth['seed']) == ('studio', 7)


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_bag_holds_every_message(
    storage: Storage,
    recording: SimulatedRecording,
    messages: list[Message],
    tmp_path: Path,
) -> None:
    """Read by rosbags itself: topics, types, arrival and bytes."""
    told: list[tuple[str, float]] = []
    write_recording(
        recording, tmp_path, storage=storage, progress=lambda s, f: told.append((s, f))
    )
    with AnyReader([tmp_path / 'bag']) as bag:
        found = [
            Message(connection.topic.lstrip('/'), connection.msgtype, receive_ns, bytes(payload))
            for connection, receive_ns, payload in bag.messages()
        ]
    assert sorted(found) == sorted(messages)
    assert {p.name for p in tmp_path.iterdir()} == {'bag', 'rig.yaml', 'truth.yaml'}
    assert told[-1] == ('writing', 1.0)
