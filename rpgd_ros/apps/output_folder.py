# SPDX-License-Identifier: Apache-2.0
"""Writes a folder whole or not at all, and never over anything but an older one of its kind."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path

from rpgd_ros.core.errors import InputError, Reason


def check_output(output: Path, names: Collection[str], *, is_forced: bool) -> None:
    """Refuse to write over anything but, when told so, an older recording.

    Args:
        output: Folder that is to be written.
        names: What an older recording may hold.
        is_forced: Whether one may be replaced.

    Raises:
        InputError: NOT_WRITABLE.

    """
    try:
        _check(output, names, is_forced=is_forced)
    except OSError as error:
        msg = f'{output} cannot be written: {error.strerror or error}'
        raise InputError(Reason.NOT_WRITABLE, msg) from error


def _check(output: Path, names: Collection[str], *, is_forced: bool) -> None:
    """Refuse as `check_output`; OSError where the operating system does not let look."""
    if not output.parent.is_dir():
        msg = f'{output.parent} is no folder: create it first'
        raise InputError(Reason.NOT_WRITABLE, msg)
    if not (output.exists() or output.is_symlink()):
        return
    if not is_forced:
        msg = f'{output} exists: choose another name, or --force to replace an older recording'
        raise InputError(Reason.NOT_WRITABLE, msg)
    if output.is_symlink() or not output.is_dir():
        msg = f'{output} is no folder: --force replaces older recordings only'
        raise InputError(Reason.NOT_WRITABLE, msg)
    foreign = sorted(p.name for p in output.iterdir() if p.name not in names)
    if foreign:
        msg = f'{output} holds {foreign[0][:80]!r}: --force replaces older recordings only'
        raise InputError(Reason.NOT_WRITABLE, msg)


@contextmanager
def scratch_folder(output: Path) -> Iterator[Path]:
    """Give a folder beside the output, and take away whatever is left of it.

    Raises:
        InputError: NOT_WRITABLE.

    """
    try:
        folder = tempfile.mkdtemp(prefix=f'.{output.name}.', suffix='.tmp', dir=output.parent)
    except OSError as error:
        msg = f'{output.parent} cannot be written: {error.strerror or error}'
        raise InputError(Reason.NOT_WRITABLE, msg) from error
    try:
        yield Path(folder)
    except InputError as error:
        # What a person asked for, not a folder that is gone when they read of it.
        said = error.message.replace(folder, str(output))
        raise InputError(error.reason, said) from error
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def finish(scratch: Path, names: Collection[str]) -> Path:
    """Move what was written into a folder with the rights of any other, and return it."""
    finished = scratch / 'finished'
    finished.mkdir(mode=0o755)
    for name in names:
        (scratch / name).rename(finished / name)
    return finished


def put_in_place(finished: Path, output: Path) -> None:
    """Rename the finished folder; an older recording goes out with the scratch folder.

    Args:
        finished: Folder within that of `scratch_folder`.
        output: What it becomes.

    Raises:
        InputError: NOT_WRITABLE; an older recording stays.

    """
    replaced = finished.parent / 'replaced'
    try:
        if output.exists():
            output.rename(replaced)
        finished.rename(output)
    except OSError as error:
        if replaced.exists() and not output.exists():
            replaced.rename(output)
        msg = f'{output} cannot be written: {error.strerror or error}'
        raise InputError(Reason.NOT_WRITABLE, msg) from error
