# SPDX-License-Identifier: Apache-2.0
"""Where `calibrate_bag` may write: nowhere that a file would be lost, or the writing fail."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.io.atomic import refuse_link
from rpgd_ros.io.storage import PACKED_SUFFIX, STORAGE_SUFFIXES
from rpgd_ros.report import check_libraries
from rpgd_ros.report.film import FILMS

RIG_SUFFIXES: Final = ('.yaml', '.yml', '.toml')
METADATA: Final = 'metadata.yaml'
RECORDED: Final = (*STORAGE_SUFFIXES, PACKED_SUFFIX)
PLACES: Final = ('output', 'write_rig', 'export', 'annotated', 'overlay', 'report')


def check_outputs(arguments: argparse.Namespace, rig_file: Path | None) -> None:
    """Refuse, before the work, what could not be written after it, or would be written over.

    Args:
        arguments: Of the command line.
        rig_file: The one that is read, wherever it was named.

    Raises:
        InputError: NOT_WRITABLE, or a library is missing.

    """
    given = {name: getattr(arguments, name) for name in PLACES}
    outputs: dict[str, Path] = {name: path for name, path in given.items() if path is not None}
    for name, path in outputs.items():
        try:
            _check_place(name, path)
        except OSError as error:
            msg = f'{path} cannot be written: {error.strerror or error}'
            raise InputError(Reason.NOT_WRITABLE, msg) from error
    taken = _taken(arguments, rig_file) if outputs else {}
    for name, path in outputs.items():
        identity, option = _identity(path), f'--{name.replace("_", "-")}'
        if identity in taken:
            msg = f'{option} {path}: this {taken[identity]}, it would be lost: choose another name'
            raise InputError(Reason.NOT_WRITABLE, msg)
        taken[identity] = f'is what {option} writes'
    if 'report' in outputs:
        check_libraries()


def _check_place(name: str, path: Path) -> None:
    """Refuse one output; OSError where the operating system would."""
    if not path.absolute().parent.is_dir():
        msg = f'{path.parent} is no folder: create it first'
        raise InputError(Reason.NOT_WRITABLE, msg)
    if name == 'write_rig' and path.suffix not in RIG_SUFFIXES:
        msg = f'{path}: need a name that ends in {", ".join(RIG_SUFFIXES)}'
        raise InputError(Reason.NOT_WRITABLE, msg)
    is_there = path.exists() or path.is_symlink()
    if name == 'annotated' and is_there:
        msg = f'{path} exists already: remove it, or choose another place'
        raise InputError(Reason.NOT_WRITABLE, msg)
    if name == 'export' or (name == 'overlay' and path.suffix not in FILMS):
        if is_there and not path.is_dir():
            msg = f'{path} is no folder: choose another name'
            raise InputError(Reason.NOT_WRITABLE, msg)
        return
    refuse_link(path)
    # What is neither would be replaced by a file: a pipe, a device.
    if is_there and not path.is_file():
        what = 'a folder' if path.is_dir() else 'no file'
        msg = f'{path} is {what}: give the name of a file'
        raise InputError(Reason.NOT_WRITABLE, msg)


def _taken(
    arguments: argparse.Namespace, rig_file: Path | None
) -> dict[tuple[int, int] | str, str]:
    """Return what is read; what cannot be looked at is left to its reader to say."""
    taken = {}
    with suppress(OSError):
        for path in _inputs(arguments, rig_file):
            taken[_identity(path)] = 'is read'
    return taken


def _inputs(arguments: argparse.Namespace, rig_file: Path | None) -> Iterator[Path]:
    """Yield what is read: rig file, parameters, the bag with its files."""
    yield from (path for path in (rig_file, arguments.params) if path is not None)
    bag: Path = arguments.bag
    yield bag
    folder = bag if bag.name != METADATA and bag.is_dir() else bag.parent
    yield folder / METADATA
    if folder == bag or bag.name == METADATA:
        yield folder
        yield from (path for path in folder.iterdir() if path.suffix in RECORDED)


def _identity(path: Path) -> tuple[int, int] | str:
    """Return what is the same for all names of a file, there or not."""
    try:
        status = path.stat()
    except OSError:
        return os.path.realpath(path)
    return status.st_dev, status.st_ino
