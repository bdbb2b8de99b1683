# SPDX-License-Identifier: Apache-2.0
"""When each camera began, from timecodes or as it was said."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NoReturn

from rpgd_ros.apps.import_inputs import Inputs
from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.importing import (
    TIMECODE_RATES,
    Skeleton,
    Timecode,
    described,
    is_odd_rate,
    seconds_after,
)


@dataclass(frozen=True, slots=True)
class Clock:
    """How the streams lie on the clock of the skeleton's file.

    Attributes:
        start_s: Time of the skeleton's file at the first frame of a video, where it is known.
        timecode: How timecodes were taken; '' = none was used.
        warnings: What looks wrong.

    """

    start_s: Mapping[str, float]
    timecode: str = ''
    warnings: tuple[str, ...] = ()


def read_clock(inputs: Inputs, skeleton: Skeleton) -> Clock:
    """Return when each camera began.

    Raises:
        InputError: BAD_INPUT. A timecode that is none, or only one side has; no rate for it.

    """
    stated, asked = skeleton.source.timecode, inputs.arguments.mocap_timecode
    if not inputs.timecodes:
        if asked:
            _refuse('--mocap-timecode is of no use without --camera-timecode [CAMERA=]HH:MM:SS:FF')
        if stated is None:
            return Clock(inputs.start_s)
        unused = (
            f'the first frame of the skeleton has timecode {stated.text}, which is not used: give '
            '--camera-timecode, that of the first frame of each video'
        )
        return Clock(inputs.start_s, warnings=(unused,))
    code = Timecode(asked, '--mocap-timecode') if asked else stated
    if code is None:
        _refuse(
            f'{skeleton.source.path}: {skeleton.source.format} states no timecode: give that of '
            'its first frame with --mocap-timecode HH:MM:SS:FF'
        )
    rate, warnings = _rate(inputs, skeleton)
    if asked and stated is not None and asked != stated.text:
        warnings.append(f'the file states timecode {stated.text}, --mocap-timecode says {asked}')
    starts = dict(inputs.start_s)
    for camera in inputs.with_keypoints:
        name = camera.name
        if (name in starts) == (name in inputs.timecodes):
            how = 'both --camera-start and' if name in starts else 'neither --camera-start nor'
            _refuse(f'camera {name} has {how} --camera-timecode: give one, as {name}=VALUE')
        if name in inputs.timecodes:
            own = Timecode(inputs.timecodes[name], f'--camera-timecode of {name}')
            starts[name] = float(skeleton.time_s[0]) + seconds_after(own, code, rate)
            if is_odd_rate(inputs.fps[name], rate):
                warnings.append(
                    f'camera {name} runs at {inputs.fps[name]:g} Hz, its timecode at {rate}: '
                    'check --camera-fps and --timecode-fps'
                )
    return Clock(starts, described(code, rate), tuple(warnings))


def _rate(inputs: Inputs, skeleton: Skeleton) -> tuple[str, list[str]]:
    """Return the rate of the timecode, and what is odd about it."""
    stated, asked = skeleton.source.timecode_fps, inputs.arguments.timecode_fps
    if not asked and not stated:
        _refuse(
            'the rate of the timecode is not known, and it is not always that of the video: give '
            f'--timecode-fps, one of {", ".join(TIMECODE_RATES)}'
        )
    differ = asked and stated and asked != stated
    return asked or stated, (
        [f'the file states timecode at {stated} Hz, --timecode-fps says {asked}'] if differ else []
    )


def _refuse(message: str) -> NoReturn:
    raise InputError(Reason.BAD_INPUT, message)
