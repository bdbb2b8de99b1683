# SPDX-License-Identifier: Apache-2.0
"""The offline program with cameras that the bag itself describes: /tf_static and CameraInfo."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import report_cases
import yaml
from bags import Message, write_bag

from rpgd_ros.apps import calibrate_bag
from rpgd_ros.core.geometry import RigidTransform, so3_exp
from rpgd_ros.io.bag import BagWriter, open_bag
from rpgd_ros.io.result_file import read_result
from rpgd_ros.io.rig import read_rig, write_rig
from rpgd_ros.messages import CAMERA_INFO, TF_MESSAGE, Link, encode_camera_info, encode_tf
from rpgd_ros.simulation import SimulatedRecording, build_scene, preset, simulate
from rpgd_ros.simulation.export import messages_of, write_recording

MOUNT = RigidTransform(so3_exp([0.1, 0.2, 0.3]), np.array([1.0, -1.0, 2.0]))


@pytest.fixture(scope='module')
def recording() -> SimulatedRecording:
    """Return a walk of 8 s before four cameras."""
    return simulate(build_scene(preset('studio'), 0, seconds=8.0))


def joints_of(recording: SimulatedRecording) -> list[Message]:
    """Return skeletons and keypoints."""
    sent = (Message(*m) for m in messages_of(recording, 'PointCloud2') if m[1] != CAMERA_INFO)
    return [m._replace(topic=f'/{m.topic}') for m in sent]


def write_rig_file(recording: SimulatedRecording, folder: Path, *, without: Sequence[str]) -> Path:
    """Write the rig file less some keys of its cameras, whose frames are named instead."""
    write_recording(recording, folder)
    tree = yaml.safe_load((folder / 'rig.yaml').read_text())
    for camera in tree['cameras']:
        for key in without:
            camera.pop(key, None)
        if 'camera_T_world' in without:
            camera['frame_id'] = f'{camera["name"]}_optical'
        if 'matrix' in without:
            camera['camera_info_topic'] = f'{camera["name"]}/camera_info'
    path = folder / 'bare.yaml'
    path.write_text(yaml.safe_dump(tree))
    return path


def poses_of(recording: SimulatedRecording, at: int) -> list[Message]:
    """Return /tf_static as two publishers send it: the mounts, and the cameras on them."""
    mounts, cameras = [], []
    for camera in recording.cameras:
        assert camera.camera_T_world is not None
        mounts.append(Link('world', f'{camera.name}_mount', MOUNT))
        mount_T_optical = MOUNT.inverse() @ camera.camera_T_world.inverse()
        cameras.append(Link(f'{camera.name}_mount', f'{camera.name}_optical', mount_T_optical))
    return [
        Message('/tf_static', TF_MESSAGE, at + i, encode_tf(links))
        for i, links in enumerate((cameras, mounts))
    ]


def assert_true(path: Path, recording: SimulatedRecording) -> None:
    """Compare a result with the truth; eight seconds of walk give 0.01 deg and 0.3 mm."""
    found = read_result(path).world_T_mocap
    np.testing.assert_allclose(found.matrix, recording.truth.world_T_mocap.matrix, atol=5e-3)


def test_cameras_are_placed_by_tf_static_of_the_bag(
    recording: SimulatedRecording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Wherever in the bag it stands: recorders write it when they hear it."""
    rig = write_rig_file(recording, tmp_path, without=['camera_T_world', 'world_T_camera'])
    joints = joints_of(recording)
    middle = joints[len(joints) // 2].receive_ns
    messages = sorted([*joints, *poses_of(recording, middle)], key=lambda m: m.receive_ns)
    bag = write_bag(tmp_path / 'walk', messages)
    output = tmp_path / 'result.yaml'
    code = calibrate_bag.main([str(bag), '--rig', str(rig), '--output', str(output)])
    assert code == calibrate_bag.EXIT_ACCEPTED
    assert 'dropped' not in capsys.readouterr().err
    assert_true(output, recording)


def test_without_tf_the_frames_are_named(
    recording: SimulatedRecording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The user learns what to record."""
    rig = write_rig_file(recording, tmp_path, without=['camera_T_world', 'world_T_camera'])
    bag = write_bag(tmp_path / 'walk', joints_of(recording))
    assert calibrate_bag.main([str(bag), '--rig', str(rig)]) == calibrate_bag.EXIT_BAD_INPUT
    said = ' '.join(capsys.readouterr().err.split())
    assert "camera cam2: frame 'cam2_optical' is not connected with 'world' on /tf_static" in said
    assert 'no_extrinsics' in said


def test_a_zoom_in_the_middle_of_the_bag_drops_what_was_before(
    recording: SimulatedRecording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As it does live: keypoints of two images are never mixed; the answer is right."""
    keys = ['size', 'matrix', 'distortion_model', 'distortion']
    rig = write_rig_file(recording, tmp_path, without=keys)
    joints = joints_of(recording)
    start, middle = joints[0].receive_ns, joints[len(joints) // 2].receive_ns
    infos = []
    for camera in recording.cameras:
        topic = f'/{camera.name}/camera_info'
        payload = encode_camera_info(camera, start, camera.name)
        infos.append(Message(topic, CAMERA_INFO, start, payload))
        if camera.name == 'cam0':
            # Wrong at first: the driver came up with its default zoom.
            zoomed = camera.matrix * [[1.3], [1.3], [1.0]]
            wrong = payload.replace(camera.matrix.tobytes(), zoomed.tobytes())
            assert wrong != payload
            infos[-1] = Message(topic, CAMERA_INFO, start, wrong)
            infos.append(Message(topic, CAMERA_INFO, middle, payload))
    messages = sorted([*joints, *infos], key=lambda m: m.receive_ns)
    bag = write_bag(tmp_path / 'walk', messages)
    output = tmp_path / 'result.yaml'
    code = calibrate_bag.main([str(bag), '--rig', str(rig), '--output', str(output)])
    assert code == calibrate_bag.EXIT_ACCEPTED
    said = ' '.join(capsys.readouterr().err.split())
    dropped = re.search(r'camera cam0: its CameraInfo changed \(.*\); its (\d+) messages', said)
    assert dropped
    n_before = sum(m.topic == '/cam0/keypoints' and m.receive_ns < middle for m in messages)
    assert int(dropped[1]) == pytest.approx(n_before, abs=1)
    assert_true(output, recording)


def test_a_complaint_about_intrinsics_is_made_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With the name of its camera once."""
    folder = tmp_path / 'walk'
    folder.mkdir()
    report_cases.good(folder)
    rig = read_rig(folder / 'rig.yaml')
    cameras = [
        replace(c, camera=None, camera_info_topic=f'{c.name}/camera_info') for c in rig.cameras
    ]
    write_rig(tmp_path / 'rig.yaml', replace(rig, cameras=tuple(cameras)))
    with open_bag(folder / 'bag') as source, BagWriter(tmp_path / 'bag') as writer:
        for topic, at, payload in source.stream(source.topics):
            odd = payload.replace(b'plumb_bob', b'plumb_odd') if 'cam0' in topic else payload
            writer.write(topic, source.topics[topic].msgtype, at, odd)
    calibrate_bag.main([str(tmp_path / 'bag'), '--rig', str(tmp_path / 'rig.yaml')])
    said = ' '.join(capsys.readouterr().err.split())
    assert said.count("'plumb_odd'") == 1
    assert 'camera cam0: camera cam0' not in said
