# SPDX-License-Identifier: Apache-2.0
"""One stream of joints, guarded against clocks: zero stamps, duplicates, jumps."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from rpgd_ros.core.geometry import Array, IntArray
from rpgd_ros.core.observations import NS_PER_S
from rpgd_ros.pairing.store import Persons, Samples, SampleStore

JUMP_NS = NS_PER_S  # a message nearer to the newest one is late or early; else a clock jumped
AGREE = 5  # messages that must agree on a new time before it is believed
AGREE_GAP_NS = 10 * NS_PER_S  # between two that agree: detectors run at 0.2 Hz and faster
MAX_HELD = 4 * AGREE  # strays of 20 kinds may come between the five that agree
STRETCH = 1024  # messages looked at together: bounds the work that one stray causes


class _Held(NamedTuple):
    """A message that waits until others agree with its stamp."""

    stamp_ns: int
    values: Array
    confidence: Array | None

    def rank(self) -> tuple[int, bytes, bytes]:
        """Rank among those of one stamp, as the store does."""
        present = int((~np.isnan(self.values).any(-1)).sum())
        confidence = b'' if self.confidence is None else self.confidence.tobytes()
        return -present, self.values.tobytes(), confidence


class JointStream:
    """Stores the samples of one stream by their stamps.

    A message within 1 s of the newest stamp belongs, late, early or twice. One farther away is
    held back: five of them in a row that agree with each other are believed, and a message that
    belongs makes an end of those held before. The first messages of a stream are held likewise,
    so that a stray at the start does not set the time.

    As long as no jump is believed, what is stored depends on the set of messages only, not on
    the order in which they came.
    """

    def __init__(self, max_frames: int, max_age_s: float, *, n_joints: int, n_values: int) -> None:
        """Start empty.

        Args:
            max_frames: Most samples kept.
            max_age_s: Samples older than the newest by more are dropped, in stamps.
            n_joints: J of the samples.
            n_values: C of the samples: 3 for skeletons, 2 for keypoints.

        """
        self._store = SampleStore(
            max_frames, round(max_age_s * NS_PER_S), n_joints=n_joints, n_values=n_values
        )
        self._newest: int | None = None
        self._old_side: int | None = None
        self._held: list[_Held] = []
        self._n_received = self._n_zero = self._n_refused = 0
        self._n_held_twice = self._n_cleared = 0

    @property
    def newest_ns(self) -> int | None:
        """The newest believed stamp, or None."""
        return self._newest

    @property
    def counts(self) -> Mapping[str, int]:
        """What became of the messages; `received` is the sum of all others.

        `kept`, `duplicate` (of one stamp, all but one), `zero_stamp`, `jump_held` (held back or
        refused), `expired` (number or age) and `cleared` (by a backward jump or `clear`).
        """
        kept = len(self._store)
        return {
            'received': self._n_received,
            'kept': kept,
            'duplicate': self._store.n_duplicate + self._n_held_twice,
            'zero_stamp': self._n_zero,
            'jump_held': self._n_refused + len(self._held),
            'expired': self._store.n_expired,
            'cleared': self._n_cleared,
        }

    def add(self, stamp_ns: IntArray, values: Array, confidence: Array | None) -> bool:
        """Take messages in the order of their arrival.

        Args:
            stamp_ns: (B,) stamps; zero and below = none.
            values: (B, J, C) joints, NaN = missing; (B, P J, C) of several persons.
            confidence: (B, J) scores, or None; (B, P J) of several persons.

        Returns:
            Whether a backward jump was believed: the other streams have to `start_epoch`.

        """
        n = len(stamp_ns)
        self._n_received += n
        if n == 1 and self._newest is not None and not self._held:
            stamp = int(stamp_ns[0])
            if stamp > 0 and abs(stamp - self._newest) <= JUMP_NS:
                self._store.append(stamp_ns, values, confidence)
                self._newest = max(self._newest, stamp)
                return False
        stamped = stamp_ns > 0
        if not stamped.all():
            self._n_zero += n - int(stamped.sum())
            stamp_ns, values = stamp_ns[stamped], values[stamped]
            confidence = None if confidence is None else confidence[stamped]
        return self._add_stamped(stamp_ns, values, confidence)

    def start_epoch(self) -> None:
        """Drop the past, because another stream jumped back, and wait for this one to follow.

        Late messages of the old side are refused; five that agree on another time are believed
        without a further epoch.
        """
        held = self._held
        self._held = []
        if self._newest is not None:
            # What this stream holds from before its newest stamp is its own jump, half done.
            self._held = [h for h in held if h.stamp_ns < self._newest]
            self._old_side, self._newest = self._newest, None
        self._n_refused += len(held) - len(self._held)
        self._n_cleared += self._store.clear()

    def clear(self) -> None:
        """Forget all messages and the time; the counts stay."""
        self._n_refused += len(self._held)
        self._held = []
        self._newest = self._old_side = None
        self._n_cleared += self._store.clear()

    def resize(self, max_frames: int, max_age_s: float) -> None:
        """Change the bounds; what is beyond them goes at once."""
        self._store.max_frames = max_frames
        self._store.max_age_ns = round(max_age_s * NS_PER_S)

    def stamps(self) -> IntArray:
        """Return the (F,) stamps, strictly increasing, valid until the next message."""
        return self._store.stamps()

    def arrays(self) -> Samples:
        """Return sorted unique samples, valid until the next message."""
        return self._store.samples()

    def lend(self) -> Samples:
        """Return sorted unique samples that stay what they are; nothing is copied for it."""
        return self._store.lend()

    def lend_persons(self) -> Persons | None:
        """Return the samples of all persons, as `lend`; None where there is never more than one.

        Where there are, `lend` and `arrays` give the first of each message.
        """
        return self._store.lend_persons()

    def _add_stamped(self, stamp_ns: IntArray, values: Array, confidence: Array | None) -> bool:
        """Take stretches that belong at once, and what lies between them one by one."""
        went_back = False
        i = 0
        while i < len(stamp_ns):
            n = self._n_belonging(stamp_ns[i : i + STRETCH])
            scores = None if confidence is None else confidence[i : i + max(n, 1)]
            if n:
                self._n_refused += len(self._held)
                self._held = []
                self._store.append(stamp_ns[i : i + n], values[i : i + n], scores)
                self._newest = max(self._newest or 0, int(stamp_ns[i : i + n].max()))
                i += n
            else:
                score = None if scores is None else scores[0].copy()
                went_back |= self._hold(_Held(int(stamp_ns[i]), values[i].copy(), score))
                i += 1
        return went_back

    def _n_belonging(self, stamp_ns: IntArray) -> int:
        """Count the leading messages near the newest stamp at their arrival."""
        if self._newest is None:
            return 0
        newest = np.maximum.accumulate(np.concatenate([[self._newest], stamp_ns[:-1]]))
        strays = np.flatnonzero(np.abs(stamp_ns - newest) > JUMP_NS)
        return int(strays[0]) if len(strays) else len(stamp_ns)

    def _hold(self, new: _Held) -> bool:
        """Hold a message back; return whether a backward jump is believed with it."""
        if self._old_side is not None and abs(new.stamp_ns - self._old_side) <= JUMP_NS:
            self._n_refused += 1
            return False
        for i, held in enumerate(self._held):
            if held.stamp_ns == new.stamp_ns:
                self._held[i] = min(held, new, key=_Held.rank)
                self._n_held_twice += 1
                return False
        if len(self._held) == MAX_HELD:
            self._held.pop(0)
            self._n_refused += 1
        self._held.append(new)
        agreed = self._agreeing(new.stamp_ns)
        return len(agreed) >= AGREE and self._believe(agreed)

    def _agreeing(self, stamp_ns: int) -> list[_Held]:
        """Return the held messages linked with a stamp by short gaps, sorted by stamp."""
        newest = self._newest
        side = [
            h for h in self._held
            if newest is None or (h.stamp_ns > newest) == (stamp_ns > newest)
        ]  # fmt: skip
        side.sort(key=lambda h: h.stamp_ns)
        stamps = np.array([h.stamp_ns for h in side])
        chain = np.cumsum(np.diff(stamps, prepend=stamps[0]) > AGREE_GAP_NS)
        mine = chain[np.searchsorted(stamps, stamp_ns)]
        return [h for h, link in zip(side, chain, strict=True) if link == mine]

    def _believe(self, agreed: list[_Held]) -> bool:
        """Go on from the time that held messages agree on; return whether that is back."""
        went_back = self._newest is not None and agreed[-1].stamp_ns < self._newest
        if went_back:
            self._n_cleared += self._store.clear()
        self._n_refused += len(self._held) - len(agreed)
        self._held = []
        self._old_side = None
        self._newest = agreed[-1].stamp_ns
        for held in agreed:
            scores = None if held.confidence is None else held.confidence[None]
            self._store.append(np.array([held.stamp_ns]), held.values[None], scores)
        return went_back
