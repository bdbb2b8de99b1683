# SPDX-License-Identifier: Apache-2.0
"""Hand-labelled frames fifty times over: minutes, so not collected by itself.

Run it by name: `pytest test/long_hand_labelled.py`.
"""

from __future__ import annotations

import numpy as np
import pytest
from hand_labelled import labelled, outcome
from test_core_hand_labelled import CONFIGS

from rpgd_ros.simulation.motion import MotionName

pytestmark = pytest.mark.long

SEEDS = 50


@pytest.mark.parametrize('name', CONFIGS)
@pytest.mark.parametrize(
    ('motion', 'seconds'),
    [('walk', 60.0), ('walk', 10.0), ('walk', 4.0), ('walk', 2.0), ('turn_in_place', 60.0)],
)
def test_hand_labels_are_never_wrong_and_accepted(
    motion: MotionName, seconds: float, name: str
) -> None:
    """Accepted within three sigma, or refused; over all that are accepted, sigma is honest."""
    found = [outcome(labelled(seed, motion, seconds), CONFIGS[name]) for seed in range(SEEDS)]
    accepted = np.array([one.sigmas for one in found if one.is_accepted])
    assert not (accepted > 3.0).any()
    if (motion, seconds) == ('walk', 60.0):
        assert len(accepted) > 0.9 * SEEDS
        assert 0.5 < float(np.sqrt((accepted**2).mean())) < 1.5
