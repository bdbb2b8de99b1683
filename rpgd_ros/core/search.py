# SPDX-License-Identifier: Apache-2.0
"""Coarse search for the offset of a video that was never synchronised.

Each camera by itself: at every offset of a grid, triplets of its keypoints with the skeletons of
that offset give poses (P3P), and the best of them says how well the offset explains the rest. The
neighbourhood of the best offsets is searched again, finer.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from rpgd_ros.core.geometry import Array
from rpgd_ros.core.linearise import Sight
from rpgd_ros.core.pool import make_pool
from rpgd_ros.core.ransac import draw_triplets, rank, solve_triplets
from rpgd_ros.core.thin import at_seen_frames

if TYPE_CHECKING:
    from collections.abc import Callable

    from rpgd_ros.core.timeline import Timeline

GRID_S = 0.08  # a walker moves 10 cm meanwhile: halfway between, a pose still explains the rest
FINE_S = 0.02
BEST = 3  # offsets looked at again
TRIPLETS, FINE_TRIPLETS = 32, 64  # per offset: half the keypoints gross leaves 4 and 8 clean
FRAMES, POINTS = 200, 160  # looked at: enough to rank, whatever the length of the recording


def coarse_offset(
    sight: Sight, timeline: Timeline, *, span_s: float, rng: np.random.Generator,
    check: Callable[[float], None],
) -> float:  # fmt: skip
    """Find the offset of one camera to a few hundredths of a second.

    Args:
        sight: The camera with its data; it has stamps.
        timeline: The MoCap track.
        span_s: Offsets from -span_s to span_s are tried.
        rng: Source of the draws.
        check: Called with the fraction done; raises to end the run.

    """
    sight = at_seen_frames(sight, FRAMES)
    half = int(span_s / GRID_S)
    grid = np.linspace(-half * GRID_S, half * GRID_S, 2 * half + 1)
    score = _scores(sight, timeline, grid, TRIPLETS, rng, check)
    if not np.isfinite(score).any():
        return 0.0
    best = grid[np.argsort(score, kind='stable')[:BEST]]
    steps = np.linspace(-GRID_S, GRID_S, 2 * round(GRID_S / FINE_S) + 1)
    fine: Array = np.unique(np.round((best[:, None] + steps).ravel(), 6))
    return float(fine[np.argmin(_scores(sight, timeline, fine, FINE_TRIPLETS, rng, check))])


def _scores(
    sight: Sight, timeline: Timeline, offsets: Array, n_triplets: int,
    rng: np.random.Generator, check: Callable[[float], None],
) -> Array:  # fmt: skip
    """Score each offset by its best pose; lower is better, infinite where there is none."""
    out = np.full(len(offsets), np.inf)
    for k, offset in enumerate(offsets):
        check(k / len(offsets))
        pool = make_pool([_late(sight, timeline, offset)], POINTS, rng)
        if len(pool) < POINTS // 4:
            continue  # the skeletons of that offset are not in the recording
        triplets = draw_triplets(pool, n_triplets, rng, same_frame=False)
        ranked = rank(pool, *solve_triplets(pool, triplets))
        if len(ranked.score):
            out[k] = ranked.score[0]
    return out


def _late(sight: Sight, timeline: Timeline, offset_s: float) -> Sight:
    """Return the camera with the skeletons of its stamps less an offset."""
    x, _ = timeline.at(timeline.seconds(sight.view.known_stamp_ns) - offset_s)
    return Sight(sight.camera, replace(sight.view, x_mocap=x))
