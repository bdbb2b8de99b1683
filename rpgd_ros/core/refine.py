# SPDX-License-Identifier: Apache-2.0
"""Refinement of a pose by the reprojection error.

`descend` goes to the optimum of a loss by Newton's method with the analytic Hessian. `adam` is
the published descent: Euler angles Z(gamma) Y(beta) X(alpha), Adam, cosine annealing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rpgd_ros.core.geometry import (
    Array,
    RigidTransform,
    euler_zyx_from_rotation,
    euler_zyx_with_derivatives,
)
from rpgd_ros.core.linearise import Normal, Sight, apply_delta, linearise, normal_equations

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rpgd_ros.core.config import RefineConfig
    from rpgd_ros.core.noise import Loss

# Newton decrement g^T H^-1 g of a likelihood, in squared standard deviations of the pose.
CONVERGED = 1e-6  # a thousandth of a sigma: nothing that anybody could measure is left
MAX_HALVINGS = 8
ADAM_BETA = (0.9, 0.999)  # as published for Adam
ADAM_EPSILON = 1e-8


@dataclass(frozen=True, slots=True, eq=False)
class Descent:
    """Where a descent ended.

    Attributes:
        pose: world_T_mocap.
        pivot_world: (3,) pivot of the parameters of `normal`, metres.
        normal: Sums of the last pass, at `pose`.
        joint_scores: (J, 6) gradient per joint, at `pose`.
        steps: Passes over the data.
        is_converged: Whether the remaining step is negligible.

    """

    pose: RigidTransform
    pivot_world: Array
    normal: Normal
    joint_scores: Array
    steps: int
    is_converged: bool


def descend(
    sights: Sequence[Sight], pose: RigidTransform, centroid_mocap: Array, loss: Loss,
    *, max_steps: int, check: Callable[[float], None],
) -> Descent:  # fmt: skip
    """Go to the nearest optimum of a loss; the cost never rises.

    Args:
        sights: Cameras with their data.
        pose: Start.
        centroid_mocap: (3,) centre of the body, metres: the pivot of the steps.
        loss: Loss of the squared residual; its curvature is that of a likelihood.
        max_steps: Most passes over the data.
        check: Called with the fraction done; raises to end the run.

    """
    n_joints = sights[0].view.uv.shape[1]

    def look(at: RigidTransform) -> Descent:
        scores = np.zeros((n_joints, 6))
        pivot = at @ centroid_mocap
        normal = normal_equations(sights, at, pivot, loss, joint_scores=scores)
        return Descent(at, pivot, normal, scores, 1, is_converged=False)

    here = look(pose)
    shrink, steps = 1.0, 1
    while True:
        check(steps / max_steps)
        delta, decrement = _newton_step(here.normal)
        if decrement < CONVERGED or steps >= max_steps or shrink < 0.5**MAX_HALVINGS:
            done = decrement < CONVERGED
            return Descent(here.pose, here.pivot_world, here.normal, here.joint_scores, steps, done)
        there = look(apply_delta(here.pose, shrink * delta, here.pivot_world))
        steps += 1
        if there.normal.cost <= here.normal.cost:
            here, shrink = there, 1.0
        else:
            shrink *= 0.5


def _newton_step(normal: Normal) -> tuple[Array, float]:
    """Return the step and its decrement; Gauss-Newton where the Hessian is not positive."""
    for matrix in (normal.hessian, normal.information):
        scale = 1.0 / np.sqrt(np.maximum(np.diag(normal.information), 1e-30))
        values, vectors = np.linalg.eigh(matrix * np.outer(scale, scale))
        if values[0] > 1e-12 * values[-1]:
            along = vectors.T @ (scale * normal.gradient)
            delta = -scale * (vectors @ (along / values))
            return delta, float(along @ (along / values))
    return np.zeros(6), 0.0  # nothing pulls along some direction: there is no step to take


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
        for _, x, uv in sight.chunks():
            res, rows_u, rows_v = linearise(sight.camera, camera_T_mocap, x, uv)
            added, weight, _ = loss.evaluate(res.du**2 + res.dv**2, res.in_view, res.seen)
            # J_i^T r, by the point in camera coordinates: the last three rows of the twist.
            pull = rows_u[3:] * (res.du * weight) + rows_v[3:] * (res.dv * weight)
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

    """
    x = np.concatenate([euler_zyx_from_rotation(pose.rotation), pose.translation])
    rate = np.array([config.lr_rotation] * 3 + [config.lr_translation] * 3)
    first, second = np.zeros(6), np.zeros(6)
    b1, b2 = ADAM_BETA
    for k in range(1, config.iterations + 1):
        check(k / config.iterations)
        _, gradient = published_gradient(sights, x[:3], x[3:], loss)
        first = b1 * first + (1.0 - b1) * gradient
        second = b2 * second + (1.0 - b2) * gradient**2
        annealed = 0.5 * rate * (1.0 + np.cos(np.pi * k / config.iterations))
        x -= annealed * (first / (1.0 - b1**k)) / (np.sqrt(second / (1.0 - b2**k)) + ADAM_EPSILON)
    return RigidTransform(euler_zyx_with_derivatives(x[:3])[0], x[3:])
