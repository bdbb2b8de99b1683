# SPDX-License-Identifier: Apache-2.0
"""Pairing: a skeleton for every camera stamp, as a pure function of the two tracks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rpgd_ros.core.geometry import Array, IntArray
from rpgd_ros.core.observations import NS_PER_S, View
from rpgd_ros.pairing.config import SyncConfig
from rpgd_ros.pairing.store import Samples


class Match(NamedTuple):
    """Which skeletons belong to which camera frames.

    Attributes:
        row: (P,) camera frames that have a skeleton.
        stamp_ns: (P,) their instants on the MoCap's clock.
        before: (P,) MoCap frame at or before the instant.
        after: (P,) MoCap frame at or after it; the same frame where no interpolation is needed.
        weight: (P,) share of `after`, 0 to 1.

    """

    row: IntArray
    stamp_ns: IntArray
    before: IntArray
    after: IntArray
    weight: Array


class PairCounts(NamedTuple):
    """What became of a camera's frames: with a skeleton, and without."""

    paired: int
    no_match: int


def match(
    mocap_ns: IntArray,
    camera_ns: IntArray,
    *,
    settings: SyncConfig,
    time_offset_s: float = 0.0,
) -> Match:
    """Find the skeletons around each camera stamp.

    Args:
        mocap_ns: (M,) strictly increasing.
        camera_ns: (F,) strictly increasing.
        settings: Interpolate or take the nearest, and the longest times for either.
        time_offset_s: How late the video is stamped: mocap time = video stamp - offset.

    """
    instant = camera_ns - round(time_offset_s * NS_PER_S)
    if not len(mocap_ns):
        none = np.empty(0, np.int64)
        return Match(none, none, none, none, np.empty(0))
    after = np.searchsorted(mocap_ns, instant)
    last = len(mocap_ns) - 1
    after_ns = mocap_ns[np.minimum(after, last)]
    before = np.where((after <= last) & (after_ns == instant), after, after - 1)
    before_ns = mocap_ns[np.maximum(before, 0)]
    if settings.interpolate:
        good = (before >= 0) & (after <= last)
        good &= after_ns - before_ns <= round(settings.max_gap * NS_PER_S)
    else:
        to_before = np.where(before >= 0, instant - before_ns, np.iinfo(np.int64).max)
        to_after = np.where(after <= last, after_ns - instant, np.iinfo(np.int64).max)
        before = after = np.where(to_before <= to_after, before, after)
        before_ns = after_ns = mocap_ns[np.clip(before, 0, last)]
        good = np.minimum(to_before, to_after) <= round(settings.max_dt * NS_PER_S)
    row = np.flatnonzero(good)
    gap = (after_ns - before_ns)[row]
    weight = (instant - before_ns)[row] / np.where(gap > 0, gap, 1)
    weight[gap == 0] = 0.0
    return Match(row, instant[row], before[row], after[row], weight)


def pair(
    mocap: Samples,
    camera: Samples,
    *,
    settings: SyncConfig,
    time_offset_s: float = 0.0,
) -> tuple[View, PairCounts]:
    """Give each camera frame the skeleton of its instant.

    A joint that is missing in one of the two skeletons of an interpolation is missing.

    Args:
        mocap: Skeletons (M, J, 3), metres.
        camera: Keypoints (F, J, 2), pixels, of the same joints.
        settings: Interpolate or take the nearest, and the longest times for either.
        time_offset_s: How late the video is stamped: mocap time = video stamp - offset.

    Returns:
        The frames that found a skeleton, stamped on the MoCap's clock, and how many did.

    """
    found = match(mocap.stamp_ns, camera.stamp_ns, settings=settings, time_offset_s=time_offset_s)
    x_mocap = mocap.values.take(found.before, axis=0)
    if found.weight.any():
        step = mocap.values.take(found.after, axis=0)
        with np.errstate(invalid='ignore', over='ignore'):  # infinite and huge numbers end here
            step -= x_mocap
            step *= found.weight[:, None, None]
            x_mocap += step
    scores = None if camera.confidence is None else camera.confidence.take(found.row, axis=0)
    view = View(found.stamp_ns, x_mocap, camera.values.take(found.row, axis=0), scores)
    return view, PairCounts(len(found.row), len(camera.stamp_ns) - len(found.row))
