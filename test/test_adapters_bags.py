# SPDX-License-Identifier: Apache-2.0
"""A recording in the types of real drivers gives the transform that it gives in ours."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import drivers
import numpy as np
import pytest
import reencoded
from bags import Message, write_bag, write_humble_bag
from reencoded import in_order, with_camera, with_mocap
from rosbags.highlevel import AnyReader

from rpgd_ros.apps import calibrate_bag
from rpgd_ros.core.geometry import Array, RigidTransform, rotation_angle
from rpgd_ros.io.bag import absolute_name
from rpgd_ros.io.result_file import read_result
from rpgd_ros.io.rig import Rig, write_rig
from rpgd_ros.simulation import SimulatedRecording, build_scene, preset, simulate
from rpgd_ros.simulation.export import messages_of, rig_of
from rpgd_ros.skeletons import joint_names, landmarks, match_joints

MAX_DEG, MAX_M = 0.04, 0.001  # of a walk of 8 s in our own types: 0.012 deg, 0.2 mm

Calibrate = Callable[[Rig, Sequence[Message]], RigidTransform]


@pytest.fixture(scope='module')
def walk() -> SimulatedRecording:
    """A walk of 8 s before four cameras."""
    return simulate(build_scene(preset('studio'), 0, seconds=8.0))


@pytest.fixture(scope='module')
def rig(walk: SimulatedRecording) -> Rig:
    """The rig of the walk, as our own types need it."""
    return rig_of(walk)


@pytest.fixture(scope='module')
def plain(walk: SimulatedRecording) -> list[Message]:
    """The walk in our own types."""
    return [Message(absolute_name(m.topic), *m[1:]) for m in messages_of(walk)]


@pytest.fixture
def calibrate(tmp_path: Path) -> Calibrate:
    """Return a function that runs the program on messages and returns the transform."""

    def run(
        rig: Rig,
        messages: Sequence[Message],
        write: Callable[[Path, list[Message]], Path] = write_bag,
    ) -> RigidTransform:
        folder = tmp_path / str(len(list(tmp_path.iterdir())))
        folder.mkdir()
        bag = write(folder / 'bag', list(messages))
        write_rig(folder / 'rig.yaml', rig)
        result = folder / 'result.yaml'
        code = calibrate_bag.main([
            str(bag), '--rig', str(folder / 'rig.yaml'), '--output', str(result),
        ])  # fmt: skip
        assert code == calibrate_bag.EXIT_ACCEPTED
        return read_result(result).world_T_mocap

    return run


def keypoints_of(plain: list[Message]) -> list[Message]:
    """Return all but the skeletons."""
    return [m for m in plain if 'mocap' not in m.topic]


def check(found: RigidTransform, walk: SimulatedRecording) -> None:
    """Compare with the truth: the angle, and where the body's points come to lie."""
    truth = walk.truth.world_T_mocap
    angle = np.degrees(rotation_angle(found.rotation.T @ truth.rotation))
    points = walk.truth.control_mocap
    apart = np.linalg.norm(found @ points - truth @ points, axis=1).mean()
    assert angle < MAX_DEG
    assert apart < MAX_M


NAMED: dict[str, tuple[Callable[..., Any], str, str]] = {
    'vicon rigid bodies': (drivers.rigid_bodies, 'bob.{joint}', '/rigid_bodies'),
    'xsens links': (drivers.link_states, 'bob_{joint}', '/link_states'),
    'named poses': (drivers.named_poses, '{joint}', '/poses'),
}


@pytest.mark.parametrize('driver', NAMED)
def test_skeletons_of_named_poses(
    driver: str, walk: SimulatedRecording, rig: Rig, plain: list[Message], calibrate: Calibrate
) -> None:
    """Under names with the subject's before them, with zeros for what is not seen."""
    make, pattern, topic = NAMED[driver]
    mocap = reencoded.skeletons(walk, reencoded.named(walk, make, pattern, topic))
    named = with_mocap(rig, topic=topic, names=pattern)
    check(calibrate(named, in_order(mocap, keypoints_of(plain))), walk)


def test_poses_per_segment_are_gathered(
    walk: SimulatedRecording, rig: Rig, plain: list[Message], calibrate: Calibrate
) -> None:
    """A topic for each segment, each stamped by its own now()."""
    mocap = reencoded.skeletons(walk, reencoded.per_segment(walk))
    segments = with_mocap(rig, topic='vicon/bob/{joint}', frame='vicon')
    check(calibrate(segments, in_order(mocap, keypoints_of(plain))), walk)


def test_a_skeleton_as_a_tree_of_frames_is_composed(
    walk: SimulatedRecording, rig: Rig, plain: list[Message], calibrate: Calibrate
) -> None:
    """Each segment relative to its parent, in a message of its own."""
    mocap = reencoded.skeletons(walk, reencoded.tf_tree(walk))
    other = Message(
        '/tf', 'tf2_msgs/msg/TFMessage', mocap[50].receive_ns,
        drivers.serialise(drivers.tf_message([drivers.transform('map', 'robot', (1, 2, 3))])),
    )  # fmt: skip
    tree = with_mocap(rig, topic='/tf', names='bob_{joint}', frame='mocap')
    check(calibrate(tree, in_order(mocap, [other], keypoints_of(plain))), walk)


def test_every_detector_gives_the_same_keypoints(
    walk: SimulatedRecording, rig: Rig, plain: list[Message], calibrate: Calibrate
) -> None:
    """One camera each with yolo, ROS4HRI, ZED and OpenPose, the last without a header."""
    coco = landmarks(joint_names('coco17'))

    def as_rows(joints: str, uv: Array, score: Array) -> Array:
        """Return (J, 3) rows of another convention, zeros = missing."""
        rows = np.zeros((len(joint_names(joints)), 3))
        for k, mark in enumerate(landmarks(joint_names(joints))):
            j = coco.index(mark) if mark in coco else None
            if j is not None and np.isfinite(uv[j]).all():
                rows[k] = *uv[j], score[j]
        return rows

    def yolo(stamp_ns: int, uv: Array, score: Array) -> object:
        seen = {j + 1: (*uv[j], score[j]) for j in range(17) if np.isfinite(uv[j]).all()}
        return drivers.detections([drivers.detection(seen)], stamp_ns=stamp_ns)

    def hri(stamp_ns: int, uv: Array, score: Array) -> object:
        rows = as_rows('hri18', uv, score)
        rows[:, :2] /= walk.cameras[1].size
        return drivers.skeleton_2d(rows, stamp_ns=stamp_ns)

    def zed(stamp_ns: int, uv: Array, score: Array) -> object:
        rows = as_rows('openpose18', uv, score)
        return drivers.objects([drivers.zed_object(rows[:, :2])], stamp_ns=stamp_ns)

    def openpose(_: int, uv: Array, score: Array) -> bytes:
        message = drivers.openpose_list([as_rows('body25', uv, score)])
        return drivers.without_header(drivers.serialise(message))

    cameras = [
        reencoded.keypoints(walk, i, encode) for i, encode in enumerate((yolo, hri, zed, openpose))
    ]
    for i, joints in enumerate(('coco17', 'hri18', 'openpose18', 'body25')):
        names = joint_names(joints)
        pairs = match_joints(rig.mocap.joints, names)
        rig = with_camera(rig, i, keypoint_joints=names, pairs=pairs)
    skeletons = [m for m in plain if 'mocap' in m.topic]
    check(calibrate(rig, in_order(skeletons, *cameras)), walk)


def test_a_humble_bag_lacks_the_definitions_and_is_read_all_the_same(
    walk: SimulatedRecording,
    rig: Rig,
    plain: list[Message],
    calibrate: Callable[..., RigidTransform],
) -> None:
    """Its sqlite3 holds names of types only."""
    encode = reencoded.named(walk, drivers.rigid_bodies, 'bob.{joint}', '/rigid_bodies')
    messages = in_order(reencoded.skeletons(walk, encode), keypoints_of(plain))
    named = with_mocap(rig, topic='/rigid_bodies', names='bob.{joint}')
    check(calibrate(named, messages, write_humble_bag), walk)


def test_azure_kinects_markers(calibrate: Calibrate) -> None:
    """The body of a depth camera, and one colour camera that is the world itself."""
    walk = simulate(build_scene(preset('kinect'), 0, seconds=12.0))
    rig = rig_of(walk)
    n_joints = len(rig.mocap.joints)

    def encode(stamp_ns: int, x: Array) -> Iterator[tuple[str, int, Any]]:
        items = [
            drivers.rviz_marker(300 + j, x[j], stamp_ns=stamp_ns)
            for j in range(n_joints)
            if np.isfinite(x[j]).all()
        ]
        yield '/body_tracking_data', stamp_ns, drivers.marker_array(items)

    mocap = reencoded.skeletons(walk, encode)
    plain = [Message(absolute_name(m.topic), *m[1:]) for m in messages_of(walk)]
    azure = with_mocap(rig, topic='body_tracking_data')
    ours = calibrate(rig, plain)
    theirs = calibrate(azure, in_order(mocap, keypoints_of(plain)))
    np.testing.assert_allclose(theirs.matrix, ours.matrix, atol=1e-3)


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_a_bag_that_is_written_carries_the_definitions(tmp_path: Path, storage: str) -> None:
    """Others can read it without the drivers' packages."""
    messages = [
        drivers.markers([drivers.marker('LASI', (1, 2, 3), index=4)]),
        drivers.detections([drivers.detection({1: (5, 6, 0.5)}, n_border=2)]),
        drivers.objects([drivers.zed_object(np.ones((18, 2)))]),
    ]
    path = write_bag(
        tmp_path / 'bag',
        [
            Message(f'/t{i}', m.__msgtype__, i + 1, drivers.serialise(m))
            for i, m in enumerate(messages)
        ],
        storage=storage,
    )
    with AnyReader([path]) as reader:
        read: list[Any] = [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages()]
    markers, detections, objects = read
    assert markers.markers[0].marker_name == 'LASI'
    assert markers.markers[0].translation.z == 3.0
    assert detections.detections[0].keypoints.data[0].point.y == 6.0
    assert objects.objects[0].skeleton_2d.keypoints[17].kp.tolist() == [1.0, 1.0]
