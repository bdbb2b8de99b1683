# SPDX-License-Identifier: Apache-2.0
"""The one way in which this package writes a file: whole, or not at all."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from rpgd_ros.core.errors import InputError, Reason

SUFFIX = '.tmp'


def write_atomic(path: Path | str, data: str | bytes, mode: int = 0o644) -> None:
    """Write a file so that readers, crashes and full disks find the old one or the new one.

    A temporary file in the same folder is written, flushed to the disk and renamed; of several
    writers the last one wins whole.

    Args:
        path: Target. The folder must exist.
        data: Text (UTF-8) or bytes.
        mode: Permissions of the file.

    Raises:
        InputError: NOT_WRITABLE. The target is a link, or what the operating system says; an old
            file is untouched and no temporary one is left.

    """
    with staged(path, data, mode) as put:
        put()


@contextmanager
def staged(path: Path | str, data: str | bytes, mode: int = 0o644) -> Iterator[Callable[[], None]]:
    """Write a file whole onto the disk, but into its place only when told to; else it goes.

    Arguments and errors as for `write_atomic`.

    Yields:
        What puts it into its place.

    """
    path = Path(path)
    refuse_link(path)
    with _said(path, 'written'):
        temporary = _temporary(path, data.encode() if isinstance(data, str) else data, mode)

    def put() -> None:
        with _said(path, 'written'):
            temporary.replace(path)
        _flush_folder(path.parent)

    try:
        yield put
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()


def refuse_link(path: Path) -> None:
    """Refuse to write a file in the place of a symbolic link.

    Raises:
        InputError: NOT_WRITABLE. It is one, or the operating system does not let look.

    """
    with _said(path, 'written'):
        is_link = path.is_symlink()
    if is_link:
        msg = f'{path} is a symbolic link: give the file itself'
        raise InputError(Reason.NOT_WRITABLE, msg)


@contextmanager
def set_aside(path: Path | str) -> Iterator[None]:
    """Take a file, if there is one, out of its place; it goes, or comes back on an exception.

    Raises:
        InputError: NOT_WRITABLE. It is no file, or what the operating system says.

    """
    path = Path(path)
    aside = path.with_name(f'.{path.name}.{os.getpid()}.aside{SUFFIX}')
    with _said(path, 'removed'):
        is_file = path.is_file() or not path.exists()
    if not is_file:
        msg = f'{path} cannot be removed: it is no file'
        raise InputError(Reason.NOT_WRITABLE, msg)
    with _said(path, 'removed'):
        aside.unlink(missing_ok=True)  # of a killed process that had our number
        with contextlib.suppress(FileNotFoundError):
            path.replace(aside)
    try:
        yield
    except BaseException:
        with contextlib.suppress(OSError):
            aside.replace(path)
        raise
    with _said(path, 'removed'):
        aside.unlink(missing_ok=True)


def make_folder(folder: Path) -> None:
    """Make a folder, if there is none, and those above it.

    Raises:
        InputError: NOT_WRITABLE.

    """
    with _said(folder, 'made'):
        folder.mkdir(parents=True, exist_ok=True)


def remove_leftovers(path: Path | str) -> None:
    """Remove temporary files that killed writers have left in the folder of a target.

    Those of files with the same stem go as well: its backups, and what is kept beside it.
    """
    path = Path(path)
    for leftover in path.parent.glob(f'.{_escaped(path.stem)}.*{SUFFIX}'):
        # .<name>.<process>.<random>.tmp
        pid = leftover.name.removesuffix(SUFFIX).rpartition('.')[0].rpartition('.')[2]
        if pid.isdigit() and not _is_alive(int(pid)):
            with contextlib.suppress(OSError):
                leftover.unlink()


@contextmanager
def _said(path: Path, done: str) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        msg = f'{path} cannot be {done}: {error.strerror or error}'
        raise InputError(Reason.NOT_WRITABLE, msg) from error


def _temporary(path: Path, data: bytes, mode: int) -> Path:
    """Write a temporary file in the folder of a target."""
    # The process is in the name, so that leftovers of a dead one can be told from files at work.
    prefix = f'.{path.name}.{os.getpid()}.'
    descriptor, temporary = tempfile.mkstemp(suffix=SUFFIX, prefix=prefix, dir=path.parent)
    try:
        with os.fdopen(descriptor, 'wb') as file:
            file.write(data)
            file.flush()
            os.fchmod(file.fileno(), mode)  # mkstemp gives 0600, whatever the umask
            os.fsync(file.fileno())
    except BaseException:
        with contextlib.suppress(OSError):
            Path(temporary).unlink()
        raise
    return Path(temporary)


def _flush_folder(folder: Path) -> None:
    # The file is in place already; some file systems cannot flush a folder.
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        return True
    return True


def _escaped(name: str) -> str:
    return ''.join(f'[{c}]' if c in '*?[' else c for c in name)
