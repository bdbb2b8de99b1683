# SPDX-License-Identifier: Apache-2.0
"""Whether the covariance says how far off the pose is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from rpgd_ros.apps.bench_problems import Case, build
from rpgd_ros.apps.bench_run import Table, Track, each, markdown
from rpgd_ros.core import Calibration, CalibrationError, RigidTransform, calibrate
from rpgd_ros.core.geometry import Array, so3_log

FRAMES = (300, 3000)
JOINTS = ('h36m17', 'h36m32')
BIAS_M = 0.02  # per axis: joints of recorded detectors lie 2 to 4 cm from those of the MoCap
IID_RANGE, BIASED_RANGE = (0.5, 1.4), (0.5, 2.0)

CAPTION = """\
Squared error in units of the reported covariance, by its number of dimensions (NEES / n): 1 is
honest, above it too sure, below it too modest. Mean (median) over {seeds} seeds of
CalibrationConfig() on the human36m rig. Errors are independent, or each joint of the MoCap is
displaced by {bias_mm:g} mm per axis against the detector's, turning with the body. Wanted:
{iid[0]:g} to {iid[1]:g} of the whole pose for independent errors, {biased[0]:g} to {biased[1]:g}
of the rotation and of the position of the body's centroid for displaced joints.
"""


def measure(
    joints: Sequence[str], seeds: Sequence[int], *, frames: Sequence[int], jobs: int, track: Track
) -> Table:
    """Compare errors with covariances for each convention, length, kind of error and seed."""
    cases = [
        Case('human36m', n, seed, bias_m=bias_m, joints=convention)
        for bias_m in (0.0, BIAS_M)
        for convention in joints
        for n in frames
        for seed in seeds
    ]
    rows = list(track(each(solve, cases, jobs=jobs), 'honesty', len(cases)))
    cells: dict[tuple[Any, ...], list[dict[str, Any]]] = {}
    for row in rows:
        cells.setdefault((row['bias_m'], row['joints'], row['frames']), []).append(row)
    text = CAPTION.format(
        seeds=len(seeds), bias_mm=1e3 * BIAS_M, iid=IID_RANGE, biased=BIASED_RANGE
    )
    header = ('errors', 'joints', 'T', 'pose / 6', 'rotation / 3', 'centroid / 3', 'refused', '')
    return Table('honesty', f'{text}\n{markdown(header, map(_line, cells.values()))}\n', rows)


def solve(case: Case) -> dict[str, Any]:
    """Calibrate one problem and weigh its error."""
    problem = build(case)
    refusal, calibration = '', None
    try:
        calibration = calibrate(problem.cameras, problem.observations)
    except CalibrationError as refused:
        refusal, calibration = str(refused.reason), refused.calibration
    nees = (np.nan,) * 3
    if calibration:
        nees = weigh(calibration, problem.truth.world_T_mocap)
    return {
        'data': case.data,
        'joints': problem.observations.n_joints,
        'frames': case.frames,
        'seed': case.seed,
        'bias_m': case.bias_m,
        'refusal': refusal,
        **dict(zip(('pose', 'rotation', 'centroid'), nees, strict=True)),
    }


def weigh(calibration: Calibration, truth: RigidTransform) -> tuple[float, float, float]:
    """Return NEES / n of the pose (n = 6), its rotation (3), and the body's centroid (3)."""
    pose, x = calibration.world_T_mocap, calibration.centroid_mocap
    turn = so3_log(truth.rotation @ pose.rotation.T)
    delta = np.concatenate([turn, truth.translation - pose.translation])
    return (
        _nees(delta, calibration.covariance),
        _nees(turn, calibration.covariance[:3, :3]),
        _nees((truth @ x) - (pose @ x), calibration.centroid_covariance),
    )


def _nees(error: Array, covariance: Array) -> float:
    return float(error @ np.linalg.solve(covariance, error)) / len(error)


def _line(rows: Sequence[dict[str, Any]]) -> list[str]:
    first = rows[0]
    values = {name: np.array([r[name] for r in rows]) for name in ('pose', 'rotation', 'centroid')}
    mean = {name: float(np.nanmean(v)) for name, v in values.items()}
    low, high = BIASED_RANGE if first['bias_m'] else IID_RANGE
    judged = ('rotation', 'centroid') if first['bias_m'] else ('pose',)
    holds = all(low <= mean[name] <= high for name in judged)
    return [
        f'joints off by {1e3 * first["bias_m"]:g} mm' if first['bias_m'] else 'independent',
        str(first['joints']),
        str(first['frames']),
        *(f'{mean[name]:.2f} ({float(np.nanmedian(v)):.2f})' for name, v in values.items()),
        f'{sum(bool(row["refusal"]) for row in rows)} of {len(rows)}',
        'holds' if holds else 'does NOT hold',
    ]
