# SPDX-License-Identifier: Apache-2.0
"""Skeletons whose joints come in messages of their own: poses per segment, frames of TF.

Every part has a stream of its own, with all its guards against clocks. Which parts make one
skeleton is decided when somebody looks, from the stamps alone: the skeletons are a function of
the set of messages, as the pairs are.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from rpgd_ros.core.geometry import Array, IntArray
from rpgd_ros.core.observations import NS_PER_S
from rpgd_ros.messages.adapters.parts import POSITION_VALUES, PartBatch
from rpgd_ros.pairing import BufferConfig, JointStream, Samples

# Parts nearer than this to each other are of one instant. vicon_receiver stamps each segment with
# its own now(), tens of microseconds after the one before; between two frames of a 200 Hz system
# there are milliseconds. A walking body moves 1.5 mm in this time.
GAP_NS: Final = 1_000_000
# Instants older than this against the newest are put together once, unless a message comes later
# still: of a full buffer of 20 segments, gathering everything takes a tenth of a second. A part
# that lags behind the others is waited for; one that lags by more has everything gathered anew.
SETTLED_NS: Final = NS_PER_S
LONGEST_LAG_NS: Final = 10 * NS_PER_S
MAX_PARTS: Final = 512  # joints, and the frames between them and the root


def gather(stamps: Sequence[IntArray], gap_ns: int = GAP_NS) -> tuple[IntArray, IntArray]:
    """Find which samples of several streams are of one instant.

    A new instant begins after a gap, and where a stream would come in twice.

    Args:
        stamps: Of each of K streams, strictly increasing.
        gap_ns: Smallest time between two instants.

    Returns:
        (F,) mean stamps, strictly increasing, and (F, K) rows of the streams; -1 = no sample.

    """
    n_streams = len(stamps)
    stamp = np.concatenate([np.empty(0, np.int64), *stamps])
    if not len(stamp):
        return stamp, np.empty((0, n_streams), np.int64)
    stream = np.repeat(np.arange(n_streams), [len(s) for s in stamps])
    row = np.concatenate([np.arange(len(s)) for s in stamps])
    order = np.lexsort((stream, stamp))
    stamp, stream, row = stamp[order], stream[order], row[order]
    run = np.cumsum(np.diff(stamp, prepend=stamp[0]) > gap_ns)
    # Of each sample, how many of its stream came before it in this run.
    _, first, place = np.unique(run * n_streams + stream, return_index=True, return_inverse=True)
    turn = row - row[first][place]
    # The run's turn never goes back: offset by the runs, one accumulation serves all of them.
    turn = np.maximum.accumulate(turn + run * (len(stamp) + 1))
    _, start, instant = np.unique(turn, return_index=True, return_inverse=True)
    rows = np.full((len(start), n_streams), -1)
    rows[instant, stream] = row
    n_parts = np.diff(np.append(start, len(stamp)))
    since = stamp - stamp[start][instant]
    return stamp[start] + np.add.reduceat(since, start) // n_parts, rows


class GatheredStream:
    """The skeletons of several parts; to the session, a stream like any other.

    Attributes:
        problems: Parts that were left out, by reason.
        root: Frame of the skeletons; '' until the first part tells it.

    """

    def __init__(self, names: Sequence[str], buffer: BufferConfig, *, root: str) -> None:
        """Start empty.

        Args:
            names: (J,) parts that are the joints.
            buffer: Bounds of the stores.
            root: Frame that the skeletons are wanted in; '' = that of the first part.

        """
        self.problems: Counter[str] = Counter()
        self._given_root = self.root = root
        self._may_chain = bool(root)
        self._names = tuple(names)
        self._buffer = buffer.max_frames, buffer.max_age_s
        self._past: Counter[str] = Counter()  # counts of parts that were forgotten
        self._gathered: Samples | None
        self._start()

    @property
    def counts(self) -> Mapping[str, int]:
        """What became of the parts, and the number of `skeletons` they make."""
        total = Counter({'received': 0, 'kept': 0, **self._past})
        for part in self._parts.values():
            total.update(part.counts)
        n_skeletons = len(self.stamps())
        if not n_skeletons and total['kept']:  # chains that do not reach the root
            total = total - Counter(kept=total['kept']) + Counter(unlinked=total['kept'])
        return {'kept': 0, **total, **self.problems, 'skeletons': n_skeletons}

    def add(self, batch: PartBatch) -> bool:
        """Take parts in the order of their arrival.

        Args:
            batch: The parts.

        Returns:
            Whether a backward jump was believed: the other streams have to `start_epoch`.

        """
        went_back = False
        self._gathered = None
        newest_ns = self._newest_ns()
        for name, rows in self._chosen(batch).items():
            stamp_ns = batch.stamp_ns[rows]
            if ((stamp_ns > 0) & (stamp_ns < self._since_ns)).any():
                self._forget()
            part = self._parts.get(name)
            if part is None:
                n_values = batch.values.shape[1]
                part = self._parts[name] = JointStream(
                    *self._buffer, n_joints=1, n_values=n_values
                )
            # Of its oldest message just now: what comes in bursts is as late as that.
            self._lag_ns[name] = newest_ns - (part.newest_ns or newest_ns)
            if part.add(stamp_ns, batch.values[rows][:, None], None):
                went_back = True
                for other in self._parts.values():
                    if other is not part:
                        other.start_epoch()
                self._forget()
        return went_back

    def start_epoch(self) -> None:
        """Drop the past, because another stream jumped back."""
        for part in self._parts.values():
            part.start_epoch()
        self._forget()

    def clear(self) -> None:
        """Forget all messages, the time and how the frames hang together; the counts stay."""
        for part in self._parts.values():
            part.clear()
            self._past.update(part.counts)
        self._start()

    def resize(self, max_frames: int, max_age_s: float) -> None:
        """Change the bounds."""
        self._buffer = max_frames, max_age_s
        for part in self._parts.values():
            part.resize(max_frames, max_age_s)
        self._forget()

    def stamps(self) -> IntArray:
        """Return the (F,) stamps, strictly increasing."""
        return self.arrays().stamp_ns

    def arrays(self) -> Samples:
        """Return sorted unique skeletons (F, J, 3) that stay what they are."""
        if self._gathered is None:
            self._gathered = self._gather()
        return self._gathered

    def lend(self) -> Samples:
        """Return sorted unique skeletons (F, J, 3) that stay what they are."""
        return self.arrays()

    def _chosen(self, batch: PartBatch) -> dict[str, list[int]]:
        """Return the rows of each part that is needed."""
        chosen: dict[str, list[int]] = {}
        links = dict(zip(batch.names, batch.parents, strict=True)) | self._parents
        for i, (name, parent) in enumerate(zip(batch.names, batch.parents, strict=True)):
            if name in self._wanted and self._is_linked(name, parent, links, batch):
                chosen.setdefault(name, []).append(i)
        return chosen

    def _is_linked(
        self, name: str, parent: str, links: Mapping[str, str], batch: PartBatch
    ) -> bool:
        """Tell whether a part can be used, and learn what lies between it and the root."""
        self.root = self.root or parent
        is_place = batch.values.shape[1] == POSITION_VALUES  # without what a chain would need
        if self._parents.setdefault(name, parent) != parent or (is_place and parent != self.root):
            self.problems['frame_changed'] += 1
            return False
        if parent != self.root and not self._may_chain:
            # Frames that hang on each other: where the chain is to end, nobody can guess.
            self.problems['needs_mocap_frame'] += 1
            return False
        while parent not in self._wanted and parent != self.root:
            if len(self._wanted) >= MAX_PARTS:
                self.problems['too_many_frames'] += 1
                return False
            self._wanted.add(parent)
            parent = links.get(parent, self.root)
        return True

    def _start(self) -> None:
        """Know of no part."""
        self.root = self._given_root
        self._parts: dict[str, JointStream] = {}
        self._lag_ns: dict[str, int] = {}  # of each part's newest messages behind the other parts
        self._parents: dict[str, str] = {}
        self._wanted: set[str] = set(self._names)
        self._forget()

    def _forget(self) -> None:
        """Put everything together anew when next asked."""
        self._gathered = None
        self._settled = Samples(np.empty(0, np.int64), np.empty((0, len(self._names), 3)), None)
        self._since_ns = 0  # instants before it are settled

    def _gather(self) -> Samples:
        names = sorted(self._parts)
        tracks = [_since(self._parts[name].arrays(), self._since_ns) for name in names]
        stamp_ns, rows = gather([track.stamp_ns for track in tracks])
        columns = {name: i for i, name in enumerate(names)}
        values = np.full((len(stamp_ns), len(self._names), 3), np.nan)
        for j, name in enumerate(self._names):
            place = self._place(name, columns, tracks, rows)
            if place is not None:
                values[:, j] = place
        there = np.isfinite(values).all(-1).any(-1)
        found = Samples(
            np.concatenate([self._settled.stamp_ns, stamp_ns[there]]),
            np.concatenate([self._settled.values, values[there]]),
            None,
        )
        found = self._within_bounds(found)
        self._settle(found, tracks)
        return found

    def _within_bounds(self, found: Samples) -> Samples:
        """Let go of what is too old, as the stores of the parts do."""
        max_frames, max_age_s = self._buffer
        newest_ns = found.stamp_ns[-1] if len(found.stamp_ns) else 0
        first = np.searchsorted(found.stamp_ns, newest_ns - round(max_age_s * NS_PER_S))
        first = max(int(first), len(found.stamp_ns) - max_frames)
        return Samples(found.stamp_ns[first:], found.values[first:], None)

    def _newest_ns(self) -> int:
        """Return the newest stamp of all parts, 0 where there is none."""
        return max((part.newest_ns or 0 for part in self._parts.values()), default=0)

    def _settle(self, found: Samples, tracks: Sequence[Samples]) -> None:
        """Keep the instants before a gap that lies some time back."""
        stamps = np.sort(np.concatenate([np.empty(0, np.int64), *(t.stamp_ns for t in tracks)]))
        after_gap = stamps[1:][np.diff(stamps) > GAP_NS]
        lag_ns = min(max(self._lag_ns.values(), default=0), LONGEST_LAG_NS)
        old = after_gap[after_gap < self._newest_ns() - lag_ns - SETTLED_NS]
        if len(old):
            self._since_ns = int(old[-1])
            n = int(np.searchsorted(found.stamp_ns, self._since_ns))
            self._settled = Samples(found.stamp_ns[:n], found.values[:n], None)

    def _place(
        self, name: str, columns: Mapping[str, int], tracks: Sequence[Samples], rows: IntArray
    ) -> Array | None:
        """Return the (F, 3) places of a frame in the root, None where they cannot be known."""
        if name not in columns:
            return None
        x = _rows(tracks[columns[name]], rows[:, columns[name]])[:, -3:]
        frame = self._parents.get(name, self.root)
        for _ in range(MAX_PARTS):  # a loop is no tree
            if frame == self.root:
                return x
            if frame not in columns:
                return None
            link = _rows(tracks[columns[frame]], rows[:, columns[frame]])
            x = np.einsum('fij,fj->fi', link[:, :9].reshape(-1, 3, 3), x) + link[:, 9:]
            frame = self._parents[frame]
        return None


def _rows(track: Samples, rows: IntArray) -> Array:
    """Return rows of a track of one part, NaN where a row is -1."""
    padded = np.concatenate([track.values[:, 0], np.full((1, track.values.shape[2]), np.nan)])
    return padded[rows]


def _since(track: Samples, since_ns: int) -> Samples:
    """Return the end of a track."""
    first = int(np.searchsorted(track.stamp_ns, since_ns))
    return Samples(track.stamp_ns[first:], track.values[first:], None)
