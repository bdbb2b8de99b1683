# SPDX-License-Identifier: Apache-2.0
"""How a result settles with the length of the recording: solves of its beginnings."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from rpgd_ros.core import CalibrationConfig, Camera, Observations, calibrate
from rpgd_ros.core.errors import CalibrationError
from rpgd_ros.core.geometry import rotation_angle
from rpgd_ros.core.observations import NS_PER_S, View
from rpgd_ros.core.result import Calibration
from rpgd_ros.report.case import Step

PARTS = (0.1, 0.25, 0.5, 0.75, 1.0)  # of the recording


def settle(
    cameras: Sequence[Camera],
    observations: Observations,
    calibration: Calibration,
    *,
    progress: Callable[[str, float], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> tuple[Step, ...]:
    """Solve ever longer beginnings of a recording; a part that gives no pose is left out.

    Args:
        cameras: One per view.
        observations: At the clock offsets that were found.
        calibration: The result of all.
        progress: Told 'convergence' and its fraction done.
        should_stop: Asked whether to end early.

    """
    c = calibration
    # The pose alone: a tenth of the time, and the parts are compared among themselves.
    config = CalibrationConfig(ransac=c.config.ransac, accept=c.config.accept)
    config = replace(config, rig=replace(config.rig, on_bumped_camera='name'))
    excluded = {d.camera for d in c.disagreements if d.rival is None}
    if c.config.rig.on_bumped_camera == 'name':
        excluded = set()
    found = []
    for i, (seconds, part) in enumerate(_parts(observations)):
        used = [
            (camera, view)
            for camera, view in zip(cameras, part, strict=True)
            if view.n_frames and camera.name not in excluded
        ]
        if progress:
            progress('convergence', i / len(PARTS))
        solved = _solve(used, observations, config, should_stop)
        if solved is not None:
            found.append((seconds, solved))
        if should_stop and should_stop():
            return ()
    if not found or found[-1][0] < _length(observations):
        return ()
    whole = found[-1][1]
    return tuple(_step(seconds, solved, whole) for seconds, solved in found)


def _solve(
    used: Sequence[tuple[Camera, View]], observations: Observations, config: CalibrationConfig,
    should_stop: Callable[[], bool] | None,
) -> Calibration | None:  # fmt: skip
    """Return what a part gives, refused or not; None where that is nothing."""
    if not used:
        return None
    part = replace(observations, views=tuple(view for _, view in used))
    try:
        return calibrate(
            [camera for camera, _ in used], part, config=config, should_stop=should_stop
        )
    except CalibrationError as refusal:
        return refusal.calibration


def _step(seconds: float, found: Calibration, whole: Calibration) -> Step:
    a, b = found.world_T_mocap, whole.world_T_mocap
    apart = a @ whole.centroid_mocap - b @ whole.centroid_mocap
    sigma_deg, sigma_m = found.worst_sigma
    angle = float(np.degrees(rotation_angle(a.rotation @ b.rotation.T)))
    return Step(seconds, angle, float(np.linalg.norm(apart)), sigma_deg, sigma_m)


def _parts(observations: Observations) -> Iterator[tuple[float, tuple[View, ...]]]:
    length = _length(observations)
    start = _start(observations)
    for share in PARTS:
        views = []
        for view in observations.views:
            if view.stamp_ns is None:
                n = round(share * view.n_frames)
            else:
                end = start + round(share * length * NS_PER_S)
                n = int(np.searchsorted(view.stamp_ns, end, 'right'))
            views.append(_first(view, n))
        yield share * length, tuple(views)


def _first(view: View, n: int) -> View:
    return View(
        None if view.stamp_ns is None else view.stamp_ns[:n],
        view.x_mocap[:n],
        view.uv[:n],
        None if view.confidence is None else view.confidence[:n],
    )


def _start(observations: Observations) -> int:
    stamps = [v.stamp_ns[0] for v in observations.views if v.stamp_ns is not None and v.n_frames]
    return int(min(stamps)) if stamps else 0


def _length(observations: Observations) -> float:
    """Seconds, or frames where no time is known."""
    stamps = [v.stamp_ns[-1] for v in observations.views if v.stamp_ns is not None and v.n_frames]
    if stamps:
        return (int(max(stamps)) - _start(observations)) / NS_PER_S
    return float(max((view.n_frames for view in observations.views), default=0))
