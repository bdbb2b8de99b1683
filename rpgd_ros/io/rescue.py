# SPDX-License-Identifier: Apache-2.0
"""Reads what is left of a storage file whose end is missing: from the front, up to the damage.

The recorder of a robot that lost power leaves an mcap file without its index, or an sqlite3 file
without its last pages; the ordinary reader needs both.
"""

from __future__ import annotations

import sqlite3
import struct
from collections import Counter, deque
from collections.abc import Collection, Iterator
from contextlib import closing
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple
from zlib import crc32

from rosbags.rosbag2.storage_mcap import DECOMPRESSORS

from rpgd_ros.core.errors import InputError
from rpgd_ros.io.budget import (
    MAX_UNPACKED_BYTES,
    check_tables,
    limit_lengths,
)
from rpgd_ros.io.translation import Translation

MCAP_MAGIC: Final = b'\x89MCAP0\r\n'
SCHEMA, CHANNEL, MESSAGE, CHUNK, FOOTER = 0x03, 0x04, 0x05, 0x06, 0x02
MESSAGE_HEAD: Final = struct.Struct('<HIQQ')  # channel, sequence, arrival, publication


class RescuedConnection(NamedTuple):
    """A topic of a damaged file, as far as a reader of bags asks.

    Attributes:
        topic: Its name.
        msgtype: Its type.
        msgcount: Messages found.

    """

    topic: str
    msgtype: str
    msgcount: int


RescuedMessage = tuple[RescuedConnection, int, bytes]
_Found = tuple[str, str, int, bytes]


class Rescue:
    """What is left of one storage file.

    Attributes:
        connections: Topics with at least one message.

    """

    def __init__(self, path: Path) -> None:
        """Read the file once to see what there is."""
        self._path = path
        counts = Counter((topic, msgtype) for topic, msgtype, _, _ in self._found())
        self.connections = [RescuedConnection(*key, n) for key, n in counts.items()]

    def messages(self, connections: Collection[RescuedConnection]) -> Iterator[RescuedMessage]:
        """Yield connection, arrival (ns) and serialised message, in the order of the file."""
        wanted = {(c.topic, c.msgtype): c for c in connections}
        for topic, msgtype, receive_ns, payload in self._found():
            if (topic, msgtype) in wanted:
                yield wanted[topic, msgtype], receive_ns, payload

    def _found(self) -> Iterator[_Found]:
        if self._path.suffix == '.mcap':
            return _mcap_messages(self._path)
        return _sqlite3_messages(self._path)


def _sqlite3_messages(path: Path) -> Iterator[_Found]:
    """Yield messages in the order of their rows, up to the first page that is missing.

    Where the file ends within a page, the rest of that page reads as zeros: the last rows, as
    many as a page holds, are not to be trusted.
    """
    uri = f'{path.absolute().as_uri()}?immutable=1'
    held: deque[_Found] = deque()
    with closing(sqlite3.connect(uri, uri=True)) as database:
        try:
            # Not to write, but because sqlite3 then bears with a file that is too short.
            database.execute('PRAGMA writable_schema = ON')
            limit_lengths(database)
            check_tables(database, path)
            (n_distrusted,) = database.execute('PRAGMA page_size').fetchone()
            n_held = 0
            for found in _rows(database):
                held.append(found)
                n_held += len(found[-1])
                while n_held - len(held[0][-1]) >= n_distrusted:
                    n_held -= len(held[0][-1])
                    yield held.popleft()
        except (sqlite3.DatabaseError, TypeError):
            return
    yield from held


def _rows(database: sqlite3.Connection) -> Iterator[_Found]:
    """Yield the messages of a database.

    Raises:
        sqlite3.DatabaseError: A page is missing.
        TypeError: A row is no message.

    """
    names = 'SELECT id, name, type FROM topics'
    topics = {key: (topic, msgtype) for key, topic, msgtype in database.execute(names)}
    query = 'SELECT topic_id, timestamp, data FROM messages NOT INDEXED ORDER BY id'
    for key, receive_ns, payload in database.execute(query):
        if not isinstance(receive_ns, int) or not isinstance(payload, bytes):
            msg = f'a row of {type(receive_ns)} and {type(payload)}'
            raise TypeError(msg)
        if key in topics:
            yield *topics[key], receive_ns, payload


def _mcap_messages(path: Path) -> Iterator[_Found]:
    """Yield messages in the order of their records, up to the first record that is cut off.

    A chunk whose checksum does not fit is left out; the next one begins where it says.
    """
    topics = _Topics()
    with path.open('rb') as file:
        if file.read(len(MCAP_MAGIC)) != MCAP_MAGIC:
            return
        for code, body in _records(file):
            if code == FOOTER:
                return
            if code == CHUNK:
                yield from topics.messages_of(_unpacked(body, path))
            else:
                yield from topics.message_of(code, body)


def _records(file: BinaryIO) -> Iterator[tuple[int, bytes]]:
    while len(head := file.read(9)) == 9:
        code, size = struct.unpack('<BQ', head)
        if size > MAX_UNPACKED_BYTES:
            return
        body = file.read(size)
        if len(body) < size:
            return
        yield code, body


def _unpacked(chunk: bytes, path: Path) -> bytes:
    """Return the records of a chunk, none where it is damaged."""
    try:
        with Translation(path):
            size, checksum, n_name = struct.unpack_from('<QII', chunk, 16)
            name = chunk[32 : 32 + n_name].decode()
            (n_packed,) = struct.unpack_from('<Q', chunk, 32 + n_name)
            packed = chunk[40 + n_name : 40 + n_name + n_packed]
            raw = DECOMPRESSORS[name](packed, size) if size <= MAX_UNPACKED_BYTES else b''
    except InputError:
        return b''
    return raw if len(raw) == size and checksum in {0, crc32(raw)} else b''


class _Topics:
    """Schemas and channels seen so far, and the messages that go by them."""

    def __init__(self) -> None:
        self._types: dict[int, str] = {}
        self._channels: dict[int, tuple[str, str]] = {}

    def messages_of(self, records: bytes) -> Iterator[_Found]:
        """Yield the messages of an unpacked chunk."""
        position = 0
        while position + 9 <= len(records):
            code, size = struct.unpack_from('<BQ', records, position)
            position += 9 + size
            yield from self.message_of(code, records[position - size : position])

    def message_of(self, code: int, body: bytes) -> Iterator[_Found]:
        """Yield the message of a record, if it is one; remember schemas and channels."""
        if code == MESSAGE and len(body) >= MESSAGE_HEAD.size:
            channel, _, receive_ns, _ = MESSAGE_HEAD.unpack_from(body)
            if channel in self._channels:
                yield *self._channels[channel], receive_ns, body[MESSAGE_HEAD.size :]
        elif code == SCHEMA and len(body) >= 6:
            self._types[int.from_bytes(body[:2], 'little')] = _string(body, 2)[0]
        elif code == CHANNEL and len(body) >= 8:
            channel, schema = struct.unpack_from('<HH', body)
            topic, end = _string(body, 4)
            if _string(body, end)[0] == 'cdr':
                self._channels[channel] = topic, self._types.get(schema, '')


def _string(body: bytes, position: int) -> tuple[str, int]:
    """Return the string at a position, and the position after it."""
    size = int.from_bytes(body[position : position + 4], 'little')
    end = position + 4 + size
    return body[position + 4 : end].decode(errors='replace'), end
