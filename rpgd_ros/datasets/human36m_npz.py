# SPDX-License-Identifier: Apache-2.0
"""Human3.6M in the form in which most people pass it on, that of VideoPose3D.

    data_3d_h36m.npz      positions_3d: subject -> action -> (T, 32, 3), metres, world
    data_2d_h36m_gt.npz   positions_2d: subject -> action -> 4 arrays (T, 17 or 32, 2), pixels
    metadata.xml          camera parameters, as in the dataset's own archive

Each file is one pickle of all sequences: it is read as a whole, once per process (a gigabyte for
both), whereas the dataset's own files are read sequence by sequence.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from rpgd_ros.core.geometry import Array
from rpgd_ros.datasets.files import require_size, undamaged
from rpgd_ros.datasets.human36m import FPS, JOINTS, N_SUBJECTS, PUBLISHED, read_cameras
from rpgd_ros.datasets.pickles import MAX_BYTES, read_npz_tree
from rpgd_ros.datasets.sequence import (
    DatasetSequence,
    check_name,
    refusal,
    sequence_from_world,
)

SKELETONS, KEYPOINTS = 'data_3d_h36m.npz', 'data_2d_h36m_gt.npz'
# Of the 32 joints, those that move by themselves.
MOVING = (0, 1, 2, 3, 6, 7, 8, 12, 13, 14, 15, 17, 18, 19, 25, 26, 27)


@dataclass(frozen=True, slots=True)
class Human36mNpz:
    """A folder with Human3.6M in three files.

    Attributes:
        folder: That holds them.
        names: `<subject>/<action>`.

    """

    folder: Path
    names: tuple[str, ...]

    @classmethod
    def open(cls, folder: Path, *, is_published: bool = False) -> Human36mNpz:
        """List the sequences; arguments as those of `Human36m.open`.

        Raises:
            InputError: A file that cannot be used as it is.

        """
        known = PUBLISHED if is_published else [f'S{n}' for n in range(1, N_SUBJECTS + 1)]
        tree = _tree(folder / SKELETONS, 'positions_3d')
        return cls(folder, tuple(f'{s}/{action}' for s in known for action in tree.get(s, {})))

    def read(self, name: str) -> DatasetSequence:
        """Read one sequence; see `Dataset`."""
        check_name(name, self.names)
        metadata, skeletons, keypoints = self.files(name)
        subject, _, action = name.partition('/')
        cameras = read_cameras(metadata, int(subject.removeprefix('S')))
        x_world = _numbers(
            skeletons, name, _tree(skeletons, 'positions_3d')[subject][action], (len(JOINTS), 3)
        )
        views = _tree(keypoints, 'positions_2d').get(subject, {}).get(action)
        if not isinstance(views, tuple) or len(views) != len(cameras):
            raise refusal(keypoints, f'{name}: need the keypoints of {len(cameras)} cameras')
        joints = MOVING if np.shape(views[0])[1:2] == (len(MOVING),) else range(len(JOINTS))
        pick = list(joints)
        uv = np.empty((len(cameras), len(x_world), len(pick), 2))
        for row, view in zip(uv, views, strict=True):
            values = _numbers(keypoints, name, view, (len(pick), 2))
            if values.shape != row.shape:
                counts = f'{len(values)} frames, but {SKELETONS} has {len(x_world)}'
                raise refusal(keypoints, f'{name}: {counts}')
            row[:] = values
        names = tuple(JOINTS[j] for j in pick)
        return sequence_from_world(name, cameras, x_world[:, pick], uv, fps=FPS, joint_names=names)

    def files(self, name: str) -> tuple[Path, ...]:
        """Return camera parameters, 3D and 2D, the same for all; see `Dataset`."""
        del name
        return tuple(self.folder / file for file in ('metadata.xml', SKELETONS, KEYPOINTS))

    def objection(self, sequence: DatasetSequence) -> str:
        """Leave no sequence out; see `Dataset`."""
        del sequence
        return ''


def _tree(path: Path, name: str) -> dict[str, dict[str, Any]]:
    require_size(path, MAX_BYTES)
    return _kept(path, name, path.stat().st_mtime_ns)


@lru_cache(maxsize=2)
def _kept(path: Path, name: str, _time_ns: int) -> dict[str, dict[str, Any]]:
    return read_npz_tree(path, name)


def _numbers(path: Path, name: str, values: Any, shape: tuple[int, int]) -> Array:
    if not isinstance(values, np.ndarray) or values.ndim != 3 or values.shape[1:] != shape:
        raise refusal(path, f'{name}: need numbers (T, {shape[0]}, {shape[1]})')
    return undamaged(values)
