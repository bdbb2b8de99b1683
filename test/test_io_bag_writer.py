# SPDX-License-Identifier: Apache-2.0
"""A recording stands where it was asked for, whole, or not at all."""

from __future__ import annotations

import resource
from pathlib import Path

import pytest
from bags import walk, write_bag
from rosbags.highlevel import AnyReader

from rpgd_ros.core import InputError, Reason
from rpgd_ros.io.bag import BagWriter


def write_until(error: BaseException, path: Path) -> None:
    """Begin a recording and end in an error."""
    with BagWriter(path) as writer:
        for message in walk():
            writer.write(*message)
        raise error


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_the_types_are_defined_in_the_bag(tmp_path: Path, storage: str) -> None:
    """Other tools read it without our help, types and all."""
    path = write_bag(tmp_path / 'walk', walk(), storage=storage)
    with AnyReader([path]) as reader:
        connection, _, payload = next(reader.messages())
        message = reader.deserialize(payload, connection.msgtype)
    assert message.width == 4  # type: ignore[attr-defined]


@pytest.mark.parametrize('error', [RuntimeError('no'), KeyboardInterrupt()])
def test_an_interrupted_recording_leaves_nothing(tmp_path: Path, error: BaseException) -> None:
    """Neither half a bag nor a temporary folder."""
    with pytest.raises(type(error)):
        write_until(error, tmp_path / 'deep' / 'walk')
    assert list((tmp_path / 'deep').iterdir()) == []


def test_an_interrupt_while_the_files_are_opened_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is passed on as it came, and the hidden folder is gone."""

    def interrupt(_writer: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr('rpgd_ros.io.bag_writer.Writer.open', interrupt)
    with pytest.raises(KeyboardInterrupt):
        write_bag(tmp_path / 'walk', walk())
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    """The name may be of a recording of last week."""
    path = write_bag(tmp_path / 'walk', walk())
    before = sorted((p.name, p.stat().st_mtime_ns) for p in path.iterdir())
    with pytest.raises(InputError, match='exists already') as refused:
        write_bag(path, walk())
    assert refused.value.reason is Reason.NOT_WRITABLE
    assert sorted((p.name, p.stat().st_mtime_ns) for p in path.iterdir()) == before


def test_sqlite3_has_no_chunks(tmp_path: Path) -> None:
    """Said before anything is written."""
    with pytest.raises(InputError, match='compress messages or the file'):
        BagWriter(tmp_path / 'walk', storage='sqlite3', compression='chunk')


def test_a_place_that_cannot_be_written_to_is_named(tmp_path: Path) -> None:
    """The operating system's reason is passed on."""
    (tmp_path / 'file').write_text('')
    with pytest.raises(InputError, match='file/walk cannot be written') as refused:
        write_bag(tmp_path / 'file' / 'walk', walk())
    assert refused.value.reason is Reason.NOT_WRITABLE


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
@pytest.mark.parametrize(('limit', 'n_frames'), [(100_000, 5000), (2000, 50), (0, 5)])
def test_a_full_disk_leaves_nothing(
    tmp_path: Path, storage: str, limit: int, n_frames: int
) -> None:
    """A limit on the size of files stands for the disk: full on the way, at the end, at once."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, hard))
    try:
        with pytest.raises(InputError, match='walk cannot be written') as refused:
            write_bag(tmp_path / 'walk', walk(n_frames), storage=storage)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert refused.value.reason is Reason.NOT_WRITABLE
    assert list(tmp_path.iterdir()) == []
