# SPDX-License-Identifier: Apache-2.0
"""Collects the figures of a solve."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from rpgd_ros.core.agreement import Disagreement, disagreements, lost_cameras
from rpgd_ros.core.covariance import covariances
from rpgd_ros.core.dating import moved_meanwhile
from rpgd_ros.core.findings import Findings
from rpgd_ros.core.geometry import Array
from rpgd_ros.core.linearise import Sight
from rpgd_ros.core.noise import Loss, NoiseModel, SquaredLoss
from rpgd_ros.core.noise_fit import noise_at
from rpgd_ros.core.quality import fits
from rpgd_ros.core.refine import Descent, appraise
from rpgd_ros.core.result import Calibration

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rpgd_ros.core.config import CalibrationConfig
    from rpgd_ros.core.examine import Tally
    from rpgd_ros.core.settle import Details

ROUNDING_PX2 = 1e-8  # squared rounding of a residual in single precision: no data are better


def report(
    sights: Sequence[Sight],
    descent: Descent,
    loss: Loss,
    *,
    threshold_px: float,
    centroid: Array,
    details: Details | None,
    joint_names: tuple[str, ...] | None,
    config: CalibrationConfig,
    seconds: float,
    order: Sequence[str],
) -> Calibration:
    """Collect the figures, cameras in the caller's order."""
    counts = descent.examination.tally
    n, n_in = int(counts.correspondences.sum()), int(counts.inliers.sum())
    names = joint_names or tuple(str(j) for j in range(sights[0].view.n_joints))
    if details is None:
        noise = loss if isinstance(loss, NoiseModel) else noise_at(sights, descent.pose)
        findings = Findings.of_pose(sights, descent.pose, centroid, noise)
    else:
        findings = Findings.of(details)
    covariance, over_time = covariances(
        descent, centroid, variance=_variance(descent, loss, n), solution=findings.solution,
        systematic=findings.systematic,
    )  # fmt: skip
    median, p95 = np.quantile(counts.sample_px, [0.5, 0.95]) if n else (np.nan, np.nan)
    with_dates = findings.drift is None
    contradicting = _contradicting(sights, descent, details, centroid, with_dates=with_dates)
    by_camera = fits(counts, [s.camera.name for s in sights], axis=1)
    return Calibration(
        world_T_mocap=descent.pose,
        covariance=covariance,
        covariance_over_time=over_time,
        mpjpe_px=float(counts.error_px.sum()) / n if n else float('nan'),
        median_px=float(median),
        p95_px=float(p95),
        inlier_ratio=n_in / n if n else 0.0,
        inliers=n_in,
        correspondences=n,
        frames=int(counts.frames.max()),
        threshold_px=threshold_px,
        centroid_mocap=centroid,
        per_camera={name: by_camera[name] for name in order if name in by_camera},
        per_joint=fits(counts, names, axis=0),
        config=config,
        time_offset_s=findings.time_offset_s,
        clock_rate=findings.clock_rate,
        joint_offset_m=findings.joint_offset_m(names),
        focal_error=findings.focal_error,
        skeleton_scale=findings.scale,
        drift=findings.drift,
        disagreements=tuple(contradicting),
        warnings=(
            *findings.warnings,
            *_camera_warnings(sights, counts, contradicting),
            *_unfinished(descent, details, config),
        ),
        seconds=seconds,
    )


def _variance(descent: Descent, loss: Loss, n: int) -> float:
    """Factor of the loss to a log likelihood: 1 for a fitted one.

    The squared loss is a log likelihood only when divided by the variance per axis.
    """
    if not isinstance(loss, SquaredLoss) or n <= 3:
        return 1.0
    return max(2.0 * descent.examination.cost / (2 * n - 6), ROUNDING_PX2)


def _contradicting(
    sights: Sequence[Sight], descent: Descent, details: Details | None, centroid: Array,
    *, with_dates: bool,
) -> list[Disagreement]:  # fmt: skip
    """Name the cameras that contradict the others, not counting what has a common cause.

    The focal length of one camera alone is none: it may as well be what is left of its move.
    """
    explained = details and details.explained
    if (
        details is not None
        and explained
        and (explained.unknowns.with_scale or len(details.lenses.focal.wrong) > 1)
    ):
        state, _, noise = explained
        sights = details.problem.scene(state).sights
        descent = appraise(sights, state.pose, centroid, noise, threshold_px=noise.threshold_px)
    if details is not None and with_dates:
        moved = moved_meanwhile(sights, descent.pose, centroid, details.at.noise)
        if moved is not None:
            return [moved]
    return disagreements(sights, descent, centroid)


def _camera_warnings(
    sights: Sequence[Sight], counts: Tally, contradicting: Sequence[Disagreement]
) -> list[str]:
    lost = lost_cameras([s.camera.name for s in sights], counts)
    return [d.sentence() for d in contradicting] + [
        f'camera {name} follows something else in {100 * share:.0f} % of its frames. '
        'Check that its detector picks the person with the MoCap skeleton'
        for name, share in lost
    ]


def _unfinished(descent: Descent, details: Details | None, config: CalibrationConfig) -> list[str]:
    refine = config.refine
    if descent.is_converged or details is not None or refine.method != 'newton':
        return []
    ended = f'the refinement ended before the optimum, after {refine.iterations} steps'
    return [f'{ended}. Raise `refine.iterations`']


def with_excluded(
    rest: Calibration, whole: Calibration, named: Sequence[Disagreement]
) -> Calibration:
    """Return the solve without the moved cameras, with what was found out about them."""
    moved = {d.camera for d in named}
    fits_of_moved = {name: whole.per_camera[name] for name in whole.per_camera if name in moved}
    excluded = f'{", ".join(sorted(moved))}: not used for the transform'
    return replace(
        rest,
        disagreements=(*named, *rest.disagreements),
        per_camera={**rest.per_camera, **fits_of_moved},
        warnings=(*(d.sentence() for d in named), excluded, *rest.warnings),
    )
