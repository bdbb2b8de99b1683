# SPDX-License-Identifier: Apache-2.0
"""Starts programs as processes of their own, watches their output and ends them, all bounded."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

REPOSITORY = Path(__file__).parent.parent


def ros_environment(domain: int, **extra: str) -> dict[str, str]:
    """Return the environment of a child: this machine only, message fields checked."""
    return {
        **os.environ,
        'ROS_DOMAIN_ID': str(domain),
        'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
        'ROS_PYTHON_CHECK_FIELDS': '1',
        # Before that of a sourced ROS, which lives there.
        'PYTHONPATH': os.pathsep.join(
            filter(None, [str(REPOSITORY), os.environ.get('PYTHONPATH', '')])
        ),
        'PYTHONUNBUFFERED': '1',
        **extra,
    }


class Child:
    """A running program whose output is read line by line."""

    def __init__(self, arguments: Sequence[str], environment: Mapping[str, str]) -> None:
        """Start it; standard output and error come together."""
        self._changed = threading.Condition()
        self._lines: list[str] = []
        self._is_closed = False
        # A background job of a shell ignores SIGINT, and so would its children.
        if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        self.process = subprocess.Popen(
            arguments,
            env=dict(environment),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    @property
    def output(self) -> str:
        """Everything printed so far."""
        with self._changed:
            return ''.join(self._lines)

    def wait_for(self, pattern: str, *, seconds: float) -> re.Match[str]:
        """Wait until the output matches; fail when it ends before, or is late."""
        with self._changed:
            self._changed.wait_for(
                lambda: self._is_closed or re.search(pattern, ''.join(self._lines)), seconds
            )
        match = re.search(pattern, self.output)
        assert match, f'no {pattern!r} within {seconds} s in:\n{self.output}'
        return match

    def wait(self, *, seconds: float) -> int:
        """Wait for the end and return the exit code; fail when it is late."""
        code = self.process.wait(seconds)
        self._reader.join(seconds)
        return code

    def end(self, number: signal.Signals, *, seconds: float) -> int:
        """Send a signal and return the exit code."""
        self.process.send_signal(number)
        return self.wait(seconds=seconds)

    def leave(self, *, seconds: float = 5.0) -> None:
        """Make sure that it has ended: asked first, for a killed node haunts its ROS domain."""
        if self.process.poll() is None:
            self.process.terminate()
        try:
            self.wait(seconds=seconds)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.wait(seconds=seconds)

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            with self._changed:
                self._lines.append(line)
                self._changed.notify_all()
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()


@contextmanager
def running(arguments: Sequence[str], environment: Mapping[str, str]) -> Iterator[Child]:
    """Run a Python module or file as a process that does not outlive the block."""
    child = Child([sys.executable, *arguments], environment)
    try:
        yield child
    finally:
        child.leave()
