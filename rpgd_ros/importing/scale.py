# SPDX-License-Identifier: Apache-2.0
"""Whether cameras and MoCap give a person the same size: else one has another unit."""

from __future__ import annotations

from itertools import combinations
from typing import Final

import numpy as np

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import Array, IntArray, RigidTransform
from rpgd_ros.importing.plan import CameraPlan, Plan
from rpgd_ros.importing.skeleton import TYPICAL_BODY_M, body_size
from rpgd_ros.io.rig import METRES_PER

FRAMES: Final = 200  # of one camera that are looked at
CAMERAS: Final = 4
SMALLEST_SINE: Final = 0.1  # of the angle between two rays that measure a depth
# Of the depth, between the rays to one joint. Keypoints to 0.7 px: 0.0006, OpenPose's of a
# recorded person 0.005 to 0.015. Of walks before cameras started up to 2 s apart, those
# below it had the body to 0.88 to 1.03 of its size.
MAX_GAP: Final = 0.04
SAME_SIZE: Final = 1.8  # the nearest units are 2.54 apart; noise makes a body larger, not twice


def check_scale(plan: Plan, calibration: str, units: str | None, *, has_own: bool = False) -> None:
    """Refuse a calibration and a skeleton whose units do not belong together.

    Two cameras that see the same person tell how large it is in the unit of their positions. Says
    nothing where their rays do not meet: other faults are found, and named, by the calibration.

    Args:
        plan: What would be written.
        calibration: Its files.
        units: That were asked for it; None = its own, or metres.
        has_own: Whether its format states a unit, so that none can be asked for.

    Raises:
        InputError: WRONG_UNIT.

    """
    posed = [c for c in plan.cameras if c.camera.camera_T_world is not None][:CAMERAS]
    sizes = [size for a, b in combinations(posed, 2) if (size := _size_ratio(plan, a, b)) > 0.0]
    if not sizes:
        return
    ratio = float(np.median(sizes))
    if 1.0 / SAME_SIZE < ratio < SAME_SIZE:
        return
    of_cameras, of_mocap = ratio * plan.skeleton.size_m, plan.skeleton.size_m
    msg = (
        f'{calibration}: the cameras see a body of {of_cameras:.3g} m, the skeleton '
        f'{plan.skeleton.source.path} has {of_mocap:.3g} m'
    )
    is_mocap = abs(np.log(of_cameras / TYPICAL_BODY_M)) < abs(np.log(of_mocap / TYPICAL_BODY_M))
    now = plan.skeleton.units if is_mocap else units or 'm'
    wanted = METRES_PER[now] * (ratio if is_mocap else 1.0 / ratio)
    right = min(METRES_PER, key=lambda u: abs(np.log(METRES_PER[u] / wanted)))
    option = f'give {"--units" if is_mocap else "--camera-units"} {right}'
    if has_own and not is_mocap:
        option = 'or write its cameras with positions in the unit of its format'
    raise InputError(Reason.WRONG_UNIT, f'{msg}: check the unit of both, {option}')


def _size_ratio(plan: Plan, a: CameraPlan, b: CameraPlan) -> float:
    """Return the person's size as two cameras see it by that of the skeleton; 0 = not known."""
    first, second = dict(a.pairs), dict(b.pairs)
    joints = sorted(first.keys() & second.keys())
    rows = np.arange(0, len(a.time_s), max(1, len(a.time_s) // FRAMES))
    middle = 0.5 * (b.time_s[1:] + b.time_s[:-1])
    other = np.searchsorted(middle, a.time_s[rows])
    is_near = np.abs(b.time_s[other] - a.time_s[rows]) < 1.0 / b.fps
    rows, other = rows[is_near], other[is_near]
    if len(rows) < 2 or len(joints) < 2:
        return 0.0
    points, gap = _meet(
        *_rays(a, rows, [first[j] for j in joints]), *_rays(b, other, [second[j] for j in joints])
    )
    if not np.isfinite(gap).any() or np.nanmedian(gap) > MAX_GAP:
        return 0.0
    found = body_size(points) / body_size(plan.skeleton.x_mocap[:, joints])
    return found if np.isfinite(found) else 0.0


def _rays(plan: CameraPlan, rows: IntArray, keypoints: list[int]) -> tuple[Array, Array]:
    """Return the centre (3,) of a camera and the directions (F, J, 3) of keypoints."""
    pose = plan.camera.camera_T_world or RigidTransform.identity()
    uv = plan.detections.uv[rows][:, keypoints]
    if plan.units == 'normalized':
        uv = uv * plan.camera.size
    flat = plan.camera.normalise(uv.reshape(-1, 2)).reshape(uv.shape)
    ray = np.concatenate([flat, np.ones((*flat.shape[:-1], 1))], -1) @ pose.rotation
    return pose.inverse().translation, ray / np.linalg.norm(ray, axis=-1, keepdims=True)


def _meet(c1: Array, d1: Array, c2: Array, d2: Array) -> tuple[Array, Array]:
    """Return where rays are nearest to each other, and how far apart there by their depth."""
    between = c1 - c2
    cosine = (d1 * d2).sum(-1)
    along1, along2 = d1 @ between, d2 @ between
    with np.errstate(invalid='ignore', divide='ignore'):
        sine2 = 1.0 - cosine**2
        depth1 = (cosine * along2 - along1) / sine2
        depth2 = (along2 - cosine * along1) / sine2
        is_good = (sine2 > SMALLEST_SINE**2) & (depth1 > 0.0) & (depth2 > 0.0)
        p1, p2 = c1 + depth1[..., None] * d1, c2 + depth2[..., None] * d2
        gap = np.linalg.norm(p1 - p2, axis=-1) / np.minimum(depth1, depth2)
    return (
        np.where(is_good[..., None], 0.5 * (p1 + p2), np.nan),
        np.where(is_good, gap, np.nan),
    )
