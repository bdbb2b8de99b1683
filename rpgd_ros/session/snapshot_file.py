# SPDX-License-Identifier: Apache-2.0
"""What a result was found from, as a file: `solve(read_snapshot(path))` gives the same bits again.

An .npz of plain arrays, one of them the settings as JSON; nothing in it is code.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, fields
from io import BytesIO
from pathlib import Path
from typing import Any, Final, get_type_hints

import numpy as np
from numpy.typing import NDArray

from rpgd_ros.core.camera import Camera
from rpgd_ros.core.config import CalibrationConfig
from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import RigidTransform
from rpgd_ros.io.atomic import set_aside, staged, write_atomic
from rpgd_ros.pairing import PairCounts, Samples, SyncConfig
from rpgd_ros.session.snapshot import KeypointTrack, Snapshot

SCHEMA: Final = 1
HEAD: Final = 'settings'  # the one array that is text
NO_POSE: Final = np.zeros((0, 0))


def write_snapshot(path: Path | str, snapshot: Snapshot) -> None:
    """Write a snapshot, uncompressed: a run waits for it, and disks are large.

    Raises:
        InputError: NOT_WRITABLE. An old file is untouched.

    """
    write_atomic(path, _packed(snapshot))


@contextmanager
def exchanged(path: Path | str, snapshot: Snapshot | None) -> Iterator[None]:
    """Exchange what a result came from, while that result is written.

    The new file is whole on the disk before anything changes, and none is in its place until the
    result is: whatever happens, no result ever stands beside the data of another.

    Args:
        path: Beside the result file.
        snapshot: What the new result came from; None = not known, the old file goes.

    Raises:
        InputError: NOT_WRITABLE. The old file is in its place, as after any exception inside.

    """
    if snapshot is None:
        with set_aside(path):
            yield
        return
    with staged(path, _packed(snapshot)) as put:
        with set_aside(path):
            yield
        put()


def _packed(snapshot: Snapshot) -> bytes:
    """Return a snapshot as the bytes of its file."""
    snapshot = snapshot.alone()  # of several persons, those that the solve used
    arrays: dict[str, NDArray[Any]] = _samples('skeletons', snapshot.skeletons)
    for v, (camera, track) in enumerate(zip(snapshot.cameras, snapshot.keypoints, strict=True)):
        pose, turn = camera.camera_T_world, snapshot.turns.get(camera.name)
        arrays |= _samples(f'camera{v}.keypoints', track.samples)
        arrays |= {
            f'camera{v}.columns': track.columns,
            f'camera{v}.matrix': camera.matrix,
            f'camera{v}.distortion': camera.distortion,
            f'camera{v}.camera_T_world': NO_POSE if pose is None else pose.matrix,
            f'camera{v}.turn': NO_POSE if turn is None else turn.matrix,
        }
    arrays[HEAD] = np.array(json.dumps(_head(snapshot)))
    file = BytesIO()
    np.savez(file, **arrays)  # type: ignore[arg-type]
    return file.getvalue()


def read_snapshot(path: Path | str) -> Snapshot:
    """Read a snapshot.

    Raises:
        InputError: BAD_RESULT_FILE. It cannot be read, or is none.

    """
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = dict(file)
        head = json.loads(str(arrays[HEAD]))
        if head['schema'] != SCHEMA:
            msg = f'{path}: schema {head["schema"]!r} is unknown, this version reads {SCHEMA}'
            raise InputError(Reason.BAD_RESULT_FILE, msg)
        return _snapshot(head, arrays)
    except (OSError, EOFError, ValueError, KeyError, TypeError, zipfile.BadZipFile) as error:
        msg = f'{path} is no file of observations: {type(error).__name__}: {error}'
        raise InputError(Reason.BAD_RESULT_FILE, msg) from error


def _head(snapshot: Snapshot) -> dict[str, Any]:
    return {
        'schema': SCHEMA,
        'joint_names': snapshot.joint_names,
        'sync': asdict(snapshot.sync),
        'config': asdict(snapshot.config),
        'pair_counts': snapshot.pair_counts,
        'left_out': snapshot.left_out,
        'cameras': [
            {
                'name': camera.name,
                'size': camera.size,
                'model': camera.model,
                'units': track.units,
                'min_confidence': track.min_confidence,
                'time_offset_s': track.time_offset_s,
            }
            for camera, track in zip(snapshot.cameras, snapshot.keypoints, strict=True)
        ],
    }


def _snapshot(head: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> Snapshot:
    cameras, tracks, turns = [], [], {}
    for v, of in enumerate(head['cameras']):
        at = f'camera{v}.'
        camera = Camera(
            of['name'], arrays[f'{at}matrix'], arrays[f'{at}distortion'], tuple(of['size']),
            _transform(arrays[f'{at}camera_T_world']), of['model'],
        )  # fmt: skip
        cameras.append(camera)
        tracks.append(
            KeypointTrack(
                samples=_read_samples(f'{at}keypoints', arrays),
                columns=arrays[f'{at}columns'],
                units=of['units'],
                min_confidence=of['min_confidence'],
                time_offset_s=of['time_offset_s'],
            )
        )
        turn = _transform(arrays[f'{at}turn'])
        if turn is not None:
            turns[camera.name] = turn
    stages = get_type_hints(CalibrationConfig)
    return Snapshot(
        cameras=tuple(cameras),
        keypoints=tuple(tracks),
        skeletons=_read_samples('skeletons', arrays),
        joint_names=tuple(head['joint_names']),
        sync=SyncConfig(**head['sync']),
        config=CalibrationConfig(
            **{
                f.name: stages[f.name](**value) if isinstance(value, dict) else value
                for f in fields(CalibrationConfig)
                for value in [head['config'][f.name]]
            }
        ),
        pair_counts={name: PairCounts(*pair) for name, pair in head['pair_counts'].items()},
        left_out=tuple(head['left_out']),
        turns=turns,
    )


def _samples(name: str, samples: Samples) -> dict[str, NDArray[Any]]:
    arrays: dict[str, NDArray[Any]] = {
        f'{name}.stamp_ns': samples.stamp_ns, f'{name}.values': samples.values
    }  # fmt: skip
    if samples.confidence is not None:
        arrays[f'{name}.confidence'] = samples.confidence
    return arrays


def _read_samples(name: str, arrays: dict[str, NDArray[Any]]) -> Samples:
    confidence = arrays.get(f'{name}.confidence')
    return Samples(arrays[f'{name}.stamp_ns'], arrays[f'{name}.values'], confidence)


def _transform(matrix: NDArray[np.float64]) -> RigidTransform | None:
    return RigidTransform.from_matrix(matrix) if matrix.size else None
