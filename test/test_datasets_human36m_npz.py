# SPDX-License-Identifier: Apache-2.0
"""Human3.6M as three files: pickles in archives, their joints, and what is refused."""

from __future__ import annotations

import os
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dataset_trees import residuals_px

from rpgd_ros.core.errors import InputError
from rpgd_ros.datasets import Human36mNpz, open_dataset
from rpgd_ros.datasets import human36m_npz as reader
from rpgd_ros.datasets.human36m import read_cameras

FRAMES = 6


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Write exact projections in the form of VideoPose3D."""
    extrinsics = []
    for angle in np.arange(4) * np.pi / 2:
        # Looks along y, x, -y or -x from 4 m, with the image upright.
        place = [-4000.0 * np.sin(angle), -4000.0 * np.cos(angle), 900.0]
        extrinsics.append([np.pi / 2, 0.0, angle, *place])
    w0 = [number for camera in extrinsics for number in camera * 11]
    w0 += [1145.0, 1144.0, 512.0, 515.0, -0.2, 0.24, -0.003, -0.001, -0.001] * 4
    (tmp_path / 'metadata.xml').write_text(f'<w0>[{" ".join(map(str, w0))}]</w0>')
    x = np.random.default_rng(0).uniform([-0.5, -0.5, 0.1], [0.5, 0.5, 1.8], (FRAMES, 32, 3))
    cameras = read_cameras(tmp_path / 'metadata.xml', 9)
    views = [camera.project(x).astype(np.float32) for camera in cameras]
    save(tmp_path, {'S9': {'Walking 1': x.astype(np.float32)}, 'S2': {'x': x}}, views)
    return tmp_path


def save(folder: Path, positions_3d: Any, views: list[Any]) -> None:
    """Write both archives as numpy does: VideoPose3D keeps 17 joints of the keypoints."""
    np.savez_compressed(folder / reader.SKELETONS, positions_3d=np.array(positions_3d))
    moving = list(reader.MOVING)
    positions_2d = np.array({'S9': {'Walking 1': [view[:, moving] for view in views]}})
    metadata = np.array({'num_joints': 17})
    np.savez_compressed(folder / reader.KEYPOINTS, positions_2d=positions_2d, metadata=metadata)


def test_joints_that_move_are_paired(folder: Path) -> None:
    """Exact projections leave the rounding of single precision."""
    dataset = open_dataset('human36m', folder, is_published=True)
    assert isinstance(dataset, Human36mNpz)
    assert dataset.names == ('S9/Walking 1',)
    sequence = dataset.read('S9/Walking 1')
    assert sequence.observations.n_joints == 17
    assert sequence.observations.joint_names is not None
    assert sequence.observations.joint_names[4] == 'LeftUpLeg'
    residuals = residuals_px(sequence)
    assert len(residuals) > 4 * FRAMES * 10
    assert residuals.max() < 1e-3


class Obeyed:
    """A pickle that would make a file."""

    def __init__(self, marker: Path) -> None:
        """Say which."""
        self.marker = marker

    def __reduce__(self) -> tuple[Any, tuple[str]]:
        """Tell pickle so."""
        return os.system, (f'touch {self.marker}',)


def test_archive_runs_nothing(folder: Path, tmp_path: Path) -> None:
    """Nor does it with the crafted object deep inside."""
    marker = tmp_path / 'marker'
    save(folder, {'S9': {'Walking 1': [Obeyed(marker)]}}, [])
    with pytest.raises(InputError, match=r'data_3d_h36m\.npz: no positions_3d.*not allowed'):
        open_dataset('human36m', folder)
    assert not marker.exists()


def test_damaged_archives_are_named(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Cut, of another kind, of other arrays, too large."""
    path = folder / reader.SKELETONS
    whole = path.read_bytes()
    for bad in (b'', whole[:50], whole[: len(whole) // 2], b'no archive'):
        path.write_bytes(bad)
        with pytest.raises(InputError, match=r'data_3d_h36m\.npz: no positions_3d'):
            Human36mNpz.open(folder)
    for name in ('other', 'positions_3d'):
        with zipfile.ZipFile(path, 'w') as archive, archive.open(f'{name}.npy', 'w') as file:
            np.lib.format.write_array(file, np.zeros(3))
        with pytest.raises(InputError, match='positions_3d'):
            Human36mNpz.open(folder)
    path.write_bytes(whole)
    monkeypatch.setattr('rpgd_ros.datasets.pickles.MAX_UNPACKED_BYTES', 100)
    os.utime(path, ns=(1, 1))
    with pytest.raises(InputError, match='unpacks to'):
        Human36mNpz.open(folder)


@pytest.mark.parametrize(
    ('cameras', 'frames', 'message'),
    [
        (3, FRAMES, 'need the keypoints of 4 cameras'),
        (4, FRAMES - 1, '5 frames, but data_3d_h36m.npz has 6'),
    ],
)
def test_keypoints_that_do_not_fit_are_refused(
    cameras: int, frames: int, message: str, folder: Path
) -> None:
    """With the path and the sequence."""
    with zipfile.ZipFile(folder / reader.SKELETONS) as archive:
        assert archive.namelist() == ['positions_3d.npy']
    x = np.zeros((FRAMES, 32, 3))
    save(folder, {'S9': {'Walking 1': x}}, [np.zeros((frames, 32, 2))] * cameras)
    with pytest.raises(InputError, match=message):
        Human36mNpz.open(folder).read('S9/Walking 1')
