# SPDX-License-Identifier: Apache-2.0
"""Refinement of a pose by the reprojection error.

`descend` goes to the optimum of a loss by Newton's method with the analytic Hessian. `adam` is
the published descent: Euler angles Z(gamma) Y(beta) X(alpha), Adam, cosine annealing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rpgd_ros.core.examine import Examination, examine
from rpgd_ros.core.geometry import (
    Array,
    RigidTransform,
    euler_zyx_from_rotation,
    euler_zyx_with_derivatives,
)
from rpgd_ros.core.linearise import Sight, linearise
from rpgd_ros.core.normal import Normal, apply_delta, normal_equations, spectrum

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rpgd_ros.core.config import RefineConfig
    from rpgd_ros.core.noise import Loss

# Newton decrement g^T H^-1 g of a likelihood, in squared standard deviations of the pose.
CONVERGED = 1e-6  # a thousandth of a sigma: nothing that anybody could measure is left
GOOD_STEP = 10.0  # from here one step was seen to end at 1e-9 to 1e-6: no need to look again
LAST_STEP = 1e-3  # within a thirtieth of a sigma the figures of both of its ends are the same
COST_ROUNDING = 1e-7  # of the cost: single-precision columns
MAX_HALVINGS = 8
ADAM_BETA = (0.9, 0.999)  # as published for Adam
ADAM_EPSILON = 1e-8


@dataclass(frozen=True, slots=True, eq=False)
class Descent:
    """Where a descent ended.

    Attributes:
        pose: world_T_mocap.
        normal: Sums where the last full step began, whose Hessian all figures use.
        examination: A look at `pose`, or at where the last step began if that was within
            `LAST_STEP`.
        is_converged: Whether the remaining step is negligible.

    """

    pose: RigidTransform
    normal: Normal
    examination: Examination
    is_converged: bool


def descend(
    sights: Sequence[Sight], pose: RigidTransform, centroid_mocap: Array, loss: Loss,
    *, max_steps: int, check: Callable[[float], None],
) -> RigidTransform:  # fmt: skip
    """Go to the nearest optimum of a loss by Newton's method.

    The cost never rises, but for the last step, which is too short for a look to be worth a pass.

    Args:
        sights: Cameras with their data.
        pose: Start.
        centroid_mocap: (3,) centre of the body, metres: the pivot of the steps.
        loss: Loss of the squared residual; its curvature is that of a likelihood.
        max_steps: Most steps tried.
        check: Called with the fraction done; raises to end the run.

    Returns:
        The pose after the last step.

    """
    pivot = pose @ centroid_mocap
    normal = normal_equations(sights, pose, pivot, loss)
    shrink = 1.0
    for step in range(1, max_steps + 1):
        check(step / max_steps)
        delta, decrement = newton_step(normal.hessian, normal.information, normal.gradient)
        moved = apply_delta(pose, shrink * delta, pivot)
        if decrement < GOOD_STEP and shrink == 1.0:
            return moved
        there_pivot = moved @ centroid_mocap
        there = normal_equations(sights, moved, there_pivot, loss)
        if there.cost <= normal.cost * (1.0 + COST_ROUNDING):
            pose, pivot, normal, shrink = moved, there_pivot, there, 1.0
        elif shrink < 0.5**MAX_HALVINGS:
            break
        else:
            shrink *= 0.5
    return pose


def finish(
    sights: Sequence[Sight], pose: RigidTransform, centroid_mocap: Array, loss: Loss,
    *, max_steps: int, threshold_px: float, check: Callable[[float], None],
) -> Descent:  # fmt: skip
    """Descend from nearby until a look at the end shows that nothing is left to gain.

    Arguments as for `descend`; `threshold_px` is that of the inliers counted at the end. From the
    optimum of a part of the data two steps with one Hessian are the rule, and so two passes over
    all of it: the gradient that the look ends with is good for a step.
    """
    shrink = 1.0
    normal = normal_equations(sights, pose, pose @ centroid_mocap, loss)
    for step in range(1, max_steps + 1):
        check(step / max_steps)
        delta, decrement = newton_step(normal.hessian, normal.information, normal.gradient)
        moved = apply_delta(pose, shrink * delta, pose @ centroid_mocap)
        pivot = moved @ centroid_mocap
        seen = examine(sights, moved, pivot, loss, threshold_px=threshold_px)
        last, left = newton_step(normal.hessian, normal.information, seen.gradient)
        if seen.cost > normal.cost * (1.0 + COST_ROUNDING):
            shrink *= 0.5
            if shrink < 0.5**MAX_HALVINGS:
                break
            continue
        # An old Hessian is off by twice what made the first step miss (its change along the way).
        will_leave = 4.0 * left**2 / max(decrement, left, 1e-30)
        if left < LAST_STEP and will_leave < CONVERGED:
            return Descent(apply_delta(moved, last, pivot), normal, seen, is_converged=True)
        if step == max_steps:
            return Descent(moved, normal, seen, is_converged=False)
        pose, shrink = moved, 1.0
        normal = normal_equations(sights, pose, pose @ centroid_mocap, loss)
    return appraise(sights, pose, centroid_mocap, loss, threshold_px=threshold_px)


def appraise(
    sights: Sequence[Sight], pose: RigidTransform, centroid_mocap: Array, loss: Loss,
    *, threshold_px: float,
) -> Descent:  # fmt: skip
    """Look at a pose that something else has refined, without moving it."""
    pivot = pose @ centroid_mocap
    normal = normal_equations(sights, pose, pivot, loss)
    seen = examine(sights, pose, pivot, loss, threshold_px=threshold_px)
    _, decrement = newton_step(normal.hessian, normal.information, seen.gradient)
    return Descent(pose, normal, seen, is_converged=decrement < CONVERGED)


def newton_step(hessian: Array, information: Array, gradient: Array) -> tuple[Array, float]:
    """Return the step and its decrement; Gauss-Newton where the Hessian is not positive."""
    found = spectrum(hessian, information)
    if not found.is_definite():  # nothing pulls along some direction: no step to take
        return np.zeros_like(gradient), 0.0
    scale, values, vectors = found
    along = vectors.T @ (scale * gradient)
    return -scale * (vectors @ (along / values)), float(along @ (along / values))


def published_gradient(
    sights: Sequence[Sight], angles: Array, translation: Array, loss: Loss
) -> tuple[float, Array]:
    """Loss (eq. 4) and its gradient by (alpha, beta, gamma, t_m).

    eq. 6, as printed: `dL/dtheta = 1/|S| sum r^T J_i R_ci (dR_m/dtheta) W`.
    eq. 5 is printed without the rotation of the camera; the derivative, checked against numeric
    ones, is `dL/dt_m = 1/|S| sum R_ci^T J_i^T r`.

    Args:
        sights: Cameras with their data.
        angles: (3,) alpha, beta, gamma, radians.
        translation: (3,) metres.
        loss: `SquaredLoss` for the publication.

    Returns:
        Loss divided by |S|, gradient (6,).

    """
    rotation, by_angle = euler_zyx_with_derivatives(angles)
    pose = RigidTransform(rotation, translation)
    force, moment, cost, count = np.zeros(3), np.zeros((3, 3)), 0.0, 0
    for sight in sights:
        camera_T_world = sight.camera_T_world
        camera_T_mocap = camera_T_world @ pose
        for x, uv in sight.chunks():
            res, slopes = linearise(sight.camera, camera_T_mocap, x, uv, np.float64)
            added, weight, _ = loss.evaluate(res)
            # J_i^T r, by the point in camera coordinates: the last three rows of the twist.
            pull = slopes.pull(res.du * weight, res.dv * weight)[3:]
            force += camera_T_world.rotation.T @ pull.sum(1)
            moment += camera_T_world.rotation.T @ pull[:, res.seen] @ x[res.seen]
            cost += added
            count += int(res.in_view.sum())
    gradient = np.concatenate([np.einsum('ij,kij->k', moment, by_angle), force])
    return cost / max(count, 1), gradient / max(count, 1)


def adam(
    sights: Sequence[Sight], pose: RigidTransform, config: RefineConfig, loss: Loss,
    *, check: Callable[[float], None],
) -> RigidTransform:  # fmt: skip
    """Descend as published: Adam on Euler angles and translation, cosine annealing to zero.

    Args:
        sights: Cameras with their data, already downsampled in time.
        pose: Start.
        config: Stage settings.
        loss: `SquaredLoss` for the publication.
        check: Called with the fraction done; raises to end the run.

    Returns:
        Where it ended, or the start where that is better: its first steps are as long as the
        rates, whatever the gradient, and may leave a narrow valley for good.

    """
    x = np.concatenate([euler_zyx_from_rotation(pose.rotation), pose.translation])
    rate = np.array([config.lr_rotation] * 3 + [config.lr_translation] * 3)
    first, second = np.zeros(6), np.zeros(6)
    b1, b2 = ADAM_BETA
    before, gradient = published_gradient(sights, x[:3], x[3:], loss)
    after = before
    for k in range(1, config.iterations + 1):
        check(k / config.iterations)
        first = b1 * first + (1.0 - b1) * gradient
        second = b2 * second + (1.0 - b2) * gradient**2
        # From the full rate: the step at zero would be the one after the last.
        annealed = 0.5 * rate * (1.0 + np.cos(np.pi * (k - 1) / config.iterations))
        x -= annealed * (first / (1.0 - b1**k)) / (np.sqrt(second / (1.0 - b2**k)) + ADAM_EPSILON)
        after, gradient = published_gradient(sights, x[:3], x[3:], loss)
    return RigidTransform(euler_zyx_with_derivatives(x[:3])[0], x[3:]) if after < before else pose
