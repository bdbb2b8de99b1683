# SPDX-License-Identifier: Apache-2.0
"""Local optimisation of a hypothesis on the pool, before anything is known of the noise."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rpgd_ros.core.geometry import Array, RigidTransform
from rpgd_ros.core.noise import NoiseModel
from rpgd_ros.core.noise_fit import LARGEST_NOISE, rough_noises
from rpgd_ros.core.normal import apply_delta
from rpgd_ros.core.pool import Pool

if TYPE_CHECKING:
    from collections.abc import Sequence

LEAST_SHARE = 0.08  # below the least share of inliers that is accepted
POLISH_QUANTILE = 0.1  # of the residuals: their scale while the share of inliers is unknown
POLISH_STEPS = 10
POLISH_DONE = 1e-4  # rad and m: below what the pool can tell; the stages to come go on from there


class Candidate(NamedTuple):
    """A pose polished on the pool, and how well it explains it.

    Attributes:
        world_T_mocap: The pose.
        noise: Fitted spread of its residuals.
        cost: Negative log likelihood per point of the pool.

    """

    world_T_mocap: RigidTransform
    noise: NoiseModel
    cost: float

    @property
    def is_sharp(self) -> bool:
        """Whether it explains enough of the data, and sharply.

        A sharp fit of a tenth of the data is no accident. A blurred one of most of it may be:
        that is what the pose of somebody else who walks in the same room looks like.
        """
        return self.noise.is_sharp and self.noise.share >= LEAST_SHARE


def polish(pool: Pool, poses: Sequence[RigidTransform]) -> list[Candidate]:
    """Descend on the pool with a loss whose scale follows the residuals, and fit their spread."""
    rotations = np.ascontiguousarray(pool.camera_R_world[pool.camera].transpose(1, 2, 0))
    translations = np.ascontiguousarray(pool.camera_t_world[pool.camera].T)
    ends = [_descend(pool, pose, rotations, translations) for pose in poses]
    squared = pool.squared_residuals(
        np.stack([e.rotation for e in ends]), np.stack([e.translation for e in ends])
    )
    residual_px = np.sqrt(np.minimum(squared, 1e8))
    largest_px = LARGEST_NOISE * float(np.median(pool.focal_px))
    noises = rough_noises(residual_px, largest_px=largest_px)
    return [
        Candidate(end, noise, noise.cost_per_point(r))
        for end, noise, r in zip(ends, noises, residual_px, strict=True)
    ]


def _descend(
    pool: Pool, pose: RigidTransform, rotations: Array, translations: Array
) -> RigidTransform:
    """Go to the nearest optimum; arguments as for `_polish_step`."""
    for _ in range(POLISH_STEPS):
        delta, pivot = _polish_step(pool, pose, rotations, translations)
        pose = apply_delta(pose, delta, pivot)
        if np.abs(delta).max() < POLISH_DONE:
            break
    return pose


def _polish_step(
    pool: Pool, pose: RigidTransform, rotations: Array, translations: Array
) -> tuple[Array, Array]:
    """One Gauss-Newton step (w, d) about the centroid, Cauchy weights.

    Args:
        pool: The points.
        pose: Where to linearise.
        rotations: (3, 3, n) camera_R_world of each point.
        translations: (3, n) camera_t_world of each point.

    """
    world = (pool.x_mocap @ pose.rotation.T + pose.translation).T
    pivot = world.mean(1)
    x, y, z = (rotations * world).sum(1) + translations
    inside = z > 1e-3
    iz = 1.0 / np.where(inside, z, 1.0)
    a, b = x * iz, y * iz
    f = pool.focal_px * inside
    du, dv = f * (a - pool.ideal[:, 0]), f * (b - pool.ideal[:, 1])
    squared = np.where(inside, du * du + dv * dv, np.inf)
    rank = int(POLISH_QUANTILE * len(squared))
    weight = 1.0 / (max(float(np.partition(squared, rank)[rank]), 1e-6) + squared)
    f *= iz
    lx, ly, lz = world - pivot[:, None]
    rows = np.empty((2, 6, len(z)))
    for row, slope, axis in ((rows[0], a, 0), (rows[1], b, 1)):
        row[3:] = f * (rotations[axis] - slope * rotations[2])
        gx, gy, gz = row[3:]
        row[0], row[1], row[2] = ly * gz - lz * gy, lz * gx - lx * gz, lx * gy - ly * gx
    weighted = rows * weight
    hessian = weighted[0] @ rows[0].T + weighted[1] @ rows[1].T
    # Where no point is before a camera nothing pulls, and the floor makes the step zero.
    damping = max(1e-9 * float(np.trace(hessian)), 1e-12) * np.eye(6)
    return -np.linalg.solve(hessian + damping, weighted[0] @ du + weighted[1] @ dv), pivot
