# SPDX-License-Identifier: Apache-2.0
"""Where a camera without extrinsics was found to stand."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from rpgd_ros.core.geometry import Array, RigidTransform, skew


@dataclass(frozen=True, slots=True, eq=False)
class CameraPose:
    """The extrinsics of one camera, and how far to trust them.

    Attributes:
        camera_T_world: World to the camera's optical frame.
        covariance: (6, 6) of (d_rot [rad], d_t [m]) along the axes of the camera:
            R_true = exp([d_rot]x) R and t_true = t + d_t.
        centroid_world: (3,) centre of the body, metres: where the sigma of the position holds.

    """

    camera_T_world: RigidTransform
    covariance: Array
    centroid_world: Array

    @property
    def world_T_camera(self) -> RigidTransform:
        """Pose of the camera in the world, as TF carries it."""
        return self.camera_T_world.inverse()

    @property
    def world_covariance(self) -> Array:
        """(6, 6) of `world_T_camera` by (d_rot, d_t), along the axes of the world."""
        back = self.camera_T_world.rotation.T
        jacobian = -np.kron(np.eye(2), back)
        jacobian[3:, :3] = -back @ skew(self.camera_T_world.translation)
        moved: Array = jacobian @ self.covariance @ jacobian.T
        return moved

    @property
    def sigma_rotation_deg(self) -> float:
        """Standard deviation of the rotation (root of the summed variances), degrees."""
        return float(np.degrees(np.sqrt(np.trace(self.covariance[:3, :3]))))

    @property
    def sigma_position_m(self) -> float:
        """Standard deviation, before the camera, of a point at the body's centre, metres."""
        lever = self.camera_T_world.rotation @ self.centroid_world
        jacobian = np.hstack([-skew(lever), np.eye(3)])
        return float(np.sqrt(np.trace(jacobian @ self.covariance @ jacobian.T)))

    @property
    def sigma_centre_m(self) -> float:
        """Standard deviation of the camera's own place in the world, metres."""
        return float(np.sqrt(np.trace(self.world_covariance[3:, 3:])))

    def turned(self, new_R_old: Array) -> CameraPose:
        """Return the pose of a frame that is turned against the camera's."""
        both = np.kron(np.eye(2), new_R_old)
        return CameraPose(
            RigidTransform(new_R_old, np.zeros(3)) @ self.camera_T_world,
            both @ self.covariance @ both.T,
            self.centroid_world,
        )


def is_mocap_world(poses: Mapping[str, CameraPose], covariance: Array) -> bool:
    """Whether a calibration found cameras in the MoCap frame, which then is the world.

    Args:
        poses: `Calibration.camera_poses`.
        covariance: Its covariance: an identity by definition has none.

    """
    return bool(poses) and not covariance.any()


def through_world(
    camera_T_mocap: RigidTransform, covariance: Array,
    world_T_mocap: RigidTransform, world_covariance: Array, centroid_mocap: Array,
) -> CameraPose:  # fmt: skip
    """Return the pose of a camera in a world that the MoCap frame is known in.

    What is not known of `world_T_mocap` is not known of the camera. Both are taken for
    independent; joint offsets that all detectors share move both alike, so that the sum is the
    careful side.

    Args:
        camera_T_mocap: The camera's own solve.
        covariance: (6, 6) of it, along the axes of the camera.
        world_T_mocap: That of the cameras with extrinsics.
        world_covariance: (6, 6) of it, along the axes of the world.
        centroid_mocap: (3,) centre of the body, metres.

    """
    camera_T_world = camera_T_mocap @ world_T_mocap.inverse()
    r = camera_T_world.rotation
    # With the true rotation exp(a) R_cm of the camera and exp(w) R_wm of the world, that of the
    # product is exp(a - R w) R; its translation t_cm - R t_wm follows from both.
    lever = skew(r @ world_T_mocap.translation)
    by_camera = np.eye(6)
    by_camera[3:, :3] = lever
    by_world = -np.kron(np.eye(2), r)
    by_world[3:, :3] = -lever @ r
    total = by_camera @ covariance @ by_camera.T + by_world @ world_covariance @ by_world.T
    return CameraPose(camera_T_world, 0.5 * (total + total.T), world_T_mocap @ centroid_mocap)
