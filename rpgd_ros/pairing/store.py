# SPDX-License-Identifier: Apache-2.0
"""A bounded, sorted store of stamped joints in preallocated arrays.

Adding is a copy to the end of an array. Order, duplicates and age are put right when somebody
looks, for all rows at once: a stream in order, the usual case, costs one comparison per row.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rpgd_ros.core.geometry import Array, BoolArray, IntArray

FIRST_ROWS = 256  # 1 s of a fast MoCap; doubled as needed, so that silent streams cost nothing
FULL_PERSONS = 4  # up to which a store keeps max_frames samples


class Samples(NamedTuple):
    """Joints over time.

    Attributes:
        stamp_ns: (F,) strictly increasing.
        values: (F, J, C) as sent; NaN = missing.
        confidence: (F, J); NaN where a message had none; None where no message had any.

    """

    stamp_ns: IntArray
    values: Array
    confidence: Array | None


class Persons(NamedTuple):
    """Joints of several persons over time.

    Attributes:
        stamp_ns: (F,) strictly increasing.
        values: (F, P, J, C) as sent; NaN = missing.
        confidence: (F, P, J); NaN where a message had none; None where no message had any.

    """

    stamp_ns: IntArray
    values: Array
    confidence: Array | None


class SampleStore:
    """Keeps the newest samples, one per stamp.

    A sample of several persons has the joints of all of them, person by person. The store is as
    wide as the largest sample that it keeps; above FULL_PERSONS it keeps fewer, so that a crowd
    takes no more memory than so many persons.

    What it holds is a function of the set of samples given, not of their order: of two samples
    with one stamp, the one with more joints stays, then the one whose bytes come first.

    Attributes:
        max_frames: Most samples kept.
        max_age_ns: Samples older than the newest by more are dropped.
        n_duplicate: Samples that shared a stamp with another.
        n_expired: Samples dropped for number or age.

    """

    def __init__(self, max_frames: int, max_age_ns: int, *, n_joints: int, n_values: int) -> None:
        """Start empty, for joints of `n_values` coordinates each."""
        self.max_frames = max_frames
        self.max_age_ns = max_age_ns
        self.n_duplicate = 0
        self.n_expired = 0
        self._start = self._sorted = self._end = 0
        self._has_confidence = False
        self._is_lent = False
        self._n_joints = n_joints
        self._stamp = np.empty(FIRST_ROWS, np.int64)
        self._n_persons = np.empty(FIRST_ROWS, np.int64)  # of each sample
        self._values = np.empty((FIRST_ROWS, n_joints, n_values))
        self._confidence = np.empty((FIRST_ROWS, n_joints))

    def append(self, stamp_ns: IntArray, values: Array, confidence: Array | None) -> None:
        """Take samples in any order: (B,), (B, J, C) and (B, J), or P J joints in place of J."""
        n = len(stamp_ns)
        if self._end + n > len(self._stamp):
            self._make_room(n)
        width, n_persons = self._values.shape[1], np.ones(n, np.int64)
        if values.shape[1] != self._n_joints or width != self._n_joints:
            # The messages of a batch may be padded for one that does not belong.
            n_persons = _n_persons(values, self._n_joints)
            needed = self._n_joints * int(n_persons.max(initial=1))
            if needed > width:
                self._move_to(len(self._stamp), needed)
                width = needed
            values = _padded(values[:, :width], width)
            confidence = None if confidence is None else _padded(confidence[:, :width], width)
        rows = slice(self._end, self._end + n)
        self._stamp[rows] = stamp_ns
        self._n_persons[rows] = n_persons
        self._values[rows] = values
        if confidence is None:
            self._confidence[rows] = np.nan
        else:
            self._confidence[rows] = confidence
            self._has_confidence = True
        self._end += n

    def clear(self) -> int:
        """Drop all samples and return how many there were."""
        n = len(self)
        self._start = self._sorted = self._end = 0
        self._has_confidence = False
        if self._is_lent or self._values.shape[1] > self._n_joints:
            self._move_to(FIRST_ROWS, self._n_joints)
        return n

    def __len__(self) -> int:
        """Return the number of samples kept."""
        self._consolidate()
        return self._end - self._start

    def stamps(self) -> IntArray:
        """Return the (F,) stamps, valid until the next sample is added."""
        self._consolidate()
        return self._stamp[self._start : self._end]

    def lend(self) -> Samples:
        """Return the samples for good: without a copy, unless the store has to change them."""
        samples = self.samples()
        self._is_lent = True
        return samples

    def lend_persons(self) -> Persons | None:
        """Return the joints of all persons for good; None where there is never more than one."""
        if self._values.shape[1] == self._n_joints:
            return None
        stamp_ns, values, confidence = self._all()
        n_persons = int(self._n_persons[self._start : self._end].max(initial=1))
        if n_persons == 1:
            return None  # the others are too long ago
        self._is_lent = True
        shape = (len(values), -1, self._n_joints)
        scores = None if confidence is None else confidence.reshape(shape)[:, :n_persons]
        return Persons(stamp_ns, values.reshape(*shape, values.shape[2])[:, :n_persons], scores)

    def samples(self) -> Samples:
        """Return the samples, valid until the next one is added; of several persons the first."""
        samples = self._all()
        if samples.values.shape[1] == self._n_joints:
            return samples
        one = slice(0, self._n_joints)
        confidence = None if samples.confidence is None else samples.confidence[:, one]
        return Samples(samples.stamp_ns, samples.values[:, one], confidence)

    def _all(self) -> Samples:
        self._consolidate()
        rows = slice(self._start, self._end)
        confidence = self._confidence[rows] if self._has_confidence else None
        return Samples(self._stamp[rows], self._values[rows], confidence)

    def _most(self, n_persons: int) -> int:
        """Return how many samples are kept where the largest is of so many persons."""
        if n_persons <= FULL_PERSONS:
            return self.max_frames
        return max(1, self.max_frames * FULL_PERSONS // n_persons)

    def _consolidate(self) -> None:
        """Sort what was added since the last time, and let go of what is too old."""
        if self._sorted < self._end:
            tail = self._stamp[self._sorted : self._end]
            follows = self._sorted == self._start or tail[0] > self._stamp[self._sorted - 1]
            if not (follows and bool((tail[1:] > tail[:-1]).all())):
                self._merge(int(tail.min()))
            self._sorted = self._end
        kept = self._stamp[self._start : self._end]
        if len(kept):
            self._drop(int(np.searchsorted(kept, kept[-1] - self.max_age_ns)))
            if self._end - self._start > self._bound:
                self._drop_crowded()

    @property
    def _bound(self) -> int:
        """Most samples kept, if one of them needs the whole width."""
        return self._most(self._values.shape[1] // max(self._n_joints, 1))

    def _drop(self, n: int) -> None:
        """Let go of the oldest."""
        self._start += n
        self.n_expired += n

    def _drop_crowded(self) -> None:
        """Keep as many of the newest as the largest of them allows, in arrays that fit them.

        A sample that does not fit in beside newer ones never does again, whatever comes: what is
        kept depends neither on the order of the samples nor on when somebody looks.
        """
        n_persons = self._n_persons[self._start : self._end]
        largest = np.maximum.accumulate(n_persons[::-1])  # of the newest one, two, three, ...
        most = np.array([self._most(n) for n in range(largest[-1] + 1)])[largest]
        n_kept = int(np.count_nonzero(np.arange(1, len(largest) + 1) <= most))
        self._drop(len(largest) - n_kept)
        n_joints = self._n_joints * int(largest[n_kept - 1])
        n_rows = max(_with_slack(n_kept), FIRST_ROWS)
        if n_joints < self._values.shape[1] or n_rows < len(self._stamp) // 2:
            self._move_to(n_rows, n_joints)

    def _merge(self, oldest_new: int) -> None:
        """Bring the rows from `oldest_new` on into order, one per stamp."""
        settled = self._stamp[self._start : self._sorted]
        first = self._start + int(np.searchsorted(settled, oldest_new))
        order = first + np.argsort(self._stamp[first : self._end], kind='stable')
        order = order[self._one_per_stamp(order)]
        self.n_duplicate += self._end - first - len(order)
        rows = slice(first, first + len(order))
        if self._is_lent:
            # What was lent must not change under its reader's eyes.
            shift = self._start
            self._move_to(len(self._stamp), self._values.shape[1])
            order, rows = order - shift, slice(rows.start - shift, rows.stop - shift)
        for array in (self._stamp, self._n_persons, self._values, self._confidence):
            array[rows] = array[order]
        self._end = rows.stop

    def _one_per_stamp(self, order: IntArray) -> BoolArray:
        """Choose one row of each stamp; `order` (n,) sorts the rows by stamp."""
        stamp = self._stamp[order]
        keep = np.ones(len(order), np.bool_)
        keep[1:] = stamp[1:] != stamp[:-1]
        again = np.flatnonzero(~keep)
        differs = self._bytes_differ(order[again - 1], order[again])
        for stamp_ns in np.unique(stamp[again[differs]]):
            group = np.arange(*np.searchsorted(stamp, [stamp_ns, stamp_ns + 1]))
            keep[group] = False
            keep[min(group, key=lambda i: self._rank(int(order[i])))] = True
        return keep

    def _bytes_differ(self, rows: IntArray, others: IntArray) -> BoolArray:
        """Tell, pair by pair, which of two rows hold other bits: NaN equals itself here."""
        differs: BoolArray = np.zeros(len(rows), np.bool_)
        for array in (self._values, self._confidence):
            bits = array.view(np.int64).reshape(len(array), -1)
            differs |= (bits[rows] != bits[others]).any(1)
        return differs

    def _rank(self, row: int) -> tuple[int, bytes, bytes]:
        """Rank a sample among those of one stamp: more joints first, then by its bytes."""
        values = self._values[row]
        missing = int(np.isnan(values).any(-1).sum())
        return missing, values.tobytes(), self._confidence[row].tobytes()

    def _make_room(self, n: int) -> None:
        """Move the rows to the front of arrays that hold `n` more and some slack."""
        self._consolidate()
        n_kept = self._end - self._start
        needed = _with_slack(n_kept) + n
        rows = max(len(self._stamp), FIRST_ROWS)
        while rows < needed:
            rows *= 2
        self._move_to(max(min(rows, _with_slack(self._bound)), needed), self._values.shape[1])

    def _move_to(self, n_rows: int, n_joints: int) -> None:
        """Move the samples to the front of arrays of at least so many rows, and this width."""
        kept, n_kept = slice(self._start, self._end), self._end - self._start
        is_same = n_joints == self._values.shape[1] and n_rows <= len(self._stamp) <= 2 * n_rows
        for name in ('_stamp', '_n_persons', '_values', '_confidence'):
            old = getattr(self, name)
            rows = old[kept]
            if old.ndim > 1 and old.shape[1] != n_joints:
                rows = _padded(rows[:, :n_joints], n_joints)
            fits = is_same and not self._is_lent
            new = old if fits else np.empty((n_rows, *rows.shape[1:]), old.dtype)
            new[:n_kept] = rows
            setattr(self, name, new)
        self._is_lent = False
        self._sorted -= self._start
        self._start, self._end = 0, n_kept


def _with_slack(n_rows: int) -> int:
    """Return room for a quarter more: rows move seldom, so adding stays cheap."""
    return n_rows + n_rows // 4 + 1


def _n_persons(values: Array, n_joints: int) -> IntArray:
    """Return how many persons each sample of values (B, P J, C) has, at least 1."""
    shape = (len(values), values.shape[1] // n_joints, n_joints)
    there: BoolArray = np.asarray(~np.isnan(values[..., 0]).reshape(shape).all(2))
    last = there.shape[1] - np.argmax(there[:, ::-1], axis=1)
    return np.where(there.any(1), last, 1)


def _padded(array: Array, n_joints: int) -> Array:
    """Return (B, J, ...) with more joints, which are NaN."""
    out = np.full((len(array), n_joints, *array.shape[2:]), np.nan)
    out[:, : array.shape[1]] = array
    return out
