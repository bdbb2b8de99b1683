# SPDX-License-Identifier: Apache-2.0
"""The whole solve: robust start, refinement, figures, gates."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from rpgd_ros.core.agreement import Disagreement, disagreements, lost_cameras
from rpgd_ros.core.body import check_body, motion_m, sampled_joints
from rpgd_ros.core.clocks import Clocks, set_clocks
from rpgd_ros.core.config import (
    PAPER_RANSAC_FRAMES,
    PAPER_REFINE_FRAMES,
    PAPER_THRESHOLD_PX,
    CalibrationConfig,
)
from rpgd_ros.core.covariance import covariances
from rpgd_ros.core.diagnose import (
    MAY_BE_MIRRORED,
    MIRRORED,
    is_mirrored,
    refuse_ambiguous,
    refuse_swapped,
)
from rpgd_ros.core.errors import CalibrationError, InputError, Reason
from rpgd_ros.core.linearise import Sight
from rpgd_ros.core.noise import Loss, NoiseModel, SquaredLoss, noise_at
from rpgd_ros.core.quality import fits, refuse
from rpgd_ros.core.ransac import published, robust_start
from rpgd_ros.core.refine import Descent, adam, appraise, descend, finish
from rpgd_ros.core.result import Calibration
from rpgd_ros.core.thin import MIDDLE_POINTS, budget, spread, thin

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rpgd_ros.core.camera import Camera
    from rpgd_ros.core.examine import Tally
    from rpgd_ros.core.geometry import Array, RigidTransform
    from rpgd_ros.core.observations import Observations

ROUNDING_PX2 = 1e-8  # squared rounding of a residual in single precision: no data are better


@dataclass(frozen=True, slots=True)
class _Run:
    """Progress, cancellation and time limit of one solve."""

    progress: Callable[[str, float], None] | None
    should_stop: Callable[[], bool] | None
    clock: Callable[[], float]
    started: float
    max_seconds: float

    def check(self, stage: str) -> Callable[[float], None]:
        """Return what a stage calls with its fraction done."""
        furthest = 0.0

        def tick(fraction: float) -> None:
            nonlocal furthest
            furthest = min(max(furthest, fraction), 1.0)  # a stage may walk over the data twice
            if self.progress is not None:
                self.progress(stage, furthest)
            if self.should_stop is not None and self.should_stop():
                msg = f'cancelled during {stage}'
                raise CalibrationError(Reason.CANCELLED, msg)
            if self.max_seconds and self.clock() - self.started > self.max_seconds:
                msg = f'the time limit of {self.max_seconds:g} s ended the run during {stage}'
                raise CalibrationError(Reason.CANCELLED, msg)

        return tick


def calibrate(
    cameras: Sequence[Camera],
    observations: Observations,
    *,
    config: CalibrationConfig | None = None,
    seed: int | None = None,
    progress: Callable[[str, float], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
    clock: Callable[[], float] = time.perf_counter,
) -> Calibration:
    """Find `world_T_mocap` from what cameras saw of a moving person.

    Args:
        cameras: One per view of the observations. A single camera without extrinsics is the
            world itself.
        observations: Skeletons and keypoints, see `Observations`.
        config: Settings; None = `CalibrationConfig()`.
        seed: Seed of the draws; None = `config.ransac.seed`.
        progress: Called with (stage, fraction done).
        should_stop: Polled; True ends the run with CANCELLED.
        clock: Seconds, monotonic, for the time limit.

    Raises:
        CalibrationError: The data do not determine a pose that anybody should use.
        InputError: Cameras and observations do not fit together.

    """
    config = config or CalibrationConfig()
    run = _Run(progress, should_stop, clock, clock(), config.max_seconds)
    sights = _sights(cameras, observations)
    check_body(sights)
    rng = np.random.default_rng(config.ransac.seed if seed is None else seed)
    centroid = _centroid(sights)
    clocks = Clocks()
    if config.ransac.score == 'inliers':
        pose, noise = _published_start(sights, config, rng, run)
        rival_ratio = np.inf
    else:
        start = robust_start(sights, config.ransac, rng, check=run.check('start'))
        if config.time.estimate_offset != 'off':
            clocks, sights, start = set_clocks(
                sights, observations.mocap, start, centroid, config, rng, check=run.check('clocks')
            )
        (pose, noise, _), rival_ratio = start.candidates[0], start.rival_ratio
    descent, loss, threshold_px = _refine(sights, pose, noise, centroid, config, run)
    calibration = _report(
        sights, descent, loss, threshold_px=threshold_px, centroid=centroid, clocks=clocks,
        joint_names=observations.joint_names, config=config, seconds=run.clock() - run.started,
        order=[c.name for c in cameras],
    )  # fmt: skip
    moved = {d.camera for d in calibration.disagreements if d.rival is None}
    if moved and config.rig.on_bumped_camera == 'exclude':
        kept = [v for v, camera in enumerate(cameras) if camera.name not in moved]
        views = tuple(observations.views[v] for v in kept)
        rest = calibrate(
            [cameras[v] for v in kept], replace(observations, views=views), config=config,
            seed=seed, progress=progress, should_stop=should_stop, clock=clock,
        )  # fmt: skip
        return _with_excluded(rest, calibration, moved)
    _pass_gates(sights, calibration, rival_ratio, run)
    return calibration


def _with_excluded(rest: Calibration, whole: Calibration, moved: set[str]) -> Calibration:
    """Return the solve without the moved cameras, with what was found out about them."""
    named = tuple(d for d in whole.disagreements if d.camera in moved)
    fits_of_moved = {name: whole.per_camera[name] for name in whole.per_camera if name in moved}
    excluded = f'{", ".join(sorted(moved))}: not used for the transform'
    return replace(
        rest,
        disagreements=named + rest.disagreements,
        per_camera={**rest.per_camera, **fits_of_moved},
        warnings=(*(d.sentence() for d in named), excluded, *rest.warnings),
        seconds=whole.seconds + rest.seconds,
    )


def _pass_gates(
    sights: Sequence[Sight], calibration: Calibration, rival_ratio: float, run: _Run
) -> None:
    """Raise when nobody should use the calibration, naming the cause where it is known."""
    config = calibration.config
    refuse_swapped(sights, calibration)
    try:
        refuse(calibration, config.accept, motion_m(sights))
        refuse_ambiguous(rival_ratio)
    except CalibrationError as refusal:
        check = run.check('diagnosis')
        if refusal.reason in MAY_BE_MIRRORED and is_mirrored(sights, config.ransac, check=check):
            raise CalibrationError(
                Reason.MIRRORED_AXES, MIRRORED, calibration=calibration
            ) from refusal
        raise


def _sights(cameras: Sequence[Camera], observations: Observations) -> list[Sight]:
    """Pair cameras with views, by name, so that their order is that of no caller.

    Those that saw nothing are kept out.
    """
    if len(cameras) != len(observations.views):
        msg = f'{len(cameras)} cameras for {len(observations.views)} views'
        raise InputError(Reason.BAD_INPUT, msg)
    if len({c.name for c in cameras}) < len(cameras):
        msg = f'cameras need different names, got {", ".join(c.name for c in cameras)}'
        raise InputError(Reason.BAD_INPUT, msg)
    blind = [c.name for c in cameras if c.camera_T_world is None]
    if blind and len(cameras) > 1:
        msg = f'no extrinsics for {", ".join(blind)}: each of several cameras needs camera_T_world'
        raise CalibrationError(Reason.NO_EXTRINSICS, msg)
    pairs = sorted(zip(cameras, observations.views, strict=True), key=lambda pair: pair[0].name)
    sights = [Sight(c, v) for c, v in pairs if v.n_frames and v.uv.shape[1]]
    if not sights:
        msg = 'no frame with skeleton and keypoints'
        raise CalibrationError(Reason.NO_DATA, msg)
    return sights


def _centroid(sights: Sequence[Sight]) -> Array:
    """(3,) centre of the observed joints, metres: the pivot of all steps."""
    x = np.concatenate([sampled_joints(s, len(sights)).reshape(-1, 3) for s in sights])
    centre: Array = np.median(x[np.isfinite(x).all(-1)], axis=0)
    return centre


def _published_start(
    sights: Sequence[Sight], config: CalibrationConfig, rng: np.random.Generator, run: _Run
) -> tuple[RigidTransform, NoiseModel]:
    tau = config.ransac.threshold_px or PAPER_THRESHOLD_PX
    ransac = replace(config.ransac, threshold_px=tau)
    few = thin(sights, ransac.frame_stride, lambda n: spread(n, PAPER_RANSAC_FRAMES))
    pose = published(few, ransac, rng, check=run.check('start'))
    return pose, noise_at(few, pose)


def _refine(
    sights: Sequence[Sight], pose: RigidTransform, noise: NoiseModel, centroid: Array,
    config: CalibrationConfig, run: _Run,
) -> tuple[Descent, Loss, float]:  # fmt: skip
    """Refine as configured; return the end, the loss, and the threshold of an inlier."""
    check, refine, steps = run.check('refinement'), config.refine, config.refine.iterations
    if refine.method == 'newton' and refine.loss == 'robust':
        # The noise is fitted on a part of the data, where the pose is already at its optimum.
        middle = thin(sights, 0, budget(sights, MIDDLE_POINTS))
        pose, _ = descend(middle, pose, centroid, noise, max_steps=steps, check=check)
        noise = noise_at(middle, pose, with_joints=refine.joint_noise)
        if noise.joint_sigma_m:
            pose, _ = descend(middle, pose, centroid, noise, max_steps=steps, check=check)
            noise = noise_at(middle, pose, with_joints=True)
    loss: Loss = SquaredLoss() if refine.loss == 'squared' else noise
    threshold_px = config.ransac.threshold_px or noise.threshold_px
    used = thin(sights, refine.frame_stride, budget(sights, refine.max_correspondences))
    if refine.method == 'newton':
        end = finish(used, pose, centroid, loss, max_steps=steps, threshold_px=threshold_px,
                     check=check)  # fmt: skip
        return end, loss, threshold_px
    if refine.method == 'adam':
        few = thin(sights, refine.frame_stride, lambda n: spread(n, PAPER_REFINE_FRAMES))
        pose = adam(few, pose, refine, loss, check=check)
    return appraise(used, pose, centroid, loss, threshold_px=threshold_px), loss, threshold_px


def _report(
    sights: Sequence[Sight],
    descent: Descent,
    loss: Loss,
    *,
    threshold_px: float,
    centroid: Array,
    clocks: Clocks,
    joint_names: tuple[str, ...] | None,
    config: CalibrationConfig,
    seconds: float,
    order: Sequence[str],
) -> Calibration:
    """Collect the figures, cameras in the caller's order."""
    counts = descent.examination.tally
    n, n_in = int(counts.correspondences.sum()), int(counts.inliers.sum())
    variance = 1.0
    if isinstance(loss, SquaredLoss) and n > 3:
        # Per axis: the squared loss is a log likelihood only when divided by the variance.
        variance = max(2.0 * descent.examination.cost / (2 * n - 6), ROUNDING_PX2)
    timed = clocks.equations(descent.pose, centroid, loss)
    covariance, over_time = covariances(descent, centroid, variance=variance, timed=timed)
    median, p95 = np.quantile(counts.sample_px, [0.5, 0.95]) if n else (np.nan, np.nan)
    contradicting = disagreements(sights, descent, centroid)
    by_camera = fits(counts, [s.camera.name for s in sights], axis=1)
    names = joint_names or tuple(str(j) for j in range(sights[0].view.n_joints))
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
        time_offset_s=clocks.offsets(timed),
        disagreements=tuple(contradicting),
        warnings=(*clocks.warnings, *_camera_warnings(sights, counts, contradicting)),
        seconds=seconds,
    )


def _camera_warnings(
    sights: Sequence[Sight], counts: Tally, contradicting: Sequence[Disagreement]
) -> list[str]:
    lost = lost_cameras([s.camera.name for s in sights], counts)
    return [d.sentence() for d in contradicting] + [
        f'camera {name} follows something else in {100 * share:.0f} % of its frames. '
        'Check that its detector picks the person with the MoCap skeleton'
        for name, share in lost
    ]
