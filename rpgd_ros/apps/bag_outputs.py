# SPDX-License-Identifier: Apache-2.0
"""What `calibrate_bag` writes, one function per option."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from threading import Event
from typing import Final

from rich.console import Console

from rpgd_ros.apps.bag_annotate import annotate
from rpgd_ros.apps.bag_job import Job, Outputs, Written, make_folder
from rpgd_ros.apps.bag_overlay import write_overlay
from rpgd_ros.apps.bag_run import BagRun, tell
from rpgd_ros.apps.progress import one_bar
from rpgd_ros.datasets.labels import write_labels
from rpgd_ros.io.atomic import write_atomic
from rpgd_ros.io.camera_files import toml_text
from rpgd_ros.io.result_file import write_result_text
from rpgd_ros.io.rig import with_poses, write_rig
from rpgd_ros.report import (
    Case,
    Photo,
    Step,
    choose_instants,
    settle,
    write_report,
)


def write_outputs(
    run: BagRun,
    arguments: argparse.Namespace,
    outputs: Outputs,
    err: Console,
    stop: Event,
) -> None:
    """Write everything that was asked for; of a refused run, the report only.

    Args:
        run: What was found.
        arguments: Of the command line.
        outputs: Told what is written, one by one.
        err: For progress and warnings.
        stop: Set when the program is to end.

    Raises:
        InputError: NOT_WRITABLE.

    """
    wanted = [name for name in OUTPUTS if getattr(arguments, name) is not None]
    if not wanted:
        return
    with one_bar(err, stop) as progress:
        job = Job(run, arguments.images, progress, lambda said: tell(err, f'warning: {said}'))
        for name in wanted:
            if _is_due(name, run):
                path: Path = getattr(arguments, name)
                outputs.begun = path
                OUTPUTS[name](job, path)
                outputs.begun = None
                outputs.written.append(Written(name, path))


def _is_due(name: str, run: BagRun) -> bool:
    """Whether a run has what an output is made of; a report has something to say of every run."""
    if name == 'report':
        return True
    if name == 'overlay':
        return run.calibration is not None
    return run.refusal is None


def _result(job: Job, path: Path) -> None:
    if job.run.result_text:
        write_result_text(path, job.run.result_text)


def _rig(job: Job, path: Path) -> None:
    run = job.run
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


def _labels(job: Job, path: Path) -> None:
    run = job.run
    if run.snapshot is None or run.calibration is None or run.observations is None:
        return
    job.progress('labels', 0.0)
    make_folder(path)
    name = run.bag.absolute().stem
    write_labels(path, name, run.snapshot.cameras, run.observations, run.calibration)


def _annotated(job: Job, path: Path) -> None:
    for said in annotate(job.run, path, job.progress):
        job.warn(said)


def _report(job: Job, path: Path) -> None:
    case = case_of(job.run, job.progress)
    pictured = {camera.name: job.images.rows(v) for v, camera in enumerate(case.cameras)}
    if any(pictured.values()):
        rows = choose_instants(case, pictured)
        wanted = {v: rows.get(camera.name, ()) for v, camera in enumerate(case.cameras)}
        photos: dict[str, tuple[Photo, ...]] = {}
        for found in job.images.instants(wanted, tell=job.warn, progress=job.progress):
            if found.image is not None:
                name = case.cameras[found.camera].name
                photos[name] = (*photos.get(name, ()), Photo(found.row, found.image))
        case = replace(case, photos=photos)
    write_report(path, case)


# What is written for each option, in this order.
OUTPUTS: Final[dict[str, Callable[[Job, Path], None]]] = {
    'output': _result,
    'write_rig': _rig,
    'export': _labels,
    'annotated': _annotated,
    'overlay': write_overlay,
    'report': _report,
}


def case_of(run: BagRun, progress: Callable[[str, float], None]) -> Case:
    """Return a run as what a report is about, without images."""
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
