# SPDX-License-Identifier: Apache-2.0
"""Skeleton files: positions, times and units as the file means them, or a line to mend."""

from __future__ import annotations

import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from shoot_files import write_bvh, write_c3d, write_csv, write_trc

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import Array
from rpgd_ros.importing import c3d, text
from rpgd_ros.importing.plan import COMMON_FPS
from rpgd_ros.importing.skeleton import settle
from rpgd_ros.importing.skeleton_files import read_skeleton
from rpgd_ros.io import child
from rpgd_ros.skeletons import CONVENTIONS

JOINTS = CONVENTIONS['plug_in_gait']
TRC = """PathFileType\t4\t(X/Y/Z)\twalk.trc
DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames
100\t100\t3\t2\tmm\t100\t1\t3
Frame#\tTime\tLHip\t\t\tRHip\t\t
\t\tX1\tY1\tZ1\tX2\tY2\tZ2

5\t0.04\t1\t2\t3\t4\t5\t6
6\t0.05\t\t\t\t4\t5\t6\t
8\t0.07\t1.5\t2\t3\t4\t5\t6
"""
BVH = """HIERARCHY
ROOT Hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Left Leg
  {
    OFFSET 10 0 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    JOINT Foot
    {
      OFFSET 0 -40 0
      CHANNELS 3 Zrotation Xrotation Yrotation
      End Site
      {
        OFFSET 0 0 10
      }
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.04
1 2 3  90 0 0   0 90 0  0 0 0
1 2 3   0 0 90  0 0 0   0 0 0
"""
CSV = """# units: cm
# up: y
frame;left_hip.x;left_hip.y;left_hip.z;head_X;head_Y;head_Z
0;1;2;3;4;5;6
2;;;;4;5;6
"""


def body(n_frames: int, seed: int = 0) -> Array:
    """Return positions of the size of a person, metres."""
    return np.random.default_rng(seed).uniform(0.0, 1.5, (n_frames, len(JOINTS), 3))


def test_trc_is_read_with_its_gaps_times_and_units(tmp_path: Path) -> None:
    """Times are those of the file, empty cells are missing, a trailing tab is nothing."""
    path = tmp_path / 'walk.trc'
    path.write_text(TRC)
    found = read_skeleton(path)
    assert found.joints == ('LHip', 'RHip')
    assert (found.units, found.units_line) == ('mm', 3)
    np.testing.assert_allclose(found.time_s, [0.04, 0.05, 0.07])
    np.testing.assert_array_equal(found.values[0], [[1, 2, 3], [4, 5, 6]])
    assert np.isnan(found.values[1, 0]).all()
    assert found.notes == ()


def test_bvh_turns_in_the_order_of_its_channels(tmp_path: Path) -> None:
    """By hand: Z by 90 deg takes the leg to +y, then X by 90 deg the foot out of the plane."""
    path = tmp_path / 'a.bvh'
    path.write_text(BVH)
    found = read_skeleton(path)
    assert found.joints == ('Hips', 'Left Leg', 'Foot')
    assert found.units is None
    np.testing.assert_allclose(found.time_s, [0.0, 0.04])
    np.testing.assert_allclose(found.values[0], [[1, 2, 3], [1, 12, 3], [1, 12, -37]], atol=1e-12)
    np.testing.assert_allclose(found.values[1], [[1, 2, 3], [1, 2, -7], [1, -38, -7]], atol=1e-12)


def test_bvh_says_how_it_takes_the_offset_of_the_root(tmp_path: Path) -> None:
    """Programs differ over it."""
    path = tmp_path / 'a.bvh'
    path.write_text(BVH.replace('OFFSET 0 0 0', 'OFFSET 0 90 0', 1))
    found = read_skeleton(path)
    np.testing.assert_allclose(found.values[0, 0], [1, 92, 3])
    assert 'OFFSET of root Hips (0, 90, 0) is added' in found.notes[0]


def test_csv_is_read_by_its_header(tmp_path: Path) -> None:
    """Semicolons, both spellings of the columns, frame numbers with the rate that was given."""
    path = tmp_path / 'a.csv'
    path.write_text(CSV)
    found = read_skeleton(path, 50.0)
    assert found.joints == ('left_hip', 'head')
    assert (found.units, found.units_line, found.up) == ('cm', 1, 'y')
    np.testing.assert_allclose(found.time_s, [0.0, 0.04])
    assert np.isnan(found.values[1, 0]).all()
    np.testing.assert_array_equal(found.values[1, 1], [4, 5, 6])


def _trc(path: Path, x: Array) -> None:
    write_trc(path, JOINTS, x)


def _csv(path: Path, x: Array) -> None:
    write_csv(path, JOINTS, x)


def _bvh(path: Path, x: Array) -> None:
    write_bvh(path, JOINTS, x)


@pytest.mark.parametrize(('write', 'atol'), [(_trc, 1e-6), (_csv, 1e-6), (_bvh, 1e-5)])
@given(n_frames=st.integers(2, 6), seed=st.integers(0, 99))
def test_what_is_written_is_read_back(
    tmp_path_factory: pytest.TempPathFactory,
    write: Callable[[Path, Array], None],
    atol: float,
    n_frames: int,
    seed: int,
) -> None:
    """Names, times and positions, to the digits of the file."""
    x = body(n_frames, seed)
    path = tmp_path_factory.mktemp('file') / 'walk.any'
    write(path, x)
    found = read_skeleton(path)
    order = [found.joints.index(name) for name in JOINTS]
    np.testing.assert_allclose(found.values[:, order], x, atol=atol)
    np.testing.assert_allclose(found.time_s, np.arange(n_frames) / 100.0, atol=1e-6)


@pytest.mark.parametrize(
    ('fps', 'decimals'),
    [*((fps, 3) for fps in COMMON_FPS), (29.97, 2), (59.94, 2), (60, 2), (400, 3), (500, 3)],
)
@pytest.mark.parametrize('kind', ['trc', 'csv'])
@pytest.mark.parametrize('n_lost', [0, 7, 300])
def test_rounded_times_have_the_rate_that_the_file_states(
    tmp_path: Path, kind: str, fps: float, decimals: int, n_lost: int
) -> None:
    """With and without a gap: its own rate, whether it is stated or asked for again."""
    path = tmp_path / 'walk'
    frames = np.delete(np.arange(1000), np.arange(300, 300 + n_lost))
    times = [f'{frame / fps:.{decimals}f}' for frame in frames]
    if kind == 'trc':
        head = TRC[: TRC.index('5\t')].replace('100\t100\t3', f'{fps}\t{fps}\t{len(frames)}')
        rows = [f'{n + 1}\t{t}\t1\t2\t3\t900\t5\t6' for n, t in zip(frames, times, strict=True)]
    else:
        head = f'# units: mm\n# fps: {fps}\ntime,LHip.x,LHip.y,LHip.z,RHip.x,RHip.y,RHip.z\n'
        rows = [f'{t},1,2,3,900,5,6' for t in times]
    path.write_text('\n'.join([head.rstrip(), *rows, '']))
    found = read_skeleton(path)
    tolerance = 10.0**-decimals / (999.0 / fps)
    assert found.fps == pytest.approx(fps, rel=tolerance)
    settled = settle(found, fps=fps)
    assert settled.warnings == ()
    np.testing.assert_allclose(settled.time_s, frames / fps, atol=1.5 * 10.0**-decimals)
    if kind == 'trc':  # renumbered, as programs do that cut out a piece
        renumbered = [f'{i}\t{row.partition(chr(9))[2]}' for i, row in enumerate(rows)]
        path.write_text('\n'.join([head.rstrip(), *renumbered, '']))
        assert read_skeleton(path).fps == found.fps


def test_c3d_is_read_through_its_library(tmp_path: Path) -> None:
    """Points that were not seen, an unlabelled one, a subject before the names, a first frame."""
    ezc3d = pytest.importorskip('ezc3d')
    x = body(1000)  # more than a pipe holds
    file = ezc3d.c3d()
    point = file['parameters']['POINT']
    point['UNITS']['value'], point['RATE']['value'] = ['mm'], [50.0]
    point['LABELS']['value'] = [*(f'Anna:{name}' for name in JOINTS), '*13']
    points = np.ones((4, len(JOINTS) + 1, len(x)))
    points[:3, :-1] = 1000.0 * x.transpose(2, 1, 0)
    points[:3, 2, 3] = np.nan
    file['data']['points'] = points
    file.add_parameter('POINT', 'Y_SCREEN', ['+Z'])
    file.write(str(tmp_path / 'a.c3d'))
    found = read_skeleton(tmp_path / 'a.c3d')
    assert found.joints == JOINTS
    assert (found.units, found.up) == ('mm', 'z')
    np.testing.assert_allclose(found.time_s, np.arange(1000) / 50.0)
    assert np.isnan(found.values[3, 2]).all()
    np.testing.assert_allclose(found.values[0], 1000.0 * x[0], rtol=1e-5)


@pytest.mark.parametrize('subject', ['', 'Anna:'])
@pytest.mark.parametrize('group', ['ANGLES', 'MOMENTS', 'FORCES', 'POWERS', 'SCALARS', 'ANGLES2'])
def test_c3d_with_results_of_a_model_gives_the_positions_only(
    tmp_path: Path, group: str, subject: str
) -> None:
    """Degrees and newton millimetres, which Vicon stores as points and names in groups."""
    ezc3d = pytest.importorskip('ezc3d')
    x = body(4)
    file = ezc3d.c3d()
    point = file['parameters']['POINT']
    point['UNITS']['value'], point['RATE']['value'] = ['mm'], [50.0]
    point['LABELS']['value'] = [f'Anna:{n}' for n in (JOINTS[0], 'LHipResult', *JOINTS[1:])]
    points = np.full((4, len(JOINTS) + 1, len(x)), 90_000.0)
    points[:3, [0, *range(2, len(JOINTS) + 1)]] = 1000.0 * x.transpose(2, 1, 0)
    file['data']['points'] = points
    file.add_parameter('POINT', group, [f'{subject}LHipResult  '])
    file.write(str(tmp_path / 'a.c3d'))
    found = read_skeleton(tmp_path / 'a.c3d')
    assert found.joints == JOINTS
    np.testing.assert_allclose(settle(found).x_mocap, x, rtol=1e-5)


def test_c3d_with_a_timecode_or_two_rates_says_so(tmp_path: Path) -> None:
    """A section that is not published is not guessed at; the parameters' rate is taken."""
    ezc3d = pytest.importorskip('ezc3d')
    path = tmp_path / 'a.c3d'
    write_c3d(path, JOINTS, body(4), fps=50.0)
    assert read_skeleton(path).notes == ()
    file = ezc3d.c3d(str(path))
    file.add_parameter('TIMECODE', 'STANDARD', [30])
    file.write(str(path))
    data = path.read_bytes()
    path.write_bytes(data[:20] + struct.pack('<f', 25.0) + data[24:])
    found = read_skeleton(path)
    assert found.fps == pytest.approx(50.0)
    assert 'has a TIMECODE section' in found.notes[0]
    assert '--mocap-timecode' in found.notes[0]
    assert 'the header says 25 Hz, POINT:RATE 50 Hz, which is taken: give' in found.notes[1]


@pytest.mark.parametrize('share', [0.2, 0.5, 0.9])
def test_c3d_that_ends_early_is_refused(tmp_path: Path, share: float) -> None:
    """The library gives what is left of it, as if that were all."""
    path = tmp_path / 'a.c3d'
    write_c3d(path, JOINTS, body(100))
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(
        InputError, match=r'a\.c3d: \d+ frames, but the header promises 100 \(1 to'
    ):
        read_skeleton(path)


def test_c3d_whose_header_cannot_count_its_frames_is_read(tmp_path: Path) -> None:
    """The header has 16 bits for them, the parameters have more."""
    path = tmp_path / 'a.c3d'
    write_c3d(path, JOINTS, body(4))
    data = path.read_bytes()
    path.write_bytes(data[:8] + struct.pack('<H', 65535) + data[10:])
    assert len(read_skeleton(path).time_s) == 4


def test_c3d_position_that_nobody_can_have_is_missing(tmp_path: Path) -> None:
    """Nothing is computed with it."""
    path, x = tmp_path / 'a.c3d', body(4)
    x[1, 2] = 1e30
    x[3, 0, 1] = np.inf
    write_c3d(path, JOINTS, x)
    found = read_skeleton(path).values
    assert np.isnan(found[1, 2]).all()
    assert np.isnan(found[3, 0, 1])
    assert np.isnan(found).sum() == 4


def test_c3d_label_in_latin_1_is_read(tmp_path: Path) -> None:
    """With a mark for the letter, as in text files."""
    path = tmp_path / 'a.c3d'
    write_c3d(path, ('LHipJ1', *JOINTS[1:]), body(4))
    path.write_bytes(path.read_bytes().replace(b'LHipJ1', b'LHipJ\xf6'))
    assert read_skeleton(path).joints[0] == 'LHipJ\ufffd'


@pytest.mark.parametrize('limit', ['-v 5000000', '-t 5'])
def test_c3d_is_read_where_less_is_allowed_than_a_file_may_take(
    tmp_path: Path, limit: str
) -> None:
    """Nobody may raise a hard limit; that of a cluster or container stays."""
    path = tmp_path / 'a.c3d'
    write_c3d(path, JOINTS, body(4))
    line = f'"{child.MAIN}" "{c3d.CHILD}" 10 {c3d.MAX_MEMORY} "{path}"'
    command = f'ulimit {limit}; exec "{sys.executable}" -P {line}'
    done = subprocess.run(['/bin/sh', '-c', command], capture_output=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(b'{"facts": {"RATE": [')


@pytest.mark.parametrize(
    ('old', 'new', 'message'),
    [
        (struct.pack('<f', 50.0), bytes(4), 'POINT:RATE is 0 Hz, need 1 to 2000: export it again'),
        (b'mm', b'px', "POINT:UNITS 'px' is unknown, need one of m, mm"),
    ],
)
def test_c3d_without_a_usable_parameter_is_refused(
    tmp_path: Path, old: bytes, new: bytes, message: str
) -> None:
    """Rates and units are never made up."""
    ezc3d = pytest.importorskip('ezc3d')
    file = ezc3d.c3d()
    point = file['parameters']['POINT']
    point['UNITS']['value'], point['RATE']['value'] = ['mm'], [50.0]
    point['LABELS']['value'] = list(JOINTS)
    file['data']['points'] = np.ones((4, len(JOINTS), 3))
    file.write(str(tmp_path / 'a.c3d'))
    data = (tmp_path / 'a.c3d').read_bytes()
    (tmp_path / 'a.c3d').write_bytes(data.replace(old, new))
    with pytest.raises(InputError, match=message):
        read_skeleton(tmp_path / 'a.c3d')


def test_binary_file_is_no_text(tmp_path: Path) -> None:
    """Whatever its first bytes promise."""
    (tmp_path / 'a.trc').write_bytes(b'PathFileType\t4\n' + bytes(8))
    with pytest.raises(InputError, match='is a binary file, need text'):
        read_skeleton(tmp_path / 'a.trc')


def test_file_without_end_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """More than the most that is read at once."""
    monkeypatch.setattr(text, 'MAX_BYTES', 2**20)
    (tmp_path / 'a.csv').write_text('time' + ',' * 2**20)
    with pytest.raises(InputError, match='more than 1 MiB: split the recording'):
        read_skeleton(tmp_path / 'a.csv')


@pytest.mark.parametrize(
    ('code', 'message'),
    [
        ('import os\nos.abort()', r'a.c3d: cannot be read as C3D: damaged'),
        ('while True: pass', r'a.c3d: cannot be read as C3D within 1 s: it is damaged'),
    ],
)
def test_library_that_crashes_or_hangs_ends_in_our_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: str, message: str
) -> None:
    """It does both on some damaged files; here a stand-in does, in its process."""
    pytest.importorskip('ezc3d')
    (tmp_path / 'child.py').write_text(code)
    monkeypatch.setattr(c3d, 'CHILD', tmp_path / 'child.py')
    monkeypatch.setattr(c3d, 'START_SECONDS', 1.0)
    (tmp_path / 'a.c3d').write_bytes(b'\x02\x50' + bytes(600))
    with pytest.raises(InputError, match=message):
        read_skeleton(tmp_path / 'a.c3d')


def test_c3d_without_its_library_says_how_to_get_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The extra is named."""
    monkeypatch.setitem(sys.modules, 'ezc3d', None)
    (tmp_path / 'a.c3d').write_bytes(b'\x02\x50' + bytes(600))
    with pytest.raises(InputError, match=r"pip install 'rpgd_ros\[import\]'"):
        read_skeleton(tmp_path / 'a.c3d')


@pytest.mark.parametrize('data', [b'\x02\x50' + bytes(600), b'\x02\x50', b'', b'text'])
def test_damaged_c3d_is_refused(tmp_path: Path, data: bytes) -> None:
    """In our words, whatever the library raises."""
    pytest.importorskip('ezc3d')
    (tmp_path / 'a.c3d').write_bytes(data)
    with pytest.raises(InputError, match=r'a\.c3d: (cannot be read as C3D|is no C3D file)'):
        read_skeleton(tmp_path / 'a.c3d')


@pytest.mark.parametrize(
    ('content', 'old', 'new', 'message'),
    [
        (TRC, 'mm', 'furlong', r":3: Units 'furlong' is unknown, need one of m,"),
        (TRC, '100\t100\t3\t2\tmm', '60\t60\t3\t2\tmm', ':3: DataRate is 60 Hz, but the Time '),
        (TRC, '100\t100\t3', '0\t100\t3', ':3: DataRate 0 is no frame rate'),
        (TRC, '\t3\t2\tmm', '\t3\t5\tmm', ':4: 2 marker names, but NumMarkers is 5'),
        (TRC, 'Units', 'Unit', ':3: Units is missing in the header'),
        (TRC, '1.5\t2\t3\t4', '1.5\t2\t4', r':9: 7 columns, need 8: .*take the marker'),
        (TRC, '1.5\t2', '1,5\t2', r":9: column 3: need a number, got '1,5'"),
        (TRC, '1.5\t2', 'inf\t2', ':9: column 3 is infinite'),
        (TRC, '8\t0.07', '8\t0.05', ':9: time goes from 0.05 to 0.05 s: it must increase'),
        (TRC, '8\t0.07', '8\t1e300', r":9: column 2: need a number up to 1e\+15, got '1e300'"),
        (TRC, '1.5\t2', '1e308\t2', r":9: column 3: need a number up to 1e\+15, got '1e308'"),
        (BVH, 'OFFSET 10', 'OFFSET 1e308', r":8: OFFSET: need a number up to 1e\+15, got '1e308'"),
        (TRC, '8\t0.07', '8\t1e8', r':9: time 1e\+08 s is more than a day'),
        (TRC, '100\t100\t3', '.5\t100\t3', ':3: DataRate 0.5 is no frame rate, need 1 to'),
        (CSV, '# up: y', '# fps: 1e-320', ':2: fps .* is no frame rate, need 1 to 2000 Hz'),
        (TRC, 'Frame#\t', 'Frame# ', ':4: need Frame#, Time and the marker names'),
        (BVH, 'Frames: 2', 'Frames: 3', ':22: 2 frames follow, but Frames is 3: is the file cut'),
        (BVH, 'Time: 0.04', 'Time: 25', ':23: Frame Time 25 s is none: write seconds'),
        (BVH, 'Time: 0.04', 'Time: 0', ':23: Frame Time 0 s is none'),
        (BVH, '0 90 0  0 0 0\n', '0 90 0  0 0\n', ':24: 11 numbers, need one for each of 12'),
        (BVH, 'CHANNELS 3 Z', 'CHANNELS 4 Z', ':9: CHANNELS needs their number'),
        (BVH, 'Zrotation Xrotation Yrotation\n  JOINT', 'Zrotation Zrotation Yrotation\n  JOINT',
         ':5: a channel comes twice'),
        (BVH, 'JOINT Foot', 'ROOT Foot', r":10: 'ROOT Foot' is out of place"),
        (BVH, 'OFFSET 10 0 0', 'OFFSET 10 0', r":8: need ROOT, JOINT, .* got 'OFFSET'"),
        (BVH, 'MOTION\n', '', ':21: need MOTION after the hierarchy'),
        (BVH[:150], '', '', 'ends too early: is it cut off'),
        (BVH, '{\n  OFFSET 0 0 0', 'OFFSET 0 0 0', r":3: need {, got 'OFFSET'"),
        (BVH, 'HIERARCHY\n', 'HIERARCHY now\n', ':1: no BVH file'),
        (CSV, 'cm', 'px', r":1: units 'px' are unknown, need one of m, cm, mm, inch"),
        (CSV, 'up: y', 'up: w', ":2: up 'w' is no axis"),
        (CSV, 'left_hip.y', 'left.y', ":3: columns 2 to 4 are 'left_hip.x', 'left.y'"),
        (CSV, ';head_Z', '', ':3: the header is not understood'),
        (CSV, ';5;6\n2', ';5\n2', ':4: 6 columns, the header has 7'),
        (CSV, 'head_Z\n0', 'head_Z\n7', ':5: time goes from 7 to 2 s'),
        (CSV, '# up: y', '# fps: none', r":2: fps: need a number, got 'none'"),
        (CSV.replace('frame', 'time'), '# up: y', '# fps: 25',
         ':2: fps is 25, but the times run at 0.5 Hz: give the true rate with --mocap-fps'),
    ],
)  # fmt: skip
def test_fault_is_named_with_file_and_line(
    tmp_path: Path, content: str, old: str, new: str, message: str
) -> None:
    """One thing wrong in an otherwise good file, and what to do."""
    path = tmp_path / 'file'
    path.write_text(content.replace(old, new, 1) if old else content)
    with pytest.raises(InputError, match=message) as refused:
        read_skeleton(path, None)
    assert refused.value.message.startswith(str(path))


@pytest.mark.parametrize('end', ['\r', '\r\n', '\n'])
@pytest.mark.parametrize('content', [TRC, BVH, CSV])
def test_lines_end_as_they_do_on_any_system(tmp_path: Path, content: str, end: str) -> None:
    """Excel saves a CSV for the Macintosh with carriage returns alone."""
    path = tmp_path / 'file'
    path.write_text(content)
    expected = read_skeleton(path, 50.0)
    path.write_bytes(content.replace('\n', end).encode())
    found = read_skeleton(path, 50.0)
    np.testing.assert_array_equal(found.values, expected.values)
    np.testing.assert_array_equal(found.time_s, expected.time_s)


@pytest.mark.parametrize('place', ['header', 'row'])
def test_quote_that_is_not_closed_is_refused(tmp_path: Path, place: str) -> None:
    """It would make one cell of the rest of the file, of which a reader of CSV takes 128 KiB."""
    path = tmp_path / 'a.csv'
    rows = [f'{i};1;2;3;4;5;6' for i in range(20_000)]
    text = CSV[: CSV.index('0;')] + '\n'.join(rows)
    old, line = ('head_X', 3) if place == 'header' else ('\n7;1', 11)
    path.write_text(text.replace(old, old.replace('1', '"1').replace('head', '"head'), 1))
    with pytest.raises(InputError, match=rf'a\.csv:{line}: .*quote') as refused:
        read_skeleton(path, 50.0)
    assert len(refused.value.message) < 300


@pytest.mark.parametrize('kind', ['trc', 'bvh', 'csv'])
def test_subject_before_all_names_is_taken_off(tmp_path: Path, kind: str) -> None:
    """As Vicon and MotionBuilder write it; of two subjects, both stay."""
    path = tmp_path / 'file'
    for subjects, expected in (('Anna', 'Anna'), JOINTS), (('Anna', 'Bob'), None):
        names = [f'{subjects[j > 0]}:{name}' for j, name in enumerate(JOINTS)]
        {'trc': _write_trc, 'bvh': _write_bvh, 'csv': _write_csv}[kind](path, names)
        joints = read_skeleton(path).joints
        assert sorted(joints) == sorted(expected or names)


def _write_trc(path: Path, names: list[str]) -> None:
    write_trc(path, names, body(4))


def _write_bvh(path: Path, names: list[str]) -> None:
    write_bvh(path, names, body(4))


def _write_csv(path: Path, names: list[str]) -> None:
    write_csv(path, names, body(4))


def test_csv_with_frame_numbers_needs_a_rate(tmp_path: Path) -> None:
    """Given, or in a line of the file."""
    path = tmp_path / 'a.csv'
    path.write_text(CSV)
    with pytest.raises(InputError, match='has frame numbers and no rate: give --mocap-fps'):
        read_skeleton(path)
    path.write_text('# fps: 100\n' + CSV)
    np.testing.assert_allclose(read_skeleton(path).time_s, [0.0, 0.02])
    path.write_text(CSV)
    found = read_skeleton(path, 100.0)
    np.testing.assert_allclose(settle(found, units='m', fps=100.0).time_s, [0.0, 0.02])


def test_unknown_unit_has_the_code_of_a_wrong_unit(tmp_path: Path) -> None:
    """For programs that call this one."""
    path = tmp_path / 'walk.trc'
    path.write_text(TRC.replace('\tmm\t', '\tyard\t'))
    with pytest.raises(InputError) as refused:
        read_skeleton(path)
    assert refused.value.reason is Reason.WRONG_UNIT


@given(kind=st.sampled_from([TRC, BVH, CSV]), data=st.data())
def test_damaged_text_is_read_or_refused_in_our_words(
    tmp_path_factory: pytest.TempPathFactory, kind: str, data: st.DataObject
) -> None:
    """Cut, and with characters exchanged: never another error."""
    start = data.draw(st.integers(0, len(kind)))
    length = data.draw(st.integers(0, 30))
    damaged = kind[:start] + data.draw(st.text(max_size=6)) + kind[start + length :]
    path = tmp_path_factory.mktemp('file') / 'file'
    path.write_bytes(damaged.encode('utf-8', errors='replace'))
    try:
        found = read_skeleton(path)
    except InputError:
        return
    assert found.values.shape == (len(found.time_s), len(found.joints), 3)
