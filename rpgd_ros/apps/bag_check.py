# SPDX-License-Identifier: Apache-2.0
"""`calibrate_bag --check`: whether an accepted result still fits a recording; no solve."""

from __future__ import annotations

import argparse

from rich.console import Console
from rich.markup import escape

from rpgd_ros.apps.bag_outputs import OUTPUTS
from rpgd_ros.apps.bag_run import BagRun, tell
from rpgd_ros.apps.tables import new_table
from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.io.backups import utc
from rpgd_ros.io.result_file import StoredResult, read_result
from rpgd_ros.session.recheck import CameraCheck, Recheck, camera_tree, recheck

UNKNOWN = '-'


def check_arguments(arguments: argparse.Namespace) -> None:
    """Refuse outputs: there is no new result that they could be made of.

    Raises:
        InputError: NOT_WRITABLE.

    """
    given = [name for name in OUTPUTS if getattr(arguments, name) is not None]
    if given:
        option = given[0].replace('_', '-')
        msg = f'--check looks only, it has nothing for --{option}: leave out one of the two'
        raise InputError(Reason.NOT_WRITABLE, msg)


def read_accepted(arguments: argparse.Namespace, world_frame: str) -> StoredResult:
    """Read the result that is to be checked, before the recording.

    Raises:
        InputError: BAD_RESULT_FILE. It cannot be read, or is of another world.

    """
    stored = read_result(arguments.check)
    if stored.world_frame != world_frame:
        msg = (
            f'{arguments.check} is of world frame {stored.world_frame[:80]!r}, the rig file has '
            f'{world_frame[:80]!r}: they do not belong together'
        )
        raise InputError(Reason.BAD_RESULT_FILE, msg)
    return stored


def check_bag(run: BagRun, stored: StoredResult, err: Console) -> Recheck:
    """Compare what was read with a result.

    Raises:
        InputError: BAD_RESULT_FILE. It knows none of the cameras, or is of another MoCap frame.
        CalibrationError: Nothing came together.

    """
    names = [camera.name for camera in run.rig.cameras]
    mocap_frame = run.frames[1]
    if stored.mocap_frame != mocap_frame:
        msg = (
            f'the result is of MoCap frame {stored.mocap_frame[:80]!r}, the recording has '
            f'{mocap_frame[:80]!r}: calibrate anew'
        )
        raise InputError(Reason.BAD_RESULT_FILE, msg)
    found = recheck(run.session.snapshot(), stored, names)
    strangers = [c.name for c in found.cameras if c.fits is None]
    if len(strangers) == len(names):
        msg = f'the result knows none of the cameras {", ".join(names)}: calibrate anew'
        raise InputError(Reason.BAD_RESULT_FILE, msg)
    for name in strangers:
        tell(err, f'warning: the result does not know camera {name}: it is not judged')
    for name in sorted(set(stored.camera_mpjpe_px) - set(names)):
        tell(err, f'warning: camera {name} of the result is not looked at')
    return found


def print_check(console: Console, found: Recheck, stored: StoredResult) -> None:
    """Print how each camera fits, and the verdict."""
    table = new_table(
        'camera', 'verdict', 'error px', 'accepted', 'limit', 'shift px', 'limit', 'since'
    )
    for camera in found.cameras:
        table.add_row(*_row(camera))
    console.print(table)
    when = utc(stored.stamp_ns)
    tell(console, f'the transform of {when} still fits' if found.fits else found.complaint)


def check_tree(found: Recheck, stored: StoredResult) -> dict[str, object]:
    """Return it for programs; the keys are documented in docs/report.md."""
    return {
        'found': utc(stored.stamp_ns),
        'fits': found.fits,
        'cameras': {camera.name: camera_tree(camera) for camera in found.cameras},
    }


def _row(c: CameraCheck) -> tuple[str, ...]:
    verdict = {None: 'not judged', True: 'fits', False: 'does not fit'}[c.fits]
    numbers = (c.error_px, c.accepted_px, c.limit_px, c.shift_px, c.shift_limit_px)
    since = '' if c.since_s is None else f'{c.since_s:.0f} s'
    texts = (UNKNOWN if value is None else f'{value:.2f}' for value in numbers)
    return escape(c.name), verdict, *texts, since
