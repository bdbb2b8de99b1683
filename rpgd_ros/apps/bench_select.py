# SPDX-License-Identifier: Apache-2.0
"""Correspondences as the peers of the benchmark want them: without gaps, or only some of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rpgd_ros.core import Observations, View
from rpgd_ros.core.geometry import Array


def selected(observations: Observations) -> list[tuple[Array, Array]]:
    """Return per camera its keypoints (n, 2), pixels, and joints (n, 3), metres, without NaN."""
    masks = [view.seen() for view in observations.views]
    return [
        (view.uv[seen], view.x_mocap[seen])
        for view, seen in zip(observations.views, masks, strict=True)
    ]


def evenly(observations: Observations, wanted: int) -> Observations:
    """Return evenly spread frames that hold about `wanted` correspondences over all cameras."""
    count = sum(int(view.seen().sum()) for view in observations.views)
    share = min(1.0, wanted / max(count, 1))
    views = []
    for view in observations.views:
        n_frames = view.n_frames
        keep = min(n_frames, max(4, round(share * n_frames)))
        frames = np.unique(np.linspace(0, n_frames - 1, keep).round().astype(int))
        views.append(View(None, view.x_mocap[frames], view.uv[frames]))
    return replace(observations, views=tuple(views), mocap=None)
