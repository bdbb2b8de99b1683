# SPDX-License-Identifier: Apache-2.0
"""The MoCap track as a smooth function of time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rpgd_ros.core.geometry import Array, BoolArray, IntArray
from rpgd_ros.core.observations import NS_PER_S, MocapTrack, is_there

if TYPE_CHECKING:
    from rpgd_ros.core.body_frame import BodyFrame

TRACK_SAMPLES = 3000  # that the noise is measured on
MAX_GAP_S = 0.1  # a limb swings through 10 cm meanwhile: no curve knows which way it went
MAX_GAP_STEPS = 1.5  # of a track so slow that each of its steps is such a gap
EVEN = 1.8  # longest over shortest of neighbouring steps: a missing sample makes it 2


class Timeline:
    """Skeletons and their velocities at any instant: cubic between samples.

    Linear interpolation of a 50 Hz track errs by 0.5 mm where a limb accelerates with 1 g; the
    cubic through the neighbours' slopes by a tenth of that.
    """

    def __init__(self, track: MocapTrack, *, is_noisy: bool = False) -> None:
        """Prepare the slopes of a track of two samples or more.

        Args:
            track: The MoCap track.
            is_noisy: Smooth it. Interpolated noise is smaller halfway between two samples than at
                one, so an offset of half a sample would seem to fit better than none; a cubic
                B-spline through means of three samples takes out as much of the noise wherever it
                is read, to 1 %.

        """
        self._is_noisy = is_noisy
        self._origin_ns = int(track.stamp_ns[0])
        self._t = self.seconds(track.stamp_ns)
        # A damaged sample would bend the curve between its neighbours, too.
        x = np.where(is_there(track.x_mocap)[..., None], track.x_mocap, np.nan)
        steps = np.diff(self._t)
        self._max_gap_s = max(MAX_GAP_S, MAX_GAP_STEPS * float(np.median(steps)))
        self._x = _evened(x, _are_even(steps)) if is_noisy else x
        self._slope = _slopes(self._t, self._x)
        self._turns: tuple[BodyFrame, Array] | None = None

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
        inside = (s >= 0.0) & (s <= 1.0) & (step <= self._max_gap_s)
        if self._is_noisy:
            both = self._splined(before, s, step)
            gaps = ~np.isfinite(both)
            if gaps.any():
                both[gaps] = self._interpolated(before, s, step)[gaps]
        else:
            both = self._interpolated(before, s, step)
        x, v = both.swapaxes(0, 1).reshape(2, len(t), *self._x.shape[1:])
        x[~inside] = np.nan
        v[~np.isfinite(x)] = 0.0
        return x, v

    def _interpolated(self, before: IntArray, s: Array, h: Array) -> Array:
        """(F, 2, 3 J) places and velocities by Hermite's cubic, a share s after a sample."""
        s2, s3 = s * s, s**3
        fall, rise = 6.0 * s - 6.0 * s2, 3.0 * s2 - 2.0 * s3
        weights = np.stack([
            1.0 - rise, rise, h * (s3 - 2.0 * s2 + s), h * (s3 - s2),
            -fall / h, fall / h, 3.0 * s2 - 4.0 * s + 1.0, 3.0 * s2 - 2.0 * s,
        ], 1)  # fmt: skip
        around = before[:, None] + [0, 1]
        n = len(before)
        samples = np.concatenate([self._x[around], self._slope[around]], 1).reshape(n, 4, -1)
        both: Array = weights.reshape(n, 2, 4) @ samples
        return both

    def _splined(self, before: IntArray, s: Array, h: Array) -> Array:
        """(F, 2, 3 J) the same by the cubic B-spline; NaN without four samples, evenly spaced."""
        r = 1.0 - s
        s2, s3, r2, r3 = s * s, s**3, r * r, r**3
        weights = np.stack([
            r3, 3.0 * s3 - 6.0 * s2 + 4.0, 3.0 * r3 - 6.0 * r2 + 4.0, s3,
            -3.0 * r2 / h, (9.0 * s2 - 12.0 * s) / h, (12.0 * r - 9.0 * r2) / h, 3.0 * s2 / h,
        ], 1) / 6.0  # fmt: skip
        around = np.clip(before[:, None] + [-1, 0, 1, 2], 0, len(self._t) - 1)
        n = len(before)
        both: Array = weights.reshape(n, 2, 4) @ self._x[around].reshape(n, 4, -1)
        both[~_are_even(np.diff(self._t[around], axis=1)).all(1)] = np.nan
        return both

    def turned(self, body: BodyFrame, t: Array) -> Array:
        """Return (F, 3, 3) mocap_R_heading at instants (F,), seconds: linear between samples.

        Between samples of 50 Hz a body turns by 3 deg at most: the mean of both is a rotation to
        one part in a thousand.
        """
        if self._turns is None or self._turns[0] is not body:
            self._turns = (body, body.headings(self._x))
        turns = self._turns[1]
        before = np.clip(np.searchsorted(self._t, t, side='right') - 1, 0, len(self._t) - 2)
        s = np.clip((t - self._t[before]) / (self._t[before + 1] - self._t[before]), 0.0, 1.0)
        s = s[:, None, None]
        mean: Array = (1.0 - s) * turns[before] + s * turns[before + 1]
        return mean


def track_noise_m(track: MocapTrack) -> float:
    """Noise of the 3D joints from one sample to the next, per axis, metres.

    Fourth differences cancel what is smooth: of a limb that swings at 2 Hz, sampled at 25 Hz, less
    than a millimetre is left.
    """
    there = is_there(track.x_mocap)
    some = np.flatnonzero(there.any(1))[:TRACK_SAMPLES]  # the person may come late
    x = np.where(there[some][..., None], track.x_mocap[some], np.nan)
    rough = np.abs(np.diff(x, 4, axis=0))
    rough = rough[np.isfinite(rough)]
    # Of normal noise the differences have a variance of 70, and half are below 0.6745 of a sigma.
    return float(np.median(rough)) / (0.6745 * np.sqrt(70.0)) if len(rough) else 0.0


def _are_even(steps: Array) -> BoolArray:
    """(..., n - 1) whether neighbouring steps (..., n) are of one length, up to jitter."""
    one, other = steps[..., :-1], steps[..., 1:]
    even: BoolArray = np.maximum(one, other) <= EVEN * np.minimum(one, other)
    return even


def _evened(x: Array, are_even: BoolArray) -> Array:
    """Return means of three samples, weights 1 2 1, where all are there at even distances."""
    out = x.copy()
    with np.errstate(invalid='ignore', over='ignore'):
        mean = 0.25 * (x[:-2] + 2.0 * x[1:-1] + x[2:])
    good = np.isfinite(mean) & are_even[:, None, None]
    out[1:-1][good] = mean[good]
    return out


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
