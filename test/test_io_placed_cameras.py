# SPDX-License-Identifier: Apache-2.0
"""Cameras that were placed: in the result file, in a rig file, and for other tools."""

from __future__ import annotations

import copy
import re
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from core_cases import LENSES, camera_with
from hypothesis import given, settings
from hypothesis import strategies as st
from studio import make_rig, without_poses
from test_io_result_file import STAMP_NS, make_calibration

from rpgd_ros.core import Calibration, Camera, CameraPose, InputError, Reason, RigidTransform
from rpgd_ros.core.geometry import Array, so3_exp
from rpgd_ros.io.camera_files import parse_cameras, toml_text
from rpgd_ros.io.result_file import read_result, write_result
from rpgd_ros.io.rig import read_rig, with_poses, write_rig

numbers = st.floats(-3.0, 3.0, allow_subnormal=False)


def placed(*names: str) -> Calibration:
    """Return a calibration with cameras whose poses need all their digits."""
    rng = np.random.default_rng(5)
    poses = {}
    for name in names:
        root = rng.normal(size=(6, 6)) * 1e-3
        pose = RigidTransform(so3_exp(rng.normal(size=3)), rng.normal(size=3) * 3.0)
        poses[name] = CameraPose(pose, root @ root.T, rng.normal(size=3))
    return replace(make_calibration(), camera_poses=poses)


@pytest.fixture
def kept(tmp_path: Path) -> Path:
    """Write a result with two placed cameras, one of which names its frame."""
    path = tmp_path / 'result.yaml'
    write_result(
        path, placed('cam0', 'cam1'), world_frame='studio', mocap_frame='vicon',
        stamp_ns=STAMP_NS, optical_frames={'cam1': 'eye_optical'},
    )  # fmt: skip
    return path


def test_result_file_keeps_placed_cameras_to_the_last_bit(kept: Path) -> None:
    """Pose, covariance, the place where its sigma holds, and the name of the frame."""
    stored = read_result(kept)
    assert list(stored.camera_poses) == ['cam0', 'cam1']
    assert stored.optical_frames == {'cam0': 'cam0_optical_frame', 'cam1': 'eye_optical'}
    for name, pose in placed('cam0', 'cam1').camera_poses.items():
        read = stored.camera_poses[name]
        assert read.camera_T_world.matrix.tobytes() == pose.camera_T_world.matrix.tobytes()
        assert read.covariance.tobytes() == pose.covariance.tobytes()
        assert read.sigma_position_m == pose.sigma_position_m


def test_result_file_of_an_older_version_has_no_placed_cameras(kept: Path) -> None:
    """It reads as before."""
    tree = yaml.safe_load(kept.read_text())
    del tree['camera_poses']
    kept.write_text(yaml.safe_dump(tree))
    stored = read_result(kept)
    assert stored.camera_poses == {}
    assert stored.optical_frames == {}


@pytest.mark.parametrize(
    ('keys', 'value', 'said'),
    [
        (('cam0', 'covariance'), [[1.0]], 'camera_poses.cam0.covariance'),
        (('cam0', 'frame'), 7, 'camera_poses.cam0.frame'),
        (('cam1', 'camera_T_world', 'xyz'), [9.0, 9.0, 9.0], 'change all or none'),
        (('cam1', 'centroid_world'), [1.0], 'camera_poses.cam1.centroid_world'),
        (('cam1', 'nonsense'), 1, 'nonsense'),
    ],
)
def test_damaged_poses_are_refused_by_name(
    kept: Path, keys: tuple[str, ...], value: object, said: str
) -> None:
    """The message says where."""
    tree: dict[str, Any] = yaml.safe_load(kept.read_text())
    spoilt = copy.deepcopy(tree)
    node = spoilt['camera_poses']
    for key in keys[:-1]:
        node = node[key]
    node[keys[-1]] = value
    kept.write_text(yaml.safe_dump(spoilt))
    with pytest.raises(InputError, match=re.escape(said)) as refused:
        read_result(kept)
    assert refused.value.reason is Reason.BAD_RESULT_FILE


def test_rig_file_takes_the_poses_that_were_found(tmp_path: Path) -> None:
    """And only those: a camera that was not placed stays without, a known one as it was."""
    rig = make_rig(3)
    known = rig.cameras[2]
    blind = without_poses(rig)
    blind = replace(blind, cameras=(*blind.cameras[:2], known))
    pose = RigidTransform(so3_exp([0.1, 0.2, 0.3]), np.array([1.0, 2.0, 3.0]))
    write_rig(tmp_path / 'rig.yaml', with_poses(blind, {'cam0': pose}))
    cameras = read_rig(tmp_path / 'rig.yaml').cameras
    assert cameras[0].extrinsics is not None
    assert cameras[0].camera is not None
    assert cameras[0].camera.camera_T_world is not None
    np.testing.assert_allclose(cameras[0].extrinsics.matrix, pose.matrix, atol=1e-12)
    np.testing.assert_allclose(cameras[0].camera.camera_T_world.matrix, pose.matrix, atol=1e-12)
    assert cameras[1].extrinsics is None
    assert known.extrinsics is not None
    assert cameras[2].extrinsics is not None
    np.testing.assert_allclose(cameras[2].extrinsics.matrix, known.extrinsics.matrix, atol=1e-12)


def test_rig_file_of_a_camera_with_camera_info_takes_its_pose(tmp_path: Path) -> None:
    """The intrinsics still come from the topic."""
    rig = without_poses(make_rig(2))
    unknown = replace(rig.cameras[0], camera=None, camera_info_topic='cam0/camera_info')
    rig = replace(rig, cameras=(unknown, rig.cameras[1]))
    pose = RigidTransform(so3_exp([0.1, 0.2, 0.3]), np.array([1.0, 2.0, 3.0]))
    write_rig(tmp_path / 'rig.yaml', with_poses(rig, {'cam0': pose}))
    camera = read_rig(tmp_path / 'rig.yaml').cameras[0]
    assert camera.camera is None
    assert camera.extrinsics is not None
    np.testing.assert_allclose(camera.extrinsics.matrix, pose.matrix, atol=1e-12)


def assert_same(read: Camera, given: Camera, x: Array) -> None:
    """Compare two cameras by what they do."""
    assert (read.name, read.size, read.model) == (given.name, given.size, given.model)
    np.testing.assert_allclose(read.project(x), given.project(x), atol=1e-6)


@settings(derandomize=True, max_examples=40, deadline=None)
@given(
    st.lists(numbers, min_size=3, max_size=3),
    st.lists(numbers, min_size=3, max_size=3),
    st.sampled_from(sorted(LENSES)),
)
def test_toml_reads_back_as_the_same_camera(
    rotvec: list[float], xyz: list[float], lens: str
) -> None:
    """Whatever the lens, the rotation (half turns too) and the place."""
    pose = RigidTransform(so3_exp(rotvec), np.array(xyz))
    camera = camera_with(lens, pose)
    found = parse_cameras(toml_text([camera], 'vicon'), 'cameras.toml')
    assert 'TOML' in found.format
    x_camera = np.random.default_rng(0).uniform([-1.0, -1.0, 2.0], [1.0, 1.0, 5.0], (50, 3))
    assert_same(found.cameras[0], camera, pose.inverse() @ x_camera)


def test_toml_has_what_aniposelib_and_pose2sim_take(tmp_path: Path) -> None:
    """Their keys, at least four coefficients, and a table of metadata without a camera."""
    pose = RigidTransform(so3_exp([0.0, np.pi, 0.0]), np.array([0.0, 0.0, 4.0]))
    path = tmp_path / 'cameras.toml'
    path.write_text(toml_text([camera_with('none', pose), camera_with('fisheye', pose)], 'v"i'))
    tree = tomllib.loads(path.read_text())
    assert list(tree) == ['none', 'fisheye', 'metadata']
    assert set(tree['none']) == {
        *('name', 'size', 'matrix', 'distortions', 'rotation', 'translation', 'fisheye'),
    }
    assert tree['none']['distortions'] == [0.0] * 4
    assert tree['fisheye']['fisheye'] is True
    assert np.linalg.norm(tree['none']['rotation']) == pytest.approx(np.pi)
    assert tree['none']['translation'] == [0.0, 0.0, 4.0]


def test_camera_without_a_pose_is_not_written_to_toml() -> None:
    """A made-up place would be believed."""
    with pytest.raises(InputError, match='camera none has no pose') as refused:
        toml_text([camera_with('none')], 'vicon')
    assert refused.value.reason is Reason.NO_EXTRINSICS
