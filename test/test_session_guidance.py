# SPDX-License-Identifier: Apache-2.0
"""Coverage, expected sigma and advice, on simulated walks."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from studio import feed, make_studio, without_poses
from walks import Reel, play, walk

from rpgd_ros.core import CalibrationConfig, CalibrationError, RigidTransform, calibrate
from rpgd_ros.core.config import AcceptConfig
from rpgd_ros.core.geometry import so3_exp
from rpgd_ros.core.linearise import Sight
from rpgd_ros.core.observations import NS_PER_S, View
from rpgd_ros.pairing import BufferConfig
from rpgd_ros.session import Session, SessionConfig, solve
from rpgd_ros.session.coverage import (
    MAX_ROOM_CELLS,
    Coverage,
    ImageCoverage,
    RoomCoverage,
)
from rpgd_ros.session.expect import Expectation, Expected
from rpgd_ros.session.guidance import Guidance
from rpgd_ros.session.monitor import Monitor, appraise
from rpgd_ros.session.recent import Recent
from rpgd_ros.simulation import Faults, build_scene, preset, simulate
from rpgd_ros.simulation.export import rig_of
from rpgd_ros.simulation.motion import MotionName


def covered(reel: Reel, begin_s: float, end_s: float, *, max_age_s: float = 300.0) -> Coverage:
    """Return the coverage of a stretch of time, fed by half seconds."""
    coverage = Coverage(max_age_s)
    for _, pairs in reel.ticks(begin_s, end_s):
        coverage.add(pairs)
    return coverage


def test_each_pair_is_handed_out_once() -> None:
    """Live, in small pieces, the same frames as the snapshot of the whole recording has."""
    recording = walk(0, seconds=6.0)
    session = Session(rig_of(recording))
    recent = Recent(session)
    found: dict[str, list[int]] = {}
    for _ in play(recording, session):
        for new in recent.take():
            assert new.view.stamp_ns is not None
            found.setdefault(new.camera.name, []).extend(new.view.stamp_ns.tolist())
    for new in recent.take():
        assert new.view.stamp_ns is not None
        found.setdefault(new.camera.name, []).extend(new.view.stamp_ns.tolist())
    snapshot = session.snapshot()
    for camera, view in zip(snapshot.cameras, snapshot.observations.views, strict=True):
        assert view.stamp_ns is not None
        assert found[camera.name] == view.stamp_ns.tolist()
    assert recent.take() == []


def test_coverage_in_pieces_is_that_of_the_whole() -> None:
    """The sums do not depend on how often somebody looks."""
    reel = Reel(walk(1, seconds=12.0))
    pieces, whole = covered(reel, 0.0, 12.0), Coverage(300.0)
    whole.add(reel.pairs(0.0, 12.0))
    for camera in reel.cameras:
        assert np.array_equal(pieces.image(camera.name).seen, whole.image(camera.name).seen)
        assert pieces.image(camera.name).n_pairs == whole.image(camera.name).n_pairs
    assert pieces.room() == whole.room()
    assert pieces.seconds == whole.seconds == pytest.approx(12.0, abs=1.1)


def test_walk_through_the_room_covers_more_than_a_walk_on_the_spot() -> None:
    """Of every image, and of the floor."""
    far, near = (
        covered(Reel(walk(2, seconds=30.0, motion=motion)), 0.0, 30.0)
        for motion in ('walk', 'still')
    )
    for name in ('cam0', 'cam1', 'cam2', 'cam3'):
        assert far.image(name).share > 1.5 * near.image(name).share
    assert far.room().area_m2 > 4.0 * near.room().area_m2
    assert far.room().extent_m[0] > 2.0


def test_coverage_forgets_what_has_left_the_buffer() -> None:
    """Ten seconds are kept: those in which the person stood in the other half are gone."""
    reel = Reel(walk(3, seconds=40.0))
    kept = covered(reel, 0.0, 40.0, max_age_s=30.0)
    everything = covered(reel, 0.0, 40.0)
    assert kept.seconds == pytest.approx(30.0, abs=2.0)
    assert kept.image('cam0').n_pairs < 0.85 * everything.image('cam0').n_pairs


def test_bodies_scattered_over_everywhere_do_not_fill_the_memory() -> None:
    """Damaged skeletons may stand anywhere: the floor is counted to a bound."""
    reel = Reel(walk(4, seconds=1.0))
    (new, *_) = reel.pairs(0.0, 1.0)
    n_places = MAX_ROOM_CELLS + 10
    coverage = Coverage(300.0)
    coverage.add([])
    assert coverage.room().area_m2 == 0.0
    x = np.zeros((n_places, 1, 3))
    x[:, 0, 0] = np.arange(n_places)
    for by in (0.0, 1e5):
        there = View(np.arange(n_places) + 10**12, x + by, np.full((n_places, 1, 2), 9.0))
        coverage.add([replace(new, view=there)])
    assert coverage.room().extent_m[0] == pytest.approx(n_places, abs=1.0)
    assert coverage.image(new.camera.name).n_pairs == 2 * n_places


def test_coverage_follows_a_buffer_that_is_changed() -> None:
    """What a shorter one lets go is no longer counted; a longer one goes on from there."""
    reel = Reel(walk(1, seconds=20.0))
    coverage = covered(reel, 0.0, 12.0)
    cameras = [camera.name for camera in reel.cameras]
    before = {name: coverage.image(name).n_pairs for name in cameras}
    coverage.resize(600.0)
    assert {name: coverage.image(name).n_pairs for name in cameras} == before
    assert coverage.seconds == pytest.approx(12.0, abs=1.1)
    coverage.resize(2.0)
    assert coverage.seconds == pytest.approx(2.0, abs=1.1)
    for _, pairs in reel.ticks(12.0, 16.0):
        coverage.add(pairs)
    fresh = covered(reel, 12.0, 16.0, max_age_s=2.0)
    assert fresh.seconds == coverage.seconds == pytest.approx(2.0, abs=1.1)
    assert coverage.room() == fresh.room()
    for name in cameras:
        assert coverage.image(name).n_pairs == fresh.image(name).n_pairs < before[name]
    coverage.resize(300.0)
    for _, pairs in reel.ticks(16.0, 20.0):
        coverage.add(pairs)
    assert coverage.seconds == pytest.approx(6.0, abs=1.1)


@pytest.mark.parametrize('side', ['left', 'right'])
def test_poorest_side_is_where_nobody_was(side: str) -> None:
    """Keypoints in one half of an image only."""
    reel = Reel(walk(4, seconds=10.0))
    view, width = reel.views[0], reel.cameras[0].size[0]
    outside = (view.uv[..., 0] < width / 2) if side == 'left' else view.uv[..., 0] >= width / 2
    reel.views[0] = replace(view, uv=np.where(outside[..., None], np.nan, view.uv))
    assert covered(reel, 0.0, 10.0).image('cam0').poorest_side == side


@pytest.mark.parametrize(('motion', 'bias_m'), [('walk', 0.0), ('walk', 0.02), ('still', 0.02)])
def test_expected_sigma_is_that_of_the_calibration_to_come(
    motion: MotionName, bias_m: float
) -> None:
    """From a run on eight seconds and the sums of 24 more, within a factor of two."""
    recording = walk(5, seconds=32.0, motion=motion, faults=Faults(bias_m=bias_m))
    reel = Reel(recording)

    def run(end_s: float) -> Any:
        views = tuple(s.view for s in reel.sights(0.0, end_s))
        try:
            observations = replace(reel.observations, views=views)
            return calibrate(recording.cameras, observations, config=CalibrationConfig())
        except CalibrationError as refused:
            return refused.calibration

    first = run(8.0)
    expectation = Expectation(first.world_T_mocap, first.centroid_mocap)
    expectation.add_sights(reel.sights(0.0, 8.0))
    expectation.settle(*first.worst_sigma)
    assert expectation.expected().sigma_deg == pytest.approx(first.worst_sigma[0])
    for _, pairs in reel.ticks(8.0, 32.0):
        for new in pairs:
            expectation.add([new])
    expected = expectation.expected()
    sigma_deg, sigma_m = run(32.0).worst_sigma
    assert 0.5 < expected.sigma_deg / sigma_deg < 2.0
    assert 0.5 < expected.sigma_m / sigma_m < 2.0


def test_pose_that_explains_nothing_has_no_expected_sigma() -> None:
    """A wrong pose would be known very exactly."""
    recording = walk(6, seconds=8.0)
    wrong = RigidTransform(so3_exp([1.0, 1.0, 0.0]), np.array([0.5, 0.5, 0.0]))
    expectation = Expectation(wrong @ recording.truth.world_T_mocap, np.zeros(3))
    for _, pairs in Reel(recording).ticks(0.0, 8.0):
        expectation.add(pairs)
    assert not expectation.expected().is_known


def test_pose_with_the_body_behind_the_camera_has_no_expected_sigma() -> None:
    """No keypoint tells how exact it is."""
    (sight, *_) = Reel(walk(6, seconds=8.0)).sights(0.0, 8.0)
    behind = RigidTransform(np.eye(3), np.array([0.0, 0.0, -1000.0]))
    expectation = Expectation(sight.camera_T_world.inverse() @ behind, np.zeros(3))
    expectation.add_sights([sight])
    assert not expectation.expected().is_known


def test_long_recording_is_known_as_well_as_a_short_one_of_the_same_frames() -> None:
    """Stretches of time are joined and none is lost, which shows where an error wavers."""
    recording = walk(5, seconds=24.0)
    steady, wavering, slow = (
        Expectation(recording.truth.world_T_mocap, np.zeros(3)) for _ in range(3)
    )
    for s in Reel(recording).sights(0.0, 24.0):
        stamp_ns = s.view.known_stamp_ns
        wave_px = 6.0 * np.sin(0.5 * (stamp_ns - stamp_ns[0]) / NS_PER_S)
        view = replace(s.view, uv=s.view.uv + wave_px[:, None, None])
        steady.add_sights([s])
        wavering.add_sights([Sight(s.camera, view)])
        slow.add_sights([Sight(s.camera, replace(view, stamp_ns=8 * stamp_ns))])
    told, expected = wavering.expected(), slow.expected()
    assert told.sigma_deg > 2.0 * steady.expected().sigma_deg
    assert expected.sigma_deg == pytest.approx(told.sigma_deg, rel=0.1)
    assert expected.sigma_m == pytest.approx(told.sigma_m, rel=0.1)


def test_sigma_of_a_run_without_data_is_not_taken_over() -> None:
    """There is nothing that it could be compared with."""
    recording = walk(6, seconds=8.0)
    told, untold = (Expectation(recording.truth.world_T_mocap, np.zeros(3)) for _ in range(2))
    told.settle(0.1, 0.01)
    assert not told.expected().is_known
    for expectation in (told, untold):
        expectation.add_sights(Reel(recording).sights(0.0, 8.0))
    assert untold.expected().is_known
    assert told.expected() == untold.expected()


def guide(**changes: Any) -> Guidance:
    """Return what is known after 41 s of which cam2 has seen little."""
    half_seen = np.zeros((9, 16), np.bool_)
    half_seen[:, 8:] = True
    little = np.zeros((9, 16), np.bool_)
    little[3:5, 12:14] = True
    usual: dict[str, Any] = {
        'seconds': 41.0,
        'motion_m': 2.0,
        'needed_motion_m': 1.0,
        'images': (
            ImageCoverage('cam0', half_seen, 9000),
            ImageCoverage('cam1', half_seen, 9000),
            ImageCoverage('cam2', little, 60),
        ),
        'room': RoomCoverage(4.0, (3.0, 1.5)),
        'expected': Expected(),
        'gates': AcceptConfig(),
    }
    return Guidance(**{**usual, **changes})


def test_sentence_names_the_camera_the_side_and_the_time() -> None:
    """What a person can do at once."""
    assert guide().sentence == (
        'cam2 has seen 3% of its image: walk to the left half of it; 41 of 60 s'
    )


def test_time_that_is_asked_for_follows_from_how_exact_it_is() -> None:
    """Twice too uncertain: four times as long; within the gates: enough."""
    twice = guide(expected=Expected(2.0, 0.01))
    assert twice.wanted_s == pytest.approx(164.0)
    assert '41 of 164 s' in twice.sentence
    assert 'known to 2.00 deg (need 1.00) and 10 mm (need 50) if stopped now' in twice.sentence
    assert twice.progress == pytest.approx(0.25)
    done = guide(expected=Expected(0.2, 0.01))
    assert done.sentence.startswith('41 s are enough; known to 0.20 deg')
    assert done.progress == 1.0


def test_where_all_images_are_full_the_person_is_to_turn() -> None:
    """More of the same walk would not help; an image that was seen evenly has no poorer side."""
    full = np.ones((9, 16), np.bool_)
    images = (ImageCoverage('cam0', full, 9000), ImageCoverage('cam1', full, 9000))
    assert [image.poorest_side for image in images] == ['', '']
    assert guide(images=images).advice == (
        'turn around and cross the room, it was walked over 3.0 x 1.5 m so far'
    )


def test_first_of_all_the_person_has_to_move() -> None:
    """No camera is spoken of before."""
    still = guide(motion_m=0.25)
    assert still.sentence.startswith('Walk through the room: moved 0.2 of 1.0 m')
    assert still.progress == pytest.approx(0.25)


def test_camera_that_saw_nobody_is_named_first() -> None:
    """It may be unplugged; or nobody went there."""
    unseen = ImageCoverage('cam3', np.zeros((9, 16), np.bool_), 0)
    assert guide(images=(*guide().images, unseen)).advice == (
        'cam3 has seen nobody yet: walk in front of it'
    )


def test_nothing_recorded_gives_no_advice_on_cameras() -> None:
    """Waiting for data is another matter."""
    empty = guide(seconds=0.0, motion_m=0.0, images=(), room=RoomCoverage(0.0, (0.0, 0.0)))
    assert empty.advice == ''
    assert empty.progress == 0.0
    assert math.isnan(float(str(empty.figures()['expected_sigma_rotation_deg'])))


def test_session_is_guided_from_the_first_step_to_a_calibration() -> None:
    """Progress grows; after a run the sigma is told, and it is that of the run."""
    recording = walk(7, seconds=16.0)
    session = Session(rig_of(recording))
    monitor = Monitor(session, max_age_s=300.0)
    gates, told = AcceptConfig(), []
    calibration = None
    for now in play(recording, session):
        monitor.look(at_all=False)
        told.append(monitor.guidance(gates, 1.0))
        if calibration is None and now > 8.0:
            snapshot = session.snapshot()
            calibration = solve(snapshot)
            monitor.conclude(appraise(snapshot, calibration), is_accepted=True, is_automatic=True)
    assert calibration is not None
    assert told[0].progress < told[10].progress < told[-1].progress == 1.0
    assert not told[10].expected.is_known
    found = told[-1].expected
    assert found.sigma_deg < 1.2 * calibration.worst_sigma[0]
    assert monitor.watch.complaint() == ''
    assert set(monitor.watch.states()) == {'cam0', 'cam1', 'cam2', 'cam3'}
    session.reset()
    monitor.clear()
    assert monitor.guidance(gates, 1.0).seconds == 0.0


def test_guidance_counts_what_the_buffer_holds() -> None:
    """Its length may be changed while the recording goes on."""
    recording = walk(7, seconds=12.0)
    session = Session(rig_of(recording))
    monitor = Monitor(session, max_age_s=300.0)
    for _ in play(recording, session):
        monitor.look()
    assert monitor.guidance(AcceptConfig(), 1.0).seconds == pytest.approx(12.0, abs=1.1)
    session.update_config(SessionConfig(buffer=BufferConfig(max_age_s=2.0)))
    monitor.resize(max_age_s=2.0)
    stamps = session.parts()[2].store.stamps()
    held_s = float(stamps[-1] - stamps[0]) / NS_PER_S
    found = monitor.guidance(AcceptConfig(), 1.0)
    assert found.seconds == pytest.approx(held_s, abs=1.1)
    assert found.figures()['recorded_s'] == found.seconds


def test_refused_run_tells_how_exact_it_is_and_is_not_watched() -> None:
    """Nobody uses its pose; how far it is from acceptance is what the person wants to know."""
    recording = walk(7, seconds=8.0)
    session = Session(rig_of(recording))
    monitor = Monitor(session, max_age_s=300.0)
    for _ in play(recording, session):
        pass
    snapshot = session.snapshot()
    found = appraise(snapshot, solve(snapshot))
    monitor.conclude(found, is_accepted=False, is_automatic=True)
    monitor.look()
    assert monitor.guidance(AcceptConfig(), 1.0).expected.is_known
    assert monitor.watch.states() == {}


@pytest.mark.parametrize('is_reset', [True, False])
def test_run_on_a_recording_that_is_forgotten_promises_nothing(is_reset: bool) -> None:  # noqa: FBT001
    """A reset, or a jump of the clock, came in while it ran: its pose counts, its data do not."""
    recording = walk(7, seconds=8.0)
    session = Session(rig_of(recording))
    monitor = Monitor(session, max_age_s=300.0)
    for _ in play(recording, session):
        monitor.look()
    snapshot, begun = session.snapshot(), monitor.recording
    found = appraise(snapshot, solve(snapshot))
    if is_reset:
        session.reset()
        monitor.clear()
    else:
        next(now for now in play(recording, session) if now > 1.0)
        assert session.n_epochs == 1
        monitor.look()
    monitor.conclude(found, is_accepted=True, is_automatic=False, recording=begun)
    monitor.look()
    guidance = monitor.guidance(AcceptConfig(), 1.0)
    assert not guidance.expected.is_known
    assert 'are enough' not in guidance.sentence
    assert monitor.recent.pose is found.pose


def test_watch_looks_at_the_person_with_mocap_among_others() -> None:
    """Others in the images come first in half of the messages, and raise nothing."""
    scene = build_scene(preset('studio'), 3, seconds=16.0, persons=3)
    recording = simulate(scene)
    session = Session(rig_of(recording))
    monitor = Monitor(session, max_age_s=300.0)
    is_watched = False
    for now in play(recording, session):
        monitor.look()
        if not is_watched and now > 8.0:
            snapshot = session.snapshot()
            assert snapshot.is_crowd
            found = appraise(snapshot, solve(snapshot))
            monitor.conclude(found, is_accepted=True, is_automatic=True)
            is_watched = True
    assert is_watched
    assert monitor.watch.complaint() == ''
    for state in monitor.watch.states().values():
        assert state.error_px < 1.3 * state.level_px


def test_walk_is_guided_before_anybody_knows_where_the_cameras_stand() -> None:
    """Images fill without extrinsics; a run that places the cameras begins their watch."""
    studio = make_studio(4)
    session = Session(without_poses(studio.rig))
    monitor = Monitor(session, max_age_s=300.0)
    half = len(studio.messages) // 2
    feed(session, studio.messages[:half], together=200)
    monitor.look()
    guidance = monitor.guidance(AcceptConfig(), 1.0)
    assert guidance.seconds == pytest.approx(6.0, abs=1.1)
    assert all(image.share > 0.0 for image in guidance.images)
    assert monitor.recent.cameras() == []
    snapshot = session.snapshot()
    calibration = solve(snapshot)
    found = appraise(snapshot, calibration)
    monitor.conclude(found, is_accepted=True, is_automatic=True)
    feed(session, studio.messages[half:], together=200)
    monitor.look()
    # Half a walk may leave one of them too uncertain to be placed.
    assert len(monitor.recent.cameras()) == len(calibration.camera_poses) >= 3
    assert set(monitor.watch.states()) >= set(calibration.camera_poses)
    assert monitor.watch.complaint() == ''
