# SPDX-License-Identifier: Apache-2.0
"""Calibration files of other tools: the same cameras come out, whichever tool wrote them."""

from __future__ import annotations

from pathlib import Path

import cv2
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
from hypothesis import given
from hypothesis import strategies as st

from rpgd_ros.core.camera import Camera
from rpgd_ros.core.errors import InputError
from rpgd_ros.core.geometry import RigidTransform, so3_exp
from rpgd_ros.io.camera_files import camera_name, parse_cameras, read_cameras
from rpgd_ros.io.rig import MocapSource, Rig, RigCamera, rig_text
from rpgd_ros.skeletons import CONVENTIONS, match_joints


def make_camera(seed: int = 0, *, fisheye: bool = False, n_coefficients: int = 5) -> Camera:
    """Return a camera with a pose, drawn at random."""
    rng = np.random.default_rng(seed)
    intrinsics = np.array([[1145.5, 0, 955.25], [0, 1143.25, 541.5], [0, 0, 1.0]])
    distortion = rng.normal(0.0, 0.01, 4 if fisheye else n_coefficients)
    pose = RigidTransform(so3_exp(rng.normal(size=3)), rng.normal(0.0, 2.0, 3))
    model = 'equidistant' if fisheye else 'pinhole'
    return Camera(f'cam{seed}', intrinsics, distortion, (1920, 1080), pose, model=model)  # type: ignore[arg-type]


def assert_same(found: Camera, true: Camera, *, has_pose: bool = True) -> None:
    """Assert that two cameras see the world alike."""
    assert found.name == true.name
    assert found.size == true.size
    assert found.model == true.model
    np.testing.assert_allclose(found.matrix, true.matrix, rtol=1e-12)
    length = min(found.distortion.size, true.distortion.size)
    np.testing.assert_allclose(found.distortion[:length], true.distortion[:length], atol=1e-12)
    if has_pose:
        delta = pose_of(found) @ pose_of(true).inverse()
        np.testing.assert_allclose(delta.matrix, np.eye(4), atol=1e-9)
    else:
        assert found.camera_T_world is None


@pytest.mark.parametrize('fisheye', [False, True])
def test_toml_gives_the_cameras_back(*, fisheye: bool) -> None:
    """With names, sizes written as 1920.0, rotation vectors and metres; metadata is no camera."""
    cameras = [make_camera(seed, fisheye=fisheye) for seed in range(3)]
    found = parse_cameras(toml_text(cameras), 'Calib.toml')
    assert found.format == 'aniposelib/Pose2Sim TOML'
    for one, true in zip(found.cameras, cameras, strict=True):
        assert_same(one, true)


def test_toml_in_millimetres_is_refused_until_its_unit_is_given() -> None:
    """The format states none: a camera at 3 km is a board measured in millimetres."""
    text = toml_text([make_camera(1)], metres_per_unit=0.001)
    with pytest.raises(InputError, match=r'Calib.toml: cam_1.translation: .*--camera-units mm'):
        parse_cameras(text, 'Calib.toml')
    assert_same(parse_cameras(text, 'Calib.toml', 'mm').cameras[0], make_camera(1))


def test_qualisys_gives_the_cameras_back() -> None:
    """From millimetres, 1/64 pixels and an axis that points backwards; names from serials."""
    cameras = [make_camera(seed, n_coefficients=n) for seed, n in ((0, 4), (1, 5))]
    found = parse_cameras(qualisys_text(cameras), 'x.qca.txt')
    assert found.format == 'Qualisys calibration'
    for one, true in zip(found.cameras, cameras, strict=True):
        assert_same(one, true)


def test_qualisys_camera_that_is_switched_off_is_left_out() -> None:
    """QTM writes it with active="0"."""
    text = qualisys_text([make_camera(0), make_camera(1)])
    text = text.replace('active="1"', 'active="0"', 1)
    assert [c.name for c in parse_cameras(text, 'q').cameras] == ['cam1']


@pytest.mark.parametrize(('lines', 'scale'), [(1080, 1.0), (720, 1.5), (540, 2.0)])
def test_qualisys_camera_has_the_size_of_its_video(lines: int, scale: float) -> None:
    """QTM counts pixels of the whole sensor; at 720p the video has two thirds of them."""
    camera = make_camera(0, n_coefficients=4)
    text = qualisys_text([camera]).replace('active="1"', f'active="1" video_resolution="{lines}p"')
    (found,) = parse_cameras(text, 'x.qca.txt').cameras
    assert found.size == (1920 * lines // 1080, lines)
    np.testing.assert_allclose(found.matrix[:2], camera.matrix[:2] / scale, rtol=1e-12)
    np.testing.assert_allclose(found.distortion, camera.distortion)


def test_qualisys_camera_with_a_part_of_the_sensor_is_scaled_behind_its_corner() -> None:
    """Left and top are pixels of the sensor too."""
    camera = make_camera(0)
    text = qualisys_text([camera]).replace('active="1"', 'active="1" video_resolution="720p"')
    text = text.replace('fov_video left="0" top="0"', 'fov_video left="480" top="270"')
    (found,) = parse_cameras(text, 'x.qca.txt').cameras
    assert found.size == (960, 540)
    middle = (camera.matrix[:2, 2] - [480, 270]) / 1.5
    np.testing.assert_allclose(found.matrix[:2, 2], middle, rtol=1e-12)


def test_qualisys_marker_camera_may_be_turned() -> None:
    """It has no video that could be: the others are read; alone, it is refused as they are."""
    for cameras, names in (([make_camera(0), make_camera(1)], ['cam1']), ([make_camera(0)], [])):
        text = qualisys_text(cameras).replace('Miqus Video', 'Miqus M3', 1)
        text = text.replace('viewrotation="0"', 'viewrotation="180" video_resolution="N/A"', 1)
        if names:
            assert [c.name for c in parse_cameras(text, 'q').cameras] == names
        else:
            with pytest.raises(InputError, match="camera cam0: viewrotation '180'"):
                parse_cameras(text, 'q')


@pytest.mark.parametrize('fisheye', [False, True])
def test_kalibr_chain_becomes_poses_in_the_first_camera(*, fisheye: bool) -> None:
    """Each camera is given relative to the one before."""
    cameras = [make_camera(seed, fisheye=fisheye, n_coefficients=4) for seed in range(3)]
    found = parse_cameras(kalibr_text(cameras), 'camchain.yaml')
    assert found.format == 'Kalibr camchain'
    for one, true in zip(found.cameras, cameras, strict=True):
        expected = pose_of(true) @ pose_of(cameras[0]).inverse()
        np.testing.assert_allclose(pose_of(one).matrix, expected.matrix, atol=1e-9)
        np.testing.assert_array_equal(one.matrix, true.matrix)
        assert one.model == true.model


def test_kalibr_without_a_chain_has_the_imu_as_world() -> None:
    """As the wiki's example writes it, with coefficients that YAML takes for a text."""
    camera = """
  camera_model: pinhole
  intrinsics: [461.629, 460.152, 362.680, 246.049]
  distortion_model: radtan
  distortion_coeffs: [-0.27695497, 0.06712482, 87538e-8, 1e-05]
  T_cam_imu:
  - [0.0, 1.0, 0.0, 0.07]
  - [-1.0, 0.0, 0.0, -0.02]
  - [0.0, 0.0, 1.0, 0.004]
  - [0.0, 0.0, 0.0, 1.0]
  timeshift_cam_imu: -8.121e-05
  rostopic: /cam0/image_raw
  resolution: [752, 480]
"""
    cameras = parse_cameras(f'cam0:{camera}cam1:{camera}', 'camchain.yaml').cameras
    assert [c.name for c in cameras] == ['cam0', 'cam1']
    np.testing.assert_allclose(pose_of(cameras[1]).translation, [0.07, -0.02, 0.004])
    assert cameras[1].distortion[3] == 1e-5


def test_kalibr_with_one_camera_gives_no_pose() -> None:
    """The camera is the world itself."""
    text = kalibr_text([make_camera(0, n_coefficients=4)])
    assert parse_cameras(text, 'camchain.yaml').cameras[0].camera_T_world is None


@pytest.mark.parametrize(('fisheye', 'n'), [(False, 5), (False, 8), (True, 4)])
def test_camera_info_gives_intrinsics_without_a_pose(fisheye: bool, n: int) -> None:  # noqa: FBT001
    """A pose is no part of what ROS saves."""
    camera = make_camera(0, fisheye=fisheye, n_coefficients=n)
    found = parse_cameras(camera_info_text(camera), 'ost.yaml')
    assert found.format == 'ROS camera_info YAML'
    assert_same(found.cameras[0], camera, has_pose=False)


@pytest.mark.parametrize('fisheye', [False, True])
def test_opencv_gives_intrinsics_named_after_the_file(*, fisheye: bool) -> None:
    """The poses in it are those of the chessboard."""
    camera = make_camera(0, fisheye=fisheye)
    found = parse_cameras(opencv_text(camera), 'shoot/cam0.yml')
    assert found.format == 'OpenCV FileStorage'
    assert_same(found.cameras[0], camera, has_pose=False)


@pytest.mark.parametrize('ending', ['yml', 'xml'])
def test_file_that_opencv_itself_writes_is_read(tmp_path: Path, ending: str) -> None:
    """Whatever the version of OpenCV makes of directive, tags and digits."""
    camera = make_camera(0)
    path = tmp_path / f'cam0.{ending}'
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write('calibration_time', 'Thu 01 Jan')
    storage.write('image_width', camera.size[0])
    storage.write('image_height', camera.size[1])
    storage.write('camera_matrix', camera.matrix)
    storage.write('distortion_coefficients', camera.distortion)
    storage.release()
    found = read_cameras(path)
    assert_same(found.cameras[0], camera, has_pose=False)


def test_rig_file_is_a_calibration_too() -> None:
    """Cameras of an earlier shoot need no other form."""
    joints = CONVENTIONS['coco17']
    camera = make_camera(0)
    pairs = match_joints(joints, joints)
    source = RigCamera(
        camera.name,
        'k',
        joints,
        pairs,
        camera=camera,
        extrinsics=camera.camera_T_world,
    )
    rig = Rig('world', MocapSource('mocap/skeleton', joints), (source,))
    found = parse_cameras(rig_text(rig), 'rig.yaml')
    assert found.format == 'rig file'
    assert_same(found.cameras[0], camera)


@given(seed=st.integers(0, 2**16))
def test_projection_survives_every_format_with_poses(seed: int) -> None:
    """What counts in the end: the pixels."""
    camera = make_camera(seed, n_coefficients=4)
    x_camera = np.array([[0.1, -0.2, 3.0], [0.5, 0.3, 5.0]])
    x_world = pose_of(camera).inverse() @ x_camera
    for text in (toml_text([camera]), qualisys_text([camera])):
        (found,) = parse_cameras(text, 'calibration').cameras
        np.testing.assert_allclose(found.project(x_world), camera.project(x_world), atol=1e-6)


@pytest.mark.parametrize(
    ('text', 'name'),
    [('cam01', 'cam01'), ('26580', 'cam_26580'), ('Kamera 1', 'Kamera_1'), ('_x', 'cam__x')],
)
def test_names_become_fit_for_topics(text: str, name: str) -> None:
    """Serial numbers and blanks are common."""
    assert camera_name(text) == name
