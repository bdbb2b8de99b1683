# SPDX-License-Identifier: Apache-2.0
"""The simulate program: what it writes, what it refuses, and what it leaves behind."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from rosbags.highlevel import AnyReader

from rpgd_ros.apps import simulate
from rpgd_ros.io.rig import read_rig

SHORT = ['--preset', 'studio', '--seconds', '1']
FILES = {'bag', 'rig.yaml', 'truth.yaml'}


def names_in(folder: Path) -> set[str]:
    """Return the names in a folder, hidden ones too."""
    return {p.name for p in folder.iterdir()}


def payloads(bag: Path) -> list[tuple[str, int, bytes]]:
    """Return the messages of a bag."""
    with AnyReader([bag]) as reader:
        return [(c.topic, t, bytes(data)) for c, t, data in reader.messages()]


def test_recording_is_written_whole(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Bag, rig and truth, nothing else beside them; the next command is told."""
    output = tmp_path / 'demo'
    assert simulate.main([*SHORT, '--output', str(output)]) == 0
    assert names_in(tmp_path) == {'demo'}
    assert names_in(output) == FILES
    assert len(read_rig(output / 'rig.yaml').cameras) == 4
    assert np.array(
        yaml.safe_load((output / 'truth.yaml').read_text())['world_T_mocap']['matrix']
    ).shape == (4, 4)
    assert f'next: calibrate_bag {output}/bag --rig {output}/rig.yaml' in capsys.readouterr().out


def test_json_names_the_files_or_the_reason(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One object, and nothing else, for scripts."""
    words = [*SHORT, '--output', str(tmp_path / 'demo'), '--json']
    assert simulate.main(words) == 0
    tree = json.loads(capsys.readouterr().out)
    assert (tree['status'], tree['exit_code']) == ('written', 0)
    assert {Path(path).name for path in tree['files'].values()} == FILES
    assert simulate.main(words) == 2
    tree = json.loads(capsys.readouterr().out)
    assert (tree['status'], tree['reason'], tree['files']) == ('bad_input', 'not_writable', {})


def test_same_seed_writes_the_same_messages(tmp_path: Path) -> None:
    """And another seed writes others."""
    for name, seed in (('a', '3'), ('b', '3'), ('c', '4')):
        assert simulate.main([*SHORT, '--output', str(tmp_path / name), '--seed', seed]) == 0
    a, b, c = (payloads(tmp_path / name / 'bag') for name in 'abc')
    assert a == b
    assert a != c
    assert (tmp_path / 'a/truth.yaml').read_text() == (tmp_path / 'b/truth.yaml').read_text()


def test_options_reach_the_recording(tmp_path: Path) -> None:
    """Storage, message type, and faults, which the truth tells."""
    output = tmp_path / 'demo'
    options = ['--storage', 'sqlite3', '--mocap-type', 'PoseArray', '--outliers', '0.3']
    options += ['--kind', 'person', '--bias', '0.02', '--lag', '0.04', '--motion', 'sway']
    assert simulate.main([*SHORT, '--output', str(output), *options]) == 0
    assert any(p.suffix == '.db3' for p in (output / 'bag').iterdir())
    with AnyReader([output / 'bag']) as reader:
        types = {c.topic.lstrip('/'): c.msgtype for c in reader.connections}
    assert types['mocap/skeleton'] == 'geometry_msgs/msg/PoseArray'
    assert types['cam0/keypoints'] == 'sensor_msgs/msg/PointCloud2'
    truth = yaml.safe_load((output / 'truth.yaml').read_text())
    assert truth['outliers'] == {'ratio': 0.3, 'kind': 'person'}
    assert set(truth['time_offset_s'].values()) == {0.04}
    assert truth['joint_bias']['sigma_m'] == 0.02


@pytest.mark.parametrize(('named', 'blind'), [([], 4), (['cam1', 'cam2'], 2)])
def test_rig_file_may_lack_extrinsics(tmp_path: Path, named: list[str], blind: int) -> None:
    """Of all cameras or of some; the truth has them all."""
    output = tmp_path / 'demo'
    assert simulate.main([*SHORT, '--output', str(output), '--no-extrinsics', *named]) == 0
    cameras = read_rig(output / 'rig.yaml').cameras
    without = [c.name for c in cameras if c.extrinsics is None]
    assert len(without) == blind
    assert all(c.camera is not None for c in cameras)
    assert not named or without == named
    truth = yaml.safe_load((output / 'truth.yaml').read_text())
    assert list(truth['camera_T_world']) == [c.name for c in cameras]


def test_cameras_to_leave_out_must_exist(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """And a dataset has no rig file."""
    options = [*SHORT, '--output', str(tmp_path / 'demo'), '--no-extrinsics', 'cam9']
    assert simulate.main(options) == 2
    assert "no camera 'cam9' to leave out" in capsys.readouterr().err
    assert simulate.main([*options[:-1], '--format', 'dataset']) == 2
    assert '--no-extrinsics is for rig files' in capsys.readouterr().err
    assert names_in(tmp_path) == set()


def test_existing_folder_is_not_overwritten(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The message says how."""
    (tmp_path / 'demo').mkdir()
    assert simulate.main([*SHORT, '--output', str(tmp_path / 'demo')]) == 2
    assert '--force to replace an older recording' in capsys.readouterr().err
    assert names_in(tmp_path / 'demo') == set()


def test_force_replaces_an_older_recording(tmp_path: Path) -> None:
    """The old one is gone, and no scratch folder is left."""
    output = tmp_path / 'demo'
    assert simulate.main([*SHORT, '--output', str(output)]) == 0
    before = (output / 'truth.yaml').read_text()
    assert simulate.main([*SHORT, '--output', str(output), '--seed', '1', '--force']) == 0
    assert (output / 'truth.yaml').read_text() != before
    assert names_in(tmp_path) == {'demo'}


def test_force_replaces_nothing_but_recordings(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A slip of the hand must not cost a home folder."""
    precious = tmp_path / 'home'
    precious.mkdir()
    (precious / 'thesis.tex').write_text('years')
    (tmp_path / 'file').write_text('')
    (tmp_path / 'link').symlink_to(precious)
    for name, message in (
        ('home', "holds 'thesis.tex'"),
        ('file', 'no folder'),
        ('link', 'no folder'),
    ):
        assert simulate.main([*SHORT, '--output', str(tmp_path / name), '--force']) == 2
        assert message in capsys.readouterr().err
    assert (precious / 'thesis.tex').read_text() == 'years'


@pytest.mark.parametrize(
    ('options', 'message'),
    [
        (['--seconds', '0'], 'length must be above 0 s'),
        (['--seconds', 'nan'], 'length must be above 0 s'),
        (['--outliers', '1.5'], 'ratio must be 0 to 1'),
        (['--lag', '9'], 'lags must be within'),
        (['--bias', '-1'], 'bias must be 0 or more'),
        (['--seed', '-1'], '--seed must be 0 or more'),
    ],
)
def test_values_out_of_range_are_refused(
    options: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 2, one line, nothing written."""
    assert simulate.main([*SHORT, '--output', str(tmp_path / 'demo'), *options]) == 2
    assert message in capsys.readouterr().err
    assert names_in(tmp_path) == set()


def test_missing_parent_folder_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It is not created: a typo would leave folders about."""
    assert simulate.main([*SHORT, '--output', str(tmp_path / 'no/demo')]) == 2
    assert 'is no folder: create it first' in capsys.readouterr().err


def test_place_that_cannot_be_written_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With the words of the operating system: here a name as long as names may be."""
    assert simulate.main([*SHORT, '--output', str(tmp_path / ('n' * 250))]) == 2
    assert 'cannot be written: File name too long' in capsys.readouterr().err
    assert names_in(tmp_path) == set()


def test_older_recording_survives_a_failure_of_the_last_step(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between taking the old one away and putting the new one there, the disk fails."""
    output = tmp_path / 'demo'
    assert simulate.main([*SHORT, '--output', str(output)]) == 0
    before = (output / 'truth.yaml').read_bytes()
    rename = Path.rename

    def fail_at_last(self: Path, target: Path) -> Path:
        if self.name == 'finished':
            raise OSError(28, 'No space left on device')
        return rename(self, target)

    monkeypatch.setattr(Path, 'rename', fail_at_last)
    assert simulate.main([*SHORT, '--output', str(output), '--seed', '1', '--force']) == 2
    assert names_in(tmp_path) == {'demo'}
    assert (output / 'truth.yaml').read_bytes() == before


@pytest.mark.parametrize('stop', [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize('forced', [False, True])
def test_stopped_run_leaves_nothing_behind(
    stop: signal.Signals, tmp_path: Path, *, forced: bool
) -> None:
    """Stopped while it writes: no half-written folder, and an older recording is untouched."""
    output = tmp_path / 'demo'
    if forced:
        assert simulate.main([*SHORT, '--output', str(output)]) == 0
    before = {p: p.read_bytes() for p in output.rglob('*') if p.is_file()}
    command = [sys.executable, '-m', 'rpgd_ros.apps.simulate', '--preset', 'studio']
    command += ['--seconds', '400', '--output', str(output), *(['--force'] if forced else [])]
    project = Path(__file__).parent.parent
    process = subprocess.Popen(command, stderr=subprocess.PIPE, cwd=project)
    deadline = time.monotonic() + 60.0
    while not list(tmp_path.glob('.demo.*.tmp/.bag.*/*/*')) and process.poll() is None:
        assert time.monotonic() < deadline, 'no bag was begun'
        time.sleep(0.01)
    process.send_signal(stop)
    _, complaint = process.communicate(timeout=20.0)
    assert process.returncode == 130
    assert b'Traceback' not in complaint
    assert b'nothing was written' in complaint
    assert names_in(tmp_path) == ({'demo'} if forced else set())
    assert {p: p.read_bytes() for p in output.rglob('*') if p.is_file()} == before


def test_dataset_is_written_in_its_own_layout(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The tree and nothing else; the next command is told."""
    output = tmp_path / 'twin'
    options = ['--preset', 'aistpp', '--format', 'dataset', '--sequences', '2', '--seconds', '1']
    assert simulate.main([*options, '--output', str(output)]) == 0
    assert names_in(tmp_path) == {'twin'}
    assert names_in(output) == {'cameras', 'keypoints2d', 'keypoints3d', 'ignore_list.txt'}
    assert len(names_in(output / 'keypoints2d')) == 2
    assert f'next: evaluate {output} --dataset aistpp' in capsys.readouterr().out
    assert simulate.main([*options, '--output', str(output), '--force']) == 2
    assert len(names_in(output / 'keypoints2d')) == 2


@pytest.mark.parametrize(
    ('options', 'message'),
    [
        (['--preset', 'studio'], 'studio is no dataset'),
        (['--preset', 'aistpp', '--sequences', '0'], '--sequences must be 1 or more'),
        (['--preset', 'aistpp', '--force'], 'never datasets'),
    ],
)
def test_dataset_that_cannot_be_is_refused(
    options: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nothing is left behind."""
    line = [*options, '--format', 'dataset', '--output', str(tmp_path / 'twin')]
    assert simulate.main(line) == 2
    assert message in capsys.readouterr().err
    assert names_in(tmp_path) == set()
