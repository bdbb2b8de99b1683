# SPDX-License-Identifier: Apache-2.0
"""The faults and threats that the package has to survive: what each is, and what is asked for.

A test says with `@pytest.mark.fault(12)` or `@pytest.mark.threat('S5')` which of them it shows,
and with the fixture `measured` what came out. `faults.py` runs these tests and prints the table;
with `@pytest.mark.fault(7, rounds=10)` it runs a test ten times, for what may be luck once.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import NamedTuple

import pytest

# Set by `make faults`: all repeats. The tests of every day do a few of them.
IS_FULL = bool(os.environ.get('RPGD_ROS_FAULTS'))


class Row(NamedTuple):
    """One line of the table.

    Attributes:
        title: The fault.
        bar: What is asked for.

    """

    title: str
    bar: str


ROWS: dict[str, Row] = {
    '1': Row('SIGTERM in a save', 'exit 0 in 2 s, file old or new, no temp left'),
    '2': Row('SIGINT in a save', 'as 1, no traceback'),
    '3': Row('SIGKILL in a save', '0 of 60 unreadable, leftovers removed at the next start'),
    '4': Row('signal in a computation', 'exit 0 in 2 s, caller hears "cancelled"'),
    '5': Row('SIGKILL and restart', 'answered in 25 s, old result published in 2 s of the start'),
    '6': Row('start/stop loop', 'every exit 0 in 3 s, at most 2 entries of shared memory more'),
    '7': Row('exception in a callback', 'node lives, all counted, WARN in 2 s'),
    '8': Row('flood', 'at most 30 MiB more, call answered, drops counted'),
    '9': Row('oversized message', 'refused by its length in 50 ms, next one used, counted'),
    '10': Row('malformed message', '0 crashes of 200, counted by reason, result unchanged'),
    '11': Row('NaN, Inf, 1e300', 'never a non-finite output, nor a warning of numpy'),
    '12': Row('order, duplicates, zero and future stamps', 'pairs are those of the sorted unique'),
    '13': Row('clock jump, bag loop', '95 % of the pairs after it, cleared once, no mix'),
    '14': Row('clock offset', 'found within a frame, or warned'),
    '15': Row('QoS mismatch', 'works either way, else ERROR with topic and policy in 2 s'),
    '16': Row('camera missing, dying, K changed', 'the others calibrate, named in 3 s, no mix'),
    '17': Row('units, axes, frame wrong', 'refused by name'),
    '18': Row('concurrent calls', '1 runs, the others hear "busy" in 0.2 s, bitwise as alone'),
    '19': Row('parameter set in a run', 'each answered in 0.1 s, run keeps its settings'),
    '20': Row('bad parameter file', 'exit 2 in 3 s, one line with the key'),
    '21': Row('recalibration, late joiners', 'all see the new transform in 1 s, |q| = 1 to 1e-9'),
    '22': Row('damaged bag', 'exit 1, 2 or 3 or a result; no traceback, no hang of 30 s'),
    '23': Row('corrupt camera or result file', 'our error with path and key, no default taken'),
    '24': Row('disk full, folder gone', 'errno text, old file intact, savable later, no temp'),
    '25': Row('several savers, a reader', '0 torn reads, mode 0644'),
    '26': Row('still, turning, far away', 'wrong beyond 3 sigma in at most 2 %, still refused'),
    '27': Row('joints on a line, plane, point', 'refused, or right to 0.1 deg'),
    '28': Row('mirror, swapped labels', 'never accepted and wrong; swap <= 50 % right to 0.1 deg'),
    '29': Row('outliers, too few points', '<= 60 %: 0.3 deg; 100 % refused; < 6 points refused'),
    '30': Row('solver returns garbage', 'truth in all, no pose non-finite or behind the camera'),
    '31': Row('same input, another result', 'bit for bit, live = replay'),
    '32': Row('dishonest sigma', 'NEES/6 in 0.5 to 1.4 iid; NEES/3 in 0.5 to 2 with bias'),
    '33': Row('wrong intrinsics', 'reported, never accepted beyond 3 sigma'),
    '34': Row('gradient near singular angles', 'numeric to 1e-6, same optimum'),
    '35': Row('soak', '< 1 MiB/min, threads and descriptors constant, every call answered'),
    'S1': Row('pickle', 'the marker file never appears'),
    'S2': Row('YAML', 'typed error in 1 s, at most 50 MiB more'),
    'S3': Row('path from the network', 'no service takes one, links refused'),
    'S4': Row('predictable temporary files', 'a planted link is not followed'),
    'S5': Row('decompression bombs', 'exit 1 or 2 in 10 s, peak 300 MiB, TMPDIR as before'),
    'S6': Row('open network', 'a node with discovery OFF is unseen'),
    'S7': Row('who may call', 'SROS2 policy names exactly the endpoints'),
    'S8': Row('limits', 'cap + 1 is refused, or the oldest dropped'),
    'S9': Row('log floods', '10 000 bad messages: at most 20 lines, foreign text cut'),
    'S10': Row('supply', 'every dependency bounded'),
}


class Figure(NamedTuple):
    """What one test measured.

    Attributes:
        what: Of what.
        value: Its worst, None where the text says it all.
        unit: Of the value.
        n: Number of repeats behind it.

    """

    what: str
    value: float | None
    unit: str
    n: int


class Measured:
    """Takes the figures of a test."""

    def __init__(self, figures: list[Figure]) -> None:
        """Note them in a list."""
        self._figures = figures

    def __call__(
        self, what: str, value: float | None = None, unit: str = '', *, n: int = 1
    ) -> None:
        """Note a figure: of several of the same name and unit the table shows the largest."""
        self._figures.append(Figure(what, value, unit, n))


@pytest.fixture
def measured(request: pytest.FixtureRequest) -> Iterator[Measured]:
    """Return where a test of a fault puts its figures."""
    figures: list[Figure] = []
    yield Measured(figures)
    request.node.user_properties += [('measured', tuple(figure)) for figure in figures]


@pytest.fixture
def fault_round() -> int:
    """Return which round of a test it is; `faults.py` counts them up."""
    return 0


def repeats(full: int, few: int) -> int:
    """Return how often to repeat: all of it in `make faults`, a few times every day."""
    return full if IS_FULL else few


def within(seconds: float) -> float:
    """Return how long something may take: in `make faults` what is asked for, every day more.

    A machine that does other things beside the tests says nothing about the package.
    """
    return seconds if IS_FULL else 10.0 * seconds


def rows_of(item: pytest.Item) -> list[str]:
    """Return the rows that a test shows.

    Raises:
        pytest.UsageError: There is no such row.

    """
    rows = [str(row) for mark in item.iter_markers('fault') for row in mark.args]
    rows += [str(row) for mark in item.iter_markers('threat') for row in mark.args]
    for row in rows:
        if row not in ROWS:
            msg = f'{item.nodeid}: there is no fault or threat {row!r}'
            raise pytest.UsageError(msg)
    return rows
