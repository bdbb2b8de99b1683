# SPDX-License-Identifier: Apache-2.0
"""Smooth functions of time from which a motion is made."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rpgd_ros.core.geometry import Array, IntArray

TURN_WIDTH_M = 0.45  # targets keep this far off the walls: nobody then leaves the room in turning
TURN_STEPS = 8  # control points of a path after which a walker gives up a target it circles around


@dataclass(frozen=True, slots=True, eq=False)
class Wobble:
    """A sum of sines with random frequencies and phases: bounded, smooth, without a period.

    Attributes:
        amplitude: Root mean square is about 0.7 of it; never above 1.5 of it.
        frequency_hz: (n,) of the sines.
        phase: (n,) radians.
        weight: (n,) of the sines.

    """

    amplitude: float
    frequency_hz: Array
    phase: Array
    weight: Array

    @classmethod
    def draw(
        cls, rng: np.random.Generator, amplitude: float, low_hz: float, high_hz: float
    ) -> Wobble:
        """Draw three sines with frequencies between the two given."""
        weight = rng.uniform(0.4, 1.0, 3)
        return cls(
            amplitude,
            rng.uniform(low_hz, high_hz, 3),
            rng.uniform(0.0, 2.0 * np.pi, 3),
            weight / np.sqrt((weight**2).sum()),
        )

    def __call__(self, t: Array) -> Array:
        """Return the values (T,) at the times (T,), seconds."""
        angles = 2.0 * np.pi * self.frequency_hz * t[:, None] + self.phase
        values: Array = self.amplitude * (np.sin(angles) @ self.weight)
        return values


def smooth_step(x: Array) -> Array:
    """Rise from 0 at x <= 0 to 1 at x >= 1 with a continuous slope."""
    c = np.clip(x, 0.0, 1.0)
    rise: Array = c * c * (3.0 - 2.0 * c)
    return rise


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """A uniform cubic B-spline on the floor: it never leaves the hull of its control points.

    Attributes:
        control: (K, 2) metres, K >= 4.
        start: Time of the curve's beginning, seconds.
        interval: Time from one control point to the next, seconds.

    """

    control: Array
    start: float
    interval: float

    def position(self, t: Array) -> Array:
        """Return where the path is (T, 2), metres."""
        k, u = self._locate(t)
        basis = np.stack(
            [
                (1.0 - u) ** 3,
                3.0 * u**3 - 6.0 * u**2 + 4.0,
                -3.0 * u**3 + 3.0 * u**2 + 3.0 * u + 1.0,
                u**3,
            ]
        )
        return self._blend(k, basis / 6.0)

    def velocity(self, t: Array) -> Array:
        """Return how fast the path runs (T, 2), metres per second."""
        k, u = self._locate(t)
        basis = np.stack(
            [-((1.0 - u) ** 2), 3.0 * u**2 - 4.0 * u, -3.0 * u**2 + 2.0 * u + 1.0, u**2]
        )
        return self._blend(k, basis / (2.0 * self.interval))

    def _locate(self, t: Array) -> tuple[IntArray, Array]:
        x = np.clip((t - self.start) / self.interval, 0.0, len(self.control) - 3)
        k = np.minimum(x.astype(np.int64), len(self.control) - 4)
        return k, x - k

    def _blend(self, k: IntArray, basis: Array) -> Array:
        near = np.stack([self.control[k + i] for i in range(4)])
        blended: Array = (basis[..., None] * near).sum(0)
        return blended


def wander(
    rng: np.random.Generator,
    *,
    start: float,
    end: float,
    area_m: float,
    centre: tuple[float, float],
    interval: float = 0.6,
) -> Path:
    """Lay a path that crosses a square room again and again.

    The walker steers towards one random target after another. Its direction turns by at most
    50 deg from one control point to the next, and the spline's velocity is a mean of three
    successive steps, so it never vanishes and the heading stays smooth.

    Args:
        rng: Source of the targets.
        start: Time at which the path begins, seconds.
        end: Time at which it ends, seconds.
        area_m: Side of the room, metres.
        centre: Middle of the room, metres.
        interval: Time between control points, seconds.

    """
    reach = 0.5 * area_m - TURN_WIDTH_M
    at = rng.uniform(-reach, reach, 2)
    heading = float(rng.uniform(-np.pi, np.pi))
    control = []
    patience = 0
    target, pace = at, 1.0
    for _ in range(int(np.ceil((end - start) / interval)) + 4):
        control.append(at)
        if patience == 0 or float(np.linalg.norm(target - at)) < 0.4:
            target, pace = rng.uniform(-reach, reach, 2), float(rng.uniform(0.45, 1.35))
            patience = TURN_STEPS
        patience -= 1
        aim = np.arctan2(target[1] - at[1], target[0] - at[0])
        wanted = float((aim - heading + np.pi) % (2.0 * np.pi) - np.pi)
        heading += float(np.clip(wanted, -np.radians(50.0), np.radians(50.0)))
        # People slow down to turn round.
        step = pace * interval * (0.3 + 0.7 * np.cos(0.5 * wanted) ** 4)
        at = at + step * np.array([np.cos(heading), np.sin(heading)])
        at = np.clip(at, -0.5 * area_m, 0.5 * area_m)
    return Path(np.array(control) + centre, start, interval)
