# SPDX-License-Identifier: Apache-2.0
"""Cameras without extrinsics, alone and beside others."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from recorded_rigs import (
    DATA,
    Case,
    bound,
    centroid,
    displacement_m,
    make_case,
    motions,
    step_from,
)
from scenes import scene

from rpgd_ros.core import (
    CalibrationConfig,
    CalibrationError,
    Camera,
    InputError,
    Observations,
    Reason,
    RigidTransform,
    calibrate,
    calibrate_cameras,
)
from rpgd_ros.core.camera_pose import through_world
from rpgd_ros.core.geometry import Array, so3_exp
from rpgd_ros.simulation import Twin

needs_data = pytest.mark.skipif(not DATA.is_dir(), reason='recorded rigs are not here')


def blind(cameras: tuple[Camera, ...], *numbers: int) -> list[Camera]:
    """Return the cameras, those of the numbers (all without any) without extrinsics."""
    chosen = numbers or range(len(cameras))
    return [replace(c, camera_T_world=None) if v in chosen else c for v, c in enumerate(cameras)]


def true_poses(case: Twin) -> dict[str, RigidTransform]:
    """Return camera_T_mocap by camera."""
    poses = {}
    for camera in case.cameras:
        assert camera.camera_T_world is not None
        poses[camera.name] = camera.camera_T_world @ case.truth.world_T_mocap
    return poses


def in_sigmas(found: RigidTransform, truth: RigidTransform, covariance: Array) -> float:
    """Return the error of a pose as a normalised estimation error, per degree of freedom."""
    step = step_from(found, truth, np.zeros(3))
    return float(step @ np.linalg.solve(covariance, step)) / 6.0


@pytest.fixture(scope='module')
def studio() -> Twin:
    """Four cameras, six seconds."""
    return scene('human36m', 300, 4)


def test_without_extrinsics_the_mocap_frame_is_the_world(studio: Twin) -> None:
    """Every camera is placed in it; its pose there is no estimate, and exact."""
    rig = calibrate_cameras(blind(studio.cameras), studio.observations)
    assert np.array_equal(rig.calibration.world_T_mocap.matrix, np.eye(4))
    assert not rig.calibration.covariance.any()
    assert list(rig.poses) == [camera.name for camera in studio.cameras]
    assert not rig.refused
    for name, truth in true_poses(studio).items():
        pose = rig.poses[name]
        assert in_sigmas(pose.camera_T_world, truth, pose.covariance) < 5.0
        assert pose.sigma_rotation_deg < 0.2
        assert rig.calibration.per_camera[name].inlier_ratio > 0.8


def test_each_camera_is_what_it_is_alone(studio: Twin) -> None:
    """Others in the rig, or their order, change no bit of a camera."""
    rig = calibrate_cameras(blind(studio.cameras), studio.observations)
    back = calibrate_cameras(
        blind(studio.cameras)[::-1],
        replace(studio.observations, views=studio.observations.views[::-1]),
    )
    alone = calibrate(
        blind(studio.cameras)[:1],
        replace(studio.observations, views=studio.observations.views[:1]),
    )
    name = studio.cameras[0].name
    for other in (back.poses[name].camera_T_world, alone.world_T_mocap):
        assert np.array_equal(rig.poses[name].camera_T_world.matrix, other.matrix)


def test_mixed_rig_keeps_its_world(studio: Twin) -> None:
    """The known cameras find world_T_mocap as without the others, which are placed in it."""
    rig = calibrate_cameras(blind(studio.cameras, 1, 3), studio.observations)
    views = studio.observations.views
    known = calibrate(
        [studio.cameras[0], studio.cameras[2]],
        replace(studio.observations, views=(views[0], views[2])),
    )
    assert np.array_equal(rig.calibration.world_T_mocap.matrix, known.world_T_mocap.matrix)
    assert list(rig.poses) == [studio.cameras[v].name for v in (1, 3)]
    for v in (1, 3):
        truth = studio.cameras[v].camera_T_world
        pose = rig.poses[studio.cameras[v].name]
        assert truth is not None
        assert in_sigmas(pose.camera_T_world, truth, pose.covariance) < 5.0
        alone = rig.alone[studio.cameras[v].name].covariance
        assert np.trace(pose.covariance[:3, :3]) > np.trace(alone[:3, :3])


def test_covariance_in_the_world_holds_both_uncertainties() -> None:
    """It is that of many draws of the camera's pose and of the world's."""
    rng = np.random.default_rng(2)
    camera_T_mocap = RigidTransform(so3_exp([0.3, -1.0, 0.4]), np.array([0.5, -0.2, 4.0]))
    world_T_mocap = RigidTransform(so3_exp([-1.2, 0.1, 0.7]), np.array([1.5, 2.0, -0.5]))
    roots = rng.normal(0.0, 1e-4, (2, 6, 6))
    own, world = (root @ root.T for root in roots)
    pose = through_world(camera_T_mocap, own, world_T_mocap, world, np.array([1.0, 0.0, 0.5]))

    def moved(transform: RigidTransform, step: Array) -> RigidTransform:
        turn = so3_exp(step[:3])
        return RigidTransform(turn @ transform.rotation, transform.translation + step[3:])

    steps = []
    for a, b in rng.normal(size=(20_000, 2, 6)):
        truth = moved(camera_T_mocap, roots[0] @ a) @ moved(world_T_mocap, roots[1] @ b).inverse()
        steps.append(step_from(pose.camera_T_world, truth, np.zeros(3)))
    drawn = np.cov(np.array(steps).T)
    scale = np.sqrt(np.diag(drawn))
    np.testing.assert_allclose(
        pose.covariance / np.outer(scale, scale), drawn / np.outer(scale, scale), atol=0.05
    )
    centres = np.array([(moved(camera_T_mocap, roots[0] @ a)).inverse().translation
                        for a in rng.normal(size=(5000, 6))])  # fmt: skip
    alone = through_world(
        camera_T_mocap, own, RigidTransform.identity(), np.zeros((6, 6)), np.zeros(3)
    )
    assert alone.sigma_centre_m == pytest.approx(np.sqrt(centres.var(0).sum()), rel=0.05)


def test_camera_that_cannot_be_placed_does_not_sink_the_others(studio: Twin) -> None:
    """It is reported with its reason: nothing seen, and keypoints of something else."""
    views = list(studio.observations.views)
    views[1] = replace(views[1], uv=np.full_like(views[1].uv, np.nan))
    rng = np.random.default_rng(0)
    views[2] = replace(views[2], uv=rng.uniform(0.0, 1000.0, views[2].uv.shape))
    rig = calibrate_cameras(
        blind(studio.cameras), replace(studio.observations, views=tuple(views))
    )
    names = [camera.name for camera in studio.cameras]
    assert list(rig.poses) == [names[0], names[3]]
    assert rig.refused[names[1]].reason is Reason.NO_DATA
    assert set(rig.refused) == {names[1], names[2]}
    told = ' '.join(rig.calibration.warnings)
    assert f'camera {names[1]} could not be placed (no_data)' in told
    assert f'camera {names[2]} could not be placed' in told


def test_no_camera_placed_is_a_refusal_that_names_them_all(studio: Twin) -> None:
    """A mirrored skeleton fits no camera: the common reason is that of the refusal."""
    views = tuple(
        replace(view, x_mocap=view.x_mocap * [-1.0, 1.0, 1.0])
        for view in studio.observations.views
    )
    with pytest.raises(CalibrationError, match='no camera could be placed') as refused:
        calibrate_cameras(blind(studio.cameras), replace(studio.observations, views=views))
    assert refused.value.reason is Reason.MIRRORED_AXES
    for camera in studio.cameras:
        assert f'camera {camera.name}:' in refused.value.message


def test_known_cameras_that_find_no_world_are_a_refusal(studio: Twin) -> None:
    """Without the world nothing can be placed in it."""
    views = list(studio.observations.views)
    views[0] = replace(views[0], uv=np.full_like(views[0].uv, np.nan))
    with pytest.raises(CalibrationError) as refused:
        calibrate_cameras(
            blind(studio.cameras, 1, 2, 3), replace(studio.observations, views=tuple(views))
        )
    assert refused.value.reason is Reason.NO_DATA


def test_run_can_be_stopped_and_ends_in_its_time(studio: Twin) -> None:
    """A stop between two cameras is a stop, not a camera without a pose."""
    n_calls = 0

    def after_a_while() -> bool:
        nonlocal n_calls
        n_calls += 1
        return n_calls > 8

    with pytest.raises(CalibrationError) as refused:
        calibrate_cameras(blind(studio.cameras), studio.observations, should_stop=after_a_while)
    assert refused.value.reason is Reason.CANCELLED

    def ticking() -> Iterator[float]:
        now = 0.0
        while True:
            now += 0.1
            yield now

    ticks = ticking()
    with pytest.raises(CalibrationError, match='time limit') as refused:
        calibrate_cameras(
            blind(studio.cameras), studio.observations,
            config=replace(CalibrationConfig(), max_seconds=1.5), clock=lambda: next(ticks),
        )  # fmt: skip
    assert refused.value.reason is Reason.CANCELLED
    assert next(ticks) < 2.0


def test_progress_of_each_stage_grows_over_all_cameras(studio: Twin) -> None:
    """It never falls, and ends at the end."""
    seen: dict[str, list[float]] = {}
    calibrate_cameras(
        blind(studio.cameras, 2, 3), studio.observations,
        progress=lambda stage, share: seen.setdefault(stage, []).append(share),
    )  # fmt: skip
    for shares in seen.values():
        assert shares == sorted(shares)
        assert 0.0 <= shares[0] <= shares[-1] <= 1.0
    assert seen['start'][-1] >= 2 / 3


def test_common_warnings_are_said_once(studio: Twin) -> None:
    """That no time is known concerns all cameras, and what one says is said with its name."""
    views = tuple(replace(view, stamp_ns=None) for view in studio.observations.views)
    rig = calibrate_cameras(
        blind(studio.cameras), Observations(views), config=CalibrationConfig.thorough()
    )
    assert len([w for w in rig.calibration.warnings if 'no time is known' in w]) == 1
    odd = [replace(c, name=f'a+b\\c ({k}') for k, c in enumerate(blind(studio.cameras[:1]))]
    one = calibrate_cameras(odd, Observations(views[:1]), config=CalibrationConfig.thorough())
    assert [w for w in one.calibration.warnings if w.startswith('camera a+b\\c (0: no time')]


def test_offsets_of_the_clocks_are_found_per_camera() -> None:
    """A video that is stamped late moves no camera."""
    lags = (0.05, -0.12, 0.0, 0.3)
    case = scene('human36m', 300, 7, lag_s=lags)
    rig = calibrate_cameras(
        blind(case.cameras), case.observations, config=CalibrationConfig.thorough()
    )
    for (name, truth), lag in zip(true_poses(case).items(), lags, strict=True):
        offset_s, sigma_s = rig.calibration.time_offset_s[name]
        assert abs(offset_s - lag) < max(4.0 * sigma_s, 1e-3)
        pose = rig.poses[name]
        assert in_sigmas(pose.camera_T_world, truth, pose.covariance) < 5.0


@pytest.mark.parametrize('number', [0, 2])
def test_cameras_and_views_must_fit(studio: Twin, number: int) -> None:
    """One camera per view, each with a name of its own."""
    with pytest.raises(InputError, match='one camera per view') as refused:
        calibrate_cameras([studio.cameras[0]] * number, studio.observations)
    assert refused.value.reason is Reason.BAD_INPUT


@needs_data
@pytest.mark.parametrize('rig', ['h36m', 'mpi3dhp'])
@pytest.mark.parametrize('motion', ['motion_cmu_02_01', 'motion_cmu_02_07'])
def test_recorded_rigs_are_found_to_the_bound(rig: str, motion: str) -> None:
    """3 px of noise, 30 % anywhere, clocks not trusted: the error is that of the clean points."""
    squared: list[float] = []
    for seed in range(2):
        case = make_case(rig, seed, motion, seed)
        found = calibrate_cameras(
            blind(case.cameras), case.observations, config=CalibrationConfig.thorough()
        )
        squared += list(errors_over_bound(case, {n: p.camera_T_world
                                                 for n, p in found.poses.items()}))  # fmt: skip
    assert len(squared) >= 7
    # Of the roots of n means of some three squares: 1.2, and what chance adds to few cameras.
    assert np.sqrt(np.mean(squared)) < 1.2 + 1.5 / np.sqrt(3 * len(squared))


def errors_over_bound(case: Case, poses: dict[str, RigidTransform]) -> Iterator[float]:
    """Yield the squared displacement of the body over that of the bound, camera by camera.

    Also check the absolute error where the bound promises it.
    """
    for v, camera in enumerate(case.cameras):
        if camera.name not in poses:
            continue
        covariance, truth = bound(case, v), case.pose(v)
        step = step_from(poses[camera.name], truth, centroid(case))
        error_m, bound_m = displacement_m(step, covariance, truth, case)
        error_deg = np.degrees(np.linalg.norm(step[:3]))
        bound_deg = np.degrees(np.sqrt(np.trace(covariance[:3, :3])))
        if 3.0 * bound_m < 0.01 and 3.0 * bound_deg < 0.2:
            assert error_m < 0.01
            assert error_deg < 0.2
        yield float(error_m / bound_m) ** 2


@needs_data
def test_recorded_motions_are_all_there() -> None:
    """The bar is measured on all of them."""
    assert len(motions()) == 7
