# SPDX-License-Identifier: Apache-2.0
"""Text files of other tools, read whole, with complaints that name file and line."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NoReturn

import numpy as np

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import Array

MAX_BYTES: Final = 2**29  # an hour at 240 Hz with 60 joints takes 1/3 of it
LONGEST_S: Final = 86_400.0  # of a recording; later times are dates, such as those of Unix
LARGEST: Final = 1e15  # larger than dates in ms; squares of damaged numbers overflow
MAX_SHOWN: Final = 80  # characters of a foreign string in a message


def refuse(
    path: Path, line: int | None, message: str, reason: Reason = Reason.BAD_INPUT
) -> NoReturn:
    """Raise an error about a line of a file, counted from 1.

    Raises:
        InputError: Always.

    """
    raise InputError(reason, f'{path}:{line}: {message}' if line else f'{path}: {message}')


def read_bytes(path: Path) -> bytes:
    """Read a file of at most 512 MiB.

    Raises:
        InputError: It cannot be read, or is larger.

    """
    try:
        with path.open('rb') as file:
            data = file.read(MAX_BYTES + 1)
    except OSError as error:
        refuse(path, None, f'cannot be read: {error.strerror or error}')
    if len(data) > MAX_BYTES:
        refuse(path, None, f'more than {MAX_BYTES >> 20} MiB: split the recording')
    return data


def read_lines(path: Path) -> list[str]:
    """Return the lines of a text file; what is no UTF-8 (names of people) is replaced.

    Raises:
        InputError: It cannot be read, or is no text.

    """
    data = read_bytes(path)
    if b'\0' in data[:4096]:
        refuse(path, None, 'is a binary file, need text')
    # Not str.splitlines, which also splits at characters that may stand in a name.
    text = data.decode('utf-8-sig', errors='replace')
    return text.replace('\r\n', '\n').replace('\r', '\n').split('\n')


def number(cell: str, path: Path, line: int, what: str) -> float:
    """Return one number of at most 1e15.

    Raises:
        InputError: It is none.

    """
    try:
        value = float(cell)
    except ValueError:
        refuse(path, line, f'{what}: need a number, got {shown(cell)}')
    if not math.isfinite(value):
        refuse(path, line, f'{what}: need a finite number, got {shown(cell)}')
    if abs(value) > LARGEST:
        refuse(path, line, f'{what}: need a number up to {LARGEST:g}, got {shown(cell)}')
    return value


def numbers(cells: Sequence[str], path: Path, line: int) -> list[float]:
    """Return the numbers of a row; NaN where a cell is empty.

    Raises:
        InputError: A cell is no number, infinite, or beyond 1e15.

    """
    try:
        values = [float(cell) if cell.strip() else math.nan for cell in cells]
    except ValueError:
        bad = ((i, cell) for i, cell in enumerate(cells, 1) if not _is_number(cell))
        column, cell = next(bad)
        refuse(path, line, f'column {column}: need a number, got {shown(cell)}')
    if any(map(math.isinf, values)):
        column = 1 + next(i for i, v in enumerate(values) if math.isinf(v))
        refuse(path, line, f'column {column} is infinite, need a number')
    large = next((i for i, v in enumerate(values, 1) if abs(v) > LARGEST), None)
    if large is not None:
        cell = shown(cells[large - 1])
        refuse(path, line, f'column {large}: need a number up to {LARGEST:g}, got {cell}')
    return values


def check_times(path: Path, time_s: Array, lines: Sequence[int]) -> None:
    """Refuse times (T,) that do not increase; `lines` (T,) are their places.

    Raises:
        InputError: Naming the first such line.

    """
    bad = np.flatnonzero(~(time_s[1:] > time_s[:-1]))
    if bad.size:
        k = int(bad[0])
        msg = f'time goes from {time_s[k]:g} to {time_s[k + 1]:g} s: it must increase'
        refuse(path, lines[k + 1], msg)


def check_span(path: Path, time_s: Array, lines: Sequence[int] = ()) -> None:
    """Refuse increasing times (T,) longer than a day; `lines` (T,) are their places, if they have.

    One damaged time makes as long a recording, and what is sampled along it fills the memory.

    Raises:
        InputError: Naming the first time that is too late.

    """
    with np.errstate(over='ignore'):
        late = np.flatnonzero(time_s - time_s[:1] > LONGEST_S)
    if late.size:
        k = int(late[0])
        msg = (
            f'time {time_s[k]:g} s is more than a day ({LONGEST_S:g} s) after the first, '
            f'{time_s[0]:g} s: correct it, or split the recording'
        )
        refuse(path, lines[k] if lines else None, msg)


def _is_number(cell: str) -> bool:
    try:
        float(cell.strip() or 'nan')
    except ValueError:
        return False
    return True


def shown(value: object) -> str:
    """Return a foreign value as it may stand in a message: quoted, and not too long."""
    try:
        text = repr(value)
    except RecursionError:  # JSON is read somewhat deeper than it is written
        return f'a {type(value).__name__} that is nested too deeply'
    return text if len(text) <= MAX_SHOWN else f'{text[: MAX_SHOWN - 3]}...'
