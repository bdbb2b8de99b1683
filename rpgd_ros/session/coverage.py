# SPDX-License-Identifier: Apache-2.0
"""What cameras and room have seen of the person so far, kept as small sums.

Each call costs what is new. The sums stand in slots of time, so that what leaves the buffer of
the session also leaves the coverage.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from rpgd_ros.core.geometry import Array, BoolArray, IntArray
from rpgd_ros.core.observations import NS_PER_S
from rpgd_ros.session.recent import Pairs

ROWS, COLUMNS = 9, 16  # cells of an image: 120 px of a full HD one, a hand at 4 m
MIN_HITS = 5  # keypoints that make a cell seen: a sixth of a second; one stray does not
ROOM_CELL_M = 0.5  # of the room: a step
MAX_ROOM_CELLS = 10_000  # of one slot: a person has been nowhere near so many
UNEVEN = 0.7  # of the better half: walks that cross a room end above
N_SLOTS = 30  # that the buffer's time is cut into: what is too old goes in steps of 3 %


@dataclass(frozen=True, slots=True)
class ImageCoverage:
    """What one camera has seen.

    Attributes:
        camera: Its name.
        seen: (ROWS, COLUMNS) cells of its image with keypoints.
        n_pairs: Keypoints with a skeleton's joint.

    """

    camera: str
    seen: BoolArray
    n_pairs: int

    @property
    def share(self) -> float:
        """Share of the image that has been seen, 0 to 1."""
        return float(self.seen.mean())

    @property
    def poorest_side(self) -> str:
        """The half of the image that has seen far less than the other: left or right; '' = none.

        Nothing is said of above and below: people cannot fly.
        """
        middle = COLUMNS // 2
        left, right = self.seen[:, :middle].mean(), self.seen[:, middle:].mean()
        if min(left, right) < UNEVEN * max(left, right):
            return 'left' if left < right else 'right'
        return ''


@dataclass(frozen=True, slots=True)
class RoomCoverage:
    """Where the person has been.

    Attributes:
        area_m2: Floor that the body's middle was over, square metres.
        extent_m: (2,) its largest extent, and the one across that, metres.

    """

    area_m2: float
    extent_m: tuple[float, float]


@dataclass(slots=True, eq=False)
class _Slot:
    """Sums over one stretch of time."""

    hits: dict[str, IntArray] = field(default_factory=dict)
    seconds: set[int] = field(default_factory=set)
    room: set[tuple[int, int, int]] = field(default_factory=set)

    def count(self, camera: str, hits: IntArray) -> None:
        """Add keypoints of a camera, by cell."""
        before = self.hits.get(camera)
        self.hits[camera] = hits if before is None else before + hits

    def merge(self, other: _Slot) -> None:
        """Add the sums of another one."""
        for camera, hits in other.hits.items():
            self.count(camera, hits)
        self.seconds |= other.seconds
        self.room |= other.room


class Coverage:
    """Running sums over the pairs of a session."""

    def __init__(self, max_age_s: float) -> None:
        """Start empty.

        Args:
            max_age_s: What is older than the newest by more is forgotten, in stamps.

        """
        self._slots: dict[int, _Slot] = {}
        self._cut(max_age_s)

    def resize(self, max_age_s: float) -> None:
        """Change the time that is kept; what lies beyond it goes at once, as far as slots tell.

        A slot is not divided: where it is older only in part, it goes with its newest second.
        """
        if max_age_s == self._max_age_s:
            return
        self._cut(max_age_s)
        before, self._slots = self._slots, {}
        newest = max((max(slot.seconds) for slot in before.values()), default=0)
        for slot in before.values():
            slot.seconds = {second for second in slot.seconds if second > newest - max_age_s}
            if slot.seconds:
                number = max(slot.seconds) * NS_PER_S // self._slot_ns
                self._slots.setdefault(number, _Slot()).merge(slot)
        self._let_go()

    def add(self, pairs: Sequence[Pairs]) -> None:
        """Take what came since the last time."""
        for new in pairs:
            stamp_ns = new.view.known_stamp_ns
            number = stamp_ns // self._slot_ns
            for n in np.unique(number).tolist():
                rows = number == n
                slot = self._slots.setdefault(n, _Slot())
                slot.seconds.update(np.unique(stamp_ns[rows] // NS_PER_S).tolist())
                self._enter(slot, new, rows)
        self._let_go()

    def clear(self) -> None:
        """Forget everything."""
        self._slots.clear()

    @property
    def seconds(self) -> float:
        """How long some camera saw the person together with the MoCap, in whole seconds."""
        return float(len(set().union(*(slot.seconds for slot in self._slots.values()))))

    def image(self, camera: str) -> ImageCoverage:
        """Return what a camera has seen; nothing of one that is not known."""
        hits = sum(
            (slot.hits[camera] for slot in self._slots.values() if camera in slot.hits),
            start=np.zeros(ROWS * COLUMNS + 1, np.int64),
        )
        seen = (hits[:-1] >= MIN_HITS).reshape(ROWS, COLUMNS)
        return ImageCoverage(camera, seen, int(hits.sum()))

    def room(self) -> RoomCoverage:
        """Return where the person has been."""
        cells: set[tuple[int, int, int]] = set()
        cells = cells.union(*(slot.room for slot in self._slots.values()))
        if len(cells) < 2:
            return RoomCoverage(len(cells) * ROOM_CELL_M**2, (0.0, 0.0))
        x = np.array(sorted(cells), np.float64) * ROOM_CELL_M
        # Along the axes of the walk itself: nobody knows yet which way of the MoCap is up.
        _, axes = np.linalg.eigh(np.cov(x.T))
        along = (x - x.mean(0)) @ axes[:, :0:-1]
        squares = np.unique(np.round(along / ROOM_CELL_M), axis=0)
        length, width = np.ptp(along, axis=0).tolist()
        return RoomCoverage(len(squares) * ROOM_CELL_M**2, (length, width))

    def _cut(self, max_age_s: float) -> None:
        """Choose how long a slot is, and how many are kept."""
        self._max_age_s = max_age_s
        self._slot_ns = max(round(max_age_s * NS_PER_S / N_SLOTS), NS_PER_S)
        self._n_slots = max(1, round(max_age_s * NS_PER_S / self._slot_ns))

    def _let_go(self) -> None:
        """Forget the slots that are too old."""
        newest = max(self._slots, default=0)
        for n in [n for n in self._slots if n <= newest - self._n_slots]:
            del self._slots[n]

    def _enter(self, slot: _Slot, new: Pairs, rows: BoolArray) -> None:
        width, height = new.camera.size
        uv, x, there = new.view.uv[rows], new.view.x_mocap[rows], new.view.seen()[rows]
        cell = _cells(uv[there], width, height)
        slot.count(new.camera.name, np.bincount(cell, minlength=ROWS * COLUMNS + 1))
        if len(slot.room) < MAX_ROOM_CELLS:
            middles = _middles(np.where(there[..., None], x, np.nan))
            slot.room.update(map(tuple, np.floor(middles / ROOM_CELL_M).astype(np.int64).tolist()))


def _cells(uv: Array, width: int, height: int) -> IntArray:
    """Return the cell of each keypoint (n, 2); those outside the image share a last one."""
    inside = (uv >= 0.0).all(1) & (uv[:, 0] < width) & (uv[:, 1] < height)
    column = np.where(inside, uv[:, 0] * (COLUMNS / width), 0.0).astype(np.int64)
    row = np.where(inside, uv[:, 1] * (ROWS / height), 0.0).astype(np.int64)
    return np.where(inside, row * COLUMNS + column, ROWS * COLUMNS)


def _middles(x: Array) -> Array:
    """Return the middle of each body (F, J, 3) that has a joint: (n, 3) metres."""
    x = x[np.isfinite(x[..., 0]).any(1)]
    return np.nanmean(x, axis=1) if len(x) else np.empty((0, 3))
