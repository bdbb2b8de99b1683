# SPDX-License-Identifier: Apache-2.0
"""The reader of Human3.6M: camera parameters, units, selection, and what it refuses."""

from __future__ import annotations

import shutil
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from dataset_trees import residuals_px, write_tree

from rpgd_ros.core.errors import InputError
from rpgd_ros.core.geometry import rotation_from_quat_xyzw
from rpgd_ros.datasets import Human36m, files, open_dataset
from rpgd_ros.datasets.human36m import W0_LENGTH, read_cameras, rotation_from_angles
from rpgd_ros.simulation.dataset_writers import euler_xyz

# S1's first camera as published: three angles, place in millimetres; f, c, k, p.
PLACE = [1841.10702775, 4955.28462345, 1563.4453959]
LENS = [1145.0494, 1143.7811, 512.5415, 515.4515, -0.2071, 0.2478, -0.0031, -0.00098, -0.00142]


@pytest.fixture(scope='module')
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Simulate a small tree once."""
    pytest.importorskip('cdflib')
    return write_tree('human36m', tmp_path_factory.mktemp('h36m') / 'tree')


def metadata(path: Path, w0: list[float]) -> Path:
    """Write camera parameters among what else the file holds."""
    numbers = ' '.join(str(value) for value in w0)
    path.write_text(f'<?xml version="1.0"?><x><y>1</y><w0>[{numbers}]</w0></x>')
    return path


def test_published_camera_is_read(tmp_path: Path) -> None:
    """Subject, camera and order of the 300 numbers; place and lens in our units and order."""
    w0 = np.tile([0.1, 0.2, 0.3, 1.0, 2.0, 3.0], 44).tolist() + LENS * 4
    second_of_s5 = 6 * (11 + 4)  # the cameras are the outer loop, the subjects the inner
    w0[second_of_s5 : second_of_s5 + 6] = [1.0, -0.5, 2.0, *PLACE]
    cameras = read_cameras(metadata(tmp_path / 'metadata.xml', w0), 5)
    assert [c.name for c in cameras] == ['54138969', '55011271', '58860488', '60457274']
    assert [c.size[1] for c in cameras] == [1002, 1000, 1000, 1002]
    camera = cameras[1]
    assert camera.camera_T_world is not None
    np.testing.assert_allclose(
        camera.camera_T_world @ (np.array(PLACE) / 1000.0), np.zeros(3), atol=1e-12
    )
    np.testing.assert_allclose(camera.distortion, [-0.2071, 0.2478, -0.00098, -0.00142, -0.0031])
    np.testing.assert_allclose(camera.pinhole, LENS[:4])


def test_angles_turn_about_x_then_y_then_z_of_the_moving_axes() -> None:
    """X(a) Y(b) Z(c): each factor by itself, and the order by a product of quarter turns."""
    quarter = np.pi / 2
    np.testing.assert_allclose(
        rotation_from_angles(np.array([quarter, 0, 0])) @ [0, 1, 0], [0, 0, 1], atol=1e-12
    )
    np.testing.assert_allclose(
        rotation_from_angles(np.array([quarter, quarter, 0])) @ [0, 0, 1], [1, 0, 0], atol=1e-12
    )
    np.testing.assert_allclose(
        rotation_from_angles(np.array([0, quarter, quarter])) @ [1, 0, 0], [0, 1, 0], atol=1e-12
    )


def test_angles_of_the_twins_are_those_of_the_reader() -> None:
    """Any rotation comes back."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        rotation = rotation_from_quat_xyzw(rng.standard_normal(4))
        angles = np.array(euler_xyz(rotation))
        np.testing.assert_allclose(rotation_from_angles(angles), rotation, atol=1e-12)


def test_twin_agrees_with_its_cameras(tree: Path) -> None:
    """At the dataset's own pose the mean residual is the published one, by an own projection."""
    dataset = open_dataset('human36m', tree)
    assert dataset.names == ('S1/Directions', 'S5/Directions')
    for name in dataset.names:
        sequence = dataset.read(name)
        assert (len(sequence.cameras), sequence.observations.n_joints) == (4, 32)
        assert residuals_px(sequence).mean() == pytest.approx(1.2299, abs=1e-3)


def test_published_selection_keeps_to_its_subjects(tree: Path, tmp_path: Path) -> None:
    """S2 is none of them; _ALL files are no sequences of their own."""
    folder = shutil.copytree(tree, tmp_path / 'tree')
    (folder / 'S5').rename(folder / 'S2')
    d3 = folder / 'S1/MyPoseFeatures/D3_Positions'
    shutil.copy(d3 / 'Directions.cdf', d3 / '_ALL 1.cdf')
    assert Human36m.open(folder).names == ('S1/Directions', 'S2/Directions')
    assert Human36m.open(folder, is_published=True).names == ('S1/Directions',)


def test_action_whose_name_cannot_be_printed_is_refused(tmp_path: Path) -> None:
    """It would be the name of a sequence, in tables and messages."""
    folder = tmp_path / 'S1/MyPoseFeatures/D3_Positions'
    folder.mkdir(parents=True)
    (folder / 'Walking\udcff.cdf').touch()
    with pytest.raises(InputError, match='is no name of a sequence'):
        Human36m.open(tmp_path)


def test_damaged_and_missing_cdf_files_are_named(tree: Path, tmp_path: Path) -> None:
    """Cut, flipped, replaced, gone: our error with the path."""
    folder = shutil.copytree(tree, tmp_path / 'tree')
    d2 = folder / 'S1/MyPoseFeatures/D2_Positions'
    one, other = d2 / 'Directions.54138969.cdf', d2 / 'Directions.55011271.cdf'
    whole = one.read_bytes()
    rng = np.random.default_rng(1)
    complaints = []
    for trial in range(20):
        flipped = bytearray(whole[: rng.integers(1, len(whole))] if trial % 2 else whole)
        flipped[rng.integers(0, min(len(flipped), 1200))] ^= 0xFF
        one.write_bytes(flipped)
        try:
            Human36m.open(folder).read('S1/Directions')
        except InputError as error:
            complaints.append(str(error))
    assert all('Directions.54138969.cdf' in complaint for complaint in complaints)
    shutil.copy(folder / 'S1/MyPoseFeatures/D3_Positions/Directions.cdf', one)
    with pytest.raises(InputError, match=r'54138969\.cdf: Pose must be \(1, T, 64\)'):
        Human36m.open(folder).read('S1/Directions')
    one.write_bytes(whole)
    other.unlink()
    with pytest.raises(InputError, match=r'55011271\.cdf: cannot be read'):
        Human36m.open(folder).read('S1/Directions')


def hanging(whole: bytes) -> bytes:
    """Return a CDF file with one flipped bit: a list of records that leads back to itself."""
    return whole[:376] + bytes([whole[376] ^ 0x40]) + whole[377:]


def bomb(_whole: bytes) -> bytes:
    """Return a compressed CDF file, of zeros: half a megabyte that unpack to 512."""
    data = zlib.compressobj(9, wbits=31)
    packed = b''.join(data.compress(bytes(2**20)) for _ in range(512)) + data.flush()
    size = 32 + len(packed)
    head = struct.pack('>QiQQi', size, 10, 8 + size, 2**29, 0) + packed
    parameters = struct.pack('>Qiiiii', 28, 11, 5, 0, 1, 6)
    return bytes.fromhex('cdf30001cccc0001') + head + parameters


@pytest.mark.threat('S1')
@pytest.mark.parametrize(
    ('damaged', 'message'),
    [
        (hanging, 'cannot be read as a CDF file with a variable Pose within 3 s'),
        (bomb, r'it would take more than \d+ MiB of memory'),
    ],
)
def test_cdf_file_that_hangs_or_fills_its_reader_is_refused(
    damaged: Callable[[bytes], bytes],
    message: str,
    tree: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Within a time and a memory that belong to its size."""
    folder = shutil.copytree(tree, tmp_path / 'tree')
    path = folder / 'S1/MyPoseFeatures/D3_Positions/Directions.cdf'
    path.write_bytes(damaged(path.read_bytes()))
    if damaged is hanging:
        monkeypatch.setattr(files, 'START_SECONDS', 2.5)
    with pytest.raises(InputError, match=message) as caught:
        Human36m.open(folder).read('S1/Directions')
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('<w0>[1 2 3]</w0>', f'w0: need {W0_LENGTH} finite numbers, found 3'),
        ('<w0>[1 two]</w0>', 'w0: need numbers'),
        ('<w1>[1]</w1>', 'no element w0'),
        (f'<w0>[{"nan " * W0_LENGTH}]</w0>', 'w0: need 300 finite numbers'),
    ],
)
def test_bad_camera_parameters_are_refused(text: str, message: str, tmp_path: Path) -> None:
    """With the path."""
    path = tmp_path / 'metadata.xml'
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_cameras(path, 1)


def test_missing_camera_parameters_are_named(tree: Path, tmp_path: Path) -> None:
    """They belong to another archive, which is easily forgotten."""
    folder = shutil.copytree(tree, tmp_path / 'tree')
    (folder / 'metadata.xml').unlink()
    with pytest.raises(InputError, match=r'metadata\.xml: cannot be read'):
        Human36m.open(folder).read('S1/Directions')
