# SPDX-License-Identifier: Apache-2.0
"""Results are kept to the last bit, read strictly, and never lost."""

from __future__ import annotations

import copy
import math
import os
import re
import shlex
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from rpgd_ros.core import (
    Calibration,
    CalibrationConfig,
    GroupFit,
    InputError,
    Reason,
    RigidTransform,
)
from rpgd_ros.core.geometry import rotation_from_euler_zyx, so3_exp
from rpgd_ros.io.result_file import backups, read_result, result_text, write_result

STAMP_NS = 1_769_860_800_123_456_789  # 2026-01-31T12:00:00.123Z


def make_calibration(seed: int = 0) -> Calibration:
    """Return a calibration with numbers that need all their digits."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(6, 6)) * 1e-3
    fit = GroupFit('cam0', 900, 880, 3.25, 3.0, (0.5, -0.25))
    blind = GroupFit('cam1', 0, 0, math.nan, math.nan, (math.nan, math.nan))
    return Calibration(
        world_T_mocap=RigidTransform(so3_exp(rng.normal(size=3)), rng.normal(size=3) * 3.0),
        covariance=root @ root.T,
        mpjpe_px=3.25,
        median_px=2.5,
        p95_px=9.0,
        inlier_ratio=880 / 900,
        inliers=880,
        correspondences=900,
        frames=90,
        threshold_px=12.0,
        centroid_mocap=rng.normal(size=3),
        per_camera={'cam0': fit, 'cam1': blind},
        per_joint={'left_hip': fit, '7': fit},
        config=CalibrationConfig.paper(),
        time_offset_s={'cam0': (0.0412, 0.0003)},
        warnings=('cam1 saw nobody: is it on?', 'größer als sonst'),
        seconds=0.25,
    )


def save(path: Path, calibration: Calibration | None = None, stamp_ns: int = STAMP_NS) -> None:
    """Write a result with usual frames."""
    write_result(
        path,
        calibration or make_calibration(),
        world_frame='studio',
        mocap_frame='vicon',
        stamp_ns=stamp_ns,
    )


@settings(derandomize=True, max_examples=50, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_result_reads_back_to_the_last_bit(
    tmp_path_factory: pytest.TempPathFactory, seed: int
) -> None:
    """What is republished at the next start is what was published."""
    path = tmp_path_factory.mktemp('results') / 'result.yaml'
    calibration = make_calibration(seed)
    save(path, calibration)
    stored = read_result(path)
    pose = calibration.world_T_mocap
    assert stored.world_T_mocap.matrix.tobytes() == pose.matrix.tobytes()
    assert stored.covariance.tobytes() == calibration.covariance.tobytes()


def test_result_says_what_was_found(tmp_path: Path) -> None:
    """Frames, time, errors, sigma, offsets, warnings."""
    path = tmp_path / 'result.yaml'
    calibration = make_calibration()
    save(path)
    stored = read_result(path)
    assert (stored.world_frame, stored.mocap_frame) == ('studio', 'vicon')
    assert stored.stamp_ns == STAMP_NS
    assert stored.mpjpe_px == 3.25
    assert stored.inlier_ratio == 880 / 900
    assert stored.sigma_rotation_deg == calibration.sigma_rotation_deg
    assert stored.sigma_position_m == calibration.sigma_position_m
    assert stored.camera_mpjpe_px['cam0'] == 3.25
    assert math.isnan(stored.camera_mpjpe_px['cam1'])
    assert stored.time_offset_s == {'cam0': (0.0412, 0.0003)}
    assert stored.warnings == calibration.warnings
    tree = yaml.safe_load(path.read_text())
    assert tree['found'] == '2026-01-31T12:00:00.123Z'
    assert 'x_world = world_T_mocap @ x_mocap' in tree['convention']
    assert tree['parameters']['ransac']['threshold_px'] == 12.0
    assert set(tree['versions']) == {'rpgd_ros', 'python', 'numpy', 'opencv'}
    assert tree['joints']['left_hip']['bias_px'] == [0.5, -0.25]


def test_other_tools_are_given_the_same_transform() -> None:
    """The command line, the URDF line and vicon_receiver's parameters carry one pose."""
    calibration = make_calibration()
    text = result_text(calibration, world_frame='a b', mocap_frame='vicon', stamp_ns=0)
    tools = yaml.safe_load(text)['for_other_tools']
    words = shlex.split(tools['static_transform_publisher'])
    assert words[:4] == ['ros2', 'run', 'tf2_ros', 'static_transform_publisher']
    options = dict(zip(words[4::2], words[5::2], strict=True))
    assert (options['--frame-id'], options['--child-frame-id']) == ('a b', 'vicon')
    xyz = [float(options[f'--{name}']) for name in 'xyz']
    quat = [float(options[f'--q{name}']) for name in 'xyzw']
    expected = calibration.world_T_mocap.matrix
    np.testing.assert_allclose(RigidTransform.from_quat_xyzw(xyz, quat).matrix, expected)
    rpy = [float(v) for v in re.findall(r'rpy="([^"]*)"', tools['urdf_origin'])[0].split()]
    np.testing.assert_allclose(rotation_from_euler_zyx(rpy), expected[:3, :3], atol=1e-12)
    assert tools['vicon_receiver']['map_xyz'] == xyz
    assert tools['vicon_receiver']['map_rpy'] == rpy


def test_old_result_becomes_a_dated_backup(tmp_path: Path) -> None:
    """The file as it was, under the date at which it was written."""
    path = tmp_path / 'node[1].yaml'
    save(path, make_calibration(1))
    old = path.read_bytes()
    os.utime(path, ns=(STAMP_NS, STAMP_NS))
    save(path, make_calibration(2))
    (backup,) = backups(path)
    assert backup.name == 'node[1].20260131T120000.123.yaml'
    assert backup.read_bytes() == old
    read_result(backup)
    assert path.read_bytes() != old


def test_backups_are_limited_to_the_newest(tmp_path: Path) -> None:
    """A node that calibrates every ten seconds does not fill the disk."""
    path = tmp_path / 'result.yaml'
    other = tmp_path / 'result.mine.yaml'
    other.touch()
    for second in range(15):
        save(path)
        os.utime(path, ns=(STAMP_NS + second * 10**9,) * 2)
    save(path)
    found = backups(path)
    assert len(found) == 10
    assert found[0].name == 'result.20260131T120014.123.yaml'
    assert found[-1].name == 'result.20260131T120005.123.yaml'
    assert other.exists()


def test_newest_backup_stays_where_the_clock_was_set_back(tmp_path: Path) -> None:
    """Ten that claim to be of the future give way to it, one by one."""
    path = tmp_path / 'result.yaml'
    for day in range(10):
        (tmp_path / f'result.2099010{day}T000000.000.yaml').touch()
    for second in range(3):
        save(path, make_calibration(second))
        os.utime(path, ns=(STAMP_NS + second * 10**9,) * 2)
        old = path.read_bytes()
    save(path)
    found = backups(path)
    assert len(found) == 10
    assert found[-1].name == 'result.20260131T120002.123.yaml'
    assert found[-1].read_bytes() == old


@pytest.mark.fault(25)
def test_several_savers_leave_one_whole_result(tmp_path: Path) -> None:
    """Node and service may save at once; every read is a whole result."""
    path = tmp_path / 'result.yaml'
    save(path)
    failures: list[InputError] = []

    def write(seed: int) -> None:
        for _ in range(10):
            try:
                save(path, make_calibration(seed))
                read_result(path)
            except InputError as error:
                failures.append(error)

    threads = [threading.Thread(target=write, args=(seed,)) for seed in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failures == []
    assert not [p for p in tmp_path.iterdir() if p.suffix == '.tmp']


def test_result_that_cannot_be_written_is_said(tmp_path: Path) -> None:
    """No folder, or a link in place of the file; nothing changes."""
    with pytest.raises(InputError, match='No such file or directory') as refused:
        save(tmp_path / 'gone' / 'result.yaml')
    assert refused.value.reason is Reason.NOT_WRITABLE
    (tmp_path / 'folder.yaml').mkdir()
    with pytest.raises(InputError, match='cannot be read for a backup'):
        save(tmp_path / 'folder.yaml')
    real, link = tmp_path / 'real.yaml', tmp_path / 'link.yaml'
    save(real)
    before = real.read_bytes()
    link.symlink_to(real)
    with pytest.raises(InputError, match='symbolic link'):
        save(link)
    assert real.read_bytes() == before


@pytest.fixture(scope='module')
def tree() -> dict[str, Any]:
    """A result file as plain data, to be spoilt."""
    text = result_text(make_calibration(), world_frame='w', mocap_frame='m', stamp_ns=STAMP_NS)
    loaded: dict[str, Any] = yaml.safe_load(text)
    return loaded


def spoil(tree: dict[str, Any], path: str, value: object) -> str:
    """Return the text with one value replaced, added, or (`...`) removed."""
    spoilt = copy.deepcopy(tree)
    steps = [int(s) if s.isdigit() else s for s in path.split('.')]
    target: Any = spoilt
    for step in steps[:-1]:
        target = target[step]
    if value is ...:
        del target[steps[-1]]
    else:
        target[steps[-1]] = value
    return yaml.safe_dump(spoilt, allow_unicode=True)


@pytest.mark.fault(23)
@pytest.mark.parametrize(
    ('path', 'value', 'message'),
    [
        ('schema', 2, 'schema: schema 2 is unknown, this version reads 1'),
        ('world_T_mocap', ..., 'world_T_mocap is missing'),
        ('world_T_mocap.matrix', ..., r'world_T_mocap: matrix is missing'),
        ('world_T_mocap.matrix', [[1, 0, 0, 0]], r'matrix: need 4 rows of 4'),
        ('world_T_mocap.matrix.3', [0, 0, 0, 2], r'matrix: need 4 rows of 4'),
        ('world_T_mocap.matrix.0.0', float('nan'), r'matrix\[0\]\[0\]: need a finite number'),
        ('world_T_mocap.matrix.0', [2.0, 0, 0, 0], r'world_T_mocap: rotation is not orthonormal'),
        ('world_T_mocap.xyz.0', 77.0, 'xyz and quat_xyzw differ from matrix by'),
        ('world_T_mocap.quat_xyzw', [0, 0, 0, 0], 'quaternion'),
        (
            'world_T_mocap.quat_wxyz',
            [1, 0, 0, 0],
            r'unknown key .quat_wxyz., did you mean quat_xyz',
        ),
        ('covariance', [[1.0]], r'covariance\[0\]: need 6 numbers, got 1'),
        ('covariance.0.1', 5.0, 'covariance: need 6 rows of 6 numbers, symmetric'),
        ('covariance.2.2', -1.0, 'not negative on the diagonal'),
        ('stamp_ns', 1.5, 'stamp_ns: need an integer'),
        ('mpjpe_px', None, 'mpjpe_px: need a number, got None'),
        ('inlier_ratio', 1.5, r'inlier_ratio: 1\.5 is outside 0 to 1'),
        ('cameras.cam0.mpjpe_px', -1.0, r'cameras\.cam0\.mpjpe_px: -1 is outside'),
        ('time_offset_s.cam0', [0.1], r'time_offset_s\.cam0: need 2 numbers'),
        ('covarianse', [], r'unknown key .covarianse., did you mean covariance\?'),
    ],
)
def test_bad_result_is_refused_with_file_and_key(
    tree: dict[str, Any], tmp_path: Path, path: str, value: object, message: str
) -> None:
    """Nothing is guessed, and no default stands in for a missing value."""
    file = tmp_path / 'result.yaml'
    file.write_text(spoil(tree, path, value))
    with pytest.raises(InputError, match=message) as refused:
        read_result(file)
    assert refused.value.reason is Reason.BAD_RESULT_FILE
    assert refused.value.message.startswith(str(file))


def test_what_is_only_for_people_may_be_missing(tree: dict[str, Any], tmp_path: Path) -> None:
    """A file cut down to the transform and its sigma is enough to start from."""
    spoilt = copy.deepcopy(tree)
    for key in ('convention', 'found', 'joints', 'parameters', 'versions', 'for_other_tools'):
        del spoilt[key]
    del spoilt['warnings'], spoilt['time_offset_s']
    (tmp_path / 'r.yaml').write_text(yaml.safe_dump(spoilt))
    stored = read_result(tmp_path / 'r.yaml')
    assert stored.warnings == ()
    assert stored.time_offset_s == {}


@pytest.mark.fault(23)
@pytest.mark.parametrize('text', ['', 'a: [', '&x [*x]', '!!python/name:os.system', '\x00', '[]'])
def test_text_that_is_no_result_is_refused(tmp_path: Path, text: str) -> None:
    """Hostile or cut text ends in a plain message."""
    (tmp_path / 'r.yaml').write_text(text)
    with pytest.raises(InputError) as refused:
        read_result(tmp_path / 'r.yaml')
    assert refused.value.reason is Reason.BAD_RESULT_FILE


@pytest.mark.fault(23)
def test_every_cut_of_a_result_is_refused(tmp_path: Path) -> None:
    """A file that ends early is never taken for a whole one."""
    text = result_text(make_calibration(), world_frame='w', mocap_frame='m', stamp_ns=STAMP_NS)
    end = text.index('cameras:')
    for cut in range(0, end, 37):
        (tmp_path / 'r.yaml').write_text(text[:cut])
        with pytest.raises(InputError):
            read_result(tmp_path / 'r.yaml')


def test_numbers_of_numpy_are_written_as_numbers(tmp_path: Path) -> None:
    """Counts and errors that come as numpy scalars read as any other."""
    numbers: dict[str, Any] = {'inliers': np.int64(880), 'mpjpe_px': np.float64(3.25)}
    calibration = replace(make_calibration(), **numbers)
    save(tmp_path / 'r.yaml', calibration)
    assert read_result(tmp_path / 'r.yaml').mpjpe_px == 3.25
