# SPDX-License-Identifier: Apache-2.0
"""When a trend over time can be told at all."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scenes
from core_cases import sights_of

from rpgd_ros.core.drift import LEAST_BLOCKS, find_drift
from rpgd_ros.core.examine import TIME_BLOCKS, time_blocks
from rpgd_ros.core.geometry import BoolArray
from rpgd_ros.core.linearise import Sight
from rpgd_ros.core.noise_fit import noise_at

CASE = scenes.scene(frames=600, seed=3)
POSE = CASE.truth.world_T_mocap
SIGHTS = sights_of(CASE)
STRETCH = time_blocks(SIGHTS)[0]  # of each frame; all cameras have the same stamps


def hidden(sights: list[Sight], of_frame: BoolArray, n_shown: int = 0) -> list[Sight]:
    """Return the cameras with all but the first joints missing in some frames."""
    out = []
    for s in sights:
        uv = s.view.uv.copy()
        uv[np.ix_(of_frame, np.arange(s.view.n_joints) >= n_shown)] = np.nan
        out.append(Sight(s.camera, replace(s.view, uv=uv)))
    return out


def test_few_stretches_of_time_tell_no_trend() -> None:
    """A person who was there at the beginning and the end only."""
    noise, middle = noise_at(SIGHTS, POSE), np.zeros(3)
    assert find_drift(SIGHTS, POSE, middle, noise) is not None
    n_seen = LEAST_BLOCKS - 1
    absent = (n_seen - 1 <= STRETCH) & (STRETCH < TIME_BLOCKS - 1)
    assert find_drift(hidden(SIGHTS, absent), POSE, middle, noise) is None


def test_stretch_that_shows_a_single_joint_of_one_camera_tells_nothing() -> None:
    """It has no pose of its own, and would pass for one without scatter."""
    noise, middle = noise_at(SIGHTS, POSE), np.zeros(3)
    in_middle = STRETCH == TIME_BLOCKS // 2
    nobody = hidden(SIGHTS, in_middle)
    is_first = np.arange(len(in_middle)) == np.argmax(in_middle)
    one_frame = hidden(SIGHTS[:1], in_middle & ~is_first)
    single = [*hidden(one_frame, is_first, n_shown=1), *nobody[1:]]
    assert single[0].view.seen()[is_first].sum() == 1
    without, with_it = (find_drift(s, POSE, middle, noise) for s in (nobody, single))
    assert without is not None
    assert with_it == without
