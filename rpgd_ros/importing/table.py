# SPDX-License-Identifier: Apache-2.0
"""CSV: a column of times or frame numbers, and three columns for each joint."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path
from typing import Final, TypedDict

import numpy as np

from rpgd_ros.core.errors import Reason
from rpgd_ros.core.geometry import Array
from rpgd_ros.importing.skeleton import (
    AXES,
    MAX_FPS,
    MIN_FPS,
    SAME_RATE,
    Axis,
    SkeletonFile,
    frame_rate,
)
from rpgd_ros.importing.text import (
    check_span,
    check_times,
    number,
    numbers,
    read_lines,
    refuse,
    shown,
)
from rpgd_ros.importing.timecode import RATES, Timecode, count
from rpgd_ros.io.rig import METRES_PER

FORMAT: Final = 'CSV'
LAYOUT: Final = (
    "'time' (s) or 'frame', then three columns per joint: left_hip.x, left_hip.y, left_hip.z (or "
    'left_hip_x ...); before it lines such as # units: mm, # up: z, # fps: 100, # timecode: '
    '10:00:00:00 (of the first frame), # timecode_fps: 25'
)
FACTS: Final = ('units', 'up', 'fps', 'timecode', 'timecode_fps')


class _Timecode(TypedDict):
    timecode: Timecode | None
    timecode_fps: str


def read_csv(path: Path, fps: float | None = None) -> SkeletonFile:
    """Read a CSV file with the header that `LAYOUT` describes.

    Args:
        path: The file; columns are separated by commas, semicolons or tabs.
        fps: Rate of frame numbers, where the file does not state it.

    Raises:
        InputError: BAD_INPUT or WRONG_UNIT, naming file and line.

    """
    lines = read_lines(path)
    facts, n_before = _facts(path, lines)
    if n_before >= len(lines) or not lines[n_before].strip():
        refuse(path, n_before + 1, f'the header is missing: need {LAYOUT}')
    separator = max(',;\t', key=lines[n_before].count)
    rows = _rows(path, lines, n_before, separator)
    header = [cell.strip() for cell in next(rows)[1]]
    joints = _joints(path, n_before + 1, header)
    values: list[list[float]] = []
    places: list[int] = []
    for i, cells in rows:
        if any(cell.strip() for cell in cells):
            if len(cells) != len(header):
                refuse(path, i, f'{len(cells)} columns, the header has {len(header)}')
            values.append(numbers(cells, path, i))
            places.append(i)
    table = np.array(values).reshape(-1, len(header))
    time_s = table[:, 0]
    check_times(path, time_s, places)
    rate = None
    if header[0].lower() == 'frame':
        rate = fps if fps is not None and 'fps' not in facts else _rate(path, facts)
        time_s = time_s / rate
    check_span(path, time_s, places)
    if rate is None and fps is None and len(time_s) > 1:
        _check_rate(path, facts, time_s)
    units, line = facts.get('units', ('', 0))
    up = facts.get('up', ('', 0))[0]
    return SkeletonFile(
        path,
        FORMAT,
        joints,
        time_s,
        table[:, 1:].reshape(len(table), len(joints), 3),
        units or None,
        line,
        up=_axis(up),
        joints_line=n_before + 1,
        frame_fps=rate,
        fps_line=facts.get('fps', ('', 0))[1],
        **_timecode(path, facts),
    )


def _facts(path: Path, lines: list[str]) -> tuple[dict[str, tuple[str, int]], int]:
    """Read lines such as `# units: mm`; return value and line by key, and how many lines."""
    facts: dict[str, tuple[str, int]] = {}
    n = 0
    while n < len(lines) and lines[n].startswith('#'):
        key, colon, value = lines[n][1:].partition(':')
        if colon and key.strip().lower() in FACTS:
            facts[key.strip().lower()] = value.strip().lower(), n + 1
        n += 1
    units, line = facts.get('units', ('m', 0))
    if units not in METRES_PER:
        msg = f'units {shown(units)} are unknown, need one of {", ".join(METRES_PER)}'
        refuse(path, line, msg, Reason.WRONG_UNIT)
    up, line = facts.get('up', ('z', 0))
    if up not in AXES:
        refuse(path, line, f'up {shown(up)} is no axis, need x, y or z')
    return facts, n


def _rows(
    path: Path, lines: list[str], n_before: int, separator: str
) -> Iterator[tuple[int, list[str]]]:
    """Yield the cells of each line, with its number; no cell goes on in the next line."""
    for i, line in enumerate(lines[n_before:], start=n_before + 1):
        try:
            yield i, next(csv.reader([line], delimiter=separator, strict=True), [])
        except csv.Error as error:
            refuse(path, i, f'cannot be split into cells ({error}): is a quote not closed?')


def _axis(text: str) -> Axis | None:
    return next((axis for axis in AXES if axis == text), None)


def _rate(path: Path, facts: dict[str, tuple[str, int]]) -> float:
    if 'fps' not in facts:
        refuse(path, None, 'has frame numbers and no rate: give --mocap-fps, or a line # fps: 100')
    text, line = facts['fps']
    rate = number(text, path, line, 'fps')
    if not MIN_FPS <= rate <= MAX_FPS:
        refuse(path, line, f'fps {rate:g} is no frame rate, need {MIN_FPS:g} to {MAX_FPS:g} Hz')
    return rate


def _check_rate(path: Path, facts: dict[str, tuple[str, int]], time_s: Array) -> None:
    if 'fps' not in facts:
        return
    stated, found = _rate(path, facts), frame_rate(time_s)
    if abs(found / stated - 1.0) > SAME_RATE:
        msg = (
            f'fps is {stated:g}, but the times run at {found:.4g} Hz: give the true rate with '
            '--mocap-fps'
        )
        refuse(path, facts['fps'][1], msg)


def _timecode(path: Path, facts: dict[str, tuple[str, int]]) -> _Timecode:
    rate, line = facts.get('timecode_fps', ('', 0))
    if line and rate not in RATES:
        refuse(path, line, f'timecode_fps {shown(rate)} is none of {", ".join(RATES)}')
    text, line = facts.get('timecode', ('', 0))
    code = Timecode(text, f'{path}:{line}: timecode') if line else None
    if code is not None and rate:
        count(code, rate)
    return {'timecode': code, 'timecode_fps': rate}


def _joints(path: Path, line: int, header: list[str]) -> tuple[str, ...]:
    if header[0].lower() not in {'time', 'frame'} or len(header) < 4 or len(header) % 3 != 1:
        refuse(path, line, f'the header is not understood: need {LAYOUT}')
    joints = []
    for i in range(1, len(header), 3):
        names = {cell[:-2] for cell in header[i : i + 3]}
        ends = [cell[-2:].lower().replace('_', '.') for cell in header[i : i + 3]]
        if len(names) != 1 or ends != ['.x', '.y', '.z']:
            found = ', '.join(shown(cell) for cell in header[i : i + 3])
            refuse(path, line, f'columns {i + 1} to {i + 3} are {found}: need {LAYOUT}')
        joints.append(names.pop())
    return tuple(joints)
