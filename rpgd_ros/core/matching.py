# SPDX-License-Identifier: Apache-2.0
"""Linear assignment: rows to columns, each at most once, so that the summed gain is largest."""

from __future__ import annotations

import numpy as np

from rpgd_ros.core.geometry import Array, IntArray


def best_matching(gain: Array) -> IntArray:
    """Match the rows of many small tables to their columns.

    Args:
        gain: (F, S, P) gain of each pair, finite; pairs of 0 and below are never matched.

    Returns:
        (F, S) column of each row, -1 = none.

    """
    n_tables, n_rows, n_columns = gain.shape
    if not n_columns:
        return np.full((n_tables, n_rows), -1)
    best: IntArray = gain.argmax(2)
    best[gain.max(2) <= 0.0] = -1
    if n_rows > 1:
        # Where no two rows want the same column, each has its best: nothing is left to solve.
        order = np.sort(best, 1)
        contested = ((order[:, 1:] == order[:, :-1]) & (order[:, 1:] >= 0)).any(1)
        for f in np.flatnonzero(contested):
            best[f] = _hungarian(gain[f])
    return best


def _hungarian(gain: Array) -> IntArray:
    """Solve one table: shortest augmenting paths with potentials (Kuhn, Munkres)."""
    n_rows, n_columns = gain.shape
    # A column of its own for each row that costs nothing: to stay alone.
    cost = np.hstack([-np.maximum(gain, 0.0), np.zeros((n_rows, n_rows))])
    by_row, by_column = np.zeros(n_rows), np.zeros(n_columns + n_rows)
    owner = np.full(n_columns + n_rows, -1)
    for first in range(n_rows):
        reach = np.full(len(owner), np.inf)
        come_from = np.full(len(owner), -1)
        done = np.zeros(len(owner), np.bool_)
        row, column = first, -1
        while row >= 0:
            slack = cost[row] - by_row[row] - by_column
            shorter = ~done & (slack < reach)
            reach[shorter], come_from[shorter] = slack[shorter], column
            open_reach = np.where(done, np.inf, reach)
            column = int(np.argmin(open_reach))
            step = open_reach[column]
            by_row[first] += step
            by_row[owner[done]] += step
            by_column[done] -= step
            reach[~done] -= step
            done[column] = True
            row = int(owner[column])
        while column >= 0:
            before = int(come_from[column])
            owner[column] = first if before < 0 else owner[before]
            column = before
    out = np.full(n_rows, -1)
    for column in range(n_columns):
        if owner[column] >= 0 and gain[owner[column], column] > 0.0:
            out[owner[column]] = column
    return out
