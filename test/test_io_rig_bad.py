# SPDX-License-Identifier: Apache-2.0
"""What is wrong in a rig file is refused, naming file, key and remedy."""

from __future__ import annotations

import copy
import time
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from rpgd_ros.core import InputError, Reason
from rpgd_ros.io.rig import parse_rig, read_rig

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
    ('cameras[1].distortion_model', 'rational_polynomial', r'\.distortion: need 8 numbers'),
    ('cameras[0].name', 'mocap', r'name: mocap is the name of the other stream'),
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


@pytest.mark.fault(23)
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
    'python object': ('a: !!python/object/apply:os.system [true]', r'line 1: tags \('),
    'custom tag': (
        'b: 1\na: !thing 1',
        r"line 2: tags \('!thing'\) are not taken: write the plain",
    ),
    'tag of a number': ('a: !!int ""', r'line 1: tags \(.*:int'),
    'tag of a sign': ('a: !!float "-"', r'line 1: tags \(.*:float'),
    'tag of a truth': ('a: !!bool x', r'line 1: tags \(.*:bool'),
    'tag of a time': ('a: !!timestamp x', r'line 1: tags \(.*:timestamp'),
    'tag of a list': ('a: !!set [1]', r'line 1: tags \(.*:set'),
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


@pytest.mark.threat('S2')
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


@pytest.mark.fault(23)
@settings(derandomize=True, max_examples=200, deadline=None)
@given(st.text(max_size=200) | st.binary(max_size=100).map(lambda b: b.decode('latin-1')))
def test_any_text_is_refused_in_our_words(text: str) -> None:
    """No text of a file raises anything but our error."""
    with pytest.raises(InputError):
        parse_rig(text)


@pytest.mark.fault(23)
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


def test_lens_model_without_its_numbers_is_refused(tree: dict[str, Any]) -> None:
    """Eight coefficients have no default."""
    del tree['cameras'][1]['distortion']
    tree['cameras'][1]['distortion_model'] = 'rational_polynomial'
    with pytest.raises(InputError, match='rational_polynomial needs distortion: 8 numbers'):
        parse_rig(yaml.safe_dump(tree))
