# SPDX-License-Identifier: Apache-2.0
"""What the node publishes, keeps in its file, and takes back from there."""

from __future__ import annotations

import json
import signal
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from geometry_msgs.msg import TransformStamped
from ros_live import WAIT_S, Live, answered_bits, assert_close, bits, live, slow
from ros_scene import Scene
from std_msgs.msg import Float64

from rpgd_ros.io.result_file import read_result
from rpgd_ros.ros.client import NODE


def test_result_of_a_clock_that_is_ahead_is_of_now(walk: Scene, rig: Path) -> None:
    """It was set back since, or the file comes from another machine: no age is negative."""
    path = rig.parent / 'result.yaml'
    with live(rig) as node:
        node.play(walk)
        assert node.calibrate()[0]
    stored = read_result(path).stamp_ns
    path.write_text(path.read_text().replace(str(stored), str(stored + 7_200_000_000_000)))
    path.with_suffix('.npz').unlink()
    assert read_result(path).stamp_ns > stored
    with live(rig) as node:
        node.wait_until('no age', lambda: node.peer.diagnostics('calibration').get('age_s') == '0')
        assert 'The transform of 0 s ago is published' in node.sentence()


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


@pytest.mark.fault(5)
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


def calibrate_half(node: Live, walk: Scene, number: int) -> dict[str, Any]:
    """Play the first (0) or the second half of a walk; return the answer of a calibration."""
    half = len(walk.messages) // 2
    node.peer.play(walk.messages[half:] if number else walk.messages[:half], rate=8.0)
    n_sent = len(walk.messages) if number else half
    node.wait_until('not counted', lambda: sum(node.received().values()) == n_sent)
    return node.calibrate()[1]


def wait_for_published(node: Live, answer: dict[str, Any]) -> None:
    """Wait until the published transform is that of an answer, bit for bit."""
    node.wait_until(
        'not published',
        lambda: bits(node.latched('transform', TransformStamped)) == answered_bits(answer),
    )


def test_revert_goes_back_to_the_calibration_before(walk: Scene, rig: Path) -> None:
    """A second walk with a bumped camera is undone, on the topics and in the file."""
    with live(rig) as node:
        node.advertise(walk.topics)
        first = calibrate_half(node, walk, 0)
        assert not node.call('revert').success
        second = calibrate_half(node, walk, 1)
        assert second['xyz'] != first['xyz']
        assert node.call('revert').success
        wait_for_published(node, first)
        node.wait_until(
            'of the other',
            lambda: node.latched('reprojection_error', Float64).data == first['mpjpe_px'],
        )
        told = f'{first["mpjpe_px"]:.6g}'
        node.wait_until(
            'of the other', lambda: node.peer.diagnostics('calibration')['recent_px'] == told
        )
        stored = read_result(rig.parent / 'result.yaml')
        assert stored.world_T_mocap.translation.tolist() == first['xyz']


def test_loaded_result_takes_the_place_of_the_accepted_one(walk: Scene, rig: Path) -> None:
    """No figure of the other one is told, ~/save leaves the file alone, and ~/revert goes back."""
    path = rig.parent / 'result.yaml'
    with live(rig) as node:
        node.advertise(walk.topics)
        first = calibrate_half(node, walk, 0)
        kept = path.read_bytes()
        second = calibrate_half(node, walk, 1)
        path.write_bytes(kept)
        assert node.call('load').success
        wait_for_published(node, first)
        node.wait_until(
            'still told', lambda: 'mpjpe_px' not in node.peer.diagnostics('calibration')
        )
        assert node.peer.message('calibration') == 'published from the result file'
        assert 'Calibrated' not in node.sentence()
        refused = node.call('save')
        assert not refused.success
        assert json.loads(refused.message)['reason'] == 'no_data'
        assert 'result.yaml was loaded' in refused.message
        assert path.read_bytes() == kept
        assert node.call('revert').success
        wait_for_published(node, second)
        assert read_result(path).world_T_mocap.translation.tolist() == second['xyz']
        node.wait_until(
            'of the file',
            lambda: node.peer.message('calibration') != 'published from the result file',
        )
        assert node.call('save').success


def test_load_waits_for_the_end_of_a_run(walk: Scene, rig: Path) -> None:
    """What it publishes would be replaced by a run that was begun against another pose."""
    with live(rig, *slow()) as node:
        node.play(walk)
        called = node.peer.begin_call(f'{NODE}/calibrate', seconds=WAIT_S)
        assert called is not None
        node.wait_until('not running', lambda: 'Calibrating' in node.sentence())
        for service in ('load', 'save', 'revert'):
            refused = node.call(service)
            assert not refused.success
            assert json.loads(refused.message)['reason'] == 'busy'
            assert 'a calibration is running' in refused.message
        assert not called.done()


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


@pytest.mark.fault(21)
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
