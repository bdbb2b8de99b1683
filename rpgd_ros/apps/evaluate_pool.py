# SPDX-License-Identifier: Apache-2.0
"""Does many tasks in processes of this machine, and outlives the death of any of them."""

from __future__ import annotations

import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import connection, forkserver, get_context, parent_process
from typing import Any, TypeVar

from rpgd_ros.apps.bench_run import ONE_THREAD

T = TypeVar('T')
R = TypeVar('R')

CONTEXT = get_context('forkserver')
PRELOAD = ['rpgd_ros.apps.evaluate_sequence']


def each_somewhere(
    function: Callable[[T], R], tasks: Sequence[T], *, jobs: int
) -> Generator[tuple[T, R | None], None, None]:
    """Yield tasks with what a function makes of them, as they finish.

    When a process dies, nobody can tell by which of the tasks at work: these are done again one
    by one, each in a process of its own.

    Args:
        function: Of a module; it keeps its results itself.
        tasks: What to do.
        jobs: Processes at once; 1 = here, without any.

    Yields:
        The task, and its result or None where its own process died.

    """
    if jobs == 1:
        yield from ((task, function(task)) for task in tasks)
        return
    os.environ.update(ONE_THREAD)  # as many threads as processes: no more
    CONTEXT.set_forkserver_preload(PRELOAD)
    waiting = deque(tasks)
    while waiting:
        suspects: list[T] = []
        yield from _until_broken(function, waiting, suspects, jobs)
        for task in suspects:
            alone, died = deque([task]), list[T]()
            yield from _until_broken(function, alone, died, 1)
            yield from ((task, None) for task in died)


def _until_broken(
    function: Callable[[T], R], waiting: deque[T], suspects: list[T], jobs: int
) -> Iterator[tuple[T, R]]:
    """Take tasks off `waiting` until none is left, or a process died: then fill `suspects`."""
    with _processes(jobs) as pool:
        at_work: dict[Future[R], T] = {}
        while waiting or at_work:
            while waiting and len(at_work) < jobs:
                task = waiting.popleft()
                try:
                    with _signals_held():
                        at_work[pool.submit(function, task)] = task
                except BrokenProcessPool:  # an idle process died
                    waiting.appendleft(task)
                    break
            if not at_work:
                return
            done, _ = wait(at_work, return_when=FIRST_COMPLETED)
            for future in done:
                task = at_work.pop(future)
                try:
                    result = future.result()
                except BrokenProcessPool:
                    suspects.append(task)
                else:
                    yield task, result
            if suspects:
                suspects.extend(at_work.values())
                return


@contextmanager
def _processes(jobs: int) -> Iterator[ProcessPoolExecutor]:
    """Start processes; at the end, wait for the tasks at work, whose results are kept."""
    forkserver.ensure_running()
    pool = ProcessPoolExecutor(jobs, mp_context=CONTEXT, initializer=_begin)
    try:
        yield pool
    finally:
        with _signals_held():
            pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def _signals_held() -> Iterator[None]:
    """Hold signals back: one in the midst of a start would leave the pool half made."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin() -> None:
    """Leave Ctrl-C to the parent, and end when the parent does, even killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT, signal.SIGTERM})
    parent = parent_process()
    if parent is not None:
        threading.Thread(target=_follow, args=(parent.sentinel,), daemon=True).start()


def _follow(sentinel: Any) -> None:
    connection.wait([sentinel])
    os._exit(1)
