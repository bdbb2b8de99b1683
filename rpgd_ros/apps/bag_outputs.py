# SPDX-License-Identifier: Apache-2.0
"""What `calibrate_bag` writes beside the terminal: result, report, labels, JSON."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from threading import Event
from typing import Any, NamedTuple

import yaml
from rich.console import Console

from rpgd_ros.apps.bag_run import BagRun, tell
from rpgd_ros.apps.progress import one_bar
from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.datasets.labels import write_labels
from rpgd_ros.io.atomic import write_atomic
from rpgd_ros.io.camera_files import toml_text
from rpgd_ros.io.result_file import result_text, write_result
from rpgd_ros.io.rig import with_poses, write_rig
from rpgd_ros.report import Case, Step, check_libraries, settle, write_report

JSON_SCHEMA = 1
RIG_SUFFIXES = ('.yaml', '.yml', '.toml')


class Written(NamedTuple):
    """A file that a run left.

    Attributes:
        what: Key of the option that asked for it.
        path: Where.

    """

    what: str
    path: Path


def check_outputs(arguments: argparse.Namespace) -> None:
    """Refuse, before the work, what could not be written after it.

    Raises:
        InputError: NOT_WRITABLE, or a library is missing.

    """
    paths = (arguments.output, arguments.report, arguments.export, arguments.write_rig)
    for path in filter(None, paths):
        if not path.absolute().parent.is_dir():
            msg = f'{path.parent} is no folder: create it first'
            raise InputError(Reason.NOT_WRITABLE, msg)
    if arguments.write_rig and arguments.write_rig.suffix not in RIG_SUFFIXES:
        msg = f'{arguments.write_rig}: need a name that ends in {", ".join(RIG_SUFFIXES)}'
        raise InputError(Reason.NOT_WRITABLE, msg)
    if arguments.report:
        check_libraries()


def write_outputs(
    run: BagRun, arguments: argparse.Namespace, err: Console, stop: Event
) -> list[Written]:
    """Write everything that was asked for; of a refused run, the report only.

    Raises:
        InputError: NOT_WRITABLE.

    """
    written = []
    with one_bar(err, stop) as progress:
        for what, write in _writers(run, arguments):
            path: Path | None = getattr(arguments, what)
            if path is not None:
                write(run, path, progress)
                written.append(Written(what, path))
    return written


Writer = Callable[[BagRun, Path, Callable[[str, float], None]], None]


def _writers(run: BagRun, _arguments: argparse.Namespace) -> Iterator[tuple[str, Writer]]:
    if run.refusal is None:
        yield 'output', _result
        yield 'write_rig', _rig
        yield 'export', _labels
    yield 'report', _report


def _result(run: BagRun, path: Path, _progress: Callable[[str, float], None]) -> None:
    if run.calibration is not None:
        world_frame, mocap_frame = run.frames
        write_result(
            path,
            run.calibration,
            world_frame=world_frame,
            mocap_frame=mocap_frame,
            stamp_ns=run.stamp_ns,
            optical_frames=run.session.optical_frames(),
        )


def _rig(run: BagRun, path: Path, _progress: Callable[[str, float], None]) -> None:
    if run.calibration is None or run.snapshot is None:
        return
    if path.suffix == '.toml':
        # Triangulated with these, the keypoints lie where the MoCap has its joints.
        mocap = run.calibration.world_T_mocap
        cameras = [
            replace(c, camera_T_world=c.camera_T_world @ mocap)
            for c in run.snapshot.cameras
            if c.camera_T_world is not None
        ]
        write_atomic(path, toml_text(cameras, run.frames[1]))
        return
    poses = {name: p.camera_T_world for name, p in run.calibration.camera_poses.items()}
    write_rig(path, with_poses(run.rig, poses))


def _labels(run: BagRun, path: Path, progress: Callable[[str, float], None]) -> None:
    if run.snapshot is None or run.calibration is None or run.observations is None:
        return
    progress('labels', 0.0)
    try:
        path.mkdir(exist_ok=True)
    except OSError as error:
        msg = f'{path} cannot be made: {error.strerror or error}'
        raise InputError(Reason.NOT_WRITABLE, msg) from error
    name = run.bag.absolute().stem
    write_labels(path, name, run.snapshot.cameras, run.observations, run.calibration)


def _report(run: BagRun, path: Path, progress: Callable[[str, float], None]) -> None:
    write_report(path, case_of(run, progress))


def case_of(run: BagRun, progress: Callable[[str, float], None]) -> Case:
    """Return a run as what a report is about."""
    world_frame, mocap_frame = run.frames
    cameras = run.snapshot.cameras if run.snapshot else ()
    steps: tuple[Step, ...] = ()
    if run.calibration is not None and run.observations is not None:
        steps = settle(cameras, run.observations, run.calibration, progress=progress)
    progress('report', 0.0)
    return Case(
        name=str(run.bag),
        world_frame=world_frame,
        mocap_frame=mocap_frame,
        stamp_ns=run.stamp_ns,
        cameras=cameras,
        observations=run.observations,
        calibration=run.calibration,
        refusal=run.refusal,
        moved_m=run.moved_m,
        streams=run.streams,
        notes=(f'found from partial data: {run.problem}',) if run.problem else (),
        steps=steps,
    )


def tell_written(out: Console, written: list[Written]) -> None:
    """Say what was written."""
    for _, path in written:
        tell(out, f'written to {path}')


def json_of(
    status: str,
    code: int,
    *,
    reason: str = '',
    message: str = '',
    run: BagRun | None = None,
    written: list[Written] | None = None,
) -> str:
    """Return a run for programs; the keys are documented in docs/report.md.

    Args:
        status: accepted, partial, refused, bad_input.
        code: Exit code.
        reason: Code of the reason, '' where accepted.
        message: What to tell a person.
        run: What was found, as far as it went.
        written: Files.

    """
    tree: dict[str, Any] = {
        'schema': JSON_SCHEMA,
        'status': status,
        'exit_code': code,
        'reason': reason or None,
        'message': message or None,
        'streams': [
            {**s._asdict(), 'dropped': dict(s.dropped)} for s in (run.streams if run else ())
        ],
        'files': {what: str(path) for what, path in written or ()},
        'result': None,
    }
    if run is not None and run.calibration is not None and run.refusal is None:
        world_frame, mocap_frame = run.frames
        text = result_text(
            run.calibration,
            world_frame=world_frame,
            mocap_frame=mocap_frame,
            stamp_ns=run.stamp_ns,
            optical_frames=run.session.optical_frames(),
        )
        tree['result'] = yaml.safe_load(text)
    return json.dumps(tree, indent=2, default=str)
