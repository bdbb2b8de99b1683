# SPDX-License-Identifier: Apache-2.0
"""One thread beside the executor, for what takes long: the solve and the writing of its files."""

from __future__ import annotations

import ctypes
import sys
import threading
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from rclpy.executors import Executor
from rclpy.task import Future

from rpgd_ros.core.errors import CalibrationError, Reason

T = TypeVar('T')

JOIN_SECONDS = 0.3  # the executor has waited before: the thread is gone or does not listen
# A write of a few hundred KiB takes milliseconds; a disk that needs longer than this is gone.
WRITE_SECONDS = 10.0

# Of glibc, which keeps what a thread has freed between two blocks that live on. With a solve every
# 5 s the process grew by 3 to 7 MiB per minute, and by none without solves.
_TRIM = getattr(ctypes.CDLL(None), 'malloc_trim', None) if sys.platform == 'linux' else None


def attempt(job: Callable[[], T]) -> T | Exception:
    """Run something at the edge of the node, which lives on whatever it raises.

    Returns:
        Its result, or what it raised.

    """
    try:
        return job()
    except Exception as error:
        return error


async def attempt_to_end(job: Awaitable[T]) -> T | Exception:
    """Await something at the edge of the node; see `attempt`."""
    try:
        return await job
    except Exception as error:
        return error


def give_back() -> None:
    """Return to the system what has been freed."""
    if _TRIM is not None:
        _TRIM(0)


class Worker:
    """Runs jobs beside the executor and completes a future of the executor's with each result.

    The threads are daemons, so that a solve that does not listen to `should_stop` does not keep
    the process alive. What a job does inside `uncut` is waited for.
    """

    def __init__(self) -> None:
        """Make an idle worker."""
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()
        self._writing = threading.Lock()

    def should_stop(self) -> bool:
        """Tell a job whether it should end early."""
        return self._stop.is_set()

    def start(self, job: Callable[[], object], executor: Executor | None) -> Future:
        """Run a job in a thread of its own.

        Args:
            job: What to do.
            executor: The executor in which the future is awaited.

        Returns:
            A future of what `attempt` makes of the job.

        """
        future = Future(executor=executor)

        def work() -> None:
            try:
                ended = attempt(job)
            except BaseException as error:  # a library's sys.exit: the future must have an end
                ended = RuntimeError(f'the job ended its thread: {error!r}')
            give_back()
            future.set_result(ended)
            if executor is not None:
                executor.wake()

        self._thread = threading.Thread(target=work, name='solver', daemon=True)
        self._thread.start()
        return future

    @contextmanager
    def uncut(self) -> Iterator[None]:
        """Keep the process alive while a file is written.

        Raises:
            CalibrationError: CANCELLED. It is to end: `join` may have been and gone already.

        """
        with self._writing:
            if self.should_stop():
                msg = 'the node is shutting down; nothing was written'
                raise CalibrationError(Reason.CANCELLED, msg)
            yield

    def request_stop(self) -> None:
        """Ask the running job to end."""
        self._stop.set()

    def join(self) -> None:
        """Wait a moment for the running job, and for as long as needed while it writes a file."""
        if self._thread is not None:
            self._thread.join(JOIN_SECONDS)
        if self._writing.acquire(timeout=WRITE_SECONDS):
            self._writing.release()
