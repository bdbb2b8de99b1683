# SPDX-License-Identifier: Apache-2.0
"""One solve: robust start, refinement, figures."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rpgd_ros.core.body import Body
from rpgd_ros.core.config import (
    PAPER_RANSAC_FRAMES,
    PAPER_REFINE_FRAMES,
    PAPER_THRESHOLD_PX,
    CalibrationConfig,
)
from rpgd_ros.core.errors import CalibrationError, InputError, Reason
from rpgd_ros.core.linearise import Sight
from rpgd_ros.core.noise import Loss, NoiseModel, SquaredLoss
from rpgd_ros.core.noise_fit import noise_at
from rpgd_ros.core.ransac import published, robust_start
from rpgd_ros.core.refine import Descent, adam, appraise, descend, finish
from rpgd_ros.core.report import report
from rpgd_ros.core.settle import Details, settle
from rpgd_ros.core.thin import MIDDLE_POINTS, thin, thin_each

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rpgd_ros.core.camera import Camera
    from rpgd_ros.core.geometry import Array, RigidTransform
    from rpgd_ros.core.observations import Observations
    from rpgd_ros.core.result import Calibration


@dataclass(frozen=True, slots=True)
class Run:
    """Progress, cancellation and time limit of one solve."""

    progress: Callable[[str, float], None] | None
    should_stop: Callable[[], bool] | None
    clock: Callable[[], float]
    started: float
    max_seconds: float
    furthest: dict[str, float] = field(default_factory=dict)

    def check(self, stage: str) -> Callable[[float], None]:
        """Return what a stage calls with its fraction done."""

        def tick(fraction: float) -> None:
            # A stage may walk over the data twice, and be entered again without a moved camera.
            furthest = min(max(self.furthest.get(stage, 0.0), fraction), 1.0)
            self.furthest[stage] = furthest
            if self.progress is not None:
                self.progress(stage, furthest)
            if self.should_stop is not None and self.should_stop():
                msg = f'cancelled during {stage}'
                raise CalibrationError(Reason.CANCELLED, msg)
            if self.max_seconds and self.clock() - self.started > self.max_seconds:
                msg = f'the time limit of {self.max_seconds:g} s ended the run during {stage}'
                raise CalibrationError(Reason.CANCELLED, msg)

        return tick


class Solved(NamedTuple):
    """A solve before the gates.

    Attributes:
        calibration: Its result.
        sights: Cameras with the data that it ended with.
        body: A look at the skeletons.
        rival_ratio: See `ransac.rival_ratio`.
        details: Clocks and joints, where they were estimated.
        is_explained: Whether the residuals at the pose are those of a detector, however noisy.

    """

    calibration: Calibration
    sights: list[Sight]
    body: Body
    rival_ratio: float
    details: Details | None
    is_explained: bool


def solve(
    cameras: Sequence[Camera], observations: Observations, config: CalibrationConfig, run: Run
) -> Solved:
    """Start, refine and collect the figures."""
    sights = _sights(cameras, observations)
    body = Body.of(sights)
    body.check()
    rng = np.random.default_rng(config.ransac.seed)
    centroid = body.centre
    details: Details | None = None
    if config.ransac.score == 'inliers':
        pose, noise = _published_start(sights, config, rng, run)
        rival_ratio = np.inf
    else:
        start = robust_start(sights, config.ransac, rng, check=run.check('start'))
        (pose, noise, _), rival_ratio = start.candidates[0], start.rival_ratio
        if config.time.estimate_offset != 'off' or config.refine.joint_offsets:
            details = settle(
                sights,
                observations.mocap,
                start,
                centroid,
                config,
                rng,
                check=run.check('details'),
            )
    if details is not None:
        sights, rival_ratio = list(details.sights), details.rival_ratio
        pose, noise = details.at.state.pose, details.at.noise
    if details is None or config.refine.method != 'newton' or config.refine.loss != 'robust':
        descent, loss, threshold_px = _refine(sights, pose, noise, centroid, config, run)
    else:
        loss, threshold_px = noise, config.ransac.threshold_px or noise.threshold_px
        descent = appraise(sights, pose, centroid, noise, threshold_px=threshold_px)
    calibration = report(
        sights, descent, loss, threshold_px=threshold_px, centroid=centroid, details=details,
        joint_names=observations.joint_names, config=config, seconds=run.clock() - run.started,
        order=[c.name for c in cameras],
    )  # fmt: skip
    is_explained = not isinstance(loss, NoiseModel) or loss.is_sharp
    return Solved(calibration, sights, body, rival_ratio, details, is_explained)


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
        msg = f'no extrinsics for {", ".join(blind)}: `calibrate_cameras` finds them'
        raise CalibrationError(Reason.NO_EXTRINSICS, msg)
    pairs = sorted(zip(cameras, observations.views, strict=True), key=lambda pair: pair[0].name)
    sights = [Sight(c, v) for c, v in pairs if v.n_frames and v.uv.shape[1]]
    if not sights:
        msg = 'no frame with skeleton and keypoints'
        raise CalibrationError(Reason.NO_DATA, msg)
    return sights


def _published_start(
    sights: Sequence[Sight], config: CalibrationConfig, rng: np.random.Generator, run: Run
) -> tuple[RigidTransform, NoiseModel]:
    tau = config.ransac.threshold_px or PAPER_THRESHOLD_PX
    ransac = replace(config.ransac, threshold_px=tau)
    few = thin_each(sights, PAPER_RANSAC_FRAMES, stride=ransac.frame_stride)
    pose = published(few, ransac, rng, check=run.check('start'))
    return pose, noise_at(few, pose)


def _refine(
    sights: Sequence[Sight], pose: RigidTransform, noise: NoiseModel, centroid: Array,
    config: CalibrationConfig, run: Run,
) -> tuple[Descent, Loss, float]:  # fmt: skip
    """Refine as configured; return the end, the loss, and the threshold of an inlier."""
    check, refine, steps = run.check('refinement'), config.refine, config.refine.iterations
    if refine.method == 'newton' and refine.loss == 'robust':
        # The noise is fitted on a part of the data, where the pose is already at its optimum.
        middle = thin(sights, MIDDLE_POINTS)
        pose = descend(middle, pose, centroid, noise, max_steps=steps, check=check)
        noise = noise_at(middle, pose, with_joints=refine.joint_noise)
        if noise.joint_sigma_m:
            pose = descend(middle, pose, centroid, noise, max_steps=steps, check=check)
            noise = noise_at(middle, pose, with_joints=True)
    loss: Loss = SquaredLoss() if refine.loss == 'squared' else noise
    threshold_px = config.ransac.threshold_px or noise.threshold_px
    used = thin(sights, refine.max_correspondences, stride=refine.frame_stride)
    if refine.method == 'newton':
        end = finish(used, pose, centroid, loss, max_steps=steps, threshold_px=threshold_px,
                     check=check)  # fmt: skip
        return end, loss, threshold_px
    if refine.method == 'adam':
        few = thin_each(sights, PAPER_REFINE_FRAMES, stride=refine.frame_stride)
        pose = adam(few, pose, refine, loss, check=check)
    return appraise(used, pose, centroid, loss, threshold_px=threshold_px), loss, threshold_px
