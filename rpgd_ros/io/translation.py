# SPDX-License-Identifier: Apache-2.0
"""One kind of error for whatever the libraries below raise on a damaged recording."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Literal

from rpgd_ros.core.errors import InputError, Reason


def bad_bag(path: Path, problem: str) -> InputError:
    """Return the error of a recording that cannot be read."""
    return InputError(Reason.BAD_BAG, f'{path}: cannot be read as a rosbag2: {problem[:300]}')


class Translation:
    """Turns whatever the libraries below raise on a damaged file into our error.

    rosbags passes on the errors of its storage and compression libraries (sqlite3, apsw, lz4,
    zstandard and backports.zstd, depending on its version) and, for damaged records, whatever
    Python says of them, down to AssertionError.
    """

    def __init__(self, path: Path) -> None:
        """Name the recording."""
        self._path = path

    def __enter__(self) -> None:
        """Begin."""

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> Literal[False]:
        """Raise our error in place of any other.

        Raises:
            InputError: BAD_BAG, from the error of the library.

        """
        if isinstance(error, Exception) and not isinstance(error, InputError):
            what = (str(error).splitlines() or [''])[0]
            raise bad_bag(self._path, f'{what or "damaged"} ({type(error).__name__})') from error
        return False
