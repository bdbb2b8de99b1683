# SPDX-License-Identifier: Apache-2.0
"""calibrate_bag on rigs without extrinsics: what it prints, writes and refuses."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from rpgd_ros.apps import calibrate_bag, simulate
from rpgd_ros.core import RigidTransform
from rpgd_ros.core.geometry import rotation_angle
from rpgd_ros.io.camera_files import read_cameras
from rpgd_ros.io.result_file import read_result
from rpgd_ros.io.rig import read_rig


def film(folder: Path, *options: str) -> Path:
    """Simulate 12 s of a walk before four cameras."""
    output = folder / 'walk'
    given = ['--preset', 'studio', '--seconds', '12', '--output', str(output)]
    assert simulate.main([*given, *options]) == 0
    return output


@pytest.fixture(scope='module')
def blind(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a recording whose rig file has no extrinsics."""
    return film(tmp_path_factory.mktemp('blind'), '--no-extrinsics')


@pytest.fixture(scope='module')
def mixed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a recording whose rig file lacks the extrinsics of one camera."""
    return film(tmp_path_factory.mktemp('mixed'), '--no-extrinsics', 'cam2')


def calibrated(walk: Path, *options: str) -> int:
    """Run the program; return its exit code."""
    return calibrate_bag.main([str(walk / 'bag'), '--rig', str(walk / 'rig.yaml'), *options])


def truth_of(walk: Path) -> tuple[RigidTransform, dict[str, RigidTransform]]:
    """Return world_T_mocap and camera_T_world by camera."""
    tree = yaml.safe_load((walk / 'truth.yaml').read_text())
    poses = {
        name: RigidTransform.from_quat_xyzw(pose['xyz'], pose['quat_xyzw'])
        for name, pose in tree['camera_T_world'].items()
    }
    return RigidTransform.from_matrix(tree['world_T_mocap']['matrix']), poses


def assert_near(found: RigidTransform | None, truth: RigidTransform) -> None:
    """Twelve seconds of a walk before one camera: 0.1 deg and 10 mm of the camera's place."""
    assert found is not None
    apart = found.inverse() @ truth
    assert np.degrees(rotation_angle(apart.rotation)) < 0.2
    assert np.linalg.norm(apart.translation) < 0.02


def test_rig_without_extrinsics_is_printed_and_written(
    blind: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """On the terminal, in the result file, as a rig file, and as TOML."""
    result, rig, toml = (tmp_path / name for name in ('r.yaml', 'found.yaml', 'found.toml'))
    assert calibrated(blind, '--output', str(result), '--write-rig', str(rig)) == 0
    out = capsys.readouterr().out
    assert 'none: the MoCap frame is the world' in out
    assert 'placed' in out
    assert f'written to {rig}' in out
    assert calibrated(blind, '--write-rig', str(toml)) == 0
    world_T_mocap, poses = truth_of(blind)
    stored = read_result(result)
    assert stored.optical_frames['cam0'] == 'cam0_optical_frame'
    for camera in read_rig(rig).cameras:
        truth = poses[camera.name] @ world_T_mocap
        assert_near(camera.extrinsics, truth)
        assert_near(stored.camera_poses[camera.name].camera_T_world, truth)
    for other in read_cameras(toml).cameras:
        assert_near(other.camera_T_world, poses[other.name] @ world_T_mocap)


def test_written_rig_calibrates_to_the_identity(blind: Path, tmp_path: Path) -> None:
    """Its world is the MoCap frame: the next recording says whether it still is."""
    rig, result = tmp_path / 'found.yaml', tmp_path / 'r.yaml'
    assert calibrated(blind, '--write-rig', str(rig)) == 0
    options = ['--rig', str(rig), '--output', str(result)]
    assert calibrate_bag.main([str(blind / 'bag'), *options]) == 0
    assert_near(read_result(result).world_T_mocap, RigidTransform.identity())


def test_mixed_rig_keeps_its_world(
    mixed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The rig file has the placed camera in the world of the others, TOML all in the MoCap's."""
    rig, toml = tmp_path / 'found.yaml', tmp_path / 'found.toml'
    assert calibrated(mixed, '--write-rig', str(rig), '--json') == 0
    answer = json.loads(capsys.readouterr().out)
    assert list(answer['result']['camera_poses']) == ['cam2']
    assert answer['files'] == {'write_rig': str(rig)}
    assert calibrated(mixed, '--write-rig', str(toml)) == 0
    world_T_mocap, poses = truth_of(mixed)
    given = {c.name: c.extrinsics for c in read_rig(mixed / 'rig.yaml').cameras}
    for camera in read_rig(rig).cameras:
        assert_near(camera.extrinsics, poses[camera.name])
        before = given[camera.name]
        if before is not None:
            assert camera.extrinsics is not None
            np.testing.assert_allclose(camera.extrinsics.matrix, before.matrix, atol=1e-12)
    for other in read_cameras(toml).cameras:
        assert_near(other.camera_T_world, poses[other.name] @ world_T_mocap)


def test_rig_is_written_under_a_name_that_says_what_it_is(
    blind: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Said before the work, not after it."""
    assert calibrated(blind, '--write-rig', str(tmp_path / 'found.txt')) == 2
    assert 'need a name that ends in .yaml, .yml, .toml' in capsys.readouterr().err
    assert calibrated(blind, '--write-rig', str(tmp_path / 'no' / 'found.yaml')) == 2
    assert 'is no folder' in capsys.readouterr().err


def test_still_person_places_no_camera(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Refused with the reason that all cameras have; nothing is written."""
    walk = film(tmp_path, '--no-extrinsics', '--motion', 'still')
    capsys.readouterr()
    assert calibrated(walk, '--write-rig', str(tmp_path / 'found.yaml')) == 1
    said = capsys.readouterr().err
    assert 'refused (degenerate_motion): no camera could be placed' in said
    assert not (tmp_path / 'found.yaml').exists()


def test_camera_that_cannot_be_placed_stays_without_extrinsics(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The others are written, also into the report; its reason is among the warnings."""
    pytest.importorskip('plotly')
    walk = film(tmp_path, '--no-extrinsics')
    tree = yaml.safe_load((walk / 'rig.yaml').read_text())
    tree['cameras'][1]['keypoints_topic'] = 'nobody/keypoints'
    (walk / 'rig.yaml').write_text(yaml.safe_dump(tree))
    rig = tmp_path / 'found.yaml'
    assert calibrated(walk, '--write-rig', str(rig), '--report', str(tmp_path / 'r.html')) == 0
    assert 'camera cam1 could not be placed (no_data)' in capsys.readouterr().out
    assert [c.extrinsics is None for c in read_rig(rig).cameras] == [False, True, False, False]
