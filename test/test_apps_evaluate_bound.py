# SPDX-License-Identifier: Apache-2.0
"""The yardstick of an evaluation: the bound, what it is worth, and what is said of it."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from dataset_trees import plan

from rpgd_ros.apps import evaluate
from rpgd_ros.apps.bench_problems import Case, build, cramer_rao
from rpgd_ros.apps.evaluate_bound import yardstick
from rpgd_ros.apps.evaluate_sequence import METHODS, Row, empty_row
from rpgd_ros.apps.evaluate_tables import conclusions, over_bound
from rpgd_ros.core import Observations, View
from rpgd_ros.datasets import DatasetSequence
from rpgd_ros.report.sequences import Panel, write_plots
from rpgd_ros.simulation import Faults
from rpgd_ros.simulation.dataset_writers import write_twin

BIAS_M = 0.02


def sequence(case: Case) -> DatasetSequence:
    """Return a problem as a dataset gives it."""
    problem = build(case)
    return DatasetSequence('x', problem.cameras, problem.observations, problem.truth.world_T_mocap)


@pytest.mark.parametrize('name', ['mpi_inf_3dhp', 'human36m', 'aistpp'])
def test_bound_from_the_residuals_is_the_one_of_the_known_noise(name: str) -> None:
    """Scale, tail and outliers are found within two percent of the bound that was told them."""
    case = Case(name, 200, 1, 'swap', 0.1)
    measured, known = yardstick(sequence(case)), cramer_rao(build(case))
    assert measured is not None
    assert measured.bound.points_m == pytest.approx(known.points_m, rel=0.02)
    assert measured.bound.rotation_deg == pytest.approx(known.rotation_deg, rel=0.02)
    assert measured.lasting_px == 0.0


def test_long_sequence_has_the_bound_of_all_its_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    """The information is taken of a part of them, and scaled."""
    given = sequence(Case('human36m', 300, 0))
    whole = yardstick(given)
    monkeypatch.setattr('rpgd_ros.apps.evaluate_bound.POINTS', 5000)
    part = yardstick(given)
    assert whole is not None
    assert part is not None
    assert part.bound.points_m == pytest.approx(whole.bound.points_m, rel=0.03)


@pytest.mark.parametrize('name', ['mpi_inf_3dhp', 'human36m', 'aistpp'])
def test_joints_that_differ_last_from_frame_to_frame(name: str) -> None:
    """20 mm at 4 m are some 5 px, whatever the noise."""
    measured = yardstick(sequence(Case(name, 200, 1, bias_m=BIAS_M)))
    assert measured is not None
    assert 2.0 < measured.lasting_px < 12.0


def test_sequence_without_keypoints_has_no_yardstick() -> None:
    """Nor one of a single point, which leaves the pose free."""
    given = sequence(Case('human36m', 20, 0))
    for n_left in (0, 1):
        views = tuple(
            View(v.stamp_ns, v.x_mocap, np.full_like(v.uv, np.nan))
            for v in given.observations.views
        )
        views[0].uv[:n_left, 0] = given.observations.views[0].uv[:n_left, 0]
        assert yardstick(replace(given, observations=Observations(views))) is None


def row(name: str, **figures: float) -> Row:
    """Return a row with figures."""
    return empty_row(name) | {'frames': 10, 'lasting_px': 0.0, 'bound_mm': 1.0} | figures


def test_error_over_the_bound_is_of_all_sequences_together() -> None:
    """RMS by RMS; sequences whose errors last are not counted."""
    rows = [
        row('a', default_mm=3.0),
        row('b', default_mm=4.0, bound_mm=7.0),
        row('c', default_mm=99.0, lasting_px=2.0),
    ]
    assert over_bound(rows, 'default') == pytest.approx(np.sqrt(25.0 / 50.0))


def test_what_does_not_hold_is_said() -> None:
    """A pose missing, an error too large: never 'holds'."""
    good = row('a', gt_px=1.0, default_px=1.0, default_mm=1.1)
    assert 'NOT' not in conclusions([good], ['default'])[0]
    far = good | {'default_mm': 1.3}
    assert (
        'error 1.30 x the bound (wanted <= 1.2: does NOT hold)' in conclusions([far], METHODS)[0]
    )
    worse = good | {'default_px': 1.001}
    assert '1.00100 x GT (wanted <= 1.0005: does NOT hold)' in conclusions([worse], METHODS)[0]
    none = good | {'default_px': float('nan')}
    assert 'does NOT hold' in conclusions([none, good], METHODS)[0]


def test_biased_twin_is_judged_by_millimetres_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The report says that the better pose can have the higher MPJPE, and gives no bound."""
    tree = tmp_path / 'tree'
    tree.mkdir()
    biased = replace(plan('aistpp', sequences=3, seconds=2.0), faults=Faults(bias_m=BIAS_M))
    write_twin(biased, tree)
    results = ['--results', str(tmp_path / 'results'), '--csv', str(tmp_path / 'rows.csv')]
    line = [str(tree), '--dataset', 'aistpp', '--methods', 'default', '--jobs', '1', *results]
    assert evaluate.main(line) == 0
    out = capsys.readouterr().out
    assert 'In 3 of 3 sequences residuals' in out
    assert 'the better pose can have the higher MPJPE' in out
    assert 'mm alone decides' in out
    assert 'holds)' not in out
    found = re.search(r'default: ([\d.]+) mm', out)
    assert found is not None
    assert 0.1 < float(found[1]) < 20.0
    default = next(text for text in out.splitlines() if text.startswith('| default '))
    assert default.split('|')[6].strip() == '-'


def test_pixels_that_would_have_judged_otherwise_are_counted() -> None:
    """Nearer with the higher MPJPE, and below the MPJPE of the truth."""
    one = row(
        'a', gt_px=5.0, default_px=4.9, rpgd_px=4.8, default_mm=2.0, rpgd_mm=6.0, lasting_px=4.0
    )
    (text,) = conclusions([one, one | {'rpgd_mm': 1.0}], ['rpgd', 'default'])
    assert 'default is nearer than RPGD in 1, in 1 of these with the higher MPJPE' in text
    assert 'Its MPJPE is below that of the true pose in 2.' in text


def test_plots_show_every_sequence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Three plots with all methods, the published means, and no address to load from."""
    pytest.importorskip('plotly')
    tree, page = tmp_path / 'tree', tmp_path / 'plots.html'
    tree.mkdir()
    write_twin(plan('aistpp', sequences=2, seconds=0.5), tree)
    line = [str(tree), '--dataset', 'aistpp', '--results', str(tmp_path / 'results')]
    assert evaluate.main([*line, '--plots', str(page), '--jobs', '1']) == 0
    assert 'aistpp: 2 sequences' in capsys.readouterr().out
    text = page.read_text()
    for wanted in ('GT', 'RANSAC-P3P', 'RPGD', 'default', 'Cramer-Rao bound', 'RPGD, published'):
        assert f'"{wanted}"' in text
    assert text.count('gBR_sBM_cAll_d04_mBR0_ch02') >= 3
    assert not re.search(r'<(script|link|img)[^>]*="http', text)


def test_name_of_a_sequence_cannot_leave_its_plot(tmp_path: Path) -> None:
    """Names are those of somebody else's files."""
    pytest.importorskip('plotly')
    hostile = '</script><script>alert(1)</script>'
    panels = [Panel('px', {'GT': np.array([1.0])})]
    write_plots(tmp_path / 'page.html', 'x', [hostile], panels)
    assert hostile not in (tmp_path / 'page.html').read_text()


def test_plots_without_their_library_are_refused_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 2, and how to have it."""
    monkeypatch.setattr('rpgd_ros.report.sequences.find_spec', lambda _name: None)
    line = [str(tmp_path), '--dataset', 'aistpp', '--plots', str(tmp_path / 'x.html')]
    assert evaluate.main(line) == 2
    assert "pip install 'rpgd_ros[report]'" in capsys.readouterr().err
