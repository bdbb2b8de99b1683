# SPDX-License-Identifier: Apache-2.0
"""Whether the cameras agree: which one was moved since the rig was calibrated, which one is lost.

A camera alone would put the body elsewhere than all others together. Where that difference is more
than the joints' own disagreement allows, the camera was bumped, or its extrinsics are wrong.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rpgd_ros.core.covariance import invert, larger, spread_between
from rpgd_ros.core.errors import CalibrationError
from rpgd_ros.core.geometry import Array, RigidTransform
from rpgd_ros.core.noise_fit import noise_at
from rpgd_ros.core.normal import delta_between
from rpgd_ros.core.observations import NS_PER_S, real_ns
from rpgd_ros.core.polish import polish
from rpgd_ros.core.pool import make_pool
from rpgd_ros.core.refine import Descent, finish
from rpgd_ros.core.thin import thin

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from rpgd_ros.core.examine import Tally
    from rpgd_ros.core.linearise import Sight

# How a detector errs depends on how it sees the body. In less time the body hardly turns, and
# between good cameras of recorded rigs 0.2 to 1.9 deg and 30 to 90 mm were seen.
MIN_SECONDS = 5.5
FRAMES_PER_S = 60.0  # where no time is known
# A rig calibrated with a wand is no better than this; a smaller move matters to nobody.
LEAST_ROTATION_DEG, LEAST_SHIFT_M = 0.1, 0.005
MIN_JOINTS = 9  # fewer independent joints do not tell six numbers from chance
WEAK_MARGIN = 0.1  # share of inliers below the median that sends a camera to a solve of its own
ALONE_POINTS, ALONE_POOL = 16_384, 512  # of that solve
ALONE_SHARE = 0.3  # of its keypoints that must agree with its own pose
LOST_MARGIN = 0.15  # share of frames beyond the other cameras' that names a lost camera


@dataclass(frozen=True, slots=True)
class Disagreement:
    """A camera that contradicts the others.

    Attributes:
        camera: Its name.
        rotation_deg: How far it is turned against its extrinsics.
        shift_m: How far its centre is from where its extrinsics say.
        sigma_deg: Standard deviation of the rotation.
        sigma_m: Standard deviation of the shift.
        excess: How many times the test statistic exceeds what chance gives once in 10 000 runs.
        rival: The other camera where there are only two: it may as well be that one.
        since_s: When it was moved, where that happened during the recording: seconds after its
            first frame.

    """

    camera: str
    rotation_deg: float
    shift_m: float
    sigma_deg: float
    sigma_m: float
    excess: float
    rival: str | None = None
    since_s: float | None = None

    def sentence(self) -> str:
        """Say it to a person."""
        moved = (
            f'{self.rotation_deg:.2f} +- {self.sigma_deg:.2f} deg and '
            f'{1000 * self.shift_m:.0f} +- {1000 * self.sigma_m:.0f} mm'
        )
        if self.rival:
            return (
                f'cameras {self.camera} and {self.rival} contradict each other by {moved}: one of '
                'the two was moved. Calibrate the rig again'
            )
        when = f', since {self.since_s:.1f} s' if self.since_s is not None else ''
        return (
            f'camera {self.camera} contradicts the others by {moved}{when}: was it moved? '
            'Calibrate its extrinsics again'
        )


def disagreements(
    sights: Sequence[Sight], descent: Descent, centroid_mocap: Array
) -> list[Disagreement]:
    """Name the cameras that contradict the others, the worst first, each removed before the next.

    Args:
        sights: Cameras with their data.
        descent: The end of the refinement.
        centroid_mocap: (3,) pivot of its parameters, metres.

    """
    active = list(range(len(sights)))
    if len(active) < 2 or not lasts_long(sights):
        return []
    views = {v: _linear(descent, v) for v in active}
    for v in _weak(descent.examination.tally):
        alone = _alone(sights[v], descent.pose, centroid_mocap)
        if alone is not None:
            views[v] = alone
        else:
            active.remove(v)  # it fits nothing: lost, not moved
    pivot = descent.pose @ centroid_mocap
    found: list[Disagreement] = []
    while len(active) > 1:
        tested = _contradicting(sights, views, pivot, active)
        if not tested:
            break
        # All contradict the one that was moved; it is the one without which the rest agree.
        without = {k: [a for a in active if a != k] for k in tested}
        v = min(tested, key=lambda k: _unrest(sights, views, pivot, without[k]))
        found.append(tested[v])
        active = without[v]
    return found


class _Opinion(NamedTuple):
    """Where one camera would put the body, as a step from the common pose.

    Attributes:
        step: (6,) where its own optimum lies.
        hessian: (6, 6) of its cost.
        information: (6, 6) the positive part.
        per_joint: (J, 6) gradient per joint at its optimum, or at the common pose.
        per_time: (TIME_BLOCKS, 6) the same per stretch of time.

    """

    step: Array
    hessian: Array
    information: Array
    per_joint: Array
    per_time: Array


def _linear(descent: Descent, v: int) -> _Opinion:
    """Opinion of a camera near the common pose: one Newton step by its own part of the sums."""
    normal, seen = descent.normal, descent.examination
    hessian, information = normal.camera_hessian[v], normal.camera_information[v]
    per_joint = seen.camera_scores[v]
    step = -invert(hessian, information) @ per_joint.sum(0)
    return _Opinion(step, hessian, information, per_joint, seen.camera_time_scores[v])


def _weak(tally: Tally) -> list[int]:
    """Cameras with far fewer inliers than the others: their optimum may be out of reach."""
    share = tally.inliers.sum(1) / np.maximum(tally.correspondences.sum(1), 1)
    return [v for v in range(len(share)) if share[v] < np.median(share) - WEAK_MARGIN]


def _alone(sight: Sight, pose: RigidTransform, centroid_mocap: Array) -> _Opinion | None:
    """Opinion of a camera far from the common pose: its own solve; None where nothing fits."""
    few = thin([sight], ALONE_POINTS)
    try:
        pool = make_pool(few, ALONE_POOL, np.random.default_rng(0))
        if len(pool) < MIN_JOINTS:
            return None
        (near,) = polish(pool, [pose])
        noise = noise_at(few, near.world_T_mocap)
    except CalibrationError:
        return None
    if not noise.is_sharp or noise.share < ALONE_SHARE:
        return None
    end = finish(few, near.world_T_mocap, centroid_mocap, noise, max_steps=20,
                 threshold_px=noise.threshold_px, check=lambda _: None)  # fmt: skip
    step = delta_between(pose, end.pose, centroid_mocap)
    normal, seen = end.normal, end.examination
    return _Opinion(step, normal.hessian, normal.information, seen.camera_scores[0],
                    seen.camera_time_scores[0])  # fmt: skip


def lost_cameras(names: Sequence[str], tally: Tally) -> list[tuple[str, float]]:
    """Name the cameras that follow something else in far more frames than the others do.

    Returns:
        Name and share of its frames.

    """
    share = tally.lost_frames / np.maximum(tally.seen_frames, 1)
    found = []
    for v, name in enumerate(names):
        others = np.delete(share, v)
        usual = float(np.median(others)) if len(others) else 0.0
        if tally.seen_frames[v] and share[v] > usual + LOST_MARGIN:
            found.append((name, float(share[v])))
    return found


def lasts_long(sights: Sequence[Sight]) -> bool:
    """Whether the stretches of time are long enough to be independent looks at the body."""
    spans = [
        s.view.n_frames / FRAMES_PER_S
        if s.view.stamp_ns is None
        else float(np.ptp(real_ns(s.view.stamp_ns, int(s.view.stamp_ns[0])))) / NS_PER_S
        for s in sights
        if s.view.n_frames
    ]
    return max(spans, default=0.0) >= MIN_SECONDS


def _contradicting(
    sights: Sequence[Sight], views: Mapping[int, _Opinion], pivot: Array, active: Sequence[int]
) -> dict[int, Disagreement]:
    """Test each active camera against the others; those that fail, by number."""
    tested = {v: _compare(sights, views, pivot, v, active, least=1.0) for v in active}
    return {v: t for v, t in tested.items() if t and t.excess >= 1.0 and _matters(t)}


def _unrest(
    sights: Sequence[Sight], views: Mapping[int, _Opinion], pivot: Array, active: Sequence[int]
) -> float:
    """How much the active cameras contradict each other: the largest excess."""
    if len(active) < 2:
        return 0.0
    tested = (_compare(sights, views, pivot, v, active) for v in active)
    return max((t.excess for t in tested if t), default=0.0)


def _matters(d: Disagreement) -> bool:
    return d.rotation_deg > LEAST_ROTATION_DEG or d.shift_m > LEAST_SHIFT_M


def _compare(
    sights: Sequence[Sight], views: Mapping[int, _Opinion], pivot: Array, v: int,
    active: Sequence[int], *, least: float = 0.0,
) -> Disagreement | None:  # fmt: skip
    """Test one camera against the other active ones.

    None where the joints cannot tell, or where the excess is below `least` for sure.
    """
    mine, others = views[v], [views[k] for k in active if k != v]
    theirs = np.stack([o.per_joint for o in others])
    used = np.any(mine.per_joint != 0.0, axis=1) & np.any(theirs != 0.0, axis=(0, 2))
    n_joints = int(used.sum())
    if n_joints < MIN_JOINTS:
        return None
    own = invert(mine.hessian, mine.information)
    hessians = np.stack([o.hessian for o in others])
    rest = invert(hessians.sum(0), np.stack([o.information for o in others]).sum(0))
    agreed = rest @ np.einsum('kij,kj->i', hessians, np.stack([o.step for o in others]))
    difference = mine.step - agreed
    free = n_joints - 6
    scale = free / (n_joints - 1) / 6.0 / chance(free)
    if difference @ np.linalg.solve(own + rest, difference) * scale < least:
        return None  # what differs between joints and times only adds to this covariance
    # Per joint, where this camera alone would put the body, less where the others would.
    apart = theirs[:, used].sum(0) @ rest - mine.per_joint[used] @ own
    later = np.stack([o.per_time for o in others]).sum(0) @ rest - mine.per_time @ own
    covariance = larger(larger(own + rest, spread_between(apart)), spread_between(later))
    excess = difference @ np.linalg.solve(covariance, difference) * scale
    x, y, z = sights[v].camera_T_world.inverse().translation - pivot
    to_centre = np.hstack([[[0, z, -y], [-z, 0, x], [y, -x, 0]], np.eye(3)])
    rival = next(k for k in active if k != v) if len(active) == 2 else None
    return Disagreement(
        camera=sights[v].camera.name,
        rotation_deg=float(np.degrees(np.linalg.norm(difference[:3]))),
        shift_m=float(np.linalg.norm(to_centre @ difference)),
        sigma_deg=float(np.degrees(np.sqrt(np.trace(covariance[:3, :3])))),
        sigma_m=float(np.sqrt(np.trace(to_centre @ covariance @ to_centre.T))),
        excess=float(excess),
        rival=None if rival is None else sights[rival].camera.name,
    )


def chance(free: int) -> float:
    """Value that F(6, free) exceeds once in 10 000 times; from 3 on within -1.3 and +6 %."""
    return 4.64 * math.exp((12.0 + 10.0 / (free + 0.5)) / free)
