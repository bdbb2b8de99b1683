# SPDX-License-Identifier: Apache-2.0
"""Several persons in the messages of a session: the candidates that the solve picks from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rpgd_ros.core.candidates import Crowd, CrowdView
from rpgd_ros.core.geometry import Array
from rpgd_ros.core.observations import MocapTrack
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
        if view.stamp_ns is not None:
            stamp_ns[rows] = view.stamp_ns
    rows = np.flatnonzero(has_skeleton)
    scores = None if persons.confidence is None else persons.confidence[rows]
    return CrowdView(stamp_ns[rows], x[rows], persons.values[rows], scores)
