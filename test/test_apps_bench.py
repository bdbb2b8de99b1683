# SPDX-License-Identifier: Apache-2.0
"""The bench program: its tables, its yardsticks, and how it ends."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scenes import scene

from rpgd_ros.apps import bench, bench_compare, bench_honesty, bench_published, bench_solver
from rpgd_ros.apps.bench_problems import Case, Error, build, cramer_rao, judge
from rpgd_ros.apps.bench_run import apart, each, figure, markdown, prepare
from rpgd_ros.core import InputError, RigidTransform, calibrate
from rpgd_ros.core.geometry import Array
from rpgd_ros.core.normal import apply_delta
from rpgd_ros.simulation import Twin

TINY = ['--seeds', '2', '--frames', '60', '--jobs', '2']
PEERS = {'poselib-fast': 'poselib', 'poselib-sub-trunc': 'poselib', 'opencv-scipy': 'scipy'}


def run(*options: str, folder: Path) -> tuple[str, list[dict[str, Any]]]:
    """Run the program on tiny problems; return what it wrote, and its figures."""
    files = ['--output', str(folder / 'bench.md'), '--json', str(folder / 'bench.json')]
    assert bench.main([*options, *TINY, *files]) == 0
    figures = json.loads((folder / 'bench.json').read_text())
    return (folder / 'bench.md').read_text(), figures[options[0]]


def table_lines(text: str) -> list[list[str]]:
    """Return the cells of all lines of all tables."""
    return [
        [cell.strip() for cell in line.strip('|').split('|')]
        for line in text.splitlines()
        if line.startswith('|')
    ]


def test_published_method_stands_beside_its_published_figures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Ground truth, RANSAC alone and RPGD; what is printed is what is written."""
    text, rows = run('published', '--data', 'human36m', folder=tmp_path)
    assert capsys.readouterr().out.strip() == text.strip()
    assert len(rows) == 2
    for row in rows:
        assert (row['cameras'], row['joints'], row['frames']) == (4, 32, 60)
        assert row['gt_px'] == pytest.approx(1.2299, rel=1e-3)
        assert row['gt_px'] < row['rpgd_px'] * 1.001 < row['ransac_px']
        assert 0.0 < row['ransac_ms'] < row['rpgd_ms']
    line = table_lines(text)[-1]
    assert line[:3] == ['human36m', '4 x 32', '4 px']
    assert line[-4:] == ['1.2299', '2.5906 (2.106)', '1.2605 (1.025)', '1.2']
    assert '- human36m: RANSAC alone is above GT; RPGD is within 1.025 x GT' in text


def test_solver_is_right_and_near_the_bound(tmp_path: Path) -> None:
    """Without and with outliers, from one problem per seed."""
    options = ['--data', 'human36m', '--solvers', 'rpgd_ros', '--kinds', 'swap']
    text, rows = run('solver', *options, '--ratios', '0.3', folder=tmp_path)
    assert [(row['seed'], row['ratio']) for row in rows] == [(0, 0), (1, 0), (0, 0.3), (1, 0.3)]
    for row in rows:
        assert row['is_right']
        assert not row['complaint']
        assert row['mm'] < 4.0 * row['bound_mm'] < 4.0
        assert 0.0 < row['ms'] < 60_000.0
    assert rows[0]['mpjpe_px'] == pytest.approx(rows[0]['gt_px'], rel=0.01)
    assert rows[0]['bound_mm'] < rows[2]['bound_mm']  # outliers tell nothing
    lines = table_lines(text)
    assert lines[2][:4] == ['human36m', '60', 'rpgd_ros', '2/2']
    assert lines[5][:2] == ['human36m', 'swap 0.3']
    assert lines[5][2].startswith('2/2, ')


def test_covariance_is_weighed_for_both_kinds_of_error(tmp_path: Path) -> None:
    """One line each, and figures that are neither zero nor absurd."""
    text, rows = run('honesty', '--joints', 'h36m17', folder=tmp_path)
    assert [(row['bias_m'], row['seed']) for row in rows] == [(0, 0), (0, 1), (0.02, 0), (0.02, 1)]
    for row in rows:
        assert row['joints'] == 17
        assert all(0.01 < row[name] < 20.0 for name in ('pose', 'rotation', 'centroid'))
    assert [line[:3] for line in table_lines(text)[2:]] == [
        ['independent', '17', '60'],
        ['joints off by 20 mm', '17', '60'],
    ]


@pytest.mark.parametrize(('name', 'library'), PEERS.items())
def test_peer_that_is_not_installed_is_said(
    name: str, library: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The others are measured all the same, and the way to have it is told."""
    monkeypatch.setitem(sys.modules, library, None)
    monkeypatch.delitem(sys.modules, f'rpgd_ros.apps.bench_{library}', raising=False)
    if library == 'scipy':
        monkeypatch.setitem(sys.modules, 'scipy.optimize', None)
    options = ['--data', 'kinect', '--solvers', name, 'rpgd_ros', '--ratios']
    text, rows = run('solver', *options, folder=tmp_path)
    assert f'{name} was left out: ' in text
    assert "pip install -e '.[bench]'" in text
    assert {row['solver'] for row in rows} == {'rpgd_ros'}


@pytest.mark.parametrize(('name', 'library'), PEERS.items())
@pytest.mark.parametrize('shape', ['human36m', 'kinect'])
def test_peer_is_used_as_it_should_be(name: str, library: str, shape: str) -> None:
    """On clean data it is as good as ours: a wrong convention would show at once."""
    pytest.importorskip(library)
    case = Case(shape, 100, 0)
    problem, threshold_px = build(case), 4.0 if shape == 'human36m' else 20.0
    answer = bench_solver.answer_of(name, problem, threshold_px)
    ours = calibrate(problem.cameras, problem.observations).world_T_mocap
    assert answer.pose is not None
    assert judge(problem, answer.pose).points_m < 3.0 * judge(problem, ours).points_m
    assert 0.0 < answer.processor_s < 60.0


@pytest.mark.parametrize('name', ['rpgd_ros', 'published'])
def test_solver_without_an_answer_is_wrong_and_says_why(name: str) -> None:
    """A refusal is no pose."""
    problem = build(Case('human36m', 60, 0))
    for view in problem.observations.views:
        view.uv[:] = np.nan
    answer = bench_solver.answer_of(name, problem, 4.0)
    assert answer.pose is None
    assert 'no_data' in answer.complaint


def test_late_answer_counts_as_none() -> None:
    """The process is ended, and the row says so."""
    prepare()
    (row,) = bench_solver.run(Case('human36m', 60, 0), ['published'], limit_s=0.01)
    assert not row['is_right']
    assert row['complaint'] == 'no answer within 0.01 s'


def test_process_that_dies_is_no_answer() -> None:
    """As when a peer written in C crashes."""
    prepare()
    with pytest.raises(TimeoutError, match='no answer within 1 s'):
        apart(os._exit, 1, limit_s=1.0)


def test_work_is_done_on_one_thread() -> None:
    """BLAS reads the environment, OpenCV too."""
    prepare()
    assert apart(os.getenv, 'OPENBLAS_NUM_THREADS', limit_s=60.0) == '1'
    assert apart(cv2.getNumThreads, limit_s=60.0) == 1
    assert list(each(abs, [-1, 2, -3], jobs=2)) == [1, 2, 3]


@pytest.mark.parametrize('shape', ['human36m', 'aistpp', 'kinect'])
def test_bound_is_that_of_numeric_derivatives(shape: str) -> None:
    """Gaussian noise, Student's t, and noise of the skeleton, from cameras' own projection."""
    problem = build(Case(shape, 12, 0))
    information = numeric_information(problem)
    covariance = np.linalg.inv(information)
    rotation_deg = np.degrees(np.sqrt(np.trace(covariance[:3, :3])))
    truth = problem.truth.world_T_mocap
    x = problem.observations.views[0].x_mocap.reshape(-1, 3)
    pivot = (truth @ x).mean(0)
    rng = np.random.default_rng(0)
    draws = rng.multivariate_normal(np.zeros(6), covariance, 4000)
    apart_m = [
        np.sqrt((((apply_delta(truth, d, pivot) @ x) - (truth @ x)) ** 2).sum(-1).mean())
        for d in draws
    ]
    bound = cramer_rao(problem)
    assert bound.rotation_deg == pytest.approx(rotation_deg, rel=1e-4)
    assert bound.points_m == pytest.approx(np.sqrt(np.mean(np.square(apart_m))), rel=0.03)


def numeric_information(problem: Twin) -> Array:
    """Return the Fisher information (6, 6) about the body's centre by central differences."""
    cameras, observations, truth = problem
    pose, nu, step = truth.world_T_mocap, truth.student_nu, 1e-5
    x = observations.views[0].x_mocap
    pivot = (pose @ x.reshape(-1, 3)).mean(0)
    total = np.zeros((6, 6))
    moved = [
        [apply_delta(pose, sign * step * e, pivot) @ x for sign in (1.0, -1.0)] for e in np.eye(6)
    ]
    shifted = [[(pose @ x) + sign * step * e for sign in (1.0, -1.0)] for e in np.eye(3)]
    for camera, inlier in zip(cameras, truth.inliers, strict=True):
        by_pose, by_point = (
            np.stack([(camera.project(a) - camera.project(b))[inlier] for a, b in pairs], -1)
            / (2.0 * step)
            for pairs in (moved, shifted)
        )
        noise = truth.sigma_m**2 * by_point @ by_point.swapaxes(1, 2)
        noise += truth.sigma_px**2 * np.eye(2)
        weighted = np.linalg.solve(noise, by_pose)
        total += (by_pose.swapaxes(1, 2) @ weighted).sum(0)
    return total * ((nu + 2.0) / (nu + 4.0) if nu else 1.0)


def test_error_is_measured_at_the_body() -> None:
    """A shift moves all points alike, wherever the origins are; a wrong pose is not right."""
    problem = scene(frames=30)
    truth = problem.truth.world_T_mocap
    exact = judge(problem, truth)
    assert exact.rotation_deg < 1e-5
    assert exact.points_m < 1e-9
    shift = np.array([0.03, 0.0, 0.04])
    shifted = judge(problem, RigidTransform(truth.rotation, truth.translation + shift))
    assert shifted.points_m == pytest.approx(0.05)
    assert shifted.mpjpe_px > 5.0 * exact.mpjpe_px
    assert not shifted.is_right
    assert Error(0.49, 0.019, 1.0).is_right
    assert not Error(0.51, 0.019, 1.0).is_right


def test_error_is_weighed_by_the_covariance() -> None:
    """Off by d, the figure is d^T C^-1 d by the dimensions; not off, it is zero."""
    problem = scene(frames=60)
    calibration = calibrate(problem.cameras, problem.observations)
    found = calibration.world_T_mocap
    assert bench_honesty.weigh(calibration, found) == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    d = np.array([1e-3, -2e-3, 5e-4])
    pose, rotation, centroid = bench_honesty.weigh(
        calibration, RigidTransform(found.rotation, found.translation + d)
    )
    whole = np.concatenate([np.zeros(3), d])
    assert pose == pytest.approx(whole @ np.linalg.inv(calibration.covariance) @ whole / 6.0)
    assert rotation == pytest.approx(0.0, abs=1e-9)
    inverse = np.linalg.inv(calibration.centroid_covariance)
    assert centroid == pytest.approx(d @ inverse @ d / 3.0)


def test_words_follow_the_figures() -> None:
    """What was reproduced is said, what was not, too."""

    def said(name: str, ransac: float, rpgd: float) -> str:
        row = {'gt_px': 2.0, 'ransac_px': 2.0 * ransac, 'rpgd_px': 2.0 * rpgd}
        return bench_published.verdict(name, [row] * 3)

    assert said('human36m', 1.3, 1.02) == (
        'human36m: RANSAC alone is above GT; RPGD is within 1.025 x GT; RPGD is below RANSAC.'
    )
    assert 'RPGD is NOT within 1.02 x GT' in said('aistpp', 1.3, 1.03)
    assert 'RANSAC alone is NOT above GT; ' in said('aistpp', 0.99, 1.0)
    assert 'not reproduced: the publication has RANSAC 0.182 px below its RPGD 0.209 px' in said(
        'mpi_inf_3dhp', 1.3, 1.0
    )
    assert 'not reproduced' not in said('mpi_inf_3dhp', 1.1, 1.3)
    assert 'RPGD is at 1.1000 x GT; the publication shows a picture only' in said(
        'kinect', 1.3, 1.1
    )
    assert 'NOT within' in said('human36m', 1.3, float('nan'))


def test_ours_is_compared_on_the_same_problems() -> None:
    """Errors over the problems that both got right; times over all."""

    def row(solver: str, seed: int, mm: float, ms: float) -> dict[str, Any]:
        figures = {'mpjpe_px': 1.0, 'gt_px': 1.0, 'bound_mm': 1.0, 'is_right': mm < 20.0}
        names = {'data': 'human36m', 'frames': 60, 'kind': 'uniform', 'ratio': 0.0}
        return {**names, **figures, 'solver': solver, 'seed': seed, 'mm': mm, 'ms': ms}

    rows = [row('a', 0, 1.0, 10.0), row('b', 0, 2.0, 20.0)]
    rows += [row('a', 1, 3.0, 10.0), row('b', 1, 99.0, 40.0)]
    header, _, ours, theirs = table_lines(bench_compare.accuracy(rows, 'a'))
    assert header[-2:] == ['a: error', 'time']
    assert ours[-2:] == ['', '']
    assert theirs[-2:] == ['0.500', '0.375']
    assert (ours[3], theirs[3]) == ('2/2', '1/2')
    assert table_lines(bench_compare.robustness(rows, 'a'))[-1][2:] == [
        '2/2, 2.24 mm, 10.0 ms',
        '1/2, 2.00 mm (0.500), 30.0 ms (0.375)',
    ]
    nothing = [row('a', 0, 1.0, 10.0), row('b', 0, 99.0, float('nan'))]
    assert table_lines(bench_compare.accuracy(nothing, 'a'))[-1][3:] == [
        '0/1', '1.000', '1.0000', '-', '-', '-', '-', '-',
    ]  # fmt: skip


def test_figures_keep_their_significant_digits() -> None:
    """Small ones are not rounded away, large ones not cut."""
    values = (0.0041234, 0.5, 12.345, 1234.5, 0.0, float('nan'), float('inf'))
    assert [figure(v) for v in values] == ['0.00412', '0.500', '12.3', '1234', '0.00', '-', '-']
    assert markdown(('a', 'long'), [('1', '2')]) == '| a | long |\n| - | ---- |\n| 1 | 2    |'


@pytest.mark.parametrize(
    ('options', 'message'),
    [
        (['speed'], "unknown table 'speed'; known: published, solver, honesty, growth, reading"),
        (['solver', '--ratios', '1.5'], '--ratios must be above 0 and at most 1'),
        (['solver', '--limit', 'nan'], '--limit must be above 0 s'),
        (['--first-seed', '-1'], '--first-seed must be 0 or more'),
        (['--output', 'no/such/file'], 'is no folder: create it first'),
    ],
)
def test_values_out_of_range_are_refused_before_the_work(
    options: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 2, one line."""
    assert bench.main(options) == 2
    said = capsys.readouterr()
    assert message in said.err
    assert not said.out


def test_help_teaches(capsys: pytest.CaptureFixture[str]) -> None:
    """The tables, an example, and what the peers need."""
    with pytest.raises(SystemExit, match='0'):
        bench.main(['--help'])
    said = capsys.readouterr().out
    for words in ('published', 'honesty', '--seeds 20', "pip install -e '.[bench]'"):
        assert words in said


@pytest.mark.parametrize('stop', [signal.SIGINT, signal.SIGTERM])
def test_stopped_run_leaves_no_process(stop: signal.Signals) -> None:
    """The pipes close only when the last process that holds them is gone."""
    command = [sys.executable, '-m', 'rpgd_ros.apps.bench', 'honesty', '--seeds', '1000']
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        cwd=Path(bench.__file__).parents[2],
    )
    assert process.stdout is not None
    assert b'numpy' in process.stdout.readline()
    process.send_signal(stop)
    _, complaint = process.communicate(timeout=30.0)
    assert process.returncode == 130
    assert b'bench: stopped' in complaint
    assert b'Traceback' not in complaint


def test_unknown_data_is_an_input_error() -> None:
    """As everywhere in the package."""
    with pytest.raises(InputError, match='unknown preset'):
        build(Case('moon', 10, 0))
