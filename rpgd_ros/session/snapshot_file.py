# SPDX-License-Identifier: Apache-2.0
"""What a result was found from, as a file: `solve(read_snapshot(path))` gives the same bits again.

An .npz of plain arrays, one of them the settings as JSON; nothing in it is code.
"""

from __future__ import annotations

import json
import math
import struct
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, fields
from io import BytesIO
from pathlib import Path
from tokenize import TokenError
from typing import Any, Final, TypeVar, cast, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray

from rpgd_ros.core.camera import Camera
from rpgd_ros.core.config import CalibrationConfig, Stage
from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import RigidTransform
from rpgd_ros.core.lens import Model
from rpgd_ros.io.atomic import set_aside, staged, write_atomic
from rpgd_ros.io.rig_types import KeypointUnits
from rpgd_ros.io.strict import Node, shown
from rpgd_ros.pairing import PairCounts, Samples, SyncConfig
from rpgd_ros.session.snapshot import KeypointTrack, Snapshot

SCHEMA: Final = 1
HEAD: Final = 'settings'  # the one array that is text
NO_POSE: Final = np.zeros((0, 0))
KEYS: Final = ('schema', 'joint_names', 'sync', 'config', 'pair_counts', 'left_out', 'cameras')
CAMERA_KEYS: Final = ('name', 'size', 'model', 'units', 'min_confidence', 'time_offset_s')
MAX_COUNT: Final = 2**31 - 1
IS_ENCRYPTED: Final = 1  # of the flags of a member
# What zipfile, NumPy and JSON raise on damaged bytes; a member that is not there is a KeyError.
UNREADABLE: Final = (
    OSError, EOFError, ValueError, LookupError, TypeError, MemoryError, OverflowError,
    RuntimeError, SyntaxError, TokenError, zipfile.BadZipFile, struct.error,
)  # fmt: skip

StageT = TypeVar('StageT', bound=Stage)


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
    source = str(path)
    try:
        with zipfile.ZipFile(path) as archive:
            head = Node(
                json.loads(str(_array(archive, HEAD, 'U', 0))), source, Reason.BAD_RESULT_FILE
            )
            _check_schema(head)
            with np.errstate(over='ignore', invalid='ignore'):  # of damaged poses
                return _snapshot(head.mapping(KEYS), archive)
    except UNREADABLE as error:
        msg = f'{source} is no file of observations: {type(error).__name__}: {str(error)[:200]}'
        raise InputError(Reason.BAD_RESULT_FILE, msg) from error


def _check_schema(head: Node) -> None:
    schema = dict(head.items()).get('schema')
    if schema is None or schema.value != SCHEMA:
        found = shown(schema.value if schema else None)
        head.refuse(f'schema {found} is unknown, this version reads {SCHEMA}')


def _array(archive: zipfile.ZipFile, name: str, kind: str, n_axes: int) -> NDArray[Any]:
    """Return an array of a kind ('i' int64, 'f' float64, 'U' text) that the file really holds."""
    member = archive.getinfo(f'{name}.npy')
    if member.compress_type != zipfile.ZIP_STORED or member.flag_bits & IS_ENCRYPTED:
        msg = f'{name} is compressed or encrypted, need an .npz that is neither'
        raise ValueError(msg)
    file = BytesIO(archive.read(member))
    is_first = np.lib.format.read_magic(file) == (1, 0)
    read = np.lib.format.read_array_header_1_0 if is_first else np.lib.format.read_array_header_2_0
    shape, _, dtype = read(file)
    n_bytes = len(file.getbuffer()) - file.tell()
    is_kind = dtype.kind == kind and dtype.isnative and (kind == 'U' or dtype.itemsize == 8)
    if not is_kind or len(shape) != n_axes or math.prod(shape) * dtype.itemsize != n_bytes:
        msg = f'{name} has {n_bytes} bytes for {shape} of {dtype}, need {n_axes} axes of {kind!r}'
        raise ValueError(msg)
    file.seek(0)
    array: NDArray[Any] = np.lib.format.read_array(file, allow_pickle=False)
    return array


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


def _snapshot(head: Mapping[str, Node], archive: zipfile.ZipFile) -> Snapshot:
    names = tuple(node.text() for node in head['joint_names'].sequence())
    cameras, tracks, turns = [], [], {}
    for v, node in enumerate(head['cameras'].sequence()):
        camera, track = _camera(node, f'camera{v}.', archive, len(names))
        cameras.append(camera)
        tracks.append(track)
        turn = _transform(archive, f'camera{v}.turn')
        if turn is not None:
            turns[camera.name] = turn
    stages = get_type_hints(CalibrationConfig)
    given = head['config'].mapping(stages)
    values: dict[str, Any] = {
        name: node.number() if stages[name] is float else _stage(node, stages[name])
        for name, node in given.items()
    }
    pairs = {name: node.sequence() for name, node in head['pair_counts'].items()}
    return Snapshot(
        cameras=tuple(cameras),
        keypoints=tuple(tracks),
        skeletons=_read_samples('skeletons', archive, (len(names), 3)),
        joint_names=names,
        sync=_stage(head['sync'], SyncConfig),
        config=CalibrationConfig(**values),
        pair_counts={
            name: PairCounts(*(count.integer(0, MAX_COUNT) for count in pair))
            for name, pair in pairs.items()
        },
        left_out=tuple(node.text() for node in head['left_out'].sequence()),
        turns=turns,
    )


def _camera(
    node: Node, at: str, archive: zipfile.ZipFile, n_joints: int
) -> tuple[Camera, KeypointTrack]:
    of = node.mapping(CAMERA_KEYS)
    width, height = (side.integer(1, MAX_COUNT) for side in of['size'].sequence())
    camera = Camera(
        of['name'].text(), _array(archive, f'{at}matrix', 'f', 2),
        _array(archive, f'{at}distortion', 'f', 1), (width, height),
        _transform(archive, f'{at}camera_T_world'),
        cast('Model', of['model'].choice(get_args(Model))),
    )  # fmt: skip
    columns = _array(archive, f'{at}columns', 'i', 1)
    if ((columns < 0) | (columns >= n_joints)).any():
        msg = (
            f'{at}columns go from {columns.min()} to {columns.max()}, there are {n_joints} joints'
        )
        raise ValueError(msg)
    return camera, KeypointTrack(
        samples=_read_samples(f'{at}keypoints', archive, (len(columns), 2)),
        columns=columns,
        units=cast('KeypointUnits', of['units'].choice(get_args(KeypointUnits))),
        min_confidence=of['min_confidence'].number(),
        time_offset_s=of['time_offset_s'].number(),
    )


def _stage(node: Node, kind: type[StageT]) -> StageT:
    """Return the settings of a stage; those that the file does not name have their default."""
    defaults = {f.name: f.default for f in fields(cast('Any', kind))}
    values: dict[str, Any] = {}
    for name, given in node.mapping((), defaults).items():
        default = defaults[name]
        if isinstance(default, bool):
            values[name] = given.flag()
        elif isinstance(default, int):
            values[name] = given.integer(-MAX_COUNT, MAX_COUNT)
        else:
            values[name] = given.number() if isinstance(default, float) else given.text()
    try:
        return kind(**values)
    except InputError as error:
        node.refuse(error.message)


def _samples(name: str, samples: Samples) -> dict[str, NDArray[Any]]:
    arrays: dict[str, NDArray[Any]] = {
        f'{name}.stamp_ns': samples.stamp_ns, f'{name}.values': samples.values
    }  # fmt: skip
    if samples.confidence is not None:
        arrays[f'{name}.confidence'] = samples.confidence
    return arrays


def _read_samples(name: str, archive: zipfile.ZipFile, shape: tuple[int, int]) -> Samples:
    """Return samples (F, *shape) whose arrays belong together."""
    stamp_ns = _array(archive, f'{name}.stamp_ns', 'i', 1)
    values = _array(archive, f'{name}.values', 'f', 3)
    key = f'{name}.confidence'
    has_scores = f'{key}.npy' in archive.namelist()
    confidence = _array(archive, key, 'f', 2) if has_scores else None
    expected = (len(stamp_ns), *shape)
    if values.shape != expected or not (confidence is None or confidence.shape == expected[:2]):
        msg = f'{name}: values {values.shape}, need {expected}, and confidence {expected[:2]}'
        raise ValueError(msg)
    if (stamp_ns[1:] <= stamp_ns[:-1]).any() or np.isinf(values).any():
        msg = f'{name}: need stamps that increase, and values that are finite or NaN'
        raise ValueError(msg)
    return Samples(stamp_ns, values, confidence)


def _transform(archive: zipfile.ZipFile, name: str) -> RigidTransform | None:
    matrix = _array(archive, name, 'f', 2)
    return RigidTransform.from_matrix(matrix) if matrix.size else None
