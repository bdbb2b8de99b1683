# SPDX-License-Identifier: Apache-2.0
"""Sets the clocks of the cameras: offsets on all data, the skeletons of the true instants."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from rpgd_ros.core.covariance import offset_sigmas
from rpgd_ros.core.geometry import Array, RigidTransform
from rpgd_ros.core.linearise import Sight
from rpgd_ros.core.noise import Loss, noise_at
from rpgd_ros.core.offsets import TimedNormal, descend_in_time, shifted, timed_equations
from rpgd_ros.core.ransac import Start, robust_start
from rpgd_ros.core.synchronise import Synchronised, synchronise
from rpgd_ros.core.thin import MIDDLE_POINTS, budget, thin
from rpgd_ros.core.timeline import Timeline

if TYPE_CHECKING:
    from collections.abc import Callable

    from rpgd_ros.core.config import CalibrationConfig
    from rpgd_ros.core.observations import MocapTrack


@dataclass(frozen=True, slots=True, eq=False)
class Clocks:
    """What was found out about time; nothing where it was not asked for."""

    sights: tuple[Sight, ...] = ()
    timeline: Timeline | None = None
    state: Synchronised | None = None
    warnings: tuple[str, ...] = ()

    def equations(self, pose: RigidTransform, centroid: Array, loss: Loss) -> TimedNormal | None:
        """Sums by pose and offsets, for the covariance."""
        if self.timeline is None or self.state is None:
            return None
        moved, velocities = shifted(self.sights, self.timeline, self.state.offset_s)
        return timed_equations(moved, velocities, pose, centroid, loss, self.state.column)

    def offsets(self, timed: TimedNormal | None) -> dict[str, tuple[float, float]]:
        """Offset and sigma by camera, where estimated."""
        if timed is None or self.state is None:
            return {}
        sigma = offset_sigmas(timed)
        found = zip(self.sights, self.state.offset_s, self.state.column, strict=True)
        return {s.camera.name: (float(o), float(sigma[c])) for s, o, c in found if c >= 0}


def set_clocks(
    sights: list[Sight], track: MocapTrack | None, start: Start, centroid: Array,
    config: CalibrationConfig, rng: np.random.Generator, *, check: Callable[[float], None],
) -> tuple[Clocks, list[Sight], Start]:  # fmt: skip
    """Estimate the offsets and give each camera the skeletons of its true instants.

    Args:
        sights: Cameras with their data.
        track: The MoCap track, or None where no time is known.
        start: Outcome of the robust start without offsets.
        centroid: (3,) pivot, metres, MoCap frame.
        config: Settings.
        rng: Source of the draws.
        check: Called with the fraction done; raises to end the run.

    Returns:
        What was found, the cameras with their new skeletons, and the start from there.

    """
    if track is None or len(track.stamp_ns) < 2 or any(s.view.stamp_ns is None for s in sights):
        msg = 'no time is known (fps or stamps): the offset of the video was not estimated'
        return Clocks(warnings=(msg,)), sights, start
    middle = thin(sights, 0, budget(sights, MIDDLE_POINTS))
    pose, noise, _ = start.candidates[0]
    if config.refine.joint_noise and noise.is_sharp:
        noise = noise_at(middle, pose, with_joints=True)
    timeline = Timeline(track, is_noisy=noise.joint_sigma_m > 0.0)
    state = synchronise(middle, timeline, start, centroid, config, rng, check=check)
    refine = config.refine
    used = thin(sights, refine.frame_stride, budget(sights, refine.max_correspondences))
    pose, offset_s, _ = descend_in_time(
        used, timeline, state.pose, state.offset_s, centroid_mocap=centroid, loss=state.noise,
        column=state.column, max_steps=2, check=check,
    )  # fmt: skip
    state = replace(state, offset_s=offset_s, pose=pose)
    warnings = tuple(
        f'camera {s.camera.name}: the motion does not tell the offset of its clock; none applied'
        for s, column in zip(sights, state.column, strict=True)
        if column < 0
    )
    if noise.joint_sigma_m:
        timeline = Timeline(track)  # smoothing shrinks what swings: it was for the offsets only
    moved, _ = shifted(used, timeline, offset_s)
    best = start.candidates[0]._replace(world_T_mocap=pose, noise=state.noise)
    # Minima that were rivals while the skeletons were late need not be rivals now.
    again = robust_start(shifted(middle, timeline, offset_s)[0], config.ransac, rng, check=check)
    return (
        Clocks(tuple(used), timeline, state, warnings),
        moved,
        replace(start, candidates=(best,), rival_ratio=again.rival_ratio),
    )
