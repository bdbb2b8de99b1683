# SPDX-License-Identifier: Apache-2.0
"""C3D, read with ezc3d (the extra `import`): joint centres and markers alike."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from rpgd_ros.core.errors import Reason
from rpgd_ros.importing.skeleton import AXES, MAX_FPS, Axis, SkeletonFile
from rpgd_ros.importing.text import read_bytes, refuse, shown

FORMAT: Final = 'C3D'
UNITS: Final = {'m': 'm', 'mm': 'mm', 'cm': 'cm', 'in': 'inch', 'inch': 'inch'}
MAGIC: Final = 0x50  # second byte of each C3D file


def read_c3d(path: Path) -> SkeletonFile:
    """Read the points of a C3D file.

    Unlabelled points (`*12`) are left out, and the name of the subject before a colon is taken off
    where all labels have the same.

    Raises:
        InputError: BAD_INPUT or WRONG_UNIT; ezc3d is not installed.

    """
    if read_bytes(path)[1:2] != bytes([MAGIC]):
        refuse(path, None, 'is no C3D file')
    try:
        ezc3d = importlib.import_module('ezc3d')
    except ImportError:
        refuse(path, None, "C3D needs the library ezc3d: pip install 'rpgd_ros[import]'")
    try:
        file = ezc3d.c3d(str(path))
        points = np.array(file['data']['points'], dtype=np.float64)[:3]
        residuals = np.array(file['data']['meta_points']['residuals'], dtype=np.float64)[0]
        parameters = file['parameters']['POINT']
        first = int(file['header']['points']['first_frame'])
    except (OSError, RuntimeError, ValueError, LookupError, MemoryError) as error:
        refuse(path, None, f'cannot be read as C3D: {str(error)[:200]}')
    rate = _rate(path, parameters)
    labels = _labels(path, parameters, points.shape[1])
    keep = [j for j, label in enumerate(labels) if label and not label.startswith('*')]
    seen = np.where(residuals < 0.0, np.nan, points)
    values = seen[:, keep].transpose(2, 1, 0)
    up = _text(parameters, 'Y_SCREEN').lstrip('+-').lower()
    return SkeletonFile(
        path,
        FORMAT,
        _without_subject([labels[j] for j in keep]),
        (first + np.arange(len(values))) / rate,
        values,
        _units(path, parameters),
        up=_axis(up),
    )


def _values(parameters: Mapping[str, Any], key: str) -> list[Any]:
    return list(parameters[key]['value']) if key in parameters else []


def _text(parameters: Mapping[str, Any], key: str) -> str:
    values = _values(parameters, key)
    return str(values[0]).strip() if values else ''


def _axis(text: str) -> Axis | None:
    return next((axis for axis in AXES if axis == text), None)


def _rate(path: Path, parameters: Mapping[str, Any]) -> float:
    values = _values(parameters, 'RATE')
    rate = float(values[0]) if values else 0.0
    if not 0.0 < rate <= MAX_FPS:
        refuse(path, None, f'POINT:RATE is {rate:g} Hz, need 1 to {MAX_FPS:g}: export it again')
    return rate


def _units(path: Path, parameters: Mapping[str, Any]) -> str | None:
    word = _text(parameters, 'UNITS').lower()
    if word and word not in UNITS:
        msg = f'POINT:UNITS {shown(word)} is unknown, need one of {", ".join(UNITS)}'
        refuse(path, None, msg, Reason.WRONG_UNIT)
    return UNITS[word] if word else None


def _labels(path: Path, parameters: Mapping[str, Any], n_points: int) -> list[str]:
    labels: list[str] = []
    for key in ('LABELS', *(f'LABELS{i}' for i in range(2, 10))):  # 255 in each
        labels += [str(label).strip() for label in _values(parameters, key)]
    if len(labels) < n_points:
        refuse(path, None, f'{n_points} points, but {len(labels)} labels: label them and export')
    return labels[:n_points]


def _without_subject(labels: list[str]) -> tuple[str, ...]:
    subjects = {label.rpartition(':')[0] for label in labels}
    return tuple(label.rpartition(':')[2] if len(subjects) == 1 else label for label in labels)
