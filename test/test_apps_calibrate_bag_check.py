# SPDX-License-Identifier: Apache-2.0
"""Yesterday's result against today's recording: it fits, or what was moved is named."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import report_cases
import yaml

from rpgd_ros.apps import calibrate_bag
from rpgd_ros.core import RigidTransform
from rpgd_ros.core.geometry import so3_exp
from rpgd_ros.io.bag import BagWriter
from rpgd_ros.io.result_file import read_result
from rpgd_ros.io.rig import read_rig, write_rig
from rpgd_ros.simulation import Corruption, Faults, SimulatedRecording, build_scene, preset
from rpgd_ros.simulation import simulate as film
from rpgd_ros.simulation.export import write_recording

SECONDS = 16.0
Run = Callable[..., 'Outcome']


class Outcome(NamedTuple):
    """What a run gave."""

    code: int
    out: str
    err: str


class Studio(NamedTuple):
    """A studio that was calibrated yesterday.

    Attributes:
        rig: Its rig file.
        result: Yesterday's result.
        bag: Yesterday's recording.

    """

    rig: Path
    result: Path
    bag: Path


def today(
    *, turned_deg: float = 0.0, since_s: float = 0.0, faults: Faults | None = None
) -> SimulatedRecording:
    """Film another walk by another person before yesterday's rig.

    Args:
        turned_deg: How far cam2 is turned by now.
        since_s: When it was.
        faults: What else goes wrong.

    """
    before = build_scene(preset('studio'), 0, seconds=SECONDS)
    scene = replace(
        build_scene(preset('studio'), 7, seconds=SECONDS, faults=faults),
        cameras=before.cameras,
        world_T_mocap=before.world_T_mocap,
    )
    recording = film(scene)
    if not turned_deg:
        return recording
    cameras = list(before.cameras)
    turn = RigidTransform(so3_exp([0.0, np.radians(turned_deg), 0.0]), np.zeros(3))
    assert cameras[2].camera_T_world is not None
    cameras[2] = replace(cameras[2], camera_T_world=turn @ cameras[2].camera_T_world)
    later = film(replace(scene, cameras=tuple(cameras)))
    old, new = recording.streams[2], later.streams[2]
    is_later = old.stamp_ns >= old.stamp_ns[0] + round(since_s * 1e9)
    uv = np.where(is_later[:, None, None], new.uv, old.uv)
    streams = list(recording.streams)
    streams[2] = replace(old, uv=uv)
    # The rig file is yesterday's: nobody has noticed.
    return replace(recording, streams=tuple(streams))


@pytest.fixture(scope='module')
def studio(tmp_path_factory: pytest.TempPathFactory) -> Studio:
    """Calibrate from yesterday's walk."""
    folder = tmp_path_factory.mktemp('yesterday')
    write_recording(film(build_scene(preset('studio'), 0, seconds=SECONDS)), folder)
    rig, result = folder / 'rig.yaml', folder / 'result.yaml'
    words = [folder / 'bag', '--rig', rig, '--output', result]
    assert calibrate_bag.main([str(word) for word in words]) == 0
    return Studio(rig, result, folder / 'bag')


@pytest.fixture
def check(capsys: pytest.CaptureFixture[str], studio: Studio, tmp_path: Path) -> Run:
    """Return a function that checks yesterday's result against a recording."""

    def check(recording: SimulatedRecording | Path, *words: object) -> Outcome:
        bag = recording if isinstance(recording, Path) else tmp_path / 'today' / 'bag'
        if not isinstance(recording, Path):
            (tmp_path / 'today').mkdir()
            write_recording(recording, tmp_path / 'today')
        capsys.readouterr()
        arguments = [bag, '--rig', studio.rig, '--check', studio.result, *words]
        code = calibrate_bag.main([str(word) for word in arguments])
        captured = capsys.readouterr()
        assert 'Traceback' not in captured.err
        return Outcome(code, captured.out, ' '.join(captured.err.split()))

    return check


def test_an_unchanged_rig_still_fits(check: Run) -> None:
    """Another walk of another person changes nothing."""
    outcome = check(today())
    assert outcome.code == 0
    assert 'still fits' in outcome.out
    assert outcome.out.count(' fits ') >= 4


def test_the_recording_of_the_result_itself_fits(check: Run, studio: Studio) -> None:
    """With the very error that was accepted."""
    outcome = check(studio.bag, '--json')
    assert outcome.code == 0
    for camera in json.loads(outcome.out)['check']['cameras'].values():
        assert camera['fits'] is True
        assert camera['error_px'] == pytest.approx(camera['accepted_px'], rel=0.05)
        assert camera['shift_px'] < 0.1 * camera['shift_limit_px']


@pytest.mark.parametrize('turned_deg', [0.3, 1.0])
def test_a_bumped_camera_is_named_and_no_other(check: Run, turned_deg: float) -> None:
    """A third of a degree is 6 pixels."""
    outcome = check(today(turned_deg=turned_deg), '--json')
    assert outcome.code == 1
    told = json.loads(outcome.out)
    assert told['status'] == 'does_not_fit'
    assert {n for n, c in told['check']['cameras'].items() if not c['fits']} == {'cam2'}
    assert 'camera cam2 is off by' in told['message']
    assert 'was it bumped?' in told['message']
    assert f'({turned_deg:.1f}' in told['message']


def test_a_camera_bumped_in_mid_recording_is_dated(check: Run) -> None:
    """To a window of four seconds; the first half alone would pass."""
    outcome = check(today(turned_deg=0.6, since_s=8.0), '--json')
    assert outcome.code == 1
    cameras = json.loads(outcome.out)['check']['cameras']
    assert cameras['cam2']['since_s'] == pytest.approx(8.0, abs=4.1)
    assert all(cameras[name]['fits'] for name in ('cam0', 'cam1', 'cam3'))


def test_another_person_before_the_cameras_is_no_moved_camera(check: Run) -> None:
    """All cameras follow somebody without markers: none is blamed."""
    outcome = check(today(faults=Faults(Corruption(0.97, 'person'))))
    assert outcome.code == 1
    assert 'cameras cam0, cam1, cam2, cam3 no longer fit the transform' in outcome.out
    assert 'somebody else' in outcome.out
    assert 'bumped' not in outcome.out


@pytest.mark.parametrize('shift_m', [0.03, 0.5])
def test_a_shifted_mocap_origin_does_not_fit(check: Run, shift_m: float) -> None:
    """All cameras see it alike, and no camera is blamed."""
    recording = today()
    mocap = recording.mocap
    moved = replace(mocap, x_mocap=mocap.x_mocap + np.array([shift_m, 0.0, 0.0]))
    outcome = check(replace(recording, mocap=moved))
    assert outcome.code == 1
    assert 'was the MoCap calibrated again' in outcome.out
    assert 'bumped' not in outcome.out


def test_a_camera_that_sees_nobody_is_no_camera_that_fits(check: Run) -> None:
    """It was on yesterday: nothing says that it stands where it stood."""
    recording = today()
    streams = list(recording.streams)
    streams[1] = replace(streams[1], uv=np.full_like(streams[1].uv, np.nan))
    outcome = check(replace(recording, streams=tuple(streams)))
    assert outcome.code == 1
    assert 'camera cam1 has seen too little' in outcome.out


def test_a_moved_camera_fits_again_with_the_place_that_was_found_for_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The old rig file does not fit, the one with the new place does."""
    monkeypatch.setattr(report_cases, 'SECONDS', 25.0)
    report_cases.bumped(tmp_path)
    names = ('p.yaml', 'result.yaml', 'rig.yaml', 'new.yaml', 'bag')
    params, result, old, new, bag = (str(tmp_path / name) for name in names)
    Path(params).write_text(
        '/**: {ros__parameters: {rig: {on_bumped_camera: re-estimate}}}', encoding='utf-8'
    )
    words = ['--params', params, '--output', result, '--write-rig', new]
    assert calibrate_bag.main([bag, '--rig', old, *words]) == 0
    assert 'cam2 was moved' in capsys.readouterr().out
    assert calibrate_bag.main([bag, '--rig', old, '--check', result]) == 1
    assert 'camera cam2 is off by' in capsys.readouterr().out
    assert calibrate_bag.main([bag, '--rig', new, '--check', result]) == 0


def test_cameras_can_be_left_out_of_the_check(check: Run, studio: Studio) -> None:
    """What is not asked for is not judged, and said so."""
    outcome = check(studio.bag, '--cameras', 'cam0', 'cam3')
    assert outcome.code == 0
    assert 'camera cam1 of the result is not looked at' in outcome.err


def test_one_camera_alone_is_not_blamed_with_certainty(check: Run) -> None:
    """Its own move looks like that of the MoCap's origin."""
    outcome = check(today(turned_deg=1.0), '--cameras', 'cam2')
    assert outcome.code == 1
    assert 'one camera alone does not tell' in outcome.out


def test_a_result_of_an_older_version_is_checked_as_well(
    check: Run, studio: Studio, tmp_path: Path
) -> None:
    """It tells the mean error of each camera only: large moves are found."""
    tree = yaml.safe_load(studio.result.read_text())
    del tree['levels']
    old = tmp_path / 'old.yaml'
    old.write_text(yaml.safe_dump(tree))
    assert check(studio.bag, '--check', old).code == 0
    outcome = check(today(turned_deg=1.0), '--check', old)
    assert outcome.code == 1
    assert 'camera cam2' in outcome.out


def test_nothing_is_solved_nor_written(check: Run, studio: Studio) -> None:
    """The result file stays as it is, and outputs are refused before the work."""
    before = studio.result.read_bytes()
    refused = check(studio.bag, '--report', 'report.html')
    assert refused.code == calibrate_bag.EXIT_BAD_INPUT
    assert 'nothing for --report' in refused.err
    assert studio.result.read_bytes() == before
    assert not Path('report.html').exists()


def test_a_result_of_another_world_is_bad_input(
    check: Run, studio: Studio, tmp_path: Path
) -> None:
    """Its numbers mean something else."""
    other = tmp_path / 'other.yaml'
    text = studio.result.read_text()
    other.write_text(text.replace('world_frame: world', 'world_frame: hall', 1))
    assert read_result(other).world_frame == 'hall'
    outcome = check(studio.bag, '--check', other)
    assert outcome.code == calibrate_bag.EXIT_BAD_INPUT
    assert "is of world frame 'hall', the rig file has 'world'" in outcome.err


def test_a_result_without_any_of_the_cameras_is_bad_input(
    check: Run, studio: Studio, tmp_path: Path
) -> None:
    """Nothing can be compared."""
    tree = yaml.safe_load(studio.result.read_text())
    tree['cameras'], tree['levels'] = {}, {}
    (tmp_path / 'none.yaml').write_text(yaml.safe_dump(tree))
    outcome = check(studio.bag, '--check', tmp_path / 'none.yaml')
    assert outcome.code == calibrate_bag.EXIT_BAD_INPUT
    assert 'knows none of the cameras cam0, cam1, cam2, cam3' in outcome.err


def test_a_recording_without_skeletons_is_bad_input(check: Run, tmp_path: Path) -> None:
    """Not a transform that does not fit."""
    with BagWriter(tmp_path / 'empty'):
        pass
    assert check(tmp_path / 'empty').code == calibrate_bag.EXIT_BAD_INPUT


def test_a_video_that_lags_as_yesterday_still_fits(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """The clock offsets of the result are applied, those of the rig file included."""
    late = Faults(lag_s=0.06)
    before = build_scene(preset('studio'), 0, seconds=SECONDS, faults=late)
    for name, recording in (('a', film(before)), ('b', today(faults=late))):
        (tmp_path / name).mkdir()
        write_recording(recording, tmp_path / name)
    rig = read_rig(tmp_path / 'a' / 'rig.yaml')
    told = replace(rig, cameras=tuple(replace(c, time_offset_s=0.02) for c in rig.cameras))
    write_rig(tmp_path / 'rig.yaml', told)
    result = tmp_path / 'r.yaml'
    words = ['--rig', str(tmp_path / 'rig.yaml')]
    first = [str(tmp_path / 'a' / 'bag'), *words, '--output', str(result)]
    assert calibrate_bag.main(first) == 0
    assert calibrate_bag.main([str(tmp_path / 'b' / 'bag'), *words, '--check', str(result)]) == 0
    capsys.readouterr()
