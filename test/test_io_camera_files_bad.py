# SPDX-License-Identifier: Apache-2.0
"""Calibration files that cannot be used: file, key, and what to do."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
import yaml
from camera_files import camera_info_text, kalibr_text, opencv_text, qualisys_text, toml_text
from hypothesis import given
from hypothesis import strategies as st
from test_io_camera_files import make_camera

from rpgd_ros.core.errors import InputError
from rpgd_ros.importing.text import shown as shown_in_import
from rpgd_ros.io.camera_files import parse_cameras, read_cameras
from rpgd_ros.io.strict import shown

CAMERA = make_camera(0, n_coefficients=4)
TEXTS = {
    'toml': toml_text([CAMERA]),
    'qualisys': qualisys_text([CAMERA]),
    'kalibr': kalibr_text([CAMERA, make_camera(1, n_coefficients=4)]),
    'camera_info': camera_info_text(CAMERA),
    'opencv': opencv_text(CAMERA),
}

WITHOUT_LENSES = """
schema: 1
world_frame: room
mocap: {joints: h36m17}
cameras: [{name: cam0, keypoints: coco17}]
"""


@pytest.mark.parametrize(
    ('kind', 'old', 'new', 'message'),
    [
        ('toml', 'rotation = ', 'turn = ', r'file: cam_1: rotation is missing'),
        ('toml', 'size = [ 1920.0', 'size = [ 1920.5', r'cam_1.size\[0\]: need a whole number'),
        ('toml', 'matrix = [[1145.5, 0.0', 'matrix = [[1145.5, 2.0', r'cam_1.matrix: .*no skew'),
        ('toml', 'matrix = [[1145.5,', 'matrix = [[', r'cam_1.matrix: need a matrix of 3 x 3'),
        ('toml', 'translation = [', 'translation = [1.0, ', r'translation: need 3 numbers, got 4'),
        ('toml', '[cam_1]', '[cam_1', 'file is not'),
        ('toml', 'matrix = [[1145.5', 'matrix = [[nan', r'cam_1.matrix.* need a finite number'),
        (
            'toml',
            'distortions = [',
            'distortions = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11,',
            'at most 14',
        ),
        ('toml', 'size = [ 1920.0, ', 'size = [ ', r'cam_1.size: need .width, height., got 1'),
        (
            'toml',
            'translation = [',
            'translation = [1e300, 0.0, 0.0]\nt = [',
            r'0\]: 1e\+300 is no',
        ),
        (
            'toml',
            'rotation = [',
            'rotation = [1e300, 0.0, 0.0]\nr = [',
            r'rotation\[0\]: 1e\+300 is',
        ),
        ('toml', 'size = ', 'size.a.a = 1\ns = ', r'cam_1.size: need a list, got .*a'),
        ('kalibr', '    - 1.0\n', '    - 2.0\n', r'T_cn_cnm1: the last row must be 0 0 0 1'),
        ('qualisys', 'r22="-0', 'r22="-9', r'camera cam0.transform: no rotation'),
        ('qualisys', 'focalLengthU', 'focalU', r'camera cam0.intrinsic: focalLengthU is missing'),
        ('qualisys', 'viewrotation="0"', 'viewrotation="90"', r'viewrotation .* Turn the view'),
        (
            'qualisys',
            'active="1"',
            'active="1" video_resolution="4K"',
            r"camera cam0: video_resolution '4K' is unknown, need 1080p",
        ),
        ('qualisys', '<fov_video', '<fov', r'camera cam0: <fov_video> is missing'),
        ('qualisys', 'active="1"', 'active="0"', r'need 1 to 128 active cameras, got 0'),
        ('qualisys', '<calibration', '<!DOCTYPE x><calibration', 'with a DOCTYPE is not taken'),
        ('qualisys', '</calibration>', '', 'file is not XML'),
        ('kalibr', 'T_cn_cnm1', 'T', r'cam1: T_cn_cnm1 is missing'),
        ('kalibr', 'radtan', 'fov', r"cam0.distortion_model: 'fov' is unknown"),
        ('kalibr', 'pinhole', 'omni', r"cam0.camera_model: 'omni' is not taken: calibrate with"),
        ('kalibr', '  resolution', '  size', r'cam0: resolution is missing'),
        ('camera_info', 'rows: 3', 'rows: 4', r'camera_matrix: need a matrix of 3 x 3 .* 4 x 3'),
        ('camera_info', 'plumb_bob', 'plumbob', r'distortion_model: .*did you mean plumb_bob'),
        ('camera_info', 'image_width: 1920', 'image_width: 0', r'image_width: need a whole'),
        ('camera_info', 'image_width: 1920', 'binning_x: 2', r'binned images'),
        ('opencv', 'image_width', 'w', r'file: image_width is missing; it has'),
        ('opencv', 'data: [', 'data: [ x,', r'camera_matrix.data\[0\]: need a number'),
    ],
)
def test_fault_is_named_with_file_and_key(kind: str, old: str, new: str, message: str) -> None:
    """One thing wrong in an otherwise good file."""
    assert old in TEXTS[kind]
    with pytest.raises(InputError, match=message) as refused:
        parse_cameras(TEXTS[kind].replace(old, new), 'file')
    assert refused.value.message.startswith('file')


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('', 'is empty'),
        ('a: 1', 'no known calibration; known are ROS camera_info YAML, Kalibr'),
        ('[1, 2]', 'no known calibration'),
        ('[section]\nkey = 1\n', r'section: matrix is missing|no camera'),
        ('[metadata]\nkey = 1\n', r'no camera: need tables such as \[cam_1\]'),
        (WITHOUT_LENSES, 'the rig file gives no intrinsics'),
        ('<a/>', r'need <calibration> .QTM. or <opencv_storage>, got <a>'),
        (
            '<opencv_storage><K/></opencv_storage>',
            'distortion_coefficients is missing',
        ),
        ('<a>' * 100_000, 'is not XML'),
        ('a: &x [1]\nb: *x', 'aliases'),
        ('cam0: !!python/object/apply:os.system [ls]', r'line 1: tags \('),
        ('[' * 5000, 'nested too deeply|not YAML|not TOML'),
    ],
)
def test_text_of_another_kind_is_refused(text: str, message: str) -> None:
    """With the formats that are known, and without running or growing anything."""
    with pytest.raises(InputError, match=message):
        parse_cameras(text, 'file')


@pytest.mark.parametrize('key', ['a.' * 20_000, 'a . ' * 40, '"a".' * 40, "'a=b'." * 40])
def test_key_of_many_parts_is_refused_quickly(key: str) -> None:
    """The library takes the square of their number."""
    start = time.perf_counter()
    for text in (f'[a]\nx = 1\n{key}b = 1\n', f'[a]\nx = 1\n[{key}b]\n'):
        with pytest.raises(InputError, match='file: line 3: a key of more than 32 parts'):
            parse_cameras(text, 'file')
    assert time.perf_counter() - start < 2.0


@pytest.mark.parametrize('text', ['"' * 10**5, 'a' * 10**6, "'" * 10**5, '"\\' * 10**5, 'a.' * 30])
def test_long_text_without_long_keys_is_searched_quickly(text: str) -> None:
    """The search for such keys takes no square of anything either."""
    start = time.perf_counter()
    with pytest.raises(InputError, match='file'):
        parse_cameras(f'[a]\nb = 1\n{text}', 'file')
    assert time.perf_counter() - start < 2.0


def test_value_that_nests_too_deeply_to_be_shown_is_refused() -> None:
    """The complaint about it says so instead of ending in another error."""
    nested: object = 1
    for _ in range(100_000):
        nested = [nested]
    for show in (shown, shown_in_import):
        assert show({'a': nested}) == 'a dict that is nested too deeply'


def test_rotation_of_left_handed_axes_is_refused() -> None:
    """A mirrored rig would be found nowhere; the message asks for what may be wrong."""
    tree = yaml.safe_load(TEXTS['kalibr'])
    first_row = tree['cam1']['T_cn_cnm1'][0]
    tree['cam1']['T_cn_cnm1'][0] = [-value for value in first_row]
    with pytest.raises(InputError, match=r'T_cn_cnm1: .* mirror image: are the axes left-handed'):
        parse_cameras(yaml.safe_dump(tree), 'file')


def test_unit_for_a_format_that_has_one_is_refused() -> None:
    """Millimetres are millimetres in a QTM file."""
    with pytest.raises(InputError, match='has its own unit: leave --camera-units out'):
        parse_cameras(TEXTS['qualisys'], 'file', 'mm')


def test_two_cameras_of_one_name_are_refused() -> None:
    """Keypoints could belong to either."""
    with pytest.raises(InputError, match='camera cam0 comes twice'):
        parse_cameras(toml_text([CAMERA, CAMERA]), 'file')


def _nothing(_path: Path) -> None:
    pass


def _binary(path: Path) -> None:
    path.write_bytes(b'\xff\xfe\x00')


def _large(path: Path) -> None:
    path.write_bytes(b' ' * (2**20 + 1))


@pytest.mark.parametrize(
    ('make', 'message'),
    [
        (_nothing, 'cannot be read: No such file'),
        (Path.mkdir, 'cannot be read: Is a directory'),
        (_binary, 'is not UTF-8 text'),
        (_large, 'is it a calibration file'),
    ],
)
def test_file_that_cannot_be_read_is_said(
    tmp_path: Path, make: Callable[[Path], None], message: str
) -> None:
    """With the words of the operating system where it has some."""
    make(tmp_path / 'calibration')
    with pytest.raises(InputError, match=message):
        read_cameras(tmp_path / 'calibration')


@given(kind=st.sampled_from(sorted(TEXTS)), data=st.data())
def test_damaged_file_is_read_or_refused_in_our_words(kind: str, data: st.DataObject) -> None:
    """Cut, and with characters exchanged: never another error."""
    text = TEXTS[kind]
    start = data.draw(st.integers(0, len(text)))
    length = data.draw(st.integers(0, 40))
    text = text[:start] + data.draw(st.text(max_size=8)) + text[start + length :]
    with suppress(InputError):
        parse_cameras(text, 'file')
