# SPDX-License-Identifier: Apache-2.0
"""BVH (Biovision hierarchy): rotations of bones, made into positions by forward kinematics."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from rpgd_ros.core.geometry import Array
from rpgd_ros.importing.skeleton import MAX_FPS, SkeletonFile
from rpgd_ros.importing.text import number, numbers, read_lines, refuse, shown
from rpgd_ros.skeletons import MAX_JOINTS

FORMAT: Final = 'BVH'
AXES: Final = 'XYZ'
CHANNELS: Final = tuple(f'{a}{kind}' for kind in ('position', 'rotation') for a in AXES)
MAX_FRAME_TIME_S: Final = 1.0

Line = tuple[int, list[str]]


@dataclass(slots=True, eq=False)
class _Joint:
    """A joint of the hierarchy.

    Attributes:
        name: Of the joint.
        parent: Index; -1 = root.
        offset: (3,) from its parent, file units.
        channels: Names in the order of the file.
        first: Column of the first channel.

    """

    name: str
    parent: int
    offset: Array = field(default_factory=lambda: np.zeros(3))
    channels: tuple[str, ...] = ()
    first: int = 0

    @property
    def has_positions(self) -> bool:
        """Whether some channels are positions."""
        return any(c.endswith('position') for c in self.channels)


def read_bvh(path: Path) -> SkeletonFile:
    """Read a BVH file: the joints without the end sites, which have no name.

    Rotations are applied in the order of the channels. The position channels of the root are added
    to its offset, as the format was published; those of other joints stand for the offset, as the
    programs that write them mean it.

    Raises:
        InputError: BAD_INPUT, naming file and line.

    """
    lines = ((i, words) for i, line in enumerate(read_lines(path), 1) if (words := line.split()))
    line, words = _next(path, lines)
    if words != ['HIERARCHY']:
        refuse(path, line, 'no BVH file: need HIERARCHY in its first line')
    joints = _hierarchy(path, lines)
    frame_s, fps_line, table = _motion(path, lines, sum(len(j.channels) for j in joints))
    return SkeletonFile(
        path,
        FORMAT,
        tuple(j.name for j in joints),
        frame_s * np.arange(len(table), dtype=np.float64),
        _positions(joints, table),
        notes=_notes(joints[0]),
        fps_line=fps_line,
        joints_line=line + 1,
    )


def _notes(root: _Joint) -> tuple[str, ...]:
    if not root.offset.any() or not root.has_positions:
        return ()
    offset = ', '.join(f'{v:g}' for v in root.offset)
    note = (
        f'the OFFSET of root {root.name} ({offset}) is added to its position channels: check the '
        'height of the feet, and set it to 0 where the program that wrote the file did not add it'
    )
    return (note,)


def _next(path: Path, lines: Iterator[Line]) -> Line:
    found = next(lines, None)
    if found is None:
        refuse(path, None, 'ends too early: is it cut off?')
    return found


def _hierarchy(path: Path, lines: Iterator[Line]) -> list[_Joint]:
    """Read up to the brace that closes the root."""
    joints: list[_Joint] = []
    stack: list[int] = []  # open joints; -1 = an end site
    n_channels = 0
    while stack or not joints:
        line, words = _next(path, lines)
        keyword = words[0].upper()
        current = joints[stack[-1]] if stack and stack[-1] >= 0 else None
        if keyword in {'ROOT', 'JOINT', 'END'}:
            is_misplaced = (keyword == 'ROOT') != (not stack) or (stack and current is None)
            if is_misplaced or len(words) < 2 or len(joints) >= MAX_JOINTS:
                refuse(path, line, f'{shown(" ".join(words))} is out of place')
            if keyword == 'END':
                stack.append(-1)
            else:
                joints.append(_Joint(' '.join(words[1:]), stack[-1] if stack else -1))
                stack.append(len(joints) - 1)
            line, words = _next(path, lines)
            if words != ['{']:
                refuse(path, line, f'need {{, got {shown(words[0])}')
        elif keyword == 'OFFSET' and stack and len(words) == 4:
            offset = np.array([number(w, path, line, 'OFFSET') for w in words[1:]])
            if current is not None:
                current.offset = offset
        elif keyword == 'CHANNELS' and current is not None:
            current.channels = _channels(path, line, words)
            current.first = n_channels
            n_channels += len(current.channels)
        elif words == ['}'] and stack:
            stack.pop()
        else:
            msg = (
                f'need ROOT, JOINT, End Site, OFFSET x y z, CHANNELS or }}, got {shown(words[0])}'
            )
            refuse(path, line, msg)
    return joints


def _channels(path: Path, line: int, words: Sequence[str]) -> tuple[str, ...]:
    spelled = {c.lower(): c for c in CHANNELS}
    found = tuple(spelled.get(w.lower(), '') for w in words[2:])
    if len(words) < 2 or words[1] != str(len(found)) or '' in found:
        msg = f'CHANNELS needs their number and that many of {", ".join(CHANNELS)}'
        refuse(path, line, f'{msg}, got {shown(" ".join(words[1:]))}')
    if len(set(found)) < len(found):
        refuse(path, line, 'a channel comes twice')
    return found


def _motion(path: Path, lines: Iterator[Line], n_channels: int) -> tuple[float, int, Array]:
    """Return the frame time, seconds, its line, and the channels (T, C)."""
    line, words = _next(path, lines)
    if words != ['MOTION']:
        refuse(path, line, f'need MOTION after the hierarchy, got {shown(words[0])}')
    line, words = _next(path, lines)
    if words[0] != 'Frames:' or len(words) != 2:
        refuse(path, line, 'need Frames: and their number')
    n_frames = number(words[1], path, line, 'Frames')
    frames_line = line
    line, words = _next(path, lines)
    if words[:2] != ['Frame', 'Time:'] or len(words) != 3:
        refuse(path, line, 'need Frame Time: and seconds')
    frame_s = number(words[2], path, line, 'Frame Time')
    if not 1.0 / MAX_FPS <= frame_s <= MAX_FRAME_TIME_S:
        msg = f'Frame Time {frame_s:g} s is none: write seconds, such as 0.033333 for 30 Hz'
        refuse(path, line, msg)
    fps_line, rows = line, []
    for line, words in lines:
        if len(words) != n_channels:
            refuse(path, line, f'{len(words)} numbers, need one for each of {n_channels} channels')
        rows.append(numbers(words, path, line))
    if len(rows) != n_frames:
        msg = f'{len(rows)} frames follow, but Frames is {n_frames:g}: is the file cut off?'
        refuse(path, frames_line, msg)
    return frame_s, fps_line, np.array(rows, dtype=np.float64).reshape(-1, n_channels)


def _positions(joints: Sequence[_Joint], table: Array) -> Array:
    """Return where the joints are.

    Args:
        joints: Parents before their children.
        table: (T, C) channels: file units and degrees.

    Returns:
        (T, J, 3) file units.

    """
    turns: list[Array] = []
    places: list[Array] = []
    for joint in joints:
        turn: Array = np.broadcast_to(np.eye(3), (len(table), 3, 3))
        moved = np.zeros((len(table), 3))
        for column, channel in enumerate(joint.channels, start=joint.first):
            axis = AXES.index(channel[0])
            if channel.endswith('position'):
                moved[:, axis] = table[:, column]
            else:
                turn = turn @ _turn(axis, np.radians(table[:, column]))
        if joint.parent < 0:
            places.append(joint.offset + moved)
            turns.append(turn)
        else:
            local = moved if joint.has_positions else np.broadcast_to(joint.offset, moved.shape)
            parent = turns[joint.parent]
            places.append(places[joint.parent] + (parent @ local[..., None])[..., 0])
            turns.append(parent @ turn)
    return np.stack(places, 1)


def _turn(axis: int, angle: Array) -> Array:
    """Return rotations (T, 3, 3) about an axis by angles (T,), radians."""
    a, b = (axis + 1) % 3, (axis + 2) % 3
    turn = np.zeros((len(angle), 3, 3))
    turn[:, axis, axis] = 1.0
    turn[:, a, a] = turn[:, b, b] = np.cos(angle)
    turn[:, b, a] = np.sin(angle)
    turn[:, a, b] = -turn[:, b, a]
    return turn
