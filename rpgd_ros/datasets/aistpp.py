# SPDX-License-Identifier: Apache-2.0
"""AIST++: dancers before nine cameras, detected and triangulated; no physical MoCap.

The layout is that of its own archive of annotations:

    keypoints2d/<sequence>.pkl   keypoints2d (9, T, 17, 3): u, v, score; timestamps (T,)
    keypoints3d/<sequence>.pkl   keypoints3d, keypoints3d_optim (T, 17, 3), centimetres, world
    cameras/mapping.txt          lines of sequence and setting
    cameras/<setting>.json       per camera: name, size, matrix, rotation (vector), translation
                                 (centimetres) of world -> camera, distortions
    ignore_list.txt              sequences that its authors advise against; may be missing

The dataset's own pose is the identity, so each sequence is moved first, see `drawn_pose`.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rpgd_ros.core.camera import Camera
from rpgd_ros.core.errors import InputError
from rpgd_ros.core.geometry import Array, so3_exp
from rpgd_ros.datasets.files import read_text, require_folder, status, undamaged
from rpgd_ros.datasets.pickles import read_arrays
from rpgd_ros.datasets.sequence import (
    DatasetSequence,
    camera_from_file,
    check_name,
    refusal,
    sequence_from_world,
    shown,
)
from rpgd_ros.skeletons import joint_names

FPS = 60.0
M_PER_CM = 0.01
JOINTS = joint_names('coco17')
MAX_RESIDUAL_PX = 300.0  # the publication's filter


@dataclass(frozen=True, slots=True)
class Aistpp:
    """A folder of AIST++ annotations.

    Attributes:
        folder: That holds keypoints2d, keypoints3d and cameras.
        settings: (sequence, setting) in the order of mapping.txt, without the ignored ones.
        is_published: Whether the publication's filter is asked for.

    """

    folder: Path
    settings: tuple[tuple[str, str], ...]
    is_published: bool = False

    @classmethod
    def open(cls, folder: Path, *, is_published: bool = False) -> Aistpp:
        """Read which sequences there are.

        Raises:
            InputError: Not such a folder.

        """
        require_folder(folder)
        ignored = _ignored(folder / 'ignore_list.txt')
        here = {path.stem for path in require_folder(folder / 'keypoints2d').glob('*.pkl')}
        settings = _mapping(folder / 'cameras' / 'mapping.txt')
        wanted = tuple(pair for pair in settings if pair[0] in here and pair[0] not in ignored)
        return cls(folder, wanted, is_published)

    @property
    def names(self) -> tuple[str, ...]:
        """Sequences in the order of mapping.txt that have keypoints and are not ignored."""
        return tuple(name for name, _ in self.settings)

    def read(self, name: str) -> DatasetSequence:
        """Read one sequence; see `Dataset`."""
        check_name(name, self.names)
        setting, skeletons, path = self.files(name)
        cameras = _cameras(setting)
        x_world = _skeletons(skeletons)
        arrays = read_arrays(path, ('keypoints2d', 'timestamps'))
        keypoints = _points(path, arrays, 'keypoints2d', (len(cameras), None, len(JOINTS), 3))
        if keypoints.shape[1] != len(x_world):
            counts = f'{keypoints.shape[1]} frames, but keypoints3d has {len(x_world)}'
            raise refusal(path, counts)
        seconds = _seconds(path, arrays, len(x_world))
        try:
            return sequence_from_world(
                name,
                cameras,
                x_world,
                keypoints[..., :2],
                confidence=keypoints[..., 2],
                stamps=seconds,
                joint_names=JOINTS,
            )
        except InputError as error:
            raise refusal(path, error.message) from error

    def files(self, name: str) -> tuple[Path, ...]:
        """Return cameras, 3D and 2D; see `Dataset`."""
        return (
            self.folder / 'cameras' / f'{dict(self.settings)[name]}.json',
            self.folder / 'keypoints3d' / f'{name}.pkl',
            self.folder / 'keypoints2d' / f'{name}.pkl',
        )

    def objection(self, sequence: DatasetSequence) -> str:
        """Apply the publication's filter of 300 px; see `Dataset`.

        It is read as: no keypoint may be farther than that from its joint as the dataset's own
        pose projects it.
        """
        if not self.is_published:
            return ''
        views = zip(sequence.cameras, sequence.observations.views, strict=True)
        worst = 0.0
        for camera, view in views:
            residual = camera.project(sequence.world_T_mocap @ view.x_mocap) - view.uv
            length = np.linalg.norm(residual, axis=-1)
            worst = max(worst, float(np.max(length, initial=0.0, where=np.isfinite(length))))
        return f'a residual of {worst:.0f} px' if worst > MAX_RESIDUAL_PX else ''


def _ignored(path: Path) -> frozenset[str]:
    return frozenset(read_text(path).split()) if status(path) else frozenset()


def _mapping(path: Path) -> list[tuple[str, str]]:
    pairs: dict[str, str] = {}
    for number, line in enumerate(read_text(path).splitlines(), 1):
        words = line.split()
        if not words:
            continue
        # Both are names of files: nothing of them may lead out of the folder.
        if len(words) != 2 or any(not _is_plain(word) for word in words):
            raise refusal(path, f'line {number}: need sequence and setting, got {shown(line)}')
        if words[0] in pairs:
            raise refusal(path, f'line {number}: {shown(words[0])} is given twice')
        pairs[words[0]] = words[1]
    return list(pairs.items())


def _is_plain(name: str) -> bool:
    return all(c.isalnum() or c in '_-' for c in name)


def _cameras(path: Path) -> tuple[Camera, ...]:
    text = read_text(path)
    try:
        cameras = tuple(_camera(path, entry) for entry in json.loads(text))
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
        raise refusal(path, f'no list of cameras: {shown(str(error))}') from error
    if not cameras:
        raise refusal(path, 'no cameras')
    return cameras


def _camera(path: Path, entry: dict[str, Any]) -> Camera:
    rotation = np.array(entry['rotation'], dtype=np.float64)
    translation = np.array(entry['translation'], dtype=np.float64)
    if rotation.shape != (3,) or translation.shape != (3,):
        msg = 'rotation and translation need three numbers each'
        raise ValueError(msg)
    width, height = entry['size']
    with np.errstate(all='ignore'):  # of numbers that are refused
        camera_R_world = so3_exp(rotation)
    return camera_from_file(
        path,
        str(entry['name']),
        matrix=np.array(entry['matrix'], dtype=np.float64),
        distortion=np.array(entry['distortions'], dtype=np.float64),
        size=(int(width), int(height)),
        rotation=camera_R_world,
        translation=translation * M_PER_CM,
    )


def _skeletons(path: Path) -> Array:
    """Return the triangulated joints (T, 17, 3), metres: the optimised ones where given."""
    arrays = read_arrays(path, ('keypoints3d', 'keypoints3d_optim'))
    name = 'keypoints3d_optim' if 'keypoints3d_optim' in arrays else 'keypoints3d'
    return _points(path, arrays, name, (None, len(JOINTS), 3), M_PER_CM)


def _points(
    path: Path,
    arrays: dict[str, NDArray[Any]],
    name: str,
    shape: tuple[int | None, ...],
    unit: float = 1.0,
) -> Array:
    return undamaged(_array(path, arrays, name, shape), unit)


def _array(
    path: Path, arrays: dict[str, NDArray[Any]], name: str, shape: tuple[int | None, ...]
) -> NDArray[Any]:
    if name not in arrays:
        raise refusal(path, f'no array {name!r}: it has {shown(", ".join(arrays))}')
    found = arrays[name].shape
    fits = len(found) == len(shape)
    if not fits or any(n not in {None, m} for n, m in zip(shape, found, strict=True)):
        wanted = tuple('T' if n is None else n for n in shape)
        raise refusal(path, f'{name} must be {wanted}, found {found}')
    return arrays[name]


def _seconds(path: Path, arrays: dict[str, NDArray[Any]], n_frames: int) -> Array:
    """Return the instants (T,), seconds.

    Timestamps count microseconds in some files and frames in others, and leave lost frames out:
    their usual step is one frame.
    """
    if 'timestamps' not in arrays or n_frames < 2:
        return np.arange(n_frames) / FPS
    with np.errstate(all='ignore'):  # of numbers that are refused
        stamps = _array(path, arrays, 'timestamps', (n_frames,)).astype(np.float64)
        steps = np.diff(stamps)
        seconds: Array = (stamps - stamps[0]) / (float(np.median(steps)) * FPS)
    if not ((steps > 0.0).all() and np.isfinite(seconds).all()):
        raise refusal(path, 'timestamps must increase')
    return seconds
