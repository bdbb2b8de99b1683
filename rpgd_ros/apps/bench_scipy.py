# SPDX-License-Identifier: Apache-2.0
"""What one would write with OpenCV and SciPy: the peer that most users would begin with."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from scipy.optimize import least_squares

from rpgd_ros.apps.bench_select import evenly, selected
from rpgd_ros.core import Camera, Observations, RigidTransform
from rpgd_ros.core.geometry import Array, skew, so3_exp
from rpgd_ros.core.linearise import linearise
from rpgd_ros.core.normal import apply_delta, twist_from_delta

START_POINTS, FINE_POINTS = 5_000, 50_000
RANSAC_DRAWS, RANSAC_CONFIDENCE = 1000, 0.999
MOST_EVALUATIONS, TOLERANCE = 50, 1e-9


def soft_l1(
    cameras: Sequence[Camera], observations: Observations, *, threshold_px: float
) -> RigidTransform:
    """OpenCV's RANSAC with AP3P per camera, the best of them; then least squares over all.

    Raises:
        RuntimeError: No camera found a pose.

    """
    start = _best_camera(cameras, evenly(observations, START_POINTS), threshold_px)
    return _fit(cameras, evenly(observations, FINE_POINTS), start, threshold_px)


def _best_camera(
    cameras: Sequence[Camera], observations: Observations, threshold_px: float
) -> RigidTransform:
    """Return the pose of that camera with which most keypoints of all cameras agree."""
    points = selected(observations)
    best, start = -1, None
    for camera, (uv, x) in zip(cameras, points, strict=True):
        found = _solve_pnp(camera, uv, x, threshold_px)
        if found is None:
            continue
        pose = _extrinsics(camera).inverse() @ found
        n_inliers = sum(
            int((np.linalg.norm(c.project(pose @ x) - uv, axis=-1) < threshold_px).sum())
            for c, (uv, x) in zip(cameras, points, strict=True)
        )
        if n_inliers > best:
            best, start = n_inliers, pose
    if start is None:
        msg = 'solvePnPRansac found no pose in any camera'
        raise RuntimeError(msg)
    return start


def _solve_pnp(camera: Camera, uv: Array, x: Array, threshold_px: float) -> RigidTransform | None:
    """Return camera_T_mocap, or None."""
    if len(uv) < 6:
        return None
    try:
        is_found, rotvec, translation, inliers = cv2.solvePnPRansac(
            x, uv, camera.matrix, camera.distortion, iterationsCount=RANSAC_DRAWS,
            reprojectionError=threshold_px, confidence=RANSAC_CONFIDENCE,
            flags=cv2.SOLVEPNP_AP3P,
        )  # fmt: skip
    except cv2.error:  # raised where it ends without enough inliers
        return None
    pose = np.asarray([rotvec, translation], dtype=np.float64).reshape(2, 3)
    if not is_found or inliers is None or not np.isfinite(pose).all():
        return None
    return RigidTransform(so3_exp(pose[0]), pose[1])


def _fit(
    cameras: Sequence[Camera], observations: Observations, start: RigidTransform,
    threshold_px: float,
) -> RigidTransform:  # fmt: skip
    """Least squares with a soft L1 loss and the analytic Jacobian, from a start nearby."""
    points = selected(observations)
    pivot = start @ np.concatenate([x for _, x in points]).mean(0)

    def residuals(delta: Array) -> Array:
        pose = apply_delta(start, delta, pivot)
        out = []
        for camera, (uv, x) in zip(cameras, points, strict=True):
            res, _ = linearise(camera, _extrinsics(camera) @ pose, x, uv, np.float64)
            out += [res.du, res.dv]
        return np.concatenate(out)

    def jacobian(delta: Array) -> Array:
        pose = apply_delta(start, delta, pivot)
        to_tangent = np.eye(6)
        to_tangent[:3, :3] = _left_jacobian(delta[:3])
        out = []
        for camera, (uv, x) in zip(cameras, points, strict=True):
            camera_T_world = _extrinsics(camera)
            _, slopes = linearise(camera, camera_T_world @ pose, x, uv, np.float64)
            chain = twist_from_delta(camera_T_world, pivot + delta[3:]) @ to_tangent
            out += [row.T @ chain for row in slopes.rows()]
        return np.concatenate(out)

    end = least_squares(
        residuals, np.zeros(6), jac=jacobian, loss='soft_l1', f_scale=threshold_px / 3.0,
        x_scale='jac', max_nfev=MOST_EVALUATIONS, xtol=TOLERANCE, ftol=TOLERANCE,
    )  # fmt: skip
    return apply_delta(start, end.x, pivot)


def _extrinsics(camera: Camera) -> RigidTransform:
    return camera.camera_T_world or RigidTransform.identity()


def _left_jacobian(rotvec: Array) -> Array:
    """Return (3, 3) J with `exp(v + dv) = exp(J dv) exp(v)` for small dv."""
    angle2 = float(rotvec @ rotvec)
    k = skew(rotvec)
    if angle2 < 1e-10:
        first: Array = np.eye(3) + 0.5 * k
        return first
    angle = np.sqrt(angle2)
    full: Array = (
        np.eye(3)
        + (1.0 - np.cos(angle)) / angle2 * k
        + (angle - np.sin(angle)) / (angle2 * angle) * (k @ k)
    )
    return full
