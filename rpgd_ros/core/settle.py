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
from rpgd_ros.core.agreement import lasts_long
from rpgd_ros.core.answer import Answer
from rpgd_ros.core.body_frame import body_frames
from rpgd_ros.core.geometry import Array
from rpgd_ros.core.linearise import Sight
from rpgd_ros.core.noise_fit import noise_at
from rpgd_ros.core.observations import is_there
from rpgd_ros.core.questions import Lenses, Questions
from rpgd_ros.core.ransac import Start, robust_start
from rpgd_ros.core.synchronise import Settled, settled, synchronise, without_unknown
from rpgd_ros.core.thin import MIDDLE_POINTS, spread, thin
from rpgd_ros.core.timeline import Timeline, track_noise_m
from rpgd_ros.core.unknowns import Unknowns

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rpgd_ros.core.config import CalibrationConfig, RefineConfig
    from rpgd_ros.core.observations import MocapTrack

FRAME_POINTS = 8192  # that the frames of the body are compared on
CORRECTION_STEPS = 6
NOISY_M = 0.003  # of the joints: depth cameras and inertial suits; markers are at 0.1 to 1 mm
GAIN_PER_NUMBER = 6.0  # log likelihood that each more number must bring (BIC of 1e5 points)
# No detector means so different a joint. Several of them are swapped sides, which a rotation of
# the body would hide: hips are 20 cm apart.
LARGEST_OFFSET_M = 0.15
TRACK_FRAMES = 600  # that they are fitted to
NO_TIME = 'no time is known (fps or stamps): the offset of the video was not estimated'


@dataclass(frozen=True, slots=True, eq=False)
class Details:
    """What was settled beside the pose.

    Attributes:
        problem: All data that is used.
        at: State, what was moved last, and noise.
        unknowns: All that is not known.
        lenses: Answers of the film to the questions for each lens.
        size: The same for the skeleton's size; None where it cannot be asked.
        explained: The state with the one of both corrected that is wrong, where one is: cameras
            that still contradict each other there were moved.
        rival_ratio: `Start.rival_ratio` of the settled skeletons.
        warnings: Sentences for people.

    """

    problem: Problem
    at: Settled
    unknowns: Unknowns
    lenses: Lenses
    size: Answer | None
    explained: Settled | None
    rival_ratio: float
    warnings: tuple[str, ...]

    @property
    def sights(self) -> Sequence[Sight]:
        """Cameras with the skeletons of their true instants, joints where they are seen."""
        return self.problem.scene(self.at.state).sights

    def of_other(self, sight: Sight) -> Sight:
        """Return another camera with skeletons as these cameras would see them.

        Its clock is taken to run as theirs do.
        """
        state = self.at.state
        one = replace(
            state, offset_s=np.array([np.median(state.offset_s)]),
            rate=np.array([np.median(state.rate)]), focal=np.zeros(1),
        )  # fmt: skip
        return replace(self.problem, sights=[sight]).scene(one).sights[0]


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
    problem, at, warnings = _clocks(sights, track, start, centroid, config, rng, check)
    clocks = at.unknowns
    if problem.timeline is not None and problem.are_joints_noisy and track is not None:
        # Smoothing shrinks what swings, and the noise: it was for the clocks only.
        problem = replace(problem, timeline=Timeline(track))
        n = len(sights)
        held = replace(clocks, offset=(-1,) * n, rate=(-1,) * n)
        at = settled(problem, at._replace(unknowns=held), check)
    if config.refine.joint_offsets and lasts_long(sights):
        # In less time a body hardly turns: then an offset of all joints looks like another pose.
        problem, at = _with_joints(problem, at, some_skeletons(sights, track), check)
    # Minima that were rivals while the skeletons were late need not be rivals now.
    again = robust_start(problem.scene(at.state).sights, config.ransac, rng, check=check)
    refine = config.refine
    used = thin(sights, refine.max_correspondences, stride=refine.frame_stride)
    problem = replace(problem, sights=used)
    state, _ = adjust(problem, at.state, at.unknowns, at.noise, max_steps=2, check=check)
    at = at._replace(state=state)
    questions = Questions.of_settled(problem, at)
    lenses, size = questions.lenses(is_common=False), questions.size()
    explained = _explained(problem, at, lenses.focal, size, refine, check)
    if explained is not None and is_corrected(explained, refine):
        at = explained
    unknowns = replace(at.unknowns, offset=clocks.offset, rate=clocks.rate)
    return Details(problem, at, unknowns, lenses, size, explained, again.rival_ratio, warnings)


def _clocks(
    sights: list[Sight], track: MocapTrack | None, start: Start, centroid: Array,
    config: CalibrationConfig, rng: np.random.Generator, check: Callable[[float], None],
) -> tuple[Problem, Settled, tuple[str, ...]]:  # fmt: skip
    """Settle pose and clocks on a part of the data; say which clock cannot be known."""
    middle = thin(sights, MIDDLE_POINTS)
    pose, noise, _ = start.candidates[0]
    are_noisy = track is not None and track_noise_m(track) > NOISY_M
    problem = Problem(middle, None, None, centroid, config.refine.joint_noise and are_noisy)
    n = len(sights)
    begin = State.begin(pose, n, sights[0].view.n_joints)
    if config.time.estimate_offset == 'off' or track is None or not _has_time(sights, track):
        with_joints = config.refine.joint_noise and noise.is_sharp
        noise = problem.noise_at(begin, with_joints=with_joints)
        at = settled(problem, Settled(begin, Unknowns((-1,) * n, (-1,) * n), noise), check)
        return problem, at, () if config.time.estimate_offset == 'off' else (NO_TIME,)
    timeline = Timeline(track, is_noisy=are_noisy)
    problem = replace(problem, timeline=timeline, middle_s=_middle_s(sights, timeline))
    at = synchronise(problem, timeline, start, config, rng, check=check)
    if config.refine.joint_noise and at.noise.is_sharp:
        at = at._replace(noise=problem.noise_at(at.state, with_joints=True))
    at = without_unknown(problem, at, config.time.max_sigma_s, check)
    warnings = tuple(
        f'camera {s.camera.name}: the motion does not tell the offset of its clock; '
        + (f'{1000.0 * offset_s:.1f} ms applied, as of the others' if offset_s else 'none applied')
        for s, column, offset_s in zip(sights, at.unknowns.offset, at.state.offset_s, strict=True)
        if column < 0
    )
    return problem, at, warnings


def _middle_s(sights: Sequence[Sight], timeline: Timeline) -> float:
    """Of the whole recording, in the seconds of its track."""
    ends = [timeline.seconds(s.view.known_stamp_ns[[0, -1]]) for s in sights]
    return 0.5 * float(np.min(ends) + np.max(ends))


def _has_time(sights: Sequence[Sight], track: MocapTrack) -> bool:
    return len(track.stamp_ns) >= 2 and all(s.view.stamp_ns is not None for s in sights)


def some_skeletons(sights: Sequence[Sight], track: MocapTrack | None) -> Array:
    """(F, J, 3) skeletons that the frame of the body is found from; NaN = missing."""
    x = max((s.view.x_mocap for s in sights), key=len) if track is None else track.x_mocap
    x = x[is_there(x).any(1)]
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
    few = thin(problem.sights, FRAME_POINTS)
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
    freed = _joints_settled(problem, at, freed, check)
    reach = np.linalg.norm(freed.state.joint_offset, axis=1)
    if np.count_nonzero(reach > LARGEST_OFFSET_M) > 1:
        return replace(problem, body=None), at
    return problem, freed


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


def _explained(
    problem: Problem, at: Settled, focal: Answer, size: Answer | None, refine: RefineConfig,
    check: Callable[[float], None],
) -> Settled | None:  # fmt: skip
    """Descend with what is wrong set free, or with what was asked for; None for neither."""
    is_long = lasts_long(problem.sights)
    is_size_wrong = size is not None and bool(size.wrong) and is_long
    if is_size_wrong and focal.wrong and size is not None:
        # One number that explains as much as many is the better explanation.
        is_size_wrong = size.gain > focal.gain - GAIN_PER_NUMBER * (len(focal.error) - 1)
    with_scale = size is not None and (refine.size == 'estimate' or is_size_wrong)
    with_focal = refine.focal == 'estimate' or (bool(focal.wrong) and not is_size_wrong)
    if not with_scale and not with_focal:
        return None
    numbers = tuple(range(len(problem.sights))) if with_focal else ()
    freed = replace(at.unknowns, focal=numbers, with_scale=with_scale)
    state, _ = adjust(problem, at.state, freed, at.noise, max_steps=CORRECTION_STEPS, check=check)
    middle = replace(problem, sights=thin(problem.sights, MIDDLE_POINTS))
    with_joints = at.noise.joint_sigma_m > 0.0
    noise = noise_at(middle.scene(state).sights, state.pose, with_joints=with_joints)
    return Settled(state, freed, noise)


def is_corrected(explained: Settled, refine: RefineConfig) -> bool:
    """Whether everything that was set free was asked to be estimated."""
    unknowns = explained.unknowns
    return (not unknowns.focal or refine.focal == 'estimate') and (
        not unknowns.with_scale or refine.size == 'estimate'
    )
