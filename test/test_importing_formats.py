# SPDX-License-Identifier: Apache-2.0
"""What every format has to refuse: a wrong unit, a missing joint, a wrong frame rate."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from shoot import CAMERA_FPS, Shoot, make_shoot
from shoot_files import (
    MOCAP_FPS,
    write_alphapose,
    write_bvh,
    write_c3d,
    write_coco,
    write_csv,
    write_labels,
    write_mmpose,
    write_openpose,
    write_trc,
)

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import Array
from rpgd_ros.importing import Detections, Skeleton, plan_camera, read_keypoints, settle
from rpgd_ros.importing.skeleton_files import read_skeleton

FRAMES = 330  # of 400: no rate makes the video as long as the skeleton


def write_skeleton(kind: str, path: Path, joints: Any, x: Array, fps: float = MOCAP_FPS) -> None:
    """Write positions that are called metres, where the format calls them anything."""
    if kind == 'bvh':
        write_bvh(path, joints, x, fps)
    elif kind == 'csv':
        write_csv(path, joints, x, f'# units: m\n# fps: {fps:g}\n', fps)
    else:
        {'trc': write_trc, 'c3d': write_c3d}[kind](path, joints, x, units='m', fps=fps)


def write_keypoints(kind: str, path: Path, uv: Array) -> None:
    """Write keypoints as a tool does."""
    names = make_shoot().keypoints
    writers: dict[str, Callable[[], None]] = {
        'openpose': lambda: write_openpose(path, uv),
        'coco': lambda: write_coco(path, uv),
        'labels': lambda: write_labels(path, uv, names),
        'alphapose': lambda: write_alphapose(path, uv),
        'mmpose': lambda: write_mmpose(path, uv, names),
    }
    writers[kind]()


SKELETONS = ('trc', 'bvh', 'csv', 'c3d')
KEYPOINTS = ('openpose', 'coco', 'labels', 'alphapose', 'mmpose')


@pytest.fixture(scope='module')
def shoot() -> Shoot:
    """Return a walk before two cameras."""
    return make_shoot()


@pytest.fixture(scope='module')
def skeleton(shoot: Shoot, tmp_path_factory: pytest.TempPathFactory) -> Skeleton:
    """Return what the MoCap saw of it."""
    path = tmp_path_factory.mktemp('mocap') / 'walk.trc'
    write_trc(path, shoot.joints, shoot.x_mocap)
    return settle(read_skeleton(path))


@pytest.fixture(scope='module')
def video(shoot: Shoot, tmp_path_factory: pytest.TempPathFactory) -> Detections:
    """Return what the first camera saw of it."""
    path = tmp_path_factory.mktemp('video') / 'video.json'
    write_coco(path, shoot.uv[0, :FRAMES])
    return read_keypoints(path)


def plan(shoot: Shoot, skeleton: Skeleton, found: Detections, fps: float = CAMERA_FPS) -> None:
    """Put the video of the first camera beside a skeleton."""
    plan_camera(skeleton, shoot.cameras[0], found, joints=shoot.keypoints, fps=fps)


@pytest.mark.parametrize(
    ('kind', 'asked', 'message'),
    [
        ('trc', None, ':3: with the unit m that the file states .* give --units mm'),
        ('csv', None, ':1: with the unit m that the file states .* give --units mm'),
        ('c3d', None, ': with the unit m that the file states .* give --units mm'),
        ('bvh', None, ': BVH states no unit.* give --units .*would be that large in mm'),
        ('bvh', 'm', ': with --units m the body spans .* give --units mm'),
    ],
)
def test_wrong_unit_of_a_skeleton_is_refused(
    tmp_path: Path, shoot: Shoot, kind: str, asked: str | None, message: str
) -> None:
    """Millimetres that are called metres: file, line where there is one, and what to do."""
    path = tmp_path / f'walk.{kind}'
    write_skeleton(kind, path, shoot.joints, 1000.0 * shoot.x_mocap[:50])
    with pytest.raises(InputError, match=f'walk.{kind}{message}') as refused:
        settle(read_skeleton(path), units=asked)
    assert refused.value.reason is Reason.WRONG_UNIT


@pytest.mark.parametrize(
    ('kind', 'place'), [('trc', ':4'), ('bvh', ':2'), ('csv', ':3'), ('c3d', '')]
)
def test_missing_joints_of_a_skeleton_are_refused(
    tmp_path: Path, shoot: Shoot, video: Detections, kind: str, place: str
) -> None:
    """Two that the detector knows: both files, the line of the names, and the option."""
    names = [*shoot.joints[:2], *(f'Marker {j}' for j in range(2, len(shoot.joints)))]
    path = tmp_path / f'walk.{kind}'
    write_skeleton(kind, path, names, shoot.x_mocap[:50])
    skeleton = settle(read_skeleton(path), units='m')
    message = f'walk.{kind}{place}, .*video.json: 2 joints .*need 3.*--joint-map KEYPOINT=JOINT'
    with pytest.raises(InputError, match=message):
        plan(shoot, skeleton, video)


@pytest.mark.parametrize(
    ('kind', 'place'), [('trc', ':3'), ('bvh', r':\d+'), ('csv', ':2'), ('c3d', '')]
)
def test_wrong_rate_of_a_skeleton_is_refused(
    tmp_path: Path, shoot: Shoot, video: Detections, kind: str, place: str
) -> None:
    """Half of the true one, without any other statement in the file: the motion tells."""
    path = tmp_path / f'walk.{kind}'
    write_skeleton(kind, path, shoot.joints, shoot.x_mocap, 0.5 * MOCAP_FPS)
    skeleton = settle(read_skeleton(path), units='m')
    message = (
        'video.json: at 50 Hz the motion of camera cam0 is not that of the skeleton, at 25 Hz it '
        rf'is: .*or --mocap-fps 100, if the rate of .*walk\.{kind}{place} is wrong'
    )
    with pytest.raises(InputError, match=message):
        plan(shoot, skeleton, video)
    plan(shoot, settle(read_skeleton(path, 100.0), units='m', fps=100.0), video)


@pytest.mark.parametrize('kind', KEYPOINTS)
def test_wrong_unit_of_keypoints_is_refused(
    tmp_path: Path, shoot: Shoot, skeleton: Skeleton, kind: str
) -> None:
    """Shares of the image that are called pixels: the file, and the option."""
    write_keypoints(kind, tmp_path / 'video', shoot.uv[0, :20] / shoot.cameras[0].size)
    found = read_keypoints(tmp_path / 'video')
    message = 'video: the keypoints lie within 0 to 1: give --keypoint-units normalized'
    with pytest.raises(InputError, match=message) as refused:
        plan(shoot, skeleton, found)
    assert refused.value.reason is Reason.WRONG_UNIT


def shorten(tree: Any) -> bool:
    """Take the last keypoint off the first person in a JSON tree."""
    if isinstance(tree, dict) and 'keypoint_scores' in tree:
        tree['keypoint_scores'].pop()
        tree['keypoints'].pop()
        return True
    for key, value in tree.items() if isinstance(tree, dict) else enumerate(tree):
        if key in {'keypoints', 'pose_keypoints_2d'} and not isinstance(value[0], str):
            del value[-3:]
            return True
        if isinstance(value, dict | list) and shorten(value):
            return True
    return False


@pytest.mark.parametrize('kind', KEYPOINTS)
def test_missing_keypoint_is_refused(tmp_path: Path, shoot: Shoot, kind: str) -> None:
    """In one frame of several: the file, the frame, and what is needed."""
    path = tmp_path / 'video'
    write_keypoints(kind, path, shoot.uv[0, :3])
    frame, file = (2, path / 'video_000000000002_keypoints.json') if path.is_dir() else (0, path)
    tree = json.loads(file.read_text())
    assert shorten(tree)
    file.write_text(json.dumps(tree))
    found, before = (16, 17) if frame else (17, 16)
    message = f'frame {frame or 1} has {found} keypoints, those before {before}: one model'
    with pytest.raises(InputError, match=message) as refused:
        read_keypoints(path)
    assert refused.value.message.startswith(f'{file}: ')


@pytest.mark.parametrize('kind', KEYPOINTS)
def test_wrong_rate_of_a_video_is_refused(
    tmp_path: Path, shoot: Shoot, skeleton: Skeleton, kind: str
) -> None:
    """Which no such file states: the motion of the skeleton tells."""
    write_keypoints(kind, tmp_path / 'video', shoot.uv[0, :FRAMES])
    found = read_keypoints(tmp_path / 'video')
    message = r'video: at 25 Hz the motion of camera cam0 is not .* give --camera-fps cam0=50 \(or'
    with pytest.raises(InputError, match=message):
        plan(shoot, skeleton, found, 25.0)
    plan(shoot, skeleton, found)


def test_rate_that_was_said_to_be_right_is_only_warned_of(
    shoot: Shoot, skeleton: Skeleton, video: Detections
) -> None:
    """With the start of the camera."""
    found = plan_camera(
        skeleton, shoot.cameras[0], video, joints=shoot.keypoints, fps=25.0, start_s=0.0
    )
    assert 'at 25 Hz the motion of camera cam0 is not that of the skeleton' in found.warnings[0]


@pytest.mark.parametrize('second', range(1, 7))
def test_right_rate_is_taken_wherever_the_camera_began(
    shoot: Shoot, skeleton: Skeleton, video: Detections, second: int
) -> None:
    """A start that nobody told, and a part of the walk."""
    uv = shoot.uv[second % 2, 10 * second : 10 * second + 300]
    found = Detections(
        video.path, video.format, np.arange(300), uv, np.ones(uv.shape[:2]), None, 0, 0, 0
    )
    plan_camera(skeleton, shoot.cameras[second % 2], found, joints=shoot.keypoints, fps=CAMERA_FPS)


def test_motion_of_somebody_else_does_not_make_a_rate_wrong(
    shoot: Shoot, skeleton: Skeleton, video: Detections
) -> None:
    """It fits at no rate: nothing is said."""
    uv = shoot.uv[0, FRAMES::-1]
    found = Detections(
        video.path, video.format, np.arange(len(uv)), uv, np.ones(uv.shape[:2]), None, 0, 0, 0
    )
    plan(shoot, skeleton, found, 60.0)
