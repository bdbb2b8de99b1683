# SPDX-License-Identifier: Apache-2.0
"""Reads the annotations of MPI-INF-3DHP, in a process of its own: see `child_main.py`."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np

NAMES = ['annot2', 'annot3']


def read(path: str) -> tuple[dict[str, Any], list[Any]]:
    """Return the numbers of the cells of annot2, and of the first cell of annot3.

    The facts are, by variable, the shapes of its cells, None for a cell that holds no table of
    numbers; or how many values stand there where it has no cells.
    """
    tree = importlib.import_module('scipy.io').loadmat(path, variable_names=NAMES)
    facts: dict[str, Any] = {}
    arrays: list[Any] = []
    for name in NAMES:
        if name not in tree:
            continue
        cells = np.asarray(tree[name])
        if cells.dtype != object:
            facts[name] = cells.size
            continue
        tables = [np.asarray(cell) for cell in cells.ravel()]
        facts[name] = [table.shape if table.dtype.kind in 'fiu' else None for table in tables]
        used = tables if name == 'annot2' else tables[:1]
        arrays += [table for table in used if table.dtype.kind in 'fiu']
    return facts, arrays
