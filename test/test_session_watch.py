# SPDX-License-Identifier: Apache-2.0
"""The watch over an accepted pose: what it names, how soon, and what it leaves in peace."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from walks import Reel, walk

from rpgd_ros.core.geometry import RigidTransform
from rpgd_ros.core.linearise import Sight
from rpgd_ros.session.levels import MIN_FRAMES, Level, agreed, levels
from rpgd_ros.session.recent import Pairs
from rpgd_ros.session.watch import Watch
from rpgd_ros.simulation import Faults

ACCEPTED_S = 10.0  # of the recording, before the watch begins
BUMP_S = 18.0
SOON_S = 10.0  # within which a camera must be named
TURN = np.array([0.3, 0.9, 0.1]) / np.linalg.norm([0.3, 0.9, 0.1])


def watched(reel: Reel, pose: RigidTransform) -> Watch:
    """Return a watch over a pose that was accepted after ten seconds."""
    watch = Watch()
    watch.accept(pose, levels(reel.sights(0.0, ACCEPTED_S), pose), is_automatic=False)
    return watch


def named_after(reel: Reel, watch: Watch, end_s: float) -> dict[str, float]:
    """Watch to the end; return when each camera was first raised, in seconds since the bump."""
    found: dict[str, float] = {}
    for now, pairs in reel.ticks(ACCEPTED_S, end_s):
        watch.add(pairs)
        for name in watch.raised:
            found.setdefault(name, now - BUMP_S)
    return found


@pytest.mark.parametrize('seed', range(20))
def test_clean_recording_raises_nothing(seed: int) -> None:
    """Not with the detector of the studio, nor where its joints lie 2 cm from the MoCap's."""
    faults = Faults(bias_m=0.02) if seed % 2 else Faults()
    recording = walk(seed, seconds=40.0, faults=faults)
    reel, pose = Reel(recording), recording.truth.world_T_mocap
    assert named_after(reel, watched(reel, pose), 40.0) == {}


@pytest.mark.parametrize('seed', range(6))
def test_bumped_camera_is_named_within_ten_seconds_and_no_other(seed: int) -> None:
    """A third of a degree is 7 px here; the others keep their peace."""
    recording = walk(seed, seconds=34.0)
    reel, pose = Reel(recording), recording.truth.world_T_mocap
    number = seed % 4
    reel.bump(number, 0.35 * TURN, at_s=BUMP_S)
    watch = watched(reel, pose)
    found = named_after(reel, watch, 34.0)
    assert list(found) == [f'cam{number}']
    assert 0.0 < found[f'cam{number}'] <= SOON_S
    complaint = watch.complaint()
    assert f'camera cam{number} is off by' in complaint
    assert 'bumped' in complaint


@pytest.mark.parametrize('seed', range(4))
def test_bump_is_found_in_spite_of_a_biased_detector(seed: int) -> None:
    """Joints that lie 2 cm per axis from the MoCap's hide a third of a degree, not a whole one."""
    recording = walk(seed, seconds=34.0, faults=Faults(bias_m=0.02))
    reel, pose = Reel(recording), recording.truth.world_T_mocap
    reel.bump(1, 1.0 * TURN, at_s=BUMP_S)
    found = named_after(reel, watched(reel, pose), 34.0)
    assert list(found) == ['cam1']
    assert 0.0 < found['cam1'] <= SOON_S


def test_slow_drift_is_named_although_calibrations_follow_it() -> None:
    """A mount that sags by 0.02 deg a second; each automatic run takes the error for normal."""
    recording = walk(3, seconds=60.0)
    reel, pose = Reel(recording), recording.truth.world_T_mocap
    for second in range(12, 60):
        reel.bump(2, 0.02 * TURN, at_s=float(second))
    watch = watched(reel, pose)
    named_s = None
    for now, pairs in reel.ticks(ACCEPTED_S, 60.0):
        watch.add(pairs)
        if now % 10.0 == 0.0:
            watch.accept(pose, levels(reel.sights(now - 10.0, now), pose), is_automatic=True)
        if watch.raised and named_s is None:
            named_s = now
    assert watch.raised == ('cam2',)
    assert named_s is not None
    assert named_s < 35.0  # 0.46 deg of drift


def test_camera_that_is_put_back_is_cleared_after_a_while_only() -> None:
    """Hysteresis: raised once, cleared once, whatever happens at the limit."""
    recording = walk(1, seconds=50.0)
    reel, pose = Reel(recording), recording.truth.world_T_mocap
    reel.bump(0, 0.5 * TURN, at_s=15.0)
    reel.bump(0, -0.5 * TURN, at_s=30.0)
    watch = watched(reel, pose)
    told = []
    for now, pairs in reel.ticks(ACCEPTED_S, 50.0):
        watch.add(pairs)
        told.append((now, bool(watch.raised)))
    changes = [now for (now, is_raised), (_, was) in zip(told[1:], told, strict=False)
               if is_raised != was]  # fmt: skip
    assert len(changes) == 2
    assert changes[0] < 15.0 + SOON_S
    assert 30.0 + 5.0 < changes[1] < 30.0 + 12.0


def test_error_at_the_limit_does_not_flap() -> None:
    """A camera that wavers about its limit every few seconds changes its state once at most."""
    recording = walk(5, seconds=60.0)
    reel, pose = Reel(recording), recording.truth.world_T_mocap
    for second in range(12, 60, 4):
        sign = 1.0 if second % 8 else -1.0
        reel.bump(3, sign * 0.09 * TURN, at_s=float(second))
    watch = watched(reel, pose)
    states = []
    for _, pairs in reel.ticks(ACCEPTED_S, 60.0):
        watch.add(pairs)
        states.append(bool(watch.raised))
    assert int(np.abs(np.diff(np.array(states, np.int64))).sum()) <= 1


def test_a_few_wrong_frames_raise_nothing() -> None:
    """A detector that follows somebody else for a second is not a bumped camera."""
    recording = walk(7, seconds=30.0)
    reel, pose = Reel(recording), recording.truth.world_T_mocap
    reel.bump(1, 5.0 * TURN, at_s=20.0)
    reel.bump(1, -5.0 * TURN, at_s=21.0)
    assert named_after(reel, watched(reel, pose), 30.0) == {}


def test_all_cameras_at_once_are_not_blamed_one_by_one() -> None:
    """The MoCap was calibrated again: nobody bumped four cameras."""
    recording = walk(2, seconds=20.0)
    reel, pose = Reel(recording), recording.truth.world_T_mocap
    watch = watched(reel, pose)
    moved = RigidTransform(np.eye(3), np.array([0.1, 0.0, 0.05]))
    for number, view in enumerate(reel.views):
        reel.views[number] = type(view)(
            view.stamp_ns, moved @ view.x_mocap, view.uv, view.confidence
        )
    for _, pairs in reel.ticks(ACCEPTED_S, 20.0):
        watch.add(pairs)
    assert len(watch.raised) == 4
    assert 'MoCap' in watch.complaint()
    assert 'bumped' not in watch.complaint()


def test_silent_camera_is_neither_raised_nor_cleared() -> None:
    """Nothing seen is nothing known."""
    recording = walk(4, seconds=30.0)
    reel, pose = Reel(recording), recording.truth.world_T_mocap
    reel.bump(0, 0.5 * TURN, at_s=12.0)
    watch = watched(reel, pose)
    for _, pairs in reel.ticks(ACCEPTED_S, 20.0):
        watch.add(pairs)
    assert watch.raised == ('cam0',)
    for _, pairs in reel.ticks(20.0, 30.0):
        watch.add([new for new in pairs if new.camera.name != 'cam0'])
    assert watch.raised == ('cam0',)


def test_camera_that_contradicts_the_pose_has_the_level_of_the_others() -> None:
    """A calibration without it is accepted, and it stays named until it is mended."""
    given = {'cam0': Level(2.0), 'cam1': Level(3.0), 'cam2': Level(40.0)}
    assert agreed(given, ['cam2'])['cam2'].error_px == pytest.approx(1.25 * 2.5)
    assert agreed(given, ['cam2'])['cam0'].error_px == 2.0
    assert agreed({'cam0': Level(9.0)}, ['cam0'])['cam0'].error_px == 9.0


def test_level_of_a_file_gives_way_to_that_of_the_first_run() -> None:
    """The file tells the mean error alone; the run, how it is spread and shifted."""
    recording = walk(8, seconds=30.0, faults=Faults(bias_m=0.02))
    reel, pose = Reel(recording), recording.truth.world_T_mocap
    watch = Watch()
    kept = {f'cam{v}': Level.kept(9.0) for v in range(4)}
    watch.accept(pose, kept, is_automatic=False)
    for _, pairs in reel.ticks(0.0, 12.0):
        watch.add(pairs)
    assert watch.raised == ()
    measured = levels(reel.sights(0.0, 12.0), pose)
    watch.accept(pose, measured, is_automatic=True)
    for _, pairs in reel.ticks(12.0, 30.0):
        watch.add(pairs)
    assert watch.raised == ()
    assert watch.states()['cam0'].level_px == measured['cam0'].error_px


def test_kept_level_finds_a_bump_as_well() -> None:
    """With more room: half a degree is 10 px here."""
    recording = walk(9, seconds=16.0)
    reel, pose = Reel(recording), recording.truth.world_T_mocap
    reel.bump(3, 0.6 * TURN, at_s=0.0)
    watch = Watch()
    watch.accept(pose, {f'cam{v}': Level.kept(3.5) for v in range(4)}, is_automatic=False)
    for _, pairs in reel.ticks(0.0, 10.0):
        watch.add(pairs)
    assert watch.raised == ('cam3',)


def test_named_camera_that_a_calibration_did_not_see_is_judged_by_its_old_level() -> None:
    """It stays named while it is off, beside another one, and no longer once it is put back."""
    recording = walk(0, seconds=46.0)
    reel, pose = Reel(recording), recording.truth.world_T_mocap
    for number in (0, 2):
        reel.bump(number, 0.5 * TURN, at_s=12.0)
        reel.bump(number, -0.5 * TURN, at_s=28.0)
    watch = watched(reel, pose)
    known = levels(reel.sights(0.0, ACCEPTED_S), pose)
    for _, pairs in reel.ticks(ACCEPTED_S, 20.0):
        watch.add(pairs)
    assert watch.raised == ('cam0', 'cam2')
    del known['cam2']
    watch.accept(pose, known, is_automatic=True)
    for _, pairs in reel.ticks(20.0, 26.0):
        watch.add(pairs)
    assert watch.raised == ('cam0', 'cam2')
    first, second = watch.complaint().split('; ')
    assert first.startswith('camera cam0 is off by')
    assert second.startswith('camera cam2 is off by')
    assert watch.states()['cam2'].is_raised
    for _, pairs in reel.ticks(26.0, 46.0):
        watch.add(pairs)
    assert not watch.raised
    assert watch.complaint() == ''


def test_camera_that_a_calibration_did_not_see_is_named_when_it_is_moved_later() -> None:
    """Nobody was there to see it: that is no reason to let it go."""
    recording = walk(0, seconds=30.0)
    reel, pose = Reel(recording), recording.truth.world_T_mocap
    reel.bump(2, 0.5 * TURN, at_s=BUMP_S)
    watch = watched(reel, pose)
    known = levels(reel.sights(0.0, ACCEPTED_S), pose)
    del known['cam2']
    watch.accept(pose, known, is_automatic=True)
    assert list(named_after(reel, watch, 30.0)) == ['cam2']


def later(pairs: list[Pairs], seconds: float) -> list[Pairs]:
    """Return the same frames at a later time."""
    by_ns = round(seconds * 1e9)
    return [
        replace(new, view=replace(new.view, stamp_ns=new.view.known_stamp_ns + by_ns))
        for new in pairs
    ]


@pytest.fixture(scope='module')
def bumped() -> tuple[Reel, RigidTransform]:
    """Return sixteen seconds, of which the first camera was bumped after ten."""
    recording = walk(1, seconds=16.0)
    reel = Reel(recording)
    reel.bump(0, 0.6 * TURN, at_s=ACCEPTED_S)
    return reel, recording.truth.world_T_mocap


def test_camera_that_comes_back_after_long_is_judged_afresh(
    bumped: tuple[Reel, RigidTransform],
) -> None:
    """A second over the limit, and one half a minute later, are not half a minute."""
    reel, pose = bumped
    watch = watched(reel, pose)
    for _, pairs in reel.ticks(10.0, 11.5):
        watch.add(pairs)
    for _, pairs in reel.ticks(11.5, 13.0):
        watch.add(later(pairs, 30.0))
    assert 'cam0' not in watch.raised
    for _, pairs in reel.ticks(13.0, 15.0):
        watch.add(later(pairs, 30.0))
    assert watch.raised == ('cam0',)


def test_raised_camera_that_sees_nobody_is_said_to_see_nobody(
    bumped: tuple[Reel, RigidTransform],
) -> None:
    """Its old error is not that of now."""
    reel, pose = bumped
    watch = watched(reel, pose)
    for _, pairs in reel.ticks(10.0, 15.0):
        watch.add(pairs)
    assert 'is off by' in watch.complaint()
    watch.restart()
    assert watch.complaint() == 'camera cam0 no longer fits the transform, and sees nobody now'


def test_camera_that_was_not_there_at_acceptance_is_shown_but_not_judged(
    bumped: tuple[Reel, RigidTransform],
) -> None:
    """There is nothing to compare its error with."""
    reel, pose = bumped
    watch = Watch()
    known = levels(reel.sights(0.0, ACCEPTED_S), pose)
    del known['cam0']
    watch.accept(pose, known, is_automatic=False)
    for _, pairs in reel.ticks(10.0, 16.0):
        watch.add(pairs)
    state = watch.states()['cam0']
    assert state.error_px > 3.0 * watch.states()['cam1'].error_px
    assert np.isnan(state.level_px)
    assert watch.raised == ()


def test_too_little_seen_is_not_judged(bumped: tuple[Reel, RigidTransform]) -> None:
    """Some frames, nobody in them, or a camera of which nobody knows where it stands."""
    reel, pose = bumped
    watch = watched(reel, pose)
    (new,) = (p for p in reel.pairs(10.0, 10.2) if p.camera.name == 'cam0')
    assert new.view.n_frames < MIN_FRAMES
    nobody = replace(new.view, uv=np.full_like(new.view.uv, np.nan))
    unplaced = replace(new.camera, camera_T_world=None)
    watch.add([replace(new, view=nobody), replace(new, camera=unplaced)])
    assert watch.states() == {}
    watch.add([new])
    assert np.isnan(watch.states()['cam0'].error_px)
    assert levels([Sight(new.camera, new.view)], pose) == {}


def test_joints_that_are_seen_in_turn_tell_of_no_lasting_offset(
    bumped: tuple[Reel, RigidTransform],
) -> None:
    """A median over joints that are hardly ever there would be one of noise."""
    reel, pose = bumped
    (sight, *_) = reel.sights(0.0, 3.0)
    assert levels([sight], pose)['cam0'].bias_px > 0.0
    n_frames, n_joints = sight.view.uv.shape[:2]
    uv = np.full_like(sight.view.uv, np.nan)
    for frame in range(0, n_frames, 8):
        shown = (frame // 8 * 3 + np.arange(3)) % n_joints
        uv[frame, shown] = sight.view.uv[frame, shown]
    level = levels([Sight(sight.camera, replace(sight.view, uv=uv))], pose)['cam0']
    assert level.error_px > 0.0
    assert level.bias_px == 0.0
