# SPDX-License-Identifier: Apache-2.0
"""How far a pose is to be trusted: covariances that know what does not average out."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rpgd_ros.core.examine import TIME_BLOCKS
from rpgd_ros.core.geometry import Array
from rpgd_ros.core.normal import spectrum

if TYPE_CHECKING:
    from rpgd_ros.core.refine import Descent
    from rpgd_ros.core.unknowns import Solution

# A detector's joint against MoCap's. It shows between three joints or more; one or two could all
# be off alike.
JOINT_BIAS_M, LEAST_JOINTS = 0.02, 3
RELATIVE_FLOOR = 1e-12  # of the variances: keeps what invert floored factorable after rounding


def covariances(
    descent: Descent,
    centroid_mocap: Array,
    *,
    variance: float = 1.0,
    solution: Solution | None = None,
    systematic: Array | None = None,
) -> tuple[Array, Array]:
    """Return `Calibration.covariance` and `Calibration.covariance_over_time`, (6, 6) each.

    A detector's joint is not the MoCap's joint, and the difference does not average out over
    frames. So the pull of the residuals is also summed per joint, and its spread between joints
    gives a clustered covariance; the first result is at least as large as that and as the one of
    independent errors. Of fewer than three joints the difference is taken to be 2 cm. The second
    is from the spread between stretches of time: it grows when errors last,
    as those of a detector that follows somebody else.

    Args:
        descent: The end of the refinement.
        centroid_mocap: (3,) metres.
        variance: Factor of the loss to a log likelihood (1 for a fitted `NoiseModel`).
        solution: Where more than the pose was estimated, that of all unknowns: what is not known
            of the others is then not known of the pose.
        systematic: (6, 6) of how far the pose may be off for reasons that were not mended.

    """
    inverse = invert(descent.normal.hessian, descent.normal.information)
    seen = descent.examination
    # From the pivot's displacement d to the translation: d_t = d + lever x w.
    x, y, z = descent.pose.rotation @ centroid_mocap
    to_origin = np.eye(6)
    to_origin[3:, :3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]

    def moved(about_pivot: Array) -> Array:
        out: Array = to_origin @ about_pivot @ to_origin.T
        return 0.5 * (out + out.T)

    if solution is None:
        by_joint = inverse @ between_groups(seen.joint_scores) @ inverse
        by_time = inverse @ between_groups(seen.time_scores) @ inverse
        about_pivot = larger(variance * inverse, by_joint)
    else:
        about_pivot = solution.covariance[:6, :6]
        by_time = solution.covariance_over_time[:6, :6]
    n_joints = int(np.any(seen.joint_scores != 0.0, axis=1).sum())
    if n_joints < LEAST_JOINTS:
        about_pivot = larger(about_pivot, of_few_joints(inverse, max(n_joints, 1)))
    if systematic is not None:
        about_pivot = about_pivot + systematic
    return moved(about_pivot), moved(by_time)


def between_groups(scores: Array) -> Array:
    """Spread between joints, or times, widened: a covariance of few groups is small too often.

    Of n groups its inverse is (n - 1) / (n - 5) times too large on the mean, for the three
    numbers of a rotation or a position.
    """
    n = int(np.any(scores != 0.0, axis=1).sum())
    widened: Array = spread_between(scores) * max(1.0, (n - 1) / max(n - 5, 1 + (n - 1) / 3))
    return widened


def of_few_joints(inverse: Array, n_joints: int) -> Array:
    """Covariance of a pose whose few joints are all off by `JOINT_BIAS_M`.

    Its position is as wrong as that many points seen once. Its rotation comes from points far
    apart in the room, between which the bias turns with the body: it averages over the walk.

    Args:
        inverse: (6, 6) covariance of independent errors, about the centroid.
        n_joints: How many joints were seen.

    """
    per_point = 3.0 * JOINT_BIAS_M**2 / float(np.trace(inverse[3:, 3:])) / n_joints
    averaged = np.repeat([1.0 / np.sqrt(TIME_BLOCKS), 1.0], 3)
    out: Array = inverse * per_point * np.outer(averaged, averaged)
    return out


def spread_between(scores: Array) -> Array:
    """Return the (p, p) covariance of the sum of independent groups, from scores (groups, p)."""
    used = scores[np.any(scores != 0.0, axis=1)]
    apart = used - used.mean(0) if len(used) else used
    spread: Array = apart.T @ apart * (len(used) / max(len(used) - 1, 1))
    return spread


def larger(a: Array, b: Array) -> Array:
    """Return the smallest covariance that is at least `a` everywhere and `b` where b exceeds a."""
    a = a + RELATIVE_FLOOR * np.diag(np.diag(a))
    root = np.linalg.cholesky(a)
    inverse = root.T @ invert(a)
    values, vectors = np.linalg.eigh(inverse @ b @ inverse.T)
    out: Array = root @ (vectors * np.maximum(values, 1.0)) @ vectors.T @ root.T
    return out


def invert(hessian: Array, information: Array | None = None) -> Array:
    """Invert the Hessian; where it is not positive, the Gauss-Newton part with a floor.

    By eigenvalues: the bits of LAPACK's own inverse depend on the number of threads.
    """
    scale, values, vectors = spectrum(hessian, hessian if information is None else information)
    values = np.maximum(values, 1e-12 * max(values[-1], 1e-30))
    inverse: Array = (vectors / values) @ vectors.T * np.outer(scale, scale)
    return inverse
