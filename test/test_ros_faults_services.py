# SPDX-License-Identifier: Apache-2.0
"""The node's services, files and discovery, as somebody who means no good would use them."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from fault_report import Measured, repeats, within
from geometry_msgs.msg import TransformStamped
from harness import ros_environment, running
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from ros_live import CALIBRATOR, WAIT_S, Live, answered_bits, assert_close, bits, live, slow
from ros_scene import Scene
from std_srvs.srv import Trigger

from rpgd_ros.core.geometry import RigidTransform, so3_exp
from rpgd_ros.messages import POSE_ARRAY, decode_joints, encode_pose_array
from rpgd_ros.ros.client import NODE
from rpgd_ros.ros.domain import free_domain
from rpgd_ros.ros.player import Peer, Timed
from rpgd_ros.ros.transforms import LATCHED
from rpgd_ros.simulation.export import MOCAP_TOPIC

N_CLIENTS = 8
HOSTILE_NAMES = (
    '/etc/cron.d/x', '../../../escaped', '~root/.ssh/authorized_keys', '/proc/self/mem', 'a\x00b',
    '$(touch escaped)', '`touch escaped`', ';touch escaped', '..', '', '/dev/null', 'x' * 5000,
)  # fmt: skip


@pytest.mark.fault(18)
def test_of_many_callers_at_once_one_is_served(walk: Scene, rig: Path, measured: Measured) -> None:
    """The others hear 'busy' at once, and the result is bit for bit that of a lone call."""
    with live(rig, *slow(200)) as node:
        node.play(walk)
        success, alone = node.calibrate()
        assert success, alone
        clients = [
            node.peer.node.create_client(Trigger, f'{NODE}/calibrate') for _ in range(N_CLIENTS)
        ]
        node.wait_until('no service', lambda: all(c.service_is_ready() for c in clients))
        for _ in range(repeats(5, 2)):
            start = time.monotonic()
            futures = [client.call_async(Trigger.Request()) for client in clients]
            node.wait_until('no busy', lambda f=futures: sum(x.done() for x in f) >= N_CLIENTS - 1)
            measured('busy heard', time.monotonic() - start, 's', n=N_CLIENTS)
            assert time.monotonic() - start < within(0.2)
            node.wait_until('no answer', lambda f=futures: all(x.done() for x in f))
            answers = [json.loads(f.result().message) for f in futures]
            served = [a for a in answers if a['reason'] == 'accepted']
            assert len(served) == 1
            assert [a['reason'] for a in answers].count('busy') == N_CLIENTS - 1
            assert answered_bits(served[0]) == answered_bits(alone)


@pytest.mark.fault(19, rounds=10)
def test_parameters_are_set_while_a_calibration_runs(
    walk: Scene, rig: Path, measured: Measured
) -> None:
    """Each change is answered at once; the run keeps what it began with, the next one does not."""
    with live(rig, *slow(1000)) as node:
        node.play(walk)
        called = node.peer.begin_call(f'{NODE}/calibrate', seconds=WAIT_S)
        assert called is not None
        node.wait_until('not running', lambda: 'Calibrating' in node.sentence())
        for n in range(20):
            start = time.monotonic()
            integer = ParameterType.PARAMETER_INTEGER
            value = ParameterValue(type=integer, integer_value=10**6 + n)
            assert set_parameter(node, 'accept.min_pairs', value) == ''
            measured('answered', time.monotonic() - start, 's')
            assert time.monotonic() - start < within(0.1)
        assert not called.done()
        node.wait_until('no answer', called.done)
        assert called.result().success
        assert node.calibrate()[1]['reason'] == 'too_few_inliers'


def set_parameter(node: Live, name: str, value: ParameterValue) -> str:
    """Set a parameter; return why that was refused, '' = it was not."""
    request = SetParameters.Request(parameters=[Parameter(name=name, value=value)])
    called = node.peer.begin_call(
        f'{NODE}/set_parameters', seconds=WAIT_S, srv_type=SetParameters, request=request
    )
    assert called is not None
    node.wait_until('no answer', called.done)
    result = called.result().results[0]
    assert result.successful == (not result.reason)
    return str(result.reason)


def moved(messages: Sequence[Timed], new_T_old: RigidTransform) -> list[Timed]:
    """Return messages whose skeletons are given in another frame."""
    out: list[Timed] = []
    for topic, time_ns, payload in messages:
        if topic == MOCAP_TOPIC:
            n_joints = (len(payload) - 16) // 56
            batch = decode_joints(POSE_ARRAY, [payload], n_joints=n_joints, n_values=3).batch
            assert batch is not None
            x = new_T_old @ batch.values[0]
            new = encode_pose_array(int(batch.stamp_ns[0]), batch.frame_id, x)
            out.append((topic, time_ns, new))
        else:
            out.append((topic, time_ns, payload))
    return out


@pytest.mark.fault(21, rounds=10)
def test_late_joiners_see_the_newest_transform(walk: Scene, rig: Path, measured: Measured) -> None:
    """Subscribers from before, between and after two calibrations with a moved truth agree."""
    new_T_old = RigidTransform(so3_exp([0.1, -0.2, 0.7]), np.array([1.0, -2.0, 0.5]))
    seen: dict[str, TransformStamped] = {}

    def listen(node: Live, name: str) -> None:
        node.peer.node.create_subscription(
            TransformStamped, f'{NODE}/transform', lambda m: seen.__setitem__(name, m), LATCHED
        )

    with live(rig) as node:
        listen(node, 'before')
        node.play(walk)
        first = node.calibrate()[1]
        listen(node, 'between')
        node.wait_until('not seen', lambda: len(seen) == 2)
        assert {tuple(bits(m)) for m in seen.values()} == {tuple(answered_bits(first))}
        assert node.call('reset').success
        node.peer.play(moved(walk.messages, new_T_old), rate=8.0)
        twice = 2 * len(walk.messages)
        node.wait_until('not counted', lambda: sum(node.received().values()) == twice)
        success, second = node.calibrate()
        assert success
        start = time.monotonic()
        listen(node, 'after')
        node.wait_until(
            'not seen',
            lambda: [bits(m) for m in seen.values()] == [answered_bits(second)] * 3,
        )
        measured('seen by all three', time.monotonic() - start, 's')
        assert time.monotonic() - start < within(1.0)
    norm = np.linalg.norm(second['quat_xyzw'])
    measured('|q| - 1', float(abs(norm - 1.0)))
    assert abs(norm - 1.0) < 1e-9
    t, q = np.array(second['xyz']), np.array(second['quat_xyzw'])
    assert_close(RigidTransform.from_quat_xyzw(t, q) @ new_T_old, walk)


def tree_of(folder: Path) -> dict[str, bytes]:
    """Return every file below a folder."""
    return {str(p): p.read_bytes() for p in folder.rglob('*') if p.is_file()}


@pytest.mark.threat('S3')
def test_no_service_takes_a_path(walk: Scene, rig: Path, measured: Measured) -> None:
    """All own services are Trigger or SetBool, and the place of the result is read-only."""
    with live(rig, 'diagnostics_period:=0.1', 'tf_mode:=none') as node:
        node.play(walk)
        assert node.calibrate()[0]
        services = node.peer.node.get_service_names_and_types_by_node(NODE, '/')
        own = {
            name: types for name, types in services if not types[0].startswith('rcl_interfaces')
        }
        kinds = {kind for types in own.values() for kind in types}
        assert kinds <= {
            'std_srvs/srv/Trigger', 'std_srvs/srv/SetBool',
            'type_description_interfaces/srv/GetTypeDescription',
        }  # fmt: skip
        before = tree_of(rig.parent)
        for name in HOSTILE_NAMES:
            text = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=name)
            for parameter in ('result_file', 'rig_file'):
                assert 'read-only' in set_parameter(node, parameter, text)
        assert tree_of(rig.parent) == before
        measured('names refused', n=len(HOSTILE_NAMES))


@pytest.mark.threat('S4')
def test_planted_links_are_not_followed(walk: Scene, rig: Path, measured: Measured) -> None:
    """Where somebody guesses a temporary name, or puts a link at the result, nothing follows."""
    victim = rig.parent / 'victim'
    victim.write_text('whole')
    with live(rig) as node:
        node.play(walk)
        pid = node.child.process.pid
        for name in (f'.result.yaml.{pid}.tmp', '.result.yaml.tmp', 'result.yaml.tmp'):
            (rig.parent / name).symlink_to(victim)
        assert node.calibrate()[1]['message'] == ''
        (rig.parent / 'result.yaml').unlink()
        (rig.parent / 'result.yaml').symlink_to(victim)
        assert 'symbolic link' in node.calibrate()[1]['message']
    assert victim.read_text() == 'whole'
    measured('links not followed', n=4)


@pytest.mark.threat('S6')
def test_node_with_discovery_off_is_unseen(walk: Scene, rig: Path, measured: Measured) -> None:
    """While another one beside it, on this machine only, is found."""
    with live(rig) as node:
        node.play(walk)
        assert node.calibrate()[0]
    domain = free_domain()
    arguments = [*CALIBRATOR, '--ros-args', '-p', f'rig_file:={rig}', '-p', 'tf_mode:=none']
    arguments += ['-p', f'result_file:={rig.parent / "result.yaml"}']
    hidden = ros_environment(domain, ROS_AUTOMATIC_DISCOVERY_RANGE='OFF')
    seen = ['-r', '__node:=seen']
    with (
        running([*arguments, '-r', '__node:=hidden'], hidden) as off,
        Peer('peer', domain_id=domain) as peer,
    ):
        off.wait_for('published the transform', seconds=WAIT_S)
        with running([*arguments, *seen], ros_environment(domain)) as on:
            assert peer.wait_until(lambda: 'seen' in peer.node.get_node_names(), seconds=WAIT_S)
            on.wait_for('published the transform', seconds=WAIT_S)
            assert 'hidden' not in peer.node.get_node_names()
            measured('unseen')
            assert on.end(signal.SIGTERM, seconds=WAIT_S) == 0
        assert off.end(signal.SIGTERM, seconds=WAIT_S) == 0


BAD_FILES: dict[str, tuple[str, str]] = {
    'empty': ('', 'rig_file is not set'),
    'typo': ('ransac.treshold_px: 3.0', 'did you mean ransac.threshold_px'),
    'text for a number': ('ransac.threshold_px: much', "got 'much'"),
    'out of range': ('ransac.threshold_px: -1.0', 'outside'),
    'not a number': ('accept.max_sigma_m: .nan', 'accept.max_sigma_m'),
    'infinite': ('accept.max_sigma_m: .inf', 'accept.max_sigma_m'),
    'text for a switch': ("auto.enabled: 'yes'", 'auto.enabled'),
    'list for a number': ('ransac.iterations: [1, 2]', 'ransac.iterations'),
    'unknown choice': ('refine.method: magic', "'magic'"),
    'unknown camera': ("cameras: ['cam9']", "no 'cam9'"),
    'alias': ('ransac.seed: &a 1\n    accept.min_pairs: *a', 'cannot be read'),
    'tag': ('rig_file: !!python/object/apply:os.system ["touch escaped"]', 'rig_file is not set'),
    'no yaml': ('{[}', 'cannot be read'),
    'unknown key deep down': ('camera.cam0.untis: pixels', 'camera.cam0.units'),
}


@pytest.mark.fault(20)
@pytest.mark.parametrize('kind', BAD_FILES)
def test_bad_parameter_file_ends_in_one_line(
    rig: Path, tmp_path: Path, kind: str, measured: Measured
) -> None:
    """Code 2 within three seconds, and the line names what is wrong."""
    line, said = BAD_FILES[kind]
    path = tmp_path / 'parameters.yaml'
    given = '' if kind in {'empty', 'tag'} else f'    rig_file: {rig}\n'
    body = f'/**:\n  ros__parameters:\n{given}    {line}\n' if line else ''
    path.write_text(body)
    arguments = [*CALIBRATOR, '--ros-args', '--params-file', str(path)]
    start = time.monotonic()
    with running(arguments, ros_environment(free_domain(), HOME=str(tmp_path))) as child:
        assert child.wait(seconds=WAIT_S) == 2, child.output
        seconds = time.monotonic() - start
        lines = child.output.splitlines()
    measured('refused', seconds, 's')
    assert seconds < within(3.0)
    assert len(lines) == 1, lines
    assert said in lines[0]
    assert not (Path(os.getcwd()) / 'escaped').exists()  # noqa: PTH109


@pytest.mark.fault(20)
def test_whole_number_stands_for_a_float(rig: Path, tmp_path: Path) -> None:
    """`10` where `10.0` is meant is no reason to refuse a file."""
    path = tmp_path / 'parameters.yaml'
    tree: dict[str, Any] = {'rig_file': str(rig), 'ransac': {'threshold_px': 10}}
    path.write_text(yaml.safe_dump({'/**': {'ros__parameters': tree}}))
    domain = free_domain()
    arguments = [*CALIBRATOR, '--ros-args', '--params-file', str(path)]
    with (
        running(arguments, ros_environment(domain, HOME=str(tmp_path))) as child,
        Peer('peer', domain_id=domain) as peer,
    ):
        peer.listen_diagnostics()
        assert peer.wait_until(lambda: bool(peer.diagnostics('mocap')), seconds=WAIT_S)
        assert child.end(signal.SIGTERM, seconds=WAIT_S) == 0, child.output
