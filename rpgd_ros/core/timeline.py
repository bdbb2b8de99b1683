# SPDX-License-Identifier: Apache-2.0
"""The MoCap track as a smooth function of time."""

from __future__ import annotations

import numpy as np

from rpgd_ros.core.geometry import Array, IntArray
from rpgd_ros.core.observations import LARGEST_COORDINATE, NS_PER_S, MocapTrack

MAX_GAP_S = 0.1  # a limb swings through 10 cm meanwhile: no curve knows which way it went


class Timeline:
    """Skeletons and their velocities at any instant: cubic between samples.

    Linear interpolation of a 50 Hz track errs by 0.5 mm where a limb accelerates with 1 g; the
    cubic through the neighbours' slopes by a tenth of that.
    """

    def __init__(self, track: MocapTrack) -> None:
        """Prepare the slopes of a track of two samples or more."""
        self._origin_ns = int(track.stamp_ns[0])
        self._t = self.seconds(track.stamp_ns)
        with np.errstate(invalid='ignore'):
            whole = np.abs(track.x_mocap).max(-1, keepdims=True) < LARGEST_COORDINATE
        # A damaged sample would bend the curve between its neighbours, too.
        self._x = np.where(whole, track.x_mocap, np.nan)
        self._slope = _slopes(self._t, self._x)

    def seconds(self, stamp_ns: IntArray) -> Array:
        """Return stamps as seconds after the first sample."""
        elapsed: Array = (stamp_ns - self._origin_ns) / NS_PER_S
        return elapsed

    def at(self, t: Array) -> tuple[Array, Array]:
        """Return skeletons (F, J, 3), metres, and velocities, m/s, at instants (F,), seconds.

        Joints that are missing, and instants outside the track or in a gap of it, are NaN with a
        velocity of zero.
        """
        last = len(self._t) - 1
        before = np.clip(np.searchsorted(self._t, t, side='right') - 1, 0, last - 1)
        step = self._t[before + 1] - self._t[before]
        s = (t - self._t[before]) / step
        inside = (s >= 0.0) & (s <= 1.0) & (step <= MAX_GAP_S)
        s, h = s[:, None, None], step[:, None, None]
        x0, x1 = self._x[before], self._x[before + 1]
        m0, m1 = h * self._slope[before], h * self._slope[before + 1]
        rise = x1 - x0
        # Hermite: x0 + s m0 + s^2 (3 rise - 2 m0 - m1) + s^3 (m0 + m1 - 2 rise)
        second, third = 3.0 * rise - 2.0 * m0 - m1, m0 + m1 - 2.0 * rise
        x = x0 + s * (m0 + s * (second + s * third))
        v = (m0 + s * (2.0 * second + s * 3.0 * third)) / h
        x[~inside] = np.nan
        v[~np.isfinite(x)] = 0.0
        return x, v


def _slopes(t: Array, x: Array) -> Array:
    """Return the slope at each sample: through both neighbours, or the one that is there."""
    with np.errstate(invalid='ignore', over='ignore'):
        forward = np.diff(x, axis=0) / np.diff(t)[:, None, None]
    slope = np.empty_like(x)
    slope[0], slope[-1] = forward[0], forward[-1]
    share = (np.diff(t)[1:] / (t[2:] - t[:-2]))[:, None, None]
    slope[1:-1] = share * forward[:-1] + (1.0 - share) * forward[1:]
    for side, neighbour in ((slope[1:], forward), (slope[:-1], forward)):
        gap = ~np.isfinite(side)
        side[gap] = neighbour[gap]
    slope[~np.isfinite(slope)] = 0.0
    return slope
