# SPDX-License-Identifier: Apache-2.0
"""Where a body goes, which way it faces, and the phase of its stride."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import Array
from rpgd_ros.simulation.signals import Path, Wobble, wander

MotionName = Literal['walk', 'sway', 'turn_in_place', 'still']
MOTIONS: tuple[MotionName, ...] = get_args(MotionName)

MARGIN_S = 2.0  # a course reaches this far beyond its time: latencies look back, stamps jitter
PHASE_STEP_S = 0.02  # the stride's phase is integrated at 50 Hz: its error stays below 1e-4 cycles
STANCE = 0.6  # share of the cycle that a foot stands, as at a comfortable speed
MAX_STEP_M = 0.75  # length of a step at high speed
STEP_SPEED = 0.7  # m/s at which it is 0.7 of that; together 1.9 steps per second at 1.2 m/s
LIVELY_SPEED = 0.35  # m/s at which arms and feet swing 0.7 of their full range
TURN_VIGOUR = 0.4  # of turn_in_place: feet are lifted, arms swing a little
TURN_PERIOD_S = 9.0  # of turn_in_place: an unhurried turn on the spot
SWAY_M = 0.007  # quiet standing: 5 to 10 mm


@dataclass(frozen=True, slots=True, eq=False)
class Instants:
    """What the course says about some instants.

    Attributes:
        position: (T, 2) of the pelvis on the floor, metres.
        heading: (T,) direction of the body's forward axis, radians from x towards y.
        speed: (T,) metres per second.
        phase: (T,) cycles of the stride; the left heel strikes at whole numbers.
        vigour: (T,) 0 to 1, how much of their range the limbs use.
        sway: (T, 2) of the pelvis against the feet, forward and left, metres.
        activity: (T,) time by which arms, trunk and head move, seconds.

    """

    position: Array
    heading: Array
    speed: Array
    phase: Array
    vigour: Array
    sway: Array
    activity: Array


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """A motion as a function of continuous time, so that any clock can sample it.

    Attributes:
        motion: One of `MOTIONS`.
        path: On the floor; a single place where the body stays.
        heading: At time 0 where the body stays, radians.
        phase_t: (K,) seconds.
        phase: (K,) cycles at those times.
        sway: Forward and left.

    """

    motion: MotionName
    path: Path
    heading: float
    phase_t: Array
    phase: Array
    sway: tuple[Wobble, Wobble]

    def at(self, t: Array) -> Instants:
        """Sample the course at the times (T,), seconds."""
        velocity = self.path.velocity(t)
        speed = np.hypot(velocity[:, 0], velocity[:, 1])
        heading = np.full_like(t, self.heading)
        vigour = speed / np.hypot(speed, LIVELY_SPEED)
        if self.motion == 'walk':
            heading = np.arctan2(velocity[:, 1], velocity[:, 0])
        elif self.motion == 'turn_in_place':
            heading = heading + 2.0 * np.pi / TURN_PERIOD_S * t
            vigour = np.full_like(t, TURN_VIGOUR)
        sway = np.stack([wobble(t) for wobble in self.sway], -1)
        return Instants(
            position=self.path.position(t),
            heading=heading,
            speed=speed,
            phase=np.interp(t, self.phase_t, self.phase),
            vigour=vigour,
            sway=sway * (self.motion in {'walk', 'sway'}),
            activity=t if self.motion in {'walk', 'turn_in_place'} else np.zeros_like(t),
        )


def stride_length(speed: Array) -> Array:
    """Return the length of a stride (two steps), metres, at a speed, m/s."""
    length: Array = 2.0 * MAX_STEP_M * speed / np.hypot(speed, STEP_SPEED)
    return length


def plan_course(
    rng: np.random.Generator,
    motion: MotionName,
    *,
    seconds: float,
    area_m: float,
    centre: tuple[float, float] = (0.0, 0.0),
) -> Course:
    """Draw a course.

    Args:
        rng: Source of everything random.
        motion: One of `MOTIONS`.
        seconds: Length; the course holds from `-MARGIN_S` to `seconds + MARGIN_S`.
        area_m: Side of the square that a walker crosses, metres.
        centre: Middle of that square, and where the other motions take place, metres.

    Raises:
        InputError: Unknown motion.

    """
    if motion not in MOTIONS:
        msg = f'unknown motion {motion!r}; known: {", ".join(MOTIONS)}'
        raise InputError(Reason.BAD_INPUT, msg)
    start, end = -MARGIN_S, seconds + MARGIN_S
    if motion == 'walk':
        path = wander(rng, start=start, end=end, area_m=area_m, centre=centre)
    else:
        path = Path(np.tile(np.asarray(centre, dtype=np.float64), (4, 1)), start, end - start)
    t = np.arange(start, end + PHASE_STEP_S, PHASE_STEP_S)
    speed = np.linalg.norm(path.velocity(t), axis=1)
    # Cycles per second = speed / stride length, which has a limit where the body stands.
    rate = np.hypot(speed, STEP_SPEED) / (2.0 * MAX_STEP_M)
    phase = rng.uniform(0.0, 1.0) + np.cumsum(rate) * PHASE_STEP_S
    sway = (Wobble.draw(rng, SWAY_M, 0.1, 0.5), Wobble.draw(rng, SWAY_M, 0.1, 0.5))
    return Course(motion, path, float(rng.uniform(-np.pi, np.pi)), t, phase, sway)
