# SPDX-License-Identifier: Apache-2.0
"""Recordings of all recorders are read, and damaged ones say what is wrong."""

from __future__ import annotations

import sqlite3
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from bags import (
    KEYPOINTS,
    SKELETON,
    Message,
    mcap_bytes,
    walk,
    write_bag,
    write_humble_bag,
)

from rpgd_ros.core import InputError, Reason
from rpgd_ros.io.bag import Bag, TopicInfo, absolute_name, open_bag
from rpgd_ros.messages import POINT_CLOUD2

Make = Callable[[Path, list[Message]], Path]


def ours(**keywords: Any) -> Make:
    """Return a maker of bags that uses the package's writer."""
    return lambda path, messages: write_bag(path, messages, **keywords)


def humble(**keywords: Any) -> Make:
    """Return a maker of bags of Humble."""
    return lambda path, messages: write_humble_bag(path, messages, **keywords)


def mcap(**keywords: Any) -> Make:
    """Return a maker of single mcap files without an index."""

    def make(path: Path, messages: list[Message]) -> Path:
        file = path.with_suffix('.mcap')
        file.write_bytes(mcap_bytes(messages, **keywords))
        return file

    return make


MAKERS: dict[str, Make] = {
    'mcap': ours(),
    'mcap_chunks': ours(compression='chunk'),
    'mcap_messages': ours(compression='message'),
    'mcap_file': ours(compression='file'),
    'sqlite3': ours(storage='sqlite3'),
    'sqlite3_messages': ours(storage='sqlite3', compression='message'),
    'sqlite3_file': ours(storage='sqlite3', compression='file'),
    'humble': humble(),
    'humble_messages': humble(compression='message'),
    'humble_file': humble(compression='file'),
    'mcap_no_index': mcap(compression=''),
    'mcap_no_index_lz4': mcap(compression='lz4'),
    'mcap_no_index_zstd': mcap(compression='zstd'),
}


def read(bag: Bag, *topics: str) -> list[tuple[str, int, bytes]]:
    """Read a bag to its end."""
    return list(bag.stream(topics or (SKELETON, KEYPOINTS)))


def unpacked(messages: list[Message]) -> list[tuple[str, int, bytes]]:
    """Return messages as a bag yields them."""
    return [(m.topic, m.receive_ns, m.payload) for m in messages]


@pytest.mark.parametrize('maker', MAKERS)
def test_what_was_recorded_is_read_in_its_order(tmp_path: Path, maker: str) -> None:
    """Each storage, each compression, with and without type definitions or index."""
    messages = walk()
    with open_bag(MAKERS[maker](tmp_path / 'walk', messages)) as bag:
        assert bag.topics == {
            KEYPOINTS: TopicInfo(POINT_CLOUD2, 10),
            SKELETON: TopicInfo(POINT_CLOUD2, 10),
        }
        assert read(bag) == unpacked(messages)
        assert read(bag, SKELETON) == unpacked(messages[::2])
        assert read(bag, '/nowhere') == []
        assert (bag.is_partial, bag.n_read, bag.n_expected) == (False, 0, 0)


@pytest.mark.parametrize('maker', ['mcap', 'sqlite3', 'humble', 'humble_messages'])
def test_a_storage_file_alone_is_a_bag(tmp_path: Path, maker: str) -> None:
    """People pass on the file and forget the folder."""
    messages = walk()
    folder = MAKERS[maker](tmp_path / 'walk', messages)
    (file,) = (path for path in folder.iterdir() if path.suffix != '.yaml')
    with open_bag(file) as bag:
        assert read(bag) == unpacked(messages)
    with open_bag(folder / 'metadata.yaml') as bag:
        assert read(bag) == unpacked(messages)


@pytest.mark.parametrize('maker', ['mcap', 'sqlite3', 'humble'])
def test_a_folder_without_metadata_is_read_file_by_file(tmp_path: Path, maker: str) -> None:
    """A recorder that was killed leaves no metadata.yaml; the user is told."""
    messages = walk()
    folder = MAKERS[maker](tmp_path / 'walk', messages)
    (folder / 'metadata.yaml').unlink()
    with open_bag(folder) as bag:
        assert read(bag) == unpacked(messages)
        assert bag.is_partial
        assert 'an unknown number of messages' in bag.problem
        assert 'metadata.yaml is missing' in bag.problem


def test_split_files_follow_each_other_by_number(tmp_path: Path) -> None:
    """_10 comes after _9."""
    messages = walk(12)
    for i in range(12):
        (tmp_path / f'walk_{i}.mcap').write_bytes(mcap_bytes(messages[2 * i : 2 * i + 2]))
    with open_bag(tmp_path) as bag:
        assert read(bag) == unpacked(messages)
        assert bag.topics[SKELETON].n_messages == 12


def test_a_bag_that_breaks_off_gives_what_it_has_and_says_how_much(tmp_path: Path) -> None:
    """Damage that shows only on the way: what came before it is used, and 'N of M' is known."""
    messages = walk(200)
    path = tmp_path / 'walk.mcap'
    path.write_bytes(mcap_bytes(messages, compression='', per_chunk=20))
    with open_bag(path) as bag:
        damaged = bytearray(path.read_bytes())
        damaged[-120] ^= 1  # within the last chunk: its checksum no longer fits
        path.write_bytes(damaged)
        assert read(bag) == unpacked(messages[:380])
        assert bag.is_partial
        assert bag.problem.startswith('380 of 400 messages: ')
        assert str(path) in bag.problem


def test_fewer_messages_than_the_metadata_counts_are_partial(tmp_path: Path) -> None:
    """A loss that leaves no trace but the count."""
    folder = write_humble_bag(tmp_path / 'walk', walk())
    with sqlite3.connect(folder / 'walk_0.db3') as connection:
        connection.execute('DELETE FROM messages WHERE id > 15')
    connection.close()
    with open_bag(folder) as bag:
        assert len(read(bag)) == 15
        assert '15 of 20 messages' in bag.problem


def test_a_message_that_is_no_bytes_ends_the_bag(tmp_path: Path) -> None:
    """sqlite3 does not care what a column holds."""
    folder = write_humble_bag(tmp_path / 'walk', walk())
    with sqlite3.connect(folder / 'walk_0.db3') as connection:
        connection.execute("UPDATE messages SET data = 'text' WHERE id = 11")
    connection.close()
    with open_bag(folder) as bag:
        assert len(read(bag)) == 10
        assert '10 of 20 messages' in bag.problem
        assert SKELETON in bag.problem


def test_a_topic_that_changes_its_type_has_both(tmp_path: Path) -> None:
    """The user sees why it cannot be used."""
    messages = walk(1)
    other = messages[0]._replace(msgtype='std_msgs/msg/String')
    for i, message in enumerate((messages[0], other)):
        (tmp_path / f'{i}.mcap').write_bytes(mcap_bytes([message]))
    with open_bag(tmp_path) as bag:
        assert bag.topics[SKELETON].msgtype == f'{POINT_CLOUD2} and std_msgs/msg/String'


def test_another_serialisation_is_refused(tmp_path: Path) -> None:
    """Foxglove's json under the names of ROS types."""
    path = tmp_path / 'walk.mcap'
    path.write_bytes(mcap_bytes(walk(2), encoding='json'))
    with pytest.raises(InputError, match=r"serialised as \['json'\], need cdr"):
        open_bag(path)


def damaged(tmp_path: Path, kind: str) -> Path:
    """Make something that is no bag."""
    path = tmp_path / 'walk'
    if kind == 'missing':
        return path
    if kind in {'text.mcap', 'empty.mcap', 'empty.db3', 'text.txt', 'ros1.bag'}:
        path = tmp_path / kind
        path.write_bytes(b'' if kind.startswith('empty') else b'no bag at all')
        return path
    path.mkdir()
    content = {
        'empty folder': None,
        'no yaml': '{',
        'other yaml': 'a: 1',
        'text for facts': 'rosbag2_bagfile_information: 3',
        'aliases': 'a: &a [x]\nrosbag2_bagfile_information: *a',
        'no file': 'rosbag2_bagfile_information: {version: 5, relative_file_paths: [a.db3]}',
        'future': 'rosbag2_bagfile_information: {version: 99}',
        'huge': '#' * 2_000_000,
    }[kind]
    if content is not None:
        (path / 'metadata.yaml').write_text(content)
    return path


@pytest.mark.fault(22)
@pytest.mark.parametrize(
    ('kind', 'message'),
    [
        ('missing', 'there is no such file'),
        ('text.mcap', 'magic'),
        ('empty.mcap', 'empty'),
        ('empty.db3', 'missing tables'),
        ('text.txt', "'.txt'"),
        ('ros1.bag', 'ROS 1 bag'),
        ('empty folder', 'metadata'),
        ('no yaml', 'YAML'),
        ('other yaml', 'rosbag2_bagfile_information'),
        ('text for facts', 'metadata.yaml is none of a recorder'),
        ('aliases', 'metadata'),
        ('no file', 'missing'),
        ('future', '99'),
        ('huge', '1048576 bytes'),
    ],
)
def test_what_is_no_bag_is_refused_in_one_sentence(
    tmp_path: Path, kind: str, message: str
) -> None:
    """One kind of error, with the path and what was found."""
    path = damaged(tmp_path, kind)
    with pytest.raises(InputError, match=message) as refused:
        open_bag(path)
    assert refused.value.reason is Reason.BAD_BAG
    assert str(path) in refused.value.message


@pytest.mark.fault(22)
@pytest.mark.parametrize('maker', ['mcap', 'mcap_chunks', 'sqlite3', 'humble_file'])
@pytest.mark.parametrize('damage', ['cut', 'flip'])
def test_damage_anywhere_is_an_error_or_a_partial_bag(
    tmp_path: Path, maker: str, damage: str
) -> None:
    """No other error, no message that was never written with its length changed by a cut."""
    messages = walk(6)
    folder = MAKERS[maker](tmp_path / 'walk', messages)
    (file,) = (path for path in folder.iterdir() if path.suffix != '.yaml')
    data = file.read_bytes()
    temporary = set(Path(tempfile.gettempdir()).iterdir())
    for i in range(25):
        place = len(data) * i // 25
        broken = bytearray(data[:place] if damage == 'cut' else data)
        if damage == 'flip':
            broken[place] ^= 0x10
        file.write_bytes(broken)
        try:
            with open_bag(folder) as bag:
                n_read = len(read(bag))
                assert bag.is_partial or n_read == len(messages) or damage == 'flip'
        except InputError as error:
            assert error.reason is Reason.BAD_BAG  # noqa: PT017 (the other way out is fine too)
    assert set(Path(tempfile.gettempdir()).iterdir()) <= temporary


def test_names_become_absolute() -> None:
    """Rig files name topics as nodes do, bags as the graph does."""
    assert absolute_name('mocap/skeleton') == absolute_name('/mocap/skeleton') == SKELETON
