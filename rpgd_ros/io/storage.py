# SPDX-License-Identifier: Apache-2.0
"""Opens the files of a recording: as a whole, else one by one, else what is left of them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from rosbags.rosbag2 import Reader

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.io.rescue import Rescue
from rpgd_ros.io.strict import MAX_BYTES, read_yaml
from rpgd_ros.io.translation import Translation, bad_bag

STORAGE_SUFFIXES = ('.mcap', '.db3')


class StorageReader(Protocol):
    """What is asked of a file, or of a whole recording."""

    @property
    def connections(self) -> Sequence[Any]:
        """Topics, each with `topic`, `msgtype` and `msgcount`."""
        ...

    def messages(self, connections: Sequence[Any]) -> Iterable[tuple[Any, int, bytes]]:
        """Yield connection, arrival (ns) and serialised message."""
        ...


class Storages(NamedTuple):
    """The files of a recording.

    Attributes:
        readers: Open, in the order of recording.
        problem: What could not be read, '' = nothing.
        claimed: Messages of each topic by metadata.yaml, where the files themselves do not say.

    """

    readers: list[StorageReader]
    problem: str = ''
    claimed: Mapping[str, int] = {}


def open_storages(path: Path, stack: ExitStack) -> Storages:
    """Open a recording; the stack closes it.

    Raises:
        InputError: BAD_BAG. Nothing of it can be read.

    """
    if not path.exists():
        raise bad_bag(path, 'there is no such file or folder')
    if path.suffix == '.bag' and path.is_file():
        raise bad_bag(path, 'a ROS 1 bag; convert it with rosbags-convert')
    if not path.is_dir():
        return _open_files([path], stack, problems=[])
    try:
        _check_metadata(path)
        return Storages([_open_reader(path, stack)])
    except InputError as error:
        files = [p for p in path.iterdir() if p.suffix in STORAGE_SUFFIXES and p.is_file()]
        storages = _open_files(sorted(files, key=_natural_order), stack, [error.message])
        return storages._replace(claimed=_claimed(path))


def _open_files(files: Sequence[Path], stack: ExitStack, problems: list[str]) -> Storages:
    """Open files one by one; of damaged ones, what is left."""
    readers: list[StorageReader] = []
    for file in files:
        try:
            readers.append(_open_reader(file, stack))
        except InputError as error:
            problems.append(error.message)
            rescue = _rescue(file)
            if rescue is not None:
                readers.append(rescue)
    if not readers:
        raise InputError(Reason.BAD_BAG, problems[-1])
    return Storages(readers, '; '.join(problems))


def _open_reader(path: Path, stack: ExitStack) -> Reader:
    with Translation(path):
        reader = stack.enter_context(Reader(path))
        formats = {getattr(c.ext, 'serialization_format', '') for c in reader.connections}
        if formats - {'cdr'}:
            raise bad_bag(path, f'messages are serialised as {sorted(formats)}, need cdr')
        return reader


def _rescue(file: Path) -> Rescue | None:
    """Return what is left of a file, None where that is nothing."""
    try:
        with Translation(file):
            rescue = Rescue(file)
    except InputError:
        return None
    return rescue if rescue.connections else None


def _check_metadata(path: Path) -> None:
    metadata = path / 'metadata.yaml'
    if not metadata.is_file():
        raise bad_bag(path, 'metadata.yaml is missing, so the recorder did not finish')
    if metadata.stat().st_size > MAX_BYTES:
        raise bad_bag(path, f'metadata.yaml has more than {MAX_BYTES} bytes')


def _claimed(path: Path) -> dict[str, int]:
    """Return the messages of each topic as metadata.yaml counts them; empty where it does not."""
    try:
        with Translation(path):
            information = read_yaml(path / 'metadata.yaml', Reason.BAD_BAG).value
            topics = information['rosbag2_bagfile_information']['topics_with_message_count']
            return {str(t['topic_metadata']['name']): int(t['message_count']) for t in topics}
    except InputError:
        return {}


def _natural_order(path: Path) -> list[str | int]:
    """Order the files of a split bag: _2 before _10."""
    return [int(part) if part.isdigit() else part for part in re.split(r'(\d+)', path.name)]
