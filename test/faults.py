# SPDX-License-Identifier: Apache-2.0
"""Runs the tests of all faults and threats and prints what each of them measured.

`python test/faults.py [--long] [rows ...]`: the long ones (soak, fuzzing, start and stop a hundred
times) take an hour, the others 25 minutes.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

TEST = Path(__file__).parent
os.environ['RPGD_ROS_FAULTS'] = 'full'  # before fault_report is imported

import pytest  # noqa: E402
from fault_report import ROWS, Figure, rows_of  # noqa: E402
from rich.console import Console  # noqa: E402
from rich.table import Table  # noqa: E402


class Collector:
    """A plugin that keeps the tests of some rows and their outcome.

    Attributes:
        outcomes: Outcomes of the tests by row.
        figures: What they measured by row.
        n_repeats: How often by row.
        seconds: How long by row.

    """

    def __init__(self, rows: Sequence[str]) -> None:
        """Keep the tests of these rows, of all where none is given."""
        self._wanted = set(rows) or set(ROWS)
        self._rows: dict[str, list[str]] = {}
        self.outcomes: dict[str, list[str]] = defaultdict(list)
        self.figures: dict[str, list[Figure]] = defaultdict(list)
        self.n_repeats: dict[str, int] = defaultdict(int)
        self.seconds: dict[str, float] = defaultdict(float)

    def pytest_generate_tests(self, metafunc: pytest.Metafunc) -> None:
        """Do ten rounds of a test that says so: once may be luck among processes."""
        marks = metafunc.definition.iter_markers('fault')
        n_rounds = max((int(mark.kwargs.get('rounds', 1)) for mark in marks), default=1)
        if n_rounds > 1:
            metafunc.fixturenames.append('fault_round')
            metafunc.parametrize('fault_round', range(n_rounds))

    def pytest_collection_modifyitems(
        self, config: pytest.Config, items: list[pytest.Item]
    ) -> None:
        """Leave out what shows none of the rows."""
        for item in items:
            self._rows[item.nodeid] = [row for row in rows_of(item) if row in self._wanted]
        config.hook.pytest_deselected(items=[i for i in items if not self._rows[i.nodeid]])
        items[:] = [item for item in items if self._rows[item.nodeid]]

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note how a test ended; of setup and teardown, only failures."""
        for row in self._rows[report.nodeid]:
            self.seconds[row] += report.duration
            if report.when != 'call' and report.outcome == 'passed':
                continue
            self.outcomes[row].append(report.outcome)
        if report.when == 'teardown':
            values = [v for key, v in report.user_properties if key == 'measured']
            figures = [Figure(*v) for v in values if isinstance(v, tuple)]
            for row in self._rows[report.nodeid]:
                self.figures[row] += figures
                self.n_repeats[row] += repeats_of(figures)

    def verdict(self, row: str) -> str:
        """Say how a row did."""
        outcomes = self.outcomes[row]
        if 'failed' in outcomes:
            return f'FAIL ({outcomes.count("failed")} of {len(outcomes)})'
        if 'passed' not in outcomes:
            return 'skipped' if outcomes else 'no test'
        n_skipped = outcomes.count('skipped')
        return f'pass ({n_skipped} skipped or known to fail)' if n_skipped else 'pass'


def repeats_of(figures: Sequence[Figure]) -> int:
    """Return how often a test did what it measured, of the figure that it measured most."""
    n: dict[str, int] = defaultdict(int)
    for figure in figures:
        n[figure.what] += figure.n
    return max(n.values(), default=1)


def summary(figures: Sequence[Figure]) -> str:
    """Return the worst of the figures of each name, and how often a text without one came."""
    worst: dict[tuple[str, str], float | None] = {}
    for figure in figures:
        key = figure.what, figure.unit
        before = worst.get(key)
        both = [value for value in (before, figure.value) if value is not None]
        worst[key] = max(both) if both else None
    return '; '.join(
        what if value is None else f'{what} {value:.3g} {unit}'.strip()
        for (what, unit), value in worst.items()
    )


def table(found: Collector, rows: Sequence[str]) -> Table:
    """Return the table of some rows."""
    out = Table('fault', 'tests', 'repeats', 'measured', 'bar', 'passed', 's')
    for row in rows:
        title, bar = ROWS[row]
        verdict = found.verdict(row)
        colour = 'green' if verdict.startswith('pass') else 'red'
        out.add_row(
            f'{row} {title}',
            str(len(found.outcomes[row])),
            str(found.n_repeats[row]),
            summary(found.figures[row]),
            bar,
            f'[{colour}]{verdict}[/]',
            f'{found.seconds[row]:.0f}',
        )
    return out


def main(argv: Sequence[str] | None = None) -> int:
    """Run the tests; return 0 where every row passed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--long', action='store_true', help='the long ones only')
    parser.add_argument('rows', nargs='*', choices=[*ROWS, []], help='these only')
    arguments = parser.parse_args(argv)
    found = Collector(arguments.rows)
    files = [str(path) for path in sorted(TEST.glob('long_*.py'))] if arguments.long else []
    start = time.monotonic()
    code = pytest.main(['-q', '--no-header', *(files or [str(TEST)])], plugins=[found])
    rows = arguments.rows or (list(found.outcomes) if arguments.long else list(ROWS))
    console = Console(width=None if sys.stdout.isatty() else 200)
    console.print(table(found, sorted(rows, key=list(ROWS).index)))
    n_bad = sum(not found.verdict(row).startswith('pass') for row in rows)
    minutes = (time.monotonic() - start) / 60
    console.print(f'{len(rows) - n_bad} of {len(rows)} passed, {minutes:.1f} min')
    return int(code) or int(n_bad > 0)


if __name__ == '__main__':
    sys.exit(main())
