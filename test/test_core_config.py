# SPDX-License-Identifier: Apache-2.0
"""Settings are checked where they are made, and the presets are what they are called."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
import pytest

from rpgd_ros.core import CalibrationConfig, InputError, Reason
from rpgd_ros.core.config import AcceptConfig, RansacConfig, RefineConfig, settings_of

STAGES = [
    getattr(CalibrationConfig(), f.name)
    for f in fields(CalibrationConfig)
    if is_dataclass(getattr(CalibrationConfig(), f.name))
]


@pytest.mark.parametrize(
    ('stage', 'values', 'words'),
    [
        (RansacConfig, {'iterations': 0}, 'iterations: 0 is outside 1 to 1e'),
        (RansacConfig, {'threshold_px': -1.0}, 'threshold_px: -1.0 is outside 0 to 500 px'),
        (RansacConfig, {'threshold_px': np.nan}, 'threshold_px: nan is outside'),
        (RansacConfig, {'sampling': 'all'}, "sampling: 'all' is none of same_frame, any_frame"),
        (RefineConfig, {'method': ''}, "method: '' is none of newton, adam, none"),
        (RefineConfig, {'lr_rotation': np.inf}, 'lr_rotation: inf is outside'),
        (AcceptConfig, {'min_inlier_ratio': 1.1}, 'min_inlier_ratio: 1.1 is outside 0 to 1'),
    ],
)
def test_values_out_of_range_are_refused(stage: Any, values: dict[str, Any], words: str) -> None:
    """The message names the setting, what it was, and what it may be."""
    with pytest.raises(InputError, match=words) as refused:
        stage(**values)
    assert refused.value.reason is Reason.BAD_PARAMETER


@pytest.mark.parametrize('stage', STAGES, ids=lambda stage: type(stage).__name__)
def test_every_setting_explains_itself_and_its_default_passes(stage: Any) -> None:
    """One sentence for people, a range that the default lies in, a choice that it is one of."""
    described = list(settings_of(stage))
    assert {f.name for f, _ in described} == {f.name for f in fields(stage)}
    for f, setting in described:
        assert setting.help, f.name
        assert setting.complaint(getattr(stage, f.name)) is None
        if not isinstance(f.default, str | bool):
            assert setting.low > -np.inf, f.name
            assert setting.high < np.inf, f.name


def test_a_stage_is_changed_in_a_copy() -> None:
    """Configurations are values; a change is checked like a new one."""
    plain = CalibrationConfig()
    changed = plain.with_stage('ransac', iterations=7)
    assert changed.ransac.iterations == 7
    assert plain == CalibrationConfig()
    assert changed.refine == plain.refine
    with pytest.raises(InputError, match='iterations: 0'):
        plain.with_stage('ransac', iterations=0)


def test_the_published_preset_is_the_published_method() -> None:
    """Triplets of one instant, inliers counted, Adam on the squared loss; tau may be given."""
    paper = CalibrationConfig.paper(threshold_px=5.0)
    assert (paper.ransac.sampling, paper.ransac.score) == ('same_frame', 'inliers')
    assert (paper.refine.method, paper.refine.loss) == ('adam', 'squared')
    assert paper.ransac.threshold_px == 5.0
