# SPDX-License-Identifier: Apache-2.0
"""Residuals, their derivatives, and sums over them that damaged entries cannot touch."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import pytest
from core_cases import LENSES, camera_with, small_problem
from hypothesis import given, settings
from hypothesis import strategies as st
from numeric import jacobian, relative_error

from rpgd_ros.core import RigidTransform, View
from rpgd_ros.core import linearise as chunks
from rpgd_ros.core import normal as module
from rpgd_ros.core.examine import examine
from rpgd_ros.core.geometry import Array, so3_exp
from rpgd_ros.core.linearise import Sight, linearise, residuals
from rpgd_ros.core.noise import Loss, NoiseModel, SquaredLoss
from rpgd_ros.core.normal import Normal, apply_delta, normal_equations, twist_from_delta

POSE = RigidTransform(so3_exp([0.4, -1.2, 0.7]), np.array([0.2, -0.1, 3.5]))
NOISE = NoiseModel(sigma_px=1.5, nu=3.0, share=0.8, background=1e-5)
CENTRE = np.array([0.3, -0.4, 0.2])  # of the bodies in these tests, MoCap frame
DAMAGE = [np.nan, np.inf, -np.inf, 1e300, -1e300, 1e30, 3e8]


def points(n: int = 40) -> tuple[Array, Array]:
    """Return points (n, 3), metres, MoCap frame, before a camera at POSE, and pixels (n, 2)."""
    rng = np.random.default_rng(4)
    x = POSE.inverse() @ np.column_stack([rng.uniform(-1.2, 1.2, (n, 2)), rng.uniform(2, 5, n)])
    return x, rng.uniform(0.0, 1000.0, (n, 2))


def with_double_columns(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the sums run over double-precision columns, so that numeric derivatives are exact."""
    monkeypatch.setattr(module, 'linearise', partial(linearise, dtype=np.float64))


@pytest.mark.parametrize('lens', LENSES)
def test_twist_rows_are_the_derivatives_of_the_residuals(lens: str) -> None:
    """A twist (w, v) of the camera moves its points by w cross x + v."""
    camera = camera_with(lens)
    x, uv = points()

    def moved(twist: Array) -> Array:
        step = RigidTransform(so3_exp(twist[:3]), twist[3:])
        found = residuals(camera, step @ POSE, x, uv, np.float64)
        return np.stack([found.du, found.dv])

    found, slopes = linearise(camera, POSE, x, uv, np.float64)
    inside = found.in_view
    assert inside.sum() > 20
    numeric = jacobian(moved, np.zeros(6), 1e-4)
    for row, expected in zip(slopes.rows(), numeric, strict=True):
        assert relative_error(row.T[inside].astype(np.float64), expected[inside]) < 1e-6


@pytest.mark.parametrize('lens', LENSES)
def test_pull_is_what_the_rows_give(lens: str) -> None:
    """J^T r, with and without making J."""
    res, slopes = linearise(camera_with(lens), POSE, *points(), np.float64)
    by_u, by_v = slopes.rows()
    np.testing.assert_allclose(
        slopes.pull(res.du, res.dv), by_u * res.du + by_v * res.dv, rtol=1e-12, atol=1e-9
    )


@settings(max_examples=50)
@given(st.lists(st.floats(-0.5, 0.5), min_size=6, max_size=6))
def test_a_step_of_the_solve_is_a_twist_of_the_camera(step: list[float]) -> None:
    """The 6x6 matrix says how far a small step moves points of the camera frame."""
    delta, pivot = 1e-5 * np.array(step), np.array([1.0, 2.0, 3.0])
    camera_T_world = RigidTransform(so3_exp([1.0, 0.4, -0.3]), np.array([-2.0, 0.5, 4.0]))
    world_T_mocap = RigidTransform(so3_exp([0.2, -0.9, 1.4]), np.array([3.0, -1.0, 0.0]))
    x_mocap = np.random.default_rng(0).normal(0.0, 1.0, (5, 3))
    before = camera_T_world @ (world_T_mocap @ x_mocap)
    after = camera_T_world @ (apply_delta(world_T_mocap, delta, pivot) @ x_mocap)
    twist = twist_from_delta(camera_T_world, pivot) @ delta
    np.testing.assert_allclose(after - before, np.cross(twist[:3], before) + twist[3:], atol=1e-8)


def test_a_step_turns_about_the_pivot() -> None:
    """The pivot itself moves by d only, however far the turn."""
    pivot, shift = np.array([1.0, 2.0, 3.0]), np.array([0.1, -0.2, 0.3])
    moved = apply_delta(POSE, np.concatenate([[2.0, -1.0, 0.5], shift]), pivot)
    at_pivot = POSE.inverse() @ pivot
    np.testing.assert_allclose(moved @ at_pivot, pivot + shift, atol=1e-12)
    np.testing.assert_allclose(
        moved.rotation, so3_exp([2.0, -1.0, 0.5]) @ POSE.rotation, atol=1e-12
    )


def test_many_steps_leave_a_rotation() -> None:
    """Rounding does not add up: ten thousand steps end in a proper rotation."""
    pose = POSE
    for _ in range(10_000):
        pose = apply_delta(pose, np.full(6, 1e-3), np.zeros(3))
    np.testing.assert_allclose(pose.rotation @ pose.rotation.T, np.eye(3), atol=1e-14)


@pytest.mark.parametrize('loss', [SquaredLoss(), NOISE], ids=['squared', 'robust'])
def test_gradient_is_the_derivative_of_the_cost(
    monkeypatch: pytest.MonkeyPatch, loss: Loss
) -> None:
    """By all six parameters, over cameras of three models, away from the optimum."""
    with_double_columns(monkeypatch)
    sights, truth = small_problem(noise_px=3.0)
    pose = apply_delta(truth, np.full(6, 0.01), truth @ CENTRE)
    pivot = pose @ CENTRE

    def cost(delta: Array) -> float:
        return normal_equations(sights, apply_delta(pose, delta, pivot), pivot, loss).cost

    normal = normal_equations(sights, pose, pivot, loss)
    assert relative_error(normal.gradient, jacobian(cost, np.zeros(6), 1e-5)) < 1e-6


@pytest.mark.parametrize('loss', [SquaredLoss(), NOISE], ids=['squared', 'robust'])
def test_hessian_is_the_derivative_of_the_gradient(
    monkeypatch: pytest.MonkeyPatch, loss: Loss
) -> None:
    """At perfect data, where the residuals are zero and so is what bends the projection."""
    with_double_columns(monkeypatch)
    sights, truth = small_problem()
    pivot = truth @ CENTRE

    def gradient(delta: Array) -> Array:
        moved = apply_delta(truth, delta, pivot)
        return normal_equations(sights, moved, pivot, loss).gradient

    normal = normal_equations(sights, truth, pivot, loss)
    numeric = jacobian(gradient, np.zeros(6), 1e-6)
    assert relative_error(normal.hessian, numeric) < 1e-5
    np.testing.assert_allclose(normal.hessian, normal.hessian.T, rtol=1e-12)


def test_hessian_follows_the_loss_where_residuals_are_large(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """For residuals that move in straight lines, weights and bending give the exact curvature."""
    with_double_columns(monkeypatch)
    sights, truth = small_problem(noise_px=4.0)
    sight, pivot = sights[0], np.zeros(3)
    pose = sight.camera_T_world @ truth
    x, uv = next(sight.chunks())
    res, slopes = linearise(sight.camera, pose, x, uv, np.float64)
    by_u, by_v = slopes.rows()

    def cost(twist: Array) -> float:
        straight = res._replace(du=res.du + twist @ by_u, dv=res.dv + twist @ by_v)
        return NOISE.evaluate(straight)[0]

    def gradient(twist: Array) -> Array:
        return jacobian(cost, twist, 1e-5)

    alone = Sight(camera_with(sight.camera.name), View(None, *(a[None] for a in (x, uv))))
    normal = normal_equations([alone], pose, pivot, NOISE)
    assert relative_error(normal.hessian, jacobian(gradient, np.zeros(6), 1e-5)) < 1e-4
    assert np.linalg.eigvalsh(normal.information)[0] > 0.0
    assert np.linalg.eigvalsh(normal.information - normal.hessian)[0] > -1e-6


def test_single_precision_is_a_thousandth_of_the_noise_of_a_detector() -> None:
    """Residuals to 1e-3 px, sums to 1e-5, also where the MoCap origin is a kilometre away."""
    sights, truth = small_problem(noise_px=2.0)
    away = RigidTransform(so3_exp([0.1, 0.2, 0.3]), np.array([1000.0, -700.0, 10.0]))
    for shift in (RigidTransform.identity(), away):
        pose = truth @ shift.inverse()
        for sight in sights:
            x, uv = next(sight.chunks())
            args = (sight.camera, sight.camera_T_world @ pose, shift @ x, uv)
            single, double = residuals(*args), residuals(*args, np.float64)
            assert single.du.dtype == np.float32
            np.testing.assert_allclose(single.du, double.du, atol=1e-3)
            np.testing.assert_allclose(single.dv, double.dv, atol=1e-3)


def sums(sights: Sequence[Sight], pose: RigidTransform, loss: Loss) -> list[Array]:
    """Return every number that passes over the data give at a pose."""
    pivot = pose @ CENTRE
    normal = normal_equations(sights, pose, pivot, loss)
    seen = examine(sights, pose, pivot, loss, threshold_px=5.0)
    tally = seen.tally
    figures = [tally.correspondences, tally.inliers, tally.error_px, tally.inlier_error_px]
    figures += [tally.bias_px, tally.frames, np.sort(tally.sample_px)]
    return [*map(np.asarray, normal), np.asarray(seen.cost), seen.joint_scores, *figures]


@pytest.mark.parametrize('loss', [SquaredLoss(), NOISE], ids=['squared', 'robust'])
@settings(max_examples=60)
@given(data=st.data())
def test_damaged_entries_count_as_missing_ones_to_the_last_bit(
    loss: Loss, data: st.DataObject
) -> None:
    """NaN, infinite or huge, in skeleton or keypoint, in one coordinate or all: all the same."""
    sights, truth = small_problem(noise_px=2.0)
    shape = sights[0].view.uv.shape[:2]
    place = st.tuples(*(st.integers(0, n - 1) for n in shape))
    hits = data.draw(st.lists(st.tuples(place, st.booleans(), st.sampled_from(DAMAGE),
                                        st.integers(0, 1)), min_size=1, max_size=6))  # fmt: skip
    damaged: list[Sight] = []
    missing: list[Sight] = []
    for sight in sights:
        pairs = [(sight.view.x_mocap.copy(), sight.view.uv.copy()) for _ in range(2)]
        for (frame, joint), in_skeleton, value, axis in hits:
            pairs[0][0 if in_skeleton else 1][frame, joint, axis] = value
            pairs[1][1][frame, joint] = np.nan
        for (x, uv), out in zip(pairs, (damaged, missing), strict=True):
            out.append(Sight(sight.camera, View(None, x, uv)))
    with np.errstate(divide='raise', over='raise', invalid='raise'):
        for a, b in zip(sums(damaged, truth, loss), sums(missing, truth, loss), strict=True):
            np.testing.assert_array_equal(a, b)
            assert np.isfinite(a).all()


@pytest.mark.parametrize('loss', [SquaredLoss(), NOISE], ids=['squared', 'robust'])
def test_missing_entries_add_nothing(loss: Loss) -> None:
    """Sums over half of the joints are those over arrays that never had the other half."""
    sights, truth = small_problem(noise_px=2.0)
    pivot = truth @ CENTRE

    def total(blank: Callable[[View], View]) -> Normal:
        halves = [Sight(s.camera, blank(s.view)) for s in sights]
        return normal_equations(halves, truth, pivot, loss)

    def with_gaps(view: View) -> View:
        uv = view.uv.copy()
        uv[:, ::2] = np.nan
        return View(None, view.x_mocap, uv)

    def without(view: View) -> View:
        return View(None, view.x_mocap[:, 1::2], view.uv[:, 1::2])

    a, b = total(with_gaps), total(without)
    np.testing.assert_allclose(a.hessian, b.hessian, rtol=1e-5, atol=1e-3)
    np.testing.assert_allclose(a.gradient, b.gradient, rtol=1e-5, atol=1e-3)
    assert a.cost == pytest.approx(b.cost, rel=1e-6)


def test_points_behind_the_camera_are_seen_but_not_in_view() -> None:
    """They are correspondences that this pose cannot explain; their residual counts as zero."""
    x, uv = points(4)
    x[1] = POSE.inverse() @ np.array([0.0, 0.0, -3.0])
    uv[2] = np.nan
    found = residuals(camera_with('five'), POSE, x, uv)
    np.testing.assert_array_equal(found.seen, [True, True, False, True])
    np.testing.assert_array_equal(found.in_view, [True, False, False, True])
    assert found.squared[1] == found.squared[2] == 0.0


def test_a_long_recording_is_walked_through_in_whole_frames() -> None:
    """Chunks cover every frame once, in order, and hold some thousand points each."""
    view = View(None, np.zeros((5000, 17, 3)), np.arange(5000 * 34.0).reshape(5000, 17, 2))
    sight = Sight(camera_with('none'), view)
    parts = [uv for _, uv in sight.chunks()]
    np.testing.assert_array_equal(np.concatenate(parts), view.uv.reshape(-1, 2))
    assert max(map(len, parts)) <= chunks.CHUNK
    assert all(len(part) % 17 == 0 for part in parts)
