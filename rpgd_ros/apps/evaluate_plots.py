# SPDX-License-Identifier: Apache-2.0
"""The publication's plot of an evaluation: every sequence with the error of each method."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from rpgd_ros.apps.bench_published import PUBLISHED
from rpgd_ros.apps.evaluate_sequence import Row
from rpgd_ros.apps.evaluate_tables import LABELS, solved
from rpgd_ros.core.geometry import Array
from rpgd_ros.datasets import DatasetName
from rpgd_ros.report.sequences import Panel, write_plots


def plot_rows(
    path: Path, dataset: DatasetName, rows: Sequence[Row], methods: Sequence[str]
) -> None:
    """Write MPJPE, distance from the dataset's pose, and time of each sequence as a page.

    Raises:
        InputError: NOT_WRITABLE, or the library is missing.

    """
    counted = solved(rows)

    def of(name: str) -> Array:
        return np.array([row[name] for row in counted], dtype=np.float64)

    def each(figure: str) -> dict[str, Array]:
        return {LABELS[method]: of(f'{method}_{figure}') for method in methods}

    paper = PUBLISHED[dataset]
    published = {
        'GT': paper.ground_truth, LABELS['ransac']: paper.ransac, LABELS['rpgd']: paper.rpgd
    }  # fmt: skip
    # A bound for independent errors is none where they last.
    bound = np.where(of('lasting_px') == 0.0, of('bound_mm'), np.nan)
    frames = f'{int(of("frames").sum())} frames' if counted else 'no frames'
    write_plots(
        path,
        f'{dataset}: {len(counted)} sequences, {frames}',
        [row['sequence'] for row in counted],
        [
            Panel('MPJPE, pixels', {'GT': of('gt_px')} | each('px'), published),
            Panel(
                "distance of the body's points from the dataset's own pose, mm",
                {'Cramer-Rao bound': bound} | each('mm'),
            ),
            Panel('time of reading and solving, ms per instant', _times(of, methods)),
        ],
    )


def _times(of: Callable[[str], Array], methods: Sequence[str]) -> dict[str, Array]:
    read = of('read_ms')
    return {'reading alone': read} | {LABELS[m]: of(f'{m}_ms') + read for m in methods}
