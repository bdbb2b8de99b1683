# SPDX-License-Identifier: Apache-2.0
"""Calibrates from a recording, without ROS."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from threading import Event

from rpgd_ros.apps.bag_check import (
    check_arguments,
    check_bag,
    check_tree,
    print_check,
    read_accepted,
)
from rpgd_ros.apps.bag_job import Outputs, Written
from rpgd_ros.apps.bag_json import bag_json
from rpgd_ros.apps.bag_outputs import tell_written, write_outputs
from rpgd_ros.apps.bag_places import check_outputs
from rpgd_ros.apps.bag_run import BagRun, read_bag, solve_bag, tell
from rpgd_ros.apps.bag_setup import read_setup, rig_file_of
from rpgd_ros.apps.progress import one_bar
from rpgd_ros.apps.stopping import EXIT_STOPPED, Stopped, stop_on_signals
from rpgd_ros.apps.tables import print_calibration, print_streams
from rpgd_ros.apps.terminal import CannotPrintError, Terminal, give_up_printing, terminals
from rpgd_ros.core.errors import InputError, Reason, RpgdError

EXIT_ACCEPTED, EXIT_REFUSED, EXIT_BAD_INPUT, EXIT_PARTIAL, EXIT_BUG = 0, 1, 2, 3, 70

# What a solve finds missing although it was never there: bad input, not a bad result.
INPUT_REASONS = frozenset({
    Reason.NO_DATA, Reason.MISSING_INTRINSICS, Reason.NO_EXTRINSICS, Reason.BAD_RIG,
})  # fmt: skip

DESCRIPTION = """\
Find the transform from the MoCap frame to the world from a recording (rosbag2) of a person who
walks through the room, as the live calibrator does. ROS need not be installed.
"""
EPILOG = """\
The bag needs the topics that the rig file names: the skeletons and the keypoints of each camera,
as sensor_msgs/PointCloud2, geometry_msgs/PoseArray, or as drivers and detectors send them: see
docs/inputs.md.

examples:
  calibrate_bag walk/ --rig rig.yaml                       # mcap or sqlite3, Humble to Jazzy
  calibrate_bag walk/walk_0.mcap --rig rig.yaml --output result.yaml
  calibrate_bag walk/ --rig rig.yaml --report report.html  # look before you trust
  calibrate_bag walk/ --rig rig.yaml --write-rig found.yaml   # cameras without extrinsics
  calibrate_bag walk/ --rig rig.yaml --cameras cam0 cam2   # leave the others out
  calibrate_bag walk/ --rig rig.yaml --params calibrator.yaml   # with the node's settings
  calibrate_bag today/ --rig rig.yaml --check result.yaml  # does yesterday's result still fit?
exit codes:
  0   accepted; with --check: it still fits
  1   refused: the data do not give a transform that anybody should use; the reason is named.
      With --check: it does not fit any more; what was moved is named
  2   bad input: rig file, bag, topics or messages cannot be used
  3   accepted, but from a part of the recording: the bag is damaged
  74  the output cannot be printed: a pipe that nobody reads, a full disk; what was written
      before is named
  130 stopped; no file is left half-written, and what was written before is named
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit code."""
    arguments = _parser().parse_args(argv)
    out, err = terminals()
    outputs = Outputs()
    try:
        return _outcome(arguments, out, err, outputs)
    except CannotPrintError as error:
        said = f'cannot print any more: {error}; {outputs.sentence()}'
        return give_up_printing(f'calibrate_bag: {said}')
    except Exception:
        with suppress(CannotPrintError):
            err.print_exception()
            tell(err, 'calibrate_bag: this should not happen, please report it')
        return EXIT_BUG


def _outcome(arguments: argparse.Namespace, out: Terminal, err: Terminal, outputs: Outputs) -> int:
    """Run, and say how it ended; returns the exit code."""
    try:
        with stop_on_signals() as stop:
            return _run(arguments, out, err, outputs, stop)
    except RpgdError as error:
        if not arguments.json:
            tell_written(out, outputs.written)
        return _refuse(arguments, out, err, error, written=outputs.written)
    except Stopped:
        tell(err, f'calibrate_bag: stopped, {outputs.sentence()}')
        return EXIT_STOPPED


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='calibrate_bag',
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add('bag', type=Path, metavar='BAG', help='folder of a rosbag2, or its .mcap or .db3 file')
    text = 'cameras, joints and topics (or rig_file in the parameter file)'
    add('--rig', type=Path, metavar='RIG.yaml', help=text)
    text = (
        'parameter file of the node, as config/calibrator.yaml: the same settings as live. Whole '
        'recordings are kept whatever buffer.* says'
    )
    add('--params', type=Path, metavar='CALIBRATOR.yaml', help=text)
    text = (
        'solve nothing: compare the recording with this accepted result, name the cameras that no '
        'longer fit it'
    )
    add('--check', type=Path, metavar='RESULT.yaml', help=text)
    text = 'write an accepted result here; an older file is kept beside it, with its date'
    add('--output', type=Path, metavar='RESULT.yaml', help=text)
    text = (
        'write a page about the run here, accepted or refused: one HTML file that needs no '
        "network (pip install 'rpgd_ros[report]')"
    )
    add('--report', type=Path, metavar='REPORT.html', help=text)
    text = (
        "write the joints in the cameras' frames (.npz) and their pixels (COCO .json) here, of an "
        'accepted result'
    )
    add('--export', type=Path, metavar='DIR', help=text)
    text = (
        'write the rig with the extrinsics that were found here: a rig file (.yaml), or the '
        'cameras in the MoCap frame for aniposelib and Pose2Sim (.toml)'
    )
    add('--write-rig', type=Path, metavar='RIG.yaml|.toml', help=text)
    text = (
        'draw keypoints and reprojected skeleton over the images of the bag, or over empty '
        'canvases: pictures into a folder, or a film of all cameras (.mp4, .avi, .mkv)'
    )
    add('--overlay', type=Path, metavar='DIR|FILE', help=text)
    text = (
        'copy the recording with transform, skeleton in the world and reprojections in it, for '
        'Foxglove and RViz, of an accepted result'
    )
    add('--annotated', type=Path, metavar='OUT.mcap', help=text)
    text = (
        'image topic of a camera, where its name does not tell (default: found beside the others)'
    )
    add('--images', nargs='+', default=[], metavar='CAMERA=TOPIC', help=text)
    text = 'print the outcome as JSON, for programs; its keys stand in docs/report.md'
    add('--json', action='store_true', help=text)
    text = 'use these cameras of the rig only'
    add('--cameras', nargs='+', default=[], metavar='NAME', help=text)
    return parser


def _run(
    arguments: argparse.Namespace, out: Terminal, err: Terminal, outputs: Outputs, stop: Event
) -> int:
    if arguments.check:
        return _check(arguments, out, err, stop)
    rig_file = rig_file_of(arguments.rig, arguments.params)
    check_outputs(arguments, rig_file)
    rig, settings = read_setup(rig_file, arguments.params, arguments.cameras)
    run = read_bag(arguments.bag, rig, err, stop, settings)
    if not arguments.json:
        print_streams(out, run.streams)
    with one_bar(err, stop) as progress:
        run = solve_bag(run, progress)
    calibration, refusal = run.calibration, run.refusal
    if calibration is not None and refusal is None and not arguments.json:
        print_calibration(out, calibration, *run.frames)
    write_outputs(run, arguments, outputs, err, stop)
    if not arguments.json:
        tell_written(out, outputs.written)
    if refusal is not None:
        return _refuse(arguments, out, err, refusal, run=run, written=outputs.written)
    code = EXIT_PARTIAL if run.problem else EXIT_ACCEPTED
    if arguments.json:
        status = 'partial' if run.problem else 'accepted'
        out.write(bag_json(status, code, message=run.problem, run=run, written=outputs.written))
    return code


def _check(arguments: argparse.Namespace, out: Terminal, err: Terminal, stop: Event) -> int:
    check_arguments(arguments)
    rig_file = rig_file_of(arguments.rig, arguments.params)
    rig, settings = read_setup(rig_file, arguments.params, arguments.cameras)
    stored = read_accepted(arguments, rig.world_frame)
    run = read_bag(arguments.bag, rig, err, stop, settings)
    if not arguments.json:
        print_streams(out, run.streams)
    found = check_bag(run, stored, err)
    code, status = EXIT_REFUSED, 'does_not_fit'
    if found.fits:
        code, status = (EXIT_PARTIAL, 'partial') if run.problem else (EXIT_ACCEPTED, 'fits')
    if arguments.json:
        message = '; '.join(filter(None, [found.complaint, run.problem]))
        tree = check_tree(found, stored)
        out.write(bag_json(status, code, message=message, run=run, check=tree))
    else:
        print_check(out, found, stored)
    return code


def _refuse(
    arguments: argparse.Namespace,
    out: Terminal,
    err: Terminal,
    error: RpgdError,
    *,
    run: BagRun | None = None,
    written: Sequence[Written],
) -> int:
    """Say why there is no result, to people and programs; returns the exit code."""
    is_input = isinstance(error, InputError) or error.reason in INPUT_REASONS
    verdict = 'bad input' if is_input else 'refused'
    code = EXIT_BAD_INPUT if is_input else EXIT_REFUSED
    tell(err, f'calibrate_bag: {verdict} ({error.reason}): {error.message}')
    if arguments.json:
        status = verdict.replace(' ', '_')
        out.write(bag_json(status, code, error=error, run=run, written=written))
    return code


if __name__ == '__main__':
    sys.exit(main())
