# SPDX-License-Identifier: Apache-2.0
"""The spread of residuals is recovered from them, and as a loss it ignores gross errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from core_cases import small_problem
from hypothesis import given, settings
from hypothesis import strategies as st
from numeric import jacobian

from rpgd_ros.core import CalibrationError, Reason, RigidTransform
from rpgd_ros.core.geometry import Array
from rpgd_ros.core.linearise import Residuals
from rpgd_ros.core.noise import Loss, NoiseModel, SquaredLoss
from rpgd_ros.core.noise_fit import fit_noise, noise_at

LARGEST_PX = 34.0  # a focal length of 1145 px
MODEL = NoiseModel(sigma_px=2.0, nu=3.0, share=0.8, background=1e-6)


def residuals_of(lengths_px: Array) -> Residuals:
    """Return residuals of given lengths, all in view."""
    yes = np.ones(len(lengths_px), bool)
    return Residuals(0.6 * lengths_px, 0.8 * lengths_px, yes, yes)


def draw(n: int, sigma_px: float, nu: float, gross: float, seed: int = 0) -> Array:
    """Draw residual lengths (n,), pixels: Student-t noise, and a share of gross errors."""
    rng = np.random.default_rng(seed)
    r = rng.normal(0.0, sigma_px, (n, 2))
    if nu < 1000.0:
        r /= np.sqrt(rng.chisquare(nu, (n, 1)) / nu)
    bad = rng.random(n) < gross
    r[bad] = rng.uniform(-800.0, 800.0, (int(bad.sum()), 2))
    length: Array = np.hypot(*r.T)
    return length


@pytest.mark.parametrize('gross', [0.0, 0.05, 0.3, 0.7])
@pytest.mark.parametrize(
    ('sigma_px', 'nu'), [(0.1, 1000.0), (1.2, 6.0), (2.0, 1000.0), (6.0, 3.0)]
)
def test_the_spread_is_recovered_from_its_own_draws(
    sigma_px: float, nu: float, gross: float
) -> None:
    """Scale to 8 %, tail to its neighbour in the table, share to 3 points, 70 % gross errors."""
    found = fit_noise(draw(20_000, sigma_px, nu, gross), largest_px=LARGEST_PX)
    assert found.sigma_px == pytest.approx(sigma_px, rel=0.08)
    tails = [3.0, 6.0, 15.0, 1000.0]
    assert abs(tails.index(found.nu) - tails.index(nu)) <= 1
    assert found.share == pytest.approx(1.0 - gross, abs=0.03)
    assert found.is_sharp


@pytest.mark.parametrize('seed', range(3))
def test_residuals_without_any_noise_part_are_no_sharp_explanation(seed: int) -> None:
    """Keypoints anywhere in the image: either nearly all is gross, or the spread is blurred."""
    rng = np.random.default_rng(seed)
    r = np.hypot(*rng.uniform(-600.0, 600.0, (2, 5000)))
    found = fit_noise(r, largest_px=LARGEST_PX)
    assert not found.is_sharp or found.share < 0.05
    assert found.sigma_px <= LARGEST_PX * (1.0 + 1e-9)


@pytest.mark.parametrize(
    'residual_px',
    [np.zeros(1), np.zeros(100), np.full(50, 1e-9), np.full(50, 3.0), np.full(7, 1e12)],
    ids=['one', 'zeros', 'tiny', 'equal', 'far'],
)
def test_odd_residuals_still_give_a_usable_loss(residual_px: Array) -> None:
    """All zero, all equal, all far off: numbers come out that a descent can work with."""
    with np.errstate(divide='raise', over='raise', invalid='raise'):
        found = fit_noise(residual_px, largest_px=LARGEST_PX)
        cost, weight, bending = found.evaluate(residuals_of(np.array([0.0, 1.0, 1e4])))
    assert bending is not None
    for figure in (found.sigma_px, found.share, found.background, found.peak, cost):
        assert np.isfinite(figure)
        assert figure > 0.0
    assert np.isfinite(weight).all()
    assert np.isfinite(bending).all()


@settings(max_examples=200)
@given(
    sigma=st.floats(0.05, 20.0), nu=st.sampled_from([3.0, 6.0, 15.0, 1000.0]),
    share=st.floats(0.05, 0.999), background=st.floats(1e-9, 1e-5), length=st.floats(0.01, 30.0),
)  # fmt: skip
def test_weight_and_bending_are_the_derivatives_of_the_loss(
    sigma: float, nu: float, share: float, background: float, length: float
) -> None:
    """The weight is 2 rho', the bending -4 rho'', by the squared residual."""
    model = NoiseModel(sigma, nu, share, background)
    squared = np.array([(length * sigma) ** 2])

    def cost(s: Array) -> float:
        return model.evaluate(residuals_of(np.sqrt(s)))[0]

    def weight(s: Array) -> float:
        return float(model.evaluate(residuals_of(np.sqrt(s)))[1][0])

    _, weights, bending = model.evaluate(residuals_of(np.sqrt(squared)))
    assert bending is not None
    step = 1e-3 * squared[0]
    scale = 1.0 / sigma**2  # the largest weight there can be
    assert weights[0] == pytest.approx(2.0 * jacobian(cost, squared, step)[0], abs=1e-7 * scale)
    expected = -2.0 * jacobian(weight, squared, step)[0]
    assert bending[0] == pytest.approx(expected, rel=1e-6, abs=1e-7 * scale**2)


def test_squared_loss_is_half_the_square() -> None:
    """Of what is in view; its weight is one, and it does not bend."""
    view = residuals_of(np.array([1.0, 2.0, 3.0]))
    view = view._replace(du=view.du * [1, 1, 0], dv=view.dv * [1, 1, 0])
    view = view._replace(in_view=np.array([True, True, False]))
    cost, weight, bending = SquaredLoss().evaluate(view)
    assert cost == pytest.approx(2.5)
    np.testing.assert_array_equal(weight, [1.0, 1.0, 0.0])
    assert bending is None


def test_a_gross_error_loses_its_pull() -> None:
    """The weight falls steadily, and the pull (weight times residual) goes to zero."""
    lengths = np.geomspace(0.1, 1e4, 200)
    cost_of = [MODEL.evaluate(residuals_of(one[None]))[0] for one in lengths]
    _, weight, bending = MODEL.evaluate(residuals_of(lengths))
    assert bending is not None
    assert (np.diff(weight) < 0.0).all()
    assert (bending >= 0.0).all()
    assert (np.diff(cost_of) > 0.0).all()
    pull = weight * lengths
    assert pull[-1] < 1e-6 * pull.max()
    # However far off, one more error costs no more than this.
    assert cost_of[-1] < np.log1p(MODEL.peak / MODEL.background) + 1e-9


def test_what_no_camera_has_in_view_costs_as_much_as_a_gross_error() -> None:
    """A pose cannot become better by turning its back on the data."""
    far, behind = residuals_of(np.array([1e6])), residuals_of(np.array([0.0]))
    behind = behind._replace(in_view=np.array([False]))
    unseen = behind._replace(seen=np.array([False]))
    assert MODEL.evaluate(behind)[0] == pytest.approx(MODEL.evaluate(far)[0], rel=1e-6)
    assert MODEL.evaluate(behind)[1][0] == 0.0
    assert MODEL.evaluate(unseen)[0] == 0.0


def test_cost_per_point_ranks_as_the_loss_does() -> None:
    """The mean negative log likelihood differs from the summed loss by a constant only."""
    a, b = np.array([0.5, 3.0, 100.0]), np.array([2.0, 2.0, 2.0])
    by_loss = MODEL.evaluate(residuals_of(a))[0] - MODEL.evaluate(residuals_of(b))[0]
    by_point = 3.0 * (MODEL.cost_per_point(a) - MODEL.cost_per_point(b))
    assert by_loss == pytest.approx(by_point, rel=1e-9)


@pytest.mark.parametrize('loss', [SquaredLoss(), MODEL], ids=['squared', 'robust'])
def test_a_loss_leaves_the_residuals_as_they_are(loss: Loss) -> None:
    """Its work on whole columns in place is its own affair."""
    res = residuals_of(np.array([1.0, 2.0]).astype(np.float32).astype(np.float64))
    before = [column.copy() for column in res]
    loss.evaluate(res)
    for column, kept in zip(res, before, strict=True):
        np.testing.assert_array_equal(column, kept)


def test_noise_at_a_pose_is_that_of_its_residuals() -> None:
    """Over all cameras; with everything behind them there is none to fit."""
    sights, truth = small_problem(noise_px=2.0)
    assert noise_at(sights, truth).sigma_px == pytest.approx(2.0, rel=0.15)
    blind = [replace(s, camera=replace(s.camera, camera_T_world=None)) for s in sights]
    behind = RigidTransform(truth.rotation, np.array([0.0, 0.0, -1e5]))
    with pytest.raises(CalibrationError, match='no keypoint lies before a camera') as refused:
        noise_at(blind, behind)
    assert refused.value.reason is Reason.TOO_FEW_INLIERS
