# SPDX-License-Identifier: Apache-2.0
"""Evaluates one sequence of a dataset, and keeps what was found as one small file."""

from __future__ import annotations

import hashlib
import json
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from rpgd_ros import __version__
from rpgd_ros.apps.bench_problems import THRESHOLDS_PX, body_points, mpjpe_px
from rpgd_ros.apps.evaluate_bound import yardstick
from rpgd_ros.core import (
    Calibration,
    CalibrationConfig,
    CalibrationError,
    RigidTransform,
    RpgdError,
    calibrate,
)
from rpgd_ros.core.geometry import rotation_angle
from rpgd_ros.datasets import Dataset, DatasetName, DatasetSequence, open_dataset
from rpgd_ros.datasets.files import status
from rpgd_ros.datasets.labels import write_labels
from rpgd_ros.io.atomic import write_atomic

# One row of results: what a CSV line holds.
Row = dict[str, Any]

SCHEMA = 2
METHODS = ('ransac', 'rpgd', 'default')
FIGURES = ('px', 'deg', 'mm', 'ms', 'refusal')
COLUMNS = (
    'sequence', 'left_out', 'error', 'cameras', 'frames', 'joints', 'correspondences', 'gt_px',
    'read_ms', *(f'{method}_{figure}' for method in METHODS for figure in FIGURES),
    'default_sigma_deg', 'default_sigma_mm', 'noise_px', 'bound_deg', 'bound_mm', 'lasting_px',
)  # fmt: skip
TEXTS = ('sequence', 'left_out', 'error', *(f'{method}_refusal' for method in METHODS))
COUNTS = ('cameras', 'frames', 'joints', 'correspondences')


@dataclass(frozen=True, slots=True)
class Task:
    """One sequence to evaluate.

    Attributes:
        dataset: Whose layout the folder has.
        folder: Of the dataset.
        name: Of the sequence.
        is_published: Whether the publication's selection is asked for.
        results: Folder of the results.
        export: Folder for labels; None = none are written.
        methods: Which of `METHODS` to run.

    """

    dataset: DatasetName
    folder: Path
    name: str
    is_published: bool
    results: Path
    export: Path | None = None
    methods: tuple[str, ...] = METHODS

    @property
    def configs(self) -> dict[str, CalibrationConfig]:
        """Settings of each method that is asked for."""
        paper = CalibrationConfig.paper(threshold_px=THRESHOLDS_PX[self.dataset])
        known = {
            'ransac': paper.with_stage('refine', method='none'),
            'rpgd': paper,
            'default': CalibrationConfig(),
        }
        return {method: known[method] for method in METHODS if method in self.methods}

    @property
    def stem(self) -> str:
        """Name for files: those of sequences hold slashes, and files cannot."""
        return quote(self.name, safe=' ')

    @property
    def file(self) -> Path:
        """Where the result is kept."""
        return self.results / f'{self.stem}.json'

    @property
    def is_exported(self) -> bool:
        """Whether nothing is left to export; the .json file is written last."""
        return self.export is None or status(self.export / f'{self.stem}.json') is not None


def evaluate(task: Task) -> Row:
    """Evaluate a sequence, write its result, and return it.

    A sequence whose files cannot be used, or whose result cannot be written, gives a row that
    says so.
    """
    try:
        dataset = open_dataset(task.dataset, task.folder, is_published=task.is_published)
        key = fingerprint(task, dataset)
        row = _measure(task, dataset)
        write_atomic(task.file, json.dumps({'schema': SCHEMA, 'key': key, 'row': row}))
    except RpgdError as error:
        return empty_row(task.name) | {'error': error.message}
    return row


def finished(task: Task, dataset: Dataset) -> Row | None:
    """Return the kept result of a sequence; None where it has to be done.

    A result counts only as long as program, settings and files are those it was made with.
    """
    try:
        kept = json.loads(task.file.read_text(encoding='utf-8'))
        row = kept['row']
        is_ours = kept['schema'] == SCHEMA and kept['key'] == fingerprint(task, dataset)
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None
    if not (is_ours and isinstance(row, dict) and _is_row(row) and row['sequence'] == task.name):
        return None
    has_labels = not (row['left_out'] or row['default_refusal'])
    return None if has_labels and not task.is_exported else row


def _is_row(row: dict[str, Any]) -> bool:
    """Whether a row that was kept has what a row has: somebody may have edited it."""
    if row.keys() != set(COLUMNS):
        return False
    texts = [row[column] for column in TEXTS]
    counts = [row[column] for column in COUNTS]
    figures = [row[column] for column in set(COLUMNS) - {*TEXTS, *COUNTS}]
    return (
        all(isinstance(text, str) and text.isprintable() for text in texts)
        and all(type(count) is int and 0 <= count < 2**63 for count in counts)
        and all(type(figure) is float for figure in figures)
    )


def fingerprint(task: Task, dataset: Dataset) -> str:
    """Return a digest of all that a result depends on; files count by size and time."""
    stats = [found for path in dataset.files(task.name) if (found := status(path))]
    parts = [
        __version__, task.dataset, task.name, task.is_published,
        [(stat.st_size, stat.st_mtime_ns) for stat in stats],
        {name: asdict(config) for name, config in task.configs.items()},
    ]  # fmt: skip
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def empty_row(name: str) -> Row:
    """Return a row without figures."""
    return {column: '' if column in TEXTS else float('nan') for column in COLUMNS} | {
        'sequence': name
    }


def _measure(task: Task, dataset: Dataset) -> Row:
    started = time.perf_counter()
    sequence = dataset.read(task.name)
    seconds = time.perf_counter() - started
    views = sequence.observations.views
    frames = max(view.n_frames for view in views)
    row = empty_row(task.name) | {
        'left_out': dataset.objection(sequence),
        'cameras': len(sequence.cameras),
        'frames': frames,
        'joints': sequence.observations.n_joints,
        'correspondences': int(sum(view.seen().sum() for view in views)),
        'gt_px': mpjpe_px(sequence.cameras, sequence.observations, sequence.world_T_mocap),
        'read_ms': 1e3 * seconds / max(frames, 1),
    }
    if row['left_out']:
        return row
    row |= _nearest(sequence)
    for method, config in task.configs.items():
        columns, calibration = _solve(sequence, method, config, frames)
        row |= columns
        if task.export and method == 'default' and calibration and not row['default_refusal']:
            cameras, observations = sequence.cameras, sequence.observations
            write_labels(task.export, task.stem, cameras, observations, calibration)
    return row


def _nearest(sequence: DatasetSequence) -> Row:
    """Return the columns of what can be known at the dataset's pose."""
    measured = yardstick(sequence)
    if measured is None:
        return {}
    return {
        'noise_px': measured.noise.sigma_px,
        'bound_deg': measured.bound.rotation_deg,
        'bound_mm': 1e3 * measured.bound.points_m,
        'lasting_px': measured.lasting_px,
    }


def _solve(
    sequence: DatasetSequence, method: str, config: CalibrationConfig, frames: int
) -> tuple[Row, Calibration | None]:
    """Return the columns of one method, and its result.

    A pose that the gates refuse counts as a pose.
    """
    refusal = ''
    calibration: Calibration | None
    started = time.perf_counter()
    try:
        calibration = calibrate(sequence.cameras, sequence.observations, config=config)
    except CalibrationError as error:
        calibration, refusal = error.calibration, str(error.reason)
    seconds = time.perf_counter() - started
    columns: Row = {
        f'{method}_ms': 1e3 * seconds / max(frames, 1),
        f'{method}_refusal': refusal,
    }
    if calibration is None:
        return columns, None
    pose = calibration.world_T_mocap
    deg, mm = distance(sequence, pose)
    columns |= {
        f'{method}_px': mpjpe_px(sequence.cameras, sequence.observations, pose),
        f'{method}_deg': deg,
        f'{method}_mm': mm,
    }
    if method == 'default':
        columns['default_sigma_deg'] = calibration.sigma_rotation_deg
        columns['default_sigma_mm'] = 1e3 * calibration.sigma_position_m
    return columns, calibration


def distance(sequence: DatasetSequence, pose: RigidTransform) -> tuple[float, float]:
    """Return how far a pose is from the dataset's: degrees, and RMS of the body's points, mm."""
    given = sequence.world_T_mocap
    x = body_points(sequence.observations)
    apart = (pose @ x) - (given @ x)
    angle = rotation_angle(given.rotation @ pose.rotation.T)
    return float(np.degrees(angle)), 1e3 * float(np.sqrt((apart**2).sum(-1).mean()))
