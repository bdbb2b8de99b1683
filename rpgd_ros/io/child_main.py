# SPDX-License-Identifier: Apache-2.0
"""A process of its own that reads files with a library which damaged ones crash, hang or fill.

Its arguments are a file of Python with a function `read`, seconds, bytes of memory, and the files
to read. `read(path)` returns what JSON can say, and arrays of numbers; of each file follow one
line of JSON and the arrays as float64. See `child.py`, whose other side this is: nothing of the
package is imported, which need not be found here.
"""

from __future__ import annotations

import json
import os
import resource
import runpy
import sys
from typing import Any, BinaryIO

import numpy as np


def main() -> None:
    """Read the files that the command line names, and write what is in them to its output."""
    reader, seconds, memory, *paths = sys.argv[1:]
    _limit(resource.RLIMIT_CPU, int(seconds))  # also where the parent is gone
    _limit(resource.RLIMIT_AS, int(memory))
    _limit(resource.RLIMIT_FSIZE, int(memory))  # libraries unpack into temporary files
    _limit(resource.RLIMIT_CORE, 0)
    with os.fdopen(os.dup(1), 'wb') as output:
        os.dup2(2, 1)  # what a library prints is no data
        read = runpy.run_path(reader)['read']
        for path in paths:
            _write(output, *read(path))


def _limit(kind: int, most: int) -> None:
    """Limit this process, which may have a lower limit already that nobody may raise."""
    hard = resource.getrlimit(kind)[1]
    most = most if hard == resource.RLIM_INFINITY else min(most, hard)
    resource.setrlimit(kind, (most, most))


def _write(output: BinaryIO, facts: Any, arrays: list[Any]) -> None:
    # A cast of a signalling NaN is no news.
    with np.errstate(all='ignore'):
        values = [np.asarray(array).astype('<f8') for array in arrays]
    head = {'facts': facts, 'shapes': [value.shape for value in values]}
    output.write(json.dumps(head).encode() + b'\n')
    output.writelines(value.tobytes() for value in values)
    output.flush()


if __name__ == '__main__':
    main()
