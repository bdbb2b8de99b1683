# SPDX-License-Identifier: Apache-2.0
"""Reads the small files of datasets, and has the large ones read by their libraries."""

from __future__ import annotations

import os
import stat
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import Array
from rpgd_ros.core.observations import LARGEST_COORDINATE
from rpgd_ros.datasets.sequence import refusal, shown
from rpgd_ros.io.child import Content, read_in_child

MAX_TEXT_BYTES = 4 * 2**20  # metadata.xml of Human3.6M, the largest of them, has half a megabyte

MISSING = "this needs {}, which is not installed: pip install 'rpgd_ros[datasets]'"

# The start of Python and SciPy on a busy machine (0.6 s and 170 MiB on an idle one), and ten times
# what the libraries take for numbers that compress to a fifth.
START_SECONDS, SECONDS_PER_MIB = 10.0, 1.0
START_MEMORY, MEMORY_PER_BYTE = 2**29, 32


def status(path: Path) -> os.stat_result | None:
    """Return what the system knows of a file or folder; None where it cannot be reached."""
    try:
        return path.stat()
    except OSError:  # also that a name is too long, which Path.exists lets through
        return None


def is_folder(path: Path) -> bool:
    """Whether there is such a folder."""
    found = status(path)
    return found is not None and stat.S_ISDIR(found.st_mode)


def require_folder(path: Path) -> Path:
    """Return the path of a folder.

    Raises:
        InputError: There is none.

    """
    if not is_folder(path):
        raise refusal(path, 'no such folder')
    return path


def require_size(path: Path, max_bytes: int) -> None:
    """Refuse a file that is missing, or larger than its kind ever is."""
    try:
        found = path.stat()
    except OSError as error:
        raise refusal(path, f'cannot be read: {error.strerror or error}') from error
    if not stat.S_ISREG(found.st_mode):
        raise refusal(path, 'no regular file')  # a device may have no end, a pipe no writer
    if found.st_size > max_bytes:
        raise refusal(path, f'{found.st_size} bytes: such files have at most {max_bytes}')


def read_bytes(path: Path, max_bytes: int) -> bytes:
    """Read a file of limited size.

    Raises:
        InputError: Missing, too large.

    """
    require_size(path, max_bytes)
    try:
        with path.open('rb') as file:
            data = file.read(max_bytes + 1)
    except OSError as error:
        raise refusal(path, f'cannot be read: {error.strerror or error}') from error
    if len(data) > max_bytes:
        raise refusal(path, f'more than {max_bytes} bytes: such files have at most as many')
    return data


def read_text(path: Path) -> str:
    """Read a text file of limited size.

    Raises:
        InputError: Missing, too large, no text.

    """
    try:
        return read_bytes(path, MAX_TEXT_BYTES).decode('utf-8')
    except UnicodeDecodeError as error:
        raise refusal(path, 'no text (UTF-8)') from error


def undamaged(values: NDArray[Any], unit: float = 1.0) -> Array:
    """Return numbers in metres or pixels; NaN for what no recording can hold.

    Args:
        values: As a file has them, of any kind of number.
        unit: Theirs, in metres or pixels.

    """
    # Signalling NaN and numbers beyond the range warn wherever they are touched.
    with np.errstate(all='ignore'):
        scaled: Array = values.astype(np.float64) * unit
        scaled[~(np.abs(scaled) <= LARGEST_COORDINATE)] = np.nan
    return scaled


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
