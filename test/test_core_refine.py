# SPDX-License-Identifier: Apache-2.0
"""Refinement: the published gradient is right, and every descent ends at its optimum."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from core_cases import sights_of, small_problem
from hypothesis import given, settings
from hypothesis import strategies as st
from numeric import jacobian, relative_error
from scenes import errors, scene

from rpgd_ros.core import Observations, RigidTransform, View, calibrate
from rpgd_ros.core.config import RefineConfig
from rpgd_ros.core.geometry import (
    Array,
    euler_zyx_from_rotation,
    euler_zyx_with_derivatives,
    rotation_from_euler_zyx,
)
from rpgd_ros.core.linearise import Sight, linearise
from rpgd_ros.core.noise import NoiseModel, SquaredLoss
from rpgd_ros.core.normal import apply_delta, normal_equations
from rpgd_ros.core.refine import adam, descend, finish, newton_step, published_gradient

NOISE = NoiseModel(sigma_px=2.0, nu=6.0, share=0.9, background=1e-6)
CENTRE = np.zeros(3)


def keep_going(fraction: float) -> None:
    """Never end a run."""
    assert 0.0 <= fraction <= 1.0


def seen_from(sights: Sequence[Sight], mocap_T_other: RigidTransform) -> list[Sight]:
    """Return the same sights with their skeletons expressed in another MoCap frame."""
    back = mocap_T_other.inverse()
    return [Sight(s.camera, View(None, back @ s.view.x_mocap, s.view.uv)) for s in sights]


def cost_at(
    sights: Sequence[Sight], pose: RigidTransform, loss: NoiseModel | SquaredLoss
) -> float:
    """Return the summed loss."""
    return normal_equations(sights, pose, np.zeros(3), loss).cost


pitches = st.one_of(
    st.floats(-90.0, 90.0), st.floats(89.9, 90.0), st.floats(-90.0, -89.9), st.just(90.0)
)


@pytest.mark.fault(34)
@settings(max_examples=80)
@given(
    alpha=st.floats(-np.pi, np.pi), pitch=pitches, gamma=st.floats(-np.pi, np.pi),
    seed=st.integers(0, 5),
)  # fmt: skip
def test_published_gradient_is_the_derivative_of_the_published_loss(
    alpha: float, pitch: float, gamma: float, seed: int
) -> None:
    """Eq. 5 and 6, over three cameras, at every pitch of the Euler angles and at the gimbal."""
    sights, truth = small_problem(seed, noise_px=5.0)
    angles = np.array([alpha, np.radians(pitch), gamma])
    # The frame in which the pose has these angles, a little off the optimum.
    there = RigidTransform(rotation_from_euler_zyx(angles), truth.translation + 0.02)
    turned = seen_from(sights, truth.inverse() @ there)

    def loss(x: Array) -> float:
        return published_gradient(turned, x[:3], x[3:], SquaredLoss())[0]

    at = np.concatenate([angles, there.translation])
    value, gradient = published_gradient(turned, at[:3], at[3:], SquaredLoss())
    assert value > 0.0
    numeric = jacobian(loss, at, 1e-4)
    assert relative_error(gradient, numeric) < 1e-6
    # A millimetre and a milliradian each: the angles are not hidden behind a larger translation.
    assert relative_error(gradient[:3], numeric[:3]) < 1e-5


def test_published_loss_is_that_of_equation_four() -> None:
    """Half the mean squared residual over the correspondences with depth > 0."""
    sights, truth = small_problem(noise_px=5.0)
    angles = euler_zyx_from_rotation(truth.rotation)
    value, _ = published_gradient(sights, angles, truth.translation, SquaredLoss())
    r = [s.camera.project(truth @ s.view.x_mocap) - s.view.uv for s in sights]
    squared = np.concatenate([(one**2).sum(-1).ravel() for one in r])
    assert value == pytest.approx(0.5 * np.nanmean(squared), rel=1e-9)


def test_equation_five_as_printed_is_not_the_derivative() -> None:
    """Without R_ci^T the pull of each camera stays in that camera's frame."""
    sights, truth = small_problem(noise_px=5.0)
    angles = euler_zyx_from_rotation(truth.rotation)
    shift = truth.translation + 0.05

    def loss(t: Array) -> float:
        return published_gradient(sights, angles, t, SquaredLoss())[0]

    printed, count = np.zeros(3), 0
    pose = RigidTransform(truth.rotation, shift)
    for sight in sights:
        x, uv = next(sight.chunks())
        camera_T_mocap = sight.camera_T_world @ pose
        res, slopes = linearise(sight.camera, camera_T_mocap, x, uv, np.float64)
        printed += slopes.pull(res.du, res.dv)[3:].sum(1)
        count += int(res.in_view.sum())
    numeric = jacobian(loss, shift, 1e-4)
    corrected = published_gradient(sights, angles, shift, SquaredLoss())[1][3:]
    assert relative_error(corrected, numeric) < 1e-6
    assert relative_error(printed / count, numeric) > 0.3


@pytest.mark.parametrize('shape', ['human36m', 'aistpp', 'kinect'])
def test_adam_reaches_the_optimum_of_the_squared_loss(shape: str) -> None:
    """Within 0.1 % of the cost that Newton's method finds, from where RANSAC-P3P ends."""
    case = scene(shape, 40, 2)
    sights, truth = sights_of(case), case.truth.world_T_mocap
    centre = np.asarray(sights[0].view.x_mocap.mean((0, 1)))
    start = apply_delta(truth, np.array([8, -6, 8, 10, -10, 10]) * 1e-3, truth @ centre)
    config = RefineConfig(method='adam', loss='squared', iterations=300)
    best = descend(sights, truth, centre, SquaredLoss(), max_steps=50, check=keep_going)
    found = adam(sights, start, config, SquaredLoss(), check=keep_going)
    optimum = cost_at(sights, best, SquaredLoss())
    assert cost_at(sights, found, SquaredLoss()) <= 1.001 * optimum
    assert optimum <= cost_at(sights, truth, SquaredLoss()) * (1.0 + 1e-6)


@settings(max_examples=60)
@given(
    turn=st.lists(st.floats(-1.0, 1.0), min_size=6, max_size=6),
    scale=st.sampled_from([0.001, 0.03, 0.3, 1.0]),
    max_steps=st.sampled_from([1, 2, 5, 50]), is_squared=st.booleans(),
)  # fmt: skip
def test_no_descent_ends_above_its_start(
    turn: list[float], scale: float, max_steps: int, *, is_squared: bool
) -> None:
    """From any start, with any number of steps, by the loss that it descends."""
    sights, truth = small_problem(noise_px=2.0)
    loss = SquaredLoss() if is_squared else NOISE
    start = apply_delta(truth, scale * np.array(turn), truth @ CENTRE)
    before = cost_at(sights, start, loss) * (1.0 + 1e-6) + 1e-6
    pose = descend(sights, start, CENTRE, loss, max_steps=max_steps, check=keep_going)
    assert cost_at(sights, pose, loss) <= before
    end = finish(sights, start, CENTRE, loss, max_steps=max_steps, threshold_px=6.0,
                 check=keep_going)  # fmt: skip
    assert cost_at(sights, end.pose, loss) <= before
    assert end.examination.cost == pytest.approx(cost_at(sights, end.pose, loss), rel=1e-5)


@pytest.mark.parametrize('loss', [SquaredLoss(), NOISE], ids=['squared', 'robust'])
def test_finish_says_truly_whether_it_converged(loss: NoiseModel | SquaredLoss) -> None:
    """At the end nothing pulls any more; cut short after one step of many, something does."""
    sights, truth = small_problem(noise_px=2.0)
    start = apply_delta(truth, np.full(6, 0.1), truth @ CENTRE)
    ends = {
        n: finish(sights, start, CENTRE, loss, max_steps=n, threshold_px=6.0, check=keep_going)
        for n in (1, 50)
    }
    assert ends[50].is_converged
    assert not ends[1].is_converged
    _, left = newton_step(
        ends[50].normal.hessian, ends[50].normal.information, ends[50].examination.gradient
    )
    assert left < 1e-6


def test_no_pull_is_no_step() -> None:
    """Where the data say nothing along some direction, the step is zero, not infinite."""
    step, decrement = newton_step(np.zeros((6, 6)), np.zeros((6, 6)), np.ones(6))
    np.testing.assert_array_equal(step, np.zeros(6))
    assert decrement == 0.0


@pytest.mark.fault(34)
@pytest.mark.parametrize('pitch', [89.0, 89.99, 90.0])
def test_the_same_optimum_is_reached_where_the_true_pose_is_at_the_gimbal(pitch: float) -> None:
    """The frame that the skeleton is given in does not matter, not even at 90 deg of pitch."""
    case = scene('human36m', 100, 3)
    gimbal = RigidTransform(rotation_from_euler_zyx([0.4, np.radians(pitch), -0.9]), np.ones(3))
    mocap_T_other = case.truth.world_T_mocap.inverse() @ gimbal
    back = mocap_T_other.inverse()
    other = Observations(
        tuple(View(v.stamp_ns, back @ v.x_mocap, v.uv) for v in case.observations.views)
    )
    found = calibrate(case.cameras, other).world_T_mocap
    expected = calibrate(case.cameras, case.observations).world_T_mocap @ mocap_T_other
    angle_deg, shift_m = errors(found, expected, other)
    assert angle_deg < 1e-4
    assert shift_m < 1e-6


def test_adam_at_the_gimbal_never_ends_in_something_else_than_a_pose() -> None:
    """Two of its angles do the same there: it may lag behind, but it does not run away."""
    sights, truth = small_problem(noise_px=2.0)
    gimbal = RigidTransform(rotation_from_euler_zyx([0.4, np.pi / 2, -0.9]), truth.translation)
    turned = seen_from(sights, truth.inverse() @ gimbal)
    config = RefineConfig(method='adam', loss='squared', iterations=300)
    start = apply_delta(gimbal, np.full(6, 5e-3), gimbal @ turned[0].view.x_mocap.mean((0, 1)))
    found = adam(turned, start, config, SquaredLoss(), check=keep_going)
    assert cost_at(turned, found, SquaredLoss()) < cost_at(turned, start, SquaredLoss())


def test_adam_turns_about_the_axes_of_its_angles() -> None:
    """Its result is a rotation of those angles, near the start when it takes one small step."""
    sights, truth = small_problem(noise_px=2.0)
    config = RefineConfig(method='adam', loss='squared', iterations=1)
    moved = adam(sights, truth, config, SquaredLoss(), check=keep_going)
    assert np.abs(moved.matrix - truth.matrix).max() < 1e-12  # annealed to zero at the last step
    rotation, _ = euler_zyx_with_derivatives(euler_zyx_from_rotation(truth.rotation))
    np.testing.assert_allclose(rotation, truth.rotation, atol=1e-12)


def test_every_descent_can_be_ended_at_each_step() -> None:
    """The check is called before each pass; what it raises ends the run."""

    class StoppedError(Exception):
        pass

    def stop(_: float) -> None:
        raise StoppedError

    sights, truth = small_problem()
    config = RefineConfig(method='adam', iterations=10)
    with pytest.raises(StoppedError):
        adam(sights, truth, config, SquaredLoss(), check=stop)
    with pytest.raises(StoppedError):
        descend(sights, truth, CENTRE, NOISE, max_steps=5, check=stop)
    with pytest.raises(StoppedError):
        finish(sights, truth, CENTRE, NOISE, max_steps=5, threshold_px=5.0, check=stop)


def test_a_robust_descent_is_not_pulled_by_gross_errors() -> None:
    """A third of the keypoints anywhere: the optimum stays where it was without them."""
    case = scene('human36m', 100, 1)
    sights = sights_of(case)
    rng = np.random.default_rng(0)
    spoiled = []
    for sight in sights:
        uv = sight.view.uv.copy()
        hit = rng.random(uv.shape[:2]) < 1.0 / 3.0
        uv[hit] = rng.uniform(0.0, 1000.0, (int(hit.sum()), 2))
        spoiled.append(Sight(sight.camera, View(None, sight.view.x_mocap, uv)))
    truth, centre = case.truth.world_T_mocap, sights[0].view.x_mocap.mean((0, 1))
    noise = NoiseModel(sigma_px=1.0, nu=15.0, share=0.66, background=3e-7)
    start = apply_delta(truth, np.full(6, 3e-3), truth @ centre)
    pose = descend(spoiled, start, centre, noise, max_steps=50, check=keep_going)
    angle_deg, shift_m = errors(pose, truth, case.observations)
    assert angle_deg < 0.03
    assert shift_m < 1e-3


def test_finish_ends_where_nothing_pulls() -> None:
    """Its last step costs no pass: what is left is far below what it promises."""
    for seed in range(8):
        sights, truth = small_problem(seed, noise_px=2.0)
        start = apply_delta(truth, np.full(6, 0.01), truth @ CENTRE)
        end = finish(sights, start, CENTRE, NOISE, max_steps=50, threshold_px=6.0,
                     check=keep_going)  # fmt: skip
        there = normal_equations(sights, end.pose, end.pose @ CENTRE, NOISE)
        _, left = newton_step(there.hessian, there.information, there.gradient)
        assert left < 1e-8
        assert end.is_converged


def test_the_rate_of_adam_falls_from_the_whole_to_nearly_nothing() -> None:
    """One step is a whole one: by the rate, against the sign of the gradient."""
    sights, truth = small_problem()
    start = RigidTransform(truth.rotation, truth.translation + 0.3)
    config = RefineConfig(method='adam', loss='squared', iterations=1, lr_translation=0.01)
    moved = adam(sights, start, config, SquaredLoss(), check=keep_going)
    np.testing.assert_allclose(np.abs(moved.translation - start.translation), 0.01, rtol=1e-6)
