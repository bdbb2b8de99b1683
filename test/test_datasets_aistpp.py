# SPDX-License-Identifier: Apache-2.0
"""The reader of AIST++: layout, units, selection, and what it refuses."""

from __future__ import annotations

import json
import pickle
import shutil
import struct
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from dataset_trees import residuals_px, write_tree

from rpgd_ros.core.errors import InputError
from rpgd_ros.datasets import Aistpp, DatasetName, drawn_pose, open_dataset

NAME = 'gBR_sBM_cAll_d04_mBR0_ch01'
# A camera that looks along the world's z from 5 m before its origin.
CAMERA = {
    'name': 'c01',
    'size': [1920, 1080],
    'matrix': [[1000.0, 0.0, 960.0], [0.0, 1000.0, 540.0], [0.0, 0.0, 1.0]],
    'rotation': [0.0, 0.0, 0.0],
    'translation': [0.0, 0.0, 500.0],
    'distortions': [0.0, 0.0, 0.0, 0.0, 0.0],
}


@pytest.fixture(scope='module')
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Simulate a small tree once."""
    return write_tree('aistpp', tmp_path_factory.mktemp('aistpp') / 'tree')


@pytest.fixture
def by_hand(tmp_path: Path) -> Path:
    """Write a tree by hand: one camera, three frames, everything where one can see it."""
    for name in ('keypoints2d', 'keypoints3d', 'cameras'):
        (tmp_path / name).mkdir()
    (tmp_path / 'cameras/mapping.txt').write_text(f'{NAME} setting1\nother setting1\n')
    (tmp_path / 'cameras/setting1.json').write_text(json.dumps([CAMERA]))
    x_cm = np.zeros((3, 17, 3))
    x_cm[1, 0] = [50.0, -25.0, 0.0]
    keypoints = np.full((1, 3, 17, 3), 0.5)
    keypoints[0, 1, 0] = [960.0 + 100.0, 540.0 - 50.0, 0.9]
    keypoints[0, 2] = np.nan
    save(tmp_path, '3d', keypoints3d=x_cm)
    save(tmp_path, '2d', keypoints2d=keypoints, timestamps=np.array([0, 16667, 50001]))
    return tmp_path


def save(folder: Path, which: str, **arrays: Any) -> None:
    """Replace a pickle of the tree."""
    (folder / f'keypoints{which}' / f'{NAME}.pkl').write_bytes(pickle.dumps(arrays))


def test_numbers_of_a_tree_written_by_hand_arrive(by_hand: Path) -> None:
    """Centimetres become metres, NaN stays missing, a lost frame leaves a gap in time."""
    sequence = Aistpp.open(by_hand).read(NAME)
    (view,) = sequence.observations.views
    x_world = sequence.world_T_mocap @ view.x_mocap
    np.testing.assert_allclose(x_world[1, 0], [0.5, -0.25, 0.0], atol=1e-12)
    np.testing.assert_allclose(view.uv[1, 0], [1060.0, 490.0])
    assert np.isnan(view.uv[2]).all()
    assert view.confidence is not None
    assert view.confidence[1, 0] == 0.9
    assert view.stamp_ns is not None
    # The usual step is one frame of 60 Hz; here the median lies between one step and two.
    assert np.diff(view.stamp_ns)[1] == pytest.approx(2 * np.diff(view.stamp_ns)[0], rel=1e-4)
    camera = sequence.cameras[0]
    assert (camera.name, camera.size) == ('c01', (1920, 1080))
    np.testing.assert_allclose(camera.project(x_world[1, 0]), [1060.0, 490.0])


def test_twin_agrees_with_its_cameras(tree: Path) -> None:
    """At the dataset's own pose the mean residual is the published one, by an own projection."""
    dataset = open_dataset('aistpp', tree)
    assert len(dataset.names) == 2
    for name in dataset.names:
        sequence = dataset.read(name)
        assert len(sequence.cameras) == 9
        assert residuals_px(sequence).mean() == pytest.approx(8.2837, abs=1e-3)


def test_sequence_is_moved_by_what_its_name_draws(tree: Path) -> None:
    """The same name gives the same pose, another name another one."""
    dataset = Aistpp.open(tree)
    first, second = (dataset.read(name) for name in dataset.names)
    again = dataset.read(first.name)
    np.testing.assert_array_equal(first.world_T_mocap.matrix, again.world_T_mocap.matrix)
    np.testing.assert_array_equal(first.world_T_mocap.matrix, drawn_pose(first.name).matrix)
    assert np.abs(first.world_T_mocap.matrix - second.world_T_mocap.matrix).max() > 0.1


def test_ignored_and_missing_sequences_are_left_out(tree: Path, tmp_path: Path) -> None:
    """ignore_list.txt is obeyed; what mapping.txt names but nobody downloaded is not there."""
    folder = shutil.copytree(tree, tmp_path / 'tree')
    ignored, kept = Aistpp.open(folder).names
    (folder / 'ignore_list.txt').write_text(f'{ignored}\n')
    assert Aistpp.open(folder).names == (kept,)
    (folder / 'keypoints2d' / f'{kept}.pkl').unlink()
    assert Aistpp.open(folder).names == ()


def test_published_selection_objects_to_large_residuals(by_hand: Path) -> None:
    """Beyond 300 px; and only when that selection is asked for."""
    keypoints = np.full((1, 3, 17, 3), [960.0, 540.0, 1.0])
    keypoints[0, 0, 5, 0] += 301.0
    save(by_hand, '2d', keypoints2d=keypoints)
    everything, published = (
        open_dataset('aistpp', by_hand, is_published=flag) for flag in (False, True)
    )
    sequence = published.read(NAME)
    assert everything.objection(sequence) == ''
    assert published.objection(sequence) == 'a residual of 301 px'
    keypoints[0, 0, 5, 0] -= 2.0
    save(by_hand, '2d', keypoints2d=keypoints)
    assert published.objection(published.read(NAME)) == ''


def with_signalling_nan(values: Any) -> Any:
    """Return a copy whose first number is a signalling NaN, which warns wherever it is touched."""
    bits = {4: ('<I', 0x7F800001), 8: ('<Q', 0x7FF0000000000001)}[values.itemsize]
    data = struct.pack(*bits) + values.tobytes()[values.itemsize :]
    return np.frombuffer(data, values.dtype).reshape(values.shape)


TIMES = {
    'time stands': np.zeros(3),
    'time crawls': np.array([0.0, 5e-324, 1.0]),
    'time flies': np.array([-1e308, 0.0, 1e308]),
    'time of a damaged number': with_signalling_nan(np.array([0.0, 1.0, 2.0])),
    'time as a list': [0, 16667, 50001],
    'time as nothing': None,
}


def spoil(folder: Path, what: str) -> None:
    """Damage a tree written by hand in one way."""
    cameras, x = folder / 'cameras', np.zeros((3, 17, 3))
    keypoints = np.zeros((1, 3, 17, 3))
    if what == 'no camera file':
        (cameras / 'setting1.json').unlink()
    elif what == 'camera no JSON':
        (cameras / 'setting1.json').write_text('[' * 100_000)
    elif what == 'camera key gone':
        (cameras / 'setting1.json').write_text(json.dumps([{'name': 'c01'}]))
    elif what == 'camera mirrored':
        broken = CAMERA | {'matrix': [[-1000.0, 0, 0], [0, 1000.0, 0], [0, 0, 1]]}
        (cameras / 'setting1.json').write_text(json.dumps([broken]))
    elif what == 'no 3D':
        (folder / 'keypoints3d' / f'{NAME}.pkl').unlink()
    elif what == 'other joints':
        save(folder, '3d', keypoints3d=x[:, :13])
    elif what == 'no array':
        save(folder, '2d', timestamps=np.arange(3))
    elif what == 'other cameras':
        save(folder, '2d', keypoints2d=np.concatenate([keypoints, keypoints]))
    elif what == 'other frames':
        save(folder, '2d', keypoints2d=keypoints[:, :2])
    elif what.startswith('time'):
        save(folder, '2d', keypoints2d=keypoints, timestamps=TIMES[what])
    elif what == 'list of joints':
        save(folder, '3d', keypoints3d=x, keypoints3d_optim=x.tolist())
    elif what == 'no cameras':
        (cameras / 'setting1.json').write_text('[]')
    elif what == 'camera turned too far':
        turned = CAMERA | {'rotation': [1e200, 0.0, 0.0]}
        (cameras / 'setting1.json').write_text(json.dumps([turned]))
    elif what == 'camera of no name':
        unnamed = CAMERA | {'name': '\ud800', 'size': [0, 0]}
        (cameras / 'setting1.json').write_text(json.dumps([unnamed]))
    elif what == 'long name':
        (cameras / 'mapping.txt').write_text(f'{NAME} {"s" * 300}\n')
    elif what == 'file without end':
        (cameras / 'setting1.json').unlink()
        (cameras / 'setting1.json').symlink_to('/dev/zero')
    elif what == 'pickle without end':
        (folder / 'keypoints3d' / f'{NAME}.pkl').unlink()
        (folder / 'keypoints3d' / f'{NAME}.pkl').symlink_to('/dev/zero')


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize(
    ('what', 'message'),
    [
        ('no camera file', r'setting1\.json: cannot be read'),
        ('camera no JSON', r'setting1\.json: no list of cameras'),
        ('camera key gone', r'setting1\.json: no list of cameras'),
        ('camera mirrored', r"setting1\.json: camera 'c01': .*focal lengths must be positive"),
        ('no 3D', r'ch01\.pkl: cannot be read'),
        ('other joints', r'keypoints3d must be .* found \(3, 13, 3\)'),
        ('no array', r"no array 'keypoints2d'"),
        ('other cameras', r'keypoints2d must be .* found \(2, 3, 17, 3\)'),
        ('other frames', r'2 frames, but keypoints3d has 3'),
        ('time stands', 'timestamps must increase'),
        ('time crawls', r'ch01\.pkl: stamps must be \(3,\) increasing seconds'),
        ('time flies', 'timestamps must increase'),
        ('time of a damaged number', 'timestamps must increase'),
        ('time as a list', 'timestamps is no array of numbers'),
        ('time as nothing', 'timestamps is no array of numbers'),
        ('list of joints', r'keypoints3d/.*ch01\.pkl: keypoints3d_optim is no array of numbers'),
        ('camera turned too far', r"setting1\.json: camera 'c01': the rotation is none"),
        ('no cameras', r'setting1\.json: no cameras'),
        ('camera of no name', r"setting1\.json: '\\ud800' is no name of a camera"),
        ('long name', r'sss\.json: cannot be read: File name too long'),
        ('file without end', r'setting1\.json: no regular file'),
        ('pickle without end', r'ch01\.pkl: no regular file'),
    ],
)
def test_damaged_file_is_named(what: str, message: str, by_hand: Path) -> None:
    """Each complaint says which file and what is wrong with it."""
    spoil(by_hand, what)
    with pytest.raises(InputError, match=message):
        Aistpp.open(by_hand).read(NAME)


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('dtype', ['<f4', '<f8'])
def test_damaged_numbers_are_missing(dtype: str, by_hand: Path) -> None:
    """Without a warning: infinite, signalling, or larger than any coordinate."""
    x, keypoints = np.zeros((3, 17, 3), dtype), np.full((1, 3, 17, 3), 0.5, dtype)
    x[0, 1], x[0, 2] = np.inf, 1e38
    keypoints[0, 0, 1], keypoints[0, 0, 2] = -np.inf, 1e38
    save(by_hand, '3d', keypoints3d=with_signalling_nan(x))
    save(by_hand, '2d', keypoints2d=with_signalling_nan(keypoints))
    (view,) = Aistpp.open(by_hand).read(NAME).observations.views
    assert np.isnan(view.x_mocap[0, :3]).any(-1).tolist() == [True] * 3
    assert np.isnan(view.uv[0, 1:3]).all()
    assert np.isfinite(view.x_mocap[1:]).all()
    assert view.seen().sum() == 3 * 17 - 3


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('one two three\n', 'line 1: need sequence and setting'),
        ('../../etc/passwd setting1\n', 'line 1: need sequence and setting'),
        ('a setting1\na setting2\n', "line 2: 'a' is given twice"),
    ],
)
def test_mapping_is_read_strictly(text: str, message: str, by_hand: Path) -> None:
    """Nothing of it may lead out of the folder."""
    (by_hand / 'cameras/mapping.txt').write_text(text)
    with pytest.raises(InputError, match=message):
        Aistpp.open(by_hand)


def test_folder_of_something_else_is_refused(tmp_path: Path) -> None:
    """With the folder that is missing."""
    with pytest.raises(InputError, match='keypoints2d: no such folder'):
        Aistpp.open(tmp_path)
    with pytest.raises(InputError, match='nowhere: no such folder'):
        Aistpp.open(tmp_path / 'nowhere')
    for kind in get_args(DatasetName):
        with pytest.raises(InputError, match='xxx: no such folder'):
            open_dataset(kind, tmp_path / ('x' * 300))


def test_unknown_sequence_is_refused(by_hand: Path) -> None:
    """A name is not a path."""
    with pytest.raises(InputError, match='no sequence'):
        Aistpp.open(by_hand).read('../x')
