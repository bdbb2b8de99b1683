# SPDX-License-Identifier: Apache-2.0
"""The figures of several solves as those of one rig."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from rpgd_ros.core.geometry import RigidTransform
from rpgd_ros.core.result import Calibration, GroupFit

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from rpgd_ros.core.camera_pose import CameraPose


def mocap_is_world(
    alone: Mapping[str, Calibration],
    poses: Mapping[str, CameraPose],
    told: Sequence[str],
    order: Sequence[str],
) -> Calibration:
    """Return the calibration of a rig whose world is the MoCap frame.

    Args:
        alone: Solve of each camera by itself, at least one.
        poses: Extrinsics that follow from them.
        told: Further warnings.
        order: Names of all cameras, as the caller has them.

    Returns:
        Sums over the cameras. `median_px` and `p95_px` are the means of theirs and the inlier
        threshold the largest. The pose is the identity, known exactly.

    """
    solves = list(alone.values())
    weight = np.array([max(s.correspondences, 1) for s in solves], np.float64)

    def mean(name: str) -> float:
        return float(np.average([getattr(s, name) for s in solves], weights=weight))

    inliers = sum(s.inliers for s in solves)
    correspondences = sum(s.correspondences for s in solves)
    whole = Calibration(
        world_T_mocap=RigidTransform.identity(),
        covariance=np.zeros((6, 6)),
        mpjpe_px=mean('mpjpe_px'),
        median_px=mean('median_px'),
        p95_px=mean('p95_px'),
        inlier_ratio=inliers / max(correspondences, 1),
        inliers=inliers,
        correspondences=correspondences,
        frames=max(s.frames for s in solves),
        threshold_px=max(s.threshold_px for s in solves),
        centroid_mocap=np.average([s.centroid_mocap for s in solves], axis=0, weights=weight),
        per_camera={},
        per_joint=_per_joint(solves),
        config=solves[0].config,
    )
    return with_placed(whole, alone, poses, told, order)


def with_placed(
    rig: Calibration,
    alone: Mapping[str, Calibration],
    poses: Mapping[str, CameraPose],
    told: Sequence[str],
    order: Sequence[str],
) -> Calibration:
    """Add cameras that were placed to a calibration.

    Arguments as for `mocap_is_world`; `rig` is that of the cameras with extrinsics.

    """
    fits = dict(rig.per_camera)
    offsets, rates = dict(rig.time_offset_s), dict(rig.clock_rate)
    focal = dict(rig.focal_error)
    for own in alone.values():
        fits |= own.per_camera
        offsets |= own.time_offset_s
        rates |= own.clock_rate
        focal |= own.focal_error
    return replace(
        rig,
        camera_poses={name: poses[name] for name in order if name in poses},
        per_camera={name: fits[name] for name in order if name in fits},
        time_offset_s={name: offsets[name] for name in order if name in offsets},
        clock_rate={name: rates[name] for name in order if name in rates},
        focal_error={name: focal[name] for name in order if name in focal},
        warnings=(*rig.warnings, *_warnings(rig, alone), *told),
    )


def _warnings(rig: Calibration, alone: Mapping[str, Calibration]) -> list[str]:
    """Return what the solves warn of: what concerns all once, the rest with the camera's name."""
    counts = Counter(w for own in alone.values() for w in own.warnings)
    counts += Counter(rig.warnings)
    common = [w for w in counts if counts[w] > 1 and w not in rig.warnings]
    return common + [
        w if re.search(rf'(?<!\w){re.escape(name)}(?!\w)', w) else f'camera {name}: {w}'
        for name, own in alone.items()
        for w in own.warnings
        if counts[w] == 1
    ]


def _per_joint(solves: Sequence[Calibration]) -> dict[str, GroupFit]:
    """Sum the fits of each joint over the cameras."""
    return {name: _summed([s.per_joint[name] for s in solves]) for name in solves[0].per_joint}


def _summed(fits: Sequence[GroupFit]) -> GroupFit:
    n, n_in = sum(f.correspondences for f in fits), sum(f.inliers for f in fits)
    seen = [f for f in fits if f.correspondences]
    agree = [f for f in fits if f.inliers]

    def mean(values: Sequence[float], counts: Sequence[int]) -> float:
        return float(np.average(values, weights=counts)) if values else float('nan')

    n_agree = [f.inliers for f in agree]
    return GroupFit(
        fits[0].name,
        n,
        n_in,
        mean([f.mpjpe_px for f in seen], [f.correspondences for f in seen]),
        mean([f.inlier_mpjpe_px for f in agree], n_agree),
        (
            mean([f.bias_px[0] for f in agree], n_agree),
            mean([f.bias_px[1] for f in agree], n_agree),
        ),
    )
