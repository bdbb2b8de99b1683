# SPDX-License-Identifier: Apache-2.0
"""The live node over DDS, as its users see it."""

from __future__ import annotations

import json
import signal
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped
from harness import ros_environment, running
from ros_live import WAIT_S, live
from ros_scene import MOCAP_FRAME, WORLD_FRAME, Scene, make_scene
from scenes import errors
from std_msgs.msg import Float64
from std_srvs.srv import SetBool

from rpgd_ros.core import RigidTransform
from rpgd_ros.io.result_file import read_result
from rpgd_ros.messages import CAMERA_INFO, encode_camera_info, encode_pose_array
from rpgd_ros.ros.client import NODE
from rpgd_ros.simulation.export import MOCAP_TOPIC


@pytest.fixture(scope='module')
def walk(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """Return eight seconds of a walk before four cameras."""
    return make_scene(tmp_path_factory.mktemp('walk'))


@pytest.fixture
def rig(walk: Scene, tmp_path: Path) -> Path:
    """Return the rig file of the walk in a folder of the test's own."""
    path = tmp_path / 'rig.yaml'
    path.write_bytes(walk.rig.read_bytes())
    return path


def heard(message: TransformStamped) -> RigidTransform:
    """Return what a listener takes from a transform message."""
    t, q = message.transform.translation, message.transform.rotation
    return RigidTransform.from_quat_xyzw([t.x, t.y, t.z], [q.x, q.y, q.z, q.w])


def bits(message: TransformStamped) -> list[str]:
    """Return every bit of a transform message."""
    t, q = message.transform.translation, message.transform.rotation
    return [value.hex() for value in (t.x, t.y, t.z, q.x, q.y, q.z, q.w)]


def answered_bits(answer: dict[str, Any]) -> list[str]:
    """Return every bit of the transform in the answer of ~/calibrate."""
    return [float(value).hex() for value in (*answer['xyz'], *answer['quat_xyzw'])]


def assert_close(found: RigidTransform, scene: Scene) -> None:
    """Compare with the truth; eight seconds of walk give 0.01 deg and 0.3 mm."""
    error_deg, error_m = errors(found, scene.world_T_mocap, scene.recording.observations())
    assert error_deg < 0.1
    assert error_m < 0.005


def test_walk_leads_to_a_published_transform_without_any_call(walk: Scene, rig: Path) -> None:
    """Start the node, walk, and the transform is on the topics and in the file."""
    with live(rig, 'auto.enabled:=true', 'auto.period_s:=0.5') as node:
        node.play(walk)
        node.wait_until(
            'not accepted',
            lambda: node.peer.diagnostics('calibration').get('last_result') == 'accepted',
        )
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


def test_answer_is_the_published_transform_bit_for_bit(walk: Scene, rig: Path) -> None:
    """The JSON keeps all digits, and so does the result file."""
    with live(rig) as node:
        node.play(walk)
        success, answer = node.calibrate()
        assert success
        assert answered_bits(answer) == bits(node.latched('transform', TransformStamped))
        assert answer['message'] == ''
    stored = read_result(rig.parent / 'result.yaml').world_T_mocap
    quat, xyz = stored.quat_xyzw.tolist(), stored.translation.tolist()
    assert answered_bits(answer) == [value.hex() for value in (*xyz, *quat)]


def test_restart_publishes_the_kept_result(walk: Scene, rig: Path) -> None:
    """What was accepted yesterday is on the latched topic before any new data."""
    with live(rig) as node:
        node.play(walk)
        _, answer = node.calibrate()
        assert node.child.end(signal.SIGTERM, seconds=WAIT_S) == 0
    with live(rig) as node:
        assert bits(node.latched('transform', TransformStamped)) == answered_bits(answer)
        assert node.latched('reprojection_error', Float64).data == pytest.approx(
            answer['mpjpe_px']
        )
    with live(rig, 'load_on_start:=false') as node:
        node.wait_until('silent', lambda: node.peer.diagnostics('calibration'))
        assert node.peer.diagnostics('calibration')['age_s'] == 'nan'


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


def test_refusal_leaves_the_published_transform_alone(walk: Scene, rig: Path) -> None:
    """After ~/reset there is nothing to calibrate from, and what was published stays."""
    with live(rig) as node:
        node.play(walk)
        assert node.calibrate()[0]
        before = bits(node.latched('transform', TransformStamped))
        assert node.call('reset').success
        assert node.calibrate()[1]['reason'] == 'no_data'
        assert bits(node.latched('transform', TransformStamped)) == before
        kept = (rig.parent / 'result.yaml').read_bytes()
        assert node.call('save').success
        again = (rig.parent / 'result.yaml').read_bytes()
        assert (
            kept.split(b'stamp_ns')[1].split(b'\n', 1)[1]
            == again.split(b'stamp_ns')[1].split(b'\n', 1)[1]
        )


def test_second_caller_hears_busy_at_once(walk: Scene, rig: Path) -> None:
    """One run at a time; the second call does not wait for the first."""
    slow = ('refine.method:=adam', 'refine.iterations:=100000', 'max_seconds:=3.0')
    with live(rig, *slow) as node:
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
        node.wait_until('not told', lambda: 'call ~/calibrate' in node.sentence())
        node.calibrate()
        node.wait_until('not told', lambda: 'Calibrated' in node.sentence())


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
        assert node.calibrate()[1]['reason'] == 'no_data'


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
        node.peer.play(infos, rate=1.0)
        node.wait_until('no intrinsics', lambda: node.calibrate()[0])


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


def test_load_publishes_what_the_file_holds(walk: Scene, rig: Path) -> None:
    """A file put there by hand is taken without a restart; without one the reason is told."""
    with live(rig, 'load_on_start:=false') as node:
        assert 'result.yaml' in node.call('load').message
        node.play(walk)
        node.calibrate()
        found = bits(node.latched('transform', TransformStamped))
        path = rig.parent / 'result.yaml'
        path.write_text(path.read_text().replace('world_frame: world', 'world_frame: elsewhere'))
        refused = node.call('load')
        assert not refused.success
        assert json.loads(refused.message)['reason'] == 'bad_result_file'
        path.write_text(path.read_text().replace('elsewhere', 'world'))
        assert node.call('load').success
        assert bits(node.latched('transform', TransformStamped)) == found


def test_revert_goes_back_to_the_calibration_before(walk: Scene, rig: Path) -> None:
    """A second walk with a bumped camera is undone, on the topics and in the file."""
    with live(rig) as node:
        node.advertise(walk.topics)
        half = len(walk.messages) // 2
        node.peer.play(walk.messages[:half], rate=8.0)
        node.wait_until('not counted', lambda: sum(node.received().values()) == half)
        first = node.calibrate()[1]
        assert not node.call('revert').success
        node.peer.play(walk.messages[half:], rate=8.0)
        node.wait_until('not counted', lambda: sum(node.received().values()) == len(walk.messages))
        second = node.calibrate()[1]
        assert second['xyz'] != first['xyz']
        assert node.call('revert').success
        node.wait_until(
            'not published',
            lambda: bits(node.latched('transform', TransformStamped)) == answered_bits(first),
        )
        stored = read_result(rig.parent / 'result.yaml')
        assert stored.world_T_mocap.translation.tolist() == first['xyz']


def test_bad_result_file_does_not_keep_the_node_from_starting(walk: Scene, rig: Path) -> None:
    """It is said, the file stays for a look, and a new result goes beside its backup."""
    (rig.parent / 'result.yaml').write_text('schema: 99\n')
    with live(rig) as node:
        node.play(walk)
        node.child.wait_for('nothing is published from the result file', seconds=WAIT_S)
        assert node.calibrate()[0]
    assert_close(read_result(rig.parent / 'result.yaml').world_T_mocap, walk)


@pytest.mark.skipif(bool(find_spec('tf2_msgs')), reason='tf2_msgs is installed')
def test_missing_tf2_msgs_is_said_once(walk: Scene, rig: Path) -> None:
    """The wheels have no tf2_msgs: everything but /tf_static works."""
    with live(rig, 'tf_mode:=static') as node:
        node.play(walk)
        assert node.calibrate()[0]
        assert node.calibrate()[0]
        assert node.child.output.count('tf2_msgs is not installed') == 1


def test_tf_static_carries_each_new_result(walk: Scene, rig: Path) -> None:
    """A listener of TF gets the same transform as one of ~/transform, again and again."""
    messages = pytest.importorskip('tf2_msgs.msg')
    with live(rig, 'tf_mode:=static') as node:
        node.peer.listen('/tf_static', messages.TFMessage)
        node.play(walk)
        for _ in range(2):
            answer = node.calibrate()[1]
            node.wait_until(
                'no /tf_static',
                lambda answer=answer: (
                    node.peer.newest('/tf_static') is not None
                    and bits(node.peer.newest('/tf_static').transforms[0]) == answered_bits(answer)
                ),
            )
