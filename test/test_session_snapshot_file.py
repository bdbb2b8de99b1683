# SPDX-License-Identifier: Apache-2.0
"""What a result was found from, kept beside it."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import random
import zipfile
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mutation import damage
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


def member(path: Path, name: str, data: bytes, method: int = zipfile.ZIP_STORED) -> None:
    """Replace an array of a file by other bytes."""
    with zipfile.ZipFile(path) as file:
        members = {n: file.read(n) for n in file.namelist()}
    with zipfile.ZipFile(path, 'w', method) as file:
        for key, value in (members | {f'{name}.npy': data}).items():
            file.writestr(key, value)


def plain(array: object, shape: tuple[int, ...] | None = None) -> bytes:
    """Return the bytes of an array, whose header may claim another shape."""
    file, values = BytesIO(), np.array(array)
    header = {'descr': values.dtype.str, 'fortran_order': False, 'shape': shape or values.shape}
    np.lib.format.write_array_header_1_0(file, header)
    return file.getvalue() + values.tobytes()


BAD_ARRAYS: dict[str, tuple[str, bytes, str]] = {
    'claims 8 TB': ('skeletons.values', plain(0.0, (10**4, 10**4, 10**4)), 'has 8 bytes for'),
    'claims overflow': ('skeletons.values', plain(0.0, (2**62, 2**62, 4)), 'has 8 bytes for'),
    'header is no header': ('skeletons.values', b'\x93NUMPY\x01\x00\x05\x00(((((', 'no file of'),
    'no array': ('skeletons.values', b'x', 'no file of observations'),
    'settings nested': (HEAD, plain('[' * 100_000), 'no file of observations: RecursionError'),
    'settings a list': (HEAD, plain('[]'), 'need a mapping'),
    'settings are numbers': (HEAD, plain(np.zeros(3)), 'settings has 24 bytes'),
    'one axis': ('skeletons.values', plain(np.zeros(3)), 'need 3 axes'),
    'text': ('skeletons.values', plain('x'), 'skeletons.values has 4 bytes'),
    'fewer skeletons': ('skeletons.values', plain(np.zeros((2, 3, 3))), 'skeletons: values'),
    'endless': ('camera0.columns', plain(np.full(12, 10**6)), 'camera0.columns go from 1000000'),
    'columns of text': ('camera0.columns', plain(['x']), 'camera0.columns has 4 bytes'),
    'stamps of floats': ('skeletons.stamp_ns', plain(np.zeros(3)), 'skeletons.stamp_ns has 24'),
    'no pose': ('camera0.camera_T_world', plain(np.full((4, 4), 1e300)), 'is not orthonormal'),
}


@pytest.mark.parametrize('name', BAD_ARRAYS)
def test_damaged_array_is_refused(snapshot: Snapshot, tmp_path: Path, name: str) -> None:
    """In our words, before memory is taken for what a header claims."""
    key, data, message = BAD_ARRAYS[name]
    path = tmp_path / 'result.npz'
    write_snapshot(path, snapshot)
    member(path, key, data)
    with pytest.raises(InputError, match=message) as refused:
        read_snapshot(path)
    assert refused.value.reason is Reason.BAD_RESULT_FILE
    assert str(path) in refused.value.message


@pytest.mark.parametrize(
    'method', [zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2], ids=str
)
def test_compressed_file_is_refused(snapshot: Snapshot, tmp_path: Path, method: int) -> None:
    """A few bytes could become any number; the file as it is written has no such part."""
    path = tmp_path / 'result.npz'
    write_snapshot(path, snapshot)
    member(path, 'other', plain(0.0), method)
    with pytest.raises(InputError, match='settings is compressed or encrypted'):
        read_snapshot(path)


def test_array_that_nobody_needs_is_not_read(snapshot: Snapshot, tmp_path: Path) -> None:
    """Whatever it claims."""
    path = tmp_path / 'result.npz'
    write_snapshot(path, snapshot)
    member(path, 'other', plain(0.0, (10**12,)))
    assert len(read_snapshot(path).cameras) == 2


BAD_SETTINGS: list[tuple[str, object, str]] = [
    ('pair_counts', [1], 'pair_counts: need a mapping, got'),
    ('pair_counts', {'cam0': 'xy'}, r'pair_counts\.cam0: need a list'),
    ('joint_names', 'abc', "joint_names: need a list, got 'abc'"),
    ('joint_names', [1, 2], r'joint_names\[0\]: need a text, got 1'),
    ('left_out', 5, 'left_out: need a list, got 5'),
    ('config', [], 'config: need a mapping'),
    ('config', {}, 'config: ransac is missing'),
    ('config.ransac', 5, r'config\.ransac: need a mapping, got 5'),
    ('config.ransac.seed', 'x', r"config\.ransac\.seed: need an integer, got 'x'"),
    ('config.ransac.threshold_px', 1e308, r'config\.ransac\.threshold_px: need a finite number'),
    ('config.ransac.threshold_px', -1.0, r'config\.ransac: threshold_px: -1.0 is outside'),
    ('config.refine.joint_noise', 1, r'joint_noise: need true or false, got 1'),
    ('config.refine.method', 'magic', r"config\.refine: method: 'magic' is none of newton"),
    ('sync.other', 1, "sync: unknown key 'other'"),
    ('cameras', ['x'], r"cameras\[0\]: need a mapping, got 'x'"),
    ('cameras.0.time_offset_s', 'x', r'cameras\[0\]\.time_offset_s: need a number'),
    ('cameras.0.size', [1e400, 2], r'cameras\[0\]\.size\[0\]: need an integer'),
    ('cameras.0.size', [1], 'no file of observations'),
    ('cameras.0.model', ['zzz'], r'cameras\[0\]\.model'),
]


@pytest.mark.parametrize(('key', 'value', 'message'), BAD_SETTINGS)
def test_damaged_setting_is_named(
    snapshot: Snapshot, tmp_path: Path, key: str, value: object, message: str
) -> None:
    """With file and key, as in the files that people write."""
    path = tmp_path / 'result.npz'
    write_snapshot(path, snapshot)
    with np.load(path) as file:
        head = json.loads(str(file[HEAD]))
    *steps, last = (int(step) if step.isdigit() else step for step in key.split('.'))
    target = head
    for step in steps:
        target = target[step]
    target[last] = value
    member(path, HEAD, plain(json.dumps(head)))
    with pytest.raises(InputError, match=message) as refused:
        read_snapshot(path)
    assert refused.value.reason is Reason.BAD_RESULT_FILE
    assert str(path) in refused.value.message


@given(seed=st.integers(0, 2**32))
@settings(
    derandomize=True,
    max_examples=150,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
def test_damaged_bytes_are_read_or_refused_in_our_words(
    snapshot: Snapshot, tmp_path: Path, seed: int
) -> None:
    """At the beginning and at the end, where the lists of the archive are."""
    path = tmp_path / 'result.npz'
    write_snapshot(path, snapshot)
    whole, rng = path.read_bytes(), random.Random(seed)  # noqa: S311
    begin, end = whole[:3000], whole[-3000:]
    if rng.random() < 0.5:
        begin = damage(begin, [begin, end], rng)
    else:
        end = damage(end, [begin, end], rng)
    path.write_bytes(begin + whole[3000:-3000] + end)
    with contextlib.suppress(InputError):
        assert len(read_snapshot(path).cameras) <= 2


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
