# SPDX-License-Identifier: Apache-2.0
"""What a pose is worth: figures per camera and joint, covariance, and the gates."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rpgd_ros.core.errors import CalibrationError, Reason
from rpgd_ros.core.geometry import Array, BoolArray, IntArray
from rpgd_ros.core.result import Calibration, GroupFit

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rpgd_ros.core.config import AcceptConfig
    from rpgd_ros.core.examine import Tally
    from rpgd_ros.core.linearise import Sight
    from rpgd_ros.core.refine import Descent

# A person: 0.5 m crouching child to 2.5 m arms up. Nothing that is worn or held makes it 5 m.
LARGEST_BODY_M = 5.0
SMALLEST_BODY_M = 0.05
UNITS_PER_M = {'millimetres': 1000.0, 'centimetres': 100.0, 'inches': 39.37}
TYPICAL_BODY_M = 1.5  # diagonal of the joints' bounding box: 1.2 sitting to 2 walking
BODY_FRAMES, BODY_FRAMES_PER_CAMERA = 200, 20  # looked at for size and motion: 10 a second of walk
LINE_RATIO = 1e-3  # second over first extent of the points: a line, up to rounding and noise


def fits(counts: Tally, names: Sequence[str], *, axis: int) -> dict[str, GroupFit]:
    """Sum a tally to one `GroupFit` per joint (axis 0) or camera (axis 1)."""
    n, n_in = counts.correspondences.sum(axis), counts.inliers.sum(axis)
    error, error_in = counts.error_px.sum(axis), counts.inlier_error_px.sum(axis)
    bias = counts.bias_px.sum(axis)
    out = {}
    for k, name in enumerate(names):
        mean_in = [float(x) / int(n_in[k]) if n_in[k] else np.nan for x in (error_in[k], *bias[k])]
        out[name] = GroupFit(
            name, int(n[k]), int(n_in[k]), float(error[k]) / int(n[k]) if n[k] else np.nan,
            mean_in[0], (mean_in[1], mean_in[2]),
        )  # fmt: skip
    return out


def covariances(
    descent: Descent, centroid_mocap: Array, *, variance: float = 1.0
) -> tuple[Array, Array]:
    """Return `Calibration.covariance` and `Calibration.covariance_over_time`, (6, 6) each.

    A detector's joint is not the MoCap's joint, and the difference does not average out over
    frames. So the pull of the residuals is also summed per joint, and its spread between joints
    gives a clustered covariance; the first result is at least as large as that and as the one of
    independent errors. The second is from the spread between stretches of time: it grows when
    errors last, as those of a detector that follows somebody else.

    Args:
        descent: The end of the refinement.
        centroid_mocap: (3,) metres.
        variance: Factor of the loss to a log likelihood (1 for a fitted `NoiseModel`).

    """
    inverse = _inverse(descent.normal.hessian, descent.normal.information)
    seen = descent.examination
    # From the pivot's displacement d to the translation: d_t = d + lever x w.
    x, y, z = descent.pose.rotation @ centroid_mocap
    to_origin = np.eye(6)
    to_origin[3:, :3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]

    def moved(about_pivot: Array) -> Array:
        out: Array = to_origin @ about_pivot @ to_origin.T
        return 0.5 * (out + out.T)

    by_joint = inverse @ _spread_between(seen.joint_scores) @ inverse
    by_time = inverse @ _spread_between(seen.time_scores) @ inverse
    return moved(larger(variance * inverse, by_joint)), moved(by_time)


def _spread_between(scores: Array) -> Array:
    """(6, 6) covariance of the sum of independent groups, from the scores (groups, 6)."""
    used = scores[np.any(scores != 0.0, axis=1)]
    apart = used - used.mean(0) if len(used) else used
    spread: Array = apart.T @ apart * (len(used) / max(len(used) - 1, 1))
    return spread


def larger(a: Array, b: Array) -> Array:
    """Return the smallest covariance that is at least `a` everywhere and `b` where b exceeds a."""
    root = np.linalg.cholesky(a)
    inverse = np.linalg.inv(root)
    values, vectors = np.linalg.eigh(inverse @ b @ inverse.T)
    out: Array = root @ (vectors * np.maximum(values, 1.0)) @ vectors.T @ root.T
    return out


def _inverse(hessian: Array, information: Array) -> Array:
    """Invert the Hessian; where it is not positive, the Gauss-Newton part with a floor."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-30))
    for matrix in (hessian, information):
        values, vectors = np.linalg.eigh(matrix * np.outer(scale, scale))
        if values[0] > 1e-12 * values[-1]:
            break
    values = np.maximum(values, 1e-12 * max(values[-1], 1e-30))
    inverse: Array = (vectors / values) @ vectors.T * np.outer(scale, scale)
    return inverse


def check_body(sights: Sequence[Sight]) -> None:
    """Refuse skeletons that are not of a person in metres, or lie on a line.

    Raises:
        CalibrationError: NO_DATA, TOO_FEW_POINTS, WRONG_UNIT, DEGENERATE_GEOMETRY.

    """
    seen = [_sampled_joints(s, len(sights)) for s in sights]
    x = np.concatenate(seen) if seen else np.empty((0, 1, 3))
    there = _finite(x)
    if not there.any():
        msg = 'no correspondence: no joint was seen by MoCap and camera at the same time'
        raise CalibrationError(Reason.NO_DATA, msg)
    if there.sum() < 6:
        msg = f'{there.sum()} correspondences, need at least 6'
        raise CalibrationError(Reason.TOO_FEW_POINTS, msg)
    _check_size(x)
    points = x[there] - x[there].mean(0)
    extent = np.sqrt(np.maximum(np.linalg.eigvalsh(points.T @ points)[::-1], 0.0))
    if extent[1] < LINE_RATIO * extent[0] or extent[0] == 0.0:
        shape = 'point' if extent[0] < 1e-9 else 'line'
        msg = (
            f'all joints lie on one {shape} for the whole recording: the pose is not determined. '
            'Check the joint map and that the skeleton moves'
        )
        raise CalibrationError(Reason.DEGENERATE_GEOMETRY, msg)


def _sampled_joints(sight: Sight, n_cameras: int) -> Array:
    """(m, J, 3) joints of this camera's part of some frames, NaN where no correspondence is."""
    wanted = max(BODY_FRAMES // n_cameras, BODY_FRAMES_PER_CAMERA)
    view = sight.at_frames(spread(sight.view.n_frames, wanted)).view
    return np.where(view.seen()[..., None], view.x_mocap, np.nan)


def spread(n_frames: int, wanted: int) -> IntArray:
    """Return up to `wanted` frame numbers, evenly spread from first to last."""
    return np.unique(
        np.linspace(0, max(n_frames - 1, 0), min(n_frames, wanted)).round().astype(int)
    )


def _finite(x: Array) -> BoolArray:
    """Whether points (..., 3) are there."""
    there: BoolArray = np.isfinite(x.sum(-1))
    return there


def _check_size(x: Array) -> None:
    there = _finite(x)
    whole = there.sum(1) >= 0.5 * there.sum(1).max()
    low = np.where(there[..., None], x, np.inf)[whole].min(1)
    high = np.where(there[..., None], x, -np.inf)[whole].max(1)
    size = float(np.median(np.linalg.norm(high - low, axis=-1)))
    if SMALLEST_BODY_M <= size <= LARGEST_BODY_M or x.shape[1] < 3 or size == 0.0:
        return
    unit = min(UNITS_PER_M, key=lambda u: abs(np.log(size / (TYPICAL_BODY_M * UNITS_PER_M[u]))))
    guess = (
        f'looks like {unit}: set `mocap.units`' if size > LARGEST_BODY_M else 'check `mocap.units`'
    )
    msg = f'the skeleton spans {size:.4g} m, a person 0.5 to 2.5 m; {guess}'
    raise CalibrationError(Reason.WRONG_UNIT, msg)


def motion_m(sights: Sequence[Sight]) -> float:
    """Distance that the body covered: diagonal of the box that holds its centre, metres."""
    centres = []
    for sight in sights:
        x = _sampled_joints(sight, len(sights))
        there = _finite(x)
        rows = there.sum(1) >= max(1, 0.5 * there.sum(1).max(initial=0))
        if rows.any():
            centres.append(np.nanmean(np.where(there[..., None], x, np.nan)[rows], 1))
    if not centres:
        return 0.0
    low, high = np.quantile(np.concatenate(centres), [0.02, 0.98], axis=0)
    return float(np.linalg.norm(high - low))


def refuse(calibration: Calibration, gates: AcceptConfig, moved_m: float) -> None:
    """Raise when nobody should use the calibration; it travels inside the error.

    Raises:
        CalibrationError: DEGENERATE_MOTION, TOO_FEW_INLIERS, TOO_FEW_FRAMES, UNCERTAIN.

    """
    for is_bad, reason, message in _complaints(calibration, gates, moved_m):
        if is_bad:
            raise CalibrationError(reason, message, calibration=calibration)


def _complaints(
    c: Calibration, gates: AcceptConfig, moved_m: float
) -> Iterator[tuple[bool, Reason, str]]:
    """Yield for each gate whether it is closed, the reason, and what to tell the person."""
    yield (
        moved_m < gates.min_motion_m,
        Reason.DEGENERATE_MOTION,
        (
            f'the person moved {moved_m:.2f} m, need {gates.min_motion_m:.2f} m. '
            'Walk through the room'
        ),
    )
    worst = min(c.per_camera.values(), key=lambda fit: fit.inlier_ratio)
    found = (
        f'{c.inliers} of {c.correspondences} keypoints ({100 * c.inlier_ratio:.1f} %) agree with '
        f'the best pose within {c.threshold_px:.1f} px (least in camera {worst.name}: '
        f'{100 * worst.inlier_ratio:.1f} %)'
    )
    yield (
        c.inlier_ratio < gates.min_inlier_ratio,
        Reason.TOO_FEW_INLIERS,
        (
            f'{found}, need {100 * gates.min_inlier_ratio:.0f} %. '
            'Check that cameras and MoCap see the same person and share a clock'
        ),
    )
    yield (
        c.inliers < gates.min_pairs,
        Reason.TOO_FEW_INLIERS,
        f'{found}, need {gates.min_pairs} keypoints. Record for longer',
    )
    yield (
        c.frames < gates.min_frames,
        Reason.TOO_FEW_FRAMES,
        f'{c.frames} frames with an agreeing keypoint, need {gates.min_frames}. Record for longer',
    )
    sigma_deg, sigma_m = c.worst_sigma
    advice = 'Walk further, and nearer to the cameras'
    yield (
        sigma_deg > gates.max_sigma_deg,
        Reason.UNCERTAIN,
        (
            f'the rotation is known to {sigma_deg:.2f} deg only, need '
            f'{gates.max_sigma_deg:.2f} deg. {advice}'
        ),
    )
    yield (
        sigma_m > gates.max_sigma_m,
        Reason.UNCERTAIN,
        (
            f'the position is known to {1000 * sigma_m:.0f} mm only, need '
            f'{1000 * gates.max_sigma_m:.0f} mm. {advice}'
        ),
    )
