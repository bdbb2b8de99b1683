# SPDX-License-Identifier: Apache-2.0
"""Simulated problems of the benchmark, and how far a pose is from their answer."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from rpgd_ros.core import Camera, Observations, RigidTransform
from rpgd_ros.core.geometry import Array, BoolArray, rotation_angle
from rpgd_ros.core.linearise import Sight, linearise
from rpgd_ros.core.normal import twist_from_delta
from rpgd_ros.simulation import Corruption, Faults, Truth, Twin, build_scene, preset, simulate
from rpgd_ros.simulation.presets import OutlierKind

# Inlier threshold tau that a user would choose for each, pixels: what peers are told.
THRESHOLDS_PX = {'mpi_inf_3dhp': 1.0, 'human36m': 4.0, 'aistpp': 15.0, 'kinect': 20.0}
RIGHT_DEG, RIGHT_M = 0.5, 0.02  # nearer than this, a pose is right; a failed search is far off


class Case(NamedTuple):
    """Which problem; the same case is the same bits.

    Attributes:
        data: Preset that it is drawn from.
        frames: Of each camera.
        seed: Of everything random.
        kind: Of the outliers beyond the preset's own.
        ratio: Share of the observations that become such outliers.
        bias_m: Standard deviation per axis of the joint-definition offsets, metres.
        joints: Convention of MoCap and keypoints; '' = the preset's.

    """

    data: str
    frames: int
    seed: int
    kind: OutlierKind = 'uniform'
    ratio: float = 0.0
    bias_m: float = 0.0
    joints: str = ''


class Error(NamedTuple):
    """How far a pose is from the truth.

    Attributes:
        rotation_deg: Angle between the two.
        points_m: RMS displacement of the body's points: that of the origins would depend on
            where the MoCap system put its own.
        mpjpe_px: Mean residual over all correspondences before a camera (eq. 7).

    """

    rotation_deg: float
    points_m: float
    mpjpe_px: float

    @property
    def is_right(self) -> bool:
        """Whether the search found the answer."""
        return self.rotation_deg < RIGHT_DEG and self.points_m < RIGHT_M


def build(case: Case) -> Twin:
    """Simulate the problem of a case.

    Raises:
        InputError: Unknown names, values out of range.

    """
    settings = preset(case.data)
    if case.joints:
        settings = replace(settings, mocap_joints=case.joints, keypoint_joints=case.joints)
    faults = Faults(Corruption(case.ratio, case.kind), bias_m=case.bias_m)
    scene = build_scene(
        settings, case.seed, seconds=case.frames / settings.camera_hz, faults=faults
    )
    recording = simulate(scene)
    pick = [keypoint for _, keypoint in recording.pairs]
    inliers = tuple(inlier[:, pick] for inlier in recording.truth.inliers)
    truth = replace(recording.truth, inliers=inliers)
    return Twin(recording.cameras, recording.observations(), truth)


def judge(problem: Twin, pose: RigidTransform) -> Error:
    """Compare a pose with the truth."""
    truth = problem.truth.world_T_mocap
    x = body_points(problem.observations)
    apart = (pose @ x) - (truth @ x)
    return Error(
        rotation_deg=float(np.degrees(rotation_angle(truth.rotation @ pose.rotation.T))),
        points_m=float(np.sqrt((apart**2).sum(-1).mean())),
        mpjpe_px=mpjpe_px(problem.cameras, problem.observations, pose),
    )


def body_points(observations: Observations) -> Array:
    """Return the joints (n, 3) of all frames, metres, MoCap frame."""
    x = observations.views[0].x_mocap.reshape(-1, 3)
    there: Array = x[np.isfinite(x).all(-1)]
    return there


def mpjpe_px(
    cameras: tuple[Camera, ...], observations: Observations, pose: RigidTransform
) -> float:
    """Return the mean residual over the correspondences before a camera (eq. 7), pixels."""
    total, count = 0.0, 0
    for camera, view in zip(cameras, observations.views, strict=True):
        residual = np.linalg.norm(camera.project(pose @ view.x_mocap) - view.uv, axis=-1)
        known = residual[np.isfinite(residual)]
        total, count = total + float(known.sum()), count + len(known)
    return total / count if count else float('nan')


@dataclass(frozen=True, slots=True)
class Bound:
    """Cramer-Rao bound: what no unbiased estimate can be better than, RMS.

    Attributes:
        rotation_deg: Of the rotation.
        points_m: Of the body's points.

    """

    rotation_deg: float
    points_m: float


def cramer_rao(problem: Twin) -> Bound:
    """Return the bound from the Fisher information at the truth.

    The noise is the one that was drawn, and which correspondences are outliers is known.

    Raises:
        LinAlgError: No pose is determined. Rounding decides whether `inv` notices that.

    """
    cameras, observations, truth = problem
    x_world = truth.world_T_mocap @ body_points(observations)
    pivot = x_world.mean(0)
    information = np.zeros((6, 6))
    for camera, view, inlier in zip(cameras, observations.views, truth.inliers, strict=True):
        sight = Sight(camera, view)
        to_twist = twist_from_delta(sight.camera_T_world, pivot)
        information += to_twist.T @ _by_twist(sight, inlier, truth) @ to_twist
    if np.linalg.matrix_rank(information, hermitian=True) < 6:
        msg = 'the information is singular'
        raise np.linalg.LinAlgError(msg)
    covariance = np.linalg.inv(information)
    # A rotation w moves a point at y from the pivot by w cross y, whose square is w^T M w.
    y = x_world - pivot
    moved = np.eye(3) * (y * y).sum(-1).mean() - y.T @ y / len(y)
    points = np.trace(moved @ covariance[:3, :3]) + np.trace(covariance[3:, 3:])
    return Bound(
        rotation_deg=float(np.degrees(np.sqrt(np.trace(covariance[:3, :3])))),
        points_m=float(np.sqrt(points)),
    )


def _by_twist(sight: Sight, inlier: BoolArray, truth: Truth) -> Array:
    """(6, 6) Fisher information by the twist of one camera.

    A residual's covariance is `sigma_px^2 I + sigma_m^2 A A^T`, where A (2, 3) is the derivative
    by the point: noise of the skeleton counts as it projects.
    """
    camera_T_mocap = sight.camera_T_world @ truth.world_T_mocap
    information = np.zeros((6, 6))
    for frames in sight.slices():
        x, uv = sight.view.x_mocap[frames].reshape(-1, 3), sight.view.uv[frames].reshape(-1, 2)
        res, slopes = linearise(sight.camera, camera_T_mocap, x, uv, np.float64)
        known = inlier[frames].ravel() & res.in_view
        row_u, row_v = (row[:, known] for row in slopes.rows())
        by_point = np.stack([row_u[3:], row_v[3:]])
        spread = truth.sigma_m**2 * np.einsum('akn,bkn->nab', by_point, by_point)
        weight = np.linalg.inv(spread + truth.sigma_px**2 * np.eye(2))
        rows = np.stack([row_u, row_v])
        information += np.einsum('apn,nab,bqn->pq', rows, weight, rows, optimize=True)
    nu = truth.student_nu
    # Of a bivariate Student-t, against the Gaussian of the same scale.
    return information * ((nu + 2.0) / (nu + 4.0) if nu else 1.0)
