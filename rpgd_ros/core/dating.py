# SPDX-License-Identifier: Apache-2.0
"""When a camera was moved, if that happened during the recording."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rpgd_ros.core.agreement import Disagreement, disagreements
from rpgd_ros.core.geometry import Array, RigidTransform
from rpgd_ros.core.linearise import Sight, residuals
from rpgd_ros.core.observations import NS_PER_S
from rpgd_ros.core.refine import appraise

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rpgd_ros.core.noise import NoiseModel

LEAST_FRAMES = 30  # on either side: half a second
LEAST_JOINTS = 4  # in a frame, for a median
LEAST_RISE = 1.4  # of the median residual
LEAST_SIGMAS = 8.0  # of the step, in standard errors of frames that are ten times correlated
CORRELATED = 10.0  # frames that err alike


class Rise(NamedTuple):
    """When the residuals of a camera rose for good.

    Attributes:
        frame: The first of the higher level.
        since_s: The same, seconds after the camera's first frame.
        sigmas: How sure that is.

    """

    frame: int
    since_s: float
    sigmas: float


def moved_meanwhile(
    sights: Sequence[Sight], pose: RigidTransform, centroid_mocap: Array, noise: NoiseModel
) -> Disagreement | None:
    """Name the camera that was moved during the recording, if one was.

    A level that rises may as well be a person who came near. So the camera is taken for two, one
    before and one after, and the latter must contradict all others, the former not.
    """
    rises = [moved_since(s, pose) for s in sights]
    best = max((r for r in rises if r), key=lambda r: r.sigmas, default=None)
    if best is None or len(sights) < 3:
        return None
    v = rises.index(best)
    frames = np.arange(sights[v].view.n_frames)
    before, after = (
        sights[v].at_frames(part) for part in (frames[: best.frame], frames[best.frame :])
    )
    name = sights[v].camera.name
    before = Sight(replace(before.camera, name=f'{name} before'), before.view)
    parts = [*(s for k, s in enumerate(sights) if k != v), before, after]
    seen = appraise(parts, pose, centroid_mocap, noise, threshold_px=noise.threshold_px)
    named = {d.camera: d for d in disagreements(parts, seen, centroid_mocap)}
    if name not in named or before.camera.name in named:
        return None
    return replace(named[name], since_s=best.since_s)


def moved_since(sight: Sight, pose: RigidTransform) -> Rise | None:
    """Find when the residuals of a camera rose for good.

    Args:
        sight: The camera with its skeletons, clocks and joints corrected.
        pose: world_T_mocap, found without this camera.

    Returns:
        None where it was out of place all the time, or no time is known.

    """
    stamp_ns = sight.view.stamp_ns
    if stamp_ns is None:
        return None
    level = _levels(sight, pose)
    known = np.flatnonzero(np.isfinite(level))
    if len(known) < 2 * LEAST_FRAMES:
        return None
    logs = np.log(np.maximum(level[known], 1e-3))
    n = np.arange(1, len(logs))
    before = np.cumsum(logs)[:-1] / n
    after = (logs.sum() - np.cumsum(logs)[:-1]) / (len(logs) - n)
    # Of two levels the split that leaves least scatter.
    gain = n * (len(logs) - n) / len(logs) * (after - before) ** 2
    inside = slice(LEAST_FRAMES - 1, len(logs) - LEAST_FRAMES)
    split = int(np.argmax(gain[inside])) + LEAST_FRAMES - 1
    rise = after[split] - before[split]
    scatter = np.concatenate([logs[: split + 1] - before[split], logs[split + 1 :] - after[split]])
    error = np.std(scatter) * np.sqrt(CORRELATED * len(logs) / (n[split] * (len(logs) - n[split])))
    if rise < np.log(LEAST_RISE) or rise < LEAST_SIGMAS * error:
        return None
    first = int(known[split + 1])
    return Rise(first, float(stamp_ns[first] - stamp_ns[0]) / NS_PER_S, float(rise / error))


def _levels(sight: Sight, pose: RigidTransform) -> Array:
    """(F,) median residual of each frame, pixels; NaN where too few joints are seen."""
    levels = []
    for x, uv in sight.chunks():
        res = residuals(sight.camera, sight.camera_T_world @ pose, x, uv)
        shape = (-1, sight.view.n_joints)
        error = np.where(res.in_view, np.sqrt(res.squared), np.nan).reshape(shape)
        enough = res.in_view.reshape(shape).sum(1) >= LEAST_JOINTS
        level = np.full(len(error), np.nan)
        level[enough] = np.nanmedian(error[enough], axis=1)
        levels.append(level)
    return np.concatenate(levels) if levels else np.empty(0)
