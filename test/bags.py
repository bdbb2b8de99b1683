# SPDX-License-Identifier: Apache-2.0
"""Tiny recordings, written by the package or byte by byte as recorders of other times did."""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal, NamedTuple
from zlib import crc32

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import yaml

from rpgd_ros.io.bag import BagWriter
from rpgd_ros.messages import POINT_CLOUD2, encode_point_cloud2

try:
    from backports import zstd
except ImportError:  # what rosbags needed before
    import zstandard as zstd  # type: ignore[import-not-found,no-redef]

START_NS = 1_700_000_000_000_000_000
STEP_NS = 10_000_000
SKELETON, KEYPOINTS = '/mocap/skeleton', '/cam0/keypoints'


class Message(NamedTuple):
    """One recorded message, in the order of `BagWriter.write`."""

    topic: str
    msgtype: str
    receive_ns: int
    payload: bytes


def walk(n: int = 10, *, n_joints: int = 4) -> list[Message]:
    """Make `n` skeletons and as many keypoints, turn by turn, 100 Hz."""
    rng = np.random.default_rng(0)
    messages = []
    for i in range(n):
        stamp_ns = START_NS + STEP_NS * i
        skeleton = encode_point_cloud2(stamp_ns, 'mocap', rng.normal(size=(n_joints, 3)))
        uv = encode_point_cloud2(stamp_ns, 'cam0', rng.normal(size=(n_joints, 2)))
        messages.append(Message(SKELETON, POINT_CLOUD2, stamp_ns, skeleton))
        messages.append(Message(KEYPOINTS, POINT_CLOUD2, stamp_ns + STEP_NS // 2, uv))
    return messages


def write_bag(path: Path, messages: Iterable[Message], **keywords: Any) -> Path:
    """Write a recording with the package's own writer."""
    with BagWriter(path, **keywords) as writer:
        for message in messages:
            writer.write(*message)
    return path


def write_humble_bag(
    path: Path,
    messages: list[Message],
    *,
    compression: Literal['', 'message', 'file'] = '',
) -> Path:
    """Write what Humble's recorder leaves: sqlite3, metadata version 5, no definitions."""
    path.mkdir()
    file = path / f'{path.name}_0.db3'
    topics = {message.topic: message.msgtype for message in messages}
    ids = {topic: i for i, topic in enumerate(topics, 1)}
    with sqlite3.connect(file) as connection:
        connection.executescript("""
            CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
            CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL,
                metadata TEXT NOT NULL);
            CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
                serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);
            CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,
                timestamp INTEGER NOT NULL, data BLOB NOT NULL);
            CREATE INDEX timestamp_idx ON messages (timestamp ASC);
            INSERT INTO schema(schema_version, ros_distro) VALUES (3, 'humble');
            """)
        connection.executemany(
            "INSERT INTO topics VALUES (?, ?, ?, 'cdr', ?)",
            [(ids[topic], topic, msgtype, QOS) for topic, msgtype in topics.items()],
        )
        connection.executemany(
            'INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)',
            [
                (ids[m.topic], m.receive_ns, squeeze(m.payload, compression == 'message'))
                for m in messages
            ],
        )
    connection.close()
    if compression == 'file':
        squeezed = file.with_name(f'{file.name}.zstd')
        squeezed.write_bytes(zstd.compress(file.read_bytes()))
        file.unlink()
        file = squeezed
    write_metadata(path, file.name, messages, compression)
    return path


QOS = """- history: 3
  depth: 0
  reliability: 1
  durability: 2
  deadline: {sec: 9223372036, nsec: 854775807}
  lifespan: {sec: 9223372036, nsec: 854775807}
  liveliness: 1
  liveliness_lease_duration: {sec: 9223372036, nsec: 854775807}
  avoid_ros_namespace_conventions: false"""


def squeeze(payload: bytes, is_compressed: bool) -> bytes:  # noqa: FBT001
    """Compress a payload where asked for."""
    return zstd.compress(payload) if is_compressed else payload


def write_metadata(path: Path, file: str, messages: list[Message], compression: str) -> None:
    """Write a metadata.yaml of version 5."""
    times = [message.receive_ns for message in messages] or [0]
    duration_ns, start_ns = max(times) - min(times), min(times)
    topics = {message.topic: message.msgtype for message in messages}
    information = {
        'version': 5,
        'storage_identifier': 'sqlite3',
        'relative_file_paths': [file],
        'duration': {'nanoseconds': duration_ns},
        'starting_time': {'nanoseconds_since_epoch': start_ns},
        'message_count': len(messages),
        'topics_with_message_count': [
            {
                'topic_metadata': {
                    'name': topic,
                    'type': msgtype,
                    'serialization_format': 'cdr',
                    'offered_qos_profiles': QOS,
                },
                'message_count': sum(message.topic == topic for message in messages),
            }
            for topic, msgtype in topics.items()
        ],
        'compression_format': 'zstd' if compression else '',
        'compression_mode': compression.upper(),
        'files': [
            {
                'path': file,
                'starting_time': {'nanoseconds_since_epoch': start_ns},
                'duration': {'nanoseconds': duration_ns},
                'message_count': len(messages),
            }
        ],
    }
    text = yaml.safe_dump({'rosbag2_bagfile_information': information}, sort_keys=False)
    (path / 'metadata.yaml').write_text(text)


MCAP_MAGIC = b'\x89MCAP0\r\n'


def record(op: int, *parts: bytes) -> bytes:
    """Make one record of an mcap file."""
    body = b''.join(parts)
    return struct.pack('<BQ', op, len(body)) + body


def text(value: str) -> bytes:
    """Make a string of an mcap record."""
    return struct.pack('<I', len(value.encode())) + value.encode()


def mcap_bytes(
    messages: list[Message],
    *,
    compression: Literal['', 'lz4', 'zstd'] = 'lz4',
    per_chunk: int = 6,
    encoding: str = 'cdr',
) -> bytes:
    """Make an mcap file as the recorder streams it: chunks with checksums, no index at the end.

    Without index and statistics a reader has to scan, as it has to after a crash.
    """
    topics = {message.topic: message.msgtype for message in messages}
    ids = {topic: i for i, topic in enumerate(topics, 1)}
    out = [MCAP_MAGIC, record(1, text('ros2'), text('by hand'))]
    announced: set[str] = set()
    for first in range(0, len(messages), per_chunk):
        chunk = messages[first : first + per_chunk]
        records = []
        for message in chunk:
            key = ids[message.topic]
            if message.topic not in announced:
                announced.add(message.topic)
                schema = struct.pack('<H', key), text(message.msgtype), text('ros2msg'), text('')
                records.append(record(3, *schema))
                channel = (
                    struct.pack('<HH', key, key),
                    text(message.topic),
                    text(encoding),
                    text(''),
                )
                records.append(record(4, *channel))
            times = struct.pack('<HIQQ', key, 0, message.receive_ns, message.receive_ns)
            records.append(record(5, times, message.payload))
        raw = b''.join(records)
        squeezed = {'': bytes, 'lz4': lz4.frame.compress, 'zstd': zstd.compress}[compression](raw)
        head = struct.pack(
            '<QQQI', chunk[0].receive_ns, chunk[-1].receive_ns, len(raw), crc32(raw)
        )
        out.append(record(6, head, text(compression), struct.pack('<Q', len(squeezed)), squeezed))
    out += [record(15, bytes(4)), record(2, bytes(20)), MCAP_MAGIC]
    return b''.join(out)
