# SPDX-License-Identifier: Apache-2.0
"""Downsampling in time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rpgd_ros.core.geometry import IntArray

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rpgd_ros.core.linearise import Sight

MIDDLE_POINTS = 32_768  # the noise is fitted on them: 0.5 % of its sigma


def spread(n_frames: int, wanted: int) -> IntArray:
    """Return up to `wanted` frame numbers, evenly spread from first to last."""
    if wanted >= n_frames:
        return np.arange(n_frames)
    return np.linspace(0, n_frames - 1, wanted).round().astype(int)


def drawn_evenly(n: int, wanted: int, rng: np.random.Generator) -> IntArray:
    """Return up to `wanted` numbers below n, ascending: one from each of as many equal stretches.

    For points, which follow each other joint by joint: at equal distances all may be of one joint.
    """
    if wanted >= n:
        return np.arange(n)
    return ((np.arange(wanted) + rng.random(wanted)) * (n / wanted)).astype(np.int64)


def at_seen_frames(sight: Sight, wanted: int) -> Sight:
    """Return up to `wanted` frames of a camera, evenly spread.

    Where few of them show anybody, over those that do: a visit of a second in an hour falls
    between evenly spread frames.
    """
    if wanted >= sight.view.n_frames:
        return sight
    part = sight.at_frames(spread(sight.view.n_frames, wanted))
    if 2 * np.count_nonzero(part.view.seen().any(1)) >= part.view.n_frames:
        return part
    frames = np.flatnonzero(sight.view.seen().any(1))
    return sight.at_frames(frames[spread(len(frames), wanted)]) if len(frames) else part


def thin(sights: Sequence[Sight], points: int, *, stride: int = 0) -> list[Sight]:
    """Downsample in time: every stride-th frame, or to about `points` correspondences in all."""
    total = sum(s.view.n_frames * s.view.n_joints for s in sights)
    share = min(1.0, points / max(total, 1))
    return [_one(s, stride, max(1, int(np.ceil(share * s.view.n_frames)))) for s in sights]


def thin_each(sights: Sequence[Sight], frames: int, *, stride: int = 0) -> list[Sight]:
    """Downsample in time: every stride-th frame, or to `frames` of each camera."""
    return [_one(s, stride, frames) for s in sights]


def _one(sight: Sight, stride: int, wanted: int) -> Sight:
    if stride > 1:
        return sight.at_frames(np.arange(0, sight.view.n_frames, stride))
    return sight if stride else at_seen_frames(sight, wanted)
