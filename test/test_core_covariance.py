# SPDX-License-Identifier: Apache-2.0
"""The covariance covers the true error, for independent errors and for those that last."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import scene

from rpgd_ros.core import (
    Calibration,
    CalibrationConfig,
    CalibrationError,
    Observations,
    RigidTransform,
    calibrate,
)
from rpgd_ros.core.config import AcceptConfig, RefineConfig
from rpgd_ros.core.covariance import invert, larger, spread_between
from rpgd_ros.core.geometry import Array, so3_exp, so3_log

OPEN = CalibrationConfig(accept=AcceptConfig(max_sigma_deg=180.0, max_sigma_m=100.0))


def covariance_of(seed: int, *, rank: int = 6, scale: float = 1.0) -> Array:
    """Draw a covariance (6, 6) with variances over several powers of ten."""
    rng = np.random.default_rng(seed)
    root = rng.normal(0.0, 1.0, (6, rank)) * 10.0 ** rng.uniform(-3.0, 0.0, (6, 1))
    out: Array = scale * root @ root.T
    return out


@settings(max_examples=100)
@given(st.integers(0, 1000), st.integers(1, 6), st.floats(1e-3, 1e3))
def test_the_larger_covariance_is_at_least_both(seed: int, rank: int, scale: float) -> None:
    """In every direction, and in none more than both together."""
    a, b = covariance_of(seed), covariance_of(seed + 5000, rank=rank, scale=scale)
    out = larger(a, b)
    directions = np.random.default_rng(seed).normal(0.0, 1.0, (200, 6))
    directions /= np.sqrt(np.einsum('ki,ij,kj->k', directions, a + b, directions))[:, None]
    of_a, of_b, of_out = (np.einsum('ki,ij,kj->k', directions, c, directions) for c in (a, b, out))
    assert (of_out >= np.maximum(of_a, of_b) - 1e-7).all()
    assert (of_out <= of_a + of_b + 1e-7).all()
    np.testing.assert_allclose(out, out.T, rtol=1e-7, atol=1e-12 * np.abs(out).max())


@settings(max_examples=50)
@given(st.integers(0, 1000), st.floats(1e-3, 0.999))
def test_the_larger_of_two_that_are_ordered_is_the_upper_one(seed: int, share: float) -> None:
    """What adds nothing changes nothing."""
    a = covariance_of(seed)
    for out in (larger(a, share * a), larger(share * a, a)):
        np.testing.assert_allclose(out, a, rtol=1e-6, atol=1e-8 * np.abs(a).max())


def test_groups_that_agree_have_no_spread() -> None:
    """The spread of a sum of independent groups is n times their variance; empty ones are out."""
    rng = np.random.default_rng(0)
    scores = rng.normal(0.0, 2.0, (4000, 3))
    np.testing.assert_allclose(spread_between(scores), 4000 * 4.0 * np.eye(3), rtol=0.1, atol=1000)
    with_gaps = np.vstack([scores, np.zeros((500, 3))])
    np.testing.assert_allclose(spread_between(with_gaps), spread_between(scores))
    np.testing.assert_array_equal(spread_between(np.ones((7, 3))), np.zeros((3, 3)))
    np.testing.assert_array_equal(spread_between(np.zeros((7, 3))), np.zeros((3, 3)))


def test_a_hessian_that_is_not_positive_gives_a_covariance_all_the_same() -> None:
    """It falls back to the positive part, and an unseen direction is very uncertain."""
    information = np.diag([4.0, 4.0, 4.0, 1.0, 1.0, 0.0])
    hessian = information - 5.0 * np.diag([1.0, 0, 0, 0, 0, 0])
    out = invert(hessian, information)
    np.testing.assert_allclose(np.diag(out)[:5], [0.25, 0.25, 0.25, 1.0, 1.0])
    assert out[5, 5] > 1e9
    assert np.isfinite(larger(out, np.eye(6))).all()
    assert np.isfinite(invert(np.zeros((6, 6)), np.zeros((6, 6)))).all()


def test_the_covariance_at_the_centroid_is_that_of_moving_it() -> None:
    """Poses drawn from the (6, 6) covariance scatter the centroid as its (3, 3) says."""
    case = scene('human36m', 100, 0)
    found = calibrate(case.cameras, case.observations)
    pose, centroid = found.world_T_mocap, found.centroid_mocap
    draws = np.random.default_rng(0).multivariate_normal(np.zeros(6), found.covariance, 20_000)
    moved = [
        RigidTransform(so3_exp(d[:3]) @ pose.rotation, pose.translation + d[3:]) @ centroid
        for d in draws
    ]
    sampled = np.cov(np.array(moved).T)
    scale = np.trace(sampled)
    np.testing.assert_allclose(found.centroid_covariance, sampled, atol=0.03 * scale)
    assert found.sigma_position_m == pytest.approx(np.sqrt(scale), rel=0.03)
    spread_deg = np.degrees(np.sqrt((draws[:, :3] ** 2).sum(1).mean()))
    assert found.sigma_rotation_deg == pytest.approx(spread_deg, rel=0.03)


def test_a_far_origin_makes_the_translation_uncertain_but_not_the_body() -> None:
    """The same recording in a frame 500 m away: the same sigma where the subject is."""
    case = scene('human36m', 100, 0)
    near = calibrate(case.cameras, case.observations)
    shift = np.array([500.0, -200.0, 30.0])
    views = tuple(replace(v, x_mocap=v.x_mocap + shift) for v in case.observations.views)
    far = calibrate(case.cameras, replace(case.observations, views=views))
    np.testing.assert_allclose(far.centroid_covariance, near.centroid_covariance, rtol=0.01)
    assert far.sigma_rotation_deg == pytest.approx(near.sigma_rotation_deg, rel=0.01)
    assert np.trace(far.covariance) > 100.0 * np.trace(near.covariance)


def test_numbers_without_digits_are_infinite_uncertainty() -> None:
    """A covariance whose parts cancel to less than zero is no accuracy."""
    case = scene('human36m', 100, 0)
    found = calibrate(case.cameras, case.observations)
    lost = replace(found, covariance=-np.eye(6))
    assert lost.worst_sigma == (np.inf, np.inf)


def nees(found: Calibration, truth: RigidTransform) -> tuple[float, float, float]:
    """Return squared errors by covariance: pose / 6, rotation / 3, centroid / 3."""
    turn = so3_log(truth.rotation @ found.world_T_mocap.rotation.T)
    error = np.concatenate([turn, truth.translation - found.world_T_mocap.translation])
    apart = truth @ found.centroid_mocap - found.world_T_mocap @ found.centroid_mocap
    parts = [(error, found.covariance), (turn, found.covariance[:3, :3])]
    parts.append((apart, found.centroid_covariance))
    whole, rotation, centroid = (float(e @ np.linalg.solve(c, e)) / len(e) for e, c in parts)
    return whole, rotation, centroid


@pytest.mark.fault(32)
@pytest.mark.parametrize(
    ('shape', 'faults'),
    [
        ('human36m', {}),
        ('aistpp', {}),
        ('human36m', {'outlier_ratio': 0.4, 'kind': 'mixed'}),
        ('human36m', {'bias_m': 0.02}),
        ('aistpp', {'bias_m': 0.02}),
    ],
)
def test_the_covariance_covers_the_true_error(shape: str, faults: dict[str, Any]) -> None:
    """Mean normalised squared error of 16 recordings near one, biased joints among them."""
    figures = []
    for seed in range(16):
        case = scene(shape, 80, seed, **faults)
        found = calibrate(case.cameras, case.observations, config=OPEN)
        figures.append(nees(found, case.truth.world_T_mocap))
    # 16 draws of a chi-square with 3 degrees of freedom scatter by 0.2 about their mean.
    for mean in np.mean(figures, axis=0):
        assert 0.4 < mean < 2.3


def test_the_squared_loss_reports_the_spread_of_its_own_residuals() -> None:
    """The published method on Gaussian noise is as sure of itself as the robust one."""
    case = scene('human36m', 150, 2)
    squared = CalibrationConfig(refine=RefineConfig(loss='squared'))
    a = calibrate(case.cameras, case.observations, config=squared)
    b = calibrate(case.cameras, case.observations)
    assert a.sigma_rotation_deg == pytest.approx(b.sigma_rotation_deg, rel=0.2)
    assert a.sigma_position_m == pytest.approx(b.sigma_position_m, rel=0.2)


@pytest.mark.parametrize('n_joints', [1, 2])
def test_few_joints_may_all_be_off(n_joints: int) -> None:
    """What cannot be told from one or two joints is covered all the same: 2 cm of bias."""
    figures = []
    for seed in range(12):
        case = scene('human36m', 120, seed, bias_m=0.02)
        joints = np.random.default_rng(seed).permutation(case.observations.n_joints)[:n_joints]
        views = tuple(
            replace(v, x_mocap=v.x_mocap[:, joints], uv=v.uv[:, joints], confidence=None)
            for v in case.observations.views
        )
        try:
            found = calibrate(case.cameras, Observations(views), config=OPEN)
        except CalibrationError:
            continue  # two poses that explain so little
        figures.append(nees(found, case.truth.world_T_mocap)[1:])
    assert len(figures) >= 8
    for mean in np.mean(figures, axis=0):
        assert 0.05 < mean < 2.3
