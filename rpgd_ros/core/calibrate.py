# SPDX-License-Identifier: Apache-2.0
"""Calibrates: solves, solves again without moved cameras, refuses what nobody should use."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from rpgd_ros.core.camera_pose import CameraPose, through_world
from rpgd_ros.core.config import (
    CalibrationConfig,
    RigConfig,
    TimeConfig,
)
from rpgd_ros.core.dating import moved_since
from rpgd_ros.core.diagnose import (
    MAY_BE_MIRRORED,
    MIRRORED,
    UNSURE,
    is_mirrored,
    looks_mirrored,
    refuse_ambiguous,
    refuse_swapped,
    unexplained,
)
from rpgd_ros.core.errors import CalibrationError, Reason
from rpgd_ros.core.linearise import Sight
from rpgd_ros.core.observations import NS_PER_S, Observations
from rpgd_ros.core.quality import refuse
from rpgd_ros.core.report import with_excluded
from rpgd_ros.core.result import Calibration
from rpgd_ros.core.solve import Run, Solved, solve

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rpgd_ros.core.agreement import Disagreement
    from rpgd_ros.core.camera import Camera


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
    if seed is not None:
        config = replace(config, ransac=replace(config.ransac, seed=seed))
    run = Run(progress, should_stop, clock, clock(), config.max_seconds)
    solved = solve(cameras, observations, config, run)
    if config.rig.on_bumped_camera != 'name':
        solved = _without_moved(solved, cameras, observations, run)
    _pass_gates(solved, run)
    return solved.calibration


def _without_moved(
    solved: Solved, cameras: Sequence[Camera], observations: Observations, run: Run
) -> Solved:
    """Solve again without the cameras that were moved, the worst first, one at a time.

    The others are judged anew each time: what one moved camera does to clocks and joints may make
    a good one look moved.
    """
    whole = solved.calibration
    named: list[Disagreement] = []
    while True:
        worst = next((d for d in solved.calibration.disagreements if d.rival is None), None)
        if worst is None:
            break
        named.append(worst)
        out = {d.camera for d in named}
        kept = [v for v, camera in enumerate(cameras) if camera.name not in out]
        views = tuple(observations.views[v] for v in kept)
        rest = [cameras[v] for v in kept]
        solved = solve(rest, replace(observations, views=views), whole.config, run)
    if not named:
        return solved
    views_of = dict(zip((c.name for c in cameras), observations.views, strict=True))
    camera_of = {c.name: c for c in cameras}
    dated, poses = [], dict(solved.calibration.camera_poses)
    for moved in named:
        sight = Sight(camera_of[moved.camera], views_of[moved.camera])
        if solved.details is not None:
            sight = solved.details.of_other(sight)
        rise = moved_since(sight, solved.calibration.world_T_mocap)
        since_s = None if rise is None else rise.since_s
        dated.append(replace(moved, since_s=since_s))
        if whole.config.rig.on_bumped_camera == 're-estimate':
            pose = _placed(sight, since_s, solved.calibration, run)
            poses.update({} if pose is None else {moved.camera: pose})
    calibration = with_excluded(solved.calibration, whole, dated)
    return solved._replace(calibration=replace(calibration, camera_poses=poses))


def _placed(sight: Sight, since_s: float | None, rest: Calibration, run: Run) -> CameraPose | None:
    """Find where a camera that was moved is now, by what it saw since; None where it cannot be."""
    stamp_ns = sight.view.stamp_ns
    if since_s is not None and stamp_ns is not None:
        sight = sight.at_frames(np.flatnonzero(stamp_ns >= stamp_ns[0] + since_s * NS_PER_S))
    camera = replace(sight.camera, camera_T_world=None)
    plain = replace(
        rest.config, time=TimeConfig(), rig=RigConfig(), refine=replace(rest.config.refine,
        joint_offsets=False),
    )  # fmt: skip
    try:
        solved = solve([camera], Observations((sight.view,)), plain, run)
        _pass_gates(solved, run)
    except CalibrationError as refusal:
        if refusal.reason is Reason.CANCELLED:
            raise
        return None
    own = solved.calibration
    return through_world(
        own.world_T_mocap, own.covariance, rest.world_T_mocap, rest.covariance, own.centroid_mocap
    )


def _pass_gates(solved: Solved, run: Run) -> None:
    """Raise when nobody should use the calibration, naming the cause where it is known."""
    calibration, sights, body, rival_ratio = solved[:4]
    config = calibration.config
    refuse_swapped(sights, calibration)
    try:
        refuse(calibration, config.accept, body.motion_m)
        refuse_ambiguous(rival_ratio, calibration)
    except CalibrationError as refusal:
        check = run.check('diagnosis')
        if refusal.reason in MAY_BE_MIRRORED and is_mirrored(sights, config.ransac, check=check):
            raise CalibrationError(
                Reason.MIRRORED_AXES, MIRRORED, calibration=calibration
            ) from refusal
        if refusal.reason in UNSURE and not solved.is_explained:
            raise CalibrationError(
                Reason.TOO_FEW_INLIERS, unexplained(calibration), calibration=calibration
            ) from refusal
        if refusal.reason is Reason.UNCERTAIN:
            # The better name: a sigma is that of one of the minima.
            refuse_ambiguous(rival_ratio, calibration)
        raise
    is_doubtful = config.ransac.score == 'likelihood' and looks_mirrored(
        sights, calibration, config.ransac.seed
    )
    if is_doubtful and is_mirrored(sights, config.ransac, check=run.check('diagnosis')):
        raise CalibrationError(Reason.MIRRORED_AXES, MIRRORED, calibration=calibration)
