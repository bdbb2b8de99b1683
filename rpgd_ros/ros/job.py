# SPDX-License-Identifier: Apache-2.0
"""One calibration as the worker runs it, and what the node answers about it. Needs no ROS."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from rpgd_ros.core.camera_pose import CameraPose
from rpgd_ros.core.errors import CalibrationError, Reason, RpgdError
from rpgd_ros.core.geometry import RigidTransform
from rpgd_ros.core.result import Calibration
from rpgd_ros.io.frames import Frames
from rpgd_ros.ros.found import found_figures
from rpgd_ros.session import Snapshot, solve
from rpgd_ros.session.monitor import Appraisal, appraise

ACCEPTED = 'accepted'
NO_FRAMES = Frames('', '')
NO_CAMERAS: Mapping[str, CameraPose] = {}
RECENT_NS = 10_000_000_000  # of the error that is published to make drift visible


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """How one run ended.

    Attributes:
        reason: `ACCEPTED`, or the code of the refusal.
        message: What was found, needed, and what to do; of an accepted run, why it could not be
            saved, or ''.
        frames: Names of the frames of an accepted run.
        seconds: Duration.
        calibration: The accepted calibration, or None.
        recent_px: Mean error of the pose that is published now over the newest data, pixels; NaN
            without one.
        appraisal: Of the pose that was found, accepted or not; None where none was.

    """

    reason: str
    message: str
    frames: Frames = NO_FRAMES
    seconds: float = math.nan
    calibration: Calibration | None = None
    recent_px: float = math.nan
    appraisal: Appraisal | None = None

    @property
    def is_accepted(self) -> bool:
        """Whether there is a calibration."""
        return self.reason == ACCEPTED


BUSY = Outcome(Reason.BUSY, 'busy: a calibration is running; its result is published')
SAVING = Outcome(Reason.BUSY, 'busy: a result is being saved; call again')
STOPPING = Outcome(Reason.CANCELLED, 'the node is shutting down')


def run(
    snapshot: Snapshot,
    frames: Frames,
    published: RigidTransform | None,
    *,
    published_cameras: Mapping[str, CameraPose] = NO_CAMERAS,
    check: Callable[[Calibration], None] | None = None,
    save: Callable[[Calibration, Appraisal], None],
    progress: Callable[[str, float], None],
    should_stop: Callable[[], bool],
) -> Outcome:
    """Solve, save what was accepted, and measure the pose that is published afterwards.

    Args:
        snapshot: Data and settings.
        frames: Their names.
        published: The pose that stands on the topics now, if any.
        published_cameras: The poses of placed cameras that stand there.
        check: Raises where a calibration that is good may not be published all the same.
        save: Writes the result file, or raises CANCELLED where the node has begun to end.
        progress: Told the stage and its fraction done.
        should_stop: Asked whether to end early.

    """
    start = time.monotonic()
    calibration: Calibration | None = None
    appraisal: Appraisal | None = None
    reason, message = ACCEPTED, ''
    try:
        found = solve(snapshot, progress=progress, should_stop=should_stop)
        if should_stop():
            return STOPPING
        if check is not None:
            check(found)
        appraisal = appraise(snapshot, found)
        calibration = found
        save(calibration, appraisal)
    except CalibrationError as error:
        calibration, reason, message = None, error.reason, error.message
        if error.calibration is not None:
            appraisal = appraise(snapshot, error.calibration)
    except RpgdError as error:
        if calibration is None:
            reason, message = error.reason, error.message
        else:
            message = f'the result could not be saved: {error.message}'
    pose, poses = published, published_cameras
    if calibration is not None:
        pose, poses = calibration.world_T_mocap, calibration.camera_poses
    recent = math.nan if pose is None else recent_error_px(snapshot, pose, poses)
    seconds = time.monotonic() - start
    return Outcome(reason, message, frames, seconds, calibration, recent, appraisal)


def recent_error_px(
    snapshot: Snapshot,
    world_T_mocap: RigidTransform,
    poses: Mapping[str, CameraPose] = NO_CAMERAS,
) -> float:
    """Return the mean residual of a pose (eq. 7) over the newest data, pixels; NaN without any.

    Args:
        snapshot: The data.
        world_T_mocap: The pose.
        poses: Of the cameras that were placed; those without any are left out.

    """
    total, count = 0.0, 0
    for camera, view in zip(snapshot.placed(poses), snapshot.observations.views, strict=True):
        if camera.camera_T_world is None or view.stamp_ns is None or not len(view.stamp_ns):
            continue
        recent = view.stamp_ns > view.stamp_ns[-1] - RECENT_NS
        x, uv = view.x_mocap[recent], view.uv[recent]
        error = np.linalg.norm(camera.project(world_T_mocap @ x) - uv, axis=-1)
        seen = np.isfinite(error)
        total += float(error[seen].sum())
        count += int(seen.sum())
    return total / count if count else math.nan


def answer(outcome: Outcome) -> str:
    """Return the one line of JSON that `~/calibrate` answers.

    Floats keep all their digits: the line holds the very transform that is published.
    """
    if outcome.calibration is None:
        return _json({'reason': str(outcome.reason), 'message': outcome.message})
    c = outcome.calibration
    return _json(
        {
            'reason': ACCEPTED,
            'message': outcome.message,
            'world_frame': outcome.frames.world,
            'mocap_frame': outcome.frames.mocap,
            'xyz': c.world_T_mocap.translation.tolist(),
            'quat_xyzw': c.world_T_mocap.quat_xyzw.tolist(),
            **figures(c),
            'seconds': outcome.seconds,
            'cameras': {
                name: {
                    'mpjpe_px': fit.mpjpe_px,
                    'inliers': int(fit.inliers),
                    'correspondences': int(fit.correspondences),
                }
                for name, fit in c.per_camera.items()
            },
            'camera_poses': {
                name: {
                    'frame': outcome.frames.optical_frame(name),
                    'xyz': pose.world_T_camera.translation.tolist(),
                    'quat_xyzw': pose.world_T_camera.quat_xyzw.tolist(),
                }
                for name, pose in c.camera_poses.items()
            },
            'warnings': list(c.warnings),
        }
    )


def figures(calibration: Calibration) -> dict[str, object]:
    """Return the figures of an accepted calibration by diagnostic key."""
    values: dict[str, object] = {
        'mpjpe_px': float(calibration.mpjpe_px),
        'median_px': float(calibration.median_px),
        'p95_px': float(calibration.p95_px),
        'inliers': int(calibration.inliers),
        'correspondences': int(calibration.correspondences),
        'inlier_ratio': float(calibration.inlier_ratio),
        'frames': int(calibration.frames),
        'sigma_rotation_deg': calibration.sigma_rotation_deg,
        'sigma_position_m': calibration.sigma_position_m,
    }
    values |= found_figures(calibration)
    for camera, pose in calibration.camera_poses.items():
        values[f'sigma_rotation_deg {camera}'] = pose.sigma_rotation_deg
        values[f'sigma_position_m {camera}'] = pose.sigma_position_m
    return values


def _json(values: Mapping[str, object]) -> str:
    return json.dumps(_without_nan(values), allow_nan=False)


def _without_nan(value: object) -> object:
    # JSON has no NaN: readers other than Python's would stumble over it.
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Mapping):
        return {str(key): _without_nan(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_without_nan(item) for item in value]
    return value
