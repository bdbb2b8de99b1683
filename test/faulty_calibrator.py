# SPDX-License-Identifier: Apache-2.0
"""The calibrator with one of its parts made slow or faulty, as a program.

The first argument says which, the others are those of the calibrator.
"""

from __future__ import annotations

import os
import stat
import sys
import time
import warnings
from collections.abc import Sequence
from typing import Any
from unittest import mock

from rclpy.service import Service

from rpgd_ros.apps import calibrator
from rpgd_ros.ros import replies
from rpgd_ros.ros.results import Results
from rpgd_ros.session import Session

SAVE_SECONDS = 0.2  # that each file takes to reach the disk; a save writes four
DROPPED = 2  # answers to each request
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


def late_clients() -> None:
    """Drop the first two answers to each request, as rclpy does for a client not yet found."""
    send = Service.send_response
    n_sent: dict[tuple[Service, int], int] = {}

    def drop_first(self: Service, response: Any, header: Any) -> None:
        key = self, header.request_id.sequence_number
        n_sent[key] = n_sent.get(key, 0) + 1
        if n_sent[key] > DROPPED:
            send(self, response, header)
        else:
            sys.stdout.write('dropped\n')
            sys.stdout.flush()
            warnings.warn('failed to send response (timeout): as if', RuntimeWarning, 1)

    mock.patch.object(Service, 'send_response', drop_first).start()


def hasty() -> None:
    """Give up answers that cannot be sent soon."""
    mock.patch.object(replies, 'KEPT_S', 0.5).start()


FAULTS = {
    'late_clients': late_clients,
    'hasty': hasty,
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
