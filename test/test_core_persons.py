# SPDX-License-Identifier: Apache-2.0
"""Several persons in view: which detection shows the one with MoCap is found by the geometry."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rpgd_ros.core import (
    Calibration,
    CalibrationConfig,
    CalibrationError,
    Crowd,
    CrowdView,
    InputError,
    Observations,
    Picked,
    Reason,
    calibrate,
    pick_persons,
)
from rpgd_ros.core.candidates import assemble
from rpgd_ros.core.geometry import Array, IntArray, RigidTransform
from rpgd_ros.core.matching import best_matching
from rpgd_ros.simulation import Corruption, Faults, build_scene, preset, simulate
from rpgd_ros.simulation.recording import SimulatedRecording

RIGS = ('studio', 'kinect', 'human36m', 'aistpp')


def film(rig: str, seed: int, *, seconds: float = 10.0, **options: object) -> SimulatedRecording:
    """Record three persons, one of them with MoCap."""
    options = {'persons': 3, **options}
    return simulate(build_scene(preset(rig), seed, seconds=seconds, **options))  # type: ignore[arg-type]


def crowd_of(recording: SimulatedRecording, *, missed: float = 0.0, seed: int = 0) -> Crowd:
    """Return the candidates, with a share of the detections missed as a whole."""
    rng = np.random.default_rng(seed)
    crowd = recording.crowd()
    views = []
    for view in crowd.views:
        uv = view.uv.copy()
        uv[rng.random(uv.shape[:2]) < missed] = np.nan
        views.append(replace(view, uv=uv))
    return replace(crowd, views=tuple(views))


def truth_of(recording: SimulatedRecording, crowd: Crowd, n_subjects: int = 1) -> list[IntArray]:
    """Return per camera (F, S) which detection is each subject's; -1 = missed."""
    assert recording.company is not None
    truth = []
    for view, order in zip(crowd.views, recording.company.order, strict=True):
        place = np.argsort(order, 1)[:, :n_subjects]
        there = np.take_along_axis(np.isfinite(view.uv[..., 0]).any(-1), place, 1)
        truth.append(np.where(there, place, -1))
    return truth


def rms_mm(found: Calibration, recording: SimulatedRecording) -> float:
    """Return how far the body's points are off."""
    x = recording.mocap.x_mocap[::20].reshape(-1, 3)
    off = (found.world_T_mocap @ x) - (recording.truth.world_T_mocap @ x)
    return 1000.0 * float(np.sqrt((off**2).sum(-1).mean()))


def wrong_share(picked: Picked, truth: list[IntArray]) -> float:
    """Return the share of the picks that are somebody else."""
    pairs = list(zip(picked.chosen, truth, strict=True))
    n_wrong = sum(int(((a != b) & (a >= 0)).sum()) for a, b in pairs)
    return n_wrong / sum(int((a >= 0).sum()) for a, _ in pairs)


def check_as_if_told(
    recordings: list[SimulatedRecording], *, n_subjects: int = 1, missed: float = 0.2,
    config: CalibrationConfig | None = None,
) -> None:  # fmt: skip
    """Right in each recording; together as accurate as with the right detections given."""
    found: list[float] = []
    told: list[float] = []
    for recording in recordings:
        crowd = crowd_of(recording, missed=missed)
        truth = truth_of(recording, crowd, n_subjects)
        picked = pick_persons(recording.cameras, crowd, config=config)
        assert wrong_share(picked, truth) < 0.01
        for observations, out in ((picked.observations, found), (assemble(crowd, truth), told)):
            out.append(
                rms_mm(calibrate(recording.cameras, observations, config=config), recording)
            )
        assert found[-1] < 1.3 * told[-1] + 0.02
    assert np.mean(np.square(found)) < 1.05**2 * np.mean(np.square(told))


@pytest.mark.parametrize('rig', RIGS)
def test_one_of_three_is_picked_in_any_order(rig: str) -> None:
    """Shuffled per frame, a fifth of the detections missed, so that their number varies."""
    check_as_if_told([film(rig, seed) for seed in range(3)])


def test_gross_keypoints_do_not_confuse_persons() -> None:
    """30 % of the subject's keypoints anywhere in the image."""
    faults = Faults(Corruption(0.3))
    check_as_if_told([film(rig, 7, faults=faults) for rig in ('studio', 'kinect')])


@pytest.mark.parametrize('persons', [2, 3])
def test_two_subjects_are_told_apart(persons: int) -> None:
    """Two skeletons, with and without a stranger."""
    made = [film(rig, 3, persons=persons, subjects=2) for rig in ('studio', 'kinect')]
    check_as_if_told(made, n_subjects=2)


def test_one_subject_is_found_among_ten() -> None:
    """One pair in ten is right."""
    check_as_if_told([film('studio', 1, persons=10, seconds=6.0)])


def test_late_video_is_picked_as_well() -> None:
    """0.2 s: the skeleton beside a detection is 30 cm ahead of it."""
    config = CalibrationConfig.thorough()
    made = [film('studio', 2, seconds=15.0, faults=Faults(lag_s=0.2))]
    check_as_if_told(made, missed=0.0, config=config)


def test_single_person_passes_through_to_the_bit() -> None:
    """What is picked from one detection per instant is the recording itself."""
    recording = simulate(build_scene(preset('human36m'), 4, seconds=6.0))
    plain = recording.observations()
    views = tuple(
        CrowdView(v.stamp_ns, v.x_mocap[:, None], v.uv[:, None], None) for v in plain.views
    )
    assert plain.mocap is not None
    picked = pick_persons(recording.cameras, Crowd(views, (plain.mocap,), plain.joint_names))
    for one, other in zip(picked.observations.views, plain.views, strict=True):
        assert one.uv.tobytes() == other.uv.tobytes()
        assert one.x_mocap.tobytes() == other.x_mocap.tobytes()
    assert picked.observations.mocap is plain.mocap
    assert {shown.share for shown in picked.shown} == {1.0}


def test_strangers_alone_are_refused() -> None:
    """The person with MoCap is in no image."""
    recording = film('studio', 0, persons=4)
    crowd = recording.crowd()
    views = []
    for view, place in zip(crowd.views, truth_of(recording, crowd), strict=True):
        uv = view.uv.copy()
        uv[np.arange(len(uv)), place[:, 0]] = np.nan
        views.append(replace(view, uv=uv))
    with pytest.raises(CalibrationError):
        calibrate(
            recording.cameras,
            pick_persons(recording.cameras, replace(crowd, views=tuple(views))).observations,
        )


def test_share_of_the_frames_that_show_the_subject_is_told() -> None:
    """Missed in half the frames of one camera, seen by nobody else."""
    recording = film('human36m', 1)
    crowd = recording.crowd()
    truth = truth_of(recording, crowd)
    uv = crowd.views[0].uv.copy()
    half = np.arange(len(uv)) % 2 == 0
    uv[half, truth[0][half, 0]] = np.nan
    crowd = replace(crowd, views=(replace(crowd.views[0], uv=uv), *crowd.views[1:]))
    shown = pick_persons(recording.cameras, crowd).shown
    assert shown[0].share == pytest.approx(0.5, abs=0.02)
    assert all(one.share > 0.97 for one in shown[1:])
    assert shown[1].detections > 2 * shown[1].shown


def test_cameras_without_extrinsics_are_taken_each_by_itself() -> None:
    """What is known of no rig still says who is who."""
    recording = film('human36m', 5)
    blind = [replace(camera, camera_T_world=None) for camera in recording.cameras]
    crowd = recording.crowd()
    picked = pick_persons(blind, crowd)
    assert wrong_share(picked, truth_of(recording, crowd)) < 0.01
    assert all(shown.share > 0.95 for shown in picked.shown)


def test_order_of_persons_and_cameras_changes_nothing() -> None:
    """The same pairs, to the bit, whoever is named first."""
    recording = film('studio', 6, seconds=6.0)
    crowd = recording.crowd()
    first = pick_persons(recording.cameras, crowd)
    back = replace(crowd, views=crowd.views[::-1])
    second = pick_persons(recording.cameras[::-1], back)
    for one, other in zip(first.chosen, second.chosen[::-1], strict=True):
        np.testing.assert_array_equal(one, other)


def test_arrays_make_a_crowd() -> None:
    """One skeleton or several; shapes that do not fit are told."""
    x, uv = np.zeros((7, 5, 3)), np.zeros((2, 7, 3, 5, 2))
    crowd = Crowd.from_arrays(x, uv, fps=50.0)
    assert crowd.views[1].x_mocap.shape == (7, 1, 5, 3)
    assert len(Crowd.from_arrays(np.zeros((7, 2, 5, 3)), uv, fps=50.0).tracks) == 2
    assert not Crowd.from_arrays(x, uv).tracks
    for bad_x, bad_uv in ((x, uv[:, :, :, :4]), (x[:6], uv), (x, uv[0]), (x[:, :0], uv)):
        with pytest.raises(InputError):
            Crowd.from_arrays(bad_x, bad_uv)


def test_candidates_without_time_are_put_one_after_the_other() -> None:
    """As those of which the time is known, but for the stamps."""
    x = np.arange(2 * 5 * 4 * 3, dtype=np.float64).reshape(5, 2, 4, 3)
    uv = np.arange(5 * 3 * 4 * 2, dtype=np.float64).reshape(1, 5, 3, 4, 2)
    picks = [np.array([[0, 1]] * 5)]
    timed = assemble(Crowd.from_arrays(x, uv, fps=10.0), picks)
    untimed = assemble(Crowd.from_arrays(x, uv), picks)
    assert timed.mocap is not None
    assert untimed.mocap is None
    assert untimed.views[0].stamp_ns is None
    assert np.array_equal(untimed.views[0].x_mocap, timed.views[0].x_mocap)
    assert np.array_equal(untimed.views[0].uv, timed.views[0].uv)


def test_cameras_of_other_skeletons_are_no_crowd() -> None:
    """Views need the skeletons and joints of each other."""
    one = CrowdView(None, np.zeros((5, 2, 4, 3)), np.zeros((5, 3, 4, 2)))
    for shape in ((5, 1, 4, 3), (5, 2, 3, 3), (6, 2, 4, 3), (5, 2, 4)):
        with pytest.raises(InputError, match=r'view 1 has skeletons .* of the other views'):
            Crowd((one, replace(one, x_mocap=np.zeros(shape))))
    for part in ({'confidence': np.ones((5, 3, 3))}, {'stamp_ns': np.arange(4)}):
        with pytest.raises(InputError, match='of view 0 must be'):
            Crowd((replace(one, **part),))


def test_nobody_in_view_is_said() -> None:
    """Not one detection."""
    recording = film('kinect', 0, seconds=2.0)
    crowd = recording.crowd()
    empty = tuple(replace(v, uv=np.full_like(v.uv, np.nan)) for v in crowd.views)
    with pytest.raises(CalibrationError) as caught:
        pick_persons(recording.cameras, replace(crowd, views=empty))
    assert caught.value.reason is Reason.NO_DATA
    with pytest.raises(InputError):
        pick_persons([], crowd)
    x = np.zeros((5, 4, 3))
    nobody = Crowd.from_arrays(x, np.zeros((len(recording.cameras), 5, 0, 4, 2)), fps=10.0)
    with pytest.raises(CalibrationError) as caught:
        pick_persons(recording.cameras, nobody)
    assert caught.value.reason is Reason.NO_DATA


def test_skeletons_follow_each_other_in_time() -> None:
    """Two subjects give one recording with one body at any instant."""
    recording = film('studio', 3, subjects=2, seconds=6.0)
    crowd = crowd_of(recording)
    observations: Observations = assemble(crowd, truth_of(recording, crowd, 2))
    assert observations.mocap is not None
    assert (np.diff(observations.mocap.stamp_ns) > 0).all()
    assert len(observations.mocap.stamp_ns) == 2 * len(recording.mocap.stamp_ns)
    pose: RigidTransform = recording.truth.world_T_mocap
    for camera, view in zip(recording.cameras, observations.views, strict=True):
        assert view.stamp_ns is not None
        assert (np.diff(view.stamp_ns) > 0).all()
        off = np.linalg.norm(camera.project(pose @ view.x_mocap) - view.uv, axis=-1)
        assert np.nanmedian(off) < 5.0


@settings(derandomize=True, max_examples=60, deadline=None)
@given(st.integers(1, 4), st.integers(0, 4), st.integers(0, 10**6))
def test_matching_is_the_best_of_all(n_rows: int, n_columns: int, seed: int) -> None:
    """Against every possible assignment; where there is nobody, nobody is matched."""
    rng = np.random.default_rng(seed)
    gain: Array = np.where(
        rng.random((3, n_rows, n_columns)) < 0.3, 0.0, rng.random((3, n_rows, n_columns))
    )
    for table, found in zip(gain, best_matching(gain), strict=True):
        padded = np.hstack([table, np.zeros((n_rows, n_rows))])
        best = max(
            sum(padded[r, c] for r, c in enumerate(order))
            for order in permutations(range(n_columns + n_rows), n_rows)
        )
        used = found[found >= 0]
        assert len(set(used.tolist())) == len(used)
        assert sum(table[r, c] for r, c in enumerate(found) if c >= 0) == pytest.approx(best)


def test_one_of_two_subjects_is_used_where_the_rate_is_estimated() -> None:
    """Recordings one after the other in time do not have one rate; the offset stays right."""
    made = film('studio', 3, subjects=2, seconds=12.0, faults=Faults(lag_s=0.03))
    config = CalibrationConfig.thorough().with_stage('time', estimate_rate=True)
    picked = pick_persons(made.cameras, made.crowd(), config=config)
    assert len(picked.used) == 1
    assert picked.chosen[0].shape[1] == 2
    found = calibrate(made.cameras, picked.observations, config=config)
    assert rms_mm(found, made) < 1.0
    assert found.time_offset_s['cam0'][0] == pytest.approx(0.03, abs=0.002)
    both = pick_persons(made.cameras, made.crowd())
    assert both.used == (0, 1)
