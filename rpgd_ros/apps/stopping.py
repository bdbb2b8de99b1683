# SPDX-License-Identifier: Apache-2.0
"""Ends a program on Ctrl-C and SIGTERM through every clean-up."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

EXIT_STOPPED = 130  # what a shell makes of SIGINT


class Stopped(BaseException):
    """A signal: ends the run through every clean-up.

    KeyboardInterrupt is not that: raised inside exec, which a bag's type store uses, it makes
    Python end by the signal even when caught, with an exit code that is not ours.
    """


@contextmanager
def stop_on_signals() -> Iterator[None]:
    """Turn the first SIGINT or SIGTERM into `Stopped`; a second one does not cut the clean-up."""

    def stop(_number: int, _frame: FrameType | None) -> None:
        for number in before:
            signal.signal(number, signal.SIG_IGN)
        raise Stopped

    before = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
