# SPDX-License-Identifier: Apache-2.0
"""Sweeps over many recordings: minutes, so not collected by itself.

Run it by name: `pytest test/long_core.py`.
"""

from __future__ import annotations

from collections import Counter

import pytest
from core_cases import far_away
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scenes import errors, scene
from test_core_faults import BASE_CONFIG, PLACE, check_damage

from rpgd_ros.core import CalibrationError, Reason, calibrate
from rpgd_ros.simulation import Twin
from rpgd_ros.simulation.motion import MotionName
from rpgd_ros.simulation.presets import OutlierKind

pytestmark = pytest.mark.long


def outcome(case: Twin) -> tuple[Reason | None, bool]:
    """Return why it was refused, and whether it was accepted beyond three sigma."""
    try:
        found = calibrate(case.cameras, case.observations)
    except CalibrationError as refused:
        return refused.reason, False
    angle_deg, shift_m = errors(found.world_T_mocap, case.truth.world_T_mocap, case.observations)
    sigma_deg, sigma_m = found.worst_sigma
    return None, angle_deg > 3.0 * sigma_deg or shift_m > 3.0 * sigma_m


@pytest.mark.fault(11)
@settings(max_examples=300, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(PLACE, min_size=1, max_size=200))
def test_any_numbers_anywhere_at_length(hits: list[tuple[bool, int, float]]) -> None:
    """Three hundred recordings with up to two hundred damaged numbers each."""
    check_damage(hits, BASE_CONFIG)


@pytest.mark.fault(29)
@pytest.mark.parametrize(
    'kind',
    [
        'uniform',
        'person',
        'failure',
        'mixed',
        'swap',
    ],
)
def test_nothing_but_outliers_is_refused_a_hundred_times(kind: OutlierKind) -> None:
    """100 of 100, over three rigs, or right where midline joints of swapped views are left."""
    shapes = ['human36m', 'kinect', 'aistpp']
    for seed in range(100):
        reason, is_wrong = outcome(
            scene(shapes[seed % 3], 100, seed, outlier_ratio=1.0, kind=kind)
        )
        assert reason is not None or (kind == 'mixed' and not is_wrong)


@pytest.mark.fault(26)
@pytest.mark.parametrize('motion', ['still', 'turn_in_place', 'sway', 'walk'])
@pytest.mark.parametrize('distance_m', [3.3, 5.0, 10.0])
@pytest.mark.parametrize('bias_px', [0.0, 3.0])
def test_one_camera_is_never_surer_than_right(
    motion: MotionName, distance_m: float, bias_px: float
) -> None:
    """Accepted beyond three sigma in at most 2 of 100; standing still is always refused."""
    results = [
        outcome(far_away(seed, distance_m, motion=motion, bias_px=bias_px)) for seed in range(100)
    ]
    assert sum(is_wrong for _, is_wrong in results) <= 2
    if motion in {'still', 'sway'}:
        assert Counter(reason for reason, _ in results) == {Reason.DEGENERATE_MOTION: 100}
