# SPDX-License-Identifier: Apache-2.0
"""Reads the small files of datasets, and has the large ones read by their libraries."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import Array
from rpgd_ros.datasets.sequence import refusal, shown
from rpgd_ros.io.child import Content, read_in_child

MAX_TEXT_BYTES = 4 * 2**20  # metadata.xml of Human3.6M, the largest of them, has half a megabyte

MISSING = "this needs {}, which is not installed: pip install 'rpgd_ros[datasets]'"

# The start of Python and SciPy on a busy machine (0.6 s and 170 MiB on an idle one), and ten times
# what the libraries take for numbers that compress to a fifth.
START_SECONDS, SECONDS_PER_MIB = 10.0, 1.0
START_MEMORY, MEMORY_PER_BYTE = 2**29, 32


def require_folder(path: Path) -> Path:
    """Return the path of a folder.

    Raises:
        InputError: There is none.

    """
    if not path.is_dir():
        raise refusal(path, 'no such folder')
    return path


def require_size(path: Path, max_bytes: int) -> None:
    """Refuse a file that is missing, or larger than its kind ever is."""
    try:
        n_bytes = path.stat().st_size
    except OSError as error:
        raise refusal(path, f'cannot be read: {error.strerror or error}') from error
    if n_bytes > max_bytes:
        raise refusal(path, f'{n_bytes} bytes: such files have at most {max_bytes}')


def read_text(path: Path) -> str:
    """Read a text file of limited size.

    Raises:
        InputError: Missing, too large, no text.

    """
    require_size(path, MAX_TEXT_BYTES)
    try:
        return path.read_text(encoding='utf-8')
    except OSError as error:
        raise refusal(path, f'cannot be read: {error.strerror or error}') from error
    except UnicodeDecodeError as error:
        raise refusal(path, 'no text (UTF-8)') from error


def numbers(path: Path, what: str, words: list[str], count: int) -> Array:
    """Return words of a text file as that many finite numbers.

    Raises:
        InputError: Fewer, more, or no numbers.

    """
    try:
        values = np.array([float(word) for word in words])
    except ValueError as error:
        raise refusal(path, f'{what}: need numbers, found {shown(" ".join(words))}') from error
    if len(values) != count or not np.isfinite(values).all():
        raise refusal(path, f'{what}: need {count} finite numbers, found {len(values)}')
    return values


def require_library(name: str) -> None:
    """Refuse to go on without a library that reads the large files of a dataset.

    Raises:
        InputError: It is not installed.

    """
    if find_spec(name) is None:
        raise InputError(Reason.BAD_INPUT, MISSING.format(name))


def read_by_library(
    reader: Path, paths: Sequence[Path], *, what: str, max_bytes: int
) -> list[Content]:
    """Read large files in a process of its own; arguments as those of `read_in_child`.

    Raises:
        InputError: Missing, too large, damaged.

    """
    for path in paths:
        require_size(path, max_bytes)
    sizes = [path.stat().st_size for path in paths]
    return read_in_child(
        reader,
        paths,
        what=what,
        seconds=START_SECONDS + SECONDS_PER_MIB * sum(sizes) / 2**20,
        memory=START_MEMORY + MEMORY_PER_BYTE * max(sizes),
    )
