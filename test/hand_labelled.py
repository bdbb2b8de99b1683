# SPDX-License-Identifier: Apache-2.0
"""A few frames that somebody labelled by hand: one camera, the skeleton of a depth sensor."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scenes import errors

from rpgd_ros.core import (
    CalibrationConfig,
    CalibrationError,
    Observations,
    Reason,
    View,
    calibrate,
)
from rpgd_ros.simulation import Twin, twin
from rpgd_ros.simulation.motion import MotionName
from rpgd_ros.skeletons import joint_names, mirror

FEWEST, MOST = 10, 20
SECONDS, HZ = 60, 30  # of the recording that the frames are picked from
OCCLUDED = 0.1  # share of the joints that nobody can see, and leaves out
SLIPS = 0.5  # share of the recordings with a frame whose left and right were exchanged
BIAS_M = 0.025  # per axis: where a person puts a joint, and where a depth sensor does


class Outcome(NamedTuple):
    """What became of it.

    Attributes:
        reason: Why it was refused; None = accepted.
        sigmas: Error over the reported sigma, the larger of rotation and place; NaN without one.
        apart_m: Distance of the body's points from the truth, RMS; NaN without a pose.

    """

    reason: Reason | None
    sigmas: float
    apart_m: float

    @property
    def is_accepted(self) -> bool:
        """Whether the pose is offered for use."""
        return self.reason is None


def labelled(seed: int, motion: MotionName = 'walk', seconds: float = SECONDS) -> Twin:
    """Pick 10 to 20 frames of a recording, and label them with the faults of a hand."""
    rng = np.random.default_rng([seed, 7])
    case = twin('kinect', round(seconds * HZ), seed, bias_m=BIAS_M, motion=motion)
    (view,) = case.observations.views
    n_frames = int(rng.integers(FEWEST, MOST + 1))
    frames = np.sort(rng.choice(view.n_frames, n_frames, replace=False))
    uv = view.uv[frames]
    uv[rng.random(uv.shape[:2]) < OCCLUDED] = np.nan
    if rng.random() < SLIPS:
        slip = int(rng.integers(n_frames))
        uv[slip] = uv[slip, list(mirror(joint_names('kinect20')))]
    stamp_ns = None if view.stamp_ns is None else view.stamp_ns[frames]
    few = View(stamp_ns, view.x_mocap[frames], uv)
    observations = Observations((few,), None, case.observations.joint_names)
    truth = replace(case.truth, inliers=(case.truth.inliers[0][frames],))
    return Twin(case.cameras, observations, truth)


def outcome(case: Twin, config: CalibrationConfig) -> Outcome:
    """Calibrate, and compare with the truth."""
    reason = None
    try:
        found = calibrate(case.cameras, case.observations, config=config)
    except CalibrationError as refused:
        if refused.calibration is None:
            return Outcome(refused.reason, float('nan'), float('nan'))
        found, reason = refused.calibration, refused.reason
    truth = case.truth.world_T_mocap
    angle_deg, shift_m = errors(found.world_T_mocap, truth, case.observations)
    sigma_deg, sigma_m = found.worst_sigma
    sigmas = max(angle_deg / sigma_deg, shift_m / sigma_m)
    x = case.observations.views[0].x_mocap
    apart = (found.world_T_mocap @ x) - (truth @ x)
    return Outcome(reason, sigmas, float(np.sqrt((apart**2).sum(-1).mean())))
