# SPDX-License-Identifier: Apache-2.0
"""Recordings that unfold to more than any recorder writes are refused before they do."""

from __future__ import annotations

import os
import sqlite3
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import pytest
import yaml
from bags import (
    MCAP_MAGIC,
    QOS,
    SKELETON,
    START_NS,
    STEP_NS,
    Message,
    mcap_bytes,
    record,
    text,
    walk,
    write_bag,
    write_humble_bag,
)
from fault_report import Measured
from harness import REPOSITORY
from studio import make_rig

from rpgd_ros.core import InputError
from rpgd_ros.io.bag import open_bag
from rpgd_ros.io.budget import check_chunks, unpack_file
from rpgd_ros.io.rig import write_rig
from rpgd_ros.messages import MAX_MESSAGE_BYTES, POINT_CLOUD2, POSE_ARRAY, encode_pose_array

try:
    from backports import zstd
except ImportError:  # what rosbags needed before
    import zstandard as zstd  # type: ignore[import-not-found,no-redef]

MIB = 2**20
BOMB_BYTES = 600 * MIB
MAX_SECONDS, MAX_PEAK_MIB = 10.0, 300.0


def chunk(raw_bytes: int, claimed: int, compression: str) -> bytes:
    """Make a chunk of zeros that claims a size of its own."""
    pack = {'zstd': zstd.compress, 'lz4': lz4.frame.compress}[compression]
    packed = pack(bytes(raw_bytes))
    head = struct.pack('<QQQI', 1, 2, claimed, 0)
    return record(6, head, text(compression), struct.pack('<Q', len(packed)), packed)


def with_chunk(path: Path, hostile: bytes) -> Path:
    """Put a chunk before the good ones of a recording without an index."""
    good = mcap_bytes(walk(30))
    start = len(MCAP_MAGIC) + len(record(1, text('ros2'), text('by hand')))
    path.write_bytes(good[:start] + hostile + good[start:])
    return path


def chunk_info(begin_ns: int, end_ns: int, size: int) -> SimpleNamespace:
    """Return what an index says of a chunk."""
    return SimpleNamespace(
        message_start_time=begin_ns, message_end_time=end_ns, uncompressed_size=size
    )


def with_index(path: Path, n_chunks: int, size: int) -> Path:
    """Write one small chunk whose index says that it is there many times."""
    hostile = chunk(MIB, size, 'zstd')
    start = [MCAP_MAGIC, record(1, text('ros2'), text('by hand'))]
    start += [record(3, struct.pack('<H', 1), text(POINT_CLOUD2), text('ros2msg'), text(''))]
    channel = struct.pack('<HH', 1, 1)
    start += [record(4, channel, text('/mocap/skeleton'), text('cdr'), text(''))]
    place = sum(map(len, start))
    packed = len(hostile) - 9 - 40 - len('zstd')
    entry = record(
        8,
        struct.pack('<QQQQ', 1, 2, place, len(hostile)),
        struct.pack('<IHQ', 10, 1, place + len(hostile)),
        struct.pack('<Q', 31),
        text('zstd'),
        struct.pack('<QQ', packed, size),
    )
    body = b''.join(start) + hostile
    summary = b''.join(start[2:]) + entry * n_chunks
    footer = record(2, struct.pack('<QQI', len(body), 0, 0))
    path.write_bytes(body + summary + footer + MCAP_MAGIC)
    return path


def humble(path: Path, compression: str) -> Path:
    """Write a bag of Humble whose compressed part is a bomb."""
    zeros = bytes(BOMB_BYTES)
    folder = write_humble_bag(path, walk(30), compression=compression)  # type: ignore[arg-type]
    if compression == 'file':
        (folder / f'{path.name}_0.db3.zstd').write_bytes(zstd.compress(zeros))
        return folder
    with sqlite3.connect(folder / f'{path.name}_0.db3') as database:
        database.execute('UPDATE messages SET data = ?', (zstd.compress(zeros),))
    return folder


def computed(path: Path, how: str) -> Path:
    """Write an sqlite3 bag whose messages are computed while they are read."""
    folder = write_humble_bag(path, walk(30))
    with sqlite3.connect(folder / f'{path.name}_0.db3') as database:
        if how == 'column':
            database.executescript("""
                ALTER TABLE messages RENAME TO old;
                CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER,
                    data BLOB GENERATED ALWAYS AS (zeroblob(600000000)) VIRTUAL);
                INSERT INTO messages(id, topic_id, timestamp) SELECT id, topic_id, timestamp
                    FROM old;
                DROP TABLE old;
            """)
        else:
            database.executescript("""
                ALTER TABLE schema RENAME TO old;
                CREATE VIEW schema AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1
                    FROM n) SELECT i AS schema_version, 'humble' AS ros_distro FROM n WHERE i < 0;
            """)
    return folder


BOMBS: dict[str, Callable[[Path], Path]] = {
    'mcap zstd': lambda p: with_chunk(p / 'a.mcap', chunk(BOMB_BYTES, BOMB_BYTES, 'zstd')),
    'mcap lz4': lambda p: with_chunk(p / 'a.mcap', chunk(BOMB_BYTES, BOMB_BYTES, 'lz4')),
    'mcap zstd that lies': lambda p: with_chunk(p / 'a.mcap', chunk(BOMB_BYTES, MIB, 'zstd')),
    'mcap lz4 that lies': lambda p: with_chunk(p / 'a.mcap', chunk(BOMB_BYTES, MIB, 'lz4')),
    'mcap index': lambda p: with_index(p / 'a.mcap', 100_000, MIB),
    'mcap index of large chunks': lambda p: with_index(p / 'a.mcap', 10, 60 * MIB),
    'message': lambda p: humble(p / 'a', 'message'),
    'file': lambda p: humble(p / 'a', 'file'),
    'column': lambda p: computed(p / 'a', 'column'),
    'endless view': lambda p: computed(p / 'a', 'view'),
}


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    """Return a rig file whose topics the recordings have."""
    path = tmp_path / 'rig.yaml'
    write_rig(path, make_rig(1))
    tree = path.read_text().replace('cam0/kp', 'cam0/keypoints')
    path.write_text(tree)
    return path


# What wait4 tells of a child begins with the memory of its parent, who may have run many tests.
TELLING_PEAK = """
import atexit, re, runpy, sys
from pathlib import Path

out, status = Path(sys.argv.pop(1)), Path('/proc/self/status')
atexit.register(lambda: out.write_text(re.search(r'VmHWM:\\s+(\\d+)', status.read_text())[1]))
runpy.run_module('rpgd_ros.apps.calibrate_bag', run_name='__main__', alter_sys=True)
"""


@pytest.mark.threat('S5')
@pytest.mark.parametrize('name', BOMBS)
def test_bomb_ends_quickly_and_small(
    tmp_path: Path, rig: Path, name: str, measured: Measured
) -> None:
    """The program ends with bad input, little memory and nothing left in TMPDIR."""
    bomb = BOMBS[name](tmp_path)
    temporary = tmp_path / 'tmp'
    temporary.mkdir()
    peak = tmp_path / 'peak'
    command = [sys.executable, '-c', TELLING_PEAK, str(peak), str(bomb), '--rig', str(rig)]
    environment = {**os.environ, 'TMPDIR': str(temporary), 'PYTHONPATH': str(REPOSITORY)}
    start = time.monotonic()
    process = subprocess.Popen(
        command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    assert process.stderr is not None
    said = process.stderr.read()
    process.wait()
    seconds, peak_mib = time.monotonic() - start, int(peak.read_text()) / 1024
    measured('peak', peak_mib, 'MiB')
    measured('end', seconds, 's')
    # What is left beside the bomb is a recording, though one of nobody.
    assert process.returncode in {1, 2}, said
    assert 'Traceback' not in said
    assert seconds < MAX_SECONDS
    assert peak_mib < MAX_PEAK_MIB
    assert not list(temporary.iterdir())


@pytest.mark.threat('S5')
def test_index_that_claims_what_no_recorder_writes_is_said(tmp_path: Path) -> None:
    """More than the file can hold, or too much of one time to be merged in memory."""
    with pytest.raises(InputError, match='its chunks claim 10485760000 bytes'):
        open_bag(with_index(tmp_path / 'a.mcap', 10_000, MIB))
    path = tmp_path / 'large.mcap'
    path.write_bytes(bytes(MIB))
    after = [chunk_info(begin, begin, 60 * MIB) for begin in range(3)]
    check_chunks(path, after)
    with pytest.raises(InputError, match='3 chunks of the same time are too much at once'):
        check_chunks(path, [chunk_info(0, 9, 60 * MIB)] * 3)


def test_file_that_unfolds_beyond_its_bound_is_said(tmp_path: Path) -> None:
    """And nothing of it is left on the disk."""
    packed, target = tmp_path / 'a.zstd', tmp_path / 'a'
    packed.write_bytes(zstd.compress(bytes(9 * MIB)))
    with pytest.raises(InputError, match=f'unfolds to more than {4 * MIB} bytes'):
        unpack_file(packed, target)
    assert not target.exists()


@pytest.mark.threat('S5')
@pytest.mark.parametrize('name', ['mcap zstd', 'mcap lz4', 'mcap zstd that lies'])
def test_good_chunks_beside_a_bomb_are_read(tmp_path: Path, name: str) -> None:
    """The recording is read in part, and that is said."""
    with open_bag(BOMBS[name](tmp_path)) as bag:
        assert len(list(bag.stream(bag.topics))) == 60
        assert bag.is_partial


@pytest.mark.threat('S8')
@pytest.mark.parametrize('storage', ['mcap', 'sqlite3', 'compressed'])
def test_message_is_cut_where_the_decoder_counts_it_as_too_long(
    tmp_path: Path, storage: str
) -> None:
    """A window of messages stays small, however long one of them is."""
    messages = walk(10)
    messages[3] = messages[3]._replace(payload=messages[3].payload + bytes(32 * MIB))
    if storage == 'mcap':
        path = tmp_path / 'a.mcap'
        path.write_bytes(mcap_bytes(messages, compression=''))
    elif storage == 'sqlite3':
        path = write_bag(tmp_path / 'a', messages, storage='sqlite3')
    else:
        path = write_humble_bag(tmp_path / 'a', messages, compression='message')
    with open_bag(path) as bag:
        lengths = [len(payload) for _, _, payload in bag.stream(bag.topics)]
        assert not bag.is_partial
    expected = [min(len(m.payload), MAX_MESSAGE_BYTES + 1) for m in messages]
    assert lengths == expected


def test_compressed_file_of_a_quiet_recording_is_no_bomb(tmp_path: Path) -> None:
    """Somebody who leaves the room for a quarter of an hour compresses well."""
    nobody = np.full((32, 3), np.nan)
    quiet = []
    for i in range(20_000):
        stamp_ns = START_NS + i * STEP_NS
        payload = encode_pose_array(stamp_ns, 'mocap', nobody)
        quiet.append(Message(SKELETON, POSE_ARRAY, stamp_ns, payload))
    path = tmp_path / 'a.mcap'
    path.write_bytes(mcap_bytes(quiet, compression='zstd', per_chunk=10_000))
    with open_bag(path) as bag:
        assert sum(1 for _ in bag.stream(bag.topics)) == 20_000
        assert not bag.is_partial


def test_long_qos_of_a_topic_with_many_publishers_is_read(tmp_path: Path) -> None:
    """metadata.yaml holds it as one text; of /tf with twenty publishers it has 8000 characters."""
    folder = write_humble_bag(tmp_path / 'a', walk(10))
    path = folder / 'metadata.yaml'
    tree = yaml.safe_load(path.read_text())
    for topic in tree['rosbag2_bagfile_information']['topics_with_message_count']:
        topic['topic_metadata']['offered_qos_profiles'] = '\n'.join([QOS] * 20)
    path.write_text(yaml.safe_dump(tree))
    with open_bag(folder) as bag:
        assert not bag.problem
