# SPDX-License-Identifier: Apache-2.0
"""Small calibration cases with known truth, for the tests of other rooms."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from rpgd_ros.core import Camera, Observations, RigidTransform
from rpgd_ros.core.geometry import Array, rotation_angle
from rpgd_ros.simulation import Twin, twin


def scene(shape: str = 'human36m', frames: int = 300, seed: int = 0, **faults: Any) -> Twin:
    """Return (cameras, observations, truth); faults as those of `rpgd_ros.simulation.twin`."""
    return twin(shape, frames, seed, **faults)


def perfect(shape: str = 'human36m', frames: int = 100, seed: int = 0, **faults: Any) -> Twin:
    """Return a scene whose keypoints are the exact projections of its MoCap joints."""
    case = twin(shape, frames, seed, **faults)
    views = tuple(
        replace(
            view,
            uv=np.where(
                view.seen()[..., None],
                camera.project(case.truth.world_T_mocap @ view.x_mocap),
                np.nan,
            ),
        )
        for camera, view in zip(case.cameras, case.observations.views, strict=True)
    )
    return case._replace(observations=replace(case.observations, views=views))


def only(case: Twin, *numbers: int) -> Twin:
    """Return the scene as seen by some of its cameras."""
    views = tuple(case.observations.views[n] for n in numbers)
    truth = replace(
        case.truth,
        inliers=tuple(case.truth.inliers[n] for n in numbers),
        lags_s=tuple(case.truth.lags_s[n] for n in numbers),
    )
    cameras = tuple(case.cameras[n] for n in numbers)
    return Twin(cameras, replace(case.observations, views=views), truth)


def errors(
    found: RigidTransform, truth: RigidTransform, observations: Observations
) -> tuple[float, float]:
    """Return rotation error, degrees, and error at the body's centroid, metres."""
    x = observations.views[0].x_mocap
    centroid: Array = x[np.isfinite(x).all(-1)].mean(0)
    angle = rotation_angle(found.rotation @ truth.rotation.T)
    return float(np.degrees(angle)), float(np.linalg.norm((found @ centroid) - (truth @ centroid)))


def mpjpe_px(
    cameras: tuple[Camera, ...], observations: Observations, pose: RigidTransform
) -> float:
    """Return the mean reprojection error of a pose over all that is seen (eq. 7), pixels."""
    distances = []
    for camera, view in zip(cameras, observations.views, strict=True):
        distance = np.linalg.norm(camera.project(pose @ view.x_mocap) - view.uv, axis=-1)
        distances.append(distance[np.isfinite(distance)])
    return float(np.concatenate(distances).mean())
