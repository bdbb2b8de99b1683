# SPDX-License-Identifier: Apache-2.0
"""The rig file says what it seems to say, and reads back as it was written."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from rpgd_ros.core import Camera, RigidTransform
from rpgd_ros.core.geometry import so3_exp
from rpgd_ros.core.lens import Model
from rpgd_ros.io.rig import MocapSource, Rig, RigCamera, parse_rig, read_rig, rig_text, write_rig
from rpgd_ros.skeletons import CONVENTIONS, match_joints

EXAMPLE = Path(__file__).parents[1] / 'config' / 'rigs' / 'example_rig.yaml'


@pytest.fixture
def tree() -> dict[str, Any]:
    """A small rig file as plain data, to be spoilt."""
    loaded: dict[str, Any] = yaml.safe_load(EXAMPLE.read_text())
    return loaded


def test_example_says_what_it_seems_to_say() -> None:
    """The file that users copy, read."""
    rig = read_rig(EXAMPLE)
    assert rig.world_frame == 'studio'
    assert rig.mocap == MocapSource('mocap/skeleton', CONVENTIONS['plug_in_gait'])
    first, second = rig.cameras
    assert first.name == 'cam0'
    assert first.keypoints_topic == 'cam0/keypoints'
    assert second.keypoints_topic == 'cam1/keypoints'
    assert first.camera is not None
    assert first.camera.size == (1920, 1080)
    assert first.camera.matrix[0, 2] == 960.0
    assert first.camera.distortion.tolist() == [-0.2, 0.24, 0.0, 0.0, -0.02]
    assert first.extrinsics is not None
    assert first.extrinsics.translation.tolist() == [0.0, 0.0, 5.0]
    assert second.extrinsics is not None
    np.testing.assert_allclose(second.extrinsics.inverse().translation, [4.0, 0.0, -2.0])
    assert first.camera_info_topic == ''
    assert len(first.pairs) == 12
    assert (0, 11) in first.pairs


def test_every_key_of_the_example_that_is_commented_out_is_known() -> None:
    """What the comments offer can be switched on."""
    lines = []
    for line in EXAMPLE.read_text().splitlines():
        bare = line.lstrip()
        is_offer = bare.startswith('# ') and ':' in bare.split()[1]
        is_key = is_offer and bare.split()[1].rstrip(':').replace('_', '').islower()
        lines.append(line.replace('# ', '', 1) if is_key else line)
    rig = parse_rig('\n'.join(lines))
    assert rig.mocap.frame == 'vicon'
    assert rig.mocap.type == 'sensor_msgs/msg/PointCloud2'
    assert rig.cameras[0].pairs


def test_camera_without_intrinsics_waits_for_camera_info(tree: dict[str, Any]) -> None:
    """Neither matrix nor topic: the topic beside the keypoints."""
    for key in ('size', 'matrix', 'distortion'):
        del tree['cameras'][1][key]
    camera = parse_rig(yaml.safe_dump(tree)).cameras[1]
    assert camera.camera is None
    assert camera.camera_info_topic == 'cam1/camera_info'
    assert camera.extrinsics is not None


def test_all_lens_models_are_taken(tree: dict[str, Any]) -> None:
    """OpenCV's three, in ROS's words."""
    camera = tree['cameras'][0]
    for model, n, core in (
        ('plumb_bob', 4, 'pinhole'),
        ('rational_polynomial', 8, 'pinhole'),
        ('equidistant', 4, 'equidistant'),
    ):
        camera |= {'distortion_model': model, 'distortion': [0.01] * n}
        read = parse_rig(yaml.safe_dump(tree)).cameras[0].camera
        assert read is not None
        assert (read.model, read.distortion.size) == (core, n)


def test_maps_of_mocap_and_camera_add_up(tree: dict[str, Any]) -> None:
    """A map for all cameras, overruled by that of one, under either name of a keypoint."""
    tree['mocap']['joints'] = ['a', 'b', 'c', 'd']
    tree['mocap']['joint_map'] = {'left_hip': 'a', 'right_hip': 'b', 'nose': 'c'}
    tree['cameras'][0]['keypoints'] = 'body25'
    tree['cameras'][0]['joint_map'] = {'LHip': 'd'}
    first, second = parse_rig(yaml.safe_dump(tree)).cameras
    body25, coco17 = CONVENTIONS['body25'], CONVENTIONS['coco17']
    assert {body25[k]: j for j, k in first.pairs} == {'Nose': 2, 'RHip': 1, 'LHip': 3}
    assert {coco17[k]: j for j, k in second.pairs} == {'nose': 2, 'right_hip': 1, 'left_hip': 0}


numbers = st.floats(-1e3, 1e3, allow_subnormal=False)
names = st.from_regex(r'[A-Za-z][A-Za-z0-9_]{0,8}', fullmatch=True)


@st.composite
def rig_cameras(draw: st.DrawFn, name: str, mocap_joints: tuple[str, ...]) -> RigCamera:
    """Draw a camera as files may describe it."""
    keypoints = CONVENTIONS[draw(st.sampled_from(['coco17', 'body25', 'mediapipe33']))]
    pairs = match_joints(mocap_joints, keypoints)
    if draw(st.booleans()):
        pairs = pairs[: draw(st.integers(3, len(pairs)))]
    extrinsics = None
    if draw(st.booleans()):
        turn, xyz = (draw(st.lists(numbers, min_size=3, max_size=3)) for _ in range(2))
        extrinsics = RigidTransform(so3_exp(np.array(turn) / 1e3), np.array(xyz))
    camera = None
    if draw(st.booleans()):
        f, c = draw(st.floats(100.0, 5000.0)), draw(st.floats(0.0, 4000.0))
        matrix = np.array([[f, 0.0, c], [0.0, f, c], [0.0, 0.0, 1.0]])
        n = draw(st.sampled_from([0, 4, 5, 8]))
        distortion = np.array(draw(st.lists(st.floats(-0.1, 0.1), min_size=n, max_size=n)))
        model: Model = 'equidistant' if n == 4 and draw(st.booleans()) else 'pinhole'
        camera = Camera(name, matrix, distortion, (640, 480), extrinsics, model=model)
    return RigCamera(
        name=name,
        keypoints_topic=f'{name}/kp',
        keypoint_joints=keypoints,
        pairs=pairs,
        camera=camera,
        camera_info_topic='' if camera is not None else f'{name}/info',
        frame_id='' if extrinsics is not None else draw(st.sampled_from(['', 'a_frame'])),
        units=draw(st.sampled_from(['pixels', 'normalized', 'auto'])),
        rectified=camera is None and draw(st.booleans()),
        time_offset_s=draw(st.floats(-10.0, 10.0)),
        min_confidence=draw(st.floats(0.0, 1.0)),
        extrinsics=extrinsics,
        type=draw(st.sampled_from(['', 'sensor_msgs/msg/PointCloud2'])),
    )


@st.composite
def rigs(draw: st.DrawFn) -> Rig:
    """Draw a rig as files may describe it."""
    joints = CONVENTIONS[draw(st.sampled_from(['h36m32', 'plug_in_gait', 'mpi28']))]
    mocap = MocapSource(
        topic='mocap',
        joints=joints if draw(st.booleans()) else joints[::-1],
        units=draw(st.sampled_from(['m', 'cm', 'mm', 'inch'])),
        frame=draw(st.sampled_from(['', 'vicon'])),
        time_offset_s=draw(st.floats(-1.0, 1.0)),
    )
    cameras = [
        draw(rig_cameras(name, mocap.joints))
        for name in draw(st.lists(names, min_size=1, max_size=3, unique=True))
    ]
    return Rig('world', mocap, tuple(cameras))


@settings(derandomize=True, max_examples=100, deadline=None)
@given(rigs())
def test_rig_reads_back_as_it_was_written(rig: Rig) -> None:
    """Every field, numbers to the last bit, poses to rounding."""
    read = parse_rig(rig_text(rig))
    assert read.world_frame == rig.world_frame
    assert read.mocap == rig.mocap
    for a, b in zip(read.cameras, rig.cameras, strict=True):
        for name in RigCamera.__slots__:
            if name not in {'camera', 'extrinsics'}:
                assert getattr(a, name) == getattr(b, name), name
        assert (a.extrinsics is None) == (b.extrinsics is None)
        if a.extrinsics is not None and b.extrinsics is not None:
            np.testing.assert_allclose(a.extrinsics.matrix, b.extrinsics.matrix, atol=1e-12)
        assert (a.camera is None) == (b.camera is None)
        if a.camera is not None and b.camera is not None:
            assert a.camera.matrix.tobytes() == b.camera.matrix.tobytes()
            assert a.camera.distortion.tobytes() == b.camera.distortion.tobytes()
            assert (a.camera.model, a.camera.size) == (b.camera.model, b.camera.size)


def test_rig_is_written_to_a_file(tmp_path: Path) -> None:
    """The example, written and read again; lists of numbers stay on one line."""
    rig = read_rig(EXAMPLE)
    write_rig(tmp_path / 'rig.yaml', rig)
    text = (tmp_path / 'rig.yaml').read_text()
    assert read_rig(tmp_path / 'rig.yaml').cameras[1].pairs == rig.cameras[1].pairs
    assert 'keypoints: coco17' in text
    assert 'xyz: [0.0, 0.0, 5.0]' in text


def test_pairs_that_names_do_not_tell_are_written_as_a_map() -> None:
    """A MoCap with numbers for names."""
    joints = tuple(str(j) for j in range(6))
    camera = RigCamera('c', 'c/kp', CONVENTIONS['coco17'], ((0, 5), (3, 11), (5, 16)))
    rig = Rig('w', MocapSource('m', joints), (replace(camera, camera_info_topic='c/info'),))
    assert parse_rig(rig_text(rig)).cameras[0].pairs == camera.pairs
