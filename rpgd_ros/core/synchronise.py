# SPDX-License-Identifier: Apache-2.0
"""The question of time: how late each video is stamped, and what of that can be known."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rpgd_ros.core.adjust import Problem, State, adjust, prior, solved_at
from rpgd_ros.core.covariance import larger
from rpgd_ros.core.geometry import Array
from rpgd_ros.core.linearise import Sight, residuals
from rpgd_ros.core.noise import NoiseModel
from rpgd_ros.core.ransac import Start, robust_start
from rpgd_ros.core.search import coarse_offset
from rpgd_ros.core.unknowns import Unknowns

if TYPE_CHECKING:
    from collections.abc import Callable

    from rpgd_ros.core.config import CalibrationConfig
    from rpgd_ros.core.timeline import Timeline
    from rpgd_ros.core.unknowns import Solution

WEAK_SHARE = 0.5  # a camera of which less agrees may be off by more than a descent can bridge
POOR_SHARE = 0.5  # of what agrees in the others: something else than time is wrong with a camera
POOR_SIGMA = 6.0  # of the others': a seventh of the keypoints alone would make it 2.7
STEPS = 12
# Two quartz clocks differ by 1e-5 to 1e-4. A rate is estimated where it is beyond doubt.
RATE_SIGMAS, LEAST_RATE = 8.0, 5e-5


class Settled(NamedTuple):
    """A state, what was estimated of it, and the spread of the residuals there."""

    state: State
    unknowns: Unknowns
    noise: NoiseModel


def synchronise(
    problem: Problem, timeline: Timeline, start: Start, config: CalibrationConfig,
    rng: np.random.Generator, *, check: Callable[[float], None],
) -> Settled:  # fmt: skip
    """Estimate the clocks of the videos, and the pose, on a part of the data.

    Args:
        problem: Cameras with their data; all have stamps.
        timeline: Its MoCap track.
        start: Outcome of the robust start without offsets.
        config: Settings.
        rng: Source of the draws.
        check: Called with the fraction done; raises to end the run.

    """
    n = len(problem.sights)
    is_common = config.time.estimate_offset == 'common'
    unknowns = Unknowns(tuple(0 if is_common else v for v in range(n)), (-1,) * n)
    at = settled(problem, _begin(problem, np.zeros(n), unknowns, start), check)
    weak = [v for v, share in enumerate(_shares(problem, at)) if share < WEAK_SHARE]
    if config.time.search_s > 0.0 and (weak or not at.noise.is_sharp):
        offset_s = at.state.offset_s.copy()
        for v in weak if at.noise.is_sharp else range(n):
            offset_s[v] = coarse_offset(
                problem.sights[v], timeline, span_s=config.time.search_s, rng=rng, check=check
            )
        if is_common:
            offset_s[:] = np.median(offset_s)
        moved = problem.scene(replace(at.state, offset_s=offset_s)).sights
        again = robust_start(moved, config.ransac, rng, check=check)
        searched = settled(problem, _begin(problem, offset_s, unknowns, again), check)
        at = min(at, searched, key=lambda s: (not s.noise.is_sharp, -s.noise.share))
    if not is_common and n > 2:
        at = _without_pretexts(problem, at, check)
    return _with_rates(problem, at, check) if config.time.estimate_rate else at


def _without_pretexts(problem: Problem, at: Settled, check: Callable[[float], None]) -> Settled:
    """Take back offsets with which a camera still fits far worse than the others.

    A camera that was moved fits nowhere in time, and some wrong offset fits a few of its keypoints
    better than the right one. These few know it far worse than the others know theirs. It gets
    that of the others, so that what is wrong with it can show.
    """
    share = np.array(_shares(problem, at))
    poor = [v for v, s in enumerate(share) if s < POOR_SHARE * np.median(np.delete(share, v))]
    if not poor or len(poor) > len(share) - 2:
        return at
    sigma = sigmas(solved_at(problem, at.state, at.unknowns, at.noise))[at.unknowns.offsets]
    poor = [v for v in poor if sigma[v] > POOR_SIGMA * np.median(np.delete(sigma, poor))]
    if not poor:
        return at
    kept = sorted(set(range(len(share))) - set(poor))
    offset_s = at.state.offset_s.copy()
    offset_s[poor] = np.median(offset_s[kept])
    column = [kept.index(v) if v in kept else -1 for v in range(len(share))]
    state = replace(at.state, offset_s=offset_s)
    unknowns = replace(at.unknowns, offset=tuple(column))
    return settled(problem, at._replace(state=state, unknowns=unknowns), check)


def _begin(problem: Problem, offset_s: Array, unknowns: Unknowns, start: Start) -> Settled:
    pose, noise, _ = start.candidates[0]
    state = State.begin(pose, len(offset_s), problem.sights[0].view.n_joints)
    return Settled(replace(state, offset_s=offset_s), unknowns, noise)


def settled(problem: Problem, at: Settled, check: Callable[[float], None]) -> Settled:
    """Descend, fit the noise again, descend."""
    state, noise = at.state, at.noise
    for _ in range(2):
        state, _ = adjust(problem, state, at.unknowns, noise, max_steps=STEPS, check=check)
        noise = problem.noise_at(state, with_joints=noise.joint_sigma_m > 0.0)
    return Settled(state, at.unknowns, noise)


def _with_rates(problem: Problem, at: Settled, check: Callable[[float], None]) -> Settled:
    """Estimate the rates, too, of the clocks that run wrong beyond doubt."""
    offset = at.unknowns.offset
    freed = replace(at.unknowns, rate=offset)
    solution = solved_at(problem, at.state, freed, at.noise)
    _, value = prior(freed, at.state)
    step, _ = solution.step(value)
    # Here by independent errors alone: a wrong rate is what makes joints and times scatter.
    wrong = _beyond(step[freed.rates], np.sqrt(np.diag(solution.inverse))[freed.rates])
    kept: list[int] | None = None
    while wrong and wrong != kept:
        kept = wrong
        rate = tuple(kept.index(c) if c in kept else -1 for c in offset)
        found = settled(problem, at._replace(unknowns=replace(at.unknowns, rate=rate)), check)
        solution = solved_at(problem, found.state, found.unknowns, found.noise)
        sigma = sigmas(solution)[found.unknowns.rates]
        rates = [found.state.rate[rate.index(n)] for n in range(len(kept))]
        wrong = [kept[k] for k in _beyond(np.array(rates), sigma)]
    return found if wrong else at


def _beyond(rate: Array, sigma: Array) -> list[int]:
    """Clocks whose rate is beyond doubt."""
    enough = np.maximum(RATE_SIGMAS * sigma, LEAST_RATE)
    return [int(k) for k in np.flatnonzero(np.abs(rate) > enough)]


def without_unknown(
    problem: Problem, at: Settled, max_sigma_s: float, check: Callable[[float], None]
) -> Settled:
    """Set offsets to zero that the motion does not tell, and settle the rest again.

    One that was taken from the other cameras stays.
    """
    unknowns = at.unknowns
    sigma = sigmas(solved_at(problem, at.state, unknowns, at.noise))[unknowns.offsets]
    known = np.flatnonzero(sigma <= max_sigma_s).tolist()
    if len(known) == len(sigma):
        return at
    is_known = np.array([c < 0 or c in known for c in unknowns.offset])
    rates = sorted({r for r, k in zip(unknowns.rate, is_known, strict=True) if k and r >= 0})
    rest = replace(
        unknowns,
        offset=tuple(known.index(c) if c in known else -1 for c in unknowns.offset),
        rate=tuple(rates.index(r) if r in rates else -1 for r in unknowns.rate),
    )
    state = replace(
        at.state,
        offset_s=np.where(is_known, at.state.offset_s, 0.0),
        rate=np.where(is_known, at.state.rate, 0.0),
    )
    return settled(problem, Settled(state, rest, at.noise), check)


def sigmas(solution: Solution) -> Array:
    """(p,) standard deviation of each unknown: what joints and times say of it, the larger."""
    whole = larger(solution.covariance, solution.covariance_over_time)
    out: Array = np.sqrt(np.diag(whole))
    return out


def _shares(problem: Problem, at: Settled) -> list[float]:
    """Share of each camera's correspondences that agree with the pose."""
    return [_share(s, at) for s in problem.scene(at.state).sights]


def _share(sight: Sight, at: Settled) -> float:
    near = seen = 0
    for x, uv in sight.chunks():
        res = residuals(sight.camera, sight.camera_T_world @ at.state.pose, x, uv)
        close = res.in_view & (res.squared < at.noise.threshold_px**2)
        near += int(np.count_nonzero(close))
        seen += int(np.count_nonzero(res.seen))
    return near / max(seen, 1)
