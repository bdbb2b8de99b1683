# SPDX-License-Identifier: Apache-2.0
"""Types of drivers over DDS: those that are installed are read, the others are named."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import drivers
import numpy as np
import pytest
import reencoded
from drivers import STAMP_NS
from reencoded import with_mocap
from ros_live import live

from rpgd_ros.core.geometry import rotation_angle
from rpgd_ros.io.rig import parse_rig, write_rig
from rpgd_ros.messages import KEYPOINT_TYPES, POSE_STAMPED, SKELETON_TYPES
from rpgd_ros.messages.adapters.types import OPENPOSE_LIST
from rpgd_ros.ros import health
from rpgd_ros.ros.domain import free_domain
from rpgd_ros.ros.inputs import Health, JointInput, health_by_stream
from rpgd_ros.ros.message_classes import OWN, PACKAGES, message_class, readable_types
from rpgd_ros.ros.player import Peer
from rpgd_ros.session import Session
from rpgd_ros.session.monitor import Monitor
from rpgd_ros.simulation import build_scene, preset, simulate
from rpgd_ros.simulation.export import messages_of, rig_of

MARKER_ARRAY = 'visualization_msgs/msg/MarkerArray'
WAIT_S = 20.0


def ignore(*_: object) -> None:
    """Take what is handed on."""


@pytest.fixture
def peer() -> Iterator[Peer]:
    """Return a node in a domain of its own."""
    with Peer('peer', domain_id=free_domain()) as peer:
        yield peer


def test_every_type_that_is_read_can_be_looked_for() -> None:
    """Its package is among those that may be imported."""
    for msg_type in {*SKELETON_TYPES, *KEYPOINT_TYPES}:
        assert msg_type in OWN or msg_type.partition('/')[0] in PACKAGES
        found = message_class(msg_type)
        is_installed = importlib.util.find_spec(msg_type.partition('/')[0]) is not None
        assert (found is not None) == is_installed


@pytest.mark.parametrize('name', ['os/msg/system', 'hri_msgs/msg/', 'x', '', 'hri_msgs/msg/os'])
def test_no_topic_names_a_module_to_import(name: str) -> None:
    """Types come from the network."""
    assert message_class(name) is None


def test_each_stream_has_its_types() -> None:
    """Pixels for cameras, places for the MoCap, poses where a topic is one joint."""
    assert readable_types('mocap') == SKELETON_TYPES
    assert readable_types('cam0') == KEYPOINT_TYPES
    assert readable_types('mocap/LHipJC') == (POSE_STAMPED,)


def test_a_type_without_its_package_is_an_error_that_names_it(peer: Peer) -> None:
    """Waiting does not help, installing does."""
    if importlib.util.find_spec('mocap4r2_msgs'):
        pytest.skip('mocap4r2_msgs is installed')
    joints = JointInput(
        peer.node, 'mocap', 'rigid_bodies', 'mocap4r2_msgs/msg/RigidBodies', ignore
    )
    said = joints.health()
    assert said.is_hopeless
    assert not joints.is_subscribed
    assert 'install the package mocap4r2_msgs (ros-jazzy-mocap4r2-msgs' in said.problem
    assert 'a recording of the topic can be read without it' in said.problem


def test_the_topics_of_one_skeleton_answer_together(peer: Peer) -> None:
    """Twelve silent topics are one line in the diagnostics, not twelve."""
    inputs = [
        JointInput(peer.node, f'mocap/{name}', f'vicon/bob/{name}', '', ignore)
        for name in ('hip', 'knee', 'ankle')
    ]
    inputs.append(JointInput(peer.node, 'cam0', 'cam0/keypoints', '', ignore))
    found = health_by_stream(inputs)
    assert list(found) == ['mocap', 'cam0']
    assert 'nobody publishes /vicon/bob/hip, and the like of 2 more of 3' in found['mocap'].problem
    assert not found['mocap'].is_hopeless
    assert np.isnan(found['mocap'].age_s)


def test_messages_without_a_header_are_a_warning() -> None:
    """Their stamps hold the detector's delay, which people should know."""
    rig = parse_rig(
        'schema: 1\nworld_frame: studio\nmocap: {joints: coco17}\ncameras:\n'
        '  - {name: cam0, keypoints: body25, camera_info_topic: cam0/camera_info}'
    )
    session = Session(rig)
    payload = drivers.without_header(drivers.serialise(drivers.openpose_list([np.ones((25, 3))])))
    for i in range(10):
        session.add('cam0', OPENPOSE_LIST, [payload], [STAMP_NS + i * 40_000_000])
    assert session.counts('cam0')['kept'] == 10
    fine = Health('', False, OPENPOSE_LIST, 'RELIABLE', 10, 25.0, 0.1)  # noqa: FBT003
    (status,) = health.input_statuses(session, {'cam0': fine}, Monitor(session, max_age_s=300.0))
    assert status.level == health.WARN
    assert 'no header' in status.message


def test_markers_are_subscribed_by_their_publishers_type(peer: Peer) -> None:
    """Azure Kinect's messages need nothing but ROS itself."""
    taken: list[bytes] = []

    def take(_: str, msg_type: str, payloads: Sequence[bytes], __: Sequence[int]) -> None:
        assert msg_type == MARKER_ARRAY
        taken.extend(bytes(payload) for payload in payloads)

    joints = JointInput(peer.node, 'mocap', 'body_tracking_data', '', take)
    payload = drivers.serialise(drivers.marker_array([drivers.rviz_marker(100, (1, 2, 3))]))
    with Peer('talker', domain_id=peer.node.context.get_domain_id()) as talker:
        talker.advertise({'body_tracking_data': MARKER_ARRAY})

        def is_heard() -> bool:
            joints.poll()
            return joints.is_subscribed and not talker.without_subscriber()

        assert peer.wait_until(is_heard, seconds=WAIT_S)
        talker.play([('body_tracking_data', 1, payload)], rate=1.0)
        assert peer.wait_until(lambda: joints.n_received > 0, seconds=WAIT_S)
    joints.flush()
    assert len(taken) == 1


def test_a_skeleton_of_poses_per_segment_calibrates_the_node(tmp_path: Path) -> None:
    """Twelve topics of vicon_receiver and four cameras, through the real node."""
    walk = simulate(build_scene(preset('studio'), 0, seconds=6.0))
    rig = with_mocap(rig_of(walk), topic='vicon/bob/{joint}', frame='vicon')
    write_rig(tmp_path / 'rig.yaml', rig)
    mocap = reencoded.skeletons(walk, reencoded.per_segment(walk))
    messages: list[Any] = [(m.topic.lstrip('/'), m.receive_ns, m.payload) for m in mocap]
    keypoints = [m for m in messages_of(walk) if m.topic.endswith('keypoints')]
    messages += [(m.topic, m.receive_ns, m.payload) for m in keypoints]
    messages.sort(key=lambda m: m[1])
    types = dict.fromkeys(rig.mocap_topics, POSE_STAMPED)
    types |= {m.topic: m.msgtype for m in keypoints}
    with live(tmp_path / 'rig.yaml') as node:
        node.advertise(types)
        sent = node.peer.play(messages, rate=4.0)
        n_sent = {'cam0/keypoints': sent['cam0/keypoints'], rig.mocap.topic: len(mocap)}

        def are_counted() -> bool:
            got = node.received()
            return all(got.get(topic) == n for topic, n in n_sent.items())

        node.wait_until('not all arrived', are_counted)
        is_accepted, answer = node.calibrate()
        assert is_accepted, answer
        found = node.client.transform(seconds=WAIT_S)
    assert found is not None
    truth = walk.truth.world_T_mocap
    assert np.degrees(rotation_angle(found.rotation.T @ truth.rotation)) < 0.1
    points = walk.truth.control_mocap
    assert np.linalg.norm(found @ points - truth @ points, axis=1).mean() < 0.002
