# SPDX-License-Identifier: Apache-2.0
"""What one solve is given, and the solve."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from rpgd_ros.core import CameraPose, Picked, calibrate, calibrate_cameras, pick_persons
from rpgd_ros.core.camera import Camera
from rpgd_ros.core.candidates import Crowd
from rpgd_ros.core.config import CalibrationConfig
from rpgd_ros.core.errors import CalibrationError, Reason
from rpgd_ros.core.geometry import Array, IntArray, RigidTransform
from rpgd_ros.core.observations import MocapTrack, Observations
from rpgd_ros.core.result import Calibration
from rpgd_ros.io.rig_types import KeypointUnits
from rpgd_ros.pairing import PairCounts, Persons, Samples, SyncConfig, pair
from rpgd_ros.session.crowd import alone, in_turn, make_crowd, single_out, stage_check, tracks_of

# Pixels of an image are counted in hundreds: a median below 2 can only be shares of its size.
LARGEST_NORMALISED = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class KeypointTrack:
    """The keypoints of one camera as they were sent.

    Attributes:
        samples: (F, K, 2) of the keypoints that are used.
        columns: (K,) their columns in the observations.
        units: Of the coordinates.
        min_confidence: Keypoints with a lower score are missing.
        time_offset_s: How late the video is stamped against the skeletons, seconds.
        persons: (F, P, K, 2) of all persons, where there are several; `samples` is the first.

    """

    samples: Samples
    columns: IntArray
    units: KeypointUnits
    min_confidence: float
    time_offset_s: float
    persons: Persons | None = None


@dataclass(frozen=True, eq=False)
class Snapshot:
    """What one solve is given; the session goes on without touching it.

    Attributes:
        cameras: Those with intrinsics, in the order of the rig file.
        keypoints: Of these cameras.
        skeletons: (M, J, 3) metres, of the joints that some camera sees.
        joint_names: (J,) of the skeletons.
        sync: Settings of the pairing.
        config: Settings of the solve.
        pair_counts: Frames of each of these cameras with and without a skeleton.
        left_out: Cameras whose intrinsics, or poses from TF, have not arrived.
        turns: By camera without a pose, which the solve is to find: optical frame to camera.
        persons: (M, S, J, 3) skeletons of all persons, where there are several with MoCap.

    """

    cameras: tuple[Camera, ...]
    keypoints: tuple[KeypointTrack, ...]
    skeletons: Samples
    joint_names: tuple[str, ...]
    sync: SyncConfig
    config: CalibrationConfig
    pair_counts: Mapping[str, PairCounts]
    left_out: tuple[str, ...] = ()
    turns: Mapping[str, RigidTransform] = field(default_factory=dict)
    persons: Persons | None = None

    @property
    def is_crowd(self) -> bool:
        """Whether some message held more than one person."""
        return self.persons is not None or any(k.persons is not None for k in self.keypoints)

    def pick(self, check: Callable[[float], None] = lambda _: None) -> Picked | None:
        """Find which detections show the persons with MoCap; once, then it is known.

        Args:
            check: Called with the fraction done; raises to end the run.

        Returns:
            What belongs together; None where there is never more than one person.

        Raises:
            CalibrationError: No detection shows a person with MoCap.

        """
        if not self.is_crowd:
            return None
        known: dict[str, Picked | CalibrationError] = self.__dict__.setdefault('_known', {})
        before = known.get('picked')
        if before is None or _is_cancelled(before):
            try:
                known['picked'] = pick_persons(
                    self.cameras, self._crowd, config=self.config, check=check
                )
            except CalibrationError as error:
                known['picked'] = error
        picked = known['picked']
        if isinstance(picked, CalibrationError):
            raise picked
        return picked

    def alone(self) -> Snapshot:
        """Return the snapshot with nobody but the persons with MoCap, one after the other.

        Where they cannot be found, the first person of each message is left.
        """
        if not self.is_crowd:
            return self
        known: Snapshot | None = self.__dict__.get('_alone')
        if known is not None:
            return known
        plain = tuple(replace(k, persons=None) for k in self.keypoints)
        was_cancelled = _is_cancelled(self.__dict__.get('_known', {}).get('picked'))
        try:
            picked = None if was_cancelled else self.pick()
        except CalibrationError:
            picked = None
        if picked is None:
            return replace(self, keypoints=plain, persons=None)
        sent = [(k.persons or alone(k.samples), k.time_offset_s) for k in self.keypoints]
        singled = single_out(sent, self._crowd, picked)
        plain = tuple(replace(k, samples=s) for k, s in zip(plain, singled, strict=True))
        skeletons = in_turn(self._crowd.of(picked.used))
        known = self.__dict__['_alone'] = replace(
            self, keypoints=plain, skeletons=skeletons, persons=None
        )
        return known

    @cached_property
    def _crowd(self) -> Crowd:
        return make_crowd(
            tracks_of(self.skeletons, self.persons),
            [
                (persons_in_columns(k, len(self.joint_names), c.size), k.time_offset_s)
                for c, k in zip(self.cameras, self.keypoints, strict=True)
            ],
            sync=self.sync,
            joint_names=self.joint_names,
        )

    def placed(self, poses: Mapping[str, CameraPose]) -> tuple[Camera, ...]:
        """Return the cameras with the poses that a solve found; a camera may still have none."""
        return tuple(
            replace(c, camera_T_world=self.turns[c.name] @ poses[c.name].camera_T_world)
            if c.name in self.turns and c.name in poses
            else c
            for c in self.cameras
        )

    def settled(self, poses: Mapping[str, CameraPose]) -> Snapshot:
        """Return the snapshot with the poses that a solve found, less cameras without any."""
        pairs = zip(self.placed(poses), self.alone().keypoints, strict=True)
        kept = [(c, k) for c, k in pairs if c.name not in self.turns or c.name in poses]
        return replace(
            self.alone(),
            cameras=tuple(c for c, _ in kept),
            keypoints=tuple(k for _, k in kept),
            turns={},
        )

    @cached_property
    def observations(self) -> Observations:
        """The pairs, one view per camera, stamped on the MoCap's clock; made when first asked.

        Of several persons those that belong together, see `alone`.
        """
        if self.is_crowd:
            return self.alone().observations
        views = tuple(
            pair(
                self.skeletons,
                in_columns(track, len(self.joint_names), camera.size),
                settings=self.sync,
                time_offset_s=track.time_offset_s,
            )[0]
            for camera, track in zip(self.cameras, self.keypoints, strict=True)
        )
        mocap = MocapTrack(self.skeletons.stamp_ns, self.skeletons.values)
        return Observations(views, mocap, self.joint_names)


def in_columns(track: KeypointTrack, n_columns: int, size: tuple[int, int]) -> Samples:
    """Return keypoints in the columns of the observations: (F, J, 2) pixels, NaN = missing.

    Args:
        track: Keypoints as sent.
        n_columns: J.
        size: Of the image, pixels.

    """
    stamp_ns, uv, confidence = track.samples
    out = np.full((len(uv), n_columns, 2), np.nan)
    out[:, track.columns] = uv * np.array(size) if _is_normalised(track) else uv
    if confidence is None:
        return Samples(stamp_ns, out, None)
    scores = np.full(out.shape[:2], np.nan)
    scores[:, track.columns] = confidence
    out[scores < track.min_confidence] = np.nan
    return Samples(stamp_ns, out, scores)


def persons_in_columns(track: KeypointTrack, n_columns: int, size: tuple[int, int]) -> Persons:
    """Return keypoints of all persons (F, P, J, 2); see `in_columns`."""
    if track.persons is None:
        return alone(in_columns(track, n_columns, size))
    stamp_ns, uv, confidence = track.persons
    n_frames, n_persons, n_joints, _ = uv.shape
    scores = None if confidence is None else confidence.reshape(-1, n_joints)
    flat = Samples(stamp_ns, uv.reshape(-1, n_joints, 2), scores)
    _, values, rated = in_columns(replace(track, samples=flat), n_columns, size)
    return Persons(
        stamp_ns,
        values.reshape(n_frames, n_persons, n_columns, 2),
        None if rated is None else rated.reshape(n_frames, n_persons, n_columns),
    )


def _is_normalised(track: KeypointTrack) -> bool:
    if track.units != 'auto':
        return track.units == 'normalized'
    uv: Array = track.samples.values
    there = np.abs(uv[np.isfinite(uv)])
    return bool(there.size) and float(np.median(there)) < LARGEST_NORMALISED


def _is_cancelled(outcome: object) -> bool:
    return isinstance(outcome, CalibrationError) and outcome.reason is Reason.CANCELLED


def solve(
    snapshot: Snapshot,
    *,
    progress: Callable[[str, float], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> Calibration:
    """Calibrate from a snapshot; may run in another thread than the session.

    Args:
        snapshot: Data and settings.
        progress: Told the stage and its fraction done.
        should_stop: Asked whether to end early.

    Returns:
        The calibration. Its time offsets are those of the stamps as sent, what the rig file says
        included; cameras that were left out are among its warnings. Where several cameras have
        no pose, it holds `camera_poses` of their optical frames, see `calibrate_cameras`.

    Raises:
        CalibrationError: The data do not give a pose that anybody should use.

    """
    picked = snapshot.pick(stage_check('persons', progress, should_stop))
    calibration = _calibrated(snapshot.alone(), progress, should_stop)
    known_s = {
        camera.name: track.time_offset_s
        for camera, track in zip(snapshot.cameras, snapshot.keypoints, strict=True)
    }
    offsets = {
        name: (offset_s + known_s[name], sigma_s)
        for name, (offset_s, sigma_s) in calibration.time_offset_s.items()
    }
    if picked is not None:
        shown = {c.name: s for c, s in zip(snapshot.cameras, picked.shown, strict=True)}
        calibration = replace(calibration, shown=shown)
    warnings = calibration.warnings
    if snapshot.left_out:
        names = ', '.join(snapshot.left_out)
        warnings = (*warnings, f'left out for want of CameraInfo or a pose from TF: {names}')
    return replace(calibration, time_offset_s=offsets, warnings=warnings)


def _calibrated(
    snapshot: Snapshot,
    progress: Callable[[str, float], None] | None,
    should_stop: Callable[[], bool] | None,
) -> Calibration:
    cameras, observations, config = snapshot.cameras, snapshot.observations, snapshot.config
    if not snapshot.turns:
        return calibrate(
            cameras, observations, config=config, progress=progress, should_stop=should_stop
        )
    found = calibrate_cameras(
        cameras, observations, config=config, progress=progress, should_stop=should_stop
    )
    poses = {
        name: pose.turned(snapshot.turns[name].inverse().rotation)
        for name, pose in found.poses.items()
    }
    return replace(found.calibration, camera_poses=poses)
