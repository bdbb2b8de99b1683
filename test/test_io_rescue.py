# SPDX-License-Identifier: Apache-2.0
"""What a recorder that was cut off has left is read from the front."""

from __future__ import annotations

import struct
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from sqlite3 import connect
from typing import Literal

import pytest
import yaml
from bags import (
    MCAP_MAGIC,
    SKELETON,
    Message,
    mcap_bytes,
    record,
    text,
    walk,
    write_bag,
    write_humble_bag,
)

from rpgd_ros.core import InputError
from rpgd_ros.io.bag import open_bag
from rpgd_ros.io.rescue import Rescue

try:
    from backports import zstd
except ImportError:  # what rosbags needed before
    import zstandard as zstd  # type: ignore[import-not-found,no-redef]

Write = Callable[[Path, list[Message]], Path]


def by_hand(path: Path, messages: list[Message]) -> Path:
    """Write one mcap file with small lz4 chunks."""
    path.mkdir()
    (path / 'walk_0.mcap').write_bytes(mcap_bytes(messages, per_chunk=20))
    return path


def without_chunks(path: Path, messages: list[Message]) -> Path:
    """Write one mcap file whose messages stand one by one, as a recorder without cache does."""
    path.mkdir()
    whole = mcap_bytes(messages, compression='', per_chunk=len(messages))
    start = whole.index(text('by hand')) + len(text('by hand'))
    head = 9 + 32 + 8  # record, chunk header with an empty compression, size of the records
    (size,) = struct.unpack_from('<Q', whole, start + head - 8)
    records = whole[start + head : start + head + size]
    (path / 'walk_0.mcap').write_bytes(whole[:start] + records + record(15, bytes(4)))
    return path


def chunked(path: Path, messages: list[Message]) -> Path:
    """Write with zstd chunks of 1 MiB and an index at the end."""
    return write_bag(path, messages, compression='chunk')


def sqlite3(path: Path, messages: list[Message]) -> Path:
    """Write a database."""
    return write_bag(path, messages, storage='sqlite3')


WRITERS: list[Write] = [by_hand, without_chunks, chunked, sqlite3, write_humble_bag]


def storage_file(folder: Path) -> Path:
    """Find the one file that is not the metadata."""
    (file,) = (path for path in folder.iterdir() if path.suffix != '.yaml')
    return file


@pytest.mark.fault(22)
@pytest.mark.parametrize('writer', WRITERS)
def test_a_cut_file_gives_its_first_messages(tmp_path: Path, writer: Write) -> None:
    """Whatever the cut: a beginning of the recording, marked partial, or a refusal."""
    messages = walk(400, n_joints=28)
    folder = writer(tmp_path / 'walk', messages)
    file = storage_file(folder)
    data = file.read_bytes()
    written = [(m.topic, m.receive_ns, m.payload) for m in messages]
    most = 0
    for share in (0.0, 0.001, 0.01, 0.1, 0.3, 0.5, 0.9, 0.99):
        file.write_bytes(data[: int(share * len(data))])
        try:
            with open_bag(folder) as bag:
                got = list(bag.stream(list(bag.topics)))
                assert bag.is_partial
        except InputError:
            continue
        assert got == written[: len(got)]
        most = max(most, len(got))
    if writer is not chunked:  # all of it is in one chunk of 1 MiB
        assert most > 0.5 * len(messages)


def test_messages_of_a_topic_that_is_lost_are_left_out(tmp_path: Path) -> None:
    """A cut database may name fewer topics than its messages do."""
    folder = write_humble_bag(tmp_path / 'walk', walk(50))
    file = storage_file(folder)
    before = {connection.topic for connection in Rescue(file).connections}
    with closing(connect(file)) as database, database:
        database.execute('DELETE FROM topics WHERE name = ?', (SKELETON,))
    after = {connection.topic for connection in Rescue(file).connections}
    assert before - after == {SKELETON}
    assert after


@pytest.mark.parametrize('writer', [sqlite3, write_humble_bag])
def test_metadata_tells_how_much_is_missing(tmp_path: Path, writer: Write) -> None:
    """'N of M messages', M as the recorder counted."""
    folder = writer(tmp_path / 'walk', walk(400, n_joints=28))
    file = storage_file(folder)
    file.write_bytes(file.read_bytes()[:200_000])
    with open_bag(folder) as bag:
        n_read = len(list(bag.stream([SKELETON])))
        assert 0 < n_read < 400
        assert bag.n_expected == 400
        assert bag.problem.startswith(f'{n_read} of 400 messages: ')


def test_without_metadata_the_total_is_unknown(tmp_path: Path) -> None:
    """No figure is made up."""
    path = tmp_path / 'walk.mcap'
    path.write_bytes(mcap_bytes(walk(100))[:-500])
    with open_bag(path) as bag:
        n_read = len(list(bag.stream([SKELETON])))
        assert bag.problem.startswith(f'{n_read} of an unknown number of messages: ')
        assert str(path) in bag.problem


def test_a_damaged_chunk_is_left_out_and_the_next_one_read(tmp_path: Path) -> None:
    """The checksum tells, and the record says where the next one begins."""
    messages = walk(100)
    data = bytearray(mcap_bytes(messages, compression='', per_chunk=20))
    data[len(data) // 2] ^= 1
    path = tmp_path / 'walk.mcap'
    path.write_bytes(data)
    with open_bag(path) as bag:
        got = [receive_ns for _, receive_ns, _ in bag.stream(list(bag.topics))]
        assert bag.is_partial
    written = [m.receive_ns for m in messages]
    assert len(got) == len(written) - 20
    assert got == [at for at in written if at in set(got)]


@pytest.mark.parametrize(
    'tail',
    [
        record(6, b'short'),
        record(6, struct.pack('<QQQII', 0, 0, 2**62, 0, 0), struct.pack('<Q', 0)),
        record(6, struct.pack('<QQQII', 0, 0, 9, 0, 4), b'what', struct.pack('<Q', 0)),
        record(5, b'short'),
        record(5, struct.pack('<HIQQ', 77, 0, 0, 0)),
        record(3, b''),
        record(4, b''),
        struct.pack('<BQ', 5, 2**63),
        b'\x05',
    ],
)
def test_records_that_lie_end_or_are_left_out(tmp_path: Path, tail: bytes) -> None:
    """Sizes beyond the file, unknown compressions and channels cost nothing."""
    path = tmp_path / 'walk.mcap'
    good = mcap_bytes(walk(10), per_chunk=4)
    end = good.rindex(record(15, bytes(4)))
    path.write_bytes(good[:end] + tail)
    with open_bag(path) as bag:
        assert len(list(bag.stream(list(bag.topics)))) == 20
        assert bag.is_partial


def pieces(folder: Path, messages: list[Message]) -> list[Path]:
    """Write a recording in three files, each compressed as a whole."""
    folder.mkdir(exist_ok=True)
    third = len(messages) // 3
    files = [folder / f'walk_{i}.mcap.zstd' for i in range(3)]
    for i, file in enumerate(files):
        file.write_bytes(zstd.compress(mcap_bytes(messages[third * i : third * (i + 1)])))
    return files


def read_all(path: Path) -> tuple[list[tuple[str, int, bytes]], str]:
    """Return the messages of a bag, and what was wrong with it."""
    with open_bag(path) as bag:
        return list(bag.stream(list(bag.topics))), bag.problem


def as_read(messages: list[Message]) -> list[tuple[str, int, bytes]]:
    """Return messages as a bag yields them."""
    return [(m.topic, m.receive_ns, m.payload) for m in messages]


@pytest.mark.fault(22)
def test_recorder_killed_while_it_compresses_loses_no_file(tmp_path: Path) -> None:
    """The last file is not compressed yet, and there is no metadata.yaml."""
    messages = walk(30)
    files = pieces(tmp_path / 'walk', messages)
    last = files[2]
    last.with_suffix('').write_bytes(zstd.decompress(last.read_bytes()))
    for is_half_there in (True, False):
        last.write_bytes(last.read_bytes()[:20]) if is_half_there else last.unlink()
        got, problem = read_all(tmp_path / 'walk')
        assert got == as_read(messages)
        assert 'metadata.yaml is missing' in problem
        assert 'zstd' not in problem


@pytest.mark.fault(22)
@pytest.mark.parametrize('damage', ['missing', 'no zstd', 'cut'])
def test_compressed_file_that_is_lost_costs_no_other(tmp_path: Path, damage: str) -> None:
    """The others are read, and the lost one is named."""
    messages = walk(30)
    folder = write_bag(tmp_path / 'walk', messages, compression='file')
    storage_file(folder).unlink()
    files = pieces(folder, messages)
    metadata = folder / 'metadata.yaml'
    tree = yaml.safe_load(metadata.read_text())
    tree['rosbag2_bagfile_information']['relative_file_paths'] = [f.name for f in files]
    metadata.write_text(yaml.safe_dump(tree))
    assert read_all(folder) == (as_read(messages), '')
    data = files[1].read_bytes()
    files[1].unlink()
    if damage != 'missing':
        files[1].write_bytes(b'no zstd at all' if damage == 'no zstd' else data[:10])
    got, problem = read_all(folder)
    assert got == as_read(messages[:20] + messages[40:])
    assert problem.startswith(f'40 of 60 messages: {files[1]}: ')


def test_files_that_were_unpacked_by_hand_are_found(tmp_path: Path) -> None:
    """With `zstd --rm -d`, which leaves metadata.yaml as it is."""
    messages = walk(30)
    folder = write_bag(tmp_path / 'walk', messages, compression='file')
    packed = storage_file(folder)
    packed.with_suffix('').write_bytes(zstd.decompress(packed.read_bytes()))
    packed.unlink()
    assert read_all(folder) == (as_read(messages), '')


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_compressed_file_alone_is_a_bag(
    tmp_path: Path, storage: Literal['mcap', 'sqlite3']
) -> None:
    """As an uncompressed one is; a complaint names it, not where it was unpacked."""
    messages = walk(30)
    file = storage_file(
        write_bag(tmp_path / 'walk', messages, storage=storage, compression='file')
    )
    assert read_all(file) == (as_read(messages), '')
    (tmp_path / 'text.txt.zstd').write_bytes(zstd.compress(b'no bag at all'))
    with pytest.raises(InputError, match='cannot be read as a rosbag2') as refused:
        open_bag(tmp_path / 'text.txt.zstd')
    assert refused.value.message.startswith(f'{tmp_path / "text.txt.zstd"}: ')


def test_nothing_left_is_refused(tmp_path: Path) -> None:
    """A file of which only the beginning stands."""
    path = tmp_path / 'walk.mcap'
    path.write_bytes(MCAP_MAGIC + record(1, text('ros2'), text('')))
    with pytest.raises(InputError, match='cannot be read as a rosbag2'):
        open_bag(path)
