# SPDX-License-Identifier: Apache-2.0
"""A pose from detections of several persons, before it is known who is who.

Every skeleton of an instant beside every detection of that instant is a candidate pair, and of n
persons in view one pair in n is right. Triplets are drawn within a pair: all three are right as
often as the pair is, where triplets from all over would need three right pairs at once. A
hypothesis is ranked by how well the best pair of each instant agrees with it, and the best ones
are polished and choose their pairs in turn.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rpgd_ros.core.geometry import Array, IntArray, RigidTransform, nearest_rotation
from rpgd_ros.core.polish import Candidate, polish
from rpgd_ros.core.pool import Pool
from rpgd_ros.core.ransac import KEPT, Ranked, draw_triplets, is_same, solve_triplets
from rpgd_ros.core.thin import spread

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rpgd_ros.core.camera import Camera
    from rpgd_ros.core.candidates import CrowdView

MIN_JOINTS = 4  # of a pair: three fit any pose
INSTANTS = 256  # looked at, over all cameras
INSTANTS_PER_CAMERA = 12, 96  # at least and at most
POINTS = 20_000  # of all pairs together: 20 persons in view leave fewer instants
BATCH = 128  # triplets
# By focal length, see `ransac`: a pose made of one body errs more at the other end of the room.
SOFT, CAP = 0.004, 0.06
FINE = 0.002, 0.03  # the same, once polished
POLISHED = 4  # of the best, at each look: after FIRST_LOOK triplets, and twice as many each time
FIRST_LOOK = 256
ROUNDS = 5  # of choosing and polishing
CLEAN_TRIPLETS = 12.0  # expected number of triplets without a gross point, at the end


class Sample(NamedTuple):
    """The candidate pairs of some instants.

    Attributes:
        pool: Points of all pairs; its `frame` is the number of the pair.
        first_point: (N,) first point of each pair.
        first_pair: (R,) first pair of each skeleton at each instant.
        pair_of: (n,) pair of each point.

    """

    pool: Pool
    first_point: IntArray
    first_pair: IntArray
    pair_of: IntArray

    def gains(self, rotation: Array, translation: Array, soft: float, cap: float) -> Array:
        """How well each pair agrees with each hypothesis, (H, N): summed logarithms."""
        squared = self.pool.squared_residuals(rotation, translation) / self.pool.focal_px**2
        gain = np.log((cap**2 + soft**2) / (np.minimum(squared, cap**2) + soft**2))
        summed: Array = np.add.reduceat(gain, self.first_point, axis=1)
        return summed

    def scores(self, rotation: Array, translation: Array, soft: float, cap: float) -> Array:
        """Mean over instants of the best pair's gain, (H,); higher is better."""
        gain = self.gains(rotation, translation, soft, cap)
        best: Array = np.maximum.reduceat(gain, self.first_pair, axis=1).mean(1)
        return best

    def chosen(self, pose: RigidTransform, soft: float, cap: float) -> IntArray:
        """Points of the best pair of each skeleton at each instant."""
        gain = self.gains(pose.rotation[None], pose.translation[None], soft, cap)[0]
        best = np.repeat(
            np.maximum.reduceat(gain, self.first_pair),
            np.diff(self.first_pair, append=len(gain)),
        )
        return np.flatnonzero((gain == best)[self.pair_of])


class Found(NamedTuple):
    """A pose that explains one pair in each of most instants.

    Attributes:
        candidate: Pose and spread of the residuals of the pairs chosen.
        score: How well it does, see `Sample.scores`.
        clean_share: Share of triplets within a pair that had to be without gross points, should
            this be the truth; 0 where the residuals are no noise.

    """

    candidate: Candidate
    score: float
    clean_share: float


def find_pose(
    sample: Sample, rng: np.random.Generator, *, iterations: int,
    check: Callable[[float], None],
) -> list[Found]:  # fmt: skip
    """Find the pose that explains one pair of most instants.

    Args:
        sample: Candidate pairs.
        rng: Source of the draws.
        iterations: Most triplets drawn.
        check: Called with the fraction done; raises to end the run.

    Returns:
        Distinct minima, the best first; none where no triplet gives a pose.

    Raises:
        CalibrationError: No pair has three points.

    """
    found: list[Found] = []
    kept = Ranked(np.empty((0, 3, 3)), np.empty((0, 3)), np.empty(0))
    drawn, look = 0, FIRST_LOOK
    while drawn < iterations:
        check(drawn / iterations)
        count = min(BATCH, iterations - drawn)
        triplets = draw_triplets(sample.pool, count, rng, same_frame=True)
        drawn += count
        kept = _best(sample, kept, *solve_triplets(sample.pool, triplets))
        if not len(kept.score) or drawn < min(look, iterations):
            continue
        found = _distinct(sample, found + _polished(sample, kept))
        if drawn * found[0].clean_share >= CLEAN_TRIPLETS:
            break
        look = 2 * drawn
    return found


def _best(sample: Sample, kept: Ranked, rotation: Array, translation: Array) -> Ranked:
    """Rank new hypotheses, and keep the best KEPT of all."""
    score = sample.scores(rotation, translation, SOFT, CAP)
    together = zip(kept, (rotation, translation, score), strict=True)
    r, t, s = (np.concatenate(pair) for pair in together)
    order = np.argsort(-s, kind='stable')[:KEPT]
    return Ranked(r[order], t[order], s[order])


def _polished(sample: Sample, kept: Ranked) -> list[Found]:
    """Let the best hypotheses that are no neighbours choose their pairs and be polished."""
    centroid = sample.pool.centroid_mocap
    starts: list[RigidTransform] = []
    for r, t in zip(kept.rotation, kept.translation, strict=True):
        pose = RigidTransform(nearest_rotation(r), t)
        if not any(is_same(pose, other, centroid) for other in starts):
            starts.append(pose)
        if len(starts) == POLISHED:
            break
    return [_settled(sample, pose) for pose in starts]


def _settled(sample: Sample, pose: RigidTransform) -> Found:
    """Choose pairs and polish, turn by turn, until the choice stays."""
    points = sample.chosen(pose, SOFT, CAP)
    for _ in range(ROUNDS):
        (candidate,) = polish(sample.pool.take(points), [pose])
        pose = candidate.world_T_mocap
        before = points
        points = sample.chosen(pose, *FINE)
        if np.array_equal(points, before):
            break
    score = sample.scores(pose.rotation[None], pose.translation[None], *FINE)
    share = candidate.noise.share if candidate.is_sharp else 0.0
    return Found(candidate, float(score[0]), share**3 * len(points) / len(sample.pool))


def _distinct(sample: Sample, found: list[Found]) -> list[Found]:
    """Keep one of each minimum, the best first."""
    centroid = sample.pool.centroid_mocap
    kept: list[Found] = []
    for one in sorted(found, key=lambda f: -f.score):
        poses = [f.candidate.world_T_mocap for f in kept]
        if not any(is_same(one.candidate.world_T_mocap, pose, centroid) for pose in poses):
            kept.append(one)
    return kept[:POLISHED]


def draw_sample(cameras: Sequence[Camera], views: Sequence[CrowdView]) -> Sample | None:
    """Take the candidate pairs of instants that are spread over the recording.

    Returns:
        The pairs; None where no instant of any camera has one.

    """
    useful = [_useful(view) for view in views]
    per_instant = max(int(np.prod(v.uv.shape[1:3])) * v.x_mocap.shape[1] for v in views)
    low, high = INSTANTS_PER_CAMERA
    wanted = min(INSTANTS, POINTS // per_instant) // len(views)
    wanted = min(max(wanted, low), high)
    parts = [
        _pairs(camera, view.at_frames(frames[spread(len(frames), wanted)]))
        for camera, view, frames in zip(cameras, views, useful, strict=True)
    ]
    counts = [len(part.x) for part in parts]
    if not sum(counts):
        return None
    row_of, pair_of = (_numbered([getattr(p, name) for p in parts]) for name in ('row', 'pair'))
    poses = [c.camera_T_world or RigidTransform.identity() for c in cameras]
    pool = Pool(
        camera=np.repeat(np.arange(len(views)), counts),
        frame=pair_of,
        x_mocap=np.concatenate([part.x for part in parts]),
        ideal=np.concatenate([part.ideal for part in parts]),
        focal_px=np.repeat(np.array([c.focal_px for c in cameras]), counts),
        camera_R_world=np.stack([pose.rotation for pose in poses]),
        camera_t_world=np.stack([pose.translation for pose in poses]),
    )
    first_point = np.flatnonzero(np.diff(pair_of, prepend=-1))
    first_pair = np.flatnonzero(np.diff(row_of[first_point], prepend=-1))
    return Sample(pool, first_point, first_pair, pair_of)


class _Pairs(NamedTuple):
    """Points of the pairs of one camera, ordered by instant, skeleton, detection, joint."""

    row: IntArray
    pair: IntArray
    x: Array
    ideal: Array


def _useful(view: CrowdView) -> IntArray:
    """Instants at which some skeleton and some detection have enough joints in common."""
    with_x, with_uv = view.there()
    common = np.einsum('fsj,fpj->fsp', with_x.astype(np.int16), with_uv.astype(np.int16))
    return np.flatnonzero((common >= MIN_JOINTS).any((1, 2)))


def _pairs(camera: Camera, view: CrowdView) -> _Pairs:
    with_x, with_uv = view.there()
    ideal = np.full(view.uv.shape, np.nan)
    ideal[with_uv] = camera.normalise(view.uv[with_uv])
    with_uv &= np.isfinite(ideal).all(-1)
    both = with_x[:, :, None] & with_uv[:, None]
    both &= (both.sum(-1) >= MIN_JOINTS)[..., None]
    f, s, p, j = np.nonzero(both)
    n_skeletons, n_persons = both.shape[1:3]
    row = f * n_skeletons + s
    return _Pairs(row, row * n_persons + p, view.x_mocap[f, s, j], ideal[f, p, j])


def _numbered(parts: list[IntArray]) -> IntArray:
    """Number the groups of all parts through, in ascending order."""
    shifted, start = [], 0
    for part in parts:
        shifted.append(part + start)
        start += int(part.max(initial=-1)) + 1
    return np.unique(np.concatenate(shifted), return_inverse=True)[1].reshape(-1)
