# SPDX-License-Identifier: Apache-2.0
"""A skeleton file as it was read, and as metres and seconds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import numpy as np

from rpgd_ros.core.errors import Reason
from rpgd_ros.core.geometry import Array
from rpgd_ros.importing.text import LONGEST_S, check_span, refuse
from rpgd_ros.importing.timecode import Timecode
from rpgd_ros.io.rig import METRES_PER
from rpgd_ros.skeletons import MAX_JOINTS, landmarks

Axis = Literal['x', 'y', 'z']
AXES: Final[tuple[Axis, ...]] = ('x', 'y', 'z')

# As core refuses them: nothing that is worn or held makes a person 5 m.
SMALLEST_BODY_M, LARGEST_BODY_M = 0.05, 5.0
# Diagonal of a person's joints: 0.5 m for a crouching child, 2.5 m with the arms up.
SMALL_BODY_M, LARGE_BODY_M = 0.5, 2.5
TYPICAL_BODY_M: Final = 1.5
BODY_FRAMES: Final = 200  # looked at for size and axes
SAME_RATE: Final = 0.01  # the ends of 0.1 s of times with three decimals
MIN_FPS, MAX_FPS = 1.0, 2000.0  # the fastest systems give 1000
# The axis that becomes z, after the two that become x and y.
_TURNS: Final[dict[str, Array]] = {
    'x': np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]),
    'y': np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
    'z': np.eye(3),
}


def origin(first_s: float) -> float:
    """Return the second that a recording counts from: 0, or its first where times are dates."""
    return first_s if abs(first_s) > LONGEST_S else 0.0


def frame_rate(time_s: Array) -> float:
    """Return the frames per second of rounded times (T,) that increase, T >= 2; gaps are borne.

    Single steps tell too little: at 120 Hz, times with three decimals are 8 or 9 ms apart. They
    only count the frames of each gap, and the whole span tells the rate.
    """
    step = np.diff(time_s)
    skip = len(step) // 4
    middle = np.sort(step)[skip : len(step) - skip].mean()
    single = step[step < 1.5 * middle].mean()
    n_steps = np.round(step / single).sum()
    with np.errstate(over='ignore'):  # of a span that some damage made tiny
        return float(n_steps / (time_s[-1] - time_s[0]))


@dataclass(frozen=True, slots=True, eq=False)
class SkeletonFile:
    """What a file says, in its own units and axes.

    Attributes:
        path: The file.
        format: Name of its format.
        joints: (J,) names in the file's order.
        time_s: (T,) seconds, increasing.
        values: (T, J, 3) positions; NaN = missing.
        units: That the file states; None = it does not.
        units_line: Where it does, counted from 1; 0 = no line.
        up: Axis that the file says points up; None = it does not.
        notes: What a user should know.
        frame_fps: Rate by which frame numbers were made times; None = the file has times.
        fps_line: Where the rate is stated, counted from 1; 0 = no line.
        joints_line: Where the joints are named, likewise.
        timecode: Of the first frame, that the file states.
        timecode_fps: Its rate, that the file states; '' = it does not.

    """

    path: Path
    format: str
    joints: tuple[str, ...]
    time_s: Array
    values: Array
    units: str | None = None
    units_line: int = 0
    up: Axis | None = None
    notes: tuple[str, ...] = ()
    frame_fps: float | None = None
    fps_line: int = 0
    joints_line: int = 0
    timecode: Timecode | None = None
    timecode_fps: str = ''

    @property
    def fps(self) -> float:
        """Frames per second."""
        return frame_rate(self.time_s)

    def at(self, line: int) -> str:
        """Return the file and, where there is one, the line, for a complaint."""
        return f'{self.path}:{line}' if line else f'{self.path}'


@dataclass(frozen=True, slots=True, eq=False)
class Skeleton:
    """The skeleton of a recording.

    Attributes:
        source: The file.
        time_s: (T,) seconds.
        x_mocap: (T, J, 3) metres; NaN = missing.
        units: That the numbers of the file were taken for.
        up: Axis of the file that was turned to z; None = the axes are the file's.
        standing: Axis of `x_mocap` along which the body stands, such as +z; '' = not known.
        size_m: Median diagonal of the body.
        warnings: What looks wrong.

    """

    source: SkeletonFile
    time_s: Array
    x_mocap: Array
    units: str
    up: Axis | None
    standing: str
    size_m: float
    warnings: tuple[str, ...]

    @property
    def joints(self) -> tuple[str, ...]:
        """(J,) names."""
        return self.source.joints

    @property
    def fps(self) -> float:
        """Frames per second."""
        return frame_rate(self.time_s)


def without_subject(joints: tuple[str, ...]) -> tuple[str, ...]:
    """Return names without that of a subject before a colon, where all have the same."""
    subjects = {name.rpartition(':')[0] for name in joints}
    return tuple(name.rpartition(':')[2] for name in joints) if len(subjects) == 1 else joints


def settle(
    file: SkeletonFile,
    *,
    units: str | None = None,
    up: Axis | None = None,
    fps: float | None = None,
) -> Skeleton:
    """Bring a skeleton file to metres, to seconds and, where asked, to z up.

    Args:
        file: As it was read.
        units: Of its positions; goes before what the file states.
        up: Its axis that points up, to be turned to z; None = keep the axes.
        fps: Its frame rate; goes before the times of the file.

    Raises:
        InputError: WRONG_UNIT where no unit is known or the body has no possible size with it,
            BAD_INPUT for too few frames or joints.

    """
    _check_shape(file)
    check_span(file.path, file.time_s)
    if fps is None:
        _check_rate(file)
    warnings = list(file.notes)
    is_zero = (file.values == 0.0).all(-1)
    values = np.where(is_zero[..., None], np.nan, file.values)
    size = body_size(values)
    if not np.isfinite(size):
        refuse(file.path, None, 'holds no position at all')
    chosen = _chosen_units(file, units, size, warnings)
    size_m = size * METRES_PER[chosen]
    if not SMALL_BODY_M <= size_m <= LARGE_BODY_M:
        warnings.append(
            f'the joints of one frame span {size_m:.3g} m, those of a person 0.5 to 2.5 m: are '
            f'the positions in {chosen}?'
        )
    x = values * METRES_PER[chosen]
    if up is not None:
        x = x @ _TURNS[up].T
        if file.up is not None and file.up != up:
            warnings.append(f'the file says that its {file.up} axis points up, --up says {up}')
    standing = standing_axis(file.joints, x)
    if up is not None and standing and standing != '+z':
        warnings.append(f'with --up {up} the body stands along {standing}, not +z: check --up')
    absent = [n for n, j in zip(file.joints, np.moveaxis(x, 1, 0), strict=True) if _is_empty(j)]
    if absent:
        warnings.append(f'never seen: {", ".join(absent[:20])}')
    time_s = _times(file, fps, warnings)
    check_span(file.path, time_s)
    return Skeleton(file, time_s, x, chosen, up, standing, size_m, tuple(warnings))


def _times(file: SkeletonFile, asked: float | None, warnings: list[str]) -> Array:
    if asked is None:
        return file.time_s
    stated = file.frame_fps or file.fps
    if abs(stated / asked - 1.0) > SAME_RATE:
        warnings.append(
            f'the file states {stated:.4g} Hz, --mocap-fps says {asked:g}: taken as {asked:g}'
        )
    begin_s = origin(float(file.time_s[0]))
    return begin_s + (file.time_s - begin_s) * (stated / asked)


def _check_rate(file: SkeletonFile) -> None:
    n_steps, span_s = len(file.time_s) - 1, float(file.time_s[-1] - file.time_s[0])
    if n_steps > (1.0 + SAME_RATE) * MAX_FPS * span_s:
        msg = f'{n_steps + 1} frames within {span_s:g} s are more than {MAX_FPS:g} Hz: are the '
        refuse(file.path, None, f'{msg}times in seconds? Give the true rate with --mocap-fps')


def _check_shape(file: SkeletonFile) -> None:
    if not 0 < len(file.joints) <= MAX_JOINTS:
        refuse(file.path, None, f'{len(file.joints)} joints, need 1 to {MAX_JOINTS}')
    twice = {name for name in file.joints if file.joints.count(name) > 1}
    if twice:
        refuse(file.path, None, f'joint {min(twice)[:80]!r} comes twice: rename one of them')
    if len(file.time_s) < 2:
        refuse(file.path, None, f'{len(file.time_s)} frames, need at least 2')


def _chosen_units(file: SkeletonFile, asked: str | None, size: float, warnings: list[str]) -> str:
    """Return the unit; refuse one with which nobody would have such a size."""
    likely = min(METRES_PER, key=lambda u: abs(np.log(size * METRES_PER[u] / TYPICAL_BODY_M)))
    chosen = asked or file.units
    if chosen is None:
        msg = (
            f'{file.format} states no unit, and the joints of one frame span {size:.4g} of it: '
            f'give --units (a person would be that large in {likely})'
        )
        refuse(file.path, None, msg, Reason.WRONG_UNIT)
    if asked is not None and file.units is not None and asked != file.units:
        warnings.append(f'the file states {file.units}, --units says {asked}: taken as {asked}')
    size_m = size * METRES_PER[chosen]
    if not SMALLEST_BODY_M <= size_m <= LARGEST_BODY_M:
        said = f'--units {chosen}' if asked else f'the unit {chosen} that the file states'
        msg = f'with {said} the body spans {size_m:.4g} m, a person 0.5 to 2.5 m: give --units'
        line = None if asked else file.units_line
        refuse(file.path, line, f'{msg} {likely}', Reason.WRONG_UNIT)
    return chosen


def _is_empty(values: Array) -> bool:
    return not np.isfinite(values).any()


def _sample(values: Array) -> Array:
    """Return at most 200 frames, those with most of their joints."""
    there = np.isfinite(values).all(-1).sum(1)
    rows = np.flatnonzero(there >= max(1, 0.5 * there.max(initial=0)))
    return values[rows[:: max(1, len(rows) // BODY_FRAMES)]]


def body_size(values: Array) -> float:
    """Return the median diagonal of the box around the joints (T, J, 3); NaN without any."""
    some = _sample(values)
    if not len(some):
        return float('nan')
    extent = np.nanmax(some, 1) - np.nanmin(some, 1)
    return float(np.median(np.linalg.norm(extent, axis=-1)))


def standing_axis(joints: tuple[str, ...], x: Array) -> str:
    """Return the axis from feet to shoulders, such as +z; '' where the names do not tell."""
    index = {mark: j for j, mark in enumerate(landmarks(joints)) if mark is not None}
    parts = {
        part: [index[m] for m in (f'left_{part}', f'right_{part}') if m in index]
        for part in ('shoulder', 'hip', 'knee', 'ankle')
    }
    low = parts['ankle'] or parts['knee']
    high = parts['shoulder'] or parts['hip']
    some = _sample(x)
    if not low or not high or not len(some):
        return ''
    spans = some[:, high].mean(1) - some[:, low].mean(1)
    spans = spans[np.isfinite(spans).all(1)]
    if not len(spans):
        return ''
    span = np.median(spans, axis=0)
    axis = int(np.argmax(np.abs(span)))
    return f'{"+" if span[axis] > 0 else "-"}{AXES[axis]}'
