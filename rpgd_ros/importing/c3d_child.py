# SPDX-License-Identifier: Apache-2.0
"""Reads a C3D file, in a process of its own (`child_main.py`): ezc3d needs one.

Of 205 truncated or flipped files, seven were endless loops and three segmentation faults.
"""

from __future__ import annotations

import importlib
import re
from typing import Any

import numpy as np

# Groups in which Vicon names the points that are no positions, each also as ANGLES2 and so on.
OUTPUTS = r'(ANGLES|MOMENTS|FORCES|POWERS|SCALARS|REACTIONS)\d*'


def read(path: str) -> tuple[dict[str, list[Any]], list[Any]]:
    """Return the parameters of the points, and the points (3, J, T)."""
    ezc3d = importlib.import_module('ezc3d')
    file = ezc3d.c3d(path)
    points = np.array(file['data']['points'], dtype=np.float64)[:3]
    residuals = np.array(file['data']['meta_points']['residuals'], dtype=np.float64)[0]
    parameters = file['parameters']['POINT']
    labels = [f'LABELS{i}' for i in ('', *range(2, 10))]  # 255 in each
    facts = {key: _values(parameters, key) for key in ('RATE', 'UNITS', 'Y_SCREEN', *labels)}
    facts['OUTPUTS'] = [
        v for key in parameters if re.fullmatch(OUTPUTS, key) for v in _values(parameters, key)
    ]
    facts['FIRST'] = [int(file['header']['points']['first_frame'])]
    facts['TIMECODE'] = sorted(file['parameters'].get('TIMECODE', {}))
    return facts, [np.where(residuals < 0.0, np.nan, points)]


def _values(parameters: Any, key: str) -> list[Any]:
    if key not in parameters:
        return []
    values = np.asarray(parameters[key]['value']).ravel().tolist()
    return [_utf8(v) if isinstance(v, str) else float(v) for v in values]


def _utf8(text: str) -> str:
    """Return a text in which what is no UTF-8 (names of people) is replaced."""
    return text.encode(errors='surrogateescape').decode(errors='replace')
