# SPDX-License-Identifier: Apache-2.0
"""SMPTE timecode: how long after another one a frame was taken."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, NoReturn

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.importing.text import shown

# Frames that a second counts, and how many there are in a true one (SMPTE ST 12-1).
RATES: Final[Mapping[str, tuple[int, float]]] = {
    '23.976': (24, 24000 / 1001),
    '24': (24, 24.0),
    '25': (25, 25.0),
    '29.97': (30, 30000 / 1001),
    '30': (30, 30.0),
    '47.952': (48, 48000 / 1001),
    '48': (48, 48.0),
    '50': (50, 50.0),
    '59.94': (60, 60000 / 1001),
    '60': (60, 60.0),
}
# Frame numbers that each minute but every tenth leaves out.
DROPPED: Final[Mapping[str, int]] = {'29.97': 2, '59.94': 4}
LAYOUT: Final = re.compile(r'(\d\d):(\d\d):(\d\d)([:;])(\d\d)')
MULTIPLE: Final = 0.005  # of a rate and its NTSC neighbour: 0.001


@dataclass(frozen=True, slots=True)
class Timecode:
    """A timecode as it was stated.

    Attributes:
        text: Such as 10:00:00:00, or 10:00:00;00 where frame numbers are dropped.
        where: Option, or file and line, for complaints.

    """

    text: str
    where: str

    @property
    def is_dropping(self) -> bool:
        """Whether frame numbers are dropped, as its semicolon says."""
        return ';' in self.text

    def refuse(self, message: str) -> NoReturn:
        """Raise an InputError: BAD_INPUT, naming where it was stated."""
        raise InputError(Reason.BAD_INPUT, f'{self.where}: {shown(self.text)}: {message}')


def count(code: Timecode, rate: str) -> int:
    """Return the frames from midnight to a timecode.

    Args:
        code: The timecode.
        rate: A key of `RATES`.

    Raises:
        InputError: BAD_INPUT. No timecode, or none that exists at this rate.

    """
    found = LAYOUT.fullmatch(code.text)
    if found is None:
        msg = (
            'need HH:MM:SS:FF, or HH:MM:SS;FF for a timecode that drops frame numbers, without '
            'subframes'
        )
        code.refuse(msg)
    hours, minutes, seconds, frame = (int(found[i]) for i in (1, 2, 3, 5))
    n = RATES[rate][0]
    if hours > 23 or minutes > 59 or seconds > 59:
        code.refuse('need less than 24 hours, 60 minutes and 60 seconds')
    if frame >= n:
        msg = f'frame {frame} of a second that has {n} at {rate} Hz: check --timecode-fps'
        code.refuse(msg)
    total_minutes = 60 * hours + minutes
    frames = (60 * total_minutes + seconds) * n + frame
    if not code.is_dropping:
        return frames
    if rate not in DROPPED:
        msg = f'frame numbers are dropped at {" and ".join(DROPPED)} Hz only, not at {rate}: '
        code.refuse(f'{msg}write : or check --timecode-fps')
    dropped = DROPPED[rate]
    if seconds == 0 and frame < dropped and minutes % 10:
        msg = f'this number is dropped: after the full minute comes frame {dropped}'
        code.refuse(msg)
    return frames - dropped * (total_minutes - total_minutes // 10)


def seconds_after(code: Timecode, other: Timecode, rate: str) -> float:
    """Return how long after another timecode one comes, less than half a day either way.

    Raises:
        InputError: BAD_INPUT. As `count`; or only one of them drops frame numbers.

    """
    frames = count(code, rate) - count(other, rate)
    if code.is_dropping != other.is_dropping:
        msg = (
            f'one of it and {other.text} ({other.where}) drops frame numbers (;) and the other '
            'does not (:): they cannot be compared. Write both as the recorders counted'
        )
        code.refuse(msg)
    day = count(Timecode(f'23:59:59{code.text[8]}{RATES[rate][0] - 1}', ''), rate) + 1
    return ((frames + day // 2) % day - day // 2) / RATES[rate][1]


def described(code: Timecode, rate: str) -> str:
    """Return how a timecode of the skeleton was taken, for people."""
    counting = 'frame numbers dropped' if code.is_dropping else 'no frame number dropped'
    why = f' (as its {code.text[8]} says)' if rate in DROPPED else ''
    return f'{code.text} at the first frame of the skeleton, {rate} Hz, {counting}{why}'


def is_odd_rate(fps: float, rate: str) -> bool:
    """Whether neither a video's rate nor its timecode's is a multiple of the other."""
    ratio = max(fps / RATES[rate][1], RATES[rate][1] / fps)
    return abs(ratio / round(ratio) - 1.0) > MULTIPLE
