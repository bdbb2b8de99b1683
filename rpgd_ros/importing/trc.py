# SPDX-License-Identifier: Apache-2.0
"""TRC (track row column): Motion Analysis, OpenSim, Pose2Sim, OptiTrack."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from rpgd_ros.core.errors import Reason
from rpgd_ros.core.geometry import Array
from rpgd_ros.importing.skeleton import MAX_FPS, MIN_FPS, SAME_RATE, SkeletonFile, frame_rate
from rpgd_ros.importing.text import (
    check_span,
    check_times,
    number,
    numbers,
    read_lines,
    refuse,
    shown,
)

FORMAT: Final = 'TRC'
UNITS: Final = {'m': 'm', 'meters': 'm', 'metres': 'm', 'mm': 'mm', 'cm': 'cm', 'inches': 'inch'}
VALUES, NAMES = 3, 4  # lines, counted from 1


def read_trc(path: Path, *, check_rate: bool = True) -> SkeletonFile:
    """Read a TRC file.

    Args:
        path: The file.
        check_rate: Refuse times that contradict DataRate.

    Raises:
        InputError: BAD_INPUT or WRONG_UNIT, naming file and line.

    """
    lines = read_lines(path)
    if len(lines) < 6 or not lines[0].startswith('PathFileType'):
        refuse(path, 1, 'no TRC file: need PathFileType and four more lines of header')
    header = dict(zip(_cells(lines[1]), _cells(lines[2]), strict=False))
    rate = number(_need(header, 'DataRate', path), path, VALUES, 'DataRate')
    if not MIN_FPS <= rate <= MAX_FPS:
        refuse(
            path, VALUES, f'DataRate {rate:g} is no frame rate, need {MIN_FPS:g} to {MAX_FPS:g} Hz'
        )
    word = _need(header, 'Units', path)
    if word.lower() not in UNITS:
        msg = f'Units {shown(word)} is unknown, need one of {", ".join(UNITS)}'
        refuse(path, VALUES, msg, Reason.WRONG_UNIT)
    joints = _names(lines[NAMES - 1], path)
    n_markers = int(number(_need(header, 'NumMarkers', path), path, VALUES, 'NumMarkers'))
    if n_markers != len(joints):
        refuse(path, NAMES, f'{len(joints)} marker names, but NumMarkers is {n_markers}')
    frames, time_s, values = _rows(lines, path, len(joints))
    n_frames = int(number(_need(header, 'NumFrames', path), path, VALUES, 'NumFrames'))
    notes = () if n_frames == len(time_s) else (
        f'the header promises {n_frames} frames, the file has {len(time_s)}',
    )  # fmt: skip
    if check_rate and len(time_s) > 1:
        _check_rate(path, rate, frames, time_s)
    return SkeletonFile(
        path,
        FORMAT,
        joints,
        time_s,
        values,
        UNITS[word.lower()],
        VALUES,
        notes=notes,
        fps_line=VALUES,
        joints_line=NAMES,
    )


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.rstrip().split('\t')]


def _need(header: dict[str, str], key: str, path: Path) -> str:
    if not header.get(key):
        refuse(path, VALUES, f'{key} is missing in the header (tab-separated, lines 2 and 3)')
    return header[key]


def _names(line: str, path: Path) -> tuple[str, ...]:
    cells = _cells(line)
    if len(cells) < 3 or not cells[0].startswith('Frame') or cells[1] != 'Time':
        refuse(path, NAMES, 'need Frame#, Time and the marker names, separated by tabs')
    return tuple(name for name in cells[2:] if name)


def _rows(lines: list[str], path: Path, n_joints: int) -> tuple[Array, Array, Array]:
    """Return frame numbers (T,), seconds (T,) and positions (T, J, 3)."""
    width = 2 + 3 * n_joints
    rows: list[list[float]] = []
    places: list[int] = []
    for i, line in enumerate(lines[NAMES + 1 :], start=NAMES + 2):
        if not line.strip():
            continue
        cells = line.rstrip('\n').split('\t')
        while len(cells) > width and not cells[-1].strip():
            cells.pop()
        if len(cells) != width:
            msg = (
                f'{len(cells)} columns, need {width}: Frame#, Time and 3 for each of {n_joints} '
                'markers. Export the file again, or take the marker without data out of line 4'
            )
            refuse(path, i, msg)
        rows.append(numbers(cells, path, i))
        places.append(i)
    table = np.array(rows, dtype=np.float64).reshape(-1, width)
    check_times(path, table[:, 1], places)
    check_span(path, table[:, 1], places)
    return table[:, 0], table[:, 1], table[:, 2:].reshape(len(table), n_joints, 3)


def _check_rate(path: Path, rate: float, frames: Array, time_s: Array) -> None:
    with np.errstate(over='ignore'):  # of a span that some damage made tiny
        found = float((frames[-1] - frames[0]) / (time_s[-1] - time_s[0]))
    # Programs that cut a piece out may number the frames anew.
    if all(abs(rate_found / rate - 1.0) > SAME_RATE for rate_found in (found, frame_rate(time_s))):
        msg = (
            f'DataRate is {rate:g} Hz, but the Time column runs at {found:.4g} Hz: give the true '
            'rate with --mocap-fps'
        )
        refuse(path, VALUES, msg)
