# SPDX-License-Identifier: Apache-2.0
"""The solver beside its peers: the same problems, one process and one thread each."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from rpgd_ros.apps.bench_compare import accuracy, robustness
from rpgd_ros.apps.bench_problems import THRESHOLDS_PX, Case, build, cramer_rao, judge
from rpgd_ros.apps.bench_run import Table, Track, apart
from rpgd_ros.core import (
    CalibrationConfig,
    CalibrationError,
    Camera,
    Observations,
    RigidTransform,
    calibrate,
)
from rpgd_ros.simulation import Twin
from rpgd_ros.simulation.presets import OutlierKind

FRAMES = (300, 3000)
DATA = ('human36m', 'mpi_inf_3dhp', 'aistpp')
OURS = 'rpgd_ros'
SOLVERS = (OURS, 'poselib-fast', 'poselib-sub-trunc', 'opencv-scipy', 'published')
WARM_UP = Case('human36m', 30, 0)

ACCURACY = """\
{seeds} seeds, no outliers beyond the data's own. right: rotation within 0.5 deg and body within
20 mm. x GT: median MPJPE by that at the true pose. error: RMS displacement of the body's points
over the right runs; x bound: the same by the Cramer-Rao bound, for which noise and outliers are
known. ms: median processor time of one solve in a process of its own, one thread. {ours}: factor
of its error, and median factor of its time, against that line's. {ours} is CalibrationConfig(),
told nothing; peers are told tau.
"""
ROBUSTNESS = """\
{seeds} seeds, {frames} frames, added outliers: right runs, RMS error of these, median time. In
brackets {ours}'s error on the problems that both got right, and its time, by those.
"""

Solver = Callable[..., RigidTransform]


@dataclass(frozen=True, slots=True)
class Answer:
    """What one solver said to one problem.

    Attributes:
        pose: world_T_mocap; None where it gave none.
        complaint: Why it gave none.
        processor_s: Processor time.
        wall_s: Time on the wall.

    """

    pose: RigidTransform | None
    complaint: str = ''
    processor_s: float = float('nan')
    wall_s: float = float('nan')


def measure(
    data: Sequence[str],
    seeds: Sequence[int],
    *,
    frames: Sequence[int],
    kinds: Sequence[OutlierKind],
    ratios: Sequence[float],
    solvers: Sequence[str],
    limit_s: float,
    track: Track,
) -> Table:
    """Run the solvers on each dataset's twin: without outliers at each length, then with them."""
    present, missing = available(solvers)
    clean = [Case(name, n, 0) for name in data for n in frames]
    dirty = [
        Case(name, min(frames), 0, kind, ratio)
        for name in data
        for kind in kinds
        for ratio in ratios
    ]
    todo = [case._replace(seed=seed) for case in (*clean, *dirty) for seed in seeds]
    answers = (run(case, present, limit_s) for case in todo)
    rows = [row for part in track(answers, 'solver', len(todo)) for row in part]
    parts = [*missing]
    if clean:
        parts.append(ACCURACY.format(seeds=len(seeds), ours=OURS))
        parts.append(accuracy([row for row in rows if not row['ratio']], OURS) + '\n')
    if dirty:
        parts.append(ROBUSTNESS.format(seeds=len(seeds), frames=min(frames), ours=OURS))
        parts.append(robustness([row for row in rows if row['ratio']], OURS) + '\n')
    return Table('solver', '\n'.join(parts), rows)


def available(solvers: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the solvers whose libraries are there, and sentences about those that are not."""
    present, missing = [], []
    for name in solvers:
        try:
            load(name)
        except ImportError as error:
            text = f"{name} was left out: {error}. To have it: pip install -e '.[bench]'\n"
            missing.append(text)
        else:
            present.append(name)
    return present, missing


def load(name: str) -> Solver:
    """Return a solver by its name.

    Raises:
        ImportError: Its library is not installed, or does not load.

    """
    if name.startswith('poselib'):
        poselib = importlib.import_module('rpgd_ros.apps.bench_poselib')
        peer: Solver = poselib.fast if name == 'poselib-fast' else poselib.truncated
        return peer
    if name == 'opencv-scipy':
        glued: Solver = importlib.import_module('rpgd_ros.apps.bench_scipy').soft_l1
        return glued
    return _ours if name == OURS else _published


def _ours(
    cameras: Sequence[Camera], observations: Observations, *, threshold_px: float
) -> RigidTransform:
    del threshold_px  # it finds its own
    return calibrate(cameras, observations, config=CalibrationConfig()).world_T_mocap


def _published(
    cameras: Sequence[Camera], observations: Observations, *, threshold_px: float
) -> RigidTransform:
    config = CalibrationConfig.paper(threshold_px=threshold_px)
    try:
        return calibrate(cameras, observations, config=config).world_T_mocap
    except CalibrationError as refusal:
        if refusal.calibration is None:
            raise
        return refusal.calibration.world_T_mocap  # the published method refuses nothing


def run(case: Case, solvers: Sequence[str], limit_s: float) -> list[dict[str, Any]]:
    """Put one problem to all solvers, one after the other, each in a process of its own."""
    problem = build(case)
    truth = problem.truth.world_T_mocap
    gt_px, bound = judge(problem, truth).mpjpe_px, cramer_rao(problem)
    rows = []
    for name in solvers:
        try:
            answer = apart(answer_of, name, problem, THRESHOLDS_PX[case.data], limit_s=limit_s)
        except TimeoutError as none:
            answer = Answer(None, str(none))
        error = judge(problem, answer.pose) if answer.pose else None
        rows.append(
            {
                **case._asdict(),
                'solver': name,
                'gt_px': gt_px,
                'bound_deg': bound.rotation_deg,
                'bound_mm': 1e3 * bound.points_m,
                'is_right': error is not None and error.is_right,
                'mpjpe_px': error.mpjpe_px if error else float('nan'),
                'deg': error.rotation_deg if error else float('nan'),
                'mm': 1e3 * error.points_m if error else float('nan'),
                'ms': 1e3 * answer.processor_s,
                'wall_ms': 1e3 * answer.wall_s,
                'complaint': answer.complaint,
            }
        )
    return rows


def answer_of(name: str, problem: Twin, threshold_px: float) -> Answer:
    """Solve a problem after a small one, which loads what is loaded once."""
    solver = load(name)
    warm = build(WARM_UP)
    _timed(solver, warm, THRESHOLDS_PX[WARM_UP.data])
    return _timed(solver, problem, threshold_px)


def _timed(solver: Solver, problem: Twin, threshold_px: float) -> Answer:
    pose, complaint = None, ''
    wall, processor = time.perf_counter(), time.process_time()
    try:
        pose = solver(problem.cameras, problem.observations, threshold_px=threshold_px)
    except (CalibrationError, ValueError, RuntimeError) as error:
        complaint = f'{type(error).__name__}: {error}'
    return Answer(pose, complaint, time.process_time() - processor, time.perf_counter() - wall)
