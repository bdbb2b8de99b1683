# SPDX-License-Identifier: Apache-2.0
"""Whether the focal lengths that were given fit the film.

A focal length that is 1 % wrong moves the transform by millimetres, and the residuals hardly show
it. So it is freed for a moment, one factor for all cameras, beside the pose, with the prior of a
good calibration: where the film wants another one beyond doubt, that is said, and the covariance
takes in how far the pose would move. A single camera that sees a body at one distance cannot tell
the two apart: then it is the prior that speaks.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rpgd_ros.core.covariance import between_groups, invert, larger
from rpgd_ros.core.geometry import Array, RigidTransform
from rpgd_ros.core.linearise import Sight, linearise
from rpgd_ros.core.normal import twist_from_delta

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rpgd_ros.core.noise import Loss

SIGMAS = 5.0  # beyond doubt; clean recordings reach 3.5 in a hundred
LEAST_ERROR = 0.001  # of the focal length: better than a chessboard does
PRIOR = 0.005  # a chessboard filmed in haste: standard deviation of its focal length


@dataclass(frozen=True, slots=True, eq=False)
class FocalCheck:
    """What the film says of the focal lengths.

    Attributes:
        error: Share by which they are too short (positive) or too long, all cameras alike.
        sigma: Its standard deviation.
        pose_shift: (6,) how far the pose moves with the focal lengths, about the pivot, each by
            as much of them.

    """

    error: float
    sigma: float
    pose_shift: Array

    @property
    def pose_error(self) -> Array:
        """(6,) how far the pose may be off, about the pivot: film and prior together."""
        kept = PRIOR**2 / (PRIOR**2 + self.sigma**2)
        spread: Array = self.pose_shift * np.hypot(kept * self.error, np.sqrt(kept) * self.sigma)
        return spread

    @property
    def is_wrong(self) -> bool:
        """Whether the given focal lengths are wrong beyond doubt."""
        return abs(self.error) > max(LEAST_ERROR, SIGMAS * self.sigma)

    def sentence(self) -> str:
        """Say it to a person."""
        way = 'short' if self.error > 0.0 else 'long'
        return (
            f'the focal lengths look {100 * abs(self.error):.1f} +- {100 * self.sigma:.1f} % too '
            f'{way}: the intrinsics do not fit the film. Calibrate the cameras again; the '
            'reported sigma holds what that may move'
        )


def check_focal(
    sights: Sequence[Sight], pose: RigidTransform, centroid_mocap: Array, loss: Loss
) -> FocalCheck:
    """Free one factor of all focal lengths beside the pose, by one Newton step.

    Args:
        sights: Cameras with (a part of) their data.
        pose: world_T_mocap at the optimum.
        centroid_mocap: (3,) pivot of the pose's parameters, metres.
        loss: Loss of the squared residual.

    """
    n_joints = sights[0].view.n_joints
    hessian, information, scores = np.zeros((7, 7)), np.zeros((7, 7)), np.zeros((n_joints, 7))
    for sight in sights:
        camera_T_mocap = sight.camera_T_world @ pose
        _, _, cx, cy = sight.camera.pinhole
        info, bend, by_joint = np.zeros((7, 7)), np.zeros((7, 7)), np.zeros((n_joints, 7))
        for x, uv in sight.chunks():
            res, slopes = linearise(sight.camera, camera_T_mocap, x, uv)
            _, weight, bending = loss.evaluate(res)
            # A longer focal length moves a projection away from the principal point.
            away_u = np.where(res.in_view, uv[:, 0] - cx + res.du, 0.0)
            away_v = np.where(res.in_view, uv[:, 1] - cy + res.dv, 0.0)
            rows_u, rows_v = slopes.rows()
            rows_u, rows_v = np.vstack([rows_u, away_u]), np.vstack([rows_v, away_v])
            pull = rows_u * res.du + rows_v * res.dv
            by_joint += (pull * weight).reshape(7, -1, n_joints).sum(1).T
            info += (rows_u * weight) @ rows_u.T + (rows_v * weight) @ rows_v.T
            if bending is not None:
                bend += (pull * bending) @ pull.T
        to_twist = np.eye(7)
        to_twist[:6, :6] = twist_from_delta(sight.camera_T_world, pose @ centroid_mocap)
        information += to_twist.T @ info @ to_twist
        hessian += to_twist.T @ (info - bend) @ to_twist
        scores += by_joint @ to_twist
    inverse = invert(hessian, information)
    step = -inverse @ scores.sum(0)
    covariance = larger(inverse, inverse @ between_groups(scores) @ inverse)
    # With the focal lengths held, the rest of the parameters follows them.
    return FocalCheck(
        float(step[6]), float(np.sqrt(covariance[6, 6])), inverse[:6, 6] / inverse[6, 6]
    )
