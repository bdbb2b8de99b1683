# SPDX-License-Identifier: Apache-2.0
"""Ends a program on Ctrl-C and SIGTERM through every clean-up."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Event
from types import FrameType

EXIT_STOPPED = 130  # what a shell makes of SIGINT


class Stopped(BaseException):
    """A signal: ends the run through every clean-up.

    KeyboardInterrupt is not that: raised inside exec, which a bag's type store uses, it makes
    Python end by the signal even when caught, with an exit code that is not ours.
    """


@contextmanager
def stop_on_signals() -> Iterator[Event]:
    """Turn SIGINT or SIGTERM into `Stopped`; a second one does not cut the clean-up.

    Python drops an exception that arrives within a destructor or a callback of C code. The event
    is set all the same: look at it from time to time.
    """
    stop = Event()

    def note(_number: int, _frame: FrameType | None) -> None:
        if not stop.is_set():
            stop.set()
            raise Stopped

    before = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
