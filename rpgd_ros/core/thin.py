# SPDX-License-Identifier: Apache-2.0
"""Downsampling in time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rpgd_ros.core.geometry import IntArray

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rpgd_ros.core.linearise import Sight

MIDDLE_POINTS = 32_768  # the noise is fitted on them: 0.5 % of its sigma


def spread(n_frames: int, wanted: int) -> IntArray:
    """Return up to `wanted` frame numbers, evenly spread from first to last."""
    if wanted >= n_frames:
        return np.arange(n_frames)
    return np.linspace(0, n_frames - 1, wanted).round().astype(int)


def thin(sights: Sequence[Sight], points: int, *, stride: int = 0) -> list[Sight]:
    """Downsample in time: every stride-th frame, or to about `points` correspondences in all."""
    total = sum(s.view.n_frames * s.view.n_joints for s in sights)
    share = min(1.0, points / max(total, 1))
    return _pick(sights, stride, lambda n: spread(n, max(1, int(np.ceil(share * n)))))


def thin_each(sights: Sequence[Sight], frames: int, *, stride: int = 0) -> list[Sight]:
    """Downsample in time: every stride-th frame, or to `frames` of each camera."""
    return _pick(sights, stride, lambda n: spread(n, frames))


def _pick(sights: Sequence[Sight], stride: int, choose: Callable[[int], IntArray]) -> list[Sight]:
    out = []
    for s in sights:
        n = s.view.n_frames
        frames = np.arange(0, n, stride) if stride else choose(n)
        out.append(s if len(frames) == n else s.at_frames(frames))
    return out
