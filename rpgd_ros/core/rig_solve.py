# SPDX-License-Identifier: Apache-2.0
"""Cameras without extrinsics: each is calibrated to the MoCap frame.

Given the skeletons, such cameras share no unknown: each is a solve of its own, in which the camera
is the world. One that cannot be calibrated does not sink the others. Where no camera has
extrinsics the MoCap frame is the world; where some have, those find `world_T_mocap`, and the
others are placed in their world.
"""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from rpgd_ros.core.calibrate import calibrate
from rpgd_ros.core.camera_pose import CameraPose, through_world
from rpgd_ros.core.config import CalibrationConfig
from rpgd_ros.core.errors import CalibrationError, InputError, Reason
from rpgd_ros.core.rig_summary import mocap_is_world, with_placed

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from rpgd_ros.core.camera import Camera
    from rpgd_ros.core.observations import Observations
    from rpgd_ros.core.result import Calibration


@dataclass(frozen=True, slots=True, eq=False)
class RigCalibration:
    """A rig of which some or all extrinsics were unknown.

    Attributes:
        calibration: Of the rig: `world_T_mocap` with the figures of the cameras that found it, and
            `camera_poses` of those that were placed. Where no camera has extrinsics,
            `world_T_mocap` is the identity, exactly.
        alone: Solve of each placed camera by itself: its `world_T_mocap` is `camera_T_mocap`.
        refused: Why each other camera without extrinsics could not be placed.

    """

    calibration: Calibration
    alone: Mapping[str, Calibration]
    refused: Mapping[str, CalibrationError]

    @property
    def poses(self) -> Mapping[str, CameraPose]:
        """The extrinsics that were found, by camera."""
        return self.calibration.camera_poses


def calibrate_cameras(
    cameras: Sequence[Camera],
    observations: Observations,
    *,
    config: CalibrationConfig | None = None,
    seed: int | None = None,
    progress: Callable[[str, float], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
    clock: Callable[[], float] = time.perf_counter,
) -> RigCalibration:
    """Find the extrinsics of the cameras that have none, and `world_T_mocap` where some have.

    Arguments as for `calibrate`. A common clock offset (`config.time`) is common to the cameras
    with extrinsics; each of the others has its own.

    Raises:
        CalibrationError: The cameras with extrinsics do not determine `world_T_mocap`, or no
            camera could be placed; the message holds the reason of each.
        InputError: Cameras and observations do not fit together.

    """
    n_names = len({c.name for c in cameras})
    if not n_names or n_names < len(cameras) or len(cameras) != len(observations.views):
        msg = (
            f'need one camera per view, of different names; got {len(observations.views)} views '
            f'for {", ".join(c.name for c in cameras) or "no camera"}'
        )
        raise InputError(Reason.BAD_INPUT, msg)
    known = [v for v, camera in enumerate(cameras) if camera.camera_T_world is not None]
    unknown = [v for v, camera in enumerate(cameras) if camera.camera_T_world is None]
    jobs = [known] if known else []
    jobs += [[v] for v in unknown]
    run = _Run(config or CalibrationConfig(), seed, progress, should_stop, clock, len(jobs))
    rig = run.solve(cameras, observations, known) if known else None
    alone: dict[str, Calibration] = {}
    refused: dict[str, CalibrationError] = {}
    for v in unknown:
        try:
            alone[cameras[v].name] = run.solve(cameras, observations, [v])
        except CalibrationError as error:
            if error.reason is Reason.CANCELLED:
                raise
            refused[cameras[v].name] = error
    if rig is None and not alone:
        raise _all_refused(refused)
    whole = _assembled(rig, alone, refused, [c.name for c in cameras])
    return RigCalibration(replace(whole, seconds=clock() - run.started), alone, refused)


@dataclass(slots=True)
class _Run:
    """Several solves that share progress and time limit."""

    config: CalibrationConfig
    seed: int | None
    progress: Callable[[str, float], None] | None
    should_stop: Callable[[], bool] | None
    clock: Callable[[], float]
    n_solves: int
    started: float = field(init=False)
    n_done: int = 0

    def __post_init__(self) -> None:
        self.started = self.clock()

    def solve(
        self, cameras: Sequence[Camera], observations: Observations, chosen: Sequence[int]
    ) -> Calibration:
        """Calibrate from some of the cameras, in the time that is left."""
        config = self.config
        if config.max_seconds:
            left = config.max_seconds - (self.clock() - self.started)
            if left <= 0.0:
                msg = (
                    f'the time limit of {config.max_seconds:g} s ended the run after '
                    f'{self.n_done} of {self.n_solves} solves'
                )
                raise CalibrationError(Reason.CANCELLED, msg)
            config = replace(config, max_seconds=left)
        views = tuple(observations.views[v] for v in chosen)
        try:
            solved = calibrate(
                [cameras[v] for v in chosen], replace(observations, views=views), config=config,
                seed=self.seed, progress=self._tell, should_stop=self.should_stop,
                clock=self.clock,
            )  # fmt: skip
        finally:
            self.n_done += 1
        return replace(solved, config=self.config)

    def _tell(self, stage: str, fraction: float) -> None:
        if self.progress is not None:
            self.progress(stage, (self.n_done + fraction) / self.n_solves)


def _assembled(
    rig: Calibration | None, alone: Mapping[str, Calibration],
    refused: Mapping[str, CalibrationError], order: Sequence[str],
) -> Calibration:  # fmt: skip
    told = tuple(
        f'camera {name} could not be placed ({error.reason}): {error.message}'
        for name, error in refused.items()
    )
    if rig is None:
        poses = {
            name: CameraPose(own.world_T_mocap, own.covariance, own.centroid_mocap)
            for name, own in alone.items()
        }
        return mocap_is_world(alone, poses, told, order)
    poses = {
        name: through_world(
            own.world_T_mocap, own.covariance, rig.world_T_mocap, rig.covariance,
            own.centroid_mocap,
        )
        for name, own in alone.items()
    }  # fmt: skip
    return with_placed(rig, alone, poses, told, order)


def _all_refused(refused: Mapping[str, CalibrationError]) -> CalibrationError:
    """Return one refusal for all cameras, with the reason that most of them have."""
    reason = Counter(error.reason for error in refused.values()).most_common(1)[0][0]
    told = '; '.join(f'camera {name}: {error.message}' for name, error in refused.items())
    return CalibrationError(reason, f'no camera could be placed: {told}')
