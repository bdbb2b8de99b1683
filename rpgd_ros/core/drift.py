# SPDX-License-Identifier: Apache-2.0
"""Whether the MoCap frame creeps through the room, as those of inertial suits do.

Each stretch of time has an opinion of its own on the pose. A trend through these opinions that
their scatter does not explain is a drift.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rpgd_ros.core.agreement import chance, lasts_long
from rpgd_ros.core.covariance import invert
from rpgd_ros.core.examine import TIME_BLOCKS, time_blocks, times_s
from rpgd_ros.core.geometry import Array, RigidTransform
from rpgd_ros.core.normal import delta_between, normal_equations, spectrum
from rpgd_ros.core.refine import GOOD_STEP, descend, newton_step

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rpgd_ros.core.linearise import Sight
    from rpgd_ros.core.noise import Loss

LEAST_DEG, LEAST_M = 0.1, 0.005  # over the recording: less matters to nobody
LEAST_BLOCKS = 6  # with data, to tell a trend from scatter
# Least over largest eigenvalue of scaled sums. Sums of single precision leave 1e-5 where nothing
# was seen; half a second of one camera has 6e-4.
ROUNDING = 2e-5
STEPS = 10  # of the descent of a stretch that is far off


class Drift(NamedTuple):
    """How fast `world_T_mocap` changes; the pose reported is that in mid-recording.

    Attributes:
        deg_per_min: Rate of the rotation.
        mm_per_min: Rate of the body's position.
        sigma_deg_per_min: Standard deviation of the first.
        sigma_mm_per_min: Standard deviation of the second.
        excess: How many times the test statistic exceeds what chance gives once in 10 000 runs.
        seconds: Duration of the recording.

    """

    deg_per_min: float
    mm_per_min: float
    sigma_deg_per_min: float
    sigma_mm_per_min: float
    excess: float
    seconds: float

    @property
    def is_certain(self) -> bool:
        """Whether there is a drift, beyond doubt and worth a word."""
        minutes = self.seconds / 60.0
        matters = (
            self.deg_per_min * minutes > LEAST_DEG or self.mm_per_min * minutes > 1e3 * LEAST_M
        )
        return self.excess > 1.0 and matters

    def sentence(self) -> str:
        """Say it to a person."""
        return (
            f'the MoCap frame drifts by {self.deg_per_min:.2f} +- {self.sigma_deg_per_min:.2f} '
            f'deg and {self.mm_per_min:.0f} +- {self.sigma_mm_per_min:.0f} mm per minute: the '
            'transform is that of mid-recording. Calibrate again often, or mend the MoCap'
        )


def find_drift(
    sights: Sequence[Sight], pose: RigidTransform, centroid_mocap: Array, loss: Loss
) -> Drift | None:
    """Fit a trend through the poses of the stretches of time.

    Args:
        sights: Cameras with (a part of) their data, clocks and joints corrected.
        pose: world_T_mocap at the optimum.
        centroid_mocap: (3,) pivot, metres.
        loss: Loss of the squared residual.

    Returns:
        None where no time is known, or too little of it.

    """
    if any(s.view.stamp_ns is None for s in sights) or not lasts_long(sights):
        return None
    times = np.concatenate(times_s(sights))
    seconds = float(times.max() - times.min())
    blocks = time_blocks(sights)
    opinions = []
    for number in range(TIME_BLOCKS):
        part = [
            s.at_frames(np.flatnonzero(block == number))
            for s, block in zip(sights, blocks, strict=True)
        ]
        part = [s for s in part if s.view.n_frames]
        if part:
            middle = (number + 0.5) / TIME_BLOCKS - 0.5
            found = _opinion(part, pose, centroid_mocap, loss)
            if found is not None:
                opinions.append((middle * seconds, *found))
    if len(opinions) < LEAST_BLOCKS:
        return None
    return _trend(opinions, seconds)


def _opinion(
    part: Sequence[Sight], pose: RigidTransform, centroid_mocap: Array, loss: Loss
) -> tuple[Array, Array] | None:
    """Where a stretch of time would put the body: step (6,) from the pose, and its information."""
    normal = normal_equations(part, pose, pose @ centroid_mocap, loss)
    # One joint of one camera does not tell all of a pose.
    if not spectrum(normal.information, normal.information).is_definite(ROUNDING):
        return None
    step, decrement = newton_step(normal.hessian, normal.information, normal.gradient)
    if decrement < GOOD_STEP:
        return step, normal.information
    # So far off that what drifted away looks like outliers from here.
    near = descend(part, pose, centroid_mocap, loss, max_steps=STEPS, check=lambda _: None)
    step = delta_between(pose, near, centroid_mocap)
    return step, normal_equations(part, near, near @ centroid_mocap, loss).information


def _trend(opinions: Sequence[tuple[float, Array, Array]], seconds: float) -> Drift:
    """Weighted line through (time, step, information) of each stretch."""
    normal, pull = np.zeros((12, 12)), np.zeros(12)
    for t, step, weight in opinions:
        line = np.hstack([np.eye(6), t * np.eye(6)])
        normal += line.T @ weight @ line
        pull += line.T @ weight @ step
    inverse = invert(normal)
    fit = inverse @ pull
    left = [step - fit[:6] - t * fit[6:] for t, step, _ in opinions]
    free = 6 * (len(opinions) - 2)
    scatter = max(
        sum(float(e @ w @ e) for e, (_, _, w) in zip(left, opinions, strict=True)) / free, 1.0
    )
    rate, covariance = fit[6:], scatter * inverse[6:, 6:]
    statistic = float(rate @ np.linalg.solve(covariance, rate)) / 6.0
    per_minute = 60.0 * np.array([np.degrees(1.0), 1e3])
    sigma = [np.sqrt(np.trace(covariance[part, part])) for part in (slice(0, 3), slice(3, 6))]
    return Drift(
        float(np.linalg.norm(rate[:3]) * per_minute[0]),
        float(np.linalg.norm(rate[3:]) * per_minute[1]),
        float(sigma[0] * per_minute[0]),
        float(sigma[1] * per_minute[1]),
        statistic / chance(free),
        seconds,
    )
