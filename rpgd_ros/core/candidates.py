# SPDX-License-Identifier: Apache-2.0
"""Skeletons and detections of several persons, before and after it is known who is who."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import Array, BoolArray, IntArray
from rpgd_ros.core.observations import (
    NS_PER_S,
    TAKE_NS,
    MocapTrack,
    Observations,
    View,
    check_names,
    check_shape,
    is_there,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

APART_NS = 1000 * NS_PER_S  # at least between two recordings: no offset bridges it


@dataclass(frozen=True, slots=True, eq=False)
class CrowdView:
    """What one camera saw of several persons, beside the skeletons of its instants.

    Attributes:
        stamp_ns: (F,) instants of the camera, strictly increasing; None where no time is known.
        x_mocap: (F, S, J, 3) skeletons at those instants, metres, MoCap frame; NaN = missing. Each
            of the S keeps its place from instant to instant.
        uv: (F, P, J, 2) keypoints of the persons detected, in any order, pixels; NaN = missing.
        confidence: (F, P, J) detector scores, or None.

    """

    stamp_ns: IntArray | None
    x_mocap: Array
    uv: Array
    confidence: Array | None = None

    @property
    def n_frames(self) -> int:
        """Number of instants."""
        return len(self.uv)

    def there(self) -> tuple[BoolArray, BoolArray]:
        """(F, S, J) and (F, P, J) whether joints and keypoints are there and are numbers."""
        return is_there(self.x_mocap), is_there(self.uv)

    def at_frames(self, frames: IntArray) -> CrowdView:
        """Return a selection of the instants."""
        stamp_ns = None if self.stamp_ns is None else self.stamp_ns[frames]
        confidence = None if self.confidence is None else self.confidence[frames]
        return CrowdView(stamp_ns, self.x_mocap[frames], self.uv[frames], confidence)


@dataclass(frozen=True, slots=True, eq=False)
class Crowd:
    """Candidates of a recording with several persons.

    Attributes:
        views: One per camera, in the order of the cameras.
        tracks: The MoCap stream of each skeleton; empty where no time is known.
        joint_names: (J,) names for reports; None where unknown.

    Raises:
        InputError: Views that do not fit each other.

    """

    views: tuple[CrowdView, ...]
    tracks: tuple[MocapTrack, ...] = ()
    joint_names: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        """Check once, at the border."""
        for number, view in enumerate(self.views):
            uv, x = view.uv.shape, view.x_mocap.shape
            shape = self.views[0].x_mocap.shape[1:]
            fits = len(uv) == len(x) == 4 and x[1:] == shape and shape[-1] == 3
            if not fits or uv[0] != x[0] or uv[2:] != (shape[1], 2):
                msg = (
                    f'view {number} has skeletons {x} and keypoints {uv}, need (F, S, J, 3) and '
                    '(F, P, J, 2) with the S and J of the other views'
                )
                raise InputError(Reason.BAD_INPUT, msg)
            check_shape(f'stamps of view {number}', view.stamp_ns, uv[:1])
            check_shape(f'confidence of view {number}', view.confidence, uv[:3])
            check_names(self.joint_names, shape[1])

    def of(self, skeletons: tuple[int, ...]) -> Crowd:
        """Return the crowd with some of its skeletons."""
        views = tuple(replace(v, x_mocap=v.x_mocap[:, skeletons]) for v in self.views)
        tracks = tuple(self.tracks[s] for s in skeletons) if self.tracks else ()
        return replace(self, views=views, tracks=tracks)

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
    ) -> Crowd:
        """Build from synchronous arrays.

        Args:
            x_mocap: (T, S, J, 3) skeletons, or (T, J, 3) of one subject, metres, NaN = missing.
            uv: (V, T, P, J, 2) detections in any order, pixels, NaN = missing.
            confidence: (V, T, P, J) detector scores.
            fps: Frames per second, where time is known by rate.
            stamps: (T,) seconds, where time is known by stamp.
            joint_names: (J,) names for reports.

        Raises:
            InputError: Shapes that do not fit, or stamps that do not increase.

        """
        x = np.asarray(x_mocap, np.float64)
        x = x[:, None] if x.ndim == 3 else x
        pixels = np.asarray(uv, np.float64)
        scores = None if confidence is None else np.asarray(confidence, np.float64)
        if x.ndim != 4 or pixels.ndim != 5 or pixels.shape[1] != len(x) or not x.shape[1]:
            msg = (
                f'need x_mocap (T, S, J, 3) and uv (V, T, P, J, 2), got {x.shape}, {pixels.shape}'
            )
            raise InputError(Reason.BAD_INPUT, msg)
        nobody = np.empty((0, *x.shape[:1], x.shape[2], 2))
        timed = Observations.from_arrays(x[:, 0], nobody, fps=fps, stamps=stamps)
        stamp_ns = timed.mocap.stamp_ns if timed.mocap else None
        tracks = () if stamp_ns is None else tuple(
            MocapTrack(stamp_ns, x[:, s]) for s in range(x.shape[1])
        )  # fmt: skip
        views = tuple(
            CrowdView(stamp_ns, x, pixels[v], None if scores is None else scores[v])
            for v in range(len(pixels))
        )
        return cls(views, tracks, joint_names)


def taken(view: CrowdView, picks: IntArray) -> View:
    """Return the picked pairs as frames, all of the first skeleton first."""
    skeleton, frame = np.nonzero(picks.T >= 0)
    person = picks[frame, skeleton]
    stamp_ns = None if view.stamp_ns is None else view.stamp_ns[frame]
    scores = None if view.confidence is None else view.confidence[frame, person]
    return View(stamp_ns, view.x_mocap[frame, skeleton], view.uv[frame, person], scores)


def assemble(crowd: Crowd, chosen: Sequence[IntArray]) -> Observations:
    """Put the recordings of the skeletons one after the other."""
    shifts = shifts_ns(crowd)
    views = []
    for view, picks in zip(crowd.views, chosen, strict=True):
        one = taken(view, picks)
        if one.stamp_ns is not None:
            skeleton, _ = np.nonzero(picks.T >= 0)
            one = replace(one, stamp_ns=one.stamp_ns + shifts[skeleton])
        views.append(one)
    track = None
    if crowd.tracks:
        stamps = [t.stamp_ns + by for t, by in zip(crowd.tracks, shifts, strict=True)]
        if len(crowd.tracks) == 1:
            track = crowd.tracks[0]
        else:
            x = np.concatenate([t.x_mocap for t in crowd.tracks])
            track = MocapTrack(np.concatenate(stamps), x)
    return Observations(tuple(views), track, crowd.joint_names)


def shifts_ns(crowd: Crowd) -> IntArray:
    """(S,) nanoseconds by which the recording of each skeleton is moved, see `real_ns`."""
    n_skeletons = crowd.views[0].x_mocap.shape[1] if crowd.views else 1
    stamps = [v.stamp_ns for v in crowd.views if v.stamp_ns is not None and v.n_frames]
    stamps += [t.stamp_ns for t in crowd.tracks if len(t.stamp_ns)]
    if not stamps:
        return np.zeros(n_skeletons, np.int64)
    span = max(int(s[-1]) for s in stamps) - min(int(s[0]) for s in stamps)
    return np.arange(n_skeletons) * (-(-(span + APART_NS) // TAKE_NS) * TAKE_NS)
