# SPDX-License-Identifier: Apache-2.0
"""How much a recording may unfold to: a file of 20 KiB can hold 600 MiB of zeros, or no end.

rosbags unpacks whatever it finds. Here is what stands before it, in the places where it unpacks:
chunks of mcap, compressed files, and the tables of sqlite3, which a hostile file may compute.
"""

from __future__ import annotations

import io
import shutil
import sqlite3
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, BinaryIO, Final, NamedTuple

import lz4.frame  # type: ignore[import-untyped]
from backports import zstd
from rosbags.rosbag2.storage_mcap import DECOMPRESSORS

from rpgd_ros.io.translation import bad_bag

MAX_UNPACKED_BYTES: Final = 64 * 2**20  # at once; a recorder's chunk has 1 to 4 MiB
MAX_OVERLAP_BYTES: Final = 2 * MAX_UNPACKED_BYTES  # chunks of one time are merged in memory
# Skeletons of 32 joints that are missing all the time: 165 at the highest level of zstd. A bomb:
# 30 000. What is small does no harm at any ratio.
MAX_RATIO: Final = 500
SMALL_BYTES: Final = 4 * 2**20
MIN_FREE_SHARE: Final = 0.5  # of the free space of the folder for temporary files that is left

SQLITE_LIMIT_LENGTH: Final = 0  # of sqlite3.h: longest text or blob
RECORDED: Final = """
    SELECT name, type, sql FROM sqlite_master WHERE name COLLATE NOCASE
    IN ('messages', 'topics', 'schema', 'metadata', 'message_definitions')
"""


class _Chunk(NamedTuple):
    """What the index of an mcap file says of a chunk."""

    start_ns: int
    end_ns: int
    size: int


def unpack(name: str, packed: bytes, size: int) -> bytes:
    """Decompress, no further than one byte beyond the size that is claimed.

    Args:
        name: 'zstd' or 'lz4'.
        packed: Compressed bytes.
        size: What they claim to unfold to.

    Raises:
        ValueError: That is more than it may be.

    """
    if size > MAX_UNPACKED_BYTES or _is_bomb(size, len(packed)):
        msg = f'{len(packed)} bytes unfold to {size}, at most {MAX_UNPACKED_BYTES} at once'
        raise ValueError(msg)
    return _first(name, packed, size + 1)


def unpack_message(packed: bytes, n_bytes: int) -> bytes:
    """Return the first bytes of a message that was compressed with zstd."""
    return _first('zstd', packed, n_bytes)


def _first(name: str, packed: bytes, n_bytes: int) -> bytes:
    opened: Any = zstd if name == 'zstd' else lz4.frame
    with opened.open(io.BytesIO(packed), 'rb') as file:
        raw: bytes = file.read(n_bytes)
    return raw


def bound_rosbags() -> None:
    """Let rosbags unpack chunks with `unpack`: it hands the claimed size on, but ignores it."""
    for name in ('zstd', 'lz4'):
        DECOMPRESSORS[name] = _bounded(name)


def _bounded(name: str) -> Callable[[bytes, int], bytes]:
    return lambda packed, size: unpack(name, packed, size)


def unpack_file(packed: Path, target: Path) -> None:
    """Decompress a zstd file, as far as it can be read.

    Args:
        packed: The compressed file.
        target: Where to; must not exist.

    Raises:
        InputError: BAD_BAG. It unfolds to more than it may.

    """
    free = int(shutil.disk_usage(target.parent).free * MIN_FREE_SHARE)
    limit = min(max(packed.stat().st_size * MAX_RATIO, SMALL_BYTES), free)
    with packed.open('rb') as file, target.open('xb') as out:
        n_bytes = _copy(file, out, limit)
    if n_bytes > limit:
        target.unlink()
        raise bad_bag(packed, f'unfolds to more than {limit} bytes')


def _copy(file: BinaryIO, out: BinaryIO, limit: int) -> int:
    """Decompress up to a limit or the damage; return the number of bytes, more than the limit."""
    n_bytes = 0
    with zstd.open(file, 'rb') as unpacked:
        try:
            while n_bytes <= limit and (part := unpacked.read(SMALL_BYTES)):
                out.write(part)
                n_bytes += len(part)
        except (zstd.ZstdError, EOFError):
            return n_bytes  # the storage inside breaks off where this does
    return n_bytes


def check_chunks(path: Path, chunks: Iterable[Any]) -> None:
    """Refuse an mcap file whose index claims what no recorder writes.

    Args:
        path: The file.
        chunks: Its `ChunkInfo`.

    Raises:
        InputError: BAD_BAG.

    """
    found = sorted(
        _Chunk(c.message_start_time, c.message_end_time, c.uncompressed_size) for c in chunks
    )
    total = sum(chunk.size for chunk in found)
    if _is_bomb(total, path.stat().st_size):
        raise bad_bag(path, f'its chunks claim {total} bytes')
    pending: list[_Chunk] = []
    for chunk in found:
        pending = [p for p in pending if p.end_ns >= chunk.start_ns] + [chunk]
        if len(pending) > 1 and sum(p.size for p in pending) > MAX_OVERLAP_BYTES:
            raise bad_bag(path, f'{len(pending)} chunks of the same time are too much at once')


def check_database(path: Path) -> None:
    """Refuse an sqlite3 file whose tables are computed when they are read.

    Raises:
        InputError: BAD_BAG.

    """
    uri = f'{path.absolute().as_uri()}?immutable=1'
    database = sqlite3.connect(uri, uri=True)
    try:
        limit_lengths(database)
        check_tables(database, path)
    except (sqlite3.Error, UnicodeDecodeError) as error:
        raise bad_bag(path, f'{error}') from error
    finally:
        database.close()


def limit_lengths(database: sqlite3.Connection) -> None:
    """Let no text or blob of a database become longer than what may be unpacked at once."""
    database.setlimit(SQLITE_LIMIT_LENGTH, MAX_UNPACKED_BYTES)


def check_tables(database: sqlite3.Connection, path: Path) -> None:
    """Refuse views, virtual tables and generated columns under the names of a recording.

    Raises:
        InputError: BAD_BAG.
        sqlite3.Error: The database is damaged.

    """
    for name, kind, sql in database.execute(RECORDED).fetchall():
        columns = database.execute('SELECT hidden FROM pragma_table_xinfo(?)', (name,)).fetchall()
        is_plain = kind == 'table' and str(sql).split()[:2] == ['CREATE', 'TABLE']
        if not is_plain or any(hidden for (hidden,) in columns):
            raise bad_bag(path, f'{name!r} is computed, not recorded')


def limit_reader(storage: Any) -> None:
    """Bound what an open reader of rosbags holds at once, whether of a file or of a folder.

    Raises:
        InputError: BAD_BAG. An mcap file claims too much.

    """
    for one in getattr(storage, 'storages', [storage]):
        if hasattr(one, 'chunks'):
            check_chunks(one.path, one.chunks)
        else:
            one.dbconn.limit(SQLITE_LIMIT_LENGTH, MAX_UNPACKED_BYTES)


def _is_bomb(size: int, packed: int) -> bool:
    return size > SMALL_BYTES and size > MAX_RATIO * packed
