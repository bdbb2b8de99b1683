# SPDX-License-Identifier: Apache-2.0
"""Slow tracks, gaps, late comers, two skeletons: what recordings do to questions of time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scenes
from core_cases import sights_of

from rpgd_ros.core import CalibrationConfig, Crowd, MocapTrack, Observations, View, calibrate
from rpgd_ros.core.agreement import lasts_long
from rpgd_ros.core.body_frame import body_frames
from rpgd_ros.core.candidates import assemble
from rpgd_ros.core.config import TimeConfig
from rpgd_ros.core.drift import find_drift
from rpgd_ros.core.examine import TIME_BLOCKS, time_blocks
from rpgd_ros.core.geometry import Array, RigidTransform, so3_exp
from rpgd_ros.core.linearise import Sight
from rpgd_ros.core.noise_fit import noise_at
from rpgd_ros.core.search import coarse_offset
from rpgd_ros.core.settle import some_skeletons
from rpgd_ros.core.timeline import Timeline, track_noise_m
from rpgd_ros.simulation import Twin

TIMED = CalibrationConfig(time=TimeConfig(estimate_offset='per_camera'))
RATED = CalibrationConfig(time=TimeConfig(estimate_offset='per_camera', estimate_rate=True))


def late_comer(case: Twin, n_before: int) -> Twin:
    """Return the scene after many frames without anybody."""

    def after(part: Array) -> Array:
        return np.concatenate([np.full((n_before, *part.shape[1:]), np.nan), part])

    track = case.observations.mocap
    assert track is not None
    step = int(track.stamp_ns[1] - track.stamp_ns[0])
    views = []
    for view in case.observations.views:
        assert view.stamp_ns is not None
        before = view.stamp_ns[0] - step * np.arange(n_before, 0, -1)
        stamp_ns = np.concatenate([before, view.stamp_ns])
        views.append(View(stamp_ns, after(view.x_mocap), after(view.uv)))
    before = track.stamp_ns[0] - step * np.arange(n_before, 0, -1)
    whole = MocapTrack(np.concatenate([before, track.stamp_ns]), after(track.x_mocap))
    return case._replace(observations=Observations(tuple(views), whole))


@pytest.mark.parametrize('fps', [5.0, 8.0, 10.0, 12.5])
def test_slow_track_has_no_gap_at_each_of_its_steps(fps: float) -> None:
    """Ten frames a second at a time of day, where each step is rounded differently."""
    stamp_ns = np.round((1.7e9 + np.arange(600) / fps) * 1e9).astype(np.int64)
    timeline = Timeline(MocapTrack(stamp_ns, np.zeros((600, 1, 3))))
    x, _ = timeline.at(timeline.seconds(stamp_ns))
    assert np.isfinite(x).all()


def test_smoothing_does_not_reach_across_a_gap() -> None:
    """A noisy track that was away for five seconds: what is there is where it was measured."""
    t = np.r_[0:90, 240:330] / 30.0
    x = np.stack([1.2 * t, np.sin(t), np.ones_like(t)], -1)[:, None]
    timeline = Timeline(MocapTrack(np.round(t * 1e9).astype(np.int64), x), is_noisy=True)
    asked = np.r_[t[85:90], t[85:89] + 1 / 60, t[90:95]]
    seen, _ = timeline.at(asked)
    np.testing.assert_allclose(seen[:, 0, 0], 1.2 * asked, atol=0.002)


def test_noise_of_a_track_is_that_of_the_person_who_comes_late() -> None:
    """Two minutes of nobody are no exact skeleton."""
    x = np.random.default_rng(0).normal(0.0, 0.01, (5000, 4, 3))
    x[:4000] = np.nan
    track = MocapTrack(np.arange(5000) * 33_333_333, x)
    assert track_noise_m(track) == pytest.approx(0.01, rel=0.1)


def test_clock_that_runs_wrong_is_right_where_the_person_came_late() -> None:
    """The middle that its offset belongs to is that of the recording, whatever is looked at."""
    case = late_comer(scenes.scene(frames=1500, seed=2), 6_000)
    views = list(case.observations.views)
    stamp_ns = views[2].known_stamp_ns
    wrong = np.round(1e-3 * (stamp_ns - stamp_ns[0])).astype(np.int64)
    views[2] = replace(views[2], stamp_ns=stamp_ns + wrong)
    observations = replace(case.observations, views=tuple(views))
    found = calibrate(case.cameras, observations, config=RATED)
    name = case.cameras[2].name
    assert found.clock_rate[name][0] == pytest.approx(1e-3, rel=0.1)
    middle_s = 0.5 * float(stamp_ns[-1] - stamp_ns[0]) / 1e9
    offset_s, sigma_s = found.time_offset_s[name]
    assert abs(offset_s - 1e-3 * middle_s) < max(4.0 * sigma_s, 0.001)
    assert found.warnings == ()
    _, error_m = scenes.errors(found.world_T_mocap, case.truth.world_T_mocap, case.observations)
    assert error_m < 0.001


def test_body_of_a_late_comer_has_a_frame_all_the_same() -> None:
    """A few seconds of a person in an hour of film: they are what is looked at."""
    case = late_comer(scenes.scene(frames=150, seed=1), 100_000)
    track = case.observations.mocap
    x = some_skeletons(sights_of(case), track)
    assert len(x) == np.isfinite(x[:, 0, 0]).sum() == 150
    assert body_frames(x)


@pytest.mark.parametrize('total_m', [0.02, 0.2, 0.4])
def test_drift_is_told_however_large(total_m: float) -> None:
    """A stretch that is many sigmas from the middle is looked at where it is."""
    case = scenes.scene(frames=1500, seed=3)
    sights = []
    for s in sights_of(case):
        t = s.view.known_stamp_ns - s.view.known_stamp_ns[0]
        x = s.view.x_mocap.copy()
        x[..., 0] -= total_m * (t / t[-1] - 0.5)[:, None]
        sights.append(Sight(s.camera, replace(s.view, x_mocap=x)))
    pose = case.truth.world_T_mocap
    centroid = np.nanmedian(sights[0].view.x_mocap, axis=(0, 1))
    drift = find_drift(sights, pose, centroid, noise_at(sights, pose))
    assert drift is not None
    assert drift.is_certain
    assert drift.mm_per_min == pytest.approx(1e3 * total_m / drift.seconds * 60.0, rel=0.1)


def test_two_skeletons_share_their_stretches_of_time() -> None:
    """Their recordings are put one after the other, and lasted no longer for it."""
    for n_frames, is_long in ((100, False), (1000, True)):
        x = np.random.default_rng(0).normal(0.0, 1.0, (n_frames, 2, 12, 3))
        uv = np.zeros((1, n_frames, 2, 12, 2))
        crowd = Crowd.from_arrays(x, uv, fps=50.0)
        chosen = np.tile([0, 1], (n_frames, 1))
        chosen[: n_frames // 10, 0] = -1  # the first skeleton is seen later than the second
        camera = scenes.scene(frames=10).cameras[0]
        sight = Sight(camera, assemble(crowd, [chosen]).views[0])
        assert lasts_long([sight]) == is_long
        blocks = time_blocks([sight])[0]
        assert np.bincount(blocks[-n_frames:], minlength=TIME_BLOCKS).min() >= n_frames // 13
        first = blocks[: n_frames - n_frames // 10]
        np.testing.assert_array_equal(first, blocks[-n_frames:][n_frames // 10 :])


def test_offset_of_a_moved_camera_is_said_to_be_that_of_the_others() -> None:
    """It is applied, so the sentence does not say that none is."""
    case = scenes.scene(frames=600, seed=0, lag_s=0.1)
    first = case.cameras[0]
    assert first.camera_T_world is not None
    turn = RigidTransform(so3_exp([0.0, np.radians(8.0), 0.0]), np.zeros(3))
    moved = replace(first, camera_T_world=turn @ first.camera_T_world)
    config = TIMED.with_stage('rig', on_bumped_camera='name')
    found = calibrate((moved, *case.cameras[1:]), case.observations, config=config)
    said = [w for w in found.warnings if 'the motion does not tell' in w]
    assert all('ms applied, as of the others' in w for w in said)
    assert found.time_offset_s[case.cameras[1].name][0] == pytest.approx(0.1, abs=0.002)


def test_search_without_a_skeleton_finds_no_offset() -> None:
    """Two frames are no film."""
    (sight, *_) = sights_of(scenes.scene(frames=30, seed=0))
    few = sight.at_frames(np.array([3, 4]))
    few.view.uv[:, 5:] = np.nan
    track = MocapTrack(few.view.known_stamp_ns, few.view.x_mocap)
    offset_s = coarse_offset(
        few, Timeline(track), span_s=2.0, rng=np.random.default_rng(0), check=lambda _: None
    )
    assert offset_s == 0.0
