# SPDX-License-Identifier: Apache-2.0
"""Skeletons in metres, seconds and known axes: stated or asked for, never guessed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.importing.skeleton import SkeletonFile, frame_rate, settle, standing_axis

JOINTS = ('LHipJC', 'RHipJC', 'LAnkleJC', 'RAnkleJC', 'LShoulderJC', 'RShoulderJC')
BODY = np.array([
    [0.1, 0.0, 0.9], [-0.1, 0.0, 0.9], [0.1, 0.1, 0.1], [-0.1, 0.1, 0.1],
    [0.2, 0.0, 1.5], [-0.2, 0.0, 1.5],
])  # fmt: skip


def make_file(metres_per_unit: float = 1.0, **changes: Any) -> SkeletonFile:
    """Return a file with a standing body of 1.5 m in some unit."""
    values = np.tile(BODY / metres_per_unit, (10, 1, 1))
    time_s = np.arange(10) / 50.0
    file = SkeletonFile(Path('walk.trc'), 'TRC', JOINTS, time_s, values, 'm', 3)
    return replace(file, **changes)


@pytest.mark.parametrize(
    ('units', 'scale'), [('m', 1.0), ('cm', 0.01), ('mm', 0.001), ('inch', 0.0254)]
)
def test_positions_become_metres(units: str, scale: float) -> None:
    """From the unit that the file states, or from the one asked for."""
    for file, asked in ((make_file(scale, units=units), None), (make_file(scale), units)):
        found = settle(file, units=asked)
        np.testing.assert_allclose(found.x_mocap[0], BODY, atol=1e-12)
        assert found.units == units
        assert found.size_m == pytest.approx(1.46, abs=0.05)


def test_unit_that_nobody_states_is_asked_for() -> None:
    """With the one in which a person would have that size."""
    with pytest.raises(InputError, match=r'walk.trc: TRC states no unit.*give --units .*in cm'):
        settle(make_file(0.01, units=None))


@pytest.mark.parametrize(
    ('scale', 'asked', 'message'),
    [
        (0.001, None, r'walk.trc:3: with the unit m that the file states .*give --units mm'),
        (1.0, 'mm', r'walk.trc: with --units mm the body spans 0.001.*give --units m'),
    ],
)
def test_unit_with_which_nobody_has_such_a_size_is_refused(
    scale: float, asked: str | None, message: str
) -> None:
    """The line is named where the file states it."""
    with pytest.raises(InputError, match=message) as refused:
        settle(make_file(scale), units=asked)
    assert refused.value.reason is Reason.WRONG_UNIT


def test_unit_that_contradicts_the_file_is_taken_and_said() -> None:
    """Some exports write m over millimetres."""
    found = settle(make_file(0.001), units='mm')
    assert 'the file states m, --units says mm: taken as mm' in found.warnings


def test_odd_size_is_said() -> None:
    """A body of 0.2 m may be a hand."""
    small = replace(make_file(), values=0.15 * make_file().values)
    assert 'span 0.2' in settle(small).warnings[0]


@pytest.mark.parametrize(('up', 'order'), [('x', (2, 0, 1)), ('y', (0, 2, 1)), ('z', (0, 1, 2))])
def test_axis_that_points_up_becomes_z_by_a_rotation(up: Any, order: tuple[int, ...]) -> None:
    """Never by a mirror image."""
    turned = BODY[:, order]
    if up == 'y':
        turned = turned * [1, 1, -1]
    file = replace(make_file(), values=np.tile(turned, (10, 1, 1)))
    found = settle(file, up=up)
    np.testing.assert_allclose(found.x_mocap[0], BODY, atol=1e-12)
    assert found.standing == '+z'
    assert found.warnings == ()


def test_axes_stay_as_they_are_unless_asked_for() -> None:
    """The transform that is sought belongs to the frame of the file."""
    file = replace(make_file(), values=make_file().values[..., [0, 2, 1]], up='y')
    found = settle(file)
    np.testing.assert_array_equal(found.x_mocap, file.values)
    assert found.standing == '+y'


def test_axis_that_contradicts_file_and_body_is_said() -> None:
    """Taken all the same: the body may lie."""
    found = settle(make_file(up='z'), up='y')
    assert found.warnings[0] == 'the file says that its z axis points up, --up says y'
    assert 'with --up y the body stands along -y, not +z' in found.warnings[1]


def test_rate_that_is_asked_for_stretches_the_times() -> None:
    """Gaps stay gaps."""
    time_s = np.array([0.0, 1, 2, 3, 4, 5, 6, 7, 8, 12]) / 50.0 + 0.2
    found = settle(make_file(time_s=time_s), fps=100.0)
    np.testing.assert_allclose(found.time_s, time_s / 2.0)
    assert found.fps == pytest.approx(100.0)
    assert found.warnings == ('the file states 50 Hz, --mocap-fps says 100: taken as 100',)
    assert settle(make_file(), fps=50.0).warnings == ()


@pytest.mark.parametrize('jitter_ms', [1, 4, 10])
def test_rate_of_times_that_tremble_is_their_mean(jitter_ms: int) -> None:
    """As a Kinect's, which come when the computer has time for them; some are lost."""
    rng = np.random.default_rng(1)
    frames = np.delete(np.arange(3000), rng.integers(1, 2999, 60))
    time_s = frames / 30.0 + rng.uniform(-0.001, 0.001, len(frames)) * jitter_ms
    assert frame_rate(time_s) == pytest.approx(30.0, rel=1e-3)


def test_zeros_are_missing_and_joints_without_data_are_said() -> None:
    """Motion capture writes 0 0 0 for what it lost."""
    values = make_file().values.copy()
    values[2, 1] = 0.0
    values[:, 0] = np.nan
    found = settle(make_file(values=values))
    assert np.isnan(found.x_mocap[2, 1]).all()
    assert 'never seen: LHipJC' in found.warnings


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'joints': (*JOINTS[:5], 'LHipJC')}, "joint 'LHipJC' comes twice"),
        ({'joints': ()}, '0 joints, need 1 to 256'),
        ({'time_s': np.zeros(1)}, '1 frames, need at least 2'),
        (
            {'time_s': np.array([*range(9), 1e5])},
            'time 100000 s is more than a day .86400 s. after',
        ),
        ({'time_s': np.array([-1e308, *range(8), 1e308])}, 'time 0 s is more than a day'),
        ({'time_s': np.arange(10) * 5e-324}, r'10 frames within .* Hz: are the times in seconds'),
        ({'time_s': np.arange(10) / 1e6}, '10 frames within 9e-06 s are more than 2000 Hz'),
        ({'values': np.full((10, 6, 3), np.nan)}, 'holds no position at all'),
    ],
)
def test_file_without_a_usable_skeleton_is_refused(changes: dict[str, Any], message: str) -> None:
    """Before anything is made of it."""
    with pytest.raises(InputError, match=message):
        settle(make_file(**changes))


def test_rate_that_makes_a_recording_last_for_days_is_refused() -> None:
    """The option may be as wrong as the file."""
    time_s = np.array([*range(9), 80_000.0]) / 50.0
    with pytest.raises(InputError, match=r'walk.trc: time \S+ s is more than a day'):
        settle(make_file(time_s=50.0 * time_s, frame_fps=50.0), fps=1.0)


def test_standing_axis_is_unknown_for_unknown_names() -> None:
    """Markers have names of their own."""
    assert standing_axis(('A', 'B'), np.ones((3, 2, 3))) == ''
