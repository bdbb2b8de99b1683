# SPDX-License-Identifier: Apache-2.0
"""Calibrates from a recording, without ROS."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from threading import Event

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from rpgd_ros.apps.stopping import EXIT_STOPPED, Stopped, stop_on_signals
from rpgd_ros.apps.tables import print_calibration, print_streams
from rpgd_ros.core.errors import InputError, Reason, RpgdError
from rpgd_ros.io.recording import Recording, open_recording
from rpgd_ros.io.result_file import write_result
from rpgd_ros.io.rig import Rig, read_rig
from rpgd_ros.pairing import BufferConfig
from rpgd_ros.session import Session, SessionConfig, replay, solve

EXIT_ACCEPTED, EXIT_REFUSED, EXIT_BAD_INPUT, EXIT_PARTIAL, EXIT_BUG = 0, 1, 2, 3, 70

# What a solve finds missing although it was never there: bad input, not a bad result.
INPUT_REASONS = frozenset({
    Reason.NO_DATA, Reason.MISSING_INTRINSICS, Reason.NO_EXTRINSICS, Reason.BAD_RIG,
})  # fmt: skip
# A recording is finite: all of it is kept, up to a day.
WHOLE_RECORDING_S = 86_400.0
UNNAMED_MOCAP_FRAME = 'mocap'  # where neither the rig file nor the messages name one

DESCRIPTION = """\
Find the transform from the MoCap frame to the world from a recording (rosbag2) of a person who
walks through the room, as the live calibrator does. ROS need not be installed.
"""
EPILOG = """\
The bag needs the topics that the rig file names: the skeletons and the keypoints of each camera,
as sensor_msgs/PointCloud2 or geometry_msgs/PoseArray.

examples:
  calibrate_bag walk/ --rig rig.yaml                       # mcap or sqlite3, Humble to Jazzy
  calibrate_bag walk/walk_0.mcap --rig rig.yaml --output result.yaml
  calibrate_bag walk/ --rig rig.yaml --cameras cam0 cam2   # leave the others out
exit codes:
  0   accepted
  1   refused: the data do not give a transform that anybody should use; the reason is named
  2   bad input: rig file, bag, topics or messages cannot be used
  3   accepted, but from a part of the recording: the bag is damaged
  130 stopped; nothing is left behind
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit code."""
    arguments = _parser().parse_args(argv)
    try:
        with stop_on_signals() as stop:
            return _run(arguments, Console(), Console(stderr=True), stop)
    except RpgdError as error:
        is_input = isinstance(error, InputError) or error.reason in INPUT_REASONS
        verdict = 'bad input' if is_input else 'refused'
        print(f'calibrate_bag: {verdict} ({error.reason}): {error.message}', file=sys.stderr)
        return EXIT_BAD_INPUT if is_input else EXIT_REFUSED
    except Stopped:
        print('calibrate_bag: stopped, nothing was written', file=sys.stderr)
        return EXIT_STOPPED
    except Exception:
        Console(stderr=True).print_exception()
        print('calibrate_bag: this should not happen, please report it', file=sys.stderr)
        return EXIT_BUG


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='calibrate_bag',
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add('bag', type=Path, metavar='BAG', help='folder of a rosbag2, or its .mcap or .db3 file')
    add('--rig', required=True, type=Path, metavar='RIG.yaml', help='cameras, joints and topics')
    text = 'write an accepted result here; an older file is kept beside it, with its date'
    add('--output', type=Path, metavar='RESULT.yaml', help=text)
    text = 'use these cameras of the rig only'
    add('--cameras', nargs='+', default=[], metavar='NAME', help=text)
    return parser


def _run(arguments: argparse.Namespace, out: Console, err: Console, stop: Event) -> int:
    output: Path | None = arguments.output
    if output and not output.parent.is_dir():
        msg = f'{output.parent} is no folder: create it first'
        raise InputError(Reason.NOT_WRITABLE, msg)
    rig = _chosen(read_rig(arguments.rig), arguments.cameras)
    with open_recording(arguments.bag, rig) as recording, _bar(err, stop) as progress:
        for warning in recording.warnings:
            _tell(err, f'warning: {warning}')
        session = Session(rig, _config(recording))
        replay(
            recording, session, progress=progress, tell=lambda said: _tell(err, f'warning: {said}')
        )
        problem = recording.source.problem
    print_streams(out, session)
    if problem:
        _tell(err, f'partial data: {problem}')
    with _bar(err, stop) as progress:
        calibration = solve(session.snapshot(), progress=progress)
    if problem:
        warnings = (*calibration.warnings, f'found from partial data: {problem}')
        calibration = replace(calibration, warnings=warnings)
    frames = rig.world_frame, session.mocap_frame or UNNAMED_MOCAP_FRAME
    print_calibration(out, calibration, *frames)
    if output:
        write_result(
            output,
            calibration,
            world_frame=frames[0],
            mocap_frame=frames[1],
            stamp_ns=time.time_ns(),
        )
        _tell(out, f'written to {output}')
    return EXIT_PARTIAL if problem else EXIT_ACCEPTED


def _tell(console: Console, sentence: str) -> None:
    """Print a sentence with foreign words in it as it is."""
    console.print(sentence, markup=False, highlight=False, soft_wrap=True)


def _chosen(rig: Rig, names: Sequence[str]) -> Rig:
    """Return the rig with the cameras that were asked for."""
    known = [camera.name for camera in rig.cameras]
    unknown = [name for name in names if name not in known]
    if unknown:
        msg = f'no camera {unknown[0][:80]!r} in the rig file; it has {", ".join(known)}'
        raise InputError(Reason.UNKNOWN_CAMERA, msg)
    if not names:
        return rig
    return replace(rig, cameras=tuple(c for c in rig.cameras if c.name in names))


def _config(recording: Recording) -> SessionConfig:
    n_frames = max(recording.n_messages, BufferConfig().max_frames)
    return SessionConfig(buffer=BufferConfig(max_frames=n_frames, max_age_s=WHOLE_RECORDING_S))


@contextmanager
def _bar(console: Console, stop: Event) -> Iterator[Callable[[str, float], None]]:
    """Show one bar, named after the stage that reports; end the run after a signal."""
    columns = (TextColumn('{task.description:>12}'), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task('', total=1.0)

        def tell(stage: str, share: float) -> None:
            if stop.is_set():
                raise Stopped
            progress.update(task, description=stage, completed=share)

        yield tell


if __name__ == '__main__':
    sys.exit(main())
