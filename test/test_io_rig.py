# SPDX-License-Identifier: Apache-2.0
"""The rig file is read strictly, and every complaint names file, key and remedy."""

from __future__ import annotations

import copy
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from rpgd_ros.core import Camera, InputError, Reason, RigidTransform
from rpgd_ros.core.camera import Model
from rpgd_ros.core.geometry import so3_exp
from rpgd_ros.io.rig import MocapSource, Rig, RigCamera, parse_rig, read_rig, rig_text, write_rig
from rpgd_ros.skeletons import CONVENTIONS, match_joints

EXAMPLE = Path(__file__).parents[1] / 'config' / 'rigs' / 'example_rig.yaml'


@pytest.fixture
def tree() -> dict[str, Any]:
    """A small rig file as plain data, to be spoilt."""
    loaded: dict[str, Any] = yaml.safe_load(EXAMPLE.read_text())
    return loaded


def spoil(tree: dict[str, Any], path: str, value: object) -> dict[str, Any]:
    """Return a copy with one value replaced, added, or (`...`) removed; path as in messages."""
    spoilt = copy.deepcopy(tree)
    steps = [
        int(s) if s.isdigit() else s for s in path.replace('[', '.').replace(']', '').split('.')
    ]
    target: Any = spoilt
    for step in steps[:-1]:
        target = target[step]
    if value is ...:
        del target[steps[-1]]
    else:
        target[steps[-1]] = value
    return spoilt


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


BAD_VALUES: list[tuple[str, object, str]] = [
    ('schema', 2, r'schema: schema 2 is unknown, this version reads 1'),
    ('schema', '1', r"schema: need an integer, got '1'"),
    ('world_frame', ..., r'world_frame is missing'),
    ('world_frame', '/studio', r"world_frame: need a frame name, got '/studio'"),
    ('world_frame', False, r'world_frame: need a text, got False'),
    ('word_frame', 'x', r"unknown key 'word_frame', did you mean world_frame\?"),
    ('mocap', [], r'mocap: need a mapping, got \[\]'),
    (
        'mocap.joints',
        'coco_17',
        r"mocap\.joints: unknown convention 'coco_17', did you mean coco17\?",
    ),
    ('mocap.joints', ['a', 'b', 'b'], r"mocap\.joints: joint 'b' comes twice"),
    ('mocap.joints', ['a', 'b', False], r'mocap\.joints: joint 2 is False'),
    ('mocap.unit', 'mm', r"mocap: unknown key 'unit', did you mean units\?"),
    ('mocap.units', 'inches', r"mocap\.units: 'inches' is unknown, did you mean inch\?"),
    ('mocap.frame', 'studio', r"mocap\.frame: 'studio' is also world_frame"),
    ('mocap.topic', 'my topic', r"mocap\.topic: need a topic, got 'my topic'"),
    ('mocap.type', 'sensor_msgs/PointCloud2', r'mocap\.type: .* did you mean sensor_msgs/msg/Poi'),
    ('mocap.joint_map', {'left_hop': 'LHipJC'}, r"'left_hop', did you mean left_hip\?"),
    ('mocap.joint_map', {7: 'LHipJC'}, r'mocap\.joint_map: key 7 is no text'),
    ('cameras', [], r'cameras: need 1 to 128 cameras, got 0'),
    ('cameras', {'cam0': 1}, r'cameras: need a list'),
    ('cameras[0].name', '0cam', r"cameras\[0\]\.name: need a letter, .* got '0cam'"),
    ('cameras[1].name', 'cam0', r'cameras\[1\]: camera cam0 comes twice'),
    (
        'cameras[1].keypoints_topic',
        'cam0/keypoints',
        r'cameras\[1\]: topic .* also that of camera',
    ),
    ('cameras[0].keypoints', ['x', 'y', 'z'], r'cameras\[0\]\.keypoints: 0 joints .* need 3'),
    (
        'cameras[0].joint_map',
        {'left_hip': 'LHip'},
        r"joint_map: no MoCap joint 'LHip', did you mean LHipJC\?",
    ),
    ('cameras[0].joint_map', {'left_hip': 3}, r'cameras\[0\]\.joint_map\.left_hip: need a text'),
    ('cameras[0].matrix', [1, 2, 3], r'cameras\[0\]\.matrix: need 9 numbers, got 3'),
    ('cameras[0].matrix', [1145, 2, 960, 0, 1145, 540, 0, 0, 1], r'no skew'),
    (
        'cameras[0].matrix[0]',
        '1e400',
        r"cameras\[0\]\.matrix\[0\]: need a number, got the text '1e400'",
    ),
    ('cameras[0].matrix[0]', float('nan'), r'cameras\[0\]\.matrix\[0\]: need a finite number'),
    ('cameras[0].matrix[0]', 10**400, r'cameras\[0\]\.matrix\[0\]: need a finite number'),
    ('cameras[0].matrix[0]', True, r'cameras\[0\]\.matrix\[0\]: need a number, got True'),
    ('cameras[0].matrix[0]', -1145.0, r'focal lengths must be positive'),
    ('cameras[0].size', [1920], r'cameras\[0\]\.size: need \[width, height\], got 1'),
    ('cameras[0].size[0]', 1920.5, r'cameras\[0\]\.size\[0\]: need an integer, got 1920\.5'),
    (
        'cameras[0].distortion',
        [0.1, 0.2],
        r'cameras\[0\]\.distortion: need 0 or 4 or 5 numbers, got 2',
    ),
    ('cameras[0].distortion_model', 'fisheye', r'distortion_model: .fisheye. is unknown'),
    ('cameras[0].rectified', True, r'cameras\[0\]: rectified keypoints have no distortion'),
    ('cameras[0].rectified', 'yes', r"cameras\[0\]\.rectified: need true or false, got 'yes'"),
    ('cameras[0].camera_T_world.quat_xyzw', [0, 0, 0, 0], r'quat_xyzw: need a quaternion .* is 0'),
    ('cameras[0].camera_T_world.xyz', [0, 0], r'camera_T_world\.xyz: need 3 numbers, got 2'),
    ('cameras[0].camera_T_world.rpy', [0, 0, 0], r"camera_T_world: unknown key 'rpy'"),
    (
        'cameras[0].world_T_camera',
        {'xyz': [0, 0, 0], 'quat_xyzw': [0, 0, 0, 1]},
        r'need at most one',
    ),
    ('cameras[0].frame_id', 'cam0_optical_frame', r'camera_T_world and frame_id are given'),
    ('cameras[0].camera_T_word', {}, r'did you mean camera_T_world\?'),
    ('cameras[0].time_offset', float('inf'), r'cameras\[0\]\.time_offset: need a finite number'),
    ('cameras[0].min_confidence', -0.1, r'cameras\[0\]\.min_confidence: -0\.1 is outside 0 to'),
    (
        'cameras[0].units',
        'pixel',
        r"cameras\[0\]\.units: 'pixel' is unknown, did you mean pixels\?",
    ),
]


@pytest.mark.parametrize(('path', 'value', 'message'), BAD_VALUES)
def test_bad_value_is_named_with_file_and_key(
    tree: dict[str, Any], tmp_path: Path, path: str, value: object, message: str
) -> None:
    """Each complaint says where, what was found, and what is needed."""
    file = tmp_path / 'my_rig.yaml'
    file.write_text(yaml.safe_dump(spoil(tree, path, value)))
    with pytest.raises(InputError, match=message) as refused:
        read_rig(file)
    assert refused.value.reason is Reason.BAD_RIG
    assert refused.value.message.startswith(f'{file}: ')


@pytest.mark.parametrize(
    'given', [('size',), ('distortion',), ('matrix',), ('size', 'distortion')]
)
def test_half_of_the_intrinsics_is_missing_intrinsics(
    tree: dict[str, Any], given: tuple[str, ...]
) -> None:
    """No default stands in for the other half."""
    camera = tree['cameras'][1]
    for key in {'size', 'matrix', 'distortion'} - set(given):
        del camera[key]
    with pytest.raises(InputError, match=r'cameras\[1\]: .* without') as refused:
        parse_rig(yaml.safe_dump(tree))
    assert refused.value.reason is Reason.MISSING_INTRINSICS


HOSTILE = {
    'empty': ('', 'is empty'),
    'only a comment': ('# nothing', 'is empty'),
    'a list': ('[1, 2]', r'need a mapping, got \[1, 2\]'),
    'a text': ('just words', 'need a mapping'),
    'not YAML': ('a: [1, 2', r'is not YAML: line \d, column'),
    'tabs': ('a:\n\t- b', 'is not YAML'),
    'python object': ('a: !!python/object/apply:os.system [true]', 'is not YAML'),
    'custom tag': ('a: !thing 1', 'is not YAML'),
    'alias': ('a: &x [1]\nb: *x', r'line 2: aliases \(\*x\)'),
    'billion laughs': (
        'a: &a [x,x]\n' + ''.join(f'b{i}: &b{i} [*a,*a]\n' for i in range(9)),
        'aliases',
    ),
    'merge key': ('a: &x {b: 1}\nc:\n  <<: *x', 'aliases'),
    'key twice': ('schema: 1\nworld_frame: a\nschema: 1', "key 'schema' is given twice"),
    'deep lists': ('[' * 100_000, 'nested too deeply'),
    'deep mappings': ('{a: ' * 5000, 'nested too deeply'),
    'impossible date': ('schema: 2024-99-99', 'impossible value'),
    'two documents': ('a: 1\n---\nb: 2', 'is not YAML'),
    'long number': ('schema: ' + '1' * 100_000, 'too large'),
    'sexagesimal bomb': ('schema: 1' + ':59' * 100_000, 'too large'),
    'many entries': ('a: [' + '1,' * 200_000 + ']', 'too large'),
    'unhashable key': ('? [1, 2]\n: 3', 'is not YAML|unknown key'),
    'control character': ('a: \x00', 'is not YAML'),
    'other schema': ('schema: 7\nworld_frame: a\nmocap: {}\ncameras: []', 'schema 7 is unknown'),
}


@pytest.mark.parametrize('name', HOSTILE)
def test_hostile_text_ends_quickly_in_a_plain_message(name: str) -> None:
    """Nothing is run, nothing grows, nothing else is raised."""
    text, message = HOSTILE[name]
    start = time.perf_counter()
    with pytest.raises(InputError, match=message) as refused:
        parse_rig(text, 'bad.yaml')
    assert time.perf_counter() - start < 2.0  # 0.1 s on an idle core; CI shares its cores
    assert refused.value.reason is Reason.BAD_RIG
    assert refused.value.message.startswith('bad.yaml')
    assert len(refused.value.message) < 1000


def test_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    """Missing, a folder, too large, or no text."""
    (tmp_path / 'large.yaml').write_bytes(b'#' * (2**20 + 1))
    (tmp_path / 'latin.yaml').write_bytes(b'a: \xff')
    for name, message in (
        ('gone.yaml', 'cannot be read: No such file'),
        ('.', 'cannot be read: Is a directory'),
        ('large.yaml', 'more than 1048576 bytes'),
        ('latin.yaml', r'is not UTF-8 text \(byte 3\)'),
    ):
        with pytest.raises(InputError, match=message) as refused:
            read_rig(tmp_path / name)
        assert refused.value.reason is Reason.BAD_RIG


@settings(derandomize=True, max_examples=200, deadline=None)
@given(st.text(max_size=200) | st.binary(max_size=100).map(lambda b: b.decode('latin-1')))
def test_any_text_is_refused_in_our_words(text: str) -> None:
    """No text of a file raises anything but our error."""
    with pytest.raises(InputError):
        parse_rig(text)


@settings(derandomize=True, max_examples=200, deadline=None)
@given(data=st.data())
def test_any_damage_to_a_value_is_refused_or_read(data: st.DataObject) -> None:
    """A value of any type at any place gives a rig or our error."""
    paths = [path for path, value, _ in BAD_VALUES if value is not ...]
    leaf = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8)
    value = data.draw(
        leaf | st.lists(leaf, max_size=9) | st.dictionaries(st.text(max_size=5), leaf, max_size=3)
    )
    tree = yaml.safe_load(EXAMPLE.read_text())
    path = data.draw(st.sampled_from(paths))
    try:
        rig = parse_rig(yaml.safe_dump(spoil(tree, path, value), allow_unicode=True))
    except InputError:
        return
    assert rig.cameras


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
