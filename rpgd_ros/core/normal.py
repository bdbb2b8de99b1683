# SPDX-License-Identifier: Apache-2.0
"""The normal equations of the reprojection error, summed over all cameras.

Parameters: delta = (w, d), world frame, with `x_world' = exp([w]x) (x_world - c) + c + d` about a
pivot c, the body's centroid. There, rotation and translation are nearly independent.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rpgd_ros.core.geometry import (
    Array,
    Column,
    RigidTransform,
    skew,
    so3_exp,
    so3_log,
)
from rpgd_ros.core.linearise import Residuals, Sight, Slopes, linearise

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rpgd_ros.core.noise import Loss


class Normal(NamedTuple):
    """Sums of one pass, by the parameters of the solve.

    Attributes:
        hessian: (6, 6) second derivative of the cost.
        information: (6, 6) its positive part, `sum w J^T J` (Gauss-Newton).
        gradient: (6,) first derivative of the cost.
        cost: Sum of the loss over all seen correspondences.
        camera_hessian: (V, 6, 6) each camera's part of the Hessian.
        camera_information: (V, 6, 6) each camera's part of the information.

    """

    hessian: Array
    information: Array
    gradient: Array
    cost: float
    camera_hessian: Array
    camera_information: Array


class Spectrum(NamedTuple):
    """Eigenvalues of a symmetric matrix whose diagonal was scaled to one.

    Radians and metres, millions of points and two: scaled, one limit of rounding suits them all.

    Attributes:
        scale: (p,) the matrix was multiplied by its outer product.
        values: (p,) ascending.
        vectors: (p, p) in columns.

    """

    scale: Array
    values: Array
    vectors: Array

    def is_definite(self, rounding: float = 1e-12) -> bool:
        """Whether every direction is known beyond rounding."""
        return bool(self.values[0] > rounding * self.values[-1])


def spectrum(hessian: Array, information: Array) -> Spectrum:
    """Return that of the Hessian; where it is not positive, that of its Gauss-Newton part."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-30))
    found = Spectrum(scale, *np.linalg.eigh(hessian * np.outer(scale, scale)))
    if found.is_definite() or hessian is information:
        return found
    return Spectrum(scale, *np.linalg.eigh(information * np.outer(scale, scale)))


def twist_from_delta(camera_T_world: RigidTransform, pivot_world: Array) -> Array:
    """Return (6, 6): the camera's twist that a step (w, d) of the solve means."""
    r = camera_T_world.rotation
    out = np.zeros((6, 6))
    out[:3, :3] = out[3:, 3:] = r
    out[3:, :3] = skew(camera_T_world @ pivot_world) @ r
    return out


def apply_delta(world_T_mocap: RigidTransform, delta: Array, pivot_world: Array) -> RigidTransform:
    """Move a pose by a step (w, d) about the pivot."""
    turn = so3_exp(delta[:3])
    translation = turn @ (world_T_mocap.translation - pivot_world) + pivot_world + delta[3:]
    r = turn @ world_T_mocap.rotation
    # Steps add up: without this (Newton's for the polar factor) it would slowly be no rotation.
    return RigidTransform(r @ (1.5 * np.eye(3) - 0.5 * r.T @ r), translation)


def delta_between(start: RigidTransform, end: RigidTransform, centroid_mocap: Array) -> Array:
    """(6,) step (w, d) about the body's centroid that takes one pose to another."""
    turn = so3_log(end.rotation @ start.rotation.T)
    return np.concatenate([turn, end @ centroid_mocap - start @ centroid_mocap])


def normal_equations(
    sights: Sequence[Sight], world_T_mocap: RigidTransform, pivot_world: Array, loss: Loss
) -> Normal:
    """Sum cost, gradient and Hessian of a loss over all correspondences.

    Args:
        sights: Cameras with their data.
        world_T_mocap: Where to linearise.
        pivot_world: (3,) pivot of the parameters, metres.
        loss: Loss of the squared residual.

    """
    hessian, information = np.zeros((2, len(sights), 6, 6))
    gradient, cost = np.zeros(6), 0.0
    for v, sight in enumerate(sights):
        camera_T_mocap = sight.camera_T_world @ world_T_mocap
        info, bend, grad = np.zeros((6, 6)), np.zeros((6, 6)), np.zeros(6)
        joint_noise = loss.joint_noise(sight.camera.focal_px)
        for x, uv in sight.chunks():
            res, slopes = linearise(sight.camera, camera_T_mocap, x, uv)
            if joint_noise:
                res, slopes = slopes.whitened(res, joint_noise)
            added, weight, bending = loss.evaluate(res)
            cost += added
            _accumulate(res, slopes, weight, bending, info, bend, grad)
        to_twist = twist_from_delta(sight.camera_T_world, pivot_world)
        information[v] = to_twist.T @ info @ to_twist
        hessian[v] = to_twist.T @ (info - bend) @ to_twist
        gradient += to_twist.T @ grad
    return Normal(hessian.sum(0), information.sum(0), gradient, cost, hessian, information)


def _accumulate(
    res: Residuals, slopes: Slopes, weight: Column, bending: Column | None,
    info: Array, bend: Array, grad: Array,
) -> None:  # fmt: skip
    """Add one chunk to the sums, by the camera's twist."""
    rows_u, rows_v = slopes.rows()
    pull = rows_u * res.du
    pull += rows_v * res.dv
    grad += pull @ weight
    root = np.sqrt(weight)
    rows_u *= root
    rows_v *= root
    info += rows_u @ rows_u.T
    info += rows_v @ rows_v.T
    if bending is not None:
        pull *= np.sqrt(bending)
        bend += pull @ pull.T
