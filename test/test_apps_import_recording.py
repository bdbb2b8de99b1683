# SPDX-License-Identifier: Apache-2.0
"""Files of a shoot, of every format, go on to the known transform."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from camera_files import (
    camera_info_text,
    kalibr_text,
    opencv_text,
    pose_of,
    qualisys_text,
    toml_text,
)
from shoot import Shoot, assert_finds, make_shoot, run_import, words_of, write_shoot
from shoot_files import (
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

from rpgd_ros.core.camera import Camera
from rpgd_ros.core.geometry import RigidTransform, nearest_rotation, so3_exp
from rpgd_ros.importing.plan import ORDERS
from rpgd_ros.io.rig import read_rig


@pytest.fixture
def shoot() -> Shoot:
    """Return a walk before two cameras."""
    return make_shoot()


@pytest.fixture
def folder(tmp_path: Path, shoot: Shoot) -> Path:
    """Write the walk as TRC, Pose2Sim TOML and one COCO file per camera."""
    write_shoot(tmp_path, shoot)
    return tmp_path


def _trc(folder: Path, shoot: Shoot) -> dict[str, object]:
    write_trc(folder / 'a.trc', shoot.joints, shoot.x_mocap * 1000.0, units='mm')
    return {'skeleton': folder / 'a.trc'}


def _bvh(folder: Path, shoot: Shoot) -> dict[str, object]:
    write_bvh(folder / 'a.bvh', shoot.joints, shoot.x_mocap * 100.0)
    return {'skeleton': folder / 'a.bvh', 'units': 'cm'}


def _csv(folder: Path, shoot: Shoot) -> dict[str, object]:
    write_csv(folder / 'a.csv', shoot.joints, shoot.x_mocap)
    return {'skeleton': folder / 'a.csv'}


def _dates(folder: Path, shoot: Shoot) -> dict[str, object]:
    write_csv(folder / 'a.csv', shoot.joints, shoot.x_mocap, start_s=1.7e9)
    return {'skeleton': folder / 'a.csv', 'camera_start': '1700000000'}


def _c3d(folder: Path, shoot: Shoot) -> dict[str, object]:
    write_c3d(folder / 'a.c3d', shoot.joints, shoot.x_mocap * 1000.0, units='mm')
    return {'skeleton': folder / 'a.c3d'}


def _openpose(folder: Path, shoot: Shoot) -> dict[str, object]:
    for i, uv in enumerate(shoot.uv):
        write_openpose(folder / 'tree' / f'cam{i}_json', uv)
    return {'keypoints': folder / 'tree'}


def _labels(folder: Path, shoot: Shoot) -> dict[str, object]:
    for i, uv in enumerate(shoot.uv):
        write_labels(folder / f'{i}.json', uv, shoot.keypoints)
    files = [f'{c.name}={folder / f"{i}.json"}' for i, c in enumerate(shoot.cameras)]
    return {'keypoints': files, 'keypoint_joints': None}


def _alphapose(folder: Path, shoot: Shoot) -> dict[str, object]:
    for i, uv in enumerate(shoot.uv):
        write_alphapose(folder / f'{i}.json', uv)
    return {'keypoints': [f'{c.name}={folder / f"{i}.json"}' for i, c in enumerate(shoot.cameras)]}


def _mmpose(folder: Path, shoot: Shoot) -> dict[str, object]:
    for i, uv in enumerate(shoot.uv):
        write_mmpose(folder / f'{i}.json', uv, shoot.keypoints)
    files = [f'{c.name}={folder / f"{i}.json"}' for i, c in enumerate(shoot.cameras)]
    return {'keypoints': files, 'keypoint_joints': None}


def _qualisys(folder: Path, shoot: Shoot) -> dict[str, object]:
    (folder / 'walk.qca.txt').write_text(qualisys_text(shoot.cameras))
    return {'cameras': folder / 'walk.qca.txt'}


@pytest.mark.parametrize(
    'files',
    [_trc, _bvh, _csv, _dates, _c3d, _openpose, _labels, _alphapose, _mmpose, _qualisys],
)
def test_files_of_each_format_lead_to_the_known_transform(
    folder: Path, shoot: Shoot, files: Callable[[Path, Shoot], dict[str, object]]
) -> None:
    """Imported, calibrated, and compared with the truth at the body."""
    assert run_import(*words_of(folder, **files(folder, shoot))) == 0
    assert_finds(folder / 'out', shoot.world_T_mocap, shoot.x_mocap)


def test_kalibr_chain_leads_to_the_transform_into_its_first_camera(
    folder: Path, shoot: Shoot
) -> None:
    """Kalibr's world is cam0."""
    short = [replace(c, distortion=c.distortion[:4]) for c in shoot.cameras]
    (folder / 'camchain.yaml').write_text(kalibr_text(short))
    assert run_import(*words_of(folder, cameras=folder / 'camchain.yaml')) == 0
    into_first = pose_of(shoot.cameras[0]) @ shoot.world_T_mocap
    assert_finds(folder / 'out', into_first, shoot.x_mocap)


def test_axis_that_points_up_is_turned_to_z(folder: Path, shoot: Shoot) -> None:
    """A file with y up and --up y gives the frame that a file with z up gives."""
    x, y, z = np.moveaxis(shoot.x_mocap, -1, 0)
    write_trc(folder / 'y.trc', shoot.joints, np.stack([x, z, -y], -1))
    assert run_import(*words_of(folder, skeleton=folder / 'y.trc', up='y')) == 0
    assert_finds(folder / 'out', shoot.world_T_mocap, shoot.x_mocap)


def test_cameras_have_rates_and_starts_of_their_own(folder: Path, shoot: Shoot) -> None:
    """One camera at half the rate, one switched on later."""
    a, b = (c.name for c in shoot.cameras)
    write_coco(folder / 'a.json', shoot.uv[0, ::2])
    write_coco(folder / 'b.json', shoot.uv[1, 75:])
    changes = {
        'keypoints': [f'{a}={folder / "a.json"}', f'{b}={folder / "b.json"}'],
        'camera_fps': [f'{a}=25', f'{b}=50'],
        'camera_start': [f'{b}=1.5'],
    }
    assert run_import(*words_of(folder, **changes)) == 0
    assert_finds(folder / 'out', shoot.world_T_mocap, shoot.x_mocap)


@pytest.mark.parametrize('is_stated', [True, False], ids=['in the file', 'as options'])
def test_timecodes_join_what_was_started_apart(
    folder: Path, shoot: Shoot, capsys: pytest.CaptureFixture[str], *, is_stated: bool
) -> None:
    """A camera that was switched on 1.5 s late, by timecodes that drop numbers over a minute."""
    a, b = (c.name for c in shoot.cameras)
    write_coco(folder / 'b.json', shoot.uv[1, 75:])
    head = '# timecode: 10:00:59;15\n# timecode_fps: 29.97\n' if is_stated else ''
    write_csv(folder / 'a.csv', shoot.joints, shoot.x_mocap, '# units: m\n' + head)
    changes: dict[str, object] = {
        'skeleton': folder / 'a.csv',
        'keypoints': [f'{a}={folder / f"pose/{a}.json"}', f'{b}={folder / "b.json"}'],
        'camera_timecode': [f'{a}=10:00:59;15', f'{b}=10:01:01;02'],
    }
    if not is_stated:
        changes |= {'mocap_timecode': '10:00:59;15', 'timecode_fps': '29.97'}
    assert run_import(*words_of(folder, **changes)) == 0
    said = capsys.readouterr().out
    assert 'timecode    10:00:59;15 at the first frame of the skeleton, 29.97 Hz, frame n' in said
    rows = [line.split() for line in said.splitlines() if '%' in line]
    assert [row[3] for row in rows] == ['0.000', '1.502']
    assert_finds(folder / 'out', shoot.world_T_mocap, shoot.x_mocap)


def test_normalised_keypoints_are_taken_when_said_so(folder: Path, shoot: Shoot) -> None:
    """Shares of width and height; without the word they are refused."""
    (folder / 'norm').mkdir()
    for camera, uv in zip(shoot.cameras, shoot.uv, strict=True):
        write_openpose(folder / 'norm' / camera.name, uv / camera.size)
    assert run_import(*words_of(folder, keypoints=folder / 'norm')) == 2
    changes = {'keypoints': folder / 'norm', 'keypoint_units': 'normalized'}
    assert run_import(*words_of(folder, **changes)) == 0
    assert read_rig(folder / 'out/rig.yaml').cameras[0].units == 'normalized'


@pytest.mark.parametrize('calibration_text', [opencv_text, camera_info_text])
def test_kinect_and_one_video_are_calibrated_without_poses(
    tmp_path: Path, calibration_text: Callable[[Camera], str]
) -> None:
    """The publication's case: a Kinect's BVH, 2D labels of one video, chessboard intrinsics.

    The camera is the world.
    """
    shoot = make_shoot('kinect', 'coco17')
    (camera,) = shoot.cameras
    write_bvh(tmp_path / 'kinect.bvh', shoot.joints, shoot.x_mocap * 100.0)
    write_labels(tmp_path / 'video.json', shoot.uv[0], shoot.keypoints)
    (tmp_path / 'camera.yml').write_text(calibration_text(camera))
    changes = {
        'skeleton': tmp_path / 'kinect.bvh',
        'units': 'cm',
        'keypoints': tmp_path / 'video.json',
        'keypoint_joints': None,
        'cameras': tmp_path / 'camera.yml',
        'world_frame': 'camera_optical_frame',
    }
    assert run_import(*words_of(tmp_path, **changes)) == 0
    into_camera = pose_of(camera) @ shoot.world_T_mocap
    assert_finds(tmp_path / 'out', into_camera, shoot.x_mocap)


def test_pose2sim_session_leads_to_the_known_transform(
    recording: Callable[[str], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Recorded detections of four cameras; the skeleton is moved by a transform to be found."""
    data = np.load(recording('pose2sim_balancing.npz'), allow_pickle=False)
    truth = RigidTransform(so3_exp([0.3, -0.2, 1.0]), np.array([0.4, -0.6, 0.2]))
    names = [str(name) for name in data['joint_names']]
    x_mocap = truth.inverse() @ data['joints3d']
    size = (int(data['image_size'][0]), int(data['image_size'][1]))
    cameras = [
        Camera(f'cam{i + 1:02}', k, d, size, RigidTransform(nearest_rotation(r), t))
        for i, (k, d, r, t) in enumerate(
            zip(data['K'], data['dist'], data['R_c'], data['t_c'], strict=True)
        )
    ]
    (tmp_path / 'Calib_qualisys.toml').write_text(toml_text(cameras))
    write_trc(tmp_path / 'balancing.trc', names, x_mocap, fps=60.0)
    columns = [ORDERS['body25b'].index(name) for name in names]
    for i, uv in enumerate(data['keypoints2d']):
        table = np.full((len(uv), len(ORDERS['body25b']), 2), np.nan)
        table[:, columns] = uv
        write_openpose(tmp_path / 'pose' / f'cam{i + 1}_json', table)
    changes = {
        'skeleton': tmp_path / 'balancing.trc',
        'cameras': tmp_path / 'Calib_qualisys.toml',
        'camera_fps': 60,
        'keypoint_joints': 'body25b',
    }
    assert run_import(*words_of(tmp_path, **changes)) == 0
    said = capsys.readouterr().out
    assert 'aniposelib/Pose2Sim TOML: cam01, cam02, cam03, cam04' in said
    assert f'cam02       {tmp_path}/pose/cam2_json (OpenPose JSON)' in said
    assert 'cam01, cam02, cam03, cam04: Nose = Nose' in said
    assert 'keypoints without a joint: LEye, REye, LEar, REar' in said
    assert_finds(tmp_path / 'out', truth, x_mocap)
