# SPDX-License-Identifier: Apache-2.0
"""SMPTE timecode: every frame has one number, and numbers that there are not are refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from rpgd_ros.core.errors import InputError
from rpgd_ros.importing.skeleton_files import read_skeleton
from rpgd_ros.importing.timecode import (
    DROPPED,
    RATES,
    Timecode,
    count,
    described,
    is_odd_rate,
    seconds_after,
)

TABLE = 'time,a.x,a.y,a.z\n0,1,2,3\n0.01,1,2,3\n'


def code(text: str, where: str = '--mocap-timecode') -> Timecode:
    """Return a timecode of an option."""
    return Timecode(text, where)


@pytest.mark.parametrize(
    ('text', 'rate', 'frames'),
    [
        ('00:00:00:00', '25', 0),
        ('10:00:00:00', '25', 900_000),
        ('00:01:00:00', '29.97', 1800),
        ('00:00:59;29', '29.97', 1799),
        ('00:01:00;02', '29.97', 1800),
        ('00:10:00;00', '29.97', 17_982),
        ('01:00:00;00', '29.97', 107_892),
        ('01:00:00;00', '59.94', 215_784),
        ('23:59:59;29', '29.97', 2_589_407),
    ],
)
def test_frames_since_midnight_are_those_of_the_standard(
    text: str, rate: str, frames: int
) -> None:
    """Numbers as in SMPTE ST 12-1: 107 892 frames in an hour that drops numbers."""
    assert count(code(text), rate) == frames


@pytest.mark.parametrize('rate', list(DROPPED))
def test_numbers_that_drop_count_every_frame_once(rate: str) -> None:
    """Twelve minutes, one number after the other: no frame is left out or counted twice."""
    dropped = DROPPED[rate]
    frames: list[int] = []
    for minute in range(12):
        for second in range(60):
            first = dropped if second == 0 and minute % 10 else 0
            frames += [
                count(code(f'00:{minute:02}:{second:02};{frame:02}'), rate)
                for frame in range(first, RATES[rate][0])
            ]
    assert frames == list(range(len(frames)))


@pytest.mark.parametrize(
    ('later', 'earlier', 'rate', 'seconds'),
    [
        ('10:00:02:12', '10:00:01:00', '25', 1.48),
        ('10:00:01:00', '10:00:02:12', '25', -1.48),
        ('01:00:00;00', '00:00:00;00', '29.97', 3600 - 0.0036),
        ('01:00:00:00', '00:00:00:00', '29.97', 3603.6),
        ('00:00:01:00', '23:59:59:00', '30', 2.0),
        ('23:59:59;00', '00:00:01;00', '59.94', -2.002),
    ],
)
def test_difference_is_in_true_seconds(
    later: str, earlier: str, rate: str, seconds: float
) -> None:
    """Across midnight too; an hour of numbers is an hour of time only where some are dropped."""
    assert seconds_after(code(later), code(earlier), rate) == pytest.approx(seconds, abs=1e-3)


@pytest.mark.parametrize(
    ('text', 'rate', 'message'),
    [
        ('10:00:00', '25', 'need HH:MM:SS:FF, or HH:MM:SS;FF'),
        ('10:00:00:01.2', '25', 'without subframes'),
        ('24:00:00:00', '25', 'need less than 24 hours'),
        ('10:00:60:00', '25', 'and 60 seconds'),
        ('10:00:00:25', '25', 'frame 25 of a second that has 25 at 25 Hz: check --timecode-fps'),
        ('10:00:00;00', '25', 'dropped at 29.97 and 59.94 Hz only, not at 25: write :'),
        ('10:01:00;01', '29.97', 'this number is dropped: after the full minute comes frame 2'),
        ('10:01:00;03', '59.94', 'comes frame 4'),
    ],
)
def test_timecode_that_cannot_be_is_refused(text: str, rate: str, message: str) -> None:
    """With the option that gave it."""
    with pytest.raises(InputError) as refused:
        count(code(text), rate)
    assert refused.value.message.startswith(f'--mocap-timecode: {text!r}: ')
    assert message in refused.value.message


def test_countings_that_differ_are_not_compared() -> None:
    """Whether numbers are dropped is never guessed."""
    with pytest.raises(InputError, match=r'drops frame numbers .* Write both as the recorders'):
        seconds_after(code('10:00:00;00'), code('10:00:00:00'), '29.97')


@pytest.mark.parametrize(
    ('text', 'rate', 'words'),
    [
        ('10:00:00:00', '29.97', '29.97 Hz, no frame number dropped (as its : says)'),
        ('10:00:00;00', '29.97', '29.97 Hz, frame numbers dropped (as its ; says)'),
        ('10:00:00:00', '25', '25 Hz, no frame number dropped'),
    ],
)
def test_how_it_was_counted_is_said(text: str, rate: str, words: str) -> None:
    """For the list of what was understood."""
    assert described(code(text), rate).endswith(words)


@pytest.mark.parametrize(('fps', 'rate'), [(50.0, '25'), (59.94, '29.97'), (50.0, '50')])
def test_rate_of_a_video_is_a_multiple_of_its_timecode(fps: float, rate: str) -> None:
    """Else one of both is wrong."""
    assert not is_odd_rate(fps, rate)
    assert is_odd_rate(1.2 * fps, rate)


def test_csv_states_the_timecode_of_its_first_frame(tmp_path: Path) -> None:
    """Of the skeleton formats, the one whose layout has it."""
    path = tmp_path / 'walk.csv'
    path.write_text('# timecode: 10:00:00;02\n# timecode_fps: 29.97\n' + TABLE)
    found = read_skeleton(path)
    assert found.timecode == Timecode('10:00:00;02', f'{path}:1: timecode')
    assert found.timecode_fps == '29.97'


@pytest.mark.parametrize(
    ('head', 'message'),
    [
        ('# timecode_fps: 31\n', ":1: timecode_fps '31' is none of 23.976, 24"),
        ('# timecode_fps: 25\n# timecode: 10:00:00:30\n', ':2: timecode: .* has 25 at 25 Hz'),
        ('# timecode_fps: 25\n# timecode: ten\n', ':2: timecode: .* need HH:MM:SS:FF'),
    ],
)
def test_csv_with_a_timecode_that_cannot_be_is_refused(
    tmp_path: Path, head: str, message: str
) -> None:
    """With file, line and what is needed."""
    path = tmp_path / 'walk.csv'
    path.write_text(head + TABLE)
    with pytest.raises(InputError, match=message) as refused:
        read_skeleton(path)
    assert refused.value.message.startswith(str(path))
