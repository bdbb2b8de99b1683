# SPDX-License-Identifier: Apache-2.0
"""10 to 20 frames labelled by hand, one camera, a depth sensor's skeleton: in the wild."""

from __future__ import annotations

import pytest
from hand_labelled import FEWEST, MOST, labelled, outcome

from rpgd_ros.core import CalibrationConfig, Reason

CONFIGS = {'default': CalibrationConfig(), 'thorough': CalibrationConfig.thorough()}


@pytest.mark.parametrize('name', CONFIGS)
@pytest.mark.parametrize('seed', range(4))
def test_few_labels_of_a_walk_give_a_pose_within_its_sigma(seed: int, name: str) -> None:
    """Accepted, the sigma says how far off it is, and is small enough to be of use."""
    case = labelled(seed)
    assert FEWEST <= case.observations.views[0].n_frames <= MOST
    found = outcome(case, CONFIGS[name])
    assert found.is_accepted
    assert found.sigmas < 3.0
    assert found.apart_m < 0.1


@pytest.mark.parametrize('name', CONFIGS)
def test_few_labels_of_somebody_who_stays_are_refused(name: str) -> None:
    """Ten frames of one place are one frame."""
    assert outcome(labelled(0, 'sway'), CONFIGS[name]).reason is Reason.DEGENERATE_MOTION
