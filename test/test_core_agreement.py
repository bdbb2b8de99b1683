# SPDX-License-Identifier: Apache-2.0
"""A camera that was moved, or that follows somebody else, is named; a good one is not."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import scenes

from rpgd_ros.core import (
    Calibration,
    CalibrationConfig,
    Camera,
    Observations,
    RigidTransform,
    calibrate,
)
from rpgd_ros.core.agreement import chance
from rpgd_ros.core.config import RigConfig
from rpgd_ros.core.geometry import so3_exp
from rpgd_ros.simulation import Twin

EXCLUDE = CalibrationConfig(rig=RigConfig(on_bumped_camera='exclude'))


def moved(camera: Camera, *, deg: float = 0.0, m: float = 0.0, seed: int = 0) -> Camera:
    """Return the camera with extrinsics that are wrong by so much, in a random direction."""
    rng = np.random.default_rng(seed)
    axis, way = rng.normal(size=(2, 3))
    assert camera.camera_T_world is not None
    pose = camera.camera_T_world.inverse()
    turn = so3_exp(np.radians(deg) * axis / np.linalg.norm(axis))
    shift = m * way / np.linalg.norm(way)
    bumped = RigidTransform(turn @ pose.rotation, pose.translation + shift)
    return replace(camera, camera_T_world=bumped.inverse())


def solved(
    case: Twin, number: int, *, config: CalibrationConfig | None = None, **bump: float
) -> Calibration:
    """Calibrate with one camera moved."""
    cameras = list(case.cameras)
    cameras[number] = moved(cameras[number], seed=number, **bump)
    return calibrate(cameras, case.observations, config=config)


@pytest.mark.parametrize(('deg', 'm'), [(0.15, 0.0), (0.0, 0.008), (2.0, 0.0), (0.0, 0.3)])
@pytest.mark.parametrize('bias_m', [0.0, 0.02])
def test_a_moved_camera_is_named_whether_by_a_little_or_a_lot(
    deg: float, m: float, bias_m: float
) -> None:
    """From what hardly shows in the residuals to what makes all of them outliers."""
    case = scenes.scene(frames=1500, seed=1, bias_m=bias_m)
    found = solved(case, 2, deg=deg, m=m)
    assert [d.camera for d in found.disagreements] == [case.cameras[2].name]
    named = found.disagreements[0]
    assert named.rotation_deg == pytest.approx(deg, abs=0.1 + 4 * named.sigma_deg)
    assert case.cameras[2].name in found.warnings[0]


@pytest.mark.parametrize('seed', range(5))
def test_no_camera_of_an_untouched_rig_is_named(seed: int) -> None:
    """Biased joints, seen differently by each camera, are no moved camera."""
    case = scenes.scene(frames=600, seed=seed, bias_m=0.02, bias_px=3.0)
    assert calibrate(case.cameras, case.observations).disagreements == ()


def test_two_seconds_of_film_name_nobody() -> None:
    """The detector's view of the body has had no time to change."""
    case = scenes.scene(frames=100, seed=1, bias_m=0.02)
    assert solved(case, 2, deg=1.0).disagreements == ()


def test_of_two_cameras_it_is_one_of_the_two() -> None:
    """Nobody can say which, and neither is thrown out."""
    case = scenes.only(scenes.scene(frames=1500, seed=3), 0, 1)
    found = solved(case, 1, config=EXCLUDE, deg=0.5)
    assert len(found.disagreements) == 1
    assert found.disagreements[0].rival is not None
    assert 'one of the two' in found.warnings[0]
    assert set(found.per_camera) == {c.name for c in case.cameras}


def test_the_transform_does_not_suffer_from_a_camera_that_is_left_out() -> None:
    """As good as a rig that never had it."""
    case = scenes.scene(frames=900, seed=4)
    rest = scenes.only(case, 0, 1, 3)
    found = solved(case, 2, config=EXCLUDE, deg=1.0, m=0.05)
    without = calibrate(rest.cameras, rest.observations)
    truth = case.truth.world_T_mocap
    error = scenes.errors(found.world_T_mocap, truth, case.observations)
    bar = scenes.errors(without.world_T_mocap, truth, case.observations)
    assert error[0] <= 1.3 * bar[0]
    assert error[1] <= 1.3 * bar[1]
    assert 'not used' in found.warnings[1]
    assert case.cameras[2].name in found.per_camera


@pytest.mark.parametrize('share', [0.3, 0.6, 0.86])
def test_a_camera_that_follows_somebody_else_is_named_with_its_share(share: float) -> None:
    """The detector's scores do not show it."""
    case = scenes.scene(frames=1000, seed=5)
    other = scenes.scene(frames=1000, seed=55)
    views = list(case.observations.views)
    lost = np.random.default_rng(0).random(20) < share
    frames = np.repeat(lost, 50)
    uv = np.where(frames[:, None, None], other.observations.views[1].uv, views[1].uv)
    views[1] = replace(views[1], uv=uv)
    found = calibrate(case.cameras, Observations(tuple(views), case.observations.mocap))
    sentence = next(w for w in found.warnings if 'follows something else' in w)
    assert case.cameras[1].name in sentence
    told = float(sentence.split(' %')[0].split()[-1]) / 100.0
    assert told == pytest.approx(lost.mean(), abs=0.1)
    assert found.disagreements == ()


def test_camera_with_three_wrong_keypoints_is_lost_and_not_moved() -> None:
    """They tell nothing of where it stands, so no move is claimed of it."""
    case = scenes.scene(frames=600, seed=2)
    views = list(case.observations.views)
    uv = np.full_like(views[1].uv, np.nan)
    uv[::250, 0] = views[1].uv[::250, 0] + 300.0
    assert np.isfinite(uv[..., 0]).sum() <= 3
    views[1] = replace(views[1], uv=uv)
    found = calibrate(case.cameras, replace(case.observations, views=tuple(views)))
    assert found.disagreements == ()
    assert scenes.errors(found.world_T_mocap, case.truth.world_T_mocap, case.observations)[0] < 0.1


@pytest.mark.parametrize('free', [3, 5, 8, 11, 26, 120])
def test_the_level_of_chance_is_what_chance_exceeds_once_in_10_000(free: int) -> None:
    """The upper quantile of F(6, free), by a sum of its density."""
    x = np.exp(np.linspace(np.log(chance(free)), np.log(chance(free)) + 16.0, 200_001))
    log_beta = math.lgamma(3.0) + math.lgamma(free / 2) - math.lgamma(3.0 + free / 2)
    ratio = 6.0 / free
    density = np.exp(
        3.0 * np.log(ratio) + 2.0 * np.log(x) - log_beta
        - 0.5 * (6 + free) * np.log1p(ratio * x)
    )  # fmt: skip
    share = float((0.5 * (density[1:] + density[:-1]) * np.diff(x)).sum())
    assert share == pytest.approx(1e-4, rel=0.1)
