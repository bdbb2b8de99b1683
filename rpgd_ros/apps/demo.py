# SPDX-License-Identifier: Apache-2.0
"""The whole way once, from a simulated recording over the live node to an error in millimetres."""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import yaml
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from rpgd_ros.apps import simulate
from rpgd_ros.apps.progress import bar_columns
from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import Array, RigidTransform, euler_zyx_from_rotation, rotation_angle
from rpgd_ros.io.bag import open_bag
from rpgd_ros.io.recording import Recording
from rpgd_ros.io.rig import read_rig
from rpgd_ros.ros.domain import free_domain
from rpgd_ros.ros.signals import StopFlag

if TYPE_CHECKING:
    from rpgd_ros.ros.client import CalibratorClient
    from rpgd_ros.ros.player import Peer, Timed

EXIT_DONE, EXIT_INACCURATE, EXIT_BAD_INPUT, EXIT_STOPPED = 0, 1, 2, 130
MAX_ERROR_DEG, MAX_ERROR_MM = 0.1, 5.0  # the walk of the default length gives 0.01 deg and 0.5 mm

RECORDING, RESULT, LOG = 'recording', 'result.yaml', 'calibrator.log'
REPORT = 'result.html'  # written where the libraries for it are installed
COORDINATES = ('x', 'y', 'z', 'roll', 'pitch', 'yaw')
START_SECONDS = 30.0  # of the node; 1 s on an idle machine
END_SECONDS = 5.0  # of the node, which promises 2
CALL_SECONDS = 60.0
COUNT_SECONDS = 5.0  # diagnostics come once a second

DESCRIPTION = """\
Simulate a studio recording in which a fifth of the keypoints is wrong, play it to the live
calibrator over DDS, and compare the transform that it publishes with the truth. Leaves in DIR:

  recording/      the bag, its rig file and the truth
  result.yaml     what the calibrator found
  result.html     the same to look at: room, cameras, residuals
  calibrator.log  what it said; log/ holds what ROS writes beside it
"""
EPILOG = """\
exit codes: 0 the error is below 0.1 deg and 5 mm, 1 it is not, 2 the demo could not run,
130 stopped; nothing stays running
"""


class _StoppedError(Exception):
    """A signal came: the demo ends through every clean-up."""


@dataclass(frozen=True, eq=False)
class Truth:
    """What the calibrator has to find.

    Attributes:
        world_T_mocap: The transform.
        x_mocap: (N, 3) points of the walking body, metres, MoCap frame.
        x_world: (N, 3) the same points, metres, world frame.

    """

    world_T_mocap: RigidTransform
    x_mocap: Array
    x_world: Array


def main(argv: Sequence[str] | None = None) -> int:
    """Run the demo; returns its exit code."""
    arguments = _parser().parse_args(argv)
    console = Console()
    stop = StopFlag()
    # For this process too, and before it imports ROS.
    os.environ |= {
        'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
        'ROS_DOMAIN_ID': str(free_domain()),
        'ROS_LOG_DIR': str(arguments.output.resolve() / 'log'),
        'ROS_PYTHON_CHECK_FIELDS': '1',
    }
    try:
        return _run(arguments, console, stop)
    except InputError as error:
        print(f'demo: {error.message}', file=sys.stderr)
        return EXIT_BAD_INPUT
    except _StoppedError:
        print('demo: stopped, nothing is left running', file=sys.stderr)
        return EXIT_STOPPED


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='demo',
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add('--output', required=True, type=Path, metavar='DIR', help='folder for what it leaves')
    add('--seconds', type=float, default=60.0, help='length of the walk (default 60)')
    add('--rate', type=float, default=5.0, help='times faster than recorded (default 5)')
    add('--outliers', type=float, default=0.2, help='share of wrong keypoints (default 0.2)')
    add('--seed', type=int, default=0, help='of everything random (default 0)')
    return parser


def _run(arguments: argparse.Namespace, console: Console, stop: StopFlag) -> int:
    if not arguments.rate > 0.0:
        msg = f'--rate must be above 0, got {arguments.rate}'
        raise InputError(Reason.BAD_INPUT, msg)
    folder = arguments.output / RECORDING
    code = _simulate(arguments, folder)
    if code:
        return code

    def check() -> None:
        if stop.is_set:
            raise _StoppedError

    check()
    answer, published, lost = _calibrate_live(arguments.output, console, check, arguments.rate)
    code = _report(console, answer, published, _read_truth(folder / 'truth.yaml'), lost=lost)
    for name, path in (('result file', RESULT), ('look at it', REPORT)):
        if (arguments.output / path).exists():
            console.print(f'{name}: {arguments.output / path}')
    return code


def _calibrate_live(
    output: Path, console: Console, check: Callable[[], None], rate: float
) -> tuple[dict[str, Any], RigidTransform, int]:
    """Play the recording to the real node; return answer, published transform, messages lost."""
    from rpgd_ros.ros.client import CalibratorClient  # noqa: PLC0415
    from rpgd_ros.ros.player import Peer  # noqa: PLC0415

    rig_path = output / RECORDING / 'rig.yaml'
    with (
        _calibrator(output, rig_path, console) as node,
        Progress(*bar_columns(), console=console, transient=True) as bars,
    ):

        def check_both() -> None:
            check()
            if node.poll() is not None:
                msg = f'the calibrator ended with code {node.returncode}: see {output / LOG}'
                raise InputError(Reason.BAD_INPUT, msg)

        with Peer('demo', check=check_both) as peer:
            client = CalibratorClient(peer, read_rig(rig_path))
            lost = _play(peer, client, output / RECORDING, bars, rate)
            bars.add_task('calibrating', total=None)
            called = client.calibrate(seconds=CALL_SECONDS)
            if called is None or not called[0]:
                msg = f'not calibrated: {called[1]["message"] if called else "no answer"}'
                raise InputError(Reason.BAD_INPUT, msg)
            published = client.transform(seconds=COUNT_SECONDS)
            bars.add_task('writing the report', total=None)
            client.save(seconds=CALL_SECONDS)
    if published is None:
        raise InputError(Reason.BAD_INPUT, 'the calibrator did not publish ~/transform')
    return called[1], published, lost


def _simulate(arguments: argparse.Namespace, folder: Path) -> int:
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        msg = f'{folder.parent} cannot be made: {error.strerror or error}'
        raise InputError(Reason.NOT_WRITABLE, msg) from error
    words = ['--preset', 'studio', '--force', '--output', str(folder)]
    words += ['--seconds', str(arguments.seconds), '--seed', str(arguments.seed)]
    # Wrong as on a set: somebody else for a second, left for right, lost, anywhere.
    words += ['--outliers', str(arguments.outliers), '--kind', 'mixed']
    return simulate.main(words)


@contextmanager
def _calibrator(output: Path, rig: Path, console: Console) -> Iterator[subprocess.Popen[bytes]]:
    """Run the real node as a process of its own, which does not outlive the block."""
    parameters = {
        'rig_file': rig.resolve(),
        'result_file': (output / RESULT).resolve(),
        'load_on_start': 'false',  # an older demo's result is not this one's
        'auto.enabled': 'false',
    }
    words = [word for name, value in parameters.items() for word in ('-p', f'{name}:={value}')]
    command = [sys.executable, '-m', 'rpgd_ros.apps.calibrator', '--ros-args', *words]
    console.print(f'starting the calibrator in ROS domain {os.environ["ROS_DOMAIN_ID"]}')
    with (output / LOG).open('wb') as log:
        # In a session of its own: Ctrl-C reaches the demo, which then ends the node in order.
        node = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True
        )
        try:
            yield node
        finally:
            _end(node)


def _end(node: subprocess.Popen[bytes]) -> None:
    node.send_signal(signal.SIGINT)
    try:
        node.wait(END_SECONDS)
    except subprocess.TimeoutExpired:
        node.kill()
        node.wait()


def _play(peer: Peer, client: CalibratorClient, folder: Path, bars: Progress, rate: float) -> int:
    """Play the bag to the node and return how many messages got lost."""
    with open_bag(folder / 'bag') as bag:
        topics = Recording(read_rig(folder / 'rig.yaml'), bag, 'the bag').topics
        peer.advertise({name: bag.topics[topic].msgtype for topic, name in topics.items()})
        if not peer.wait_until(lambda: not peer.without_subscriber(), seconds=START_SECONDS):
            silent = ', '.join(peer.without_subscriber())
            msg = f'the calibrator did not subscribe to {silent} within {START_SECONDS:g} s'
            raise InputError(Reason.MISSING_TOPIC, msg)
        total = sum(bag.topics[topic].n_messages for topic in topics)
        title = f'playing {rate:g} times as fast as recorded'
        task = bars.add_task(title, total=1.0, things=(total, 'messages'))
        messages = ((topics[topic], *rest) for topic, *rest in bag.stream(topics))
        sent = peer.play(
            cast('Iterator[Timed]', messages),
            rate=rate,
            on_sent=lambda n: bars.update(task, completed=n / max(1, total)),
        )
    peer.wait_until(lambda: client.received() == sent, seconds=COUNT_SECONDS)
    return sum(sent.values()) - sum(client.received().values())


def _read_truth(path: Path) -> Truth:
    tree = yaml.safe_load(path.read_text())
    points = tree['control_points']
    return Truth(
        RigidTransform.from_matrix(tree['world_T_mocap']['matrix']),
        np.array([point['mocap'] for point in points]),
        np.array([point['world'] for point in points]),
    )


def _report(
    console: Console, answer: dict[str, Any], published: RigidTransform, truth: Truth, *, lost: int
) -> int:
    """Show what was published beside the truth; return the exit code."""
    true = truth.world_T_mocap
    error_deg = float(np.degrees(rotation_angle(published.rotation.T @ true.rotation)))
    error_mm = 1e3 * float(np.linalg.norm(published.translation - true.translation))
    distances = np.linalg.norm(published @ truth.x_mocap - truth.x_world, axis=-1)
    table = Table('world_T_mocap')
    for heading in ('published', 'truth'):
        table.add_column(heading, justify='right')
    for row in zip(COORDINATES, _numbers(published), _numbers(true), strict=True):
        table.add_row(*row)
    console.print(table)
    figures = {
        'rotation error': f'{error_deg:.4f} deg',
        'translation error': f'{error_mm:.2f} mm (of the MoCap origin)',
        "error of the body's points": f'{1e3 * float(distances.mean()):.2f} mm (mean)',
        'uncertainty as published': f'{answer["sigma_rotation_deg"]:.4f} deg, '
        f'{1e3 * answer["sigma_position_m"]:.2f} mm (of the body)',
        'MPJPE': f'{answer["mpjpe_px"]:.2f} px, wrong keypoints included '
        f'(median {answer["median_px"]:.2f} px)',
        'inliers': f'{answer["inlier_ratio"]:.1%} of {answer["correspondences"]} correspondences',
        'time to calibrate': f'{answer["seconds"]:.2f} s',
        'messages lost': str(lost),
    }
    for name, figure in figures.items():
        console.print(f'{name:<27}{figure}')
    is_accurate = error_deg <= MAX_ERROR_DEG and error_mm <= MAX_ERROR_MM
    if not is_accurate:
        console.print(f'the error exceeds {MAX_ERROR_DEG} deg or {MAX_ERROR_MM:g} mm')
    return EXIT_DONE if is_accurate else EXIT_INACCURATE


def _numbers(pose: RigidTransform) -> list[str]:
    angles = np.degrees(euler_zyx_from_rotation(pose.rotation))
    return [f'{v:.4f} m' for v in pose.translation] + [f'{v:.4f} deg' for v in angles]


if __name__ == '__main__':
    sys.exit(main())
