# SPDX-License-Identifier: Apache-2.0
"""What an evaluation prints and writes: the publication's table, rows, and CSV."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence

import numpy as np
from rich.console import Console

from rpgd_ros.apps.bench_published import PUBLISHED
from rpgd_ros.apps.bench_run import figure, markdown
from rpgd_ros.apps.evaluate_sequence import COLUMNS, METHODS, Row
from rpgd_ros.core.geometry import Array
from rpgd_ros.datasets import DatasetName

JSON_SCHEMA = 1
MAX_ROWS = 40  # more sequences are left to the CSV file
LASTS = '- (lasting)'  # no bound for independent errors says anything there
LABELS = {'ransac': 'RANSAC-P3P', 'rpgd': 'RPGD', 'default': 'default'}
CAPTION = """\
MPJPE: mean over sequences of the mean residual over all correspondences (eq. 7). deg and mm: from
the dataset's own pose, mm as RMS displacement of the body's points; medians over sequences. ms:
reading and solving by the clock on this machine, per instant over all cameras; published: on its
authors'. Poses that the gates refuse (!) count. The MPJPE at the dataset's pose (GT) is no lower
bound: where joints of detector and MoCap differ, a worse pose can have a lower MPJPE and a better
one a higher; then mm decides. x bound: RMS of mm over sequences by that of the Cramer-Rao bound at
the dataset's pose, for independent errors with the spread that the residuals show there."""
# What the default solver has to keep on simulated sequences.
MOST_GT, MOST_BOUND = 1.0005, 1.2


def csv_text(rows: Sequence[Row]) -> str:
    """Return the rows as CSV, one line per sequence; numbers that are not there are empty."""
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator='\n')
    writer.writeheader()
    for row in rows:
        writer.writerow({key: '' if _is_nan(value) else value for key, value in row.items()})
    return text.getvalue()


def json_text(dataset: str, rows: Sequence[Row]) -> str:
    """Return the rows as JSON: `schema`, `dataset`, and `rows` with the columns of the CSV.

    Numbers that are not there are null.
    """
    table = [
        {key: None if _is_nan(row[key]) else row[key] for key in COLUMNS if key in row}
        for row in rows
    ]
    tree = {'schema': JSON_SCHEMA, 'dataset': dataset, 'rows': table}
    return json.dumps(tree, indent=2, default=float)


def _is_nan(value: object) -> bool:
    return isinstance(value, float) and np.isnan(value)


def solved(rows: Sequence[Row]) -> list[Row]:
    """Return the rows of sequences that were neither left out nor unreadable."""
    return [row for row in rows if not (row['left_out'] or row['error'])]


def print_results(
    console: Console, dataset: DatasetName, rows: Sequence[Row], methods: Sequence[str] = METHODS
) -> None:
    """Print rows and table; nothing where nothing was solved."""
    counted = solved(rows)
    if not counted:
        return
    frames = int(sum(row['frames'] for row in counted))
    paragraphs = [
        f'{dataset}: {len(counted)} sequences, {frames} frames',
        _by_method(dataset, counted, methods),
        CAPTION.replace('\n', ' '),
        *conclusions(counted, methods),
    ]
    if len(counted) <= MAX_ROWS:
        paragraphs.insert(0, _by_sequence(counted, methods))
    # soft_wrap: a table that is cut at 80 columns where nobody watches is of no use.
    console.print('\n\n'.join(paragraphs), markup=False, highlight=False, soft_wrap=True)


def _by_sequence(rows: Sequence[Row], methods: Sequence[str]) -> str:
    header = ('sequence', 'frames', 'GT px', *(f'{LABELS[m]} px' for m in methods))
    header += ('mm', 'bound mm', 'ms')
    return markdown(
        header,
        [
            (
                row['sequence'],
                str(row['frames']),
                figure(row['gt_px'], 5),
                *(_pixels(row, method) for method in methods),
                figure(row['default_mm']),
                LASTS if row['lasting_px'] else figure(row['bound_mm']),
                figure(row['default_ms'] + row['read_ms']),
            )
            for row in rows
        ],
    )


def _pixels(row: Row, method: str) -> str:
    return figure(row[f'{method}_px'], 5) + ('!' if row[f'{method}_refusal'] else '')


def _by_method(dataset: DatasetName, rows: Sequence[Row], methods: Sequence[str]) -> str:
    header = (
        '', 'px', '/ GT', 'deg', 'mm', 'x bound', 'ms', 'refused', 'published px', '/ GT', 'ms'
    )  # fmt: skip
    paper = PUBLISHED[dataset]
    published = {'ransac': paper.ransac, 'rpgd': paper.rpgd}
    truth = float(_column(rows, 'gt_px').mean())
    lines = [('GT', figure(truth, 5), '1', *'-----', f'{paper.ground_truth}', '1', '-')]
    for method in methods:
        pixels = _column(rows, f'{method}_px')
        known = np.isfinite(pixels)
        mean = _mean(pixels[known])
        ratio = mean / _mean(_column(rows, 'gt_px')[known])
        theirs = published.get(method)
        lines.append(
            (
                LABELS[method],
                figure(mean, 5),
                figure(ratio, 5),
                _median(rows, f'{method}_deg'),
                _median(rows, f'{method}_mm'),
                figure(over_bound(rows, method)),
                figure(_mean(_column(rows, f'{method}_ms') + _column(rows, 'read_ms'))),
                str(sum(bool(row[f'{method}_refusal']) for row in rows)),
                f'{theirs}' if theirs else '-',
                f'{theirs / paper.ground_truth:.3f}' if theirs else '-',
                f'{paper.frame_ms}' if method == 'rpgd' else '-',
            )
        )
    return markdown(header, lines)


def over_bound(rows: Sequence[Row], method: str) -> float:
    """Return RMS of the error over that of the bound, where errors are independent."""
    free = [row for row in rows if row['lasting_px'] == 0.0]
    mm, bound = _column(free, f'{method}_mm'), _column(free, 'bound_mm')
    known = np.isfinite(mm) & np.isfinite(bound)
    return float(np.sqrt(_mean(mm[known] ** 2) / _mean(bound[known] ** 2)))


def conclusions(rows: Sequence[Row], methods: Sequence[str]) -> list[str]:
    """Say what the table shows of the default solver, and where its pixels say nothing."""
    said = []
    lasting = [row for row in rows if row['lasting_px'] > 0.0]
    free = [row for row in rows if row['lasting_px'] == 0.0]
    if free and 'default' in methods:
        ratio = float(np.max(_column(free, 'default_px') / _column(free, 'gt_px')))
        bound = over_bound(free, 'default')
        said.append(
            f'default, {len(free)} sequences with independent errors: MPJPE at most {ratio:.5f} x '
            f'GT ({_held(ratio, MOST_GT)}), error {bound:.2f} x the bound '
            f'({_held(bound, MOST_BOUND)}).'
        )
    if lasting:
        said.append(_of_lasting(rows, lasting, methods))
    return said


def _held(value: float, most: float) -> str:
    return f'wanted <= {most:g}: {"holds" if value <= most else "does NOT hold"}'


def _of_lasting(rows: Sequence[Row], lasting: Sequence[Row], methods: Sequence[str]) -> str:
    """Say that there mm alone judges, and how often pixels would have judged otherwise."""
    text = (
        f"In {len(lasting)} of {len(rows)} sequences residuals at the dataset's own pose last "
        f'from frame to frame (median {_median(lasting, "lasting_px")} px), as where joints of '
        'detector and MoCap differ. There the better pose can have the higher MPJPE, and no bound '
        'for independent errors holds: mm alone decides.'
    )
    for method in methods:
        text += f' {LABELS[method]}: {_median(lasting, f"{method}_mm")} mm.'
    if 'default' not in methods:
        return text
    for other in (m for m in methods if m != 'default'):
        nearer = _column(lasting, 'default_mm') < _column(lasting, f'{other}_mm')
        more_px = _column(lasting, 'default_px') > _column(lasting, f'{other}_px')
        text += (
            f' default is nearer than {LABELS[other]} in {int(nearer.sum())}, in '
            f'{int((nearer & more_px).sum())} of these with the higher MPJPE.'
        )
    better = _column(lasting, 'default_px') < _column(lasting, 'gt_px')
    return f'{text} Its MPJPE is below that of the true pose in {int(better.sum())}.'


def _column(rows: Sequence[Row], name: str) -> Array:
    return np.array([row[name] for row in rows], dtype=np.float64)


def _mean(values: Array) -> float:
    return float(values.mean()) if values.size else float('nan')


def _median(rows: Sequence[Row], name: str) -> str:
    values = _column(rows, name)
    known = values[np.isfinite(values)]
    return figure(float(np.median(known))) if known.size else '-'
