# SPDX-License-Identifier: Apache-2.0
"""A rig without extrinsics: what the node publishes of its cameras, and keeps."""

from __future__ import annotations

import signal
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import pytest
from harness import Child
from ros_live import WAIT_S, Live, live
from ros_scene import MOCAP_FRAME, WORLD_FRAME, Scene

pytest.importorskip('rclpy')

from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped

from rpgd_ros.core import CameraPose, RigidTransform
from rpgd_ros.core.geometry import rotation_angle, so3_exp
from rpgd_ros.io.result_file import read_result
from rpgd_ros.io.rig import read_rig, write_rig
from rpgd_ros.ros.transforms import (
    Published,
    TransformOutput,
    camera_pose_message,
    camera_transforms,
)

if TYPE_CHECKING:
    from rclpy.node import Node


def blind_rig(walk: Scene, folder: Path, *names: str) -> Path:
    """Write the rig file of the walk, these cameras (all without any) without extrinsics."""
    rig = read_rig(walk.rig)
    cameras = tuple(
        replace(c, extrinsics=None, camera=replace(c.camera, camera_T_world=None))
        if c.camera is not None and (not names or c.name in names)
        else c
        for c in rig.cameras
    )
    path = folder / 'rig.yaml'
    write_rig(path, replace(rig, cameras=cameras))
    return path


def heard(message: PoseWithCovarianceStamped) -> RigidTransform:
    """Return the pose of a message."""
    p, q = message.pose.pose.position, message.pose.pose.orientation
    return RigidTransform.from_quat_xyzw([p.x, p.y, p.z], [q.x, q.y, q.z, q.w])


def assert_placed(node: Live, walk: Scene, name: str, parent: str) -> None:
    """Compare a camera's pose with the truth: within three of the sigma that it carries."""
    message = node.latched(f'{name}/pose', PoseWithCovarianceStamped)
    assert message.header.frame_id == parent
    camera = next(c for c in walk.recording.cameras if c.name == name)
    assert camera.camera_T_world is not None
    truth = camera.camera_T_world.inverse()
    if parent == MOCAP_FRAME:
        truth = walk.world_T_mocap.inverse() @ truth
    apart = heard(message) @ truth.inverse()
    sigma = np.sqrt(np.array(message.pose.covariance).reshape(6, 6).diagonal())
    centre = heard(message).translation - truth.translation
    assert np.linalg.norm(centre) < 3.0 * np.linalg.norm(sigma[:3])
    assert rotation_angle(apart.rotation) < 3.0 * np.linalg.norm(sigma[3:])
    assert np.linalg.norm(centre) < 0.03
    assert np.degrees(rotation_angle(apart.rotation)) < 0.3


def test_cameras_without_extrinsics_are_published_in_the_mocap_frame(
    walk: Scene, tmp_path: Path
) -> None:
    """Walk once, and every camera has its place; a restart publishes the same bits again."""
    rig = blind_rig(walk, tmp_path)
    names = [camera.name for camera in walk.recording.cameras]
    with live(rig) as node:
        node.play(walk)
        success, answer = node.calibrate()
        assert success, answer
        assert set(answer['camera_poses']) == set(names)
        assert answer['camera_poses'][names[0]]['frame'] == f'{names[0]}_optical_frame'
        for name in names:
            assert_placed(node, walk, name, MOCAP_FRAME)
        before = node.latched(f'{names[1]}/pose', PoseWithCovarianceStamped)
        transform = node.latched('transform', TransformStamped)
        assert (transform.header.frame_id, transform.child_frame_id) == (WORLD_FRAME, MOCAP_FRAME)
        assert transform.transform.rotation.w == 1.0
        node.wait_until(
            'not told', lambda: '4 cameras placed in the MoCap frame' in node.sentence()
        )
        assert float(node.peer.diagnostics('calibration')[f'sigma_position_m {names[2]}']) > 0.0
        _end(node.child)
    stored = read_result(tmp_path / 'result.yaml')
    assert list(stored.camera_poses) == names
    with live(rig) as node:
        again = node.latched(f'{names[1]}/pose', PoseWithCovarianceStamped)
        assert heard(again).matrix.tolist() == heard(before).matrix.tolist()
        assert list(again.pose.covariance) == list(before.pose.covariance)


def test_cameras_of_a_kept_result_are_watched_where_it_placed_them(
    walk: Scene, tmp_path: Path
) -> None:
    """After a restart each fits as it did when it was accepted."""
    rig = blind_rig(walk, tmp_path)
    with live(rig) as node:
        node.play(walk)
        assert node.calibrate()[0]
        node.child.end(signal.SIGTERM, seconds=WAIT_S)
    path = tmp_path / 'result.yaml'
    stored = read_result(path)
    assert set(stored.camera_poses) == {camera.name for camera in walk.recording.cameras}
    with live(rig) as node:
        node.play(walk)

        def watched(name: str, key: str) -> float:
            return float(node.peer.diagnostics(f'camera {name}').get(key, 'nan'))

        for name in stored.camera_poses:
            node.wait_until(f'{name} not watched', lambda n=name: watched(n, 'error_px') > 0.0)
            assert watched(name, 'error_px') < 1.5 * watched(name, 'accepted_px')
        assert 'Attention' not in node.sentence()


def _end(child: Child) -> None:
    child.process.terminate()
    assert child.wait(seconds=WAIT_S) == 0


def test_camera_without_extrinsics_is_published_in_the_world(walk: Scene, tmp_path: Path) -> None:
    """Beside cameras that have them; of those nothing is published."""
    name, known = walk.recording.cameras[2].name, walk.recording.cameras[0].name
    with live(blind_rig(walk, tmp_path, name)) as node:
        node.play(walk)
        success, answer = node.calibrate()
        assert success, answer
        assert list(answer['camera_poses']) == [name]
        assert_placed(node, walk, name, WORLD_FRAME)
        topics = dict(node.peer.node.get_topic_names_and_types())
        assert not [topic for topic in topics if topic.endswith(f'/{known}/pose')]


class Recorder:
    """Takes the place of node and publishers where tf2_msgs is not installed."""

    def __init__(self) -> None:
        """Hear nothing yet."""
        self.messages: dict[str, list[Any]] = {}

    def create_publisher(self, _type: object, topic: str, _qos: object) -> SimpleNamespace:
        """Return what keeps the messages of a topic."""
        return SimpleNamespace(publish=self.messages.setdefault(topic, []).append)


def test_one_message_on_tf_static_holds_all_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    """A latched topic keeps only its last message: a camera in another one would be lost."""
    monkeypatch.setitem(sys.modules, 'tf2_msgs', ModuleType('tf2_msgs'))
    module = ModuleType('tf2_msgs.msg')
    module.__dict__['TFMessage'] = SimpleNamespace
    monkeypatch.setitem(sys.modules, 'tf2_msgs.msg', module)
    recorder = Recorder()
    output = TransformOutput(cast('Node', recorder), with_tf=True)
    output.publish(published(np.zeros((6, 6))))
    (message,) = recorder.messages['/tf_static']
    assert [(t.header.frame_id, t.child_frame_id) for t in message.transforms] == [
        ('studio', 'vicon'),
        ('vicon', 'eye_optical_frame'),
    ]
    assert len(recorder.messages['~/cam0/pose']) == 1


def published(covariance: np.ndarray[tuple[int, int], np.dtype[np.float64]]) -> Published:
    """Return a result with one placed camera."""
    half = np.diag([1e-6, 2e-6, 3e-6, 1e-4, 2e-4, 3e-4])
    pose = RigidTransform(so3_exp([0.4, -0.8, 0.2]), np.array([0.3, 1.0, 4.0]))
    return Published(
        world_frame='studio',
        mocap_frame='vicon',
        world_T_mocap=RigidTransform.identity(),
        covariance=covariance,
        stamp_ns=1_700_000_000_123_456_789,
        cameras={'cam0': CameraPose(pose, half, np.zeros(3))},
        optical_frames={'cam0': 'eye_optical_frame'},
    )


def test_tf_of_a_camera_is_its_pose_and_not_the_inverse() -> None:
    """The origin of the camera frame lies where the camera stands."""
    result = published(np.zeros((6, 6)))
    (message,) = camera_transforms(result)
    assert (message.header.frame_id, message.child_frame_id) == ('vicon', 'eye_optical_frame')
    t, q = message.transform.translation, message.transform.rotation
    said = RigidTransform.from_quat_xyzw([t.x, t.y, t.z], [q.x, q.y, q.z, q.w])
    expected = result.cameras['cam0'].camera_T_world.inverse()
    np.testing.assert_allclose(said.matrix, expected.matrix, atol=1e-12)
    assert type(t.x) is float
    assert camera_transforms(published(np.eye(6)))[0].header.frame_id == 'studio'


def test_covariance_of_a_camera_is_along_the_axes_of_the_parent() -> None:
    """In ROS order, position first: as the spread of many cameras shows."""
    result = published(np.zeros((6, 6)))
    pose = result.cameras['cam0']
    message = camera_pose_message(result, 'cam0')
    rng = np.random.default_rng(0)
    root = np.linalg.cholesky(pose.covariance)
    steps = []
    for step in rng.normal(size=(20_000, 6)) @ root.T:
        turn = so3_exp(step[:3])
        truth = RigidTransform(
            turn @ pose.camera_T_world.rotation, pose.camera_T_world.translation + step[3:]
        ).inverse()
        apart = truth.rotation @ pose.world_T_camera.rotation.T
        half = np.array([apart[2, 1], apart[0, 2], apart[1, 0]])
        steps.append([*(truth.translation - pose.world_T_camera.translation), *half])
    drawn = np.cov(np.array(steps).T)
    scale = np.sqrt(np.outer(np.diag(drawn), np.diag(drawn)))
    said = np.array(message.pose.covariance).reshape(6, 6)
    np.testing.assert_allclose(said / scale, drawn / scale, atol=0.05)
