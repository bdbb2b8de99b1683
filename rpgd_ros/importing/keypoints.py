# SPDX-License-Identifier: Apache-2.0
"""The keypoints of one camera, from one file per frame or one file per video."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import Array, IntArray
from rpgd_ros.importing.people import MAX_FRAME, Document, chosen, frame_number, read_document
from rpgd_ros.importing.text import refuse, shown
from rpgd_ros.io.camera_files import camera_name

MAX_FILES: Final = 500_000  # two hours at 60 Hz
PROGRESS_EVERY: Final = 50  # files
# What folders of one camera are called, around its name: cam1_json, cam01_keypoints.
ENDINGS: Final = re.compile(r'[_-]?(json|keypoints|pose)$', re.IGNORECASE)

Progress = Callable[[float], None]


@dataclass(frozen=True, slots=True, eq=False)
class Detections:
    """What the detector found in one video.

    Attributes:
        path: Folder or file.
        format: Name of its format.
        frames: (F,) numbers of the frames with somebody in them, increasing.
        uv: (F, K, 2) keypoints; NaN = missing.
        scores: (F, K) scores, 0 where missing.
        joints: Keypoint names that the files state; None = they do not.
        n_empty: Frames without anybody.
        n_others: People that were left out, in all frames.
        first: Number of the first frame, with or without anybody in it.
        is_whole: Whether frames without anybody are listed, so that none comes before `first`.

    """

    path: Path
    format: str
    frames: IntArray
    uv: Array
    scores: Array
    joints: tuple[str, ...] | None
    n_empty: int
    n_others: int
    first: int
    is_whole: bool = True

    @property
    def n_joints(self) -> int:
        """Number of keypoints of a person."""
        return int(self.uv.shape[1])


def read_keypoints(
    path: Path, *, min_score: float = 0.0, progress: Progress | None = None
) -> Detections:
    """Read the keypoints of one camera.

    Of several people in a frame, the one with the largest sum of scores is taken and the others
    are counted. Keypoints at exactly (0, 0), with a score of 0 or below `min_score` are missing.

    Args:
        path: A folder of JSON files, one per frame, or a JSON file of a whole video.
        min_score: Lowest score of a keypoint.
        progress: Called with the fraction that is read.

    Raises:
        InputError: BAD_INPUT, naming file and place.

    """
    if not path.is_dir():
        document = read_document(path)
        if None in document.frames:
            refuse(path, None, 'holds one frame: give the folder of all frames')
        frames = {n: people for n, people in document.frames.items() if n is not None}
        return _detections(path, [document], frames, min_score, {})
    documents: list[Document] = []
    frames = {}
    files = frame_files(path)
    for i, (number, file) in enumerate(files.items()):
        document = read_document(file)
        if len(document.frames) != 1:
            refuse(file, None, 'holds a whole video: give the file instead of its folder')
        documents.append(document._replace(frames={}))
        frames[number] = next(iter(document.frames.values()))
        if progress and i % PROGRESS_EVERY == 0:
            progress(i / len(files))
    return _detections(path, documents, frames, min_score, files)


def frame_files(folder: Path) -> dict[int, Path]:
    """Return the JSON files of a folder by the frame number at the end of their names.

    Raises:
        InputError: None, too many, no number, or the same twice.

    """
    files: dict[int, Path] = {}
    try:
        names = sorted(p for p in folder.iterdir() if p.suffix.lower() == '.json' and p.is_file())
    except OSError as error:
        refuse(folder, None, f'cannot be read: {error.strerror or error}')
    if not 0 < len(names) <= MAX_FILES:
        refuse(folder, None, f'{len(names)} .json files, need 1 to {MAX_FILES}, one per frame')
    for path in names:
        number = frame_number(path.name)
        if number is None:
            refuse(path, None, 'no frame number in its name: need such as video_000001.json')
        if number > MAX_FRAME:
            refuse(path, None, f'need a frame number up to {MAX_FRAME} in its name, got {number}')
        if number in files:
            msg = f'also ends in frame number {number}, as {files[number].name} does: one video '
            refuse(path, None, f'{msg}per folder')
        files[number] = path
    return dict(sorted(files.items()))


def _detections(
    path: Path,
    documents: Sequence[Document],
    people: Mapping[int, list[Array]],
    min_score: float,
    files: Mapping[int, Path],
) -> Detections:
    with_somebody = sorted(number for number, persons in people.items() if persons)
    if not with_somebody:
        refuse(path, None, f'nobody in any of {len(people)} frames', Reason.NO_DATA)
    tables = [chosen(people[number]) for number in with_somebody]
    n_joints = len(tables[0])
    for number, table in zip(with_somebody, tables, strict=True):
        if len(table) != n_joints:
            msg = f'frame {number} has {len(table)} keypoints, those before {n_joints}: one model '
            refuse(
                files.get(number, path), None, f'{msg}per video, all its keypoints in each frame'
            )
    data = np.stack(tables)
    uv, scores = data[..., :2].copy(), data[..., 2].copy()
    is_missing = (uv == 0.0).all(-1) | ~np.isfinite(data).all(-1)
    is_missing |= (scores <= 0.0) | (scores < min_score)
    uv[is_missing] = np.nan
    scores[is_missing] = 0.0
    joints = next((d.joints for d in documents if d.joints is not None), None)
    if joints is not None and len(joints) != n_joints:
        refuse(path, None, f'names {len(joints)} keypoints, but gives {n_joints}')
    formats = sorted({d.format for d in documents})
    return Detections(
        path,
        ' and '.join(formats) if len(formats) < 3 else formats[0],
        np.array(with_somebody, dtype=np.int64),
        uv,
        scores,
        joints,
        len(people) - len(with_somebody),
        sum(len(persons) - 1 for persons in people.values() if persons),
        min(people),
        all(d.is_whole for d in documents),
    )


def camera_paths(root: Path, cameras: Sequence[str]) -> dict[str, Path]:
    """Find the folder or file of each camera below a folder, as in Pose2Sim's `pose`.

    `cam1_json` belongs to camera `cam1`, and by its number to a camera `cam01` where numbers tell
    all cameras apart.

    Args:
        root: Folder with one folder (or JSON file) for each camera.
        cameras: Names of the calibration.

    Returns:
        Path by camera, in the order of the cameras; those without any are left out.

    Raises:
        InputError: Nothing belongs to any camera, or two belong to one.

    """
    try:
        entries = sorted(p for p in root.iterdir() if p.is_dir() or p.suffix.lower() == '.json')
    except OSError as error:
        refuse(root, None, f'cannot be read: {error.strerror or error}')
    found: dict[str, Path] = {}
    keys = {name: frame_number(name) for name in cameras}
    are_telling = None not in keys.values() and len(set(keys.values())) == len(keys)
    for entry in entries:
        name = camera_name(ENDINGS.sub('', entry.name.removesuffix('.json')))
        owner = name if name in keys else None
        if owner is None and are_telling:
            number = frame_number(name)
            owner = next((c for c, n in keys.items() if n == number), None)
        if owner is not None and owner in found:
            msg = f'{shown(found[owner].name)} and {shown(entry.name)} both look like {owner}'
            refuse(root, None, f'{msg}: give each with --keypoints {owner}=PATH')
        if owner is not None:
            found[owner] = entry
    if not found:
        names = ', '.join(shown(e.name) for e in entries[:10]) or 'nothing'
        msg = f'holds {names}; none belongs to cameras {", ".join(list(cameras)[:10])}'
        raise InputError(Reason.UNKNOWN_CAMERA, f'{root}: {msg}: give --keypoints NAME=PATH')
    return {name: found[name] for name in cameras if name in found}
