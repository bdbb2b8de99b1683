# SPDX-License-Identifier: Apache-2.0
"""Why a pose explains the data badly: swapped labels, mirrored axes, a second minimum."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from rpgd_ros.core.errors import CalibrationError, Reason
from rpgd_ros.core.linearise import Sight
from rpgd_ros.core.pool import make_pool
from rpgd_ros.core.ransac import draw_triplets, rank, robust_start, solve_triplets
from rpgd_ros.core.thin import at_seen_frames

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rpgd_ros.core.config import RansacConfig
    from rpgd_ros.core.geometry import Array, IntArray, RigidTransform
    from rpgd_ros.core.result import Calibration

GOOD_RATIO = 0.6  # share of inliers above which nothing needs explaining, unless
MOST_SWAPPED = 0.5  # of the joints are: a body without a midline is its own mirror, but for noise
MIN_COST_RATIO = 1.25  # squared error of the second minimum over the first, to tell them apart
SWAP_FRAMES = 20  # per camera
TINY_PX = 1e-6  # that places of one joint under two names may be apart
NEAR = 2.0  # times the distance to the nearest joint: a keypoint lies on each of these
LOST, FOUND = 0.15, 0.5  # a swapped joint agrees with itself less often, with its twin more often
MIN_SWAPPED_PAIRS = 2  # one pair alone may be a mistake in the joint map
LEFT_OUT = 0.5  # of the share of inliers in the best camera
GLANCE_POINTS, GLANCE_TRIPLETS = 256, 64  # where the mirrored one is right, most of them are good
MIRROR_GAIN = 4.0  # in squared error, of the mirrored skeleton over the given one
UNSURE = (Reason.UNCERTAIN, Reason.AMBIGUOUS)
MAY_BE_MIRRORED = (
    Reason.TOO_FEW_INLIERS,
    Reason.TOO_FEW_FRAMES,
    Reason.UNCERTAIN,
    Reason.AMBIGUOUS,
)
MIRRORED = (
    'the skeleton fits when one of its axes is mirrored: the MoCap frame is left-handed. '
    'Negate one axis, or swap two, in the MoCap software'
)


def refuse_ambiguous(ratio: float, calibration: Calibration | None = None) -> None:
    """Raise AMBIGUOUS where a second, different pose explains the data nearly as well.

    A flat body far away looks the same from two sides (the two solutions of a planar target).

    Args:
        ratio: `Start.rival_ratio`.
        calibration: The refused result, for a look at it.

    """
    if ratio < MIN_COST_RATIO:
        msg = (
            f'two different poses explain the data: the second has {ratio:.2f} times the squared '
            f'error of the best, need {MIN_COST_RATIO}. Walk further, turn, and come nearer'
        )
        raise CalibrationError(Reason.AMBIGUOUS, msg, calibration=calibration)


def unexplained(calibration: Calibration) -> str:
    """Say that the best pose is none: its residuals are as broad as those of any pose."""
    return (
        f'no pose explains the keypoints: the best leaves {calibration.median_px:.0f} px in the '
        'median. Check that cameras and MoCap see the same person and share a clock'
    )


def refuse_swapped(sights: Sequence[Sight], calibration: Calibration) -> None:
    """Raise SWAPPED_LABELS where joints lie on each other's projection in nearly every frame."""
    names = list(calibration.per_joint)
    pairs = swapped_joints(sights, calibration.world_T_mocap, calibration.threshold_px)
    if calibration.inlier_ratio > GOOD_RATIO and 2 * len(pairs) < MOST_SWAPPED * len(names):
        return
    if len(pairs) >= MIN_SWAPPED_PAIRS:
        listed = ', '.join(f'{names[a]} and {names[b]}' for a, b in pairs[:3])
        msg = (
            f'{len(pairs)} pairs of joints are labelled the other way round in nearly every frame '
            f'({listed}): left and right are swapped. Check the joint map and the joint order'
        )
        raise CalibrationError(Reason.SWAPPED_LABELS, msg, calibration=calibration)


def swapped_joints(
    sights: Sequence[Sight], pose: RigidTransform, threshold_px: float
) -> list[tuple[int, int]]:
    """Find pairs of joints whose keypoints lie on each other's projection instead of their own.

    Nearer than the threshold, and than to the others: where all labels are swapped, the breadth of
    the body is taken for noise, and the threshold is wider than the body.
    """
    n_joints = sights[0].view.n_joints
    hits, counts = np.zeros((2, n_joints, n_joints))
    for sight in sights:
        part = at_seen_frames(sight, SWAP_FRAMES)
        seen = part.view.seen()[..., None]
        x, uv = np.where(seen, part.view.x_mocap, np.nan), np.where(seen, part.view.uv, np.nan)
        projected = part.camera.project_camera((part.camera_T_world @ pose) @ x)
        # (F, keypoint, projection): who lies on whom.
        squared, across = (uv[:, :, None, k] - projected[:, None, :, k] for k in range(2))
        squared *= squared
        across *= across
        squared += across
        nearest = np.sqrt(np.fmin.reduce(squared, axis=2, keepdims=True))
        hits += (squared < np.minimum(threshold_px, NEAR * nearest + TINY_PX) ** 2).sum(0)
        counts += np.isfinite(squared).sum(0)
    ratio: Array = hits / np.maximum(counts, 1.0)
    own = np.diag(ratio)
    lost: IntArray = np.flatnonzero((own < LOST) & (np.diag(counts) > 0))
    pairs = []
    for a in lost:
        b = int(np.argmax(ratio[a]))
        is_mutual = b in lost and int(np.argmax(ratio[b])) == a
        if a < b and is_mutual and min(ratio[a, b], ratio[b, a]) > FOUND:
            pairs.append((int(a), b))
    return pairs


def looks_mirrored(sights: Sequence[Sight], calibration: Calibration, seed: int) -> bool:
    """Whether some cameras hardly agree with a pose that others fit, and a mirrored skeleton may.

    Two of four cameras may believe a mirrored walk; the others then seem to see somebody else.
    """
    shares = [fit.inliers / max(fit.correspondences, 1) for fit in calibration.per_camera.values()]
    if calibration.inlier_ratio > GOOD_RATIO or min(shares) > LEFT_OUT * max(shares):
        return False
    given, mirrored = (
        make_pool(side, GLANCE_POINTS, np.random.default_rng(seed))
        for side in (sights, _mirrored(sights))
    )
    rng = np.random.default_rng(seed)
    triplets = draw_triplets(mirrored, GLANCE_TRIPLETS, rng, same_frame=False)
    other = rank(mirrored, *solve_triplets(mirrored, triplets)).score
    pose = calibration.world_T_mocap
    own = rank(given, pose.rotation[None], pose.translation[None]).score
    return bool(len(other) and other[0] < own[0])


def is_mirrored(
    sights: Sequence[Sight], config: RansacConfig, *, check: Callable[[float], None]
) -> bool:
    """Whether a mirrored skeleton explains data far better that the given one explains badly."""
    given, other = (
        robust_start(side, config, np.random.default_rng(config.seed), check=check).candidates[0]
        for side in (sights, _mirrored(sights))
    )
    return other.is_sharp and given.cost - other.cost > np.log(MIRROR_GAIN)


def _mirrored(sights: Sequence[Sight]) -> list[Sight]:
    return [
        Sight(s.camera, replace(s.view, x_mocap=s.view.x_mocap * [-1.0, 1.0, 1.0])) for s in sights
    ]
