# SPDX-License-Identifier: Apache-2.0
"""What a result was found from, kept beside it."""

from __future__ import annotations

import contextlib
import errno
import json
import os
from pathlib import Path

import numpy as np
import pytest
from studio import feed, make_studio, without_poses

from rpgd_ros.core import InputError, Reason
from rpgd_ros.io.atomic import write_atomic
from rpgd_ros.session import Session, Snapshot, solve
from rpgd_ros.session.snapshot_file import (
    HEAD,
    SCHEMA,
    exchanged,
    read_snapshot,
    write_snapshot,
)


@pytest.fixture(scope='module')
def snapshot() -> Snapshot:
    """Return twelve seconds before two cameras."""
    studio = make_studio()
    return feed(Session(studio.rig), studio.messages, together=1000).snapshot()


def test_kept_observations_give_the_same_bits_again(snapshot: Snapshot, tmp_path: Path) -> None:
    """Pose and covariance, from the file alone."""
    write_snapshot(tmp_path / 'result.npz', snapshot)
    first, again = solve(snapshot), solve(read_snapshot(tmp_path / 'result.npz'))
    assert again.world_T_mocap.matrix.tobytes() == first.world_T_mocap.matrix.tobytes()
    assert again.covariance.tobytes() == first.covariance.tobytes()
    assert again.config == first.config


def test_cameras_without_poses_are_kept_as_such(tmp_path: Path) -> None:
    """The solve is to place them, then as now."""
    studio = make_studio(4)
    taken = feed(Session(without_poses(studio.rig)), studio.messages, together=1000).snapshot()
    write_snapshot(tmp_path / 'result.npz', taken)
    read = read_snapshot(tmp_path / 'result.npz')
    assert [c.camera_T_world for c in read.cameras] == [None] * 4
    assert set(read.turns) == set(taken.turns)


def test_kept_file_is_plain_data(snapshot: Snapshot, tmp_path: Path) -> None:
    """Any numpy reads it, and nothing in it is a pickle."""
    write_snapshot(tmp_path / 'result.npz', snapshot)
    with np.load(tmp_path / 'result.npz', allow_pickle=False) as arrays:
        assert arrays['skeletons.values'].shape == snapshot.skeletons.values.shape
        assert arrays['camera1.keypoints.stamp_ns'].dtype == np.int64


@pytest.mark.parametrize('data', [b'', b'PK\x03\x04 and no more', b'\x93NUMPY', b'{}'])
def test_other_files_are_refused(tmp_path: Path, data: bytes) -> None:
    """The message names the file."""
    path = tmp_path / 'result.npz'
    path.write_bytes(data)
    with pytest.raises(InputError, match='no file of observations') as refused:
        read_snapshot(path)
    assert refused.value.reason is Reason.BAD_RESULT_FILE


def test_file_of_a_later_version_is_refused_by_its_schema(
    snapshot: Snapshot, tmp_path: Path
) -> None:
    """The message says which schemas there are, and nothing is guessed."""
    path = tmp_path / 'result.npz'
    write_snapshot(path, snapshot)
    with np.load(path) as file:
        arrays = dict(file)
    head = json.loads(str(arrays[HEAD]))
    head['schema'] = SCHEMA + 1
    arrays[HEAD] = np.array(json.dumps(head))
    np.savez(path, **arrays)
    with pytest.raises(
        InputError, match=f'schema {SCHEMA + 1} is unknown, .* {SCHEMA}$'
    ) as refused:
        read_snapshot(path)
    assert refused.value.reason is Reason.BAD_RESULT_FILE


def test_folder_in_the_place_of_the_file_is_not_removed(tmp_path: Path) -> None:
    """The message tells the path, and why."""
    path = tmp_path / 'result.npz'
    path.mkdir()
    with (
        pytest.raises(InputError, match=r'result\.npz cannot be removed: ') as refused,
        exchanged(path, None),
    ):
        pytest.fail('went on')
    assert refused.value.reason is Reason.NOT_WRITABLE
    assert path.is_dir()


def test_file_of_another_result_can_be_removed_twice(tmp_path: Path) -> None:
    """One that is not there is removed already."""
    path = tmp_path / 'result.npz'
    path.write_bytes(b'x')
    for _ in range(2):
        with exchanged(path, None):
            pass
        assert list(tmp_path.iterdir()) == []


def test_no_result_ever_stands_beside_the_data_of_another(
    snapshot: Snapshot, tmp_path: Path
) -> None:
    """While it is written, which a kill may end, none is there; where that fails, the old one."""
    path = tmp_path / 'result.npz'
    path.write_bytes(b'old')
    for data in (snapshot, None):
        with contextlib.suppress(InputError), exchanged(path, data):
            assert not path.exists()
            write_atomic(tmp_path / 'gone' / 'result.yaml', '')
        assert path.read_bytes() == b'old'
        assert list(tmp_path.iterdir()) == [path]
    with exchanged(path, snapshot):
        assert not path.exists()
    assert read_snapshot(path).pair_counts == snapshot.pair_counts
    assert list(tmp_path.iterdir()) == [path]


def test_data_for_which_there_is_no_room_change_nothing(
    snapshot: Snapshot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The result is not written then, and keeps what it came from."""
    path = tmp_path / 'result.npz'
    path.write_bytes(b'old')

    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), descriptor)

    monkeypatch.setattr(os, 'fsync', full)
    with pytest.raises(InputError, match='No space left'), exchanged(path, snapshot):
        pytest.fail('went on')
    assert path.read_bytes() == b'old'
    assert list(tmp_path.iterdir()) == [path]
