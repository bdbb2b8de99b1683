# SPDX-License-Identifier: Apache-2.0
"""What RViz and Foxglove get, against the truth: skeleton, reprojections, the room."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rclpy.qos import QoSProfile
from ros_live import Live, live
from ros_scene import WORLD_FRAME, Scene, make_scene
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import Marker, MarkerArray

from rpgd_ros.core.geometry import Array
from rpgd_ros.ros.client import NODE

FEW = QoSProfile(depth=5)


@pytest.fixture(scope='module')
def walk(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """Return twelve seconds of a walk before four cameras."""
    return make_scene(tmp_path_factory.mktemp('walk'), seconds=12.0)


@pytest.fixture(scope='module')
def node(walk: Scene) -> Any:
    """Return a node that has calibrated from the walk, before listeners came."""
    with live(walk.rig) as running:
        running.advertise(walk.topics)
        half = 2 * len(walk.messages) // 3
        running.peer.play(walk.messages[:half], rate=8.0)
        assert running.calibrate()[0]
        for topic, kind in {
            'skeleton_world': PointCloud2,
            'cam1/reprojection': PointCloud2,
            'markers': MarkerArray,
        }.items():
            running.peer.listen(f'{NODE}/{topic}', kind, qos=FEW)
        names = [f'/{NODE}/{name}' for name in ('skeleton_world', 'markers', 'cam1/reprojection')]
        running.wait_until(
            'not connected',
            lambda: all(running.peer.node.count_publishers(name) for name in names),
        )
        running.peer.play(walk.messages[half:], rate=2.0)
        yield running


def newest(node: Live, topic: str) -> Any:
    """Return the newest message of an overlay."""
    node.wait_until(f'no {topic}', lambda: node.peer.newest(f'{NODE}/{topic}') is not None)
    node.peer.wait_until(lambda: False, seconds=0.5)  # take what is still on its way
    return node.peer.newest(f'{NODE}/{topic}')


def values(cloud: PointCloud2) -> Array:
    """Return the joints of a cloud."""
    return np.frombuffer(bytes(cloud.data), '<f4').reshape(cloud.width, -1).astype(np.float64)


def stamp_ns(cloud: PointCloud2) -> int:
    """Return the stamp of a cloud."""
    return int(cloud.header.stamp.sec * 10**9 + cloud.header.stamp.nanosec)


def true_skeleton(walk: Scene, at_ns: int) -> Array:
    """Return the joints in the world (J, 3) at a stamp, straight from the simulation."""
    mocap, pose = walk.recording.mocap, walk.world_T_mocap
    columns = [j for j, _ in walk.recording.pairs]
    x = mocap.x_mocap[:, columns].reshape(len(mocap.stamp_ns), -1)
    since = (mocap.stamp_ns - mocap.stamp_ns[0]).astype(np.float64)
    at = float(at_ns - mocap.stamp_ns[0])
    joints = np.array([np.interp(at, since, column) for column in x.T]).reshape(-1, 3)
    return pose @ joints


def test_skeleton_is_where_the_person_is(node: Live, walk: Scene) -> None:
    """In the world, at its own stamp, within 5 mm."""
    cloud = newest(node, 'skeleton_world')
    assert cloud.header.frame_id == WORLD_FRAME
    assert [field.name for field in cloud.fields] == ['x', 'y', 'z']
    np.testing.assert_allclose(values(cloud), true_skeleton(walk, stamp_ns(cloud)), atol=0.005)


def test_reprojection_lies_on_the_image_of_the_person(node: Live, walk: Scene) -> None:
    """At a stamp of the camera's own, within a pixel and a half of the true place."""
    cloud = newest(node, 'cam1/reprojection')
    assert [field.name for field in cloud.fields] == ['u', 'v']
    assert stamp_ns(cloud) in set(walk.recording.streams[1].stamp_ns.tolist())
    expected = walk.recording.cameras[1].project(true_skeleton(walk, stamp_ns(cloud)))
    np.testing.assert_allclose(values(cloud), expected, atol=1.5)


def test_markers_show_floor_cameras_skeleton_and_way(node: Live, walk: Scene) -> None:
    """All in the world; cameras where they hang, under their names; the floor under the feet."""
    found: dict[str, list[Marker]] = {}
    for marker in newest(node, 'markers').markers:
        assert marker.header.frame_id == WORLD_FRAME
        found.setdefault(marker.ns, []).append(marker)
    names = {'floor', 'advice', 'camera', 'camera_name', 'path', 'covered', 'joints', 'skeleton'}
    assert set(found) == names
    for camera, frustum, name in zip(
        walk.recording.cameras, found['camera'], found['camera_name'], strict=True
    ):
        assert name.text.startswith(camera.name)
        assert camera.camera_T_world is not None
        centre, apex = camera.camera_T_world.inverse().translation, frustum.points[0]
        np.testing.assert_allclose([apex.x, apex.y, apex.z], centre, atol=1e-6)
    assert {round(p.z, 6) for p in found['floor'][0].points} == {
        round(found['floor'][0].points[0].z, 6)
    }
    assert abs(found['floor'][0].points[0].z) < 0.15  # ankles stand above the floor
    path = found['path'][0]
    assert len(path.points) == len(path.colors) > 20
    greens = [colour.g > colour.r for colour in path.colors[-5:]]
    assert all(greens)
    joints = found['joints'][0]
    body = np.array([[p.x, p.y, p.z] for p in joints.points])
    assert len(body) == len(walk.recording.pairs)
    assert 0.0 < body[:, 2].min() < body[:, 2].max() < 2.0
    assert len(found['skeleton'][0].points) % 2 == 0
    assert found['skeleton'][0].points


def test_nothing_is_drawn_for_nobody(walk: Scene, tmp_path: Path) -> None:
    """Without a listener no overlay is computed; with one for markers only, no other."""
    rig = tmp_path / 'rig.yaml'
    rig.write_bytes(walk.rig.read_bytes())
    with live(rig) as node:
        node.peer.listen(f'{NODE}/markers', MarkerArray, qos=FEW)
        node.advertise(walk.topics)
        node.peer.play(walk.messages[:2000], rate=8.0)
        found = {marker.ns for marker in newest(node, 'markers').markers}
        # Without a pose nobody knows where in the world the person is.
        assert found == {'floor', 'advice', 'camera', 'camera_name'}
