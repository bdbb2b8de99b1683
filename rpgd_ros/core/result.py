# SPDX-License-Identifier: Apache-2.0
"""What a solve returns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from rpgd_ros.core.config import CalibrationConfig
from rpgd_ros.core.geometry import Array, RigidTransform

if TYPE_CHECKING:
    from rpgd_ros.core.agreement import Disagreement
    from rpgd_ros.core.camera_pose import CameraPose
    from rpgd_ros.core.drift import Drift
    from rpgd_ros.core.findings import JointOffset
    from rpgd_ros.core.persons import Shown


@dataclass(frozen=True, slots=True)
class GroupFit:
    """How one camera, or one joint, agrees with the pose.

    Attributes:
        name: Of the camera or joint.
        correspondences: Those with a depth > 0 (S of eq. 4).
        inliers: Those with a residual below the threshold (eq. 3).
        mpjpe_px: Mean residual over the correspondences (eq. 7), pixels; NaN without any.
        inlier_mpjpe_px: Mean residual over the inliers, pixels; NaN without any.
        bias_px: Mean residual vector (du, dv) of the inliers, pixels.

    """

    name: str
    correspondences: int
    inliers: int
    mpjpe_px: float
    inlier_mpjpe_px: float
    bias_px: tuple[float, float]

    @property
    def inlier_ratio(self) -> float:
        """Inliers over correspondences; 0 without any."""
        return self.inliers / self.correspondences if self.correspondences else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """A pose, and how far to trust it.

    Attributes:
        world_T_mocap: The publication's (R_m, t_m): `x_world = world_T_mocap @ x_mocap`.
        covariance: (6, 6) of (d_rot [rad], d_t [m]), world frame: R_true = exp([d_rot]x) R and
            t_true = t + d_t. The larger of the independent and the per-joint clustered one.
        covariance_over_time: (6, 6) the same from the spread between stretches of time: larger
            than `covariance` where errors last. The gates look at both.
        mpjpe_px: Mean residual over all correspondences before a camera (eq. 7), pixels.
        median_px: Median residual, pixels.
        p95_px: 95th percentile of the residuals, pixels.
        inlier_ratio: Inliers over correspondences.
        inliers: Number of inliers.
        correspondences: Number of correspondences.
        frames: Instants with an inlier, of the camera that has most.
        threshold_px: Inlier threshold used, given or estimated, pixels.
        centroid_mocap: (3,) centre of the observed joints, metres, MoCap frame.
        per_camera: Fit by camera name.
        per_joint: Fit by joint name, or number.
        time_offset_s: {camera: (offset, sigma)} where estimated, seconds.
        clock_rate: {camera: (rate, sigma)} where a clock runs wrong: by how much later it gets,
            seconds per second. The offset is then that in mid-recording.
        joint_offset_m: Where the detector sees each joint, where estimated.
        focal_error: {camera: (error, sigma)} where asked for: share by which the focal length that
            was given is too short.
        skeleton_scale: (error, sigma) where asked for: share by which the skeleton is too small.
        drift: How fast `world_T_mocap` changes, where it does beyond doubt.
        disagreements: Cameras that contradict the others, the worst first.
        camera_poses: Extrinsics by camera, where they were found (`calibrate_cameras`).
        shown: By camera, how much of its video shows the persons with MoCap, where several
            persons were in view.
        warnings: Sentences for people.
        config: The settings of the run.
        seconds: Duration of the run.

    """

    world_T_mocap: RigidTransform
    covariance: Array
    mpjpe_px: float
    median_px: float
    p95_px: float
    inlier_ratio: float
    inliers: int
    correspondences: int
    frames: int
    threshold_px: float
    centroid_mocap: Array
    per_camera: Mapping[str, GroupFit]
    per_joint: Mapping[str, GroupFit]
    config: CalibrationConfig
    covariance_over_time: Array = field(default_factory=lambda: np.zeros((6, 6)))
    time_offset_s: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    clock_rate: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    joint_offset_m: Mapping[str, JointOffset] = field(default_factory=dict)
    focal_error: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    skeleton_scale: tuple[float, float] | None = None
    drift: Drift | None = None
    disagreements: tuple[Disagreement, ...] = ()
    camera_poses: Mapping[str, CameraPose] = field(default_factory=dict)
    shown: Mapping[str, Shown] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    seconds: float = 0.0

    @property
    def sigma_rotation_deg(self) -> float:
        """Standard deviation of the rotation (root of the summed variances), degrees."""
        return _rotation_deg(self.covariance)

    @property
    def sigma_position_m(self) -> float:
        """Standard deviation of the body's centroid (root of the summed variances), metres."""
        return _root_trace(self.centroid_covariance)

    @property
    def centroid_covariance(self) -> Array:
        """(3, 3) covariance of the world position of the body's centroid, square metres.

        The translation is that of the MoCap origin, which may be far from the room: a small
        rotation moves it a long way. The centroid is where the subject is.
        """
        return self._at_centroid(self.covariance)

    @property
    def worst_sigma(self) -> tuple[float, float]:
        """The larger sigma of both covariances: rotation in degrees, centroid in metres."""
        over_time = _root_trace(self._at_centroid(self.covariance_over_time))
        return (
            max(self.sigma_rotation_deg, _rotation_deg(self.covariance_over_time)),
            max(self.sigma_position_m, over_time),
        )

    def _at_centroid(self, covariance: Array) -> Array:
        x, y, z = self.world_T_mocap.rotation @ self.centroid_mocap
        jacobian = np.hstack([[[0, z, -y], [-z, 0, x], [y, -x, 0]], np.eye(3)])
        moved: Array = jacobian @ covariance @ jacobian.T
        return moved


def _rotation_deg(covariance: Array) -> float:
    return float(np.degrees(_root_trace(covariance[:3, :3])))


def _root_trace(covariance: Array) -> float:
    """Root of the summed variances; infinite where a covariance has lost all its digits."""
    total = float(np.trace(covariance))
    return float(np.sqrt(total)) if total >= 0.0 else np.inf
