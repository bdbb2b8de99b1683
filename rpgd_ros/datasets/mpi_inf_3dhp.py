# SPDX-License-Identifier: Apache-2.0
"""MPI-INF-3DHP (training set): markerless MoCap and 14 cameras without distortion.

The layout is that of its own archive:

    S*/Seq*/annot.mat            cells of 14 cameras: annot2 (T, 56), pixels; annot3 (T, 84),
                                 millimetres, in the frame of that camera
    S*/Seq*/camera.calibration   per camera: name, sensor, size, animated, intrinsic (4 x 4),
                                 extrinsic (4 x 4, world -> camera, millimetres), radial

There is no MoCap frame: skeletons are given 14 times, once per camera frame. It is rebuilt by one
rule: the annotations of the first camera are brought into the world by that camera's extrinsics,
and the sequence is then moved by `drawn_pose`. Those of the other cameras, and univ_annot3, whose
bodies are scaled to one height, are not used.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rpgd_ros.core.camera import Camera
from rpgd_ros.core.geometry import Array
from rpgd_ros.datasets.files import (
    numbers,
    read_by_library,
    read_text,
    require_folder,
    require_library,
    undamaged,
)
from rpgd_ros.datasets.sequence import (
    DatasetSequence,
    camera_from_file,
    check_name,
    refusal,
    sequence_from_world,
    sequence_names,
    shown,
)
from rpgd_ros.skeletons import joint_names

M_PER_MM = 0.001
JOINTS = joint_names('mpi28')
N_CAMERAS = 14
HEADER = 'Skeletool Camera Calibration File V1.0'
ENTRY_LENGTHS = {
    'name': 1, 'sensor': 2, 'size': 2, 'animated': 1, 'intrinsic': 16, 'extrinsic': 16, 'radial': 1
}  # fmt: skip
CHILD = Path(__file__).with_name('mat_child.py')
MAX_MAT_BYTES = 2**30  # the longest sequence takes 0.3 GiB uncompressed
# All recordings last four minutes: those of about 6000 frames ran at 25 Hz, of 12000 at 50 Hz.
FAST_FRAMES = 9000
FPS, FAST_FPS = 25.0, 50.0


@dataclass(frozen=True, slots=True)
class MpiInf3dhp:
    """A folder of MPI-INF-3DHP's training set.

    Attributes:
        folder: That holds the subjects.
        names: `<subject>/<sequence>`.

    """

    folder: Path
    names: tuple[str, ...]

    @classmethod
    def open(cls, folder: Path) -> MpiInf3dhp:
        """List the sequences.

        The publication used 14 of the 16, and does not say which: they are all there.

        Raises:
            InputError: Not such a folder.

        """
        found = require_folder(folder).glob('S*/Seq*/annot.mat')
        names = sorted(f'{p.parts[-3]}/{p.parts[-2]}' for p in found)
        return cls(folder, sequence_names(folder, names))

    def read(self, name: str) -> DatasetSequence:
        """Read one sequence; see `Dataset`."""
        check_name(name, self.names)
        calibration, annotations = self.files(name)
        cameras = read_cameras(calibration)
        uv, x_first = _annotations(annotations, len(cameras))
        first = cameras[0].camera_T_world
        if first is None:
            raise refusal(calibration, 'the first camera has no extrinsics')
        x_world = first.inverse() @ x_first
        fps = FAST_FPS if len(x_world) > FAST_FRAMES else FPS
        return sequence_from_world(name, cameras, x_world, uv, fps=fps, joint_names=JOINTS)

    def files(self, name: str) -> tuple[Path, ...]:
        """Return calibration and annotations; see `Dataset`."""
        return self.folder / name / 'camera.calibration', self.folder / name / 'annot.mat'

    def objection(self, sequence: DatasetSequence) -> str:
        """Leave no sequence out; see `Dataset`."""
        del sequence
        return ''


def read_cameras(path: Path) -> tuple[Camera, ...]:
    """Read the 14 cameras of a camera.calibration.

    Raises:
        InputError: Not such a file.

    """
    header, *lines = read_text(path).strip().splitlines() or ['']
    if header.strip() != HEADER:
        raise refusal(path, f'the first line must be {HEADER!r}, found {shown(header)}')
    if len(lines) != N_CAMERAS * len(ENTRY_LENGTHS):
        need = f'{N_CAMERAS} cameras of {len(ENTRY_LENGTHS)} lines'
        raise refusal(path, f'need {need}, found {len(lines)} lines')
    step = len(ENTRY_LENGTHS)
    return tuple(_camera(path, lines[i : i + step]) for i in range(0, len(lines), step))


def _camera(path: Path, lines: list[str]) -> Camera:
    entry: dict[str, list[str]] = {}
    for line, key in zip(lines, ENTRY_LENGTHS, strict=True):
        found, *words = line.split() or ['']
        if found != key or len(words) != ENTRY_LENGTHS[key]:
            need = f'{key} with {ENTRY_LENGTHS[key]} values'
            raise refusal(path, f'need {need}, found {shown(line)}')
        entry[key] = words
    name = entry['name'][0]
    if entry['animated'] != ['0'] or float(numbers(path, 'radial', entry['radial'], 1)[0]):
        raise refusal(path, f'camera {shown(name)}: moving or distorting cameras are unknown here')
    width, height = numbers(path, 'size', entry['size'], 2)
    extrinsic = numbers(path, 'extrinsic', entry['extrinsic'], 16).reshape(4, 4)
    return camera_from_file(
        path,
        name,
        matrix=numbers(path, 'intrinsic', entry['intrinsic'], 16).reshape(4, 4)[:3, :3],
        distortion=np.zeros(0),
        size=(int(width), int(height)),
        rotation=extrinsic[:3, :3],
        translation=extrinsic[:3, 3] * M_PER_MM,
    )


def _annotations(path: Path, n_cameras: int) -> tuple[Array, Array]:
    """Return keypoints (V, T, 28, 2), pixels, and the first camera's joints (T, 28, 3), metres."""
    require_library('scipy')
    (content,) = read_by_library(CHILD, [path], what='a MATLAB file', max_bytes=MAX_MAT_BYTES)
    arrays = iter(content.arrays)
    shapes = {name: _cells(path, name, content.facts, n_cameras) for name in ('annot2', 'annot3')}
    tables = [_joints(path, 'annot2', shape, arrays, 2) for shape in shapes['annot2']]
    x_first = undamaged(_joints(path, 'annot3', shapes['annot3'][0], arrays, 3), M_PER_MM)
    uv = np.empty((n_cameras, len(x_first), len(JOINTS), 2))
    for row, keypoints in zip(uv, tables, strict=True):
        if keypoints.shape != row.shape:
            counts = f'{len(keypoints)} frames, but annot3 has {len(x_first)}'
            raise refusal(path, f'annot2: {counts}')
        row[:] = undamaged(keypoints)
    return uv, x_first


def _cells(path: Path, name: str, facts: dict[str, Any], n_cameras: int) -> list[Any]:
    if name not in facts:
        raise refusal(path, f'no variable {name}')
    shapes = facts[name]
    if not isinstance(shapes, list) or len(shapes) != n_cameras:
        found = len(shapes) if isinstance(shapes, list) else f'{shapes} values'
        raise refusal(path, f'{name} must have {n_cameras} cells, found {found}')
    return shapes


def _joints(
    path: Path, name: str, shape: list[int] | None, arrays: Iterator[Array], n_values: int
) -> Array:
    width = len(JOINTS) * n_values
    if shape is None or len(shape) != 2 or shape[1] != width:
        found = 'something else' if shape is None else tuple(shape)
        raise refusal(path, f'{name} must hold numbers (T, {width}), found {found}')
    return next(arrays).reshape(-1, len(JOINTS), n_values)
