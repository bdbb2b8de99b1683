# SPDX-License-Identifier: Apache-2.0
"""The terminal shows how fast it goes and how long it takes; pipes and NO_COLOR are respected."""

from __future__ import annotations

import io
from threading import Event

import numpy as np
import pytest
from rich.console import Console

from rpgd_ros.apps.progress import bar_columns, one_bar
from rpgd_ros.apps.stopping import Stopped
from rpgd_ros.apps.tables import print_calibration, print_streams
from rpgd_ros.core import CalibrationConfig, RigidTransform
from rpgd_ros.core.result import Calibration, GroupFit
from rpgd_ros.report import StreamCount


def terminal() -> Console:
    """Return a terminal that takes notes."""
    return Console(file=io.StringIO(), force_terminal=True, width=100)


def written(console: Console) -> str:
    """Return what a console has shown."""
    file = console.file
    assert isinstance(file, io.StringIO)
    return file.getvalue()


def test_a_terminal_sees_stage_share_rate_and_time_left() -> None:
    """Rates count what is worked through, where that is known."""
    console = terminal()
    now = [0.0]
    console.get_time = lambda: now[0]
    with one_bar(console, Event(), {'reading': (1000, 'messages')}) as tell:
        for k in range(1, 6):
            now[0] += 1.0
            tell('reading', 0.1 * k)
    shown = written(console)
    assert 'reading' in shown
    assert '50 %' in shown
    assert '100 messages/s' in shown
    assert '0:00:05' in shown


def test_slow_things_are_counted_by_the_minute() -> None:
    """Half a sequence a minute is not 0 a second."""
    _, _, _, rate, _ = bar_columns()

    class Task:
        speed = 0.01
        fields: dict[str, object] = {'things': (1.0, 'sequences')}  # noqa: RUF012

    assert str(rate.render(Task())) == '0.6 sequences/min'  # type: ignore[arg-type]


def test_a_pipe_gets_no_bar() -> None:
    """Logs stay readable."""
    console = Console(file=io.StringIO(), force_terminal=False)
    with one_bar(console, Event()) as tell:
        tell('reading', 0.5)
    assert written(console).strip() == ''


def test_a_stop_ends_the_run_at_the_next_report() -> None:
    """Through every clean-up."""
    stop = Event()
    stop.set()
    with pytest.raises(Stopped), one_bar(terminal(), stop) as tell:
        tell('reading', 0.1)


def calibration() -> Calibration:
    """Make a result with one camera."""
    fit = GroupFit('cam[red]0', 100, 90, 3.0, 2.0, (0.1, -0.1))
    return Calibration(
        world_T_mocap=RigidTransform.identity(), covariance=1e-8 * np.eye(6), mpjpe_px=3.0,
        median_px=2.0, p95_px=9.0, inlier_ratio=0.9, inliers=90, correspondences=100, frames=10,
        threshold_px=6.0, centroid_mocap=np.zeros(3), per_camera={fit.name: fit}, per_joint={},
        config=CalibrationConfig(), warnings=('look [bold]here[/bold]',),
    )  # fmt: skip


@pytest.mark.parametrize('variable', ['NO_COLOR', ''])
def test_colours_are_off_when_asked(monkeypatch: pytest.MonkeyPatch, variable: str) -> None:
    """Tables of a terminal are bold at most; NO_COLOR takes every colour."""
    monkeypatch.delenv('NO_COLOR', raising=False)
    if variable:
        monkeypatch.setenv(variable, '1')
    console = terminal()
    print_calibration(console, calibration(), 'world', 'mocap')
    assert console.no_color == bool(variable)
    assert not any(f'\x1b[3{n}' in written(console) for n in range(1, 8)) or not variable


def test_names_with_brackets_are_printed_as_they_are() -> None:
    """They are names, no orders to the terminal."""
    console = terminal()
    print_calibration(console, calibration(), 'world[b]', 'mocap')
    print_streams(console, [StreamCount('cam[red]0', '/a[bold]', 1, 1, 1, {})])
    shown = written(console)
    for name in ('cam[red]0', 'world[b]', '/a[bold]', 'look [bold]here[/bold]'):
        assert name in shown
