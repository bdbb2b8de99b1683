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
    return np.unique(
        np.linspace(0, max(n_frames - 1, 0), min(n_frames, wanted)).round().astype(int)
    )


def thin(sights: Sequence[Sight], stride: int, choose: Callable[[int], IntArray]) -> list[Sight]:
    """Downsample in time: every stride-th frame, or those that `choose` picks of n."""
    out = []
    for s in sights:
        n = s.view.n_frames
        frames = np.arange(0, n, stride) if stride else choose(n)
        out.append(s if len(frames) == n else s.at_frames(frames))
    return out


def budget(sights: Sequence[Sight], points: int) -> Callable[[int], IntArray]:
    """Return a chooser that keeps about `points` correspondences over all cameras."""
    total = sum(s.view.n_frames * s.view.n_joints for s in sights)
    share = min(1.0, points / max(total, 1))
    return lambda n_frames: spread(n_frames, max(1, int(np.ceil(share * n_frames))))
