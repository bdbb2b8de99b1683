# SPDX-License-Identifier: Apache-2.0
"""Published datasets, read sequence by sequence from folders in their own layouts."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from rpgd_ros.datasets.aistpp import Aistpp
from rpgd_ros.datasets.files import status
from rpgd_ros.datasets.human36m import Human36m
from rpgd_ros.datasets.human36m_npz import SKELETONS, Human36mNpz
from rpgd_ros.datasets.mpi_inf_3dhp import MpiInf3dhp
from rpgd_ros.datasets.sequence import Dataset, DatasetSequence, drawn_pose

DatasetName = Literal['aistpp', 'human36m', 'mpi_inf_3dhp']

__all__ = [
    'Aistpp',
    'Dataset',
    'DatasetName',
    'DatasetSequence',
    'Human36m',
    'Human36mNpz',
    'MpiInf3dhp',
    'drawn_pose',
    'open_dataset',
]


def open_dataset(kind: DatasetName, folder: Path, *, is_published: bool = False) -> Dataset:
    """Open a dataset; only names are read.

    Args:
        kind: Whose layout the folder has.
        folder: Where.
        is_published: Whether to keep to the publication's selection of sequences.

    Raises:
        InputError: Not such a folder.

    """
    if kind == 'aistpp':
        return Aistpp.open(folder, is_published=is_published)
    if kind == 'human36m' and status(folder / SKELETONS):
        return Human36mNpz.open(folder, is_published=is_published)
    if kind == 'human36m':
        return Human36m.open(folder, is_published=is_published)
    return MpiInf3dhp.open(folder)
