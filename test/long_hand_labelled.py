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
def test_labels_of_a_minute_are_never_wrong_and_accepted(name: str) -> None:
    """All within three sigma, nearly all accepted, and sigma neither too small nor too large."""
    found = [outcome(labelled(seed), CONFIGS[name]) for seed in range(SEEDS)]
    accepted = np.array([one.sigmas for one in found if one.is_accepted])
    assert len(accepted) > 0.9 * SEEDS
    assert accepted.max() < 3.0
    assert 0.5 < float(np.sqrt((accepted**2).mean())) < 1.5


@pytest.mark.parametrize('name', CONFIGS)
@pytest.mark.parametrize('motion', ['sway', 'turn_in_place'])
def test_labels_of_somebody_who_stays_are_refused_or_within_sigma(
    motion: MotionName, name: str
) -> None:
    """At most one of 50 accepted beyond three sigma, none beyond four."""
    found = [outcome(labelled(seed, motion), CONFIGS[name]) for seed in range(SEEDS)]
    sigmas = np.array([one.sigmas for one in found if one.is_accepted])
    assert (sigmas > 3.0).sum() <= 1
    assert not (sigmas > 4.0).any()


@pytest.mark.parametrize(
    ('name', 'seconds'),
    [
        ('default', 10.0),
        ('default', 4.0),
        ('default', 2.0),
        ('thorough', 10.0),
        ('thorough', 4.0),
        ('thorough', 2.0),
    ],
)
def test_labels_of_a_few_seconds_are_refused_or_within_sigma(name: str, seconds: float) -> None:
    """Frames of a short walk say less: one of 50 accepted beyond three sigma, none beyond four."""
    found = [outcome(labelled(seed, 'walk', seconds), CONFIGS[name]) for seed in range(SEEDS)]
    sigmas = np.array([one.sigmas for one in found if one.is_accepted])
    assert (sigmas > 3.0).sum() <= 1
    assert not (sigmas > 4.0).any()
