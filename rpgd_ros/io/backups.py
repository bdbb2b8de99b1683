# SPDX-License-Identifier: Apache-2.0
"""Dated copies of files that are replaced."""

from __future__ import annotations

import contextlib
import re
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.observations import NS_PER_S
from rpgd_ros.io.atomic import write_atomic

MAX_BACKUPS: Final = 10  # of a node that calibrates by itself; the oldest go
DATE: Final = re.compile(r'\d{8}T\d{6}\.\d{3}')


def backups(path: Path | str) -> list[Path]:
    """Return the dated backups of a result file, newest first."""
    path = Path(path)
    return sorted(
        (
            other
            for other in path.parent.glob('*')
            if other.name.startswith(f'{path.stem}.')
            and DATE.fullmatch(other.name[len(path.stem) + 1 :].removesuffix(path.suffix))
        ),
        reverse=True,
    )


def back_up(path: Path) -> None:
    """Copy the file that is to be replaced, and let go of the oldest copies."""
    try:
        data, changed_ns = path.read_bytes(), path.stat().st_mtime_ns
    except FileNotFoundError:
        return
    except OSError as error:
        msg = f'{path} cannot be read for a backup: {error.strerror or error}'
        raise InputError(Reason.NOT_WRITABLE, msg) from error
    date = utc(changed_ns).translate({ord(c): None for c in '-:Z'})
    newest = path.with_name(f'{path.stem}.{date}{path.suffix}')
    write_atomic(newest, data)
    # Where the clock was set back, others claim to be later than the one just written.
    others = [other for other in backups(path) if other != newest]
    for oldest in others[MAX_BACKUPS - 1 :]:
        with contextlib.suppress(OSError):
            oldest.unlink()


def utc(stamp_ns: int) -> str:
    """Return UTC with milliseconds, as in 2026-01-31T12:05:09.123Z."""
    seconds, ns = divmod(int(stamp_ns), NS_PER_S)
    text = datetime.fromtimestamp(seconds, tz=UTC).strftime('%Y-%m-%dT%H:%M:%S')
    return f'{text}.{ns // 1_000_000:03}Z'
