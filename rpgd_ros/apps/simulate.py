# SPDX-License-Identifier: Apache-2.0
"""Writes a simulated recording with known truth: for demos, tests, and planning a rig."""

from __future__ import annotations

import argparse
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from threading import Event
from types import FrameType
from typing import get_args

from rich.console import Console
from rich.progress import Progress, TaskID

from rpgd_ros.apps.outcome_json import json_of
from rpgd_ros.apps.output_folder import check_output, finish, put_in_place, scratch_folder
from rpgd_ros.apps.progress import bar_columns
from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.simulation import PRESETS, Corruption, Faults, build_scene, preset, simulate
from rpgd_ros.simulation.dataset_scenes import TwinPlan
from rpgd_ros.simulation.dataset_writers import write_twin
from rpgd_ros.simulation.detector import OUTLIER_KINDS
from rpgd_ros.simulation.export import BAG, RIG, TRUTH, MocapType, Storage, write_recording
from rpgd_ros.simulation.motion import MOTIONS

EXIT_DONE, EXIT_BAD_INPUT, EXIT_STOPPED = 0, 2, 130
STAGES = ('filming', 'writing')
FILES = (BAG, RIG, TRUTH)

Progression = Callable[[str, float], None]

DESCRIPTION = """\
Simulate a person who walks through a room before calibrated cameras, seen by a MoCap system and by
a keypoint detector per camera, and write what both send:

  DIR/bag         rosbag2 with mocap/skeleton, <camera>/keypoints, <camera>/camera_info
  DIR/rig.yaml    the rig file for the calibrator and for calibrate_bag
  DIR/truth.yaml  the transform that a calibration has to find

With --format dataset, write sequences in the layout of the dataset that the preset is a twin of.
"""
EPILOG = """\
examples:
  simulate --preset studio --output demo
  simulate --preset kinect --output far --seconds 20 --motion sway   # should be refused
  simulate --preset studio --output bad --outliers 0.4 --kind person --lag 0.02
  simulate --preset studio --output blind --no-extrinsics    # of no camera; or name some
  simulate --preset studio --output crowd --persons 3
  simulate --preset aistpp --format dataset --sequences 20 --seconds 13 --output twin
then:
  calibrate_bag demo/bag --rig demo/rig.yaml
  evaluate twin --dataset aistpp
exit codes: 0 written, 2 bad input, 130 stopped (nothing is left behind)
"""


class _StoppedError(Exception):
    """A signal came: the run ends through every clean-up."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit code."""
    arguments = _parser().parse_args(argv)
    console = Console(stderr=True)
    try:
        with _stop_on_signals() as stop:
            _run(arguments, console, stop)
    except InputError as error:
        print(f'simulate: {error.message}', file=sys.stderr)
        if arguments.json:
            print(json_of('bad_input', EXIT_BAD_INPUT, error=error))
        return EXIT_BAD_INPUT
    except _StoppedError:
        print('simulate: stopped, nothing was written', file=sys.stderr)
        return EXIT_STOPPED
    output = arguments.output
    is_dataset = arguments.format == 'dataset'
    if arguments.json:
        files = {'bag': output / BAG, 'rig': output / RIG, 'truth': output / TRUTH}
        print(json_of('written', EXIT_DONE, files={'dataset': output} if is_dataset else files))
    elif is_dataset:
        print(f'{output}\nnext: evaluate {output} --dataset {arguments.preset}')
    else:
        print(f'{output / BAG}\n{output / RIG}\n{output / TRUTH}')
        print(f'next: calibrate_bag {output / BAG} --rig {output / RIG}')
    return EXIT_DONE


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='simulate',
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add('--preset', required=True, choices=list(PRESETS), help='rig, rates, joints and noise')
    add('--output', required=True, type=Path, metavar='DIR', help='folder to write')
    text = 'one recording as a bag, or sequences in the layout of a dataset (default bag)'
    add('--format', choices=('bag', 'dataset'), default='bag', help=text)
    text = 'how many sequences of a dataset (default 4)'
    add('--sequences', type=int, default=4, metavar='N', help=text)
    add('--seconds', type=float, default=60.0, help='length (default 60)')
    add('--seed', type=int, default=0, help='the same seed gives the same bits (default 0)')
    add('--motion', choices=MOTIONS, default='walk', help='what the person does (default walk)')
    add('--storage', choices=get_args(Storage), default='mcap', help='bag format (default mcap)')
    text = 'share of keypoints that are wholly wrong, 0 to 1 (default 0)'
    add('--outliers', type=float, default=0.0, metavar='SHARE', help=text)
    text = 'how: anywhere; left and right swapped; somebody else for a second; a blob; a mixture'
    add('--kind', choices=OUTLIER_KINDS, default='uniform', help=text)
    text = 'how far the joints of MoCap and detector differ, per axis (in reality 0.02 to 0.04)'
    add('--bias', type=float, default=0.0, metavar='METRES', help=text)
    text = 'how late the video is stamped (default 0)'
    add('--lag', type=float, default=0.0, metavar='SECONDS', help=text)
    text = 'how many people are in view, the person with MoCap among them (default 1)'
    add('--persons', type=int, default=1, metavar='N', help=text)
    text = 'how many of them have MoCap (default 1)'
    add('--subjects', type=int, default=1, metavar='N', help=text)
    text = 'message type of the skeletons (default PointCloud2)'
    add('--mocap-type', choices=get_args(MocapType), default='PointCloud2', help=text)
    text = (
        'write the rig file without the extrinsics of these cameras, or of all: the calibration '
        'finds them; truth.yaml has them'
    )
    add('--no-extrinsics', nargs='*', metavar='CAMERA', help=text)
    add('--json', action='store_true', help='print the outcome as JSON, for programs')
    add('--force', action='store_true', help='replace DIR if it is an older recording')
    return parser


def _run(arguments: argparse.Namespace, console: Console, stop: Event) -> None:
    output: Path = arguments.output
    check_output(output, FILES, is_forced=arguments.force)
    if arguments.seed < 0:
        msg = f'--seed must be 0 or more, got {arguments.seed}'
        raise InputError(Reason.BAD_INPUT, msg)
    faults = Faults(
        Corruption(arguments.outliers, arguments.kind),
        bias_m=arguments.bias,
        lag_s=arguments.lag,
    )
    with scratch_folder(output) as scratch, _bars(console, stop) as progress:
        if arguments.format == 'dataset':
            finished = _film_dataset(arguments, faults, scratch, progress)
        else:
            finished = _film_bag(arguments, faults, scratch, progress)
        put_in_place(finished, output)


def _film_bag(
    arguments: argparse.Namespace, faults: Faults, scratch: Path, progress: Progression
) -> Path:
    """Write one recording and return its folder."""
    scene = build_scene(
        preset(arguments.preset),
        arguments.seed,
        seconds=arguments.seconds,
        motion=arguments.motion,
        faults=faults,
        persons=arguments.persons,
        subjects=arguments.subjects,
    )
    blind = _blind(arguments.no_extrinsics, [camera.name for camera in scene.cameras])
    recording = simulate(scene, progress=progress)
    write_recording(
        recording,
        scratch,
        storage=arguments.storage,
        mocap_type=arguments.mocap_type,
        blind=blind,
        progress=progress,
    )
    return finish(scratch, FILES)


def _blind(wanted: Sequence[str] | None, names: Sequence[str]) -> Sequence[str]:
    """Return the cameras of which the rig file gives no extrinsics."""
    for name in wanted or ():
        if name not in names:
            msg = f'no camera {name[:80]!r} to leave out; the rig has {", ".join(names)}'
            raise InputError(Reason.UNKNOWN_CAMERA, msg)
    return () if wanted is None else wanted or names


def _film_dataset(
    arguments: argparse.Namespace, faults: Faults, scratch: Path, progress: Progression
) -> Path:
    """Write a tree of sequences and return its folder."""
    if arguments.force:
        msg = '--force replaces recordings, never datasets: choose another name'
        raise InputError(Reason.NOT_WRITABLE, msg)
    if arguments.no_extrinsics is not None:
        msg = '--no-extrinsics is for rig files: a dataset has its own layout'
        raise InputError(Reason.BAD_INPUT, msg)
    if (arguments.persons, arguments.subjects) != (1, 1):
        msg = '--persons and --subjects are for bags: a dataset has one person'
        raise InputError(Reason.BAD_INPUT, msg)
    if arguments.sequences < 1:
        msg = f'--sequences must be 1 or more, got {arguments.sequences}'
        raise InputError(Reason.BAD_INPUT, msg)
    plan = TwinPlan(
        preset(arguments.preset),
        arguments.sequences,
        arguments.seconds,
        arguments.seed,
        arguments.motion,
        faults,
    )
    finished = finish(scratch, ())
    write_twin(plan, finished, progress)
    progress('writing', 1.0)
    return finished


@contextmanager
def _bars(console: Console, stop: Event) -> Iterator[Progression]:
    """Show one bar per stage, and end the run at the next step after a signal."""
    with Progress(*bar_columns(), console=console) as progress:
        tasks: dict[str, TaskID] = {s: progress.add_task(s, total=1.0) for s in STAGES}

        def tell(stage: str, fraction: float) -> None:
            if stop.is_set():
                raise _StoppedError
            progress.update(tasks[stage], completed=fraction)

        yield tell


@contextmanager
def _stop_on_signals() -> Iterator[Event]:
    """Note SIGINT and SIGTERM in an event.

    An exception out of the handler would be lost where Python ignores exceptions (destructors),
    and would cut clean-ups that run at that moment.
    """
    stop = Event()

    def note(_number: int, _frame: FrameType | None) -> None:
        stop.set()

    before = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


if __name__ == '__main__':
    sys.exit(main())
