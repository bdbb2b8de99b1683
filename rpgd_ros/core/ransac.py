# SPDX-License-Identifier: Apache-2.0
"""RANSAC-P3P: a pose from three correspondences of one camera, many times over.

`published` is Algorithm 1 of the publication, step for step. `robust_start` is ours: triplets of
one camera from any instants (the MoCap frame does not move, so they are as valid as those of one
instant, and they span the room rather than one body), hypotheses ranked by all their residuals on
a small pool, the best of them polished there, until enough clean triplets must have been drawn.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from rpgd_ros.core.errors import CalibrationError, Reason
from rpgd_ros.core.geometry import Array, IntArray, RigidTransform, rotation_angle, so3_exp
from rpgd_ros.core.linearise import residuals
from rpgd_ros.core.polish import Candidate, polish
from rpgd_ros.core.pool import Pool, make_pool

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rpgd_ros.core.config import RansacConfig
    from rpgd_ros.core.linearise import Sight

POOL_POINTS = 2048  # over all cameras: a pose polished on them starts the next stage within 1 px
POOL_POINTS_PER_CAMERA = 128  # at least: a camera of a large rig must still show its own outliers
COARSE_POINTS = 256  # first ranking; of those ranked, KEPT go on to the whole pool
KEPT = 24
POLISHED = 4  # of each batch: the best by score, different from each other
WITHIN = 2.0 * np.log(4.0)  # of the best score: others have 4 x its residuals and need no polish
FIRST_BATCH = 64
CLEAN_TRIPLETS = 10.0  # expected number of all-inlier triplets at the end: exp(-10) to have none
UNEXPLAINED_SHARE = 0.2  # the least share of inliers that is accepted by default
SOFT_PX = 2.0  # residuals below it rank alike: a pose of three noisy points is no better than that
CAP_PX = 100.0  # residuals beyond it rank alike
SAME_ANGLE = np.radians(2.0)  # two poses nearer than this, and SAME_DISTANCE, are one minimum
SAME_DISTANCE = 0.15  # metres, at the body's centroid


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """Outcome of the robust start.

    Attributes:
        candidates: Distinct minima, the best first.
        drawn: Number of triplets drawn.

    """

    candidates: tuple[Candidate, ...]
    drawn: int


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
    coarse = pool.take(np.arange(0, len(pool), max(1, len(pool) // COARSE_POINTS)))
    found: list[Candidate] = []
    drawn, batch = 0, FIRST_BATCH
    while drawn < config.iterations:
        triplets = draw_triplets(pool, min(batch, config.iterations - drawn), rng,
                                 same_frame=config.sampling == 'same_frame')  # fmt: skip
        drawn, batch = drawn + len(triplets), drawn + len(triplets)
        rotation, translation = solve_triplets(pool, triplets)
        for index in _best_distinct(pool, coarse, rotation, translation):
            check(drawn / config.iterations)
            found.append(polish(pool, RigidTransform(rotation[index], translation[index])))
        found = _distinct(found, pool.centroid_mocap)
        if found:
            noise = found[0].noise
            share = noise.share if noise.is_sharp else min(noise.share, UNEXPLAINED_SHARE)
            if drawn * share**3 >= CLEAN_TRIPLETS:
                break
    if not found:
        msg = f'none of {drawn} triplets gave a pose: are all points on one line, or one point?'
        raise CalibrationError(Reason.DEGENERATE_GEOMETRY, msg)
    return Start(tuple(found), drawn)


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

    Cameras take turns, so that each is heard.

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
    return order[first[chosen][:, None] + np.stack([a, b, c], 1)]


def solve_triplets(pool: Pool, triplets: IntArray) -> tuple[Array, Array]:
    """Solve P3P for each triplet and compose with the extrinsics.

    OpenCV's AP3P: its older P3P misses one true pose in fifteen. Poses that are not finite, or
    have one of the three points behind the camera, are left out.

    Returns:
        (H, 3, 3) world_R_mocap and (H, 3) translations, metres.

    """
    rotvecs: list[Array] = []
    shifts: list[Array] = []
    camera: list[int] = []
    identity = np.eye(3)
    for triplet in triplets:
        x, ideal = pool.x_mocap[triplet], pool.ideal[triplet]
        if _is_degenerate(x):
            continue
        _, rvecs, tvecs = cv2.solveP3P(
            x[:, None], ideal[:, None], identity, None, flags=cv2.SOLVEPNP_AP3P
        )
        rotvecs += [np.asarray(r, np.float64).ravel() for r in rvecs]
        shifts += [np.asarray(t, np.float64).ravel() for t in tvecs]
        camera += [int(pool.camera[triplet[0]])] * len(rvecs)
    if not camera:
        return np.empty((0, 3, 3)), np.empty((0, 3))
    r, t, c = np.array(rotvecs), np.array(shifts), np.array(camera)
    good = np.isfinite(r).all(-1) & np.isfinite(t).all(-1) & (np.abs(t).max(-1) < 1e6)
    r, t, c = so3_exp(r[good]), t[good], c[good]
    world_R_camera = np.swapaxes(pool.camera_R_world[c], 1, 2)
    shifted = t - pool.camera_t_world[c]
    return world_R_camera @ r, (world_R_camera @ shifted[:, :, None])[:, :, 0]


def _is_degenerate(x: Array) -> bool:
    """Whether three points nearly lie on one line: their P3P has a family of solutions."""
    u, v = x[1] - x[0], x[2] - x[0]
    ux, uy, uz = u
    vx, vy, vz = v
    area2 = (uy * vz - uz * vy) ** 2 + (uz * vx - ux * vz) ** 2 + (ux * vy - uy * vx) ** 2
    longest2 = max(u @ u, v @ v, (v - u) @ (v - u))
    return bool(area2 < 1e-4 * longest2**2)


def _best_distinct(pool: Pool, coarse: Pool, rotation: Array, translation: Array) -> list[int]:
    """Return indices of the best hypotheses that are not near a better one."""
    if not len(rotation):
        return []
    first = _rank(coarse, rotation, translation)
    kept = np.argsort(first, kind='stable')[:KEPT]
    score = _rank(pool, rotation[kept], translation[kept])
    order = kept[np.argsort(score, kind='stable')][: int((score < score.min() + WITHIN).sum())]
    centre = pool.centroid_mocap
    chosen: list[int] = []
    for h in order:
        if len(chosen) == POLISHED:
            break
        here = rotation[h] @ centre + translation[h]
        if not any(
            np.linalg.norm(rotation[k] @ centre + translation[k] - here) < SAME_DISTANCE
            and rotation_angle(rotation[k].T @ rotation[h]) < SAME_ANGLE
            for k in chosen
        ):
            chosen.append(int(h))
    return chosen


def _rank(pool: Pool, rotation: Array, translation: Array) -> Array:
    """Score hypotheses, lower is better: (H,) mean log residual between SOFT_PX and CAP_PX."""
    squared = np.minimum(pool.squared_residuals(rotation, translation), CAP_PX**2)
    score: Array = np.log(squared + SOFT_PX**2).mean(1)
    return score


def _distinct(found: list[Candidate], centroid_mocap: Array) -> list[Candidate]:
    """Return the candidates by cost, without those that are the same minimum as a better one."""
    kept: list[Candidate] = []
    for c in sorted(found, key=lambda one: one.cost):
        for k in kept:
            apart = c.world_T_mocap @ centroid_mocap - k.world_T_mocap @ centroid_mocap
            turn = k.world_T_mocap.rotation.T @ c.world_T_mocap.rotation
            if np.linalg.norm(apart) < SAME_DISTANCE and rotation_angle(turn) < SAME_ANGLE:
                break
        else:
            kept.append(c)
    return kept
