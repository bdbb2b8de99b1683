# SPDX-License-Identifier: Apache-2.0
"""RANSAC-P3P: fair triplets, poses that are poses, and the best of them wins."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from core_cases import make_sight, sights_of, small_problem, small_rig
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import errors, only, perfect, scene

from rpgd_ros.core import CalibrationError, Reason, RigidTransform, View
from rpgd_ros.core.config import RansacConfig
from rpgd_ros.core.geometry import Array, rotation_angle, so3_exp
from rpgd_ros.core.linearise import Sight
from rpgd_ros.core.pool import Pool, make_pool
from rpgd_ros.core.ransac import (
    COARSE_POINTS,
    count_inliers,
    draw_triplets,
    published,
    robust_start,
    solve_triplets,
)

N_TRIPLETS = 3000


def rng(seed: int = 0) -> np.random.Generator:
    """Return a source of draws."""
    return np.random.default_rng(seed)


def keep_going(fraction: float) -> None:
    """Never end a run."""
    assert 0.0 <= fraction <= 1.0


def pool_of(sizes: list[list[int]]) -> Pool:
    """Return a pool with so many points per camera and frame; what they are does not matter."""
    camera = np.concatenate([np.full(sum(frames), c) for c, frames in enumerate(sizes)])
    frame = np.concatenate([np.repeat(np.arange(len(frames)), frames) for frames in sizes])
    n, v = len(camera), len(sizes)
    return Pool(
        camera.astype(np.int64), frame.astype(np.int64), np.zeros((n, 3)), np.zeros((n, 2)),
        np.ones(n), np.tile(np.eye(3), (v, 1, 1)), np.zeros((v, 3)),
    )  # fmt: skip


@settings(max_examples=100)
@given(
    sizes=st.lists(st.lists(st.integers(0, 6), min_size=1, max_size=5), min_size=1, max_size=4),
    seed=st.integers(0, 100), same_frame=st.booleans(),
)  # fmt: skip
def test_triplets_are_three_points_of_one_camera(
    sizes: list[list[int]], seed: int, *, same_frame: bool
) -> None:
    """Distinct, of one camera, of one of its frames if asked; refused where there are none."""
    pool = pool_of(sizes)
    enough = any(n >= 3 for frames in sizes for n in (frames if same_frame else [sum(frames)]))
    if not enough:
        with pytest.raises(CalibrationError, match='has 3 correspondences') as refused:
            draw_triplets(pool, 10, rng(seed), same_frame=same_frame)
        assert refused.value.reason is Reason.TOO_FEW_POINTS
        return
    triplets = draw_triplets(pool, 50, rng(seed), same_frame=same_frame)
    assert triplets.shape == (50, 3)
    assert all(len(set(triplet)) == 3 for triplet in triplets.tolist())
    assert (pool.camera[triplets] == pool.camera[triplets[:, :1]]).all()
    if same_frame:
        assert (pool.frame[triplets] == pool.frame[triplets[:, :1]]).all()


@pytest.mark.parametrize('same_frame', [True, False])
def test_every_triplet_is_as_likely_as_any_other(*, same_frame: bool) -> None:
    """Of five points there are ten triplets; each comes up a tenth of the time."""
    triplets = draw_triplets(pool_of([[5]]), 20_000, rng(), same_frame=same_frame)
    counts = Counter(tuple(sorted(triplet)) for triplet in triplets.tolist())
    assert len(counts) == 10
    assert min(counts.values()) > 0.9 * 2000


def test_a_camera_with_two_percent_of_the_data_is_drawn_from_as_often() -> None:
    """Cameras take turns, however many keypoints each has."""
    triplets = draw_triplets(pool_of([[980], [20]]), 1000, rng(), same_frame=False)
    of_small = int((triplets[:, 0] >= 980).sum())
    assert of_small == 500


@pytest.mark.fault(30)
@pytest.mark.parametrize('same_frame', [True, False])
def test_three_exact_points_give_the_true_pose_every_time(*, same_frame: bool) -> None:
    """AP3P: 3000 of 3000, and no pose that is not finite or has a point behind the camera."""
    case = perfect('human36m', 100, 1)
    pool = make_pool(sights_of(case), 2000, rng())
    truth = case.truth.world_T_mocap
    triplets = draw_triplets(pool, N_TRIPLETS + 50, rng(), same_frame=same_frame)
    found = solved = 0
    for triplet in triplets:
        if solved == N_TRIPLETS:
            break
        rotation, translation = solve_triplets(pool, triplet[None])
        if not len(rotation) and is_thin(pool.x_mocap[triplet]):
            continue  # three points on a line have no pose; they are not solved at all
        solved += 1
        x = pool.x_mocap[triplet]
        moved = x @ np.swapaxes(rotation, 1, 2) + translation[:, None]
        found += bool((np.abs(moved - truth @ x).max((1, 2)) < 1e-5).any())
        depth = moved @ pool.camera_R_world[pool.camera[triplet[0]], 2]
        depth += pool.camera_t_world[pool.camera[triplet[0]], 2]
        assert np.isfinite(moved).all()
        assert (depth > 0.0).all()
    assert found == solved == N_TRIPLETS


def is_thin(x: Array) -> bool:
    """Whether three points lie within 1.2 deg of one line."""
    u, v = x[1] - x[0], x[2] - x[0]
    longest = max(np.linalg.norm(u), np.linalg.norm(v), np.linalg.norm(u - v))
    return bool(np.linalg.norm(np.cross(u, v)) <= 0.0101 * longest**2)


@pytest.mark.fault(30)
@pytest.mark.parametrize(
    'x',
    [
        np.zeros((3, 3)),
        np.outer([0.0, 1.0, 2.0], [1.0, 2.0, 3.0]),
        np.outer([0.0, 0.0, 2.0], [1.0, 2.0, 3.0]),
        np.full((3, 3), 1e6),
    ],
    ids=['point', 'line', 'two', 'far'],
)
@pytest.mark.parametrize('ideal', [np.zeros((3, 2)), np.eye(3)[:, :2], np.full((3, 2), 1e6)])
def test_points_without_a_pose_give_none(x: Array, ideal: Array) -> None:
    """Coincident and collinear points, in space or in the image: no pose, no OpenCV error."""
    pool = replace(pool_of([[3]]), x_mocap=x, ideal=ideal)
    with np.errstate(divide='raise', over='raise', invalid='raise'):
        rotation, translation = solve_triplets(pool, np.array([[0, 1, 2]]))
    assert rotation.shape == (0, 3, 3)
    assert translation.shape == (0, 3)


@pytest.mark.fault(30)
@settings(max_examples=100)
@given(
    numbers=st.lists(st.floats(-1e3, 1e3), min_size=9, max_size=9),
    pixels=st.lists(st.floats(-10.0, 10.0), min_size=6, max_size=6),
)
def test_whatever_is_solved_is_finite_and_before_the_camera(
    numbers: list[float], pixels: list[float]
) -> None:
    """Three points and three directions that do not belong together."""
    x = np.array(numbers).reshape(3, 3)
    pool = replace(pool_of([[3]]), x_mocap=x, ideal=np.array(pixels).reshape(3, 2))
    rotation, translation = solve_triplets(pool, np.array([[0, 1, 2]]))
    for r, t in zip(rotation, translation, strict=True):
        assert ((RigidTransform(r, t) @ x)[:, 2] > 0.0).all()


def inliers_by_hand(sights: list[Sight], pose: RigidTransform, threshold_px: float) -> int:
    """Count as eq. 3 says, by the projection of the camera in double precision."""
    r = [s.camera.project(pose @ s.view.x_mocap) - s.view.uv for s in sights]
    return sum(int((np.linalg.norm(one, axis=-1) < threshold_px).sum()) for one in r)


def test_the_winner_of_algorithm_one_has_the_most_inliers() -> None:
    """Every hypothesis of the same draws, counted by hand: none has more."""
    case = scene('human36m', 12, 5, outlier_ratio=0.4)
    sights, config = sights_of(case), RansacConfig(threshold_px=12.0, iterations=60)
    winner = published(sights, config, rng(7), check=keep_going)
    again = rng(7)
    pool = make_pool(sights, 10**6, again)
    triplets = draw_triplets(pool, 60, again, same_frame=True)
    rotation, translation = solve_triplets(pool, triplets)
    counts = [
        inliers_by_hand(sights, RigidTransform(r, t), 12.0)
        for r, t in zip(rotation, translation, strict=True)
    ]
    assert len(counts) > 60
    assert inliers_by_hand(sights, winner, 12.0) == max(counts)
    assert count_inliers(sights, winner, 12.0) == max(counts)


def test_algorithm_one_draws_from_all_that_is_valid() -> None:
    """C is every correspondence with a valid keypoint, of every camera and frame."""
    sights = sights_of(scene('human36m', 12, 5))
    pool = make_pool(sights, 10**6, rng())
    assert len(pool) == sum(int(s.view.seen().sum()) for s in sights)


def test_a_sample_is_spread_over_cameras_and_frames() -> None:
    """Each camera gives its share, and no stretch of the recording is left out."""
    sights = sights_of(scene('human36m', 300, 5))
    pool = make_pool(sights, 200, rng())
    assert np.bincount(pool.camera).tolist() == [200] * 4
    assert (np.diff(pool.camera) >= 0).all()
    first = pool.camera == 0
    assert np.histogram(pool.frame[first], 10, (0, 300))[0].min() >= 5
    keys = pool.frame[first] * 1000 + (pool.x_mocap[first, :1].round(9) % 1 * 1000).ravel()
    assert len(np.unique(keys)) > 190


def test_few_valid_keypoints_among_many_missing_are_all_found() -> None:
    """Where nearly everything is missing, the sample is all that is left."""
    sights, truth = small_problem()
    uv = sights[0].view.uv.copy()
    uv[5:] = np.nan
    sight = make_sight(small_rig()[0], truth, sights[0].view.x_mocap)
    sparse = Sight(sight.camera, View(None, sight.view.x_mocap, uv))
    assert len(make_pool([sparse], 100, rng())) == 40


@pytest.mark.parametrize('kind', ['uniform', 'swap', 'person', 'failure', 'mixed'])
@pytest.mark.parametrize('sampling', ['same_frame', 'any_frame'])
def test_the_robust_start_finds_the_pose_among_many_outliers(kind: str, sampling: str) -> None:
    """Half of the keypoints gross, of every kind: within a degree and 3 cm of the truth."""
    case = scene('human36m', 150, 2, outlier_ratio=0.5, kind=kind)
    config = RansacConfig(sampling='same_frame' if sampling == 'same_frame' else 'any_frame')
    start = robust_start(sights_of(case), config, rng(), check=keep_going)
    angle_deg, shift_m = errors(
        start.candidates[0].world_T_mocap, case.truth.world_T_mocap, case.observations
    )
    assert angle_deg < 1.0
    assert shift_m < 0.03
    assert start.drawn <= config.iterations


def test_a_minority_camera_is_heard() -> None:
    """One camera in four is good and has 2 % of the keypoints; the others show anything."""
    case = scene('human36m', 300, 4)
    sights = []
    for k, sight in enumerate(sights_of(case)):
        uv = sight.view.uv.copy()
        if k == 2:
            uv[18:] = np.nan
        else:
            uv = np.where(np.isnan(uv), uv, rng(k).uniform(0.0, 1000.0, uv.shape))
        sights.append(Sight(sight.camera, View(None, sight.view.x_mocap, uv)))
    share = sights[2].view.seen().sum() / sum(s.view.seen().sum() for s in sights)
    assert share < 0.021
    start = robust_start(sights, RansacConfig(), rng(), check=keep_going)
    found = start.candidates[0].world_T_mocap
    angle_deg, shift_m = errors(found, case.truth.world_T_mocap, only(case, 2).observations)
    assert angle_deg < 2.0
    assert shift_m < 0.1


def test_candidates_are_different_minima_with_the_best_first() -> None:
    """A flat body far away has two explanations; both are kept, and they are not one."""
    flat = rng(1).uniform(-1.0, 1.0, (1, 17, 3)) * [0.3, 0.9, 0.0]
    truth = RigidTransform(so3_exp([0.3, 0.2, 0.0]), np.array([0.0, 0.0, 10.0]))
    camera = replace(small_rig()[0], camera_T_world=None)
    sight = make_sight(camera, truth, np.repeat(flat, 60, 0), rng(2).normal(0, 3.0, (60, 17, 2)))
    start = robust_start([sight], RansacConfig(), rng(), check=keep_going)
    first, second = (c.world_T_mocap for c in start.candidates[:2])
    turn = first.rotation.T @ second.rotation
    assert np.degrees(np.arccos((np.trace(turn) - 1.0) / 2.0)) > 2.0
    assert 0.0 < start.rival_ratio < np.inf


def test_a_line_of_points_has_no_start() -> None:
    """Nothing but degenerate triplets: refused by name, after the draws that were allowed."""
    line = np.linspace(0.0, 1.0, 17)[None, :, None] * np.array([0.0, 1.0, 0.0])
    truth = RigidTransform(np.eye(3), np.array([0.0, -0.5, 4.0]))
    sight = make_sight(replace(small_rig()[0], camera_T_world=None), truth, np.repeat(line, 9, 0))
    with pytest.raises(CalibrationError, match='none of 200 triplets gave a pose') as refused:
        robust_start([sight], RansacConfig(iterations=200), rng(), check=keep_going)
    assert refused.value.reason is Reason.DEGENERATE_GEOMETRY
    with pytest.raises(CalibrationError, match='triplets gave a pose with an inlier') as refused:
        published([sight], RansacConfig(threshold_px=5.0, iterations=50), rng(), check=keep_going)
    assert refused.value.reason is Reason.TOO_FEW_INLIERS


def test_first_ranking_hears_every_joint() -> None:
    """A pool that is all there has its joints in turn: one that is all wrong is one of seven."""
    (camera, *_), n_frames = small_rig(), 2 * COARSE_POINTS // 7 * 4 - 1
    truth = RigidTransform(so3_exp([0.3, -1.0, 0.5]), np.array([0.2, 0.1, -0.3]))
    x = truth.inverse() @ rng().uniform(-0.7, 0.7, (n_frames, 7, 3))
    sight = make_sight(camera, truth, x, rng(1).normal(0.0, 1.0, (n_frames, 7, 2)))
    sight.view.uv[:, 0] = rng(2).uniform(0.0, 1000.0, (n_frames, 2))
    for seed in range(8):
        start = robust_start([sight], RansacConfig(), rng(seed), check=keep_going)
        assert start.drawn < 500
        found = start.candidates[0].world_T_mocap
        assert rotation_angle(found.rotation.T @ truth.rotation) < 0.03
