# SPDX-License-Identifier: Apache-2.0
"""Several persons in the messages of a session: the candidates that the solve picks from."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from rpgd_ros.core.candidates import Crowd, CrowdView, shifts_ns
from rpgd_ros.core.errors import CalibrationError, Reason
from rpgd_ros.core.geometry import Array
from rpgd_ros.core.observations import NS_PER_S, MocapTrack
from rpgd_ros.core.persons import Picked
from rpgd_ros.pairing import Persons, Samples, SyncConfig, follow, pair


def alone(samples: Samples) -> Persons:
    """Return samples of one person as those of a crowd of one."""
    scores = None if samples.confidence is None else samples.confidence[:, None]
    return Persons(samples.stamp_ns, samples.values[:, None], scores)


def tracks_of(skeletons: Samples, persons: Persons | None) -> list[Samples]:
    """Return the skeletons of each person with MoCap."""
    return [skeletons] if persons is None else follow(persons)


def make_crowd(
    tracks: Sequence[Samples],
    detections: Sequence[tuple[Persons, float]],
    *,
    sync: SyncConfig,
    joint_names: tuple[str, ...],
) -> Crowd:
    """Give the frames of each camera the skeletons of their instants.

    Args:
        tracks: (M, J, 3) of each person with MoCap, metres.
        detections: Of each camera (F, P, J, 2) pixels, and how late its video is stamped, seconds.
        sync: Settings of the pairing.
        joint_names: (J,).

    """
    views = tuple(_view(tracks, persons, sync, late_s) for persons, late_s in detections)
    streams = tuple(MocapTrack(track.stamp_ns, track.values) for track in tracks)
    return Crowd(views, streams, joint_names)


def _view(
    tracks: Sequence[Samples], persons: Persons, sync: SyncConfig, late_s: float
) -> CrowdView:
    """Return the frames that have a skeleton, stamped on the MoCap's clock."""
    n_frames, _, n_joints, _ = persons.values.shape
    number: Array = np.arange(n_frames, dtype=np.float64)
    x = np.full((n_frames, len(tracks), n_joints, 3), np.nan)
    stamp_ns, has_skeleton = persons.stamp_ns.copy(), np.zeros(n_frames, np.bool_)
    # The frames go through the pairing in the place of a keypoint: their numbers come back.
    frames = Samples(persons.stamp_ns, number[:, None, None], None)
    for s, track in enumerate(tracks):
        view, _ = pair(track, frames, settings=sync, time_offset_s=late_s)
        rows = view.uv[:, 0, 0].astype(np.int64)
        x[rows, s], has_skeleton[rows] = view.x_mocap, True
        stamp_ns[rows] = view.known_stamp_ns
    rows = np.flatnonzero(has_skeleton)
    scores = None if persons.confidence is None else persons.confidence[rows]
    return CrowdView(stamp_ns[rows], x[rows], persons.values[rows], scores)


def single_out(
    detections: Sequence[tuple[Persons, float]], crowd: Crowd, picked: Picked
) -> list[Samples]:
    """Return what was picked, as sent: a recording of one person per camera.

    Args:
        detections: As for `make_crowd`, in any columns.
        crowd: What was made of them.
        picked: What was picked of that.

    """
    shifts = shifts_ns(crowd.of(picked.used))
    singled = []
    cameras = zip(detections, crowd.views, picked.chosen, strict=True)
    for (persons, late_s), view, picks in cameras:
        chosen = picks[:, picked.used]
        skeleton, frame = np.nonzero(chosen.T >= 0)
        stamps = np.empty(0, np.int64) if view.stamp_ns is None else view.stamp_ns
        row = np.searchsorted(persons.stamp_ns, stamps + round(late_s * NS_PER_S))[frame]
        person = chosen[frame, skeleton]
        scores = None if persons.confidence is None else persons.confidence[row, person]
        stamp_ns = persons.stamp_ns[row] + shifts[skeleton]
        singled.append(Samples(stamp_ns, persons.values[row, person], scores))
    return singled


def in_turn(crowd: Crowd) -> Samples:
    """Return the skeletons of all persons with MoCap, one person after the other."""
    parts = list(zip(crowd.tracks, shifts_ns(crowd), strict=True))
    if len(parts) == 1:
        return Samples(crowd.tracks[0].stamp_ns, crowd.tracks[0].x_mocap, None)
    return Samples(
        np.concatenate([track.stamp_ns + shift for track, shift in parts]),
        np.concatenate([track.x_mocap for track, _ in parts]),
        None,
    )


def stage_check(
    stage: str,
    progress: Callable[[str, float], None] | None,
    should_stop: Callable[[], bool] | None,
) -> Callable[[float], None]:
    """Return what a stage calls with its fraction done."""
    furthest = 0.0

    def tick(fraction: float) -> None:
        nonlocal furthest
        furthest = max(furthest, fraction)
        if progress is not None:
            progress(stage, furthest)
        if should_stop is not None and should_stop():
            msg = f'cancelled during {stage}'
            raise CalibrationError(Reason.CANCELLED, msg)

    return tick
