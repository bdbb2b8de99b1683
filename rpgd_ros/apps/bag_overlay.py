# SPDX-License-Identifier: Apache-2.0
"""`calibrate_bag --overlay`: pictures or a film, over the recording's images where it has any."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from rpgd_ros.apps.bag_job import Job, make_folder
from rpgd_ros.core.observations import Observations, View
from rpgd_ros.report.film import (
    FILMS,
    Instant,
    Painter,
    blank_instants,
    write_film,
    write_pictures,
)

MOST_PICTURES: Final = 50  # of a camera: to look through, not to watch


def write_overlay(job: Job, path: Path) -> None:
    """Draw keypoints and reprojected skeleton of a run.

    Args:
        job: The run.
        path: A film where it ends in one of `FILMS`, else a folder for pictures.

    Raises:
        InputError: NOT_WRITABLE.

    """
    run = job.run
    if run.snapshot is None or run.calibration is None or run.observations is None:
        return
    cameras, observations = run.snapshot.cameras, run.observations
    painter = Painter(cameras, observations, run.calibration.world_T_mocap)
    if path.suffix in FILMS:
        write_film(path, painter, cameras, observations, _instants(job, observations, most=0))
        return
    make_folder(path)
    names = [camera.name for camera in cameras]
    write_pictures(path, painter, names, _instants(job, observations, most=MOST_PICTURES))


def _instants(job: Job, observations: Observations, *, most: int) -> Iterator[Instant]:
    """Yield what an overlay shows: images where there are any, else empty canvases.

    Args:
        job: The run.
        observations: Of it.
        most: Instants of each camera, evenly spread; 0 = all.

    """
    images = job.images
    views = observations.views
    shown = {v: images.rows(v) or tuple(range(view.n_frames)) for v, view in enumerate(views)}
    wanted = {v: _spread(rows, most) for v, rows in shown.items()}
    blank = {v: rows for v, rows in wanted.items() if not images.rows(v)}
    if len(blank) < len(views):
        yield from _merged(
            images.instants(wanted, tell=job.warn, progress=job.progress),
            list(blank_instants(views, blank)),
            views,
        )
        return
    every = list(blank_instants(views, wanted))
    for n, instant in enumerate(every):
        job.progress('overlay', n / len(every))
        yield instant


def _merged(
    pictured: Iterator[Instant], blank: list[Instant], views: Sequence[View]
) -> Iterator[Instant]:
    """Put instants of cameras without images between those with, by their time."""

    def time_of(instant: Instant) -> int:
        stamps = views[instant.camera].stamp_ns
        return 0 if stamps is None else int(stamps[instant.row])

    n = 0
    for instant in pictured:
        now = time_of(instant)
        while n < len(blank) and time_of(blank[n]) <= now:
            yield blank[n]
            n += 1
        yield instant
    yield from blank[n:]


def _spread(rows: Sequence[int], most: int) -> tuple[int, ...]:
    if not most or len(rows) <= most:
        return tuple(rows)
    return tuple(rows[i] for i in np.linspace(0, len(rows) - 1, most).round().astype(int))
