# SPDX-License-Identifier: Apache-2.0
"""What the solver is given: per camera, skeletons at that camera's stamps beside its keypoints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import Array, BoolArray, IntArray

NS_PER_S = 1_000_000_000
LARGEST_STAMP_S = 9e9  # the year 2255, and what 64 bits of nanoseconds hold
LOWEST_FPS, HIGHEST_FPS = 1e-3, 1e6  # a frame a quarter of an hour, a frame a microsecond
TAKE_NS = 10_000_000 * NS_PER_S  # recordings of several skeletons follow each other at this
LARGEST_COORDINATE = 1e6  # metres or pixels; beyond it a number is damage, not data


def is_there(points: Array) -> BoolArray:
    """(...) whether points (..., n) are numbers, and no damaged ones."""
    # By the squared length: a maximum over so few takes ten times as long.
    with np.errstate(invalid='ignore', over='ignore'):
        squared = np.einsum('...k,...k->...', points, points, dtype=np.float64)
    there: BoolArray = squared < LARGEST_COORDINATE**2  # False for NaN
    return there


def real_ns(stamp_ns: IntArray, origin_ns: int) -> IntArray:
    """(F,) time since (or before) some instant, of whichever skeleton the recording is."""
    half = TAKE_NS // 2
    real: IntArray = (stamp_ns - origin_ns + half) % TAKE_NS - half
    return real


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """The correspondences of one camera (C of the publication's Algorithm 1, for one i).

    Attributes:
        stamp_ns: (F,) instants of the camera, strictly increasing; None where no time is known.
        x_mocap: (F, J, 3) skeleton at those instants, metres, MoCap frame; NaN = missing.
        uv: (F, J, 2) keypoints, pixels; NaN = missing.
        confidence: (F, J) detector scores, or None.

    """

    stamp_ns: IntArray | None
    x_mocap: Array
    uv: Array
    confidence: Array | None = None

    @property
    def n_frames(self) -> int:
        """Number of instants."""
        return len(self.uv)

    @property
    def n_joints(self) -> int:
        """Number of joints."""
        return int(self.uv.shape[1])

    @property
    def known_stamp_ns(self) -> IntArray:
        """(F,) instants of the camera, for what makes no sense without them.

        Raises:
            InputError: No time is known.

        """
        if self.stamp_ns is None:
            msg = 'frames without stamps: need the time of each, or their rate'
            raise InputError(Reason.BAD_INPUT, msg)
        return self.stamp_ns

    def seen(self) -> BoolArray:
        """(F, J) whether both sides of a correspondence are there and are numbers."""
        return is_there(self.uv) & is_there(self.x_mocap)


@dataclass(frozen=True, slots=True, eq=False)
class MocapTrack:
    """The MoCap stream itself, kept for questions of time.

    Attributes:
        stamp_ns: (M,) strictly increasing.
        x_mocap: (M, J, 3) metres; NaN = missing.

    """

    stamp_ns: IntArray
    x_mocap: Array


@dataclass(frozen=True, slots=True, eq=False)
class Observations:
    """All correspondences of a recording.

    Attributes:
        views: One per camera, in the order of the cameras.
        mocap: The MoCap track, or None where no time is known.
        joint_names: (J,) names for reports; None where unknown.

    Raises:
        InputError: Views that do not fit each other, joint names that are not one per joint.

    """

    views: tuple[View, ...]
    mocap: MocapTrack | None = None
    joint_names: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        """Check once, at the border, so that no sum over the data needs to."""
        for number, view in enumerate(self.views):
            shape = (len(view.uv), self.n_joints)
            if view.uv.shape != (*shape, 2) or view.x_mocap.shape != (*shape, 3):
                msg = (
                    f'view {number} has skeletons {view.x_mocap.shape} and keypoints '
                    f'{view.uv.shape}, need (F, {self.n_joints}, 3) and (F, {self.n_joints}, 2)'
                )
                raise InputError(Reason.BAD_INPUT, msg)
            check_shape(f'stamps of view {number}', view.stamp_ns, shape[:1])
            check_shape(f'confidence of view {number}', view.confidence, shape)
        if self.mocap is not None and self.views:
            track, samples = self.mocap, (len(self.mocap.stamp_ns), self.n_joints, 3)
            check_shape('skeletons of the MoCap track', track.x_mocap, samples)
        if self.views:
            check_names(self.joint_names, self.n_joints)

    @property
    def n_joints(self) -> int:
        """Number of joints J."""
        return self.views[0].uv.shape[1] if self.views and self.views[0].uv.ndim > 1 else 0

    @classmethod
    def from_arrays(
        cls,
        x_mocap: ArrayLike,
        uv: ArrayLike,
        *,
        confidence: ArrayLike | None = None,
        fps: float | None = None,
        stamps: ArrayLike | None = None,
        joint_names: tuple[str, ...] | None = None,
    ) -> Observations:
        """Build from synchronous arrays, which are referred to, not copied.

        Args:
            x_mocap: (T, J, 3) metres, NaN = missing.
            uv: (V, T, J, 2) pixels, NaN = missing.
            confidence: (V, T, J) detector scores.
            fps: Frames per second, where time is known by rate.
            stamps: (T,) seconds, where time is known by stamp.
            joint_names: (J,) names for reports.

        Raises:
            InputError: Shapes that do not fit, or stamps that do not increase.

        """
        x = np.asarray(x_mocap, dtype=np.float64)
        pixels = np.asarray(uv, dtype=np.float64)
        scores = None if confidence is None else np.asarray(confidence, dtype=np.float64)
        _check_shapes(x, pixels, scores)
        stamp_ns = _stamps_ns(len(x), fps, stamps)
        views = tuple(
            View(stamp_ns, x, pixels[v], None if scores is None else scores[v])
            for v in range(len(pixels))
        )
        track = None if stamp_ns is None else MocapTrack(stamp_ns, x)
        return cls(views, track, joint_names)


def check_shape(what: str, values: Array | IntArray | None, shape: tuple[int, ...]) -> None:
    """Refuse values of another shape than they must have; None is none of them.

    Raises:
        InputError: They have.

    """
    if values is not None and values.shape != shape:
        msg = f'{what} must be {shape}, got {values.shape}'
        raise InputError(Reason.BAD_INPUT, msg)


def check_names(names: Sequence[str] | None, n_joints: int) -> None:
    """Refuse names that are not one per joint; None is none of them.

    Raises:
        InputError: They are not.

    """
    if names is not None and len(set(names)) != n_joints:
        msg = f'{len(set(names))} different joint names for {n_joints} joints'
        raise InputError(Reason.BAD_INPUT, msg)


def _check_shapes(x: Array, uv: Array, confidence: NDArray[np.float64] | None) -> None:
    if x.ndim != 3 or x.shape[2] != 3:
        msg = f'x_mocap must be (T, J, 3), got {x.shape}'
        raise InputError(Reason.BAD_INPUT, msg)
    if uv.ndim != 4 or uv.shape[1:] != (*x.shape[:2], 2):
        msg = f'uv must be (V, {x.shape[0]}, {x.shape[1]}, 2) to fit x_mocap, got {uv.shape}'
        raise InputError(Reason.BAD_INPUT, msg)
    if confidence is not None and confidence.shape != uv.shape[:3]:
        msg = f'confidence must be {uv.shape[:3]} to fit uv, got {confidence.shape}'
        raise InputError(Reason.BAD_INPUT, msg)


def _stamps_ns(n_frames: int, fps: float | None, stamps: ArrayLike | None) -> IntArray | None:
    if stamps is not None:
        seconds = np.asarray(stamps, dtype=np.float64)
        is_known = bool((np.abs(seconds) < LARGEST_STAMP_S).all())  # False for NaN
        if seconds.shape != (n_frames,) or not is_known or not (np.diff(seconds) > 0.0).all():
            msg = f'stamps must be ({n_frames},) increasing seconds, got shape {seconds.shape}'
            raise InputError(Reason.BAD_INPUT, msg)
        return np.round(seconds * NS_PER_S).astype(np.int64)
    if fps is None:
        return None
    if not LOWEST_FPS <= fps <= HIGHEST_FPS:
        msg = f'fps must be a number from {LOWEST_FPS:g} to {HIGHEST_FPS:g}, got {fps}'
        raise InputError(Reason.BAD_INPUT, msg)
    return np.round(np.arange(n_frames) * (NS_PER_S / fps)).astype(np.int64)
