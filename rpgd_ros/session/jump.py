# SPDX-License-Identifier: Apache-2.0
"""The gate that keeps automatic calibrations from moving a transform that is in use."""

from __future__ import annotations

import math

import numpy as np

from rpgd_ros.core.config import AcceptConfig
from rpgd_ros.core.errors import CalibrationError, Reason
from rpgd_ros.core.geometry import Array, RigidTransform, rotation_angle, skew
from rpgd_ros.core.result import Calibration

SIGMAS = 3.0  # of both poses together: two that are uncertain may differ by so much


def refuse_jump(
    calibration: Calibration, published: RigidTransform, covariance: Array, gates: AcceptConfig
) -> None:
    """Refuse a pose that is far from the published one, unless both are that uncertain.

    Without that exception a first pose that was barely good enough would stay for ever.

    Args:
        calibration: What was found.
        published: The pose that is in use.
        covariance: (6, 6) of it, as `Calibration.covariance`.
        gates: The largest jumps.

    Raises:
        CalibrationError: JUMP, with both poses' distance and what to do.

    """
    found = calibration.world_T_mocap
    centroid = calibration.centroid_mocap
    turned_deg = math.degrees(rotation_angle(found.rotation @ published.rotation.T))
    moved_m = float(np.linalg.norm(found @ centroid - published @ centroid))
    before_deg, before_m = _sigmas(published, covariance, centroid)
    after_deg, after_m = calibration.worst_sigma
    may_turn_deg = max(gates.max_jump_deg, SIGMAS * math.hypot(before_deg, after_deg))
    may_move_m = max(gates.max_jump_m, SIGMAS * math.hypot(before_m, after_m))
    if turned_deg <= may_turn_deg and moved_m <= may_move_m:
        return
    msg = (
        f'the transform found is {turned_deg:.2f} deg and {1e3 * moved_m:.0f} mm from the '
        f'published one, allowed by itself are {may_turn_deg:.2f} deg and '
        f'{1e3 * may_move_m:.0f} mm. Was the MoCap calibrated again, or the rig moved? '
        'Call ~/calibrate to accept the new one'
    )
    raise CalibrationError(Reason.JUMP, msg, calibration=calibration)


def _sigmas(pose: RigidTransform, covariance: Array, centroid: Array) -> tuple[float, float]:
    """Standard deviations of a pose: rotation in degrees, position of the body in metres."""
    jacobian = np.hstack([-skew(pose.rotation @ centroid), np.eye(3)])
    turn, shift = np.trace(covariance[:3, :3]), np.trace(jacobian @ covariance @ jacobian.T)
    return math.degrees(math.sqrt(max(turn, 0.0))), math.sqrt(max(shift, 0.0))
