# SPDX-License-Identifier: Apache-2.0
"""What no residual shows: poses that look good and are wrong, counted over many recordings."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import Any, NamedTuple

import cv2
import numpy as np
import pytest
from core_cases import far_away, flat_figure, flattened
from fault_report import Measured, repeats
from scenes import errors, scene
from test_core_covariance import nees
from test_core_published import WRONG, wrong_cameras

from rpgd_ros.core import (
    Calibration,
    CalibrationConfig,
    CalibrationError,
    Observations,
    Reason,
    calibrate,
)
from rpgd_ros.simulation import Twin
from rpgd_ros.simulation.motion import MotionName
from rpgd_ros.simulation.presets import OutlierKind

N_SIGMA = 3.0


class Outcome(NamedTuple):
    """How a recording was judged, and what is true."""

    reason: Reason | None
    error_deg: float = 0.0
    is_beyond: bool = False
    calibration: Calibration | None = None


def outcome(case: Twin, config: CalibrationConfig | None = None) -> Outcome:
    """Calibrate; compare what was accepted with the truth and with its own sigma."""
    try:
        found = calibrate(case.cameras, case.observations, config=config or CalibrationConfig())
    except CalibrationError as refused:
        return Outcome(refused.reason)
    truth = case.truth.world_T_mocap
    angle_deg, shift_m = errors(found.world_T_mocap, truth, case.observations)
    sigma_deg, sigma_m = found.worst_sigma
    is_beyond = angle_deg > N_SIGMA * sigma_deg or shift_m > N_SIGMA * sigma_m
    return Outcome(None, angle_deg, is_beyond, found)


@pytest.mark.fault(26)
@pytest.mark.parametrize('motion', ['still', 'turn_in_place', 'walk'])
@pytest.mark.parametrize(('distance_m', 'bias_px'), [(5.0, 0.0), (10.0, 0.0), (10.0, 3.0)])
def test_far_subject_is_never_surer_than_right(
    motion: MotionName, distance_m: float, bias_px: float, measured: Measured
) -> None:
    """Beyond three sigma in at most two of a hundred, and who stands still is refused always."""
    n = repeats(40, 3)
    found = [
        outcome(far_away(1000 + seed, distance_m, motion=motion, bias_px=bias_px))
        for seed in range(n)
    ]
    n_beyond = sum(f.is_beyond for f in found)
    measured('beyond 3 sigma', 100.0 * n_beyond / n, '%', n=n)
    assert n_beyond <= 0.02 * n
    if motion == 'still':
        assert {f.reason for f in found} == {Reason.DEGENERATE_MOTION}


@pytest.mark.fault(27)
@pytest.mark.parametrize('onto', ['line', 'point', 'plane'])
def test_thin_bodies_are_refused_or_right(onto: str, measured: Measured) -> None:
    """Lines and points always refused; planes right to 0.1 deg, or refused."""
    n = repeats(300, 10)
    found = [
        outcome(flattened(('human36m', 'kinect')[seed % 2], 100 + seed, onto=onto))
        for seed in range(n)
    ]
    accepted = [f for f in found if f.reason is None]
    wrong = max((f.error_deg for f in accepted), default=0.0)
    measured(f'{onto}: {len(accepted)} of {n} accepted, off by', wrong, 'deg', n=n)
    if onto == 'plane':
        assert wrong < 0.1
    else:
        assert not accepted


@pytest.mark.fault(28)
@pytest.mark.parametrize(('distance_m', 'tilt_deg'), [(3, 20), (5, 20), (10, 5), (10, 40)])
def test_flat_figures_are_refused_or_right(
    distance_m: float, tilt_deg: float, measured: Measured
) -> None:
    """Whichever way they lean, the wrong one is never accepted."""
    n = repeats(50, 5)
    found = [outcome(flat_figure(100 + seed, distance_m, tilt_deg)) for seed in range(n)]
    n_beyond = sum(f.is_beyond for f in found)
    measured('accepted beyond 3 sigma', 100.0 * n_beyond / n, '%', n=n)
    assert n_beyond == 0


def mirrored(case: Twin, axis: int) -> Twin:
    """Return a case whose MoCap frame is left-handed."""
    turn = np.ones(3)
    turn[axis] = -1.0
    views = [replace(view, x_mocap=view.x_mocap * turn) for view in case.observations.views]
    return case._replace(observations=Observations(tuple(views)))


@pytest.mark.fault(28)
@pytest.mark.fault(17)
def test_left_handed_axes_are_refused(measured: Measured) -> None:
    """Whichever of them is turned."""
    n = repeats(30, 3)
    shapes = ['human36m', 'kinect', 'mpi_inf_3dhp']
    cases = [mirrored(scene(shapes[s % 3], 120, 100 + s), s // 3 % 3) for s in range(n)]
    found = [outcome(case) for case in cases]
    n_accepted = sum(f.reason is None for f in found)
    measured('mirrored accepted', n_accepted, n=n)
    assert n_accepted == 0


@pytest.mark.fault(28)
@pytest.mark.parametrize('ratio', [0.2, 0.5, 1.0])
def test_swapped_labels_are_survived_or_refused(ratio: float, measured: Measured) -> None:
    """In up to half of the frames: right to 0.1 deg; in all of them: refused."""
    n = repeats(20, 2)
    found = [
        outcome(scene('human36m', 200, 100 + seed, outlier_ratio=ratio, kind='swap'))
        for seed in range(n)
    ]
    accepted = [f for f in found if f.reason is None]
    if ratio == 1.0:
        measured('all swapped accepted', len(accepted), n=n)
        assert not accepted
        return
    worst = max(f.error_deg for f in accepted)
    measured('swapped', worst, 'deg', n=n)
    assert len(accepted) == n
    assert worst < 0.1


@pytest.mark.fault(29)
@pytest.mark.parametrize('kind', ['uniform', 'swap', 'failure', 'mixed'])
@pytest.mark.parametrize('ratio', [0.0, 0.3, 0.6])
def test_outliers_up_to_sixty_percent_do_not_matter(
    kind: OutlierKind, ratio: float, measured: Measured
) -> None:
    """Right to 0.3 deg in every recording."""
    n = repeats(10, 1)
    found = [
        outcome(scene('human36m', 150, 200 + seed, outlier_ratio=ratio, kind=kind))
        for seed in range(n)
    ]
    assert all(f.reason is None for f in found), Counter(f.reason for f in found)
    worst = max(f.error_deg for f in found)
    measured('up to 60 %', worst, 'deg', n=n)
    assert worst < 0.3


@pytest.mark.fault(29)
@pytest.mark.parametrize('kind', ['uniform', 'failure'])
def test_nothing_but_outliers_is_refused(kind: OutlierKind, measured: Measured) -> None:
    """A hundred recordings, of one camera and of four."""
    n = repeats(50, 3)
    shapes = ['human36m', 'kinect', 'aistpp']
    found = [
        outcome(scene(shapes[seed % 3], 100, 300 + seed, outlier_ratio=1.0, kind=kind))
        for seed in range(n)
    ]
    n_accepted = sum(f.reason is None for f in found)
    measured('100 % accepted', n_accepted, n=n)
    assert n_accepted == 0


@pytest.mark.fault(31)
@pytest.mark.parametrize('config', [CalibrationConfig(), CalibrationConfig.thorough()])
def test_threads_of_opencv_do_not_change_a_bit(
    config: CalibrationConfig, measured: Measured
) -> None:
    """Five runs, with one and with two threads."""
    case = scene('human36m', 200, 7, outlier_ratio=0.2, kind='mixed')
    seen: set[bytes] = set()
    threads = cv2.getNumThreads()
    try:
        for n in (1, 2, 1, 2, 2):
            cv2.setNumThreads(n)
            found = calibrate(case.cameras, case.observations, config=config)
            seen.add(found.world_T_mocap.matrix.tobytes() + found.covariance.tobytes())
    finally:
        cv2.setNumThreads(threads)
    measured('different results less one', len(seen) - 1, n=5)
    assert len(seen) == 1


@pytest.mark.fault(32)
@pytest.mark.parametrize(
    ('shape', 'faults'),
    [
        ('human36m', {}),
        ('aistpp', {}),
        ('human36m', {'bias_m': 0.02}),
        ('aistpp', {'bias_m': 0.02}),
    ],
)
def test_reported_sigma_is_that_of_the_errors(
    shape: str, faults: dict[str, Any], measured: Measured
) -> None:
    """Mean normalised squared error of many recordings, with and without biased joints."""
    n = repeats(60, 10)
    open_gates = CalibrationConfig().with_stage(
        'accept', max_sigma_deg=180.0, max_sigma_m=100.0, min_motion_m=0.0
    )
    figures = []
    for seed in range(n):
        case = scene(shape, 80, 400 + seed, **faults)
        found = calibrate(case.cameras, case.observations, config=open_gates)
        figures.append(nees(found, case.truth.world_T_mocap))
    whole, rotation, centroid = (float(f) for f in np.mean(figures, axis=0))
    # The few of every day scatter: 10 draws of a chi-square by 0.26 of their mean.
    slack = 1.0 if n >= 60 else 1.7
    if faults:
        measured('with bias: rotation', rotation, n=n)
        measured('with bias: centroid', centroid, n=n)
        assert 0.5 / slack < rotation < 2.0 * slack
        assert 0.5 / slack < centroid < 2.0 * slack
    else:
        measured('iid: NEES/6', whole, n=n)
        assert 0.5 / slack < whole < 1.4 * slack


@pytest.mark.fault(33)
@pytest.mark.parametrize(
    'change',
    [
        pytest.param(WRONG[0], id='short'),
        pytest.param(WRONG[1], id='long'),
        pytest.param(WRONG[2], id='lens left out'),
    ],
)
def test_wrong_intrinsics_are_covered_by_the_sigma(
    change: dict[str, Any], measured: Measured
) -> None:
    """All cameras wrong by one percent, or without their lens: never beyond three sigma."""
    n = repeats(15, 2)
    found = [outcome(wrong_cameras(scene('human36m', 200, 500 + s), change)) for s in range(n)]
    n_beyond = sum(f.is_beyond for f in found)
    measured('beyond 3 sigma', 100.0 * n_beyond / n, '%', n=n)
    assert n_beyond == 0
    for f in found:
        assert f.calibration is None or len(f.calibration.per_camera) == 4
