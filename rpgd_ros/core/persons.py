# SPDX-License-Identifier: Apache-2.0
"""Who is who: picks the persons that have MoCap out of all that the cameras detected.

No tracking: a pose that explains one pair of skeleton and detection at most instants is found
first (`crowd`); at that pose the pair of each instant is the one that agrees. What was picked is
then a recording like any other. Of several skeletons each makes a recording of its own, and the
recordings stand one after the other in time, so that at any instant there is one body.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rpgd_ros.core.adjust import Problem, State
from rpgd_ros.core.candidates import Crowd, CrowdView, assemble
from rpgd_ros.core.config import CalibrationConfig
from rpgd_ros.core.crowd import draw_sample, find_pose
from rpgd_ros.core.errors import CalibrationError, InputError, Reason
from rpgd_ros.core.geometry import Array, BoolArray, IntArray, RigidTransform
from rpgd_ros.core.linearise import Sight
from rpgd_ros.core.matching import best_matching
from rpgd_ros.core.noise import NoiseModel
from rpgd_ros.core.noise_fit import noise_at
from rpgd_ros.core.observations import MocapTrack, Observations
from rpgd_ros.core.refine import descend
from rpgd_ros.core.synchronise import Settled, settled
from rpgd_ros.core.thin import MIDDLE_POINTS, thin
from rpgd_ros.core.timeline import Timeline
from rpgd_ros.core.unknowns import Unknowns

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rpgd_ros.core.camera import Camera

# A detection shows the subject where so many of its joints lie within three sigma, and so large a
# part of the share that does in most detections picked: of somebody else a few joints come to lie
# there by chance.
AGREEING_JOINTS, AGREEING_PART, AGREEING_SHARE = 3, 0.5, 0.2
ROUNDS = 3  # of picking and refining: the first pose is 1 px off at worst, the second nothing
CHUNK = 1024  # instants


class Shown(NamedTuple):
    """In how much of a camera's video the persons with MoCap were found.

    Attributes:
        frames: Instants with a skeleton and a detection, counted once for each skeleton.
        shown: Those of them at which a detection was picked for the skeleton.
        detections: Detections in all these instants.

    """

    frames: int
    shown: int
    detections: int

    @property
    def share(self) -> float:
        """Share of the instants that show the subject; 0 without any."""
        return self.shown / self.frames if self.frames else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Picked:
    """What belongs together.

    Attributes:
        observations: For `calibrate`, cameras as given.
        chosen: Per camera (F, S) the detection of each skeleton; -1 = none.
        shown: Per camera, how much of its video shows the subjects.
        used: Skeletons of which the observations are. Where the rate of the clocks is estimated,
            only the one that was picked most: recordings that stand one after the other do not
            have one rate.

    """

    observations: Observations
    chosen: tuple[IntArray, ...]
    shown: tuple[Shown, ...]
    used: tuple[int, ...] = (0,)


def pick_persons(
    cameras: Sequence[Camera],
    crowd: Crowd,
    *,
    config: CalibrationConfig | None = None,
    seed: int | None = None,
    check: Callable[[float], None] = lambda _: None,
) -> Picked:
    """Find which detection shows which skeleton.

    Args:
        cameras: One per view. Those without extrinsics are taken each by itself.
        crowd: Skeletons and detections.
        config: Settings; None = `CalibrationConfig()`.
        seed: Seed of the draws; None = `config.ransac.seed`.
        check: Called with the fraction done; raises to end the run.

    Raises:
        CalibrationError: NO_DATA or TOO_FEW_INLIERS, where no detection shows a skeleton.
        InputError: Cameras and views do not fit together.

    """
    config = config or CalibrationConfig()
    if len(cameras) != len(crowd.views):
        msg = f'{len(cameras)} cameras for {len(crowd.views)} views'
        raise InputError(Reason.BAD_INPUT, msg)
    seed = config.ransac.seed if seed is None else seed
    chosen = [np.full((v.n_frames, v.x_mocap.shape[1]), -1) for v in crowd.views]
    for group in _groups(cameras, crowd.views):
        some = [cameras[v] for v in group], tuple(crowd.views[v] for v in group)
        picked = _pick(*some, crowd.tracks, config, seed, check)
        for v, picks in zip(group, picked, strict=True):
            chosen[v] = picks
    shown = tuple(_shown(v, picks) for v, picks in zip(crowd.views, chosen, strict=True))
    _check_shown(shown, config.accept.min_inlier_ratio)
    counts = np.sum([(picks >= 0).sum(0) for picks in chosen], axis=0)
    is_one = config.time.estimate_rate and bool(crowd.tracks)
    used = (int(np.argmax(counts)),) if is_one else tuple(range(len(counts)))
    part, of_these = crowd.of(used), [one[:, used] for one in chosen]
    return Picked(assemble(part, of_these), tuple(chosen), shown, used)


def _groups(cameras: Sequence[Camera], views: Sequence[CrowdView]) -> list[list[int]]:
    """Cameras that share a world, by name so that their order is that of no caller."""
    order = sorted(range(len(cameras)), key=lambda v: cameras[v].name)
    order = [v for v in order if views[v].uv.size and views[v].x_mocap.size]
    known = [v for v in order if cameras[v].camera_T_world is not None]
    return [*([known] if known else []), *([v] for v in order if v not in known)]


def _pick(
    cameras: Sequence[Camera], views: tuple[CrowdView, ...], tracks: tuple[MocapTrack, ...],
    config: CalibrationConfig, seed: int, check: Callable[[float], None],
) -> list[IntArray]:  # fmt: skip
    """Pick in cameras whose poses are known to each other."""
    nobody = [np.full((v.n_frames, v.x_mocap.shape[1]), -1) for v in views]
    sample = draw_sample(cameras, views)
    if sample is None:
        return nobody
    found = find_pose(
        sample, np.random.default_rng(seed), iterations=config.ransac.iterations, check=check
    )
    if not found:
        return nobody
    pose, noise, _ = found[0].candidate
    chosen, moved = nobody, list(views)
    for _ in range(ROUNDS):
        before = chosen
        chosen = [
            pick_at(camera, view, pose, noise, check)
            for camera, view in zip(cameras, moved, strict=True)
        ]
        if all(map(np.array_equal, chosen, before)):
            break
        part = Crowd(views, tracks)
        pose, noise, offset_s = _refined(cameras, part, chosen, pose, noise, config, check)
        if offset_s is not None:
            moved = [_shifted(v, tracks, by) for v, by in zip(views, offset_s, strict=True)]
    return chosen


def _refined(
    cameras: Sequence[Camera], crowd: Crowd, chosen: Sequence[IntArray], pose: RigidTransform,
    noise: NoiseModel, config: CalibrationConfig, check: Callable[[float], None],
) -> tuple[RigidTransform, NoiseModel, Array | None]:  # fmt: skip
    """Refine the pose on what was picked, and the offsets (V,) of the videos where asked for."""
    observations = assemble(crowd, chosen)
    pairs = zip(cameras, observations.views, strict=True)
    sights = [Sight(camera, view) for camera, view in pairs if view.n_frames]
    if not sights:
        return pose, noise, None
    middle = thin(sights, MIDDLE_POINTS)
    noise = noise_at(middle, pose)
    x = np.concatenate([s.view.x_mocap.reshape(-1, 3) for s in middle])
    centroid = np.nanmedian(x, 0)
    track = observations.mocap
    if config.time.estimate_offset == 'off' or track is None or len(track.stamp_ns) < 2:
        steps = config.refine.iterations
        pose = descend(middle, pose, centroid, noise, max_steps=steps, check=check)
        return pose, noise_at(middle, pose), None
    problem = Problem(middle, Timeline(track), None, centroid)
    n = len(middle)
    unknowns = Unknowns(tuple(range(n)), (-1,) * n)
    begin = State.begin(pose, n, middle[0].view.n_joints)
    state, _, noise = settled(problem, Settled(begin, unknowns, noise), check)
    pose, known_s = state.pose, state.offset_s
    offset_s = np.zeros(len(cameras))
    offset_s[[view.n_frames > 0 for view in observations.views]] = known_s
    return pose, noise, offset_s


def _shifted(view: CrowdView, tracks: Sequence[MocapTrack], offset_s: float) -> CrowdView:
    """Return the skeletons of the instants that the video really shows."""
    if view.stamp_ns is None:
        return view
    bodies = []
    for track in tracks:
        timeline = Timeline(track)
        bodies.append(timeline.at(timeline.seconds(view.stamp_ns) - offset_s)[0])
    return replace(view, x_mocap=np.stack(bodies, 1))


def pick_at(
    camera: Camera, view: CrowdView, pose: RigidTransform, noise: NoiseModel,
    check: Callable[[float], None] = lambda _: None,
) -> IntArray:  # fmt: skip
    """Choose the detection of each skeleton at a known pose.

    Args:
        camera: The camera.
        view: What it saw.
        pose: world_T_mocap.
        noise: Spread of the residuals of the right pairs.
        check: Called between the parts of the data.

    Returns:
        (F, S) number of the detection; -1 where none shows the skeleton. No detection is given
        to two skeletons.

    """
    camera_T_mocap = (camera.camera_T_world or RigidTransform.identity()) @ pose
    chosen = np.full((view.n_frames, view.x_mocap.shape[1]), -1)
    for start in range(0, view.n_frames, CHUNK):
        check(start / view.n_frames)
        rows = slice(start, start + CHUNK)
        projected = camera.project_camera(camera_T_mocap @ view.x_mocap[rows])
        chosen[rows] = best_matching(_gains(projected, view.uv[rows], noise))
    return chosen


def _gains(projected: Array, uv: Array, noise: NoiseModel) -> Array:
    """Log likelihood of each pair above that of none, (F, S, P); 0 where it shows nobody.

    Args:
        projected: (F, S, J, 2) pixels.
        uv: (F, P, J, 2) pixels.
        noise: Spread of the residuals of the right pairs.

    """
    shape = (*projected.shape[:2], uv.shape[1])
    gains = np.zeros(shape)
    scale, power = noise.nu * noise.sigma_px**2, 0.5 * (noise.nu + 2.0)
    top = np.log(noise.peak / noise.background)
    least = max(AGREEING_SHARE, AGREEING_PART * noise.share)
    for s, p in np.ndindex(shape[1:]):
        with np.errstate(invalid='ignore', over='ignore'):
            squared = ((projected[:, s] - uv[:, p]) ** 2).sum(-1)
            seen = np.abs(uv[:, p]).max(-1) < np.inf
            near = squared < noise.threshold_px**2  # False for NaN
            gain = np.logaddexp(0.0, top - power * np.log1p(squared / scale))
        n_near, n_seen = near.sum(1), seen.sum(1)
        good = (n_near >= AGREEING_JOINTS) & (n_near >= least * n_seen)
        gains[good, s, p] = np.nansum(gain[good], 1)
    return gains


def _shown(view: CrowdView, picks: IntArray) -> Shown:
    joints, keypoints = view.there()
    with_x: BoolArray = np.asarray(joints.any(2))
    with_uv: BoolArray = np.asarray(keypoints.any(2))
    both = with_x & np.asarray(with_uv.any(1))[:, None]
    n_detections = int(with_uv[np.asarray(both.any(1))].sum())
    return Shown(int(both.sum()), int((picks >= 0).sum()), n_detections)


def _check_shown(shown: Sequence[Shown], least: float) -> None:
    frames, n_shown = sum(s.frames for s in shown), sum(s.shown for s in shown)
    if not frames:
        msg = 'no frame with skeleton and keypoints'
        raise CalibrationError(Reason.NO_DATA, msg)
    if n_shown < max(1.0, least * frames):
        msg = (
            f'the person with MoCap was found in {n_shown} of {frames} frames '
            f'({100 * n_shown / frames:.1f} %), need {100 * least:.0f} %. Check that the cameras '
            'see the person with MoCap and share a clock with it'
        )
        raise CalibrationError(Reason.TOO_FEW_INLIERS, msg)
