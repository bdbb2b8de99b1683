# SPDX-License-Identifier: Apache-2.0
"""The reader of MPI-INF-3DHP: calibration text, the rebuilt frame, and what it refuses."""

from __future__ import annotations

import shutil
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dataset_trees import residuals_px, write_tree

from rpgd_ros.core.errors import InputError
from rpgd_ros.datasets import MpiInf3dhp, open_dataset
from rpgd_ros.datasets.mpi_inf_3dhp import read_cameras

# An entry in the words of the dataset: seven digits, blanks at the ends of lines.
ENTRY = """\
name          {number}
  sensor      10 10
  size        2048 2048
  animated    0
  intrinsic   1497.693 0 1024.704 0 0 1497.103 1051.394 0 0 0 1 0 0 0 0 1 
  extrinsic   0.9650164 0.00488022 0.262144 -562.8666 -0.004488356 -0.9993728 0.0351275 \
1398.138 0.262151 -0.03507521 -0.9643893 3852.623 0 0 0 1 
  radial      0
"""  # noqa: W291
HEADER = 'Skeletool Camera Calibration File V1.0\n'


@pytest.fixture(scope='module')
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Simulate a small tree once."""
    pytest.importorskip('scipy')
    return write_tree('mpi_inf_3dhp', tmp_path_factory.mktemp('mpi') / 'tree')


def calibration(path: Path, *, change: tuple[str, str] = ('', ''), n_cameras: int = 14) -> Path:
    """Write a calibration of equal cameras, the first of them changed."""
    entries = [ENTRY.format(number=number) for number in range(n_cameras)]
    entries[0] = entries[0].replace(*change) if change[0] else entries[0]
    path.write_text(HEADER + ''.join(entries))
    return path


def test_calibration_in_the_words_of_the_dataset_is_read(tmp_path: Path) -> None:
    """Seven digits of a rotation are enough; millimetres become metres."""
    cameras = read_cameras(calibration(tmp_path / 'camera.calibration'))
    assert [camera.name for camera in cameras] == [str(number) for number in range(14)]
    camera = cameras[0]
    assert camera.size == (2048, 2048)
    assert camera.camera_T_world is not None
    np.testing.assert_allclose(camera.camera_T_world.translation, [-0.5628666, 1.398138, 3.852623])
    assert camera.camera_T_world.rotation[0, 2] == pytest.approx(0.262144, abs=1e-6)
    np.testing.assert_allclose(camera.pinhole, [1497.693, 1497.103, 1024.704, 1051.394])


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        (('extrinsic', 'extrinsics'), 'need extrinsic with 16 values'),
        (('0.9650164', '0.8650164'), "camera '0': the rotation is none"),
        (('0.9650164', 'one'), 'extrinsic: need numbers'),
        (('1497.693 0 ', '1497.693 '), 'need intrinsic with 16 values'),
        (('animated    0', 'animated    1'), 'moving or distorting cameras'),
        (('radial      0', 'radial      0.1'), 'moving or distorting cameras'),
        (('2048 2048', '0 2048'), 'image size must be positive'),
    ],
)
def test_bad_calibration_is_refused(change: tuple[str, str], message: str, tmp_path: Path) -> None:
    """With path, camera and line."""
    with pytest.raises(InputError, match=message) as caught:
        read_cameras(calibration(tmp_path / 'camera.calibration', change=change))
    assert 'camera.calibration' in str(caught.value)


def test_other_files_are_no_calibration(tmp_path: Path) -> None:
    """Header and number of cameras are checked."""
    path = calibration(tmp_path / 'camera.calibration', n_cameras=13)
    with pytest.raises(InputError, match='need 14 cameras of 7 lines, found 91 lines'):
        read_cameras(path)
    for text in ('', 'name 0\n'):
        path.write_text(text)
        with pytest.raises(InputError, match='the first line must be'):
            read_cameras(path)


def test_folder_whose_name_cannot_be_printed_is_refused(tmp_path: Path) -> None:
    """It would be the name of a sequence, in tables and messages."""
    for name in ('Seq\udcff', 'Seq\x1b[31m'):
        folder = tmp_path / f'{len(name)}' / 'S1' / name
        folder.mkdir(parents=True)
        (folder / 'annot.mat').touch()
        with pytest.raises(InputError, match='is no name of a sequence'):
            MpiInf3dhp.open(tmp_path / f'{len(name)}')


@pytest.mark.filterwarnings('error')
def test_rotation_of_huge_numbers_is_refused_without_a_warning(tmp_path: Path) -> None:
    """Their products are beyond the range of numbers."""
    path = calibration(tmp_path / 'camera.calibration', change=('0.9650164', '1e308'))
    with pytest.raises(InputError, match='the rotation is none'):
        read_cameras(path)


def test_twin_agrees_with_its_cameras(tree: Path) -> None:
    """At the rebuilt pose the mean residual is the published one, by an own projection."""
    dataset = open_dataset('mpi_inf_3dhp', tree)
    assert dataset.names == ('S1/Seq1', 'S1/Seq2')
    for name in dataset.names:
        sequence = dataset.read(name)
        assert (len(sequence.cameras), sequence.observations.n_joints) == (14, 28)
        assert residuals_px(sequence).mean() == pytest.approx(0.1607, abs=1e-4)


def test_frame_is_rebuilt_from_the_first_camera_alone(tree: Path, tmp_path: Path) -> None:
    """That is the stated rule: other cameras' skeletons do not matter."""
    scipy_io: Any = pytest.importorskip('scipy.io')
    folder = shutil.copytree(tree, tmp_path / 'tree')
    path = folder / 'S1/Seq1/annot.mat'
    before = MpiInf3dhp.open(folder).read('S1/Seq1')
    kept = ('annot2', 'annot3')
    arrays = {name: scipy_io.loadmat(path)[name] for name in kept}
    for cell in arrays['annot3'][1:]:
        cell[0] = cell[0] + 1000.0
    scipy_io.savemat(path, arrays)
    after = MpiInf3dhp.open(folder).read('S1/Seq1')
    np.testing.assert_array_equal(
        before.observations.views[5].x_mocap, after.observations.views[5].x_mocap
    )


def changed(arrays: dict[str, Any], what: str) -> dict[str, Any]:
    """Return annotations with one fault."""
    if what == 'no annot3':
        return {'annot2': arrays['annot2']}
    if what == 'other cameras':
        return arrays | {'annot2': arrays['annot2'][:8]}
    if what == 'no cells':
        return arrays | {'annot2': np.zeros((14, 1))}
    if what == 'other joints':
        arrays['annot3'][0, 0] = arrays['annot3'][0, 0][:, :51]
    elif what == 'other frames':
        arrays['annot2'][3, 0] = arrays['annot2'][3, 0][:7]
    elif what == 'words':
        arrays['annot2'][3, 0] = 'words'
    return arrays


@pytest.mark.parametrize(
    ('what', 'message'),
    [
        ('no annot3', 'no variable annot3'),
        ('other cameras', 'annot2 must have 14 cells, found 8'),
        ('no cells', 'annot2 must have 14 cells'),
        ('other joints', r'annot3 must hold numbers \(T, 84\), found \(50, 51\)'),
        ('other frames', 'annot2: 7 frames, but annot3 has 50'),
        ('words', r'annot2 must hold numbers'),
    ],
)
def test_other_annotations_are_refused(
    what: str, message: str, tree: Path, tmp_path: Path
) -> None:
    """With the path and what was found."""
    scipy_io: Any = pytest.importorskip('scipy.io')
    folder = shutil.copytree(tree, tmp_path / 'tree')
    path = folder / 'S1/Seq1/annot.mat'
    found = scipy_io.loadmat(path)
    arrays = {name: found[name] for name in ('annot2', 'annot3')}
    scipy_io.savemat(path, changed(arrays, what))
    with pytest.raises(InputError, match=message) as caught:
        MpiInf3dhp.open(folder).read('S1/Seq1')
    assert 'annot.mat' in str(caught.value)


def test_damaged_annotations_are_named(tree: Path, tmp_path: Path) -> None:
    """Cut and flipped files, and files of another kind: our error, or numbers."""
    folder = shutil.copytree(tree, tmp_path / 'tree')
    path = folder / 'S1/Seq1/annot.mat'
    whole = path.read_bytes()
    rng = np.random.default_rng(2)
    complaints = []
    for trial in range(12):
        bad = bytearray(whole[: rng.integers(0, len(whole))] if trial % 2 else whole)
        if bad:
            bad[rng.integers(0, min(len(bad), 600))] ^= 0xFF
        path.write_bytes(bad)
        try:
            MpiInf3dhp.open(folder).read('S1/Seq1')
        except InputError as error:
            complaints.append(str(error))
    assert all('annot.mat' in complaint for complaint in complaints)
    path.unlink()
    with pytest.raises(InputError, match='no sequence'):
        MpiInf3dhp.open(folder).read('S1/Seq1')


def element(kind: int, body: bytes) -> bytes:
    """Return a data element of a MATLAB file."""
    return struct.pack('<II', kind, len(body)) + body + bytes(-len(body) % 8)


def nested(depth: int) -> bytes:
    """Return annot2 as a cell in a cell in a cell ..."""
    heads, size = [], 0
    for level in range(depth):
        name = b'annot2' if level == depth - 1 else b''
        cell = struct.pack('<II', 1, 0), struct.pack('<ii', 1, 1)
        head = element(6, cell[0]) + element(5, cell[1]) + element(1, name)
        size += len(head) + 8
        heads.append(struct.pack('<II', 14, size - 8) + head)
    return b''.join(reversed(heads))


@pytest.mark.threat('S1')
def test_annotations_that_crash_or_fill_their_reader_are_refused(
    tree: Path, tmp_path: Path
) -> None:
    """Cells in cells end SciPy with a segmentation fault; zeros unpack to a thousand times."""
    scipy_io: Any = pytest.importorskip('scipy.io')
    folder = shutil.copytree(tree, tmp_path / 'tree')
    path = folder / 'S1/Seq1/annot.mat'
    start = path.read_bytes()[:128]
    scipy_io.savemat(path, {'annot2': np.zeros(2**26)}, do_compression=True)
    bomb = path.read_bytes()
    assert len(bomb) < 2**20
    for data, message in (
        (start + nested(20_000), 'cannot be read as a MATLAB file: damaged'),
        (bomb, r'it would take more than \d+ MiB of memory'),
        (b'', 'cannot be read as a MATLAB file: .*truncated'),
        (b'ab', 'cannot be read as a MATLAB file: '),
    ):
        path.write_bytes(data)
        with pytest.raises(InputError, match=message) as caught:
            MpiInf3dhp.open(folder).read('S1/Seq1')
        assert 'annot.mat' in str(caught.value)
