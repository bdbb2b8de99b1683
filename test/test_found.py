# SPDX-License-Identifier: Apache-2.0
"""What was found beside the transform reaches terminal, page and diagnostics."""

from __future__ import annotations

import importlib.util
import re
from dataclasses import replace
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from test_io_found import full
from test_report_page import case_of

from rpgd_ros.apps.found_tables import found_rows
from rpgd_ros.apps.tables import print_calibration
from rpgd_ros.core import Calibration
from rpgd_ros.report import write_report
from rpgd_ros.report.blocks import Table
from rpgd_ros.report.found import lenses, signed, weakest_axis
from rpgd_ros.ros.found import found_figures

needs_libraries = pytest.mark.skipif(
    not all(map(importlib.util.find_spec, ('plotly', 'jinja2'))), reason='needs the extra report'
)


def printed(calibration: Calibration) -> str:
    """Return what the terminal shows."""
    text = StringIO()
    print_calibration(Console(file=text, width=200), calibration, 'world', 'mocap')
    return text.getvalue()


def test_the_terminal_shows_each_finding_with_its_sigma() -> None:
    """Clocks with rates, lenses, size, moved cameras, persons, joints; in ms, us, % and mm."""
    rows = dict(found_rows(full()))
    assert rows == {
        'cam0 is late': '41.2 +- 0.3 ms, later by 25.0 +- 1.0 us every second',
        'cam0 focal length': '+1.10 +- 0.05 % longer than given',
        'cam1 focal length': '-0.01 +- 0.05 % longer than given',
        'skeleton': '+2.00 +- 0.10 % larger than given',
        'MoCap frame drifts': '0.20 +- 0.01 deg and 12 +- 1 mm a minute',
        'cam1 was moved': '0.50 +- 0.02 deg, 13 +- 2 mm, 9.5 s after the begin',
        'cam0 or cam1 was moved': '0.50 +- 0.02 deg, 13 +- 2 mm',
        'cam0 shows it': 'shown in 93 % of 300 frames',
    }
    said = printed(full())
    for name, value in rows.items():
        assert re.search(rf'^{re.escape(name)} +{re.escape(value)}', said, re.MULTILINE)
    assert re.search(r'left_hip +\+10 -20 \+3 +4\.0', said)


def test_the_terminal_says_what_cannot_be_seen_with_its_size_and_direction() -> None:
    """Where joints were given offsets, and only there."""
    covariance = np.diag([0, 0, 0, 1e-6, 1e-6, 25e-6]).astype(float)
    said = printed(full(covariance=covariance))
    assert 'cannot be seen' in said
    assert '5.0 mm along (0.00, 0.00, 1.00)' in said
    assert 'cannot be seen' not in printed(full(joint_offset_m={}))


def test_the_weakest_axis_is_that_of_the_largest_variance() -> None:
    """Whatever way eigenvectors point, its largest part is positive."""
    for turn in (1.0, -1.0):
        axis = turn * np.array([0.6, 0.0, -0.8])
        covariance = np.zeros((6, 6))
        covariance[3:, 3:] = 9e-6 * np.outer(axis, axis) + 1e-8 * np.eye(3)
        sigma_m, found = weakest_axis(full(covariance=covariance))
        assert sigma_m == pytest.approx(0.003, rel=0.01)
        assert found == (-0.6, 0.0, 0.8)


def test_a_camera_called_like_markup_is_printed_as_it_is() -> None:
    """Names come from files."""
    assert '[red]cam[/red] is late' in printed(full(time_offset_s={'[red]cam[/red]': (0.1, 0.01)}))


def test_diagnostics_have_every_finding_under_a_key_with_its_unit() -> None:
    """Numbers in ms, ppm, % and mm."""
    values = found_figures(full())
    assert values['time_offset_ms cam0'] == pytest.approx(41.2)
    assert values['time_offset_sigma_ms cam0'] == pytest.approx(0.3)
    assert values['clock_rate_ppm cam0'] == pytest.approx(25.0)
    assert values['focal_error_percent cam0'] == pytest.approx(1.1)
    assert values['focal_error_sigma_percent cam1'] == pytest.approx(0.05)
    assert values['skeleton_scale_percent'] == pytest.approx(2.0)
    assert values['joint_offset_mm left_hip'] == '10.0 -20.0 3.0'
    assert values['joint_offset_sigma_mm left_hip'] == '1.0 1.0 4.0'
    assert values['moved_mm cam1'] == pytest.approx(13.0)
    assert values['moved_since_s cam1'] == pytest.approx(9.5)
    assert values['drift_mm_per_min'] == pytest.approx(12.0)
    assert values['shown_percent cam0'] == pytest.approx(100 * 280 / 300)


def test_nothing_that_was_not_asked_for_has_a_key_or_a_line() -> None:
    """Absence is told by absence, never by a zero."""
    nothing = full(
        time_offset_s={}, clock_rate={}, focal_error={}, skeleton_scale=None, joint_offset_m={},
        disagreements=(), shown={}, drift=None,
    )  # fmt: skip
    assert found_figures(nothing) == {}
    assert list(found_rows(nothing)) == []


def test_the_page_marks_lengths_that_do_not_fit() -> None:
    """More than three sigma and a tenth of a percent: an exact nothing is not marked."""
    shown = full(focal_error={'a': (0.011, 0.0005), 'b': (0.0005, 1e-5), 'c': (0.02, 0.01)})
    table = next(block for block in lenses(shown) if isinstance(block, Table))
    assert table.marked == {0, 3}  # the skeleton is the last


@needs_libraries
def test_the_page_has_a_section_for_what_else_was_found(tmp_path: Path) -> None:
    """Lenses, size, clocks, rates, joints, persons, and what cannot be seen."""
    case, c = case_of(), full()
    assert case.calibration is not None
    joint = next(iter(case.calibration.per_joint))
    calibration = replace(
        case.calibration,
        time_offset_s=c.time_offset_s, clock_rate=c.clock_rate, focal_error=c.focal_error,
        skeleton_scale=c.skeleton_scale, shown=c.shown, drift=c.drift,
        joint_offset_m={joint: c.joint_offset_m['left_hip']},
    )  # fmt: skip
    verdict = write_report(tmp_path / 'r.html', replace(case, calibration=calibration))
    assert 'the MoCap frame drifts by 12' in verdict.headline
    page = (tmp_path / 'r.html').read_text().replace('\N{NO-BREAK SPACE}', ' ')
    section = page[page.index('id="found"') : page.index('id="time"')]
    for text in (
        'What else was found', 'focal length of cam0', '+1.10 %', 'size of the skeleton',
        '+2.00 %', '41.20 ms', '25.0 ± 1.0 µs/s', 'cannot be seen', '93.3 %',
        '12.0 mm', 'creeps', '+10, \N{MINUS SIGN}20, +3', '1.0, 1.0, 4.0',
    ):  # fmt: skip
        assert text in section, text
    assert 'id="joint-offsets"' in section


def test_a_sign_stands_before_what_has_digits_only() -> None:
    """A rounded nothing is neither more nor less."""
    assert signed(0.004, 2) == '0.00'
    assert signed(-0.004, 2) == '0.00'
    assert signed(0.2, 1) == '+0.2'
    assert signed(-0.2, 1) == '\N{MINUS SIGN}0.2'
