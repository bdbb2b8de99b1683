# SPDX-License-Identifier: Apache-2.0
"""Cameras that topics describe, live: latched and changing CameraInfo, poses on TF."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
import yaml
from geometry_msgs.msg import TransformStamped
from ros_live import WAIT_S, Live, live
from ros_scene import Scene
from sensor_msgs.msg import CameraInfo

from rpgd_ros.core import RigidTransform
from rpgd_ros.messages import Link, encode_camera_info, encode_tf
from rpgd_ros.ros.transforms import LATCHED

INTRINSICS = ('size', 'matrix', 'distortion_model', 'distortion')
POSES = ('camera_T_world', 'world_T_camera')


def rig_without(walk: Scene, folder: Path, keys: Sequence[str]) -> Path:
    """Write the rig file of the walk less some keys of its cameras."""
    tree = yaml.safe_load(walk.rig.read_text())
    for camera in tree['cameras']:
        for key in keys:
            camera.pop(key, None)
        if 'matrix' in keys:
            camera['camera_info_topic'] = f'{camera["name"]}/camera_info'
        if 'camera_T_world' in keys:
            camera['frame_id'] = f'{camera["name"]}_optical'
    path = folder / 'rig.yaml'
    path.write_text(yaml.safe_dump(tree))
    return path


def publish_infos(node: Live, walk: Scene) -> dict[str, Any]:
    """Send each camera's CameraInfo once, latched, as a file server does; return publishers."""
    publishers = {}
    for camera in walk.recording.cameras:
        topic = f'{camera.name}/camera_info'
        publishers[camera.name] = node.peer.node.create_publisher(CameraInfo, topic, LATCHED)
        publishers[camera.name].publish(encode_camera_info(camera, 1, camera.name))
    return publishers


def links_of(walk: Scene) -> list[Link]:
    """Return where the cameras hang: world -> mount -> optical frame."""
    links = []
    mount = RigidTransform.from_quat_xyzw([1.0, 2.0, 3.0], [0.0, 0.6, 0.0, 0.8])
    for camera in walk.recording.cameras:
        assert camera.camera_T_world is not None
        mount_T_optical = mount.inverse() @ camera.camera_T_world.inverse()
        links.append(Link('world', f'{camera.name}_mount', mount))
        links.append(Link(f'{camera.name}_mount', f'{camera.name}_optical', mount_T_optical))
    return links


def test_camera_info_that_was_sent_once_before_the_node_came_is_heard(
    walk: Scene, tmp_path: Path
) -> None:
    """A publisher that keeps its message has it for late joiners; what is missing is told."""
    with live(rig_without(walk, tmp_path, INTRINSICS)) as node:
        node.play(walk)
        node.wait_until('not told', lambda: 'no CameraInfo of cam0 has come' in node.sentence())
        publishers = publish_infos(node, walk)

        def is_calibrated() -> bool:
            return node.calibrate()[0]

        node.wait_until('no intrinsics', is_calibrated)
        assert 'CameraInfo' not in node.peer.message('camera cam0')
        zoomed = walk.recording.cameras[0]
        payload = encode_camera_info(zoomed, 2, zoomed.name)
        matrix = zoomed.matrix * [[1.2], [1.2], [1.0]]
        publishers[zoomed.name].publish(payload.replace(zoomed.matrix.tobytes(), matrix.tobytes()))
        node.child.wait_for('camera cam0: its CameraInfo changed .* are dropped', seconds=WAIT_S)
        node.wait_until(
            'not dropped', lambda: node.peer.diagnostics('camera cam0').get('kept') == '0'
        )
        assert node.calibrate()[0]


@pytest.mark.skipif(bool(find_spec('tf2_msgs')), reason='tf2_msgs is installed')
def test_missing_tf2_msgs_is_an_error_of_each_camera_that_needs_it(
    walk: Scene, tmp_path: Path
) -> None:
    """Waiting does not help: the package is named, and the way without it."""
    with live(rig_without(walk, tmp_path, POSES)) as node:
        node.wait_until(
            'not told', lambda: 'ros-jazzy-tf2-msgs' in node.peer.message('camera cam1')
        )
        assert 'camera_T_world in the rig file' in node.peer.message('camera cam1')


def test_cameras_are_placed_by_tf_static_live(walk: Scene, tmp_path: Path) -> None:
    """The chain may come from several publishers, one of them late."""
    messages = pytest.importorskip('tf2_msgs.msg')
    with live(rig_without(walk, tmp_path, POSES)) as node:
        node.play(walk)
        node.wait_until(
            'not told', lambda: 'TF has not named it yet' in node.peer.message('camera cam0')
        )
        assert node.calibrate()[1]['reason'] == 'no_extrinsics'
        links = links_of(walk)
        tf = [node.peer.node.create_publisher(messages.TFMessage, '/tf_static', LATCHED)]
        tf[0].publish(encode_tf(links[:5]))
        node.wait_until(
            'not told',
            lambda: (
                "parent there is 'cam3_mount'" in node.peer.message('camera cam3')
                or 'TF has not named it yet' in node.peer.message('camera cam3')
            ),
        )
        tf.append(node.peer.node.create_publisher(messages.TFMessage, '/tf_static', LATCHED))
        tf[1].publish(encode_tf(links[5:]))
        node.wait_until('not placed', lambda: node.calibrate()[0])
        assert node.latched('transform', TransformStamped).header.frame_id == 'world'


def test_cameras_may_hang_on_frames_of_tf(walk: Scene, tmp_path: Path) -> None:
    """Drivers that repeat a pose which never changes; a mount that is turned is noticed."""
    messages = pytest.importorskip('tf2_msgs.msg')
    with live(rig_without(walk, tmp_path, POSES)) as node:
        node.play(walk)
        tf = node.peer.node.create_publisher(messages.TFMessage, '/tf', 100)

        def is_placed() -> bool:
            tf.publish(encode_tf(links_of(walk)))
            return node.calibrate()[0]

        node.wait_until('not placed', is_placed)
        moved = RigidTransform.from_quat_xyzw([1.0, 2.0, 3.0], [0.0, 0.62, 0.0, 0.785])
        links = [Link('world', 'cam2_mount', moved)]

        def is_noticed() -> bool:
            tf.publish(encode_tf(links))
            return 'camera cam2: its pose on TF moved by' in node.child.output

        node.wait_until('not noticed', is_noticed)


def test_another_parent_of_the_mocap_frame_on_tf_is_named(walk: Scene, tmp_path: Path) -> None:
    """Two parents of one frame: TF would jump between them."""
    messages = pytest.importorskip('tf2_msgs.msg')
    rig = tmp_path / 'rig.yaml'
    rig.write_bytes(walk.rig.read_bytes())
    with live(rig, 'tf_mode:=static') as node:
        node.play(walk)
        tf = node.peer.node.create_publisher(messages.TFMessage, '/tf_static', LATCHED)
        tf.publish(encode_tf([Link('odom', 'mocap', RigidTransform.identity())]))
        node.wait_until('not told', lambda: "below 'odom'" in node.peer.message('mocap'))
