# SPDX-License-Identifier: Apache-2.0
"""Whether video and MoCap show the same motion at the same speed."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import numpy as np

from rpgd_ros.core.geometry import Array, IntArray

GRID_HZ: Final = 30.0
STEP_S: Final = 0.1  # over which a joint moves: a third of a step of a walk
TREND_S: Final = 2.0  # coming nearer makes all speeds larger
SHORTEST_S: Final = 5.0  # ten steps; fewer fit at many speeds
SEGMENT_S: Final = 60.0
MAX_LAG_S: Final = 10.0
SOME_MOTION: Final = 0.5  # share of a segment in which a speed is known
# Recorded walks and games of 15 to 23 s, keypoints to 1 px (4 px): 0.86 to 0.96 (0.54 to 0.88) at
# the right rate, at most 0.55 at another that differs by a fifth or more; of other motions, at all
# rates, at most 0.61 in 616 trials.
FITS, FITS_NOT, LEAST_GAIN = 0.65, 0.5, 0.25


def activity(time_s: Array, points: Array) -> Array:
    """Return how fast a pose changes on a grid of `GRID_HZ` from its first frame on.

    Args:
        time_s: (T,) increasing.
        points: (T, J, D) joints in space or in an image; NaN = missing.

    Returns:
        (N,) speed of the joints beside that of the body, over its average of some seconds; NaN
        where it is not known.

    """
    grid = np.arange(time_s[0], time_s[-1], 1.0 / GRID_HZ)
    before, after = (_frames_at(time_s, grid + sign * STEP_S / 2.0) for sign in (-1.0, 1.0))
    lasted = time_s[after] - time_s[before]
    near = np.flatnonzero(np.abs(lasted / STEP_S - 1.0) < 0.5)  # few where frames are far apart
    step = points[after[near]] - points[before[near]]
    known = np.asarray(np.isfinite(step).all(-1))
    step = np.where(known[..., None], step / lasted[near, None, None], 0.0)
    count = known.sum(1)
    body = step.sum(1) / np.maximum(count, 1)[:, None]
    total = np.where(known, np.linalg.norm(step - body[:, None], axis=-1), 0.0).sum(1)
    speed = np.full(len(grid), np.nan)
    speed[near] = np.where(count >= 3, total / np.maximum(count, 1), np.nan)
    with np.errstate(invalid='ignore', divide='ignore'):
        return speed / _smoothed(speed)


def _frames_at(time_s: Array, when: Array) -> IntArray:
    """Return the frames nearest to some times."""
    middle = 0.5 * (time_s[1:] + time_s[:-1])
    return np.searchsorted(middle, when).astype(np.int64)


def _smoothed(values: Array) -> Array:
    window = np.ones(min(len(values), round(TREND_S * GRID_HZ)))
    known = np.isfinite(values)
    total = np.convolve(np.where(known, values, 0.0), window, mode='same')
    return total / np.convolve(known.astype(np.float64), window, mode='same')


def likeness(mocap: Array, camera: Array, begin: int) -> float:
    """Return the largest correlation of two activities over lags of some seconds.

    Args:
        mocap: (N,)
        camera: (M,)
        begin: Sample of the MoCap at which the camera is thought to begin.

    """
    n = min(len(camera), round(SEGMENT_S * GRID_HZ))
    skip = (len(camera) - n) // 2
    part = camera[skip : skip + n]
    most = round(MAX_LAG_S * GRID_HZ)
    best = 0.0
    for lag in range(begin + skip - most, begin + skip + most + 1):
        low, high = max(0, lag), min(len(mocap), lag + n)
        if high - low >= max(SHORTEST_S * GRID_HZ, 0.5 * min(n, len(mocap))):
            best = max(best, _correlation(mocap[low:high], part[low - lag : high - lag]))
    return best


def _correlation(a: Array, b: Array) -> float:
    known = np.isfinite(a) & np.isfinite(b)
    if known.sum() < SOME_MOTION * len(a):
        return 0.0
    a, b = a[known] - a[known].mean(), b[known] - b[known].mean()
    scale = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / scale if scale > 0.0 else 0.0


def better_rate(
    mocap: tuple[Array, Array],
    camera: tuple[IntArray, Array],
    fps: float,
    rates: Iterable[float],
    begin_s: float,
) -> float | None:
    """Return a frame rate at which the video fits the MoCap, where it does not at its own.

    Args:
        mocap: Times (T,) and joints (T, J, 3).
        camera: Frame numbers (F,) and the same joints (F, J, 2).
        fps: That was stated for the video.
        rates: That it may have instead.
        begin_s: After the first frame of the MoCap, when frame 0 was taken as far as is known.

    """
    still = activity(mocap[0] - mocap[0][0], mocap[1])

    def fit(rate: float) -> float:
        time_s = camera[0] / rate
        moving = activity(time_s, camera[1])
        return likeness(still, moving, round((begin_s + time_s[0]) * GRID_HZ))

    own = fit(fps)
    if own >= FITS_NOT:
        return None
    best, rate = max(((fit(rate), rate) for rate in rates), default=(0.0, fps))
    return rate if best >= max(FITS, own + LEAST_GAIN) else None
