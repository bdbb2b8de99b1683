# SPDX-License-Identifier: Apache-2.0
"""Settles everything beside the pose: clocks, and where the detector sees each joint."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from rpgd_ros.core.adjust import (
    JOINT_SIGMA_M,
    Problem,
    State,
    adjust,
    joint_sigma,
    look,
)
from rpgd_ros.core.body_frame import body_frames
from rpgd_ros.core.geometry import Array
from rpgd_ros.core.linearise import Sight
from rpgd_ros.core.noise import NoiseModel, noise_at
from rpgd_ros.core.observations import is_there
from rpgd_ros.core.ransac import Start, robust_start
from rpgd_ros.core.synchronise import STEPS, Settled, settled, synchronise, without_unknown
from rpgd_ros.core.thin import MIDDLE_POINTS, budget, spread, thin
from rpgd_ros.core.timeline import Timeline
from rpgd_ros.core.unknowns import Unknowns

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rpgd_ros.core.config import CalibrationConfig
    from rpgd_ros.core.observations import MocapTrack

FRAME_POINTS = 8192  # that the frames of the body are compared on
TRACK_FRAMES = 600  # that they are fitted to
NO_TIME = 'no time is known (fps or stamps): the offset of the video was not estimated'


@dataclass(frozen=True, slots=True, eq=False)
class Details:
    """What was settled beside the pose.

    Attributes:
        problem: All data that is used.
        at: State, unknowns and noise.
        rival_ratio: `Start.rival_ratio` of the settled skeletons.
        warnings: Sentences for people.

    """

    problem: Problem
    at: Settled
    rival_ratio: float
    warnings: tuple[str, ...]

    @property
    def sights(self) -> Sequence[Sight]:
        """Cameras with the skeletons of their true instants, joints where they are seen."""
        return self.problem.scene(self.at.state).sights


def settle(
    sights: list[Sight], track: MocapTrack | None, start: Start, centroid: Array,
    config: CalibrationConfig, rng: np.random.Generator, *, check: Callable[[float], None],
) -> Details:  # fmt: skip
    """Estimate clocks, joint offsets and pose together, as configured.

    Args:
        sights: Cameras with their data.
        track: The MoCap track, or None where no time is known.
        start: Outcome of the robust start.
        centroid: (3,) pivot, metres, MoCap frame.
        config: Settings.
        rng: Source of the draws.
        check: Called with the fraction done; raises to end the run.

    """
    middle = thin(sights, 0, budget(sights, MIDDLE_POINTS))
    pose, noise, _ = start.candidates[0]
    if config.refine.joint_noise and noise.is_sharp:
        noise = noise_at(middle, pose, with_joints=True)
    timeline, warnings = None, []
    if config.time.estimate_offset != 'off':
        if (
            track is None
            or len(track.stamp_ns) < 2
            or any(s.view.stamp_ns is None for s in sights)
        ):
            warnings.append(NO_TIME)
        else:
            timeline = Timeline(track, is_noisy=noise.joint_sigma_m > 0.0)
    problem = Problem(middle, timeline, None, centroid)
    if timeline is not None:
        at = synchronise(problem, timeline, start, config, rng, check=check)
    else:
        at = settled(problem, _held(problem, start, noise), check)
    if config.refine.joint_noise and at.noise.is_sharp and not at.noise.joint_sigma_m:
        at = at._replace(
            noise=noise_at(problem.scene(at.state).sights, at.state.pose, with_joints=True)
        )
    if config.refine.joint_offsets:
        problem, at = _with_joints(problem, at, _skeletons(sights, track), check)
    if timeline is not None:
        at = without_unknown(problem, at, config.time.max_sigma_s, check)
        warnings += [
            f'camera {s.camera.name}: the motion does not tell the offset of its clock; none '
            'applied'
            for s, column in zip(sights, at.unknowns.offset, strict=True)
            if column < 0
        ]
    # Minima that were rivals while the skeletons were late need not be rivals now.
    again = robust_start(problem.scene(at.state).sights, config.ransac, rng, check=check)
    refine = config.refine
    used = thin(sights, refine.frame_stride, budget(sights, refine.max_correspondences))
    whole = replace(problem, sights=used)
    return _finished(whole, at, track, again.rival_ratio, warnings, check)


def _held(problem: Problem, start: Start, noise: NoiseModel) -> Settled:
    """Begin where nothing is asked of time."""
    n, n_joints = len(problem.sights), problem.sights[0].view.n_joints
    state = State.begin(start.candidates[0].world_T_mocap, n, n_joints)
    return Settled(state, Unknowns((-1,) * n, (-1,) * n), noise)


def _skeletons(sights: Sequence[Sight], track: MocapTrack | None) -> Array:
    """(F, J, 3) skeletons that the frame of the body is found from."""
    x = max((s.view.x_mocap for s in sights), key=len) if track is None else track.x_mocap
    x = x[spread(len(x), TRACK_FRAMES)]
    return np.where(is_there(x)[..., None], x, np.nan)


def _with_joints(
    problem: Problem, at: Settled, x: Array, check: Callable[[float], None]
) -> tuple[Problem, Settled]:
    """Estimate where the detector sees each joint, in the frame that explains most."""
    n_joints = problem.sights[0].view.n_joints
    freed = at._replace(
        state=replace(at.state, joint_sigma_m=JOINT_SIGMA_M),
        unknowns=replace(at.unknowns, n_joints=n_joints),
    )
    few = thin(problem.sights, 0, budget(problem.sights, FRAME_POINTS))
    best, most = None, 0.0
    for body in body_frames(x):
        of_body = replace(problem, sights=few, body=body)
        system = look(of_body, freed.state, freed.unknowns, freed.noise)
        sigma, gain = joint_sigma(system, freed.state)
        if sigma and gain > most:
            best, most = body, gain
    if best is None:
        return problem, at
    problem = replace(problem, body=best)
    return problem, _joints_settled(problem, at, freed, check)


def _joints_settled(
    problem: Problem, at: Settled, freed: Settled, check: Callable[[float], None]
) -> Settled:
    """Descend with the spread of the joints' offsets that the data make likeliest."""
    for _ in range(2):
        freed = settled(problem, freed, check)
        system = look(problem, freed.state, freed.unknowns, freed.noise)
        sigma, _ = joint_sigma(system, freed.state)
        if not sigma:
            return at
        freed = freed._replace(state=replace(freed.state, joint_sigma_m=sigma))
    return freed


def _finished(
    problem: Problem, at: Settled, track: MocapTrack | None, rival_ratio: float,
    warnings: Sequence[str], check: Callable[[float], None],
) -> Details:  # fmt: skip
    """Descend once more, on all data."""
    state, _ = adjust(problem, at.state, at.unknowns, at.noise, max_steps=2, check=check)
    if at.noise.joint_sigma_m and problem.timeline is not None and track is not None:
        # Smoothing shrinks what swings: it was for the clocks only.
        problem = replace(problem, timeline=Timeline(track))
        n = len(problem.sights)
        held = replace(at.unknowns, offset=(-1,) * n, rate=(-1,) * n)
        state, _ = adjust(problem, state, held, at.noise, max_steps=STEPS, check=check)
    return Details(problem, at._replace(state=state), rival_ratio, tuple(warnings))
