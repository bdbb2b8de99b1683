# SPDX-License-Identifier: Apache-2.0
"""Makes a recording of the files of a shoot: skeletons, keypoints and a camera calibration."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from threading import Event
from typing import get_args

from rich.console import Console
from rich.progress import Progress, TaskID

from rpgd_ros.apps.import_clock import read_clock
from rpgd_ros.apps.import_inputs import Inputs, parse_inputs
from rpgd_ros.apps.import_json import plan_tree
from rpgd_ros.apps.import_tables import print_plan
from rpgd_ros.apps.outcome_json import json_of
from rpgd_ros.apps.output_folder import check_output, finish, put_in_place, scratch_folder
from rpgd_ros.apps.progress import bar_columns
from rpgd_ros.apps.stopping import EXIT_STOPPED, Stopped, stop_on_signals
from rpgd_ros.core.errors import InputError
from rpgd_ros.importing import (
    AXES,
    BAG,
    RIG,
    TIMECODE_RATES,
    Plan,
    check_plan,
    check_scale,
    plan_camera,
    read_keypoints,
    read_skeleton,
    settle,
    write_plan,
)
from rpgd_ros.io.bag_writer import Storage
from rpgd_ros.io.camera_files import TOML
from rpgd_ros.io.rig import METRES_PER

EXIT_DONE, EXIT_BAD_INPUT, EXIT_BUG = 0, 2, 70
FILES = (BAG, RIG)

DESCRIPTION = """\
Make a recording of the files of a shoot, for calibrate_bag and for replay:

  --skeleton    TRC, BVH, C3D (pip install 'rpgd_ros[import]') or CSV, whose columns are time (s)
                or frame, then three for each joint: left_hip.x, left_hip.y, left_hip.z; lines
                such as # units: mm and # fps: 100 may stand before
  --keypoints   OpenPose, COCO, MMPose or AlphaPose JSON: a folder with one file per frame, or a
                file for a whole video, for each camera; or a folder of such (Pose2Sim's pose/)
  --cameras     ROS camera_info, Kalibr camchain, aniposelib/Pose2Sim TOML, Qualisys .qca.txt,
                OpenCV YAML or XML, or a rig file; several files for several cameras

  DIR/bag       rosbag2 with mocap/skeleton and <camera>/keypoints
  DIR/rig.yaml  the rig file

Units, rates and joints are those that the files state, or those given here; what neither says is
asked for. Of several people in a frame, the one with the most and surest keypoints is taken.
"""
EPILOG = """\
examples:
  import_recording --skeleton walk.trc --keypoints pose/ --cameras Calib.toml --camera-fps 60
      --keypoint-joints halpe26 --output shoot --dry-run      # what was understood
  import_recording --skeleton kinect.bvh --units cm --keypoints video.json --cameras camera.yml
      --camera-fps 30 --output kinect                         # one camera: it is the world
  import_recording --skeleton a.c3d --keypoints left=l/ right=r/ --cameras camchain.yaml
      --camera-fps left=50 right=25 --camera-start 2.5 --keypoint-joints coco17 --output out
then:
  calibrate_bag shoot/bag --rig shoot/rig.yaml
exit codes: 0 written (or, with --dry-run, understood), 2 bad input, 130 stopped (nothing is left)
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit code."""
    arguments = _parser().parse_args(argv)
    try:
        with stop_on_signals() as stop:
            return _run(arguments, Console(stderr=True), stop)
    except InputError as error:
        print(f'import_recording: {error.message}', file=sys.stderr)
        if arguments.json:
            print(json_of('bad_input', EXIT_BAD_INPUT, error=error))
        return EXIT_BAD_INPUT
    except Stopped:
        print('import_recording: stopped, nothing was written', file=sys.stderr)
        return EXIT_STOPPED
    except Exception:
        Console(stderr=True).print_exception()
        print('import_recording: this should not happen, please report it', file=sys.stderr)
        return EXIT_BUG


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='import_recording',
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add('--skeleton', required=True, type=Path, metavar='FILE', help='skeletons of the MoCap')
    text = "keypoints, for each camera or in one folder that holds every camera's"
    add('--keypoints', required=True, nargs='+', metavar='[CAMERA=]PATH', help=text)
    add('--cameras', required=True, nargs='+', type=Path, metavar='FILE', help='calibration')
    add('--output', required=True, type=Path, metavar='DIR', help='folder to write')
    text = 'of the skeleton, where its file states none, or a wrong one'
    add('--units', choices=list(METRES_PER), help=text)
    text = 'axis of the skeleton that points up, to be turned to z (default: keep the axes)'
    add('--up', choices=AXES, help=text)
    text = 'rate of the skeleton, where its file states none, or a wrong one'
    add('--mocap-fps', type=float, metavar='HZ', help=text)
    text = 'rate of the videos, of all or by camera'
    add('--camera-fps', required=True, nargs='+', metavar='[CAMERA=]HZ', help=text)
    text = "time of the skeleton's file at the first frame of a video"
    add('--camera-start', nargs='+', default=[], metavar='[CAMERA=]SECONDS', help=text)
    text = 'number of that frame, 0 or 1 (default 1 where the lowest is 1, else 0)'
    add('--first-frame', nargs='+', default=[], metavar='[CAMERA=]NUMBER', help=text)
    text = "SMPTE timecode of a video's first frame; ;FF where frame numbers are dropped"
    add('--camera-timecode', nargs='+', default=[], metavar='[CAMERA=]HH:MM:SS:FF', help=text)
    text = "of the first frame in the skeleton's file, where the file states none, or a wrong one"
    add('--mocap-timecode', metavar='HH:MM:SS:FF', help=text)
    text = 'rate of the timecodes; for videos of 50 Hz and more it may be half of theirs'
    add('--timecode-fps', choices=list(TIMECODE_RATES), help=text)
    text = 'coco17, body25, body25b, halpe26 ..., or names between commas'
    add('--keypoint-joints', metavar='NAMES', help=text)
    text = 'of the keypoints: pixels, or shares of width and height (default pixels)'
    add('--keypoint-units', choices=('pixels', 'normalized'), default='pixels', help=text)
    text = (
        'which joint of the skeleton a keypoint is, where the names do not tell; none: leave out'
    )
    add('--joint-map', nargs='+', default=[], metavar='KEYPOINT=JOINT', help=text)
    text = 'keypoints with a lower score are missing (default 0)'
    add('--min-score', type=float, default=0.0, metavar='SCORE', help=text)
    text = 'of positions in a calibration that states none (TOML; default m)'
    add('--camera-units', choices=list(METRES_PER), help=text)
    text = 'name of the frame of the calibration (default world)'
    add('--world-frame', default='world', metavar='NAME', help=text)
    add('--storage', choices=get_args(Storage), default='mcap', help='bag format (default mcap)')
    add('--dry-run', action='store_true', help='say what was understood, and write nothing')
    add('--json', action='store_true', help='print the outcome as JSON, for programs')
    add('--force', action='store_true', help='replace DIR if it is an older recording')
    return parser


def _run(arguments: argparse.Namespace, console: Console, stop: Event) -> int:
    output: Path = arguments.output
    inputs = parse_inputs(arguments)
    if not arguments.dry_run:
        check_output(output, FILES, is_forced=arguments.force)
    with _bars(console, stop) as progress:
        plan = _read(inputs, progress)
    if not arguments.json:
        print_plan(Console(), plan, inputs)
    if arguments.dry_run:
        if arguments.json:
            print(json_of('understood', EXIT_DONE, **plan_tree(plan, inputs)))
        return EXIT_DONE
    with scratch_folder(output) as scratch, _bars(console, stop) as progress:
        write_plan(
            plan,
            scratch,
            storage=arguments.storage,
            progress=lambda share: progress('writing', share),
        )
        put_in_place(finish(scratch, FILES), output)
    if arguments.json:
        files = {'bag': output / BAG, 'rig': output / RIG}
        print(json_of('written', EXIT_DONE, files=files, **plan_tree(plan, inputs)))
        return EXIT_DONE
    print(f'{output / BAG}\n{output / RIG}')
    print(f'next: calibrate_bag {output / BAG} --rig {output / RIG}')
    return EXIT_DONE


def _read(inputs: Inputs, progress: Callable[[str, float], None]) -> Plan:
    """Read everything that was named."""
    options = inputs.arguments
    progress('skeleton', 0.0)
    file = read_skeleton(options.skeleton, options.mocap_fps)
    skeleton = settle(file, units=options.units, up=options.up, fps=options.mocap_fps)
    progress('skeleton', 1.0)
    clock = read_clock(inputs, skeleton)
    plans = []
    for camera in inputs.with_keypoints:

        def tell(share: float, stage: str = camera.name) -> None:
            progress(stage, share)

        path = inputs.paths[camera.name]
        detections = read_keypoints(path, min_score=options.min_score, progress=tell)
        tell(1.0)
        plans.append(
            plan_camera(
                skeleton,
                camera,
                detections,
                joints=inputs.joints,
                fps=inputs.fps[camera.name],
                start_s=clock.start_s.get(camera.name),
                first_frame=inputs.first_frame.get(camera.name),
                joint_map=inputs.joint_map,
                units=options.keypoint_units,
            )
        )
    plan = Plan(skeleton, tuple(plans), options.world_frame, clock.timecode, clock.warnings)
    check_plan(plan)
    files = ', '.join(str(path) for path in options.cameras)
    check_scale(plan, files, options.camera_units, has_own=TOML not in inputs.formats)
    return plan


@contextmanager
def _bars(console: Console, stop: Event) -> Iterator[Callable[[str, float], None]]:
    """Show one bar per stage, from its first report on; end the run after a signal."""
    tasks: dict[str, TaskID] = {}
    with Progress(*bar_columns(), console=console, transient=True) as bars:

        def tell(stage: str, share: float) -> None:
            if stop.is_set():
                raise Stopped
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=1.0)
            bars.update(tasks[stage], completed=share)

        yield tell


if __name__ == '__main__':
    sys.exit(main())
