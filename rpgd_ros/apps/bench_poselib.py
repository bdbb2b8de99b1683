# SPDX-License-Identifier: Apache-2.0
"""PoseLib's generalized absolute pose, tuned by hand: the strongest peer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import poselib

from rpgd_ros.apps.bench_select import evenly, selected
from rpgd_ros.core import Camera, Observations, RigidTransform
from rpgd_ros.core.geometry import Array


class _Rig(NamedTuple):
    """Correspondences per camera in the order of PoseLib's arguments."""

    uv: list[Array]
    x: list[Array]
    camera_T_world: list[Any]
    cameras: list[dict[str, Any]]


def fast(
    cameras: Sequence[Camera], observations: Observations, *, threshold_px: float
) -> RigidTransform:
    """RANSAC of at least 50 draws on 1500 correspondences; Cauchy's loss on all."""
    start = _start(cameras, evenly(observations, 1500), threshold_px, {'min_iterations': 50})
    loss = {'loss_type': 'CAUCHY', 'loss_scale': threshold_px / 3.0}
    return _refine(cameras, observations, start, loss)


def truncated(
    cameras: Sequence[Camera], observations: Observations, *, threshold_px: float
) -> RigidTransform:
    """RANSAC on 5000 correspondences; the loss truncated at the threshold on all."""
    start = _start(cameras, evenly(observations, 5000), threshold_px, {})
    loss = {'loss_type': 'TRUNCATED', 'loss_scale': threshold_px}
    return _refine(cameras, observations, start, loss)


def _start(
    cameras: Sequence[Camera],
    observations: Observations,
    threshold_px: float,
    ransac: Mapping[str, Any],
) -> Any:
    pose, _ = poselib.estimate_generalized_absolute_pose(
        *_rig(cameras, observations),
        {'max_reproj_error': threshold_px, **ransac},
        {'loss_type': 'CAUCHY', 'loss_scale': threshold_px / 3.0},
    )
    return pose


def _refine(
    cameras: Sequence[Camera], observations: Observations, start: Any, loss: Mapping[str, Any]
) -> RigidTransform:
    rig = _rig(cameras, observations)
    pose, _ = poselib.refine_generalized_absolute_pose(
        rig.uv, rig.x, start, rig.camera_T_world, rig.cameras, dict(loss)
    )
    return RigidTransform(np.asarray(pose.R), np.asarray(pose.t))


def _rig(cameras: Sequence[Camera], observations: Observations) -> _Rig:
    """Return what PoseLib takes; a camera that saw nothing is left out."""
    rig = _Rig([], [], [], [])
    for camera, (uv, x) in zip(cameras, selected(observations), strict=True):
        if len(uv):
            rig.uv.append(uv)
            rig.x.append(x)
            rig.camera_T_world.append(_pose(camera.camera_T_world or RigidTransform.identity()))
            rig.cameras.append(_camera(camera))
    return rig


def _pose(transform: RigidTransform) -> Any:
    pose = poselib.CameraPose()
    pose.R, pose.t = transform.rotation, transform.translation
    return pose


def _camera(camera: Camera) -> dict[str, Any]:
    width, height = camera.size
    params = list(camera.pinhole)
    if not camera.distortion.any():
        return {'model': 'PINHOLE', 'width': width, 'height': height, 'params': params}
    params += [*camera.distortion, *[0.0] * (8 - len(camera.distortion))]
    return {'model': 'FULL_OPENCV', 'width': width, 'height': height, 'params': params}
