# SPDX-License-Identifier: Apache-2.0
"""rosbag2 recordings: mcap and sqlite3, Humble to Jazzy, raw messages in and out, without ROS."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Literal, NamedTuple, Self

from rosbags.rosbag2 import Reader

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.io.bag_writer import BagWriter

__all__ = ['Bag', 'BagWriter', 'TopicInfo', 'absolute_name', 'open_bag']

STORAGE_SUFFIXES = ('.mcap', '.db3')
MAX_METADATA_BYTES = 1024 * 1024  # a bag of 1000 topics has 0.3 MiB


class TopicInfo(NamedTuple):
    """What a bag says of a topic.

    Attributes:
        msgtype: Message type; several, joined by ' and ', where the topic changed its type.
        n_messages: Number of messages.

    """

    msgtype: str
    n_messages: int


class Bag:
    """An open recording; close it, or use it as a context manager.

    Attributes:
        path: Where it lies.
        topics: What it holds, by absolute topic name.
        problem: What is wrong with the bag, '' = nothing. May be known after `stream` only.
        n_read: Messages that the last `stream` gave.
        n_expected: Messages that it should have given.

    """

    def __init__(self, path: Path, readers: list[Reader], stack: ExitStack, problem: str) -> None:
        """Take over open readers and the stack that closes them; call `open_bag` instead."""
        self.path = path
        self.topics: Mapping[str, TopicInfo] = MappingProxyType(_topics(readers))
        self.problem = problem
        self.n_read = self.n_expected = 0
        self._readers = readers
        self._stack = stack

    @property
    def is_partial(self) -> bool:
        """Whether messages are missing, as far as is known."""
        return bool(self.problem)

    def stream(self, topics: Collection[str]) -> Iterator[tuple[str, int, bytes]]:
        """Yield the messages of some topics in the order of the recording.

        Where the bag breaks off, so does this; `problem` says so afterwards.

        Args:
            topics: Absolute names; those that the bag does not have are left out.

        Yields:
            Topic, arrival (ns), and the serialised message.

        Raises:
            InputError: Nothing at all can be read.

        """
        self.n_read = 0
        self.n_expected = sum(
            self.topics[topic].n_messages for topic in set(topics) & set(self.topics)
        )
        failure: InputError | None = None
        for reader in self._readers:
            try:
                yield from self._stream_one(reader, topics)
            except InputError as error:
                failure = error
        if failure and not self.n_read:
            raise failure
        if failure or self.n_read < self.n_expected:
            cause = failure.message if failure else f'{self.path}: ends early'
            self.problem = f'{self.n_read} of {self.n_expected} messages: {cause}'

    def _stream_one(
        self, reader: Reader, topics: Collection[str]
    ) -> Iterator[tuple[str, int, bytes]]:
        with _Translation(self.path):
            connections = [c for c in reader.connections if c.topic in topics]
            if not connections:  # which would mean all to rosbags
                return
            for connection, receive_ns, payload in reader.messages(connections):
                # sqlite3 stores in any column what a writer puts there.
                if not isinstance(payload, bytes) or not isinstance(receive_ns, int):
                    msg = f'a message of {connection.topic!r} is no bytes or has no time'
                    raise TypeError(msg)
                self.n_read += 1
                yield connection.topic, receive_ns, payload

    def close(self) -> None:
        """Close all files."""
        self._stack.close()

    def __enter__(self) -> Self:
        """Return the bag, which is open already."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Close all files."""
        self.close()


def open_bag(path: Path | str) -> Bag:
    """Open a recording.

    Args:
        path: The folder with metadata.yaml, or one .mcap or .db3 file. Without its metadata.yaml
            a folder is read file by file.

    Raises:
        InputError: It cannot be read at all.

    """
    path = Path(path)
    if path.name == 'metadata.yaml':
        path = path.parent
    with ExitStack() as stack, _Translation(path):
        if not path.exists():
            raise _bad_bag(path, 'there is no such file or folder')
        readers, problem = _open_readers(path, stack)
        return Bag(path, readers, stack.pop_all(), problem)


def absolute_name(topic: str) -> str:
    """Return the name that a topic has in a bag of a node without a namespace."""
    return '/' + topic.lstrip('/')


def _open_readers(path: Path, stack: ExitStack) -> tuple[list[Reader], str]:
    """Open a bag as a whole or, where that fails, file by file; say what could not be read."""
    if not path.is_dir():
        return [_open_reader(path, stack)], ''
    failures = []
    try:
        _check_metadata(path)
        return [_open_reader(path, stack)], ''
    except InputError as error:
        failures.append(error)
    readers = []
    for file in sorted(path.iterdir(), key=_natural_order):
        if file.suffix in STORAGE_SUFFIXES and file.is_file():
            try:
                readers.append(_open_reader(file, stack))
            except InputError as error:
                failures.append(error)
    if not readers:
        raise failures[-1]
    return readers, '; '.join(failure.message for failure in failures)


def _check_metadata(path: Path) -> None:
    metadata = path / 'metadata.yaml'
    if not metadata.is_file():
        raise _bad_bag(path, 'metadata.yaml is missing, so the recorder did not finish')
    if metadata.stat().st_size > MAX_METADATA_BYTES:
        raise _bad_bag(path, f'metadata.yaml has more than {MAX_METADATA_BYTES} bytes')


def _open_reader(path: Path, stack: ExitStack) -> Reader:
    if path.is_file() and path.suffix == '.bag':
        raise _bad_bag(path, 'a ROS 1 bag; convert it with rosbags-convert')
    with _Translation(path):
        reader = stack.enter_context(Reader(path))
        formats = {getattr(c.ext, 'serialization_format', '') for c in reader.connections}
        if formats - {'cdr'}:
            raise _bad_bag(path, f'messages are serialised as {sorted(formats)}, need cdr')
        return reader


def _natural_order(path: Path) -> list[str | int]:
    """Order the files of a split bag: _2 before _10."""
    return [int(part) if part.isdigit() else part for part in re.split(r'(\d+)', path.name)]


def _topics(readers: list[Reader]) -> dict[str, TopicInfo]:
    types: dict[str, set[str]] = {}
    counts: dict[str, int] = {}
    for reader in readers:
        for connection in reader.connections:
            types.setdefault(connection.topic, set()).add(connection.msgtype)
            counts[connection.topic] = counts.get(connection.topic, 0) + connection.msgcount
    return {
        topic: TopicInfo(' and '.join(sorted(types[topic])), counts[topic])
        for topic in sorted(types)
    }


def _bad_bag(path: Path, problem: str) -> InputError:
    return InputError(Reason.BAD_BAG, f'{path}: cannot be read as a rosbag2: {problem[:300]}')


class _Translation:
    """Turns whatever the libraries below raise on a damaged file into our error.

    rosbags passes on the errors of its storage and compression libraries (sqlite3, apsw, lz4,
    zstandard and backports.zstd, depending on its version) and, for damaged records, whatever
    Python says of them, down to AssertionError.
    """

    def __init__(self, path: Path) -> None:
        self._path = path

    def __enter__(self) -> None:
        pass

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> Literal[False]:
        if isinstance(error, Exception) and not isinstance(error, InputError):
            what = (str(error).splitlines() or [''])[0]
            raise _bad_bag(self._path, f'{what or "damaged"} ({type(error).__name__})') from error
        return False
