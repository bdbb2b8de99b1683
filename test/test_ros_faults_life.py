# SPDX-License-Identifier: Apache-2.0
"""The life of the node's process under fire: signals, kills, restarts, exceptions, full disks."""

from __future__ import annotations

import contextlib
import json
import resource
import signal
import subprocess
import time
from pathlib import Path

import pytest
from fault_report import Measured, repeats, within
from geometry_msgs.msg import TransformStamped
from harness import Child
from rcl_interfaces.msg import ParameterType, ParameterValue
from ros_live import WAIT_S, Live, answered_bits, bits, live, slow
from ros_scene import Scene
from test_ros_live_parameters import set_to

from rpgd_ros.io.result_file import read_result
from rpgd_ros.ros.client import NODE
from rpgd_ros.ros.domain import free_domain
from rpgd_ros.ros.player import Peer

FAULTY = str(Path(__file__).with_name('faulty_calibrator.py'))
END_S = 2.0


def temporary_files(folder: Path) -> list[str]:
    """Return the names of what an interrupted save would leave."""
    return [path.name for path in folder.iterdir() if path.name.endswith('.tmp')]


def end(child: Child, number: signal.Signals) -> float:
    """End a node with a signal; return how long it took."""
    start = time.monotonic()
    assert child.end(number, seconds=WAIT_S) == 0, child.output
    return time.monotonic() - start


@pytest.mark.parametrize(
    'number',
    [
        pytest.param(signal.SIGTERM, marks=pytest.mark.fault(1)),
        pytest.param(signal.SIGINT, marks=pytest.mark.fault(2)),
    ],
)
def test_signal_in_a_save_leaves_a_whole_file(
    walk: Scene, rig: Path, number: signal.Signals, measured: Measured
) -> None:
    """In the backup or in the result itself: the node finishes what it writes and ends."""
    path = rig.parent / 'result.yaml'
    for n in range(repeats(10, 2)):
        before = read_result(path).stamp_ns if path.exists() else 0
        with live(rig, program=[FAULTY, 'slow_disk']) as node:
            node.play(walk)
            assert node.peer.begin_call(f'{NODE}/calibrate', seconds=WAIT_S) is not None
            # After the data comes the backup, where there is something to back up.
            number_of = 2 if n % 2 or not before else 3
            node.child.wait_for('(saving\n.*){%d}' % number_of, seconds=WAIT_S)  # noqa: UP031
            seconds = end(node.child, number)
            assert seconds < within(END_S)
            assert 'Traceback' not in node.child.output
        measured('end', seconds, 's')
        assert read_result(path).stamp_ns >= before
        assert not temporary_files(rig.parent)


@pytest.mark.fault(4)
def test_signal_in_a_computation_is_heeded_at_once(
    walk: Scene, rig: Path, measured: Measured
) -> None:
    """The caller hears of it before the node goes, and nothing is written."""
    for n in range(repeats(10, 1)):
        with live(rig, *slow()) as node:
            node.play(walk)
            called = node.peer.begin_call(f'{NODE}/calibrate', seconds=WAIT_S)
            assert called is not None
            node.wait_until('not running', lambda: 'Calibrating' in node.sentence())
            start = time.monotonic()
            node.child.process.send_signal((signal.SIGTERM, signal.SIGINT)[n % 2])
            node.wait_until('no answer', called.done)
            assert json.loads(called.result().message)['reason'] == 'cancelled'
            assert node.child.wait(seconds=WAIT_S) == 0
            measured('end', time.monotonic() - start, 's')
            assert time.monotonic() - start < within(END_S)
            assert 'Traceback' not in node.child.output
            assert not (rig.parent / 'result.yaml').exists()


@pytest.mark.fault(5)
def test_killed_node_is_answered_again_and_keeps_its_result(
    walk: Scene, rig: Path, measured: Measured
) -> None:
    """The dead node's service haunts the domain: a client that tries again gets its answer."""
    domain = free_domain()
    with live(rig, domain=domain) as node:
        node.play(walk)
        success, answer = node.calibrate()
        assert success
        node.child.process.kill()
    for _ in range(repeats(20, 2)):
        start = time.monotonic()
        with live(rig, domain=domain) as node:
            line = node.child.wait_for('published the transform of .*', seconds=WAIT_S)
            started = time.monotonic() - start
            assert 'result.yaml, found 20' in line.group()
            # Fast DDS may let two processes find each other 3 s late where one was killed before,
            # at the next announcement of the other: seen of listeners that had always been there.
            published = node.latched('transform', TransformStamped)
            measured('heard', time.monotonic() - start, 's')
            assert bits(published) == answered_bits(answer)
            while (called := node.peer.call(f'{NODE}/calibrate', seconds=1.0)) is None:
                assert time.monotonic() - start < within(25.0), 'no answer'
            assert 'no_data' in called.message
            measured('answered', time.monotonic() - start, 's')
            measured('published', started, 's')
            assert started < within(2.0)
            node.child.process.kill()


def shared_memory(pid: int) -> set[str]:
    """Return the shared memory that a process uses."""
    lines = Path(f'/proc/{pid}/maps').read_text().splitlines()
    return {line.split()[-1] for line in lines if '/dev/shm/' in line}  # noqa: S108


def start_and_stop(rig: Path, n_rounds: int, measured: Measured) -> None:
    """Start, call and end a node many times; what stays of it after the first round stays few."""
    used: set[str] = set()
    left: list[int] = []
    domain = free_domain()
    # Somebody else stays in the domain: between two rounds it would be free, and taken by others.
    with Peer('studio', domain_id=domain):
        for n in range(n_rounds):
            with live(rig, domain=domain) as node:
                assert node.calibrate()[1]['reason'] == 'no_data'
                used |= shared_memory(node.child.process.pid)
                seconds = end(node.child, (signal.SIGINT, signal.SIGTERM)[n % 2])
            left.append(sum(Path(name).exists() for name in used))
            measured('end', seconds, 's')
            assert seconds < within(3.0)
    assert used
    measured('shared memory', max(left) - left[0], 'entries more', n=n_rounds)
    assert max(left) - left[0] <= 2


@pytest.mark.fault(6)
def test_node_starts_and_stops_again_and_again(rig: Path, measured: Measured) -> None:
    """Each round ends with code 0; `long_ros_faults.py` does a hundred."""
    start_and_stop(rig, repeats(10, 2), measured)


@pytest.mark.fault(7, rounds=10)
def test_exception_in_a_callback_is_counted_and_survived(
    walk: Scene, rig: Path, measured: Measured
) -> None:
    """One batch of ten raises: the node says how often, warns, and calibrates from the rest."""
    with live(rig, program=[FAULTY, 'faulty_session']) as node:
        node.play(walk)
        said = time.monotonic()
        n_raised = node.child.output.count('raised\n')
        assert n_raised > 1

        def is_counted() -> bool:
            counted = node.peer.diagnostics('calibration').get('internal_errors', '0')
            return int(counted) == node.child.output.count('raised\n')

        node.wait_until('not counted', is_counted)
        node.wait_until(
            'no warning', lambda: 'internal error' in node.peer.message('calibration') or None
        )
        measured('told', time.monotonic() - said, 's', n=n_raised)
        assert time.monotonic() - said < within(2.0)
        success, _ = node.calibrate()
        assert success
        node.wait_until('no warning', lambda: 'internal error' in node.peer.message('calibration'))
        assert node.child.output.count('internal error') <= 2  # the log is not flooded


@pytest.mark.fault(7, rounds=10)
def test_exception_in_a_service_or_an_automatic_run_is_survived(
    walk: Scene, rig: Path, measured: Measured
) -> None:
    """Who called hears of it; nobody hears of automatic runs, but they are counted as well."""
    with live(rig, 'auto.period_s:=0.5', program=[FAULTY, 'faulty_services']) as node:
        node.play(walk)
        for service in ('calibrate', 'reset') * 2:
            answered = node.call(service)
            assert not answered.success
            answer = json.loads(answered.message)
            assert answer['reason'] == 'internal_error'
            assert 'RuntimeError: nobody foresaw this' in answer['message']
        on = ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=True)
        assert set_to(node, 'auto.enabled', on) == ''

        def counted() -> int:
            return int(node.peer.diagnostics('calibration')['internal_errors'])

        node.wait_until('not counted', lambda: counted() > 4)
        assert node.call('load').success is False
        measured('exceptions in services counted', n=counted())
        assert 'Traceback' not in node.child.output


@pytest.mark.fault(24, rounds=10)
def test_full_disk_is_said_and_harms_nothing(
    walk: Scene, rig: Path, tmp_path: Path, measured: Measured
) -> None:
    """A file system of 8 MiB, filled to the last byte."""
    disk = tmp_path / 'disk'
    disk.mkdir()
    mount = ['mount', '-t', 'tmpfs', '-o', 'size=8m', 'tmpfs', str(disk)]
    if subprocess.run(mount, check=False, capture_output=True).returncode:
        pytest.skip('only root can mount a small disk')
    try:
        path = disk / 'result.yaml'
        with live(rig, f'result_file:={path}') as node:
            node.play(walk)
            assert node.calibrate()[1]['message'] == ''
            old = path.read_bytes()
            filler = disk / 'filler'
            with contextlib.suppress(OSError), filler.open('wb', buffering=0) as file:
                while True:
                    file.write(bytes(512))
            save_is_refused(node, 'No space left')
            assert path.read_bytes() == old
            assert not temporary_files(disk)
            filler.unlink()
            assert node.call('save').success
            assert path.read_bytes() != old
        measured('full disk told, saved later')
    finally:
        subprocess.run(['umount', '-l', str(disk)], check=False)  # noqa: S607


def save_is_refused(node: Live, words: str) -> None:
    """Calibrate; the answer says why the result could not be saved."""
    success, answer = node.calibrate()
    assert success
    assert words in answer['message'], answer


@pytest.mark.fault(24, rounds=10)
def test_result_that_cannot_be_saved_is_kept_until_it_can(
    walk: Scene, rig: Path, measured: Measured
) -> None:
    """No space, no folder, a link in its place: said with the system's words, saved afterwards."""
    path = rig.parent / 'kept' / 'result.yaml'
    with live(rig, f'result_file:={path}') as node:
        node.play(walk)
        assert node.calibrate()[0]
        pid, old = node.child.process.pid, path.read_bytes()
        before = resource.prlimit(pid, resource.RLIMIT_FSIZE)
        data = path.with_suffix('.npz').read_bytes()
        for room in (1000, len(data) - 1):  # for neither, for all but the data
            resource.prlimit(pid, resource.RLIMIT_FSIZE, (room, before[1]))
            save_is_refused(node, 'File too large')
            assert path.read_bytes() == old
            assert path.with_suffix('.npz').read_bytes() == data
            assert not temporary_files(path.parent)
        resource.prlimit(pid, resource.RLIMIT_FSIZE, before)
        assert node.call('save').success
        assert path.read_bytes() != old

        aside = path.parent.rename(rig.parent / 'aside')
        path.parent.write_text('a file in place of the folder')
        save_is_refused(node, 'File exists')
        path.parent.unlink()
        assert node.call('save').success  # the folder is made again

        path.unlink()
        path.symlink_to(aside / 'result.yaml')
        elsewhere = (aside / 'result.yaml').read_bytes()
        save_is_refused(node, 'symbolic link')
        assert (aside / 'result.yaml').read_bytes() == elsewhere
        path.unlink()
        assert node.call('save').success
        assert read_result(path).world_frame
        measured('3 kinds told and saved later', n=3)
