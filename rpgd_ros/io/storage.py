# SPDX-License-Identifier: Apache-2.0
"""Opens the files of a recording: as a whole, else one by one, else what is left of them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path, PurePath
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, Protocol

from rosbags.rosbag2 import Reader

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.io.budget import bound_rosbags, check_database, limit_reader, unpack_file
from rpgd_ros.io.rescue import Rescue
from rpgd_ros.io.strict import MAX_BYTES, read_yaml
from rpgd_ros.io.translation import Translation, bad_bag

STORAGE_SUFFIXES = ('.mcap', '.db3')
PACKED_SUFFIX = '.zstd'  # behind the other one, where whole files are compressed


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
    bound_rosbags()
    if not path.is_dir():
        return _open_files([path], stack, problems=[])
    problems: list[str] = []
    try:
        information = _metadata(path)
        if str(information.get('compression_mode')).lower() != 'file':
            return Storages([_open_reader(path, stack)])
        files = _named_files(path, information)
    except InputError as error:
        problems.append(error.message)
        files = _files_of(path)
    return _open_files(files, stack, problems)._replace(claimed=_claimed(path))


def _open_files(files: Sequence[Path], stack: ExitStack, problems: list[str]) -> Storages:
    """Open files one by one; of damaged ones, what is left."""
    readers: list[StorageReader] = []
    for file in files:
        plain = file
        try:
            plain = _unpacked(file, stack) if file.suffix == PACKED_SUFFIX else file
            readers.append(_open_reader(plain, stack))
        except InputError as error:
            problems.append(error.message.replace(str(plain), str(file)))
            rescue = _rescue(plain)
            if rescue is not None:
                readers.append(rescue)
    if not readers:
        raise InputError(Reason.BAD_BAG, problems[-1])
    return Storages(readers, '; '.join(problems))


def _open_reader(path: Path, stack: ExitStack) -> Reader:
    with Translation(path):
        for database in [path] if path.is_file() else path.glob('*.db3'):
            if database.suffix == '.db3':
                check_database(database)
        reader = stack.enter_context(Reader(path))
        limit_reader(reader.storage)
        # Not by rosbags, which knows no limit: the stream recognises what is compressed.
        reader.storage.metadata = reader.storage.metadata._replace(compression_mode=None)
        formats = {getattr(c.ext, 'serialization_format', '') for c in reader.connections}
        if formats - {'cdr'}:
            raise bad_bag(path, f'messages are serialised as {sorted(formats)}, need cdr')
        return reader


def _named_files(path: Path, information: Mapping[str, Any]) -> list[Path]:
    """Return the files of a recording as its metadata.yaml names them."""
    with Translation(path):
        files = [path / PurePath(name).name for name in information['relative_file_paths']]
    if not files:
        raise bad_bag(path, 'metadata.yaml names no file')
    # Unpacked by hand, they have the names that they had before.
    plain = [file.with_name(file.name.removesuffix(PACKED_SUFFIX)) for file in files]
    return [p if p.is_file() and not f.exists() else f for f, p in zip(files, plain, strict=True)]


def _files_of(path: Path) -> list[Path]:
    """Return the files of a folder that look like those of a recording, in their order."""
    files = {p.name: p for p in path.iterdir() if p.is_file()}
    found = []
    for name, file in files.items():
        plain = name.removesuffix(PACKED_SUFFIX)
        # A recorder that is killed while it compresses a file leaves both, and the other is whole.
        if PurePath(plain).suffix in STORAGE_SUFFIXES and (plain == name or plain not in files):
            found.append(file)
    return sorted(found, key=_natural_order)


def _unpacked(packed: Path, stack: ExitStack) -> Path:
    """Decompress a file into a folder that the stack removes."""
    with Translation(packed):
        folder = Path(stack.enter_context(TemporaryDirectory(prefix='rpgd_ros_')))
        unpack_file(packed, folder / packed.stem)
    return folder / packed.stem


def _rescue(file: Path) -> Rescue | None:
    """Return what is left of a file, None where that is nothing."""
    try:
        with Translation(file):
            rescue = Rescue(file)
    except InputError:
        return None
    return rescue if rescue.connections else None


def _metadata(path: Path) -> Mapping[str, Any]:
    """Read metadata.yaml with our strict reader, before rosbags does with its own."""
    metadata = path / 'metadata.yaml'
    if not metadata.is_file():
        raise bad_bag(path, 'metadata.yaml is missing, so the recorder did not finish')
    with Translation(path):
        # The QoS of each publisher stands in one text: with twenty of them it is long.
        tree = read_yaml(metadata, Reason.BAD_BAG, max_scalar=MAX_BYTES).value
        information = tree['rosbag2_bagfile_information']
        if not isinstance(information, Mapping):
            raise bad_bag(path, 'metadata.yaml is none of a recorder')
        return information


def _claimed(path: Path) -> dict[str, int]:
    """Return the messages of each topic as metadata.yaml counts them; empty where it does not."""
    try:
        with Translation(path):
            topics = _metadata(path)['topics_with_message_count']
            return {str(t['topic_metadata']['name']): int(t['message_count']) for t in topics}
    except InputError:
        return {}


def _natural_order(path: Path) -> list[str | int]:
    """Order the files of a split bag: _2 before _10."""
    return [int(part) if part.isdigit() else part for part in re.split(r'(\d+)', path.name)]
