# SPDX-License-Identifier: Apache-2.0
"""Figures per camera and joint, and the gates that a calibration must pass."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rpgd_ros.core.errors import CalibrationError, Reason
from rpgd_ros.core.result import Calibration, GroupFit

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rpgd_ros.core.config import AcceptConfig
    from rpgd_ros.core.examine import Tally


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
        not sigma_deg <= gates.max_sigma_deg,  # NaN is no accuracy
        Reason.UNCERTAIN,
        (
            f'the rotation is known to {sigma_deg:.2f} deg only, need '
            f'{gates.max_sigma_deg:.2f} deg. {advice}'
        ),
    )
    yield (
        not sigma_m <= gates.max_sigma_m,
        Reason.UNCERTAIN,
        (
            f'the position is known to {1000 * sigma_m:.0f} mm only, need '
            f'{1000 * gates.max_sigma_m:.0f} mm. {advice}'
        ),
    )
