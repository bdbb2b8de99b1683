# SPDX-License-Identifier: Apache-2.0
"""Residuals of every camera, for pictures: of evenly spread frames where there are very many."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rpgd_ros.core import Camera, RigidTransform
from rpgd_ros.core.agreement import LOST_MARGIN
from rpgd_ros.core.diagnose import swapped_joints
from rpgd_ros.core.errors import Reason
from rpgd_ros.core.geometry import Array, BoolArray, IntArray
from rpgd_ros.core.linearise import Sight
from rpgd_ros.core.observations import NS_PER_S, View
from rpgd_ros.core.thin import spread
from rpgd_ros.report.case import Case
from rpgd_ros.skeletons import landmarks

MAX_FRAMES = 4000  # per camera: two minutes at 30 Hz; 15 MB of arrays for 28 joints
# Of a moved camera: residuals scatter less than half of what they share, which is a tenth of the
# image at most. Another person is farther off, and walks.
MOST_SCATTER, MOST_SHIFT = 0.5, 0.1
# What is wrong with all cameras alike: where one fits less, it looks from another side.
OF_ALL = frozenset({
    Reason.SWAPPED_LABELS, Reason.MIRRORED_AXES, Reason.WRONG_UNIT, Reason.TOO_FEW_INLIERS,
})  # fmt: skip
TIME_BINS = 120  # of the whole recording, at most
UP_FROM = ('left_ankle', 'right_ankle', 'left_hip', 'right_hip')
UP_TO = ('left_shoulder', 'right_shoulder', 'head', 'nose', 'neck')


@dataclass(frozen=True, eq=False)
class Look:
    """What one camera measured, beside what the calibration makes of the skeleton.

    Attributes:
        camera: The camera.
        view: Its data.
        frames: (F,) numbers of these instants in the camera's whole view.
        uv: (F, J, 2) reprojected joints, pixels; NaN without a calibration.
        threshold_px: Residual of an inlier; NaN without a calibration.

    """

    camera: Camera
    view: View
    frames: IntArray
    uv: Array
    threshold_px: float

    @cached_property
    def seen(self) -> BoolArray:
        """(F, J) whether both sides of a correspondence are there."""
        return self.view.seen()

    @cached_property
    def residual(self) -> Array:
        """(F, J, 2) reprojection minus keypoint (eq. 2), pixels; NaN where not seen."""
        residual: Array = np.where(self.seen[..., None], self.uv - self.view.uv, np.nan)
        return residual

    @cached_property
    def error_px(self) -> Array:
        """(F, J) length of the residuals."""
        error: Array = np.hypot(self.residual[..., 0], self.residual[..., 1])
        return error

    @cached_property
    def is_near(self) -> BoolArray:
        """(F, J) whether a correspondence is an inlier (eq. 3)."""
        near: BoolArray = self.error_px < self.threshold_px  # False for NaN
        return near

    @cached_property
    def share(self) -> Array:
        """(F,) share of inliers; NaN where nothing was seen."""
        n = self.seen.sum(1)
        share: Array = np.where(n > 0, self.is_near.sum(1) / np.maximum(n, 1), np.nan)
        return share

    @cached_property
    def lost_ratio(self) -> float:
        """Share of the frames with a correspondence in which most are no inliers."""
        share = self.share[np.isfinite(self.share)]
        return float((share < 0.5).mean()) if len(share) else 0.0

    @cached_property
    def shift_px(self) -> float:
        """How far everything is beside its place, the same way; 0 where residuals scatter."""
        residuals = self.residual[np.isfinite(self.error_px)]
        if not len(residuals):
            return 0.0
        middle = np.median(residuals, axis=0)
        scatter = float(np.median(np.linalg.norm(residuals - middle, axis=1)))
        shift = float(np.linalg.norm(middle))
        is_same = scatter < MOST_SCATTER * shift < MOST_SCATTER * MOST_SHIFT * self.camera.size[0]
        return shift if is_same else 0.0

    @cached_property
    def seconds(self) -> Array:
        """(F,) time since 1970, or number of the frame where no time is known."""
        stamps = self.view.stamp_ns
        known = self.frames if stamps is None else stamps / NS_PER_S
        return np.asarray(known, np.float64)


@dataclass(frozen=True, eq=False)
class Measured:
    """A case with its residuals.

    Attributes:
        case: The run.
        looks: One per camera.

    """

    case: Case
    looks: tuple[Look, ...]

    @cached_property
    def names(self) -> tuple[str, ...]:
        """(J,) of the joints."""
        observations = self.case.observations
        if observations is None:
            return ()
        return observations.joint_names or tuple(str(j) for j in range(observations.n_joints))

    @cached_property
    def lost(self) -> dict[str, float]:
        """Cameras that follow something else in far more frames than the others, and how many."""
        refusal = self.case.refusal
        if refusal is not None and refusal.reason in OF_ALL:
            return {}
        ratio = np.array([look.lost_ratio for look in self.looks])
        found = {}
        for v, look in enumerate(self.looks):
            others = np.delete(ratio, v)
            if ratio[v] > (float(np.median(others)) if len(others) else 0.0) + LOST_MARGIN:
                found[look.camera.name] = float(ratio[v])
        return found

    @cached_property
    def moved(self) -> frozenset[str]:
        """Cameras that contradict the others."""
        c = self.case.calibration
        return frozenset(d.camera for d in c.disagreements) if c else frozenset()

    @cached_property
    def used(self) -> tuple[Look, ...]:
        """Of the cameras that the transform was found from; all, where it was from none."""
        c = self.case.calibration
        if c is None or c.config.rig.on_bumped_camera == 'name':
            return self.looks
        excluded = {d.camera for d in c.disagreements if d.rival is None}
        return tuple(k for k in self.looks if k.camera.name not in excluded) or self.looks

    @cached_property
    def start_s(self) -> float:
        """Time of the first instant of any camera."""
        return min((float(look.seconds[0]) for look in self.looks if len(look.frames)), default=0)

    @property
    def has_time(self) -> bool:
        """Whether instants have stamps."""
        return all(look.view.stamp_ns is not None for look in self.looks)

    @cached_property
    def path(self) -> tuple[Array, Array]:
        """Seconds (N,) and the body's centre (N, 3), metres, in the world, else in MoCap's."""
        look = max(self.looks, key=lambda look: int(look.seen.any(1).sum()))
        x = np.where(look.seen[..., None], look.view.x_mocap, np.nan)
        rows = np.isfinite(x.sum(-1)).any(1)
        return look.seconds[rows] - self.start_s, self.to_world(np.nanmean(x[rows], axis=1))

    def to_world(self, x_mocap: Array) -> Array:
        """Move points to the world; leave them where no transform is known."""
        c = self.case.calibration
        return c.world_T_mocap @ x_mocap if c else x_mocap

    @cached_property
    def up(self) -> Array:
        """(3,) the axis of the picture's frame along which the body stands, signed."""
        marks = landmarks(self.names)
        low = [j for j, mark in enumerate(marks) if mark in UP_FROM]
        high = [j for j, mark in enumerate(marks) if mark in UP_TO]
        up = np.array([0.0, 0.0, 1.0])
        if low and high and self.looks:
            x = self.to_world(np.concatenate([look.view.x_mocap for look in self.looks]))
            spans = x[:, high].mean(1) - x[:, low].mean(1)
            spans = spans[np.isfinite(spans).all(1)]
            if len(spans):
                mean = spans.mean(0)
                axis = int(np.argmax(np.abs(mean)))
                up = np.eye(3)[axis] * np.sign(mean[axis])
        return up


def measure(case: Case) -> Measured:
    """Reproject the skeletons of a case into its cameras."""
    if case.observations is None:
        return Measured(case, ())
    pairs = zip(case.cameras, case.observations.views, strict=True)
    return Measured(case, tuple(_look(case, Sight(camera, view)) for camera, view in pairs))


def _look(case: Case, sight: Sight) -> Look:
    frames = np.asarray(spread(sight.view.n_frames, MAX_FRAMES))
    thinned = sight.at_frames(frames)
    c = case.calibration
    if c is None:
        uv = np.full(thinned.view.uv.shape, np.nan)
    else:
        camera_T_mocap: RigidTransform = sight.camera_T_world @ c.world_T_mocap
        uv = sight.camera.project_camera(camera_T_mocap @ thinned.view.x_mocap)
    threshold_px = c.threshold_px if c else np.nan
    return Look(sight.camera, thinned.view, frames, uv, threshold_px)


def swapped_names(measured: Measured) -> tuple[tuple[str, str], ...]:
    """Return the pairs of joints that lie on each other's projection."""
    c = measured.case.calibration
    if c is None:
        return ()
    sights = [Sight(look.camera, look.view) for look in measured.looks if len(look.frames)]
    pairs = swapped_joints(sights, c.world_T_mocap, c.threshold_px)
    return tuple((measured.names[a], measured.names[b]) for a, b in pairs)
