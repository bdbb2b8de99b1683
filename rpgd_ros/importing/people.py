# SPDX-License-Identifier: Apache-2.0
"""What the JSON documents of pose detectors say: people by frame."""

from __future__ import annotations

import json
import re
from collections import defaultdict
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from rpgd_ros.core.geometry import Array
from rpgd_ros.importing.text import read_bytes, refuse, shown
from rpgd_ros.skeletons import MAX_JOINTS

OPENPOSE: Final = 'OpenPose JSON'
COCO: Final = 'COCO JSON'
ALPHAPOSE: Final = 'AlphaPose JSON'
MMPOSE: Final = 'MMPose JSON'
LARGEST_PX, LARGEST_SCORE = 1e9, 1e3  # scores are shares, percents or heights of peaks
MAX_FRAME: Final = 10**9  # 190 days at 60 Hz; a larger number is a date or a hash
# Where the keypoints of one person are, by tool.
FLAT_KEYS: Final = ('pose_keypoints_2d', 'pose_keypoints', 'joints', 'keypoints')


class Document(NamedTuple):
    """The people of one file.

    Attributes:
        format: Name of the format.
        frames: People by frame number, each (K, 3) u, v, score; key None = the file is one frame.
        joints: Keypoint names that the file states; None = it does not.
        is_whole: Whether frames without anybody are listed too.

    """

    format: str
    frames: Mapping[int | None, list[Array]]
    joints: tuple[str, ...] | None = None
    is_whole: bool = True


def frame_number(name: str) -> int | None:
    """Return the last number in the name of a file or image without its ending, or None."""
    stem = re.sub(r'\.(json|jpe?g|png|bmp|tiff?)$', '', name, flags=re.IGNORECASE)
    found = re.findall(r'\d+', re.sub('_keypoints$', '', Path(stem).name))
    return int(found[-1][-18:]) if found else None


def read_document(path: Path) -> Document:
    """Read the JSON of a detector.

    Raises:
        InputError: BAD_INPUT, naming file, place and what is known.

    """
    try:
        tree = json.loads(read_bytes(path))
    except (ValueError, RecursionError) as error:
        line = getattr(error, 'lineno', None)
        refuse(path, line, f'is not JSON: {str(error)[:200]}')
    if isinstance(tree, dict):
        return _of_mapping(path, tree)
    if not isinstance(tree, list):
        refuse(path, 1, f'need a JSON object or list, got {shown(tree)}')
    return _of_list(path, tree)


def _of_mapping(path: Path, tree: Mapping[str, Any]) -> Document:
    if 'people' in tree or 'bodies' in tree:
        return Document(OPENPOSE, {None: _people(path, tree, '')})
    if 'annotations' in tree:
        return _of_annotations(path, tree)
    if 'instance_info' in tree:
        document = _of_list(path, _list(path, tree['instance_info'], 'instance_info'))
        return document._replace(joints=_mmpose_joints(path, tree.get('meta_info')))
    # AlphaPose for a whole video, in the layouts of OpenPose and CMU: people by image.
    images = [
        (k, v) for k, v in tree.items() if isinstance(v, dict) and ('people' in v or 'bodies' in v)
    ]
    if not images or len(images) < len(tree):
        keys = ', '.join(shown(key) for key in list(tree)[:5])
        known = 'people (OpenPose), annotations (COCO) or instance_info (MMPose)'
        refuse(path, 1, f'need an object with {known}, got one with {keys or "nothing"}')
    frames: dict[int | None, list[Array]] = {}
    for name, value in images:
        frame = _image(path, name, name)
        _check_new(path, frame, frames, name)
        frames[frame] = _people(path, value, f'{name}.')
    return Document(ALPHAPOSE, frames, is_whole=False)


def _people(path: Path, tree: Mapping[str, Any], where: str) -> list[Array]:
    key = 'people' if 'people' in tree else 'bodies'
    people = _list(path, tree[key], f'{where}{key}')
    return [_person(path, p, f'{where}{key}[{i}]') for i, p in enumerate(people)]


def _of_list(path: Path, items: list[Any]) -> Document:
    """Read a list: of detections with `image_id`, of frames, or of the people of one frame."""
    if not items:
        return Document(MMPOSE, {None: []})
    if not isinstance(items[0], dict):
        refuse(path, 1, f'need a list of objects, got {shown(items[0])}')
    frames: dict[int | None, list[Array]] = defaultdict(list)
    image_of: dict[int, object] = {}
    name = MMPOSE
    for i, item in enumerate(items):
        place = f'[{i}]'
        if not isinstance(item, dict):
            refuse(path, None, f'{place}: need an object, got {shown(item)}')
        if 'instances' in item:
            frame = _frame(path, item.get('frame_id'), f'{place}.frame_id')
            frames[frame] += [
                _person(path, p, f'{place}.instances[{j}]')
                for j, p in enumerate(_list(path, item['instances'], f'{place}.instances'))
            ]
        elif 'image_id' in item:
            is_name = isinstance(item['image_id'], str)
            name = ALPHAPOSE if is_name else COCO
            frame = _image(path, item['image_id'], f'{place}.image_id')
            if frame in frames and image_of[frame] != item['image_id']:
                _check_new(path, frame, frames, f'{place}.image_id')
            image_of[frame] = item['image_id']
            frames[frame].append(_person(path, item, place))
        else:
            frames[None].append(_person(path, item, place))
    if None in frames and len(frames) > 1:
        refuse(path, None, 'some entries name their frame and others do not')
    return Document(name, frames, is_whole=name == MMPOSE)


def _of_annotations(path: Path, tree: Mapping[str, Any]) -> Document:
    """Read COCO's own layout: images, annotations, categories."""
    frames: dict[int | None, list[Array]] = {}
    frame_of: dict[object, int] = {}
    for i, image in enumerate(_list(path, tree.get('images'), 'images')):
        place = f'images[{i}]'
        if not isinstance(image, dict) or 'id' not in image:
            refuse(path, None, f'{place}: need an object with id and file_name')
        name = str(image.get('file_name', image['id']))
        frame = _image(path, name, f'{place}.file_name')
        _check_new(path, frame, frames, f'{place}.file_name')
        frames[frame] = []
        if str(image['id']) in frame_of:
            refuse(path, None, f'{place}.id: {shown(image["id"])} is also that of another image')
        frame_of[str(image['id'])] = frame
    for i, item in enumerate(_list(path, tree['annotations'], 'annotations')):
        place = f'annotations[{i}]'
        if not isinstance(item, dict) or str(item.get('image_id')) not in frame_of:
            refuse(path, None, f'{place}: need image_id, one of the images')
        frames[frame_of[str(item['image_id'])]].append(_person(path, item, place))
    joints = None
    categories = tree.get('categories')
    if isinstance(categories, list) and categories and isinstance(categories[0], dict):
        joints = _names(path, categories[0].get('keypoints'), 'categories[0].keypoints')
    return Document(COCO, frames, joints)


def _mmpose_joints(path: Path, meta: object) -> tuple[str, ...] | None:
    table = meta.get('keypoint_id2name') if isinstance(meta, dict) else None
    if not isinstance(table, dict):
        return None
    return _names(path, list(table.values()), 'meta_info.keypoint_id2name')


def _names(path: Path, names: object, place: str) -> tuple[str, ...] | None:
    if names is None:
        return None
    if not isinstance(names, list) or not all(isinstance(n, str) for n in names):
        refuse(path, None, f'{place}: need a list of names, got {shown(names)}')
    for i, name in enumerate(names):
        if not name.isprintable():
            refuse(path, None, f'{place}[{i}]: {shown(name)} is no name that can be written')
    return tuple(names)


def _check_new(path: Path, frame: int, known: Collection[int | None], place: str) -> None:
    if frame in known:
        msg = f'{place[:80]}: frame {frame} is also that of another image: one video per file'
        refuse(path, None, msg)


def _list(path: Path, value: object, place: str) -> list[Any]:
    if not isinstance(value, list):
        refuse(path, None, f'{place}: need a list, got {shown(value)}')
    return value


def _frame(path: Path, value: object, place: str) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value <= MAX_FRAME:
        refuse(path, None, f'{place}: need a frame number from 0, got {shown(value)}')
    return value


def _image(path: Path, value: object, place: str) -> int:
    """Return the frame that an image's name or number says."""
    if not isinstance(value, str):
        return _frame(path, value, place)
    found = frame_number(value)
    if found is None:
        refuse(path, None, f'{place}: no frame number in {shown(value)}: name images 000001.jpg')
    return _frame(path, found, place)


def _person(path: Path, item: object, place: str) -> Array:
    """Return the keypoints (K, 3) of a person: u, v, score."""
    keys = [key for key in FLAT_KEYS if isinstance(item, dict) and key in item]
    if not isinstance(item, dict) or not keys:
        refuse(path, None, f'{place}: no keypoints; need one of {", ".join(FLAT_KEYS)}')
    values = _list(path, item[keys[0]], f'{place}.{keys[0]}')
    try:
        table = np.array(values, dtype=np.float64)
    except (ValueError, TypeError, OverflowError):
        refuse(path, None, f'{place}.{keys[0]}: need numbers, equally many for each keypoint')
    if table.ndim == 1 and table.size % 3 == 0:
        table = table.reshape(-1, 3)
    if table.ndim == 3 and len(table) == 1:  # MMPose wraps what it writes for images
        table = table[0]
    if table.ndim == 2 and table.shape[1] == 2:
        scores = item.get('keypoint_scores', [1.0] * len(table))
        table = np.column_stack([table, _scores(path, scores, len(table), place)])
    if table.ndim != 2 or table.shape[1] != 3 or not 0 < len(table) <= MAX_JOINTS:
        msg = f'need x, y, score for each of 1 to {MAX_JOINTS} keypoints, got {table.size} numbers'
        refuse(path, None, f'{place}.{keys[0]}: {msg}')
    return _without_damage(table)


def _scores(path: Path, values: object, n: int, place: str) -> Array:
    try:
        scores = np.array(values, dtype=np.float64).reshape(-1)
    except (ValueError, TypeError, OverflowError):
        scores = np.zeros(0)
    if len(scores) != n:
        refuse(path, None, f'{place}.keypoint_scores: need {n} numbers, got {shown(values)}')
    return scores


def chosen(people: list[Array]) -> Array:
    """Return the person with the largest sum of scores: the most, and the surest, keypoints."""
    return max(people, key=lambda person: float(person[:, 2].clip(0.0).sum()))


def _without_damage(table: Array) -> Array:
    """Return keypoints (K, 3) in which those with an impossible number are missing, as zeros."""
    is_sound = np.asarray((np.abs(table) <= (LARGEST_PX, LARGEST_PX, LARGEST_SCORE)).all(1))
    return np.where(is_sound[:, None], table, 0.0)
