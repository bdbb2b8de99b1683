# SPDX-License-Identifier: Apache-2.0
"""Reads files in a process of its own, with limits on time and memory.

For formats whose libraries damaged files crash (a segmentation fault ends the whole program), hang
or have unpack gigabytes from kilobytes.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import Array

MAIN: Final = Path(__file__).with_name('child_main.py')
MAX_SAID = 200  # characters of what the library said


@dataclass(frozen=True, slots=True, eq=False)
class Content:
    """What is in a file.

    Attributes:
        facts: What JSON can say.
        arrays: Numbers.

    """

    facts: Any
    arrays: tuple[Array, ...]


def read_in_child(
    reader: Path, paths: Sequence[Path], *, what: str, seconds: float, memory: int
) -> list[Content]:
    """Read files of one kind.

    Args:
        reader: A file of Python, which imports nothing of this package, with a function `read`:
            of a path, facts and arrays.
        paths: Of the files.
        what: They are, for messages.
        seconds: That all may take together.
        memory: That the process may take, bytes.

    Raises:
        InputError: BAD_INPUT; the message begins with the file that cannot be read.

    """
    files = [str(path.absolute()) for path in paths]
    limits = [str(math.ceil(seconds)), str(memory)]
    command = [sys.executable, '-P', str(MAIN), str(reader), *limits, *files]
    problem = ''
    with tempfile.TemporaryDirectory() as folder:
        try:
            done = subprocess.run(
                command,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=seconds,
                check=False,
                # One thread: each of numpy's takes address space.
                env=os.environ | {'TMPDIR': folder, 'OPENBLAS_NUM_THREADS': '1'},
            )
            output = done.stdout
            if done.returncode != 0:
                problem = f'cannot be read as {what}: {_said(done, memory)}'
        except subprocess.TimeoutExpired as error:
            output = error.stdout or b''
            problem = f'cannot be read as {what} within {seconds:.0f} s: it is damaged'
    found = list(_contents(output))
    if problem:
        # They are read in their order: what is not there is what it died of.
        culprit = paths[min(len(found), len(paths) - 1)]
        raise InputError(Reason.BAD_INPUT, f'{culprit}: {problem}')
    return found


def _said(done: subprocess.CompletedProcess[bytes], memory: int) -> str:
    lines = done.stderr.decode(errors='replace').strip().splitlines()
    # A negative code is a signal: what was printed before that is no complaint.
    last = lines[-1] if lines and done.returncode > 0 else 'damaged'
    if 'MemoryError' in last:
        return f'it would take more than {memory >> 20} MiB of memory'
    return last[:MAX_SAID]


def _contents(output: bytes) -> Iterator[Content]:
    """Yield what was written as a whole."""
    begin = 0
    while (end := output.find(b'\n', begin)) >= 0:
        head = json.loads(output[begin:end])
        begin = end + 1
        arrays = []
        for shape in head['shapes']:
            count = math.prod(shape)
            if begin + 8 * count > len(output):
                return
            arrays.append(np.frombuffer(output, '<f8', count, begin).reshape(shape))
            begin += 8 * count
        yield Content(head['facts'], tuple(arrays))
