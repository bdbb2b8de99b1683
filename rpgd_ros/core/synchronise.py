# SPDX-License-Identifier: Apache-2.0
"""The whole question of time: which offsets there are, and which of them can be known."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from rpgd_ros.core.covariance import offset_sigmas
from rpgd_ros.core.geometry import Array, RigidTransform
from rpgd_ros.core.linearise import Sight, residuals
from rpgd_ros.core.noise import NoiseModel, noise_at
from rpgd_ros.core.offsets import descend_in_time, shifted, timed_equations
from rpgd_ros.core.ransac import Start, robust_start
from rpgd_ros.core.search import coarse_offset

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rpgd_ros.core.config import CalibrationConfig
    from rpgd_ros.core.timeline import Timeline

WEAK_SHARE = 0.5  # a camera of which less agrees may be off by more than a descent can bridge
STEPS = 12


@dataclass(frozen=True, slots=True, eq=False)
class Synchronised:
    """Offsets and the pose that goes with them.

    Attributes:
        offset_s: (V,) seconds: MoCap time = video stamp - offset; 0 where it cannot be known.
        column: Per camera the number of its offset among those estimated, or -1.
        pose: world_T_mocap at these offsets.
        noise: Spread of its residuals.

    """

    offset_s: Array
    column: tuple[int, ...]
    pose: RigidTransform
    noise: NoiseModel


def synchronise(
    sights: Sequence[Sight], timeline: Timeline, start: Start, centroid_mocap: Array,
    config: CalibrationConfig, rng: np.random.Generator,
    *, check: Callable[[float], None],
) -> Synchronised:  # fmt: skip
    """Estimate offsets and pose on a part of the data.

    Args:
        sights: Cameras with their data; all have stamps.
        timeline: The MoCap track.
        start: Outcome of the robust start without offsets.
        centroid_mocap: (3,) pivot, metres.
        config: Settings.
        rng: Source of the draws.
        check: Called with the fraction done; raises to end the run.

    """
    is_common = config.time.estimate_offset == 'common'
    column = tuple(0 if is_common else v for v in range(len(sights)))
    state = _begin(np.zeros(len(sights)), column, start)
    state = _settle(sights, timeline, state, centroid_mocap, check)
    weak = [v for v, share in enumerate(_shares(sights, timeline, state)) if share < WEAK_SHARE]
    if config.time.search_s > 0.0 and (weak or not state.noise.is_sharp):
        offset_s = state.offset_s.copy()
        for v in weak if state.noise.is_sharp else range(len(sights)):
            offset_s[v] = coarse_offset(
                sights[v], timeline, span_s=config.time.search_s, rng=rng, check=check
            )
        if is_common:
            offset_s[:] = np.median(offset_s)
        moved, _ = shifted(sights, timeline, offset_s)
        again = robust_start(moved, config.ransac, rng, check=check)
        searched = _begin(offset_s, column, again)
        searched = _settle(sights, timeline, searched, centroid_mocap, check)
        if (not searched.noise.is_sharp, -searched.noise.share) < (
            not state.noise.is_sharp,
            -state.noise.share,
        ):
            state = searched
    return _without_unknown(sights, timeline, state, centroid_mocap, config, check)


def _begin(offset_s: Array, column: tuple[int, ...], start: Start) -> Synchronised:
    pose, noise, _ = start.candidates[0]
    return Synchronised(offset_s, column, pose, noise)


def _settle(
    sights: Sequence[Sight], timeline: Timeline, state: Synchronised, centroid_mocap: Array,
    check: Callable[[float], None],
) -> Synchronised:  # fmt: skip
    """Descend, fit the noise again, descend."""
    pose, offset_s, noise = state.pose, state.offset_s, state.noise
    for _ in range(2):
        pose, offset_s, _ = descend_in_time(
            sights, timeline, pose, offset_s, centroid_mocap=centroid_mocap, loss=noise,
            column=state.column, max_steps=STEPS, check=check,
        )  # fmt: skip
        noise = noise_at(shifted(sights, timeline, offset_s)[0], pose)
    return replace(state, offset_s=offset_s, pose=pose, noise=noise)


def _without_unknown(
    sights: Sequence[Sight], timeline: Timeline, state: Synchronised, centroid_mocap: Array,
    config: CalibrationConfig, check: Callable[[float], None],
) -> Synchronised:  # fmt: skip
    """Set offsets to zero that the motion does not tell, and settle the rest again."""
    moved, velocities = shifted(sights, timeline, state.offset_s)
    normal = timed_equations(
        moved, velocities, state.pose, centroid_mocap, state.noise, state.column
    )
    sigma = offset_sigmas(normal)
    known = [c for c in sorted(set(state.column)) if sigma[c] <= config.time.max_sigma_s]
    if len(known) == len(sigma):
        return state
    column = tuple(known.index(c) if c in known else -1 for c in state.column)
    offset_s = np.where(np.array(column) >= 0, state.offset_s, 0.0)
    rest = replace(state, offset_s=offset_s, column=column)
    return _settle(sights, timeline, rest, centroid_mocap, check)


def _shares(sights: Sequence[Sight], timeline: Timeline, state: Synchronised) -> list[float]:
    """Share of each camera's correspondences that agree with the pose."""
    out = []
    for sight in shifted(sights, timeline, state.offset_s)[0]:
        near = seen = 0
        for x, uv in sight.chunks():
            res = residuals(sight.camera, sight.camera_T_world @ state.pose, x, uv)
            close = res.in_view & (res.squared < state.noise.threshold_px**2)
            near += int(np.count_nonzero(close))
            seen += int(np.count_nonzero(res.seen))
        out.append(near / max(seen, 1))
    return out
