# SPDX-License-Identifier: Apache-2.0
"""A solve's data as a report wants them: pairs at the clock offsets that were found."""

from __future__ import annotations

from dataclasses import replace

from rpgd_ros.core.body import Body
from rpgd_ros.core.errors import CalibrationError
from rpgd_ros.core.linearise import Sight
from rpgd_ros.core.observations import Observations
from rpgd_ros.core.result import Calibration
from rpgd_ros.report import Case
from rpgd_ros.session import Snapshot


def case_of_snapshot(
    name: str,
    snapshot: Snapshot,
    calibration: Calibration | None,
    *,
    world_frame: str,
    mocap_frame: str,
    stamp_ns: int,
    refusal: CalibrationError | None = None,
) -> Case:
    """Return a solve as what a report is about.

    Args:
        name: Of the recording.
        snapshot: What the solve was given, with the places of cameras that it found.
        calibration: What it found, refused or not.
        world_frame: Parent frame.
        mocap_frame: Child frame.
        stamp_ns: When it ended, since 1970.
        refusal: Why nobody should use it; None = accepted.

    """
    return Case(
        name=name,
        world_frame=world_frame,
        mocap_frame=mocap_frame,
        stamp_ns=stamp_ns,
        cameras=snapshot.cameras,
        observations=observations_of(snapshot, calibration),
        calibration=calibration,
        refusal=refusal,
        moved_m=moved_m(snapshot),
    )


def offsets_s(snapshot: Snapshot, calibration: Calibration | None) -> tuple[float, ...]:
    """Return how late the video of each camera is stamped, found or known, seconds."""
    found = {}
    if calibration is not None:
        worst_s = calibration.config.time.max_sigma_s  # beyond it, an offset is not applied
        found = {
            name: offset_s
            for name, (offset_s, sigma_s) in calibration.time_offset_s.items()
            if sigma_s <= worst_s
        }
    return tuple(
        found.get(camera.name, track.time_offset_s)
        for camera, track in zip(snapshot.cameras, snapshot.keypoints, strict=True)
    )


def observations_of(snapshot: Snapshot, calibration: Calibration | None) -> Observations:
    """Return the pairs of a snapshot, at the clock offsets that were found."""
    tracks = tuple(
        replace(track, time_offset_s=offset_s)
        for track, offset_s in zip(
            snapshot.keypoints, offsets_s(snapshot, calibration), strict=True
        )
    )
    return replace(snapshot, keypoints=tracks).observations


def moved_m(snapshot: Snapshot) -> float:
    """Return the distance that the body covered, as the gates count it, metres."""
    pairs = zip(snapshot.cameras, snapshot.observations.views, strict=True)
    return Body.of([Sight(camera, view) for camera, view in pairs if view.n_frames]).motion_m
