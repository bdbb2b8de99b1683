# SPDX-License-Identifier: Apache-2.0
"""The calibrator with one of its parts made slow or faulty, as a program.

The first argument says which, the others are those of the calibrator.
"""

from __future__ import annotations

import os
import stat
import sys
import time
from collections.abc import Sequence
from typing import Any
from unittest import mock

from rpgd_ros.apps import calibrator
from rpgd_ros.ros.results import Results
from rpgd_ros.session import Session

SAVE_SECONDS = 0.2  # that each file takes to reach the disk; a save writes four
EVERY = 10  # batches, of which the session refuses one


def slow_disk() -> None:
    """Let each file take its time, and say when it begins."""
    flush = os.fsync

    def slowly(descriptor: int) -> None:
        if stat.S_ISREG(os.fstat(descriptor).st_mode):
            sys.stdout.write('saving\n')
            sys.stdout.flush()
            time.sleep(SAVE_SECONDS)
        flush(descriptor)

    mock.patch.object(os, 'fsync', slowly).start()


def faulty_session() -> None:
    """Raise what nobody foresaw for one batch of ten, and say so."""
    add = Session.add
    n_batches = 0

    def now_and_then(self: Session, stream: str, *arguments: Any) -> None:
        nonlocal n_batches
        n_batches += 1
        if n_batches % EVERY == 0:
            sys.stdout.write('raised\n')
            sys.stdout.flush()
            msg = 'nobody foresaw this'
            raise RuntimeError(msg)
        add(self, stream, *arguments)

    mock.patch.object(Session, 'add', now_and_then).start()


def faulty_services() -> None:
    """Raise what nobody foresaw in each calibration and each reset."""
    raised = RuntimeError('nobody foresaw this')
    mock.patch.object(Results, 'frames', side_effect=raised).start()
    mock.patch.object(Session, 'reset', side_effect=raised).start()


FAULTS = {
    'slow_disk': slow_disk,
    'faulty_session': faulty_session,
    'faulty_services': faulty_services,
}


def main(arguments: Sequence[str]) -> int:
    """Run the calibrator with a fault."""
    FAULTS[arguments[0]]()
    return calibrator.main(arguments[1:])


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
