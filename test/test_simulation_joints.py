# SPDX-License-Identifier: Apache-2.0
"""The body has a place for every joint of every convention."""

from __future__ import annotations

from itertools import product

import pytest

from rpgd_ros.core.errors import InputError
from rpgd_ros.simulation.joints import landmarks_of
from rpgd_ros.skeletons import CONVENTIONS, MIN_PAIRS, match_joints


@pytest.mark.parametrize('convention', CONVENTIONS)
def test_every_joint_of_a_convention_has_a_place_of_its_own(convention: str) -> None:
    """Two joints at one place would count one observation twice."""
    places = landmarks_of(convention)
    assert len(places) == len(CONVENTIONS[convention]) == len(set(places))


@pytest.mark.parametrize(('one', 'other'), list(product(CONVENTIONS, repeat=2)))
def test_joints_that_are_paired_are_one_point_of_the_body(one: str, other: str) -> None:
    """A simulated pair of joints differs by the bias that was asked for, and by nothing else."""
    pairs = match_joints(CONVENTIONS[one], CONVENTIONS[other])
    assert len(pairs) >= MIN_PAIRS
    for j, k in pairs:
        assert landmarks_of(one)[j] == landmarks_of(other)[k]


def test_unknown_convention_is_refused() -> None:
    """The nearest known one is named."""
    with pytest.raises(InputError, match='coco17'):
        landmarks_of('coco71')
