# SPDX-License-Identifier: Apache-2.0
"""RANSAC-P3P: a pose from three correspondences of one camera, many times over.

`published` is Algorithm 1 of the publication, step for step. `robust_start` is ours: triplets of
one camera from any instants (the MoCap frame does not move, so they are as valid as those of one
instant, and they span the room rather than one body), hypotheses ranked by all their residuals on
a small pool, the best of them polished there, until enough clean triplets must have been drawn.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np

from rpgd_ros.core.camera import MIN_DEPTH
from rpgd_ros.core.errors import CalibrationError, Reason
from rpgd_ros.core.geometry import (
    Array,
    BoolArray,
    IntArray,
    RigidTransform,
    nearest_rotation,
    rotation_angle,
    so3_exp,
)
from rpgd_ros.core.linearise import residuals
from rpgd_ros.core.polish import Candidate, polish
from rpgd_ros.core.pool import Pool, make_pool
from rpgd_ros.core.thin import drawn_evenly

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rpgd_ros.core.config import RansacConfig
    from rpgd_ros.core.linearise import Sight

POOL_POINTS = 2048  # over all cameras: a pose polished on them starts the next stage within 1 px
POOL_POINTS_PER_CAMERA = 128  # at least: a camera of a large rig must still show its own outliers
COARSE_POINTS = 256  # first ranking; of those ranked, KEPT go on to the whole pool
KEPT = 24
POLISHED = 4  # the best by score, different from each other
WITHIN = 2.0 * np.log(2.0)  # of the best score: others have twice its residuals, no rivals
BATCHES = 64, 128  # the first is enough for clean data
CLEAN_TRIPLETS = 8.0  # expected number of all-inlier triplets at the end: exp(-8) to have none
# By focal length, so that they mean an angle: residuals below the first rank alike (a pose made of
# three noisy points is no better than that), as do those beyond the last; between lies a guess
# which correspondences a hypothesis explains before anything is polished.
SOFT, EXPLAINED, CAP = 0.002, 0.015, 0.03
SAME_ANGLE = np.radians(2.0)  # two poses nearer than this, and SAME_DISTANCE, are one minimum
SAME_DISTANCE = 0.15  # metres, at the body's centroid


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """Outcome of the robust start.

    Attributes:
        candidates: Distinct minima, the best first.
        drawn: Number of triplets drawn.
        rival_ratio: Squared error of the second over that of the first, see `rival_ratio`.

    """

    candidates: tuple[Candidate, ...]
    drawn: int
    rival_ratio: float


class Ranked(NamedTuple):
    """Hypotheses by score, the best first: (H, 3, 3), (H, 3) metres, (H,)."""

    rotation: Array
    translation: Array
    score: Array


def robust_start(
    sights: Sequence[Sight], config: RansacConfig, rng: np.random.Generator,
    *, check: Callable[[float], None],
) -> Start:  # fmt: skip
    """Find the pose that explains most of the data, whatever the rest is.

    Args:
        sights: Cameras with their data.
        config: Stage settings.
        rng: Source of the draws.
        check: Called with the fraction done; raises to end the run.

    Raises:
        CalibrationError: No camera has three correspondences, or no triplet gives a pose.

    """
    pool = make_pool(sights, max(POOL_POINTS_PER_CAMERA, POOL_POINTS // len(sights)), rng)
    coarse = pool.take(drawn_evenly(len(pool), COARSE_POINTS, rng))
    kept = Ranked(np.empty((0, 3, 3)), np.empty((0, 3)), np.empty(0))
    candidates: list[Candidate] = []
    drawn, share, same_frame = 0, 0.0, config.sampling == 'same_frame'
    while drawn < config.iterations:
        check(drawn / config.iterations)
        count = min(BATCHES[drawn > 0], config.iterations - drawn)
        triplets = draw_triplets(pool, count, rng, same_frame=same_frame)
        drawn += len(triplets)
        kept = _merge(kept, rank(coarse, *solve_triplets(pool, triplets)))
        if not len(kept.score):
            continue
        share = max(share, _explained(pool, kept))
        if drawn * share**3 < CLEAN_TRIPLETS and drawn < config.iterations:
            continue
        candidates = _polish_best(pool, kept)
        share = candidates[0].noise.share if candidates[0].is_sharp else 0.0
        if drawn * share**3 >= CLEAN_TRIPLETS:
            break
    if not candidates:
        msg = f'none of {drawn} triplets gave a pose: are all points on one line, or one point?'
        raise CalibrationError(Reason.DEGENERATE_GEOMETRY, msg)
    return Start(tuple(candidates), drawn, rival_ratio(pool, candidates))


def published(
    sights: Sequence[Sight], config: RansacConfig, rng: np.random.Generator,
    *, check: Callable[[float], None],
) -> RigidTransform:  # fmt: skip
    """Algorithm 1: K triplets of one camera and instant; most inliers (eq. 3) over all of C wins.

    Args:
        sights: Cameras with their data, already downsampled in time.
        config: Stage settings; `threshold_px` is tau and must be given.
        rng: Source of the draws.
        check: Called with the fraction done; raises to end the run.

    Raises:
        CalibrationError: No instant has three correspondences, or no hypothesis has an inlier.

    """
    pool = make_pool(sights, sum(s.view.uv[..., 0].size for s in sights), rng)
    triplets = draw_triplets(pool, config.iterations, rng, same_frame=True)
    best, best_count = None, 0
    for k, triplet in enumerate(triplets):
        check(k / len(triplets))
        for r, t in zip(*solve_triplets(pool, triplet[None]), strict=True):
            pose = RigidTransform(r, t)
            count = count_inliers(sights, pose, config.threshold_px)
            if count > best_count:
                best, best_count = pose, count
    if best is None:
        msg = f'none of {len(triplets)} triplets gave a pose with an inlier'
        raise CalibrationError(Reason.TOO_FEW_INLIERS, msg)
    return best


def count_inliers(sights: Sequence[Sight], pose: RigidTransform, threshold_px: float) -> int:
    """Count correspondences with depth > 0 and a residual below the threshold (eq. 3)."""
    count = 0
    for sight in sights:
        for x, uv in sight.chunks():
            r = residuals(sight.camera, sight.camera_T_world @ pose, x, uv)
            count += int(np.count_nonzero(r.in_view & (r.squared < threshold_px**2)))
    return count


def draw_triplets(
    pool: Pool, count: int, rng: np.random.Generator, *, same_frame: bool
) -> IntArray:
    """Draw (count, 3) distinct points of one camera, and of one of its frames if asked.

    Cameras take turns, so that each is heard; of frames, any is drawn, as published.

    Raises:
        CalibrationError: No camera (and frame) has three points.

    """
    group = pool.camera
    if same_frame:
        group = group * (int(pool.frame.max(initial=0)) + 1) + pool.frame
    order = np.argsort(group, kind='stable')
    _, first, size = np.unique(group[order], return_index=True, return_counts=True)
    usable = np.flatnonzero(size >= 3)
    if not len(usable):
        where = 'camera and instant' if same_frame else 'camera'
        msg = f'no {where} has 3 correspondences: {len(pool)} in all. Is the person in view?'
        raise CalibrationError(Reason.TOO_FEW_POINTS, msg)
    chosen = usable[rng.integers(0, len(usable), count) if same_frame
                    else np.resize(rng.permutation(len(usable)), count)]  # fmt: skip
    n = size[chosen]
    # Three distinct numbers below n: each draw skips the ones before it.
    a, b, c = (rng.integers(0, n - k) for k in range(3))
    b += b >= a
    low, high = np.minimum(a, b), np.maximum(a, b)
    c += c >= low
    c += c >= high
    triplets: IntArray = order[first[chosen][:, None] + np.stack([a, b, c], 1)]
    return triplets


def solve_triplets(pool: Pool, triplets: IntArray) -> tuple[Array, Array]:
    """Solve P3P for each triplet and compose with the extrinsics.

    OpenCV's AP3P: its older P3P misses one true pose in fifteen. Poses that are not finite, or
    have one of the three points behind the camera, are left out.

    Returns:
        (H, 3, 3) world_R_mocap and (H, 3) translations, metres.

    """
    triplets = triplets[~_degenerate(pool.x_mocap[triplets])]
    rotvecs: list[Array] = []
    shifts: list[Array] = []
    counts: list[int] = []
    identity = np.eye(3)
    for x, ideal in zip(pool.x_mocap[triplets], pool.ideal[triplets], strict=True):
        _, rvecs, tvecs = cv2.solveP3P(x, ideal, identity, None, flags=cv2.SOLVEPNP_AP3P)
        rotvecs += (np.asarray(r, np.float64) for r in rvecs)
        shifts += (np.asarray(t, np.float64) for t in tvecs)
        counts.append(len(rvecs))
    if not rotvecs:
        return np.empty((0, 3, 3)), np.empty((0, 3))
    v, t = (np.concatenate(column, axis=1).T for column in (rotvecs, shifts))
    triplet = np.repeat(triplets, counts, axis=0)
    good = np.isfinite(v).all(-1) & np.isfinite(t).all(-1) & (np.abs(t).max(-1) < 1e6)
    r, t, triplet = so3_exp(v[good]), t[good], triplet[good]
    depth = (pool.x_mocap[triplet] @ r[:, 2, :, None])[:, :, 0] + t[:, 2:]
    good = (depth > MIN_DEPTH).all(-1)
    r, t, c = r[good], t[good], pool.camera[triplet[good, 0]]
    world_R_camera = np.swapaxes(pool.camera_R_world[c], 1, 2)
    return world_R_camera @ r, (world_R_camera @ (t - pool.camera_t_world[c])[..., None])[..., 0]


def rival_ratio(pool: Pool, candidates: Sequence[Candidate]) -> float:
    """Compare the two best minima where either explains the data.

    Returns:
        Squared error of the second over that of the first, each residual cut at three sigma of
        the first's noise; infinite without a second.

    """
    if len(candidates) < 2:
        return np.inf
    limit = candidates[0].noise.threshold_px ** 2
    rotations = np.stack([c.world_T_mocap.rotation for c in candidates[:2]])
    translations = np.stack([c.world_T_mocap.translation for c in candidates[:2]])
    squared = pool.squared_residuals(rotations, translations)
    explained = np.minimum(squared, limit)[:, (squared < limit).any(0)].sum(1)
    return float(explained[1] / max(explained[0], 1e-12))


def _degenerate(x: Array) -> BoolArray:
    """Whether three points (n, 3, 3) nearly lie on a line: P3P has a family of solutions then."""
    u, v = x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]
    area2 = (np.cross(u, v) ** 2).sum(-1)
    longest2 = np.maximum.reduce([(side**2).sum(-1) for side in (u, v, v - u)])
    out: BoolArray = area2 <= 1e-4 * longest2**2  # equal where all three are one point
    return out


def rank(pool: Pool, rotation: Array, translation: Array) -> Ranked:
    """Score hypotheses by their mean log residual between SOFT and CAP; lower is better."""
    squared = pool.squared_residuals(rotation, translation) / pool.focal_px**2
    score = np.log(np.minimum(squared, CAP**2) + SOFT**2).mean(1)
    order = np.argsort(score, kind='stable')
    return Ranked(rotation[order], translation[order], score[order])


def _merge(kept: Ranked, new: Ranked) -> Ranked:
    """Keep the best KEPT of both."""
    order = np.argsort(np.concatenate([kept.score, new.score]), kind='stable')[:KEPT]
    pairs = zip(kept, new, strict=True)
    return Ranked(*(np.concatenate(pair)[order] for pair in pairs))


def _explained(pool: Pool, kept: Ranked) -> float:
    """Share of the pool that the best hypothesis explains as it is."""
    squared = pool.squared_residuals(kept.rotation[:1], kept.translation[:1])
    return float((squared < (EXPLAINED * pool.focal_px) ** 2).mean())


def _polish_best(pool: Pool, kept: Ranked) -> list[Candidate]:
    """Polish the best hypotheses that are no neighbours; return distinct minima, best first."""
    ranked = rank(pool, kept.rotation, kept.translation)
    close = int((ranked.score < ranked.score[0] + WITHIN).sum())
    centroid = pool.centroid_mocap
    starts: list[RigidTransform] = []
    for r, t in zip(ranked.rotation[:close], ranked.translation[:close], strict=True):
        pose = RigidTransform(nearest_rotation(r), t)
        if len(starts) < POLISHED and not any(is_same(pose, s, centroid) for s in starts):
            starts.append(pose)
    minima: list[Candidate] = []
    for c in sorted(polish(pool, starts), key=lambda one: (not one.is_sharp, one.cost)):
        poses = [m.world_T_mocap for m in minima]
        if not any(is_same(c.world_T_mocap, pose, centroid) for pose in poses):
            minima.append(c)
    return minima


def is_same(a: RigidTransform, b: RigidTransform, centroid_mocap: Array) -> bool:
    """Whether two poses are one minimum."""
    apart = float(np.linalg.norm(a @ centroid_mocap - b @ centroid_mocap))
    return apart < SAME_DISTANCE and rotation_angle(a.rotation.T @ b.rotation) < SAME_ANGLE
