# SPDX-License-Identifier: Apache-2.0
"""rosbag2 recordings: mcap and sqlite3, Humble to Jazzy, raw messages in and out, without ROS."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import NamedTuple, Self

from rpgd_ros.core.errors import InputError
from rpgd_ros.io.bag_writer import BagWriter
from rpgd_ros.io.budget import unpack_message
from rpgd_ros.io.storage import StorageReader, Storages, open_storages
from rpgd_ros.io.translation import Translation
from rpgd_ros.messages import MAX_MESSAGE_BYTES

__all__ = ['Bag', 'BagWriter', 'TopicInfo', 'absolute_name', 'open_bag']

ZSTD_MAGIC = b'\x28\xb5\x2f\xfd'  # no CDR message begins like this


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

    def __init__(self, path: Path, storages: Storages, stack: ExitStack) -> None:
        """Take over open files and the stack that closes them; call `open_bag` instead."""
        self.path = path
        self.topics: Mapping[str, TopicInfo] = MappingProxyType(_topics(storages.readers))
        self.problem = storages.problem
        self.n_read = self.n_expected = 0
        self._storages = storages
        self._stack = stack

    @property
    def is_partial(self) -> bool:
        """Whether messages are missing, as far as is known."""
        return bool(self.problem)

    def stream(
        self, topics: Collection[str], *, longest: int = MAX_MESSAGE_BYTES
    ) -> Iterator[tuple[str, int, bytes]]:
        """Yield the messages of some topics in the order of the recording.

        Where the bag breaks off, so does this; `problem` says so afterwards.

        Args:
            topics: Absolute names; those that the bag does not have are left out.
            longest: Bytes of a message that are given; one that is longer loses its end.

        Yields:
            Topic, arrival (ns), and the serialised message.

        Raises:
            InputError: Nothing at all can be read.

        """
        claimed = self._storages.claimed
        wanted = [topic for topic in self.topics if topic in topics]
        self.n_read = 0
        self.n_expected = sum(
            max(self.topics[topic].n_messages, claimed.get(topic, 0)) for topic in wanted
        )
        failure: InputError | None = None
        for reader in self._storages.readers:
            try:
                yield from self._stream_one(reader, wanted, longest)
            except InputError as error:
                failure = error
        if failure and not self.n_read:
            raise failure
        self.problem = self._shortfall(failure)

    def _shortfall(self, failure: InputError | None) -> str:
        """Say how much is missing, and why."""
        causes = [self._storages.problem, failure.message if failure else '']
        if self.n_read < self.n_expected and not any(causes):
            causes.append(f'{self.path} has fewer than its metadata.yaml counts')
        if not any(causes):
            return ''
        is_known = bool(self._storages.claimed) or not self._storages.problem
        total = str(self.n_expected) if is_known else 'an unknown number of'
        return f'{self.n_read} of {total} messages: {"; ".join(filter(None, causes))}'

    def _stream_one(
        self, reader: StorageReader, topics: Collection[str], longest: int
    ) -> Iterator[tuple[str, int, bytes]]:
        with Translation(self.path):
            connections = [c for c in reader.connections if c.topic in topics]
            if not connections:  # which would mean all to rosbags
                return
            for connection, receive_ns, payload in reader.messages(connections):
                # sqlite3 stores in any column what a writer puts there.
                if not isinstance(payload, bytes) or not isinstance(receive_ns, int):
                    msg = f'a message of {connection.topic!r} is no bytes or has no time'
                    raise TypeError(msg)
                message = payload
                if payload.startswith(ZSTD_MAGIC):
                    # Compressed message by message, as only metadata.yaml says.
                    message = unpack_message(payload, longest + 1)
                self.n_read += 1
                # The decoder counts what is longer than a message may be, and needs no more of it.
                yield connection.topic, receive_ns, message[: longest + 1]

    def definitions(self) -> dict[str, str]:
        """Return the definition of each topic's type, '' where the bag has none (Humble)."""
        found: dict[str, str] = {}
        for reader in self._storages.readers:
            for connection in reader.connections:
                text = getattr(getattr(connection, 'msgdef', None), 'data', '')
                found[connection.topic] = found.get(connection.topic) or str(text)
        return found

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
        path: The folder with metadata.yaml, or one .mcap or .db3 file, also with .zstd behind it.
            Without its metadata.yaml a folder is read file by file, and of damaged files what is
            left.

    Raises:
        InputError: It cannot be read at all.

    """
    path = Path(path)
    if path.name == 'metadata.yaml':
        path = path.parent
    with ExitStack() as stack, Translation(path):
        storages = open_storages(path, stack)
        return Bag(path, storages, stack.pop_all())


def absolute_name(topic: str) -> str:
    """Return the name that a topic has in a bag of a node without a namespace."""
    return '/' + topic.lstrip('/')


def _topics(readers: Sequence[StorageReader]) -> dict[str, TopicInfo]:
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
