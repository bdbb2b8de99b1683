# SPDX-License-Identifier: Apache-2.0
"""C3D, read with ezc3d (the extra `import`): joint centres and markers alike."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import numpy as np

from rpgd_ros.core.errors import Reason
from rpgd_ros.importing.skeleton import AXES, MAX_FPS, MIN_FPS, SAME_RATE, Axis, SkeletonFile
from rpgd_ros.importing.text import LARGEST, read_bytes, refuse, shown
from rpgd_ros.io.child import read_in_child

FORMAT: Final = 'C3D'
UNITS: Final = {'m': 'm', 'mm': 'mm', 'cm': 'cm', 'in': 'inch', 'inch': 'inch'}
INTEL: Final = bytes([84])  # processor type; the others write numbers in other ways
SGI: Final = bytes([86])  # whose integers begin with the high byte
NO_LAST: Final = 2**16 - 1  # of the header, also where the last frame has a larger number
MAGIC: Final = 0x50  # second byte of each C3D file
CHILD: Final = Path(__file__).with_name('c3d_child.py')
# The start of Python on a busy machine, and ten times what a megabyte takes.
START_SECONDS, SECONDS_PER_MIB = 10.0, 1.0
MAX_MEMORY: Final = 2**33  # bytes; a file of 33 MiB (60 markers, 36 000 frames) takes 0.6 GiB
# Vicon's exporter writes such a section; neither it nor the C3D user guide says what stands in it.
TIMECODE_NOTE: Final = (
    'the file has a TIMECODE section, whose layout is not published, so that it is not read: give '
    '--mocap-timecode as the MoCap program shows it for the first frame of the file'
)

Parameters = Mapping[str, list[Any]]


def read_c3d(path: Path) -> SkeletonFile:
    """Read the points of a C3D file.

    Unlabelled points (`*12`) and the results of a model (angles, moments, ...) are left out.

    Raises:
        InputError: BAD_INPUT or WRONG_UNIT; ezc3d is not installed.

    """
    data = read_bytes(path)
    if data[1:2] != bytes([MAGIC]):
        refuse(path, None, 'is no C3D file')
    if find_spec('ezc3d') is None:
        refuse(path, None, "C3D needs the library ezc3d: pip install 'rpgd_ros[import]'")
    seconds = START_SECONDS + SECONDS_PER_MIB * len(data) / 2**20
    (content,) = read_in_child(CHILD, [path], what=FORMAT, seconds=seconds, memory=MAX_MEMORY)
    parameters, (points,) = content.facts, content.arrays
    rate = _rate(path, parameters)
    labels = _labels(path, parameters, points.shape[1])
    outputs = {str(name).strip().rpartition(':')[2] for name in parameters['OUTPUTS']}
    keep = [j for j, label in enumerate(labels) if label and not label.startswith('*')]
    keep = [j for j in keep if labels[j].rpartition(':')[2] not in outputs]
    values = points[:, keep].transpose(2, 1, 0)
    values = np.where(np.abs(values) <= LARGEST, values, np.nan)
    _check_whole(path, data, len(values))
    up = _text(parameters, 'Y_SCREEN').lstrip('+-').lower()
    return SkeletonFile(
        path,
        FORMAT,
        tuple(labels[j] for j in keep),
        (parameters['FIRST'][0] + np.arange(len(values), dtype=np.float64)) / rate,
        values,
        _units(path, parameters),
        up=_axis(up),
        notes=_notes(data, rate, parameters),
    )


def _check_whole(path: Path, data: bytes, n_frames: int) -> None:
    """Refuse a file that ends early, of which ezc3d gives the frames that are left."""
    order = '>' if _processor(data) == SGI else '<'
    first, last = struct.unpack(f'{order}HH', data[6:10])
    if n_frames < last - first + 1 and last != NO_LAST:
        msg = (
            f'{n_frames} frames, but the header promises {last - first + 1} ({first} to {last}): '
            'the file is cut off, copy or export it again'
        )
        refuse(path, None, msg)


def _processor(data: bytes) -> bytes:
    return data[512 * (data[0] - 1) + 3 :][:1]


def _notes(data: bytes, rate: float, parameters: Parameters) -> tuple[str, ...]:
    notes = [TIMECODE_NOTE] if parameters['TIMECODE'] else []
    # ezc3d takes the rate of the parameters for that of the header.
    (stated,) = struct.unpack('<f', data[20:24]) if _processor(data) == INTEL else (rate,)
    if not abs(stated / rate - 1.0) <= SAME_RATE:
        notes.append(
            f'the header says {stated:.4g} Hz, POINT:RATE {rate:g} Hz, which is taken: give the '
            'true rate with --mocap-fps'
        )
    return tuple(notes)


def _text(parameters: Parameters, key: str) -> str:
    values = parameters[key]
    return str(values[0]).strip() if values else ''


def _axis(text: str) -> Axis | None:
    return next((axis for axis in AXES if axis == text), None)


def _rate(path: Path, parameters: Parameters) -> float:
    values = parameters['RATE']
    rate = float(values[0]) if values else 0.0
    if not MIN_FPS <= rate <= MAX_FPS:
        refuse(
            path,
            None,
            f'POINT:RATE is {rate:g} Hz, need {MIN_FPS:g} to {MAX_FPS:g}: export it again',
        )
    return rate


def _units(path: Path, parameters: Parameters) -> str | None:
    word = _text(parameters, 'UNITS').lower()
    if word and word not in UNITS:
        msg = f'POINT:UNITS {shown(word)} is unknown, need one of {", ".join(UNITS)}'
        refuse(path, None, msg, Reason.WRONG_UNIT)
    return UNITS[word] if word else None


def _labels(path: Path, parameters: Parameters, n_points: int) -> list[str]:
    labels: list[str] = []
    for key in ('LABELS', *(f'LABELS{i}' for i in range(2, 10))):
        labels += [str(label).strip() for label in parameters[key]]
    if len(labels) < n_points:
        refuse(path, None, f'{n_points} points, but {len(labels)} labels: label them and export')
    return labels[:n_points]
