# SPDX-License-Identifier: Apache-2.0
"""What was found beside the pose is kept as well, and older files stay readable."""

from __future__ import annotations

import copy
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from test_io_result_file import STAMP_NS, make_calibration, save

from rpgd_ros.core import Calibration, InputError, Reason
from rpgd_ros.core.agreement import Disagreement
from rpgd_ros.core.drift import Drift
from rpgd_ros.core.findings import JointOffset
from rpgd_ros.core.persons import Shown
from rpgd_ros.io.found import FOUND, StoredLevel
from rpgd_ros.io.result_file import read_result, result_text
from rpgd_ros.session.levels import Level, stored_levels

LEVEL = StoredLevel(2.5, 0.1, (0.25, -0.5), 0.2, 0.3)


def full(**changes: Any) -> Calibration:
    """Return a calibration that found everything there is to find."""
    values: dict[str, Any] = {
        'clock_rate': {'cam0': (2.5e-5, 1e-6)},
        'focal_error': {'cam0': (0.011, 0.0005), 'cam1': (-0.0001, 0.0005)},
        'skeleton_scale': (0.02, 0.001),
        'joint_offset_m': {'left_hip': JointOffset((0.01, -0.02, 0.003), (0.001, 0.001, 0.004))},
        'disagreements': (
            Disagreement('cam1', 0.5, 0.013, 0.02, 0.002, 41.0, since_s=9.5),
            Disagreement('cam0', 0.5, 0.013, 0.02, 0.002, 3.0, 'cam1'),
        ),
        'drift': Drift(0.2, 12.0, 0.01, 0.8, 30.0, 60.0),
        'shown': {'cam0': Shown(300, 280, 900)},
        **changes,
    }
    return replace(make_calibration(), **values)


@pytest.fixture
def tree() -> dict[str, Any]:
    """Return the content of a file with everything in it."""
    text = result_text(
        full(), world_frame='w', mocap_frame='m', stamp_ns=STAMP_NS, levels={'cam0': LEVEL}
    )
    found: dict[str, Any] = yaml.safe_load(text)
    return found


def read(tree: dict[str, Any], folder: Path) -> Any:
    """Read a file with this content."""
    (folder / 'r.yaml').write_text(yaml.safe_dump(tree))
    return read_result(folder / 'r.yaml')


def test_everything_that_was_found_reads_back(tree: dict[str, Any], tmp_path: Path) -> None:
    """Clocks, rates, lenses, size, joints, contradictions, persons and levels."""
    found, c = read(tree, tmp_path).found, full()
    for name in FOUND:
        if name != 'levels':
            assert getattr(found, name) == getattr(c, name), name
    assert found.levels == {'cam0': LEVEL}


@settings(derandomize=True, max_examples=30, deadline=None)
@given(values=st.lists(st.floats(-1e3, 1e3), min_size=4, max_size=4))
def test_findings_keep_all_their_digits(
    tmp_path_factory: pytest.TempPathFactory, values: list[float]
) -> None:
    """What is read is what was found, to the last bit."""
    a, b, c, d = values
    path = tmp_path_factory.mktemp('found') / 'r.yaml'
    save(path, full(clock_rate={'cam0': (a, b)}, skeleton_scale=(c, d)))
    found = read_result(path).found
    assert found.clock_rate == {'cam0': (a, b)}
    assert found.skeleton_scale == (c, d)


@pytest.mark.parametrize('key', [key for key in FOUND if key != 'time_offset_s'])
def test_a_file_from_before_is_still_read(tree: dict[str, Any], tmp_path: Path, key: str) -> None:
    """What it does not tell is empty, everything else is there."""
    del tree[key]
    stored = read(tree, tmp_path)
    assert not getattr(stored.found, key)
    assert stored.time_offset_s == {'cam0': (0.0412, 0.0003)}


def test_what_has_no_number_is_left_out(tmp_path: Path) -> None:
    """A clock that nobody could tell makes no file that cannot be read."""
    nothing = (math.nan, math.inf)
    blind = JointOffset((0.0, 0.0, 0.0), (math.inf, math.inf, math.inf))
    odd = Disagreement('cam1', 0.5, 0.013, 0.02, math.inf, 41.0)
    save(
        tmp_path / 'r.yaml',
        full(
            time_offset_s={'cam0': nothing}, focal_error={'cam0': nothing},
            skeleton_scale=nothing, joint_offset_m={'hip': blind}, disagreements=(odd,),
        ),
    )  # fmt: skip
    found = read_result(tmp_path / 'r.yaml').found
    assert not found.time_offset_s
    assert not found.focal_error
    assert found.skeleton_scale is None
    assert not found.joint_offset_m
    assert math.isnan(found.disagreements[0].sigma_m)


@pytest.mark.fault(23)
@pytest.mark.parametrize(
    ('path', 'value', 'message'),
    [
        ('clock_rate.cam0', [1], r'clock_rate\.cam0: need 2 numbers, got 1'),
        ('focal_error', [1], 'focal_error: need a mapping'),
        ('skeleton_scale', 'big', 'skeleton_scale: need a list'),
        ('joint_offset_m.left_hip.xyz', [1, 2], r'left_hip\.xyz: need 3 numbers'),
        ('joint_offset_m.left_hip.sygma', [1, 2], 'unknown key .sygma., did you mean sigma'),
        ('shown.cam0.frames', -1, r'shown\.cam0\.frames: need an integer from 0'),
        ('levels.cam0.error_px', -1.0, r'levels\.cam0\.error_px: -1 is outside'),
        ('drift', [1], 'drift: need a mapping'),
        ('drift.mm_per_min', 'x', r'drift\.mm_per_min: need a number'),
        ('disagreements', {}, 'disagreements: need a list'),
    ],
)
def test_bad_findings_are_refused_with_file_and_key(
    tree: dict[str, Any], tmp_path: Path, path: str, value: object, message: str
) -> None:
    """Nothing is guessed."""
    spoilt = copy.deepcopy(tree)
    *parents, key = path.split('.')
    node = spoilt
    for parent in parents:
        node = node[parent]
    node[key] = value
    with pytest.raises(InputError, match=message) as refused:
        read(spoilt, tmp_path)
    assert refused.value.reason is Reason.BAD_RESULT_FILE


def test_levels_of_an_older_file_are_those_of_its_mean_errors(
    tree: dict[str, Any], tmp_path: Path
) -> None:
    """A camera without a mean error has none; a level that is told in full goes before."""
    told = stored_levels(read(tree, tmp_path))
    assert set(told) == {'cam0'}
    assert not told['cam0'].is_kept
    assert told['cam0'].stored == LEVEL
    del tree['levels']
    older = stored_levels(read(tree, tmp_path))
    assert older['cam0'].is_kept
    assert older['cam0'].error_px == 3.25


def test_a_level_keeps_its_shift() -> None:
    """Both components, in their order."""
    level = Level(2.0, 0.1, np.array([0.5, -1.0]), 0.2, 0.3)
    again = Level.of_stored(level.stored)
    np.testing.assert_array_equal(again.shift_px, level.shift_px)
    assert (again.error_px, again.bias_px) == (2.0, 0.3)
