# SPDX-License-Identifier: Apache-2.0
"""Measures what the live node keeps up with, beside bare rclpy, in one run."""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Column, Table

from rpgd_ros.apps.calibrator import BLAS_THREADS
from rpgd_ros.io.bag import BagWriter, open_bag
from rpgd_ros.io.rig import write_rig
from rpgd_ros.messages import CAMERA_INFO, POINT_CLOUD2, POSE_ARRAY, encode_pose_array
from rpgd_ros.ros.domain import free_domain
from rpgd_ros.simulation import SimulatedRecording, build_scene, preset, simulate
from rpgd_ros.simulation.export import Message, messages_of, rig_of

MOCAP_HZ, CAMERA_HZ = 240.0, 60.0
RATES = (1000, 2000, 3000, 4000, 5000, 6000, 8000)  # messages per second of the search
SEARCH_SECONDS = 10.0  # at most
CALIBRATE_EVERY_S = 5.0

DESCRIPTION = """\
Play 240 Hz of skeletons and 14 x 60 Hz of keypoints (1080 messages per second) over DDS to the
live node, which calibrates every 5 s meanwhile, and to a node that takes the same messages with
bare rclpy and does nothing with them. Then look for the highest rate of PoseArrays that each takes
without a loss, without calibrations. Every taker is a process of its own, with queues of equal
depth; publisher and taker share this machine.
"""


@dataclass(frozen=True)
class Trial:
    """One taker under one load.

    Attributes:
        taker: Who took the messages.
        load: What was sent.
        sent: Messages published.
        seconds: Time that the publisher took.
        figures: Of the taker.

    """

    taker: str
    load: str
    sent: int
    seconds: float
    figures: Mapping[str, float]

    @property
    def lost(self) -> int:
        """Messages that were published and not taken."""
        return self.sent - int(self.figures['received'])

    @property
    def rate(self) -> float:
        """Messages published per second."""
        return self.sent / self.seconds if self.seconds else 0.0


def main(argv: Sequence[str] | None = None) -> int:
    """Run the benchmark, or one of its processes."""
    arguments = _parser().parse_args(argv)
    if arguments.role:
        print(json.dumps(_play_role(arguments.role, arguments.rest)))
        return 0
    console = Console()
    with tempfile.TemporaryDirectory(prefix='bench_live_') as folder:
        trials = list(_trials(Path(folder), arguments.seconds, arguments.rates, console))
    _report(console, trials)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog='make bench-live', description=DESCRIPTION)
    text = 'length of the trials with calibrations; of the search at most 10 (default 60)'
    parser.add_argument('--seconds', type=float, default=60.0, metavar='S', help=text)
    text = 'messages per second of the search, in rising order'
    parser.add_argument('--rates', type=int, nargs='*', default=RATES, metavar='N', help=text)
    parser.add_argument('--role', choices=('node', 'rclpy', 'player'), help=argparse.SUPPRESS)
    parser.add_argument('rest', nargs='*', help=argparse.SUPPRESS)
    return parser


def _play_role(role: str, rest: Sequence[str]) -> Mapping[str, float]:
    from rpgd_ros.ros import load  # noqa: PLC0415 - only the processes of the benchmark need ROS

    if role == 'player':
        return load.play(Path(rest[0]), rate=float(rest[1]), n_messages=int(rest[2]))
    if role == 'rclpy':
        return load.take_with_rclpy(json.loads(rest[0]))
    given = (word for parameter in rest for word in ('-p', parameter))
    return load.take_with_node(['--ros-args', *given])


def _trials(
    folder: Path, seconds: float, rates: Sequence[int], console: Console
) -> Iterator[Trial]:
    console.print('simulating the studio ...')
    scene = replace(preset('mpi_inf_3dhp'), mocap_hz=MOCAP_HZ, camera_hz=CAMERA_HZ)
    recording = simulate(build_scene(scene, 0, seconds=seconds))
    write_rig(folder / 'rig.yaml', rig_of(recording))
    bags = {
        'PointCloud2': _write(folder / 'clouds', messages_of(recording)),
        'PoseArray': _write(folder / 'poses', _as_poses(recording)),
    }
    auto = ('auto.enabled:=true', f'auto.period_s:={CALIBRATE_EVERY_S}', 'buffer.min_motion:=0.0')
    for load, bag in bags.items():
        for taker in ('node', 'rclpy'):
            yield _shown(console, _trial(folder, taker, load, bag, parameters=auto))
    usual = _rate_of(bags['PoseArray'])
    for taker in ('node', 'rclpy'):
        for rate in rates:
            found = _trial(
                folder,
                taker,
                f'PoseArray, {rate}/s',
                bags['PoseArray'],
                rate=rate / usual,
                n_messages=round(rate * min(SEARCH_SECONDS, seconds)),
                parameters=('auto.enabled:=false',),
            )
            yield _shown(console, found)
            if found.lost:
                break


def _trial(
    folder: Path,
    taker: str,
    load: str,
    bag: Path,
    *,
    rate: float = 1.0,
    n_messages: int = sys.maxsize,
    parameters: Sequence[str],
) -> Trial:
    """Start a taker and a player, wait for the player, and ask the taker for its figures."""
    environment = {
        BLAS_THREADS: '1',
        **os.environ,
        'ROS_DOMAIN_ID': str(free_domain()),
        'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
    }
    rest = [
        f'rig_file:={folder / "rig.yaml"}',
        f'result_file:={folder / "result.yaml"}',
        'tf_mode:=none',
        'load_on_start:=false',
        *parameters,
    ]
    if taker == 'rclpy':
        with open_bag(bag) as opened:
            rest = [json.dumps({t: info.msgtype for t, info in opened.topics.items()})]
    with (
        _start('player', [str(bag), str(rate), str(n_messages)], environment) as player,
        _start(taker, rest, environment) as taking,
    ):
        played = _answer(player)
        taking.send_signal(signal.SIGTERM)
        figures = _answer(taking)
    return Trial(taker, load, int(played['sent']), played['seconds'], figures)


def _start(
    role: str, rest: Sequence[str], environment: Mapping[str, str]
) -> subprocess.Popen[str]:
    command = [sys.executable, '-m', 'rpgd_ros.apps.bench_live', '--role', role, '--', *rest]
    return subprocess.Popen(command, env=dict(environment), stdout=subprocess.PIPE, text=True)


def _answer(process: subprocess.Popen[str]) -> dict[str, Any]:
    out, _ = process.communicate()
    found: dict[str, Any] = json.loads(out.strip().splitlines()[-1])
    return found


def _write(path: Path, messages: Iterator[Message]) -> Path:
    with BagWriter(path) as writer:
        for message in messages:
            if message.msgtype != CAMERA_INFO:
                writer.write(f'/{message.topic}', *message[1:])
    return path


def _as_poses(recording: SimulatedRecording) -> Iterator[Message]:
    """Yield the recording with every skeleton and every detection as a PoseArray."""
    rows = {camera.name: 0 for camera in recording.cameras}
    streams = dict(zip(rows, recording.streams, strict=True))
    sent = {name: np.flatnonzero(stream.is_sent) for name, stream in streams.items()}
    for message in messages_of(recording, 'PoseArray'):
        name = message.topic.partition('/')[0]
        if message.msgtype == POINT_CLOUD2:
            stream, row = streams[name], sent[name][rows[name]]
            rows[name] += 1
            xyz = np.pad(stream.uv[row], ((0, 0), (0, 1)))
            payload = encode_pose_array(int(stream.stamp_ns[row]), name, xyz)
            yield message._replace(msgtype=POSE_ARRAY, payload=payload)
        else:
            yield message


def _rate_of(bag: Path) -> float:
    with open_bag(bag) as opened:
        times = [at for _, at, _ in opened.stream(opened.topics)]
    return len(times) / ((times[-1] - times[0]) * 1e-9)


def _shown(console: Console, trial: Trial) -> Trial:
    console.print(
        f'{trial.taker:>6}, {trial.load}: {trial.lost} of {trial.sent} lost at {trial.rate:.0f}/s'
    )
    return trial


def _report(console: Console, trials: Sequence[Trial]) -> None:
    table = Table('taker', Column('load', no_wrap=True))
    for heading in ('msg/s', 'sent', 'lost', 'p50 ms', 'p99 ms', 'max ms', 'cores'):
        table.add_column(heading, justify='right')
    for trial in trials:
        f = trial.figures
        table.add_row(
            trial.taker,
            trial.load,
            f'{trial.rate:.0f}',
            str(trial.sent),
            str(trial.lost),
            *(f'{f[key]:.2f}' for key in ('p50_ms', 'p99_ms', 'max_ms', 'cpu')),
        )
    console.print(table)
    for taker in ('node', 'rclpy'):
        best = max((t.rate for t in trials if t.taker == taker and not t.lost), default=0.0)
        console.print(f'{taker}: up to {best:.0f} messages per second, none lost')


if __name__ == '__main__':
    sys.exit(main())
