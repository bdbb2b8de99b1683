# SPDX-License-Identifier: Apache-2.0
"""A process of its own that reads one C3D file: ezc3d crashes or hangs on damaged ones.

Of 205 truncated or flipped files, seven were endless loops and three segmentation faults.
Writes a line of JSON, then the points as float64.
"""

from __future__ import annotations

import importlib
import json
import os
import re
import resource
import sys
from typing import Any, BinaryIO

import numpy as np

# Groups in which Vicon names the points that are no positions, each also as ANGLES2 and so on.
OUTPUTS = r'(ANGLES|MOMENTS|FORCES|POWERS|SCALARS|REACTIONS)\d*'
MAX_MEMORY = 2**33  # bytes; a file of 33 MiB (60 markers, 36 000 frames) takes 0.6 GiB


def main() -> None:
    """Read a file within some seconds, as the command line says, and write it to its output."""
    seconds = int(sys.argv[2])
    _limit(resource.RLIMIT_CPU, seconds)  # also where the parent is gone
    _limit(resource.RLIMIT_AS, MAX_MEMORY)
    with os.fdopen(os.dup(1), 'wb') as output:
        os.dup2(2, 1)  # what the library prints is no data
        _read(sys.argv[1], output)


def _limit(kind: int, most: int) -> None:
    """Limit this process, which may have a lower limit already that nobody may raise."""
    hard = resource.getrlimit(kind)[1]
    most = most if hard == resource.RLIM_INFINITY else min(most, hard)
    resource.setrlimit(kind, (most, most))


def _read(path: str, output: BinaryIO) -> None:
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
    facts['SHAPE'] = list(points.shape)
    facts['TIMECODE'] = sorted(file['parameters'].get('TIMECODE', {}))
    output.write(json.dumps(facts).encode() + b'\n')
    output.write(np.where(residuals < 0.0, np.nan, points).astype('<f8').tobytes())


def _values(parameters: Any, key: str) -> list[Any]:
    if key not in parameters:
        return []
    values = np.asarray(parameters[key]['value']).ravel().tolist()
    return [_utf8(v) if isinstance(v, str) else float(v) for v in values]


def _utf8(text: str) -> str:
    """Return a text in which what is no UTF-8 (names of people) is replaced."""
    return text.encode(errors='surrogateescape').decode(errors='replace')


if __name__ == '__main__':
    main()
