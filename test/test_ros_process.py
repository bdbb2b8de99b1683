# SPDX-License-Identifier: Apache-2.0
"""The node as a process: how it refuses to start, and how it ends."""

from __future__ import annotations

import json
import signal
import time
from pathlib import Path

import pytest
import yaml
from harness import ros_environment, running
from ros_live import CALIBRATOR, WAIT_S, live, slow
from ros_scene import Scene

from rpgd_ros.ros.client import NODE
from rpgd_ros.ros.domain import free_domain
from rpgd_ros.ros.parameters_text import calibrator_yaml
from rpgd_ros.ros.player import Peer

END_S = 2.0  # launch escalates after 5


def refusal(*arguments: str, home: Path) -> str:
    """Return the one line with which the program refuses to start."""
    environment = ros_environment(free_domain(), HOME=str(home))
    with running([*CALIBRATOR, *arguments], environment) as child:
        assert child.wait(seconds=WAIT_S) == 2, child.output
        lines = child.output.splitlines()
    assert len(lines) == 1, child.output
    return lines[0]


def set_to(*parameters: str) -> list[str]:
    """Return the command line that sets parameters."""
    return ['--ros-args', *(word for p in parameters for word in ('-p', p))]


@pytest.mark.fault(20)
@pytest.mark.parametrize(
    ('parameters', 'said'),
    [
        ([], 'no rig file: parameter rig_file is not set'),
        (['rig_fiel:=rig.yaml'], "unknown parameter 'rig_fiel': did you mean rig_file?"),
        (['rig_file:=/no/such/rig.yaml'], '/no/such/rig.yaml'),
        (['rig_file:=RIG', 'ransac.treshold_px:=3.0'], 'did you mean ransac.threshold_px?'),
        (['rig_file:=RIG', 'ransac.threshold_px:=-1.0'], 'ransac.threshold_px: -1.0 is outside'),
        (['rig_file:=RIG', 'ransac.threshold_px:=much'], "need a number, got 'much'"),
        (['rig_file:=RIG', 'accept.min_motion_m:=.nan'], 'accept.min_motion_m: nan is outside'),
        (
            ['rig_file:=RIG', "cameras:=['cam0', 'cam9']"],
            "no 'cam9', it has cam0, cam1, cam2, cam3",
        ),
        (['rig_file:=RIG', 'camera.cam9.units:=pixels'], "no camera 'cam9', it has cam0, cam1"),
        (['rig_file:=RIG', 'mocap_frame:=world'], "world_frame and mocap_frame are both 'world'"),
        (['rig_file:=RIG', 'nonsense'], 'the ROS arguments cannot be read'),
    ],
)
def test_bad_parameters_end_in_one_line_and_code_2(
    walk: Scene, tmp_path: Path, parameters: list[str], said: str
) -> None:
    """The line says what was found and what is needed; nothing is started."""
    given = [p.replace('RIG', str(walk.rig)) for p in parameters]
    assert said in refusal(*set_to(*given), home=tmp_path)


@pytest.mark.fault(20)
@pytest.mark.parametrize(
    ('text', 'said'),
    [
        ('', 'no rig file: parameter rig_file is not set'),
        ('other_node:\n  ros__parameters:\n    rig_file: rig.yaml\n', 'the name of this node'),
        ('/**:\n  ros__parameters:\n    a: *x\n', 'the ROS arguments cannot be read'),
        (
            '/**:\n  ros__parameters:\n    auto:\n      perod_s: 3.0\n',
            'did you mean auto.period_s',
        ),
    ],
)
def test_bad_parameter_files_end_in_one_line_and_code_2(
    tmp_path: Path, text: str, said: str
) -> None:
    """Without a check rclpy starts happily with an empty file, or with one for another node."""
    path = tmp_path / 'parameters.yaml'
    path.write_text(text)
    assert said in refusal('--ros-args', '--params-file', str(path), home=tmp_path)


@pytest.mark.fault(23)
def test_bad_rig_file_ends_in_one_line_and_code_2(walk: Scene, tmp_path: Path) -> None:
    """The line names the file and the key."""
    tree = yaml.safe_load(walk.rig.read_text())
    tree['cameras'][1]['matrx'] = tree['cameras'][1].pop('matrix')
    path = tmp_path / 'rig.yaml'
    path.write_text(yaml.safe_dump(tree))
    line = refusal(*set_to(f'rig_file:={path}'), home=tmp_path)
    assert str(path) in line
    assert 'matrx' in line


def test_arguments_that_are_not_ros_arguments_are_refused(tmp_path: Path) -> None:
    """`calibrator rig.yaml` is a misunderstanding that help would clear up."""
    environment = ros_environment(free_domain(), HOME=str(tmp_path))
    with running([*CALIBRATOR, 'rig.yaml'], environment) as child:
        assert child.wait(seconds=WAIT_S) == 2
        assert 'unrecognized arguments: rig.yaml' in child.output


def test_help_teaches_the_three_commands(tmp_path: Path) -> None:
    """What to start, what to call, where the result is."""
    environment = ros_environment(free_domain(), HOME=str(tmp_path))
    with running([*CALIBRATOR, '--help'], environment) as child:
        assert child.wait(seconds=WAIT_S) == 0
        for word in ('rig_file:=rig.yaml', '/calibrate', '/transform', 'exit codes'):
            assert word in child.output


def test_example_parameter_file_is_taken_as_it_is(walk: Scene, tmp_path: Path) -> None:
    """A copy of config/calibrator.yaml starts the node."""
    path = tmp_path / 'calibrator.yaml'
    path.write_text(calibrator_yaml().replace("rig_file: ''", f"rig_file: '{walk.rig}'"))
    domain = free_domain()
    arguments = [*CALIBRATOR, '--ros-args', '--params-file', str(path)]
    with (
        running(arguments, ros_environment(domain, HOME=str(tmp_path))) as child,
        Peer('peer', domain_id=domain) as peer,
    ):
        peer.listen_diagnostics()
        assert peer.wait_until(lambda: bool(peer.diagnostics('mocap')), seconds=WAIT_S)
        assert child.end(signal.SIGTERM, seconds=WAIT_S) == 0, child.output


@pytest.mark.fault(6)
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_signal_ends_the_node_cleanly(walk: Scene, number: signal.Signals) -> None:
    """Exit code 0 within two seconds, without a traceback."""
    with live(walk.rig) as node:
        node.wait_until('not up', lambda: node.peer.diagnostics('calibration'))
        start = time.monotonic()
        assert node.child.end(number, seconds=WAIT_S) == 0
        assert time.monotonic() - start < END_S
        assert 'Traceback' not in node.child.output


@pytest.mark.fault(4)
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_signal_ends_a_running_calibration(walk: Scene, number: signal.Signals) -> None:
    """The caller hears of it, and the process does not outlast two seconds."""
    with live(walk.rig, *slow()) as node:
        node.play(walk)
        called = node.peer.begin_call(f'{NODE}/calibrate', seconds=WAIT_S)
        assert called is not None
        node.wait_until('not running', lambda: 'Calibrating' in node.sentence())
        start = time.monotonic()
        node.child.process.send_signal(number)
        node.wait_until('no answer', called.done)
        assert json.loads(called.result().message)['reason'] == 'cancelled'
        assert node.child.wait(seconds=WAIT_S) == 0
        assert time.monotonic() - start < END_S
        assert 'Traceback' not in node.child.output
        assert not (walk.rig.parent / 'result.yaml').exists()
