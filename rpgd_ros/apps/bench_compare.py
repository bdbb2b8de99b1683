# SPDX-License-Identifier: Apache-2.0
"""Tables of solvers side by side, from the figures of single solves."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from rpgd_ros.apps.bench_run import figure, markdown
from rpgd_ros.core.geometry import Array

Row = dict[str, Any]
Cell = dict[str, list[Row]]  # rows by solver, in the order of the seeds


def accuracy(rows: Sequence[Row], ours: str) -> str:
    """Return a table with a line for each kind of problem and solver."""
    header = (
        'data', 'T', 'solver', 'right', 'MPJPE px', 'x GT', 'error mm', 'x bound', 'ms',
        f'{ours}: error', 'time',
    )  # fmt: skip
    lines = []
    for cell in _cells(rows):
        for name, runs in cell.items():
            first = runs[0]
            lines.append(
                [
                    first['data'],
                    str(first['frames']),
                    name,
                    _count(runs),
                    figure(_median(_column(runs, 'mpjpe_px')), 4),
                    figure(_median(_column(runs, 'mpjpe_px') / _column(runs, 'gt_px')), 5),
                    figure(_rms_error(runs)),
                    figure(_rms_error(runs) / _rms(_column(runs, 'bound_mm'))),
                    figure(_median(_column(runs, 'ms'))),
                    *_factors(cell, ours, name),
                ]
            )
    return markdown(header, lines)


def robustness(rows: Sequence[Row], ours: str) -> str:
    """Return a table with a line for each kind of problem, and a column for each solver."""
    lines, solvers = [], list(dict.fromkeys(row['solver'] for row in rows))
    for cell in _cells(rows):
        first = next(iter(cell.values()))[0]
        lines.append([first['data'], f'{first["kind"]} {first["ratio"]:g}'])
        for name, runs in cell.items():
            error = f'{figure(_rms_error(runs))} mm'
            time = f'{figure(_median(_column(runs, "ms")))} ms'
            factors = _factors(cell, ours, name)
            parts = [f'{p} ({f})' if f else p for p, f in zip((error, time), factors, strict=True)]
            lines[-1].append(', '.join([_count(runs), *parts]))
    return markdown(('data', 'outliers', *solvers), lines)


def _cells(rows: Sequence[Row]) -> Iterator[Cell]:
    """Yield the rows of each kind of problem, whatever its seed."""
    cells: dict[tuple[Any, ...], Cell] = {}
    for row in rows:
        kind = tuple(row[name] for name in ('data', 'frames', 'kind', 'ratio'))
        cells.setdefault(kind, {}).setdefault(row['solver'], []).append(row)
    yield from cells.values()


def _factors(cell: Cell, ours: str, name: str) -> tuple[str, str]:
    """Our error and time by those of another solver, on the same problems."""
    if name == ours or ours not in cell:
        return '', ''
    both = [
        (a, b)
        for a, b in zip(cell[ours], cell[name], strict=True)
        if a['is_right'] and b['is_right']
    ]
    mine, theirs = [a for a, _ in both], [b for _, b in both]
    error = _rms(_column(mine, 'mm')) / _rms(_column(theirs, 'mm')) if both else np.nan
    time = _median(_column(cell[ours], 'ms') / _column(cell[name], 'ms'))
    return figure(error), figure(time)


def _count(runs: Sequence[Row]) -> str:
    return f'{sum(row["is_right"] for row in runs)}/{len(runs)}'


def _rms_error(runs: Sequence[Row]) -> float:
    """RMS error of the right runs, millimetres."""
    return _rms(_column([row for row in runs if row['is_right']], 'mm'))


def _column(runs: Sequence[Row], name: str) -> Array:
    return np.array([row[name] for row in runs], dtype=np.float64)


def _median(values: Array) -> float:
    """Median of what is known; NaN without any."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else float('nan')


def _rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean())) if len(values) else float('nan')
