# SPDX-License-Identifier: Apache-2.0
"""Prints so that foreign text does nothing, and that it is known when nobody can read it."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import TextIOWrapper
from typing import Any

from rich.console import Console
from rich.text import Text

from rpgd_ros.report.plain import plain

EXIT_CANNOT_PRINT = 74  # EX_IOERR of sysexits.h


class CannotPrintError(Exception):
    """The reader of a pipe is gone, or the disk that the output goes to is full."""


class Terminal(Console):
    """A console for sentences and tables with foreign words in them."""

    def render_str(self, text: str, *args: Any, **kwargs: Any) -> Text:
        """Render a string, in a table or not, as rich does; what cannot be seen is escaped."""
        return super().render_str(plain(text), *args, **kwargs)

    def print(self, *objects: Any, **kwargs: Any) -> None:
        """Print as rich does.

        Raises:
            CannotPrintError: It was in vain.

        """
        with _noticed():
            super().print(*objects, **kwargs)

    def on_broken_pipe(self) -> None:
        """Leave it to the program how to end; rich would end it as one that found a fault.

        Raises:
            CannotPrintError: Always.

        """
        raise CannotPrintError(os.strerror(errno.EPIPE))

    def write(self, text: str) -> None:
        """Print a text for programs as it is.

        Raises:
            CannotPrintError: It was in vain.

        """
        with _noticed():
            self.file.write(f'{text}\n')
            self.file.flush()


def terminals() -> tuple[Terminal, Terminal]:
    """Return what prints to the output and to the error output."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            # A name that the terminal cannot show is no reason to end.
            stream.reconfigure(errors='backslashreplace')
    return Terminal(emoji=False), Terminal(stderr=True, emoji=False)


def give_up_printing(sentence: str) -> int:
    """Say on the error output, where that is possible, why there is no more; returns the code."""
    with suppress(OSError):
        print(plain(sentence), file=sys.stderr, flush=True)
    for stream in (sys.stdout, sys.stderr):
        # What is left in a buffer would fail again when Python ends, with a code of its own.
        with suppress(OSError):
            stream.flush()
            continue
        with suppress(OSError):
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, stream.fileno())
            os.close(nowhere)
    return EXIT_CANNOT_PRINT


@contextmanager
def _noticed() -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise CannotPrintError(error.strerror or str(error)) from error
