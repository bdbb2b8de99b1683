# SPDX-License-Identifier: Apache-2.0
"""The live node over DDS, as its users see it."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import numpy as np
import pytest
import yaml
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped
from harness import ros_environment, running
from ros_live import WAIT_S, Live, assert_close, live, slow
from ros_scene import MOCAP_FRAME, WORLD_FRAME, Scene, make_scene
from std_msgs.msg import Float64
from std_srvs.srv import SetBool

from rpgd_ros.io.result_file import read_result
from rpgd_ros.io.rig import read_rig
from rpgd_ros.messages import CAMERA_INFO, encode_camera_info, encode_pose_array
from rpgd_ros.ros.client import NODE
from rpgd_ros.simulation.export import MOCAP_TOPIC


def are_of_one_run(node: Live) -> bool:
    """Whether transform and pose were published together: the next run may end between them."""
    transform = node.latched('transform', TransformStamped)
    pose = node.latched('pose', PoseWithCovarianceStamped)
    return bool(transform.header.stamp == pose.header.stamp)


def test_walk_leads_to_a_published_transform_without_any_call(walk: Scene, rig: Path) -> None:
    """Start the node, walk, and the transform is on the topics and in the file."""
    with live(rig, 'auto.enabled:=true', 'auto.period_s:=0.5') as node:
        node.play(walk)
        node.wait_until(
            'not accepted',
            lambda: node.peer.diagnostics('calibration').get('last_result') == 'accepted',
        )
        node.wait_until('both of one run', lambda: are_of_one_run(node))
        message = node.latched('transform', TransformStamped)
        assert (message.header.frame_id, message.child_frame_id) == (WORLD_FRAME, MOCAP_FRAME)
        pose = node.latched('pose', PoseWithCovarianceStamped)
        assert pose.pose.pose.position.x == message.transform.translation.x
        assert np.diag(np.array(pose.pose.covariance).reshape(6, 6)).min() > 0.0
        assert 1.0 < node.latched('reprojection_error', Float64).data < 10.0
        assert node.child.end(signal.SIGINT, seconds=WAIT_S) == 0
    stored = read_result(rig.parent / 'result.yaml')
    assert_close(stored.world_T_mocap, walk)


def test_call_during_a_stream_of_1000_messages_per_second_loses_nothing(
    walk: Scene, rig: Path
) -> None:
    """Another process calls; the publisher's counts are the node's, and the answer has figures."""
    seconds = (walk.messages[-1][1] - walk.messages[0][1]) * 1e-9
    rate = 1000.0 * seconds / len(walk.messages)
    caller = Path(__file__).with_name('ros_caller.py')
    with live(rig) as node:
        node.advertise(walk.topics)
        domain = str(node.peer.node.context.get_domain_id())
        environment = ros_environment(int(domain))
        with running([str(caller), f'{NODE}/calibrate'], environment) as calling:
            sent = node.send(walk.messages, rate=rate)
            calling.wait_for('called', seconds=WAIT_S)
            assert calling.wait(seconds=WAIT_S) == 0, calling.output
        assert node.received() == sent
        answers = [json.loads(line) for line in calling.output.splitlines() if line[0] == '{']
    during = [answer for answer in answers if answer['reason'] == 'accepted']
    assert during, answers
    assert during[-1]['inliers'] > 500
    assert during[-1]['mpjpe_px'] < 10.0
    assert set(during[-1]['cameras']) == {camera.name for camera in walk.recording.cameras}


@pytest.mark.fault(26)
def test_refusals_name_their_reason(tmp_path: Path) -> None:
    """An empty buffer and a person who stands still are no calibration."""
    scene = make_scene(tmp_path, motion='still')
    with live(scene.rig) as node:
        success, answer = node.calibrate()
        assert (success, answer['reason']) == (False, 'no_data')
        assert 'mocap/skeleton' in answer['message']
        node.play(scene)
        success, answer = node.calibrate()
        assert (success, answer['reason']) == (False, 'degenerate_motion')
        assert answer['message']
        assert not (tmp_path / 'result.yaml').exists()


@pytest.mark.fault(18)
def test_second_caller_hears_busy_at_once(walk: Scene, rig: Path) -> None:
    """One run at a time; the second call does not wait for the first."""
    with live(rig, *slow(), 'max_seconds:=3.0') as node:
        node.play(walk)
        first = node.peer.begin_call(f'{NODE}/calibrate', seconds=WAIT_S)
        assert first is not None
        node.wait_until('not running', lambda: 'Calibrating' in node.sentence())
        success, answer = node.calibrate()
        assert (success, answer['reason']) == (False, 'busy')
        assert not first.done()
        node.wait_until('no answer', first.done)
        assert json.loads(first.result().message)['reason'] == 'cancelled'


def test_status_says_what_is_missing(walk: Scene, rig: Path) -> None:
    """The person in the room needs no diagnostics viewer."""
    with live(rig) as node:
        assert 'nobody publishes /mocap/skeleton' in node.sentence()
        node.play(walk)
        node.wait_until('not told', lambda: 'Call ~/calibrate' in node.sentence())
        node.calibrate()
        node.wait_until('not told', lambda: 'Calibrated' in node.sentence())


@pytest.mark.fault(15)
def test_best_effort_publishers_are_heard(walk: Scene, rig: Path) -> None:
    """The subscription takes the reliability of what it finds."""
    with live(rig) as node:
        node.advertise(walk.topics, is_reliable=False)
        node.peer.play(walk.messages, rate=4.0)
        node.wait_until('no mocap', lambda: sum(node.received().values()) > 0)
        assert node.peer.diagnostics('mocap')['qos'] == 'BEST_EFFORT'
        assert node.calibrate()[0]


def test_pause_stops_collecting(walk: Scene, rig: Path) -> None:
    """While disabled the node counts messages but keeps none."""
    with live(rig) as node:
        node.advertise(walk.topics)
        paused = node.peer.begin_call(
            f'{NODE}/set_enabled',
            seconds=WAIT_S,
            srv_type=SetBool,
            request=SetBool.Request(data=False),
        )
        assert paused is not None
        node.wait_until('not paused', paused.done)
        node.send(walk.messages)
        node.wait_until('not told', lambda: 'Not collecting: call' in node.sentence())
        node.wait_until('not told', lambda: 'not collecting' in node.peer.message('mocap'))
        assert node.calibrate()[1]['reason'] == 'no_data'


@pytest.mark.fault(10)
def test_messages_that_cannot_be_used_are_counted_by_reason(walk: Scene, rig: Path) -> None:
    """Damage, another number of joints and another person's message cost nothing but a count."""
    with live(rig) as node:
        node.play(walk)
        before = node.calibrate()[1]
        end_ns = walk.messages[-1][1]
        whole = next(m[2] for m in walk.messages if m[0] == MOCAP_TOPIC)
        short = encode_pose_array(end_ns, MOCAP_FRAME, np.ones((3, 3)))
        bad = [whole[:40], whole[:3], bytes(300_000), short]
        sent = node.peer.play([(MOCAP_TOPIC, end_ns, payload) for payload in bad], rate=1.0)
        total = sent[MOCAP_TOPIC] + sum(m[0] == MOCAP_TOPIC for m in walk.messages)
        node.wait_until('not counted', lambda: node.received()[MOCAP_TOPIC] == total)
        entry = node.peer.diagnostics('mocap')
        assert int(entry['wrong_joints']) == 1
        assert int(entry['oversized']) == 1
        assert int(entry['malformed']) == 2
        assert node.calibrate()[1]['xyz'] == before['xyz']


def test_skeletons_of_another_frame_are_told_until_reset(walk: Scene, rig: Path) -> None:
    """The MoCap system was restarted with other settings: nothing of it is taken any more."""
    with live(rig) as node:
        node.play(walk)
        stamp_ns = walk.messages[-1][1]
        x = np.ones((len(read_rig(rig).mocap.joints), 3))
        n_sent = 0

        def says(sentence: str) -> bool:
            nonlocal n_sent
            n_sent += 1
            payload = encode_pose_array(stamp_ns + n_sent * 10_000_000, 'other', x)
            node.peer.play([(MOCAP_TOPIC, 1, payload)], rate=1.0)
            return sentence in node.peer.message('mocap')

        node.wait_until(
            'not told', lambda: says('none could be used: frame_changed, call ~/reset')
        )
        assert node.peer.level('mocap') == b'\x01'
        assert 'frame_changed, call ~/reset' in node.sentence()
        assert node.call('reset').success
        node.wait_until('not taken', lambda: says('receiving'))


@pytest.mark.fault(15)
def test_forced_reliability_that_no_publisher_offers_is_an_error(rig: Path, walk: Scene) -> None:
    """The topic and the policy are named where somebody looks for them."""
    override = 'qos_overrides./mocap/skeleton.subscription.reliability:=reliable'
    with live(rig, override) as node:
        node.peer.advertise(walk.topics, is_reliable=False)
        node.wait_until('not told', lambda: 'RELIABILITY' in node.peer.message('mocap') or None)
        assert '/mocap/skeleton' in node.peer.message('mocap')


def test_intrinsics_may_come_as_camera_info(walk: Scene, rig: Path) -> None:
    """A rig file without K names the topic that has it; until then the reason is told."""
    tree = yaml.safe_load(rig.read_text())
    for camera in tree['cameras']:
        camera['camera_info_topic'] = f'{camera["name"]}/camera_info'
        for key in ('size', 'matrix', 'distortion_model', 'distortion'):
            del camera[key]
    rig.write_text(yaml.safe_dump(tree))
    with live(rig) as node:
        node.play(walk)
        assert node.calibrate()[1]['reason'] == 'missing_intrinsics'
        infos = [
            (f'{c.name}/camera_info', 1, encode_camera_info(c, walk.messages[0][1], c.name))
            for c in walk.recording.cameras
        ]
        node.advertise({topic: CAMERA_INFO for topic, _, _ in infos})

        def is_calibrated() -> bool:
            node.peer.play(infos, rate=1.0)  # a camera repeats it: one message may get lost
            return node.calibrate()[0]

        node.wait_until('no intrinsics', is_calibrated)


def test_node_lives_in_a_namespace(walk: Scene, rig: Path) -> None:
    """Inputs are relative names, outputs and services the node's own."""
    with live(rig, namespace='/hall') as node:
        node.play(walk)
        assert node.calibrate()[0]
        assert node.latched('transform', TransformStamped).child_frame_id == MOCAP_FRAME


def test_only_the_wanted_cameras_are_used(walk: Scene, rig: Path) -> None:
    """A camera that is known to be bad is left out by a parameter."""
    with live(rig, "cameras:=['cam0', 'cam2']") as node:
        peer = node.peer
        wanted = [
            m for m in walk.messages if m[0] in {MOCAP_TOPIC, 'cam0/keypoints', 'cam2/keypoints'}
        ]
        node.advertise({topic: walk.topics[topic] for topic, _, _ in wanted})
        sent = peer.play(wanted, rate=8.0)
        node.wait_until('not counted', lambda: sum(node.received().values()) == sum(sent.values()))
        success, answer = node.calibrate()
        assert success
        assert set(answer['cameras']) == {'cam0', 'cam2'}
