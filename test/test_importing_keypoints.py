# SPDX-License-Identifier: Apache-2.0
"""Keypoint files: one person per frame, what is missing, and which camera they belong to."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from shoot_files import (
    write_alphapose,
    write_coco,
    write_labels,
    write_mmpose,
    write_openpose,
)

from rpgd_ros.core.errors import InputError
from rpgd_ros.core.geometry import Array
from rpgd_ros.importing.keypoints import camera_paths, read_keypoints
from rpgd_ros.importing.people import frame_number
from rpgd_ros.skeletons import CONVENTIONS

NAMES = CONVENTIONS['coco17']
PERSON = [10.0, 20.0, 0.9, 30.0, 40.0, 0.8]
WEAK = [1.0, 2.0, 0.3, 3.0, 4.0, 0.2]


def pixels(n_frames: int = 6, seed: int = 0) -> Array:
    """Return keypoints (F, 17, 2), some of them missing."""
    rng = np.random.default_rng(seed)
    uv = np.round(rng.uniform(1.0, 1900.0, (n_frames, 17, 2)), 3)
    uv[rng.random((n_frames, 17)) < 0.2] = np.nan
    uv[:, 0] = 5.0
    return uv


def write(path: Path, tree: object) -> Path:
    """Write JSON and return its place."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(tree))
    return path


@pytest.mark.parametrize(
    ('kind', 'name'),
    [
        ('openpose', 'OpenPose JSON'),
        ('coco', 'COCO JSON'),
        ('labels', 'COCO JSON'),
        ('alphapose', 'AlphaPose JSON'),
        ('mmpose', 'MMPose JSON'),
    ],
)
def test_what_a_tool_writes_is_read_back(tmp_path: Path, kind: str, name: str) -> None:
    """Frames, pixels, scores, and names where the layout has them."""
    uv = pixels()
    path = tmp_path / kind
    writers: dict[str, Any] = {
        'openpose': lambda: write_openpose(path, uv),
        'coco': lambda: write_coco(path, uv),
        'labels': lambda: write_labels(path, uv, NAMES),
        'alphapose': lambda: write_alphapose(path, uv),
        'mmpose': lambda: write_mmpose(path, uv, NAMES),
    }
    writers[kind]()
    found = read_keypoints(path)
    assert found.format == name
    assert found.frames.tolist() == list(range(6))
    np.testing.assert_allclose(found.uv, uv, atol=1e-4)
    np.testing.assert_array_equal(found.scores > 0.0, np.isfinite(uv[..., 0]))
    assert found.joints == (NAMES if kind in {'labels', 'mmpose'} else None)
    assert found.is_whole == (kind not in {'coco', 'alphapose'})  # lists of what was found


def test_surest_person_is_taken_and_others_are_counted(tmp_path: Path) -> None:
    """By the sum of scores; the order in the file does not matter."""
    people = [{'pose_keypoints_2d': p} for p in (WEAK, PERSON, WEAK)]
    write(tmp_path / 'v' / 'a_000_keypoints.json', {'people': people})
    write(tmp_path / 'v' / 'a_001_keypoints.json', {'people': []})
    write(tmp_path / 'v' / 'a_004_keypoints.json', {'people': people[:1]})
    found = read_keypoints(tmp_path / 'v')
    assert found.frames.tolist() == [0, 4]
    assert (found.n_empty, found.n_others, found.first) == (1, 2, 0)
    np.testing.assert_array_equal(found.uv[0], [[10, 20], [30, 40]])
    np.testing.assert_array_equal(found.scores[1], [0.3, 0.2])


@pytest.mark.parametrize('score', [float('inf'), -float('inf'), float('nan'), 1e308, 1e6, -50.0])
def test_person_with_a_damaged_score_does_not_win(tmp_path: Path, score: float) -> None:
    """That score counts as none, in either order."""
    damaged = [*WEAK[:5], score]
    for i, people in enumerate(([damaged, PERSON], [PERSON, damaged])):
        tree = [{'keypoints': person, 'image_id': 1} for person in people]
        found = read_keypoints(write(tmp_path / f'{i}.json', tree))
        np.testing.assert_array_equal(found.uv[0], [[10, 20], [30, 40]])


@pytest.mark.parametrize('value', [1e308, -1e200, float('inf')])
def test_keypoint_at_an_impossible_place_is_missing(tmp_path: Path, value: float) -> None:
    """Nothing is computed with it, which would end in a warning and in infinite numbers."""
    tree = [{'keypoints': [*PERSON[:3], value, *PERSON[4:]], 'image_id': 1}]
    found = read_keypoints(write(tmp_path / 'v.json', tree))
    assert np.isfinite(found.uv[0]).tolist() == [[True, True], [False, False]]
    assert found.scores[0, 1] == 0.0


def test_zeros_and_low_scores_are_missing(tmp_path: Path) -> None:
    """Also what is no number, which JSON of Python may hold."""
    people = [{'keypoints': [[0, 0], [5, 6], [7, 8], [9, float('nan')]],
               'keypoint_scores': [0.9, 0.0, 0.4, 0.9]}]  # fmt: skip
    write(tmp_path / 'v' / '1.json', people)
    found = read_keypoints(tmp_path / 'v')
    assert np.isfinite(found.uv[0, :, 0]).tolist() == [False, False, True, False]
    found = read_keypoints(tmp_path / 'v', min_score=0.5)
    assert not np.isfinite(found.uv).any()


@pytest.mark.parametrize(
    'tree',
    [
        {'0.jpg': {'version': 0.1, 'bodies': [{'joints': PERSON}]}},
        {'0.jpg': {'version': 1.1, 'people': [{'pose_keypoints_2d': PERSON}]}},
        [{'frame_id': 0, 'instances': [{'keypoints': [[10, 20], [30, 40]]}]}],
        [{'frame_id': 0, 'instances': [{'keypoints': [[[10, 20], [30, 40]]]}]}],
        {'instance_info': [{'frame_id': 0, 'instances': [{'keypoints': [[10, 20], [30, 40]]}]}]},
        [{'image_id': 'video_0.png', 'keypoints': PERSON}],
    ],
)
def test_other_layouts_of_the_tools_are_read_too(tmp_path: Path, tree: object) -> None:
    """CMU and OpenPose layouts of AlphaPose, MMPose with and without meta data."""
    found = read_keypoints(write(tmp_path / 'video.json', tree))
    np.testing.assert_array_equal(found.uv[0], [[10, 20], [30, 40]])
    assert found.frames.tolist() == [0]


def test_folder_of_alphapose_frames_is_numbered_by_its_files(tmp_path: Path) -> None:
    """With --separate-json each file holds the people of one image."""
    for i in (1, 2, 3):
        write(tmp_path / 'v' / f'{i}.json', [{'image_id': f'{i}.jpg', 'keypoints': PERSON}])
    assert read_keypoints(tmp_path / 'v').frames.tolist() == [1, 2, 3]


@pytest.mark.parametrize(
    ('name', 'number'),
    [
        ('video_000000000012_keypoints.json', 12),
        ('cam01.0214.json', 214),
        ('frames/000007.jpg', 7),
        ('take2_0003_keypoints.json', 3),
        ('poses.json', None),
    ],
)
def test_frame_number_is_the_last_in_the_name(name: str, number: int | None) -> None:
    """Cameras and takes have numbers too, before it."""
    assert frame_number(name) == number


@pytest.mark.parametrize(
    ('tree', 'message'),
    [
        ({'people': [{'pose_keypoints_2d': PERSON}]}, 'holds one frame: give the folder'),
        ({'a': 1}, "need an object with people .OpenPose., .* got one with 'a'"),
        ({}, 'got one with nothing'),
        (7, 'need a JSON object or list, got 7'),
        ([1], 'need a list of objects, got 1'),
        ([{'image_id': 1, 'keypoints': PERSON}, 5], r'\[1\]: need an object'),
        ([{'image_id': -1, 'keypoints': PERSON}], r'\[0\].image_id: need a frame number'),
        ([{'image_id': 'a.jpg', 'keypoints': PERSON}], "no frame number in 'a.jpg': name images"),
        ([{'image_id': 1}], r'\[0\]: no keypoints; need one of'),
        ([{'image_id': 1, 'keypoints': [1, 2]}], 'need x, y, score for each of 1 to 256'),
        ([{'image_id': 1, 'keypoints': ['a', 1, 2]}], 'keypoints: need numbers'),
        ([{'image_id': 1, 'keypoints': [[1, 2], [3]]}], 'keypoints: need numbers'),
        ([{'image_id': 1, 'keypoints': [[1, 2]], 'keypoint_scores': [1, 2]}], 'need 1 numbers'),
        ([{'image_id': 1, 'keypoints': PERSON}, {'keypoints': PERSON}], 'and others do not'),
        ([{'image_id': 1, 'keypoints': PERSON}, {'image_id': 2, 'keypoints': PERSON[:3]}],
         'frame 2 has 1 keypoints, those before 2'),
        ([{'frame_id': 3, 'instances': []}], 'nobody in any of 1 frames'),
        ({'annotations': [], 'images': [1]}, r'images\[0\]: need an object with id'),
        ({'annotations': [{'image_id': 9}], 'images': []}, r'annotations\[0\]: need image_id'),
        ({'annotations': [], 'images': []}, 'nobody in any of 0 frames'),
        ({'annotations': [{'image_id': 1, 'keypoints': PERSON}],
          'images': [{'id': 1, 'file_name': '1.jpg'}], 'categories': [{'keypoints': ['a']}]},
         'names 1 keypoints, but gives 2'),
        ({'0.jpg': {'people': []}, 'a0.jpg': {'people': []}},
         r'json: a0.jpg: frame 0 is also that of another image: one video per file'),
        ([{'image_id': n, 'keypoints': PERSON} for n in ('0.jpg', '0.jpg', 'a0.jpg')],
         r'\[2\].image_id: frame 0 is also that of another image'),
        ({'annotations': [], 'images': [{'id': 1, 'file_name': f'{c}/1.jpg'} for c in 'ab']},
         r'images\[1\].file_name: frame 1 is also that of another image'),
        ({'annotations': [], 'images': [{'id': 1, 'file_name': f'{n}.jpg'} for n in (1, 2)]},
         r'images\[1\].id: 1 is also that of another image'),
        ({'annotations': [], 'images': [], 'categories': [{'keypoints': ['a', '\ud800']}]},
         r"categories\[0\].keypoints\[1\]: '.ud800' is no name that can be written"),
    ],
)  # fmt: skip
def test_fault_is_named_with_file_and_place(tmp_path: Path, tree: object, message: str) -> None:
    """And with what was needed."""
    path = write(tmp_path / 'video.json', tree)
    with pytest.raises(InputError, match=message) as refused:
        read_keypoints(path)
    assert refused.value.message.startswith(str(path))


@pytest.mark.parametrize(
    ('text', 'message'),
    [('{"people": [', ':1: is not JSON'), ('[' * 100_000, 'is not JSON'), ('', 'is not JSON')],
)
def test_file_that_is_no_json_is_refused(tmp_path: Path, text: str, message: str) -> None:
    """Cut off, or nested without end."""
    (tmp_path / 'video.json').write_text(text)
    with pytest.raises(InputError, match=message):
        read_keypoints(tmp_path / 'video.json')


def test_folder_that_is_no_video_is_refused(tmp_path: Path) -> None:
    """Empty, without numbers, of two videos, of whole videos."""
    with pytest.raises(InputError, match=r'0 \.json files, need 1 to'):
        read_keypoints(tmp_path)
    for name, message in (('poses.json', 'no frame number'), ('1.json', 'also ends in frame')):
        folder = tmp_path / name
        write(folder / name, {'people': []})
        write(folder / 'b_1.json', {'people': []})
        with pytest.raises(InputError, match=message):
            read_keypoints(folder)
    write(tmp_path / 'd' / '20240101120000.json', {'people': []})
    with pytest.raises(
        InputError, match=r'000\.json: need a frame number up to 1000000000 in its'
    ):
        read_keypoints(tmp_path / 'd')
    items = [{'image_id': i, 'keypoints': PERSON} for i in (1, 2)]
    write(tmp_path / 'c' / '1.json', items)
    with pytest.raises(InputError, match='holds a whole video: give the file'):
        read_keypoints(tmp_path / 'c')


def test_folders_are_given_to_cameras_by_name_or_number(tmp_path: Path) -> None:
    """Pose2Sim calls the folder of camera cam01 cam1_json."""
    for name in ('cam1_json', 'cam2_json', 'cam10_json', 'images'):
        (tmp_path / name).mkdir()
    found = camera_paths(tmp_path, ['cam01', 'cam02', 'cam03', 'cam10'])
    assert {c: p.name for c, p in found.items()} == {
        'cam01': 'cam1_json',
        'cam02': 'cam2_json',
        'cam10': 'cam10_json',
    }
    (tmp_path / 'left.json').write_text('[]')
    assert camera_paths(tmp_path, ['left', 'right']) == {'left': tmp_path / 'left.json'}


def test_folders_that_could_be_of_either_camera_are_refused(tmp_path: Path) -> None:
    """With the option that says it."""
    for name in ('cam1_json', 'cam01_json'):
        (tmp_path / name).mkdir()
    with pytest.raises(InputError, match='both look like cam1: give each with --keypoints cam1='):
        camera_paths(tmp_path, ['cam1'])
    with pytest.raises(InputError, match=r'none belongs to cameras left.* --keypoints NAME='):
        camera_paths(tmp_path, ['left'])


@given(data=st.data())
def test_damaged_json_is_read_or_refused_in_our_words(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    """Values of another kind anywhere in the tree: never another error."""
    folder = tmp_path_factory.mktemp('damage')
    leaf = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=4)
    tree = st.recursive(leaf, lambda s: st.lists(s, max_size=3), max_leaves=6)
    keys = ['people', 'annotations', 'images', 'instance_info', 'image_id', 'keypoints', 'joints']
    keys += ['instances', 'frame_id', 'keypoint_scores', 'pose_keypoints_2d', 'id', 'meta_info']
    item = st.dictionaries(st.sampled_from(keys), tree | st.just(PERSON), max_size=4)
    items = st.lists(item, max_size=3)
    whole = item | items | st.dictionaries(st.sampled_from(keys), items, max_size=3)
    path = write(folder / 'video_1.json', data.draw(whole))
    try:
        found = read_keypoints(path)
    except InputError:
        return
    assert found.uv.shape == (len(found.frames), found.n_joints, 2)
