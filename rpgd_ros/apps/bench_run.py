# SPDX-License-Identifier: Apache-2.0
"""Runs measurements in processes of their own, one thread each, and lays out what they say."""

from __future__ import annotations

import math
import multiprocessing
import os
import signal
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing import forkserver
from multiprocessing.pool import Pool
from typing import Any, NamedTuple, TypeVar

T = TypeVar('T')
R = TypeVar('R')

# Read by the libraries when they are loaded, which is why the work is done in other processes.
ONE_THREAD = dict.fromkeys(
    (
        'OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS', 'BLIS_NUM_THREADS',
        'OPENCV_FOR_THREADS_NUM',
    ), '1',
)  # fmt: skip
# Imported once, by the process that all others are forked from; what is missing is passed over.
PRELOAD = [
    'rich.progress', 'rpgd_ros.apps.bench_honesty', 'rpgd_ros.apps.bench_poselib',
    'rpgd_ros.apps.bench_published', 'rpgd_ros.apps.bench_scipy', 'rpgd_ros.apps.bench_solver',
]  # fmt: skip
CONTEXT = multiprocessing.get_context('forkserver')

# Shows a bar for an iterable of a known length: (items, what they are, how many).
Track = Callable[[Iterable[Any], str, int], Iterable[Any]]


class Table(NamedTuple):
    """What one measurement found.

    Attributes:
        name: Of the measurement.
        text: Markdown.
        rows: The raw figures, one mapping for each problem and solver.

    """

    name: str
    text: str
    rows: list[dict[str, Any]]


def prepare() -> None:
    """Set the environment of the processes to come."""
    os.environ.update(ONE_THREAD)
    CONTEXT.set_forkserver_preload(PRELOAD)


def each(function: Callable[[T], R], tasks: Sequence[T], *, jobs: int) -> Iterator[R]:
    """Yield what a function makes of each task, in order, from `jobs` processes at once."""
    with _processes(jobs) as pool:
        yield from pool.imap(function, tasks)


def apart(function: Callable[..., R], *arguments: object, limit_s: float) -> R:
    """Return what a function says in a new process, which is ended then.

    Raises:
        TimeoutError: No answer in time: it hung, or its process died.

    """
    with _processes(1) as pool:
        try:
            return pool.apply_async(function, arguments).get(limit_s)
        except multiprocessing.TimeoutError:
            msg = f'no answer within {limit_s:g} s'
            raise TimeoutError(msg) from None


@contextmanager
def _processes(jobs: int) -> Iterator[Pool]:
    """Start processes, and end them whatever happens."""
    forkserver.ensure_running()
    # A signal in the midst of a start would leave a process that nobody knows of.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    try:
        with CONTEXT.Pool(jobs, _leave_ctrl_c_to_the_parent) as pool:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
            yield pool
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _leave_ctrl_c_to_the_parent() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def markdown(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a markdown table whose columns stand under each other in a terminal, too."""
    lines = [list(header), *(list(row) for row in rows)]
    widths = [max(len(line[k]) for line in lines) for k in range(len(header))]
    lines.insert(1, ['-' * width for width in widths])
    return '\n'.join(
        f'| {" | ".join(cell.ljust(w) for cell, w in zip(line, widths, strict=True))} |'
        for line in lines
    )


def figure(value: float, digits: int = 3) -> str:
    """Return a number with at least that many significant digits; '-' where there is none."""
    if not math.isfinite(value):
        return '-'
    magnitude = math.floor(math.log10(abs(value))) if value else 0
    return f'{value:.{max(digits - 1 - magnitude, 0)}f}'
