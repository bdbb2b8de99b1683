# SPDX-License-Identifier: Apache-2.0
"""The import program: what it says, what it refuses, and what it leaves behind."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from camera_files import opencv_text, qualisys_text
from rich.progress import Progress, TaskID
from shoot import Shoot, make_shoot, run_import, words_of, write_shoot
from shoot_files import write_coco, write_csv, write_openpose, write_trc

from rpgd_ros.apps import import_recording

# Both sides with timecode.
CODES: dict[str, object] = {
    'mocap_timecode': '10:00:00:00',
    'camera_timecode': '10:00:00:00',
    'timecode_fps': '25',
}


@pytest.fixture(scope='module')
def shoot() -> Shoot:
    """Return a walk before two cameras."""
    return make_shoot()


@pytest.fixture(scope='module')
def written(tmp_path_factory: pytest.TempPathFactory, shoot: Shoot) -> Path:
    """Write the walk as TRC, Pose2Sim TOML and one COCO file per camera."""
    folder = tmp_path_factory.mktemp('shoot')
    write_shoot(folder, shoot)
    return folder


@pytest.fixture
def folder(written: Path, tmp_path: Path) -> Path:
    """Return a copy of the files."""
    return shutil.copytree(written, tmp_path, dirs_exist_ok=True)


def names_in(folder: Path) -> set[str]:
    """Return the names in a folder, hidden ones too."""
    return {p.name for p in folder.iterdir()}


def test_dry_run_says_what_was_understood_and_writes_nothing(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Streams, joints with and without a partner, durations, units."""
    before = names_in(folder)
    assert run_import(*words_of(folder, dry_run=True)) == 0
    said = capsys.readouterr().out
    assert names_in(folder) == before
    for words in (
        'walk.trc (TRC)',
        '800 frames at 100 Hz, 0.000 to 7.990 s; 12 joints',
        'positions in m (stated), body 1.',
        'axes as in the file, body along ',
        'calibration aniposelib/Pose2Sim TOML: cam0, cam1; positions in m (as Pose2Sim means them',
        'left_hip = LHipJC',
        'keypoints without a joint: nose, left_eye',
    ):
        assert words in said


def test_dry_run_counts_other_people_and_empty_frames(
    folder: Path, shoot: Shoot, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each seventh frame has a second, less certain person; some frames have nobody."""
    for i, uv in enumerate(shoot.uv):
        write_openpose(folder / 'tree' / f'cam{i}_json', uv)
    for frame in range(40, 45):
        path = folder / 'tree' / 'cam0_json' / f'video_{frame:012d}_keypoints.json'
        path.write_text(json.dumps({'version': 1.3, 'people': []}))
    assert run_import(*words_of(folder, keypoints=folder / 'tree', dry_run=True)) == 0
    said = capsys.readouterr().out
    row = next(line for line in said.splitlines() if line.startswith('cam0 ') and '%' in line)
    assert row.split() == ['cam0', '395', '50', '0.000', '7.980', '5', '57', '71%', '12']


def test_what_is_odd_is_said(
    folder: Path, shoot: Shoot, capsys: pytest.CaptureFixture[str]
) -> None:
    """Calibration and keypoints of two video sizes, a camera without keypoints, a wrong --up."""
    (folder / 'half').mkdir()
    write_coco(folder / 'half' / f'{shoot.cameras[0].name}.json', 3.0 * shoot.uv[0])
    assert run_import(*words_of(folder, keypoints=folder / 'half', dry_run=True, up='x')) == 0
    said = capsys.readouterr().out
    assert 'of the keypoints lie outside its 1920 x 1080 image' in said
    assert f'no keypoints for {shoot.cameras[1].name}: left out' in said
    assert 'with --up x the body stands along ' in said


def test_cameras_without_poses_are_said_to_be_placed_later(
    folder: Path, shoot: Shoot, capsys: pytest.CaptureFixture[str]
) -> None:
    """Several intrinsic calibrations are a rig without extrinsics."""
    for camera in shoot.cameras:
        (folder / f'{camera.name}.yml').write_text(opencv_text(camera))
    files = [folder / f'{camera.name}.yml' for camera in shoot.cameras]
    assert run_import(*words_of(folder, cameras=files, dry_run=True)) == 0
    out = ' '.join(capsys.readouterr().out.split())
    assert 'warning: the calibration gives no poses for several cameras: calibrate_bag' in out


def test_timecodes_that_contradict_or_are_not_used_are_said(
    folder: Path, shoot: Shoot, capsys: pytest.CaptureFixture[str]
) -> None:
    """An option goes before the file, and a video's rate is a multiple of its timecode's."""
    head = '# units: m\n# timecode: 09:00:00:00\n# timecode_fps: 30\n'
    write_csv(folder / 'a.csv', shoot.joints, shoot.x_mocap, head)
    words = {'skeleton': folder / 'a.csv', 'dry_run': True}
    assert run_import(*words_of(folder, **words)) == 0
    assert 'has timecode 09:00:00:00, which is not used: give --ca' in capsys.readouterr().out
    codes = CODES | {'timecode_fps': '29.97'}
    assert run_import(*words_of(folder, **codes, **words)) == 0
    said = capsys.readouterr().out
    for warning in (
        'the file states timecode at 30 Hz, --timecode-fps says 29.97',
        'the file states timecode 09:00:00:00, --mocap-timecode says 10:00:00:00',
        'camera cam0 runs at 50 Hz, its timecode at 29.97: check --camera-fps and --timecode-fps',
    ):
        assert f'warning: {warning}' in said


def test_each_stage_has_a_bar(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Reading the skeleton and each camera, and writing."""
    begun: list[str] = []

    class Bars(Progress):
        def add_task(self, description: str, *words: Any, **more: Any) -> TaskID:
            begun.append(description)
            return super().add_task(description, *words, **more)

    monkeypatch.setattr(import_recording, 'Progress', Bars)
    assert run_import(*words_of(folder)) == 0
    assert begun == ['skeleton', 'cam0', 'cam1', 'writing']


def test_json_says_what_was_understood_and_nothing_else(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Streams, joints, units and files; the same with --dry-run, but without files."""
    trees = []
    for changes in ({'dry_run': True}, {}):
        assert run_import(*words_of(folder, json=True, **changes)) == 0
        trees.append(json.loads(capsys.readouterr().out))
    dry, wet = trees
    assert (dry['status'], dry['files']) == ('understood', {})
    files = {'bag': str(folder / 'out/bag'), 'rig': str(folder / 'out/rig.yaml')}
    assert (wet['status'], wet['exit_code'], wet['files']) == ('written', 0, files)
    for key in ('skeleton', 'cameras', 'warnings', 'timecode'):
        assert dry[key] == wet[key]
    assert (dry['skeleton']['units'], dry['skeleton']['fps']) == ('m', pytest.approx(100.0))
    assert [c['camera'] for c in dry['cameras']] == ['cam0', 'cam1']
    assert dry['cameras'][0]['pairs']['left_hip'] == 'LHipJC'
    assert 'nose' in dry['cameras'][0]['keypoints_without_joint']


def test_json_of_bad_input_has_the_reason(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """For scripts; people read the same sentence on the error output."""
    assert run_import(*words_of(folder, json=True, units='mm')) == 2
    captured = capsys.readouterr()
    tree = json.loads(captured.out)
    assert (tree['status'], tree['exit_code'], tree['reason']) == ('bad_input', 2, 'wrong_unit')
    assert captured.err.strip() == f'import_recording: {tree["message"]}'


def test_unforeseen_error_is_reported_as_one(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """With a code of its own, and nothing written."""

    def fail(*_: object, **__: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(import_recording, 'write_plan', fail)
    before = names_in(folder)
    assert run_import(*words_of(folder)) == 70
    assert 'this should not happen, please report it' in capsys.readouterr().err
    assert names_in(folder) == before


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'units': 'mm'}, 'with --units mm the body spans 0.0'),
        ({'camera_fps': 100}, 'at 50 Hz both would last the same: give --camera-fps cam0=50'),
        ({'camera_start': 100}, 'they never meet. Give --camera-start cam0=SECONDS'),
        ({'camera_fps': ['cam0=50']}, 'camera cam1 has no frame rate: give --camera-fps cam1=HZ'),
        ({'camera_fps': ['cam7=50']}, "no camera 'cam7' in the calibration"),
        ({'camera_fps': ['fast']}, "--camera-fps needs a number from 1 to 2000, got 'fast'"),
        ({'camera_fps': [0]}, '--camera-fps needs a number'),
        (
            {'camera_timecode': '10:00:00:00'},
            'TRC states no timecode: give that of its first frame',
        ),
        ({'mocap_timecode': '10:00:00:00'}, 'of no use without --camera-timecode [CAMERA=]'),
        (
            CODES | {'timecode_fps': None},
            'rate of the timecode is not known, and it is not always',
        ),
        (CODES | {'camera_start': 0}, 'camera cam0 has both --camera-start and --camera-timecode'),
        (CODES | {'camera_timecode': 'cam0=10:00:00:00'}, 'cam1 has neither --camera-start nor'),
        (CODES | {'camera_timecode': 'cam7=10:00:00:00'}, "--camera-timecode: no camera 'cam7'"),
        (CODES | {'camera_timecode': '10:00:00:27'}, "of cam0: '10:00:00:27': frame 27 of a se"),
        (CODES | {'camera_timecode': '11:00:00:00'}, 'at its first frame, or check its timecode'),
        ({'first_frame': 2}, "--first-frame needs 0 or 1, got '2'"),
        ({'first_frame': ['cam7=1']}, "--first-frame: no camera 'cam7' in the calibration"),
        ({'first_frame': ['cam1=1']}, 'cam1.json: has a frame 0, but --first-frame says 1'),
        ({'mocap_fps': -1}, '--mocap-fps must be 1 to 2000'),
        ({'keypoint_joints': None}, '17 keypoints without names: give --keypoint-joints (coco17'),
        ({'keypoint_joints': 'body25'}, '17 keypoints, but 25 names: check --keypoint-joints'),
        ({'keypoint_joints': 'coco'}, "unknown convention 'coco', did you mean coco17?"),
        ({'joint_map': ['nose=Head']}, "no MoCap joint 'Head'"),
        ({'joint_map': ['nose']}, '--joint-map needs KEYPOINT=JOINT'),
        ({'keypoint_units': 'normalized'}, 'they are pixels'),
        ({'camera_units': 'inch'}, 'Calib.toml: the cameras see a body of 0.0'),
        ({'camera_units': 'mm', 'cameras': 'q.qca.txt'}, 'has its own unit'),
        ({'cameras': ['Calib.toml', 'Calib.toml']}, 'camera cam0 comes twice among'),
        ({'skeleton': 'Calib.toml'}, 'no TRC, BVH or C3D file, and no CSV file'),
        ({'skeleton': 'none.trc'}, 'none.trc: cannot be read: No such file'),
        ({'keypoints': 'none'}, 'cannot be read: No such file'),
        ({'keypoints': ['cam7=pose']}, "--keypoints: no camera 'cam7' in the calibration"),
        ({'keypoints': ['cam0=a.json', 'cam0=b.json']}, '--keypoints gives camera cam0 twice'),
        ({'keypoints': ['pose', 'pose']}, '--keypoints needs either one folder'),
        ({'min_score': 2.0}, 'all keypoints are missing: check --min-score'),
        ({'world_frame': '/world'}, 'world_frame: need a frame name'),
        ({'world_frame': 'mocap'}, "world_frame: 'mocap' is the frame of the skeletons"),
        ({'output': 'none/out'}, 'is no folder: create it first'),
        ({'output': 'pose'}, 'exists: choose another name, or --force'),
        ({'output': 'pose', 'force': True}, "holds 'cam0.json': --force replaces older"),
    ],
)
def test_what_does_not_fit_is_refused_with_a_remedy(
    folder: Path,
    shoot: Shoot,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    changes: dict[str, object],
    message: str,
) -> None:
    """Exit code 2, one line, and nothing written."""
    monkeypatch.chdir(folder)
    (folder / 'q.qca.txt').write_text(qualisys_text(shoot.cameras))
    before = names_in(folder)
    assert run_import(*words_of(folder, **changes)) == 2
    assert message in capsys.readouterr().err
    assert names_in(folder) == before


def test_older_recording_is_replaced_only_when_told(folder: Path) -> None:
    """--force replaces what this program wrote."""
    assert run_import(*words_of(folder)) == 0
    before = (folder / 'out/rig.yaml').read_text()
    assert run_import(*words_of(folder, camera_fps=[50])) == 2
    changes = {'force': True, 'world_frame': 'studio', 'storage': 'sqlite3'}
    assert run_import(*words_of(folder, **changes)) == 0
    assert (folder / 'out/rig.yaml').read_text() != before
    assert any(p.suffix == '.db3' for p in (folder / 'out/bag').iterdir())
    assert not [name for name in names_in(folder) if name.startswith('.')]


@pytest.mark.parametrize('stop', [signal.SIGINT, signal.SIGTERM])
def test_stopped_run_leaves_nothing_behind(
    folder: Path, shoot: Shoot, stop: signal.Signals
) -> None:
    """Stopped while it writes: no folder, no scratch folder, exit code 130."""
    write_trc(folder / 'walk.trc', shoot.joints, np.tile(shoot.x_mocap, (8, 1, 1)))
    before = names_in(folder)
    words = [str(word) for word in words_of(folder)]
    command = [sys.executable, '-m', 'rpgd_ros.apps.import_recording', *words]
    project = Path(__file__).parent.parent
    process = subprocess.Popen(command, stderr=subprocess.PIPE, cwd=project)
    deadline = time.monotonic() + 60.0
    while not list(folder.glob('.out.*.tmp/.bag.*/*/*')) and process.poll() is None:
        assert time.monotonic() < deadline, 'no bag was begun'
        time.sleep(0.005)
    process.send_signal(stop)
    _, complaint = process.communicate(timeout=20.0)
    assert process.returncode == 130
    assert b'Traceback' not in complaint
    assert b'nothing was written' in complaint
    assert names_in(folder) == before
