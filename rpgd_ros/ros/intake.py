# SPDX-License-Identifier: Apache-2.0
"""What became of the messages that arrived: how many were stored, and where none is any more."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from rpgd_ros.messages import Drop
from rpgd_ros.ros.inputs import STALE_SECONDS, Health
from rpgd_ros.ros.parameters import shown
from rpgd_ros.session import Session

NOT_COLLECTING = 'not collecting: call ~/set_enabled to go on'
STORED = ('kept', 'expired', 'cleared')  # those still there, and those that were
# Counts of messages that were dropped; the others are of joints, or of messages that were used.
DROPPED = (
    *map(str, Drop), 'duplicate', 'jump_held', 'unlinked', 'needs_mocap_frame', 'too_many_frames'
)  # fmt: skip
ADVICE = {str(Drop.FRAME_CHANGED): ', call ~/reset to take the new frame'}


class _Mark(NamedTuple):
    """When all was well with a stream, and its counts then."""

    now_s: float
    counts: Mapping[str, int]


class Intake:
    """Compares what came with what was stored, per stream. Belongs to the session's thread."""

    def __init__(self, session: Session) -> None:
        """Count from nothing."""
        self._session = session
        self._marks: dict[str, _Mark] = {}

    def n_stored(self) -> int:
        """Return the number of messages that were stored since the start, of all streams."""
        return sum(_n_stored(self._session.counts(name)) for name in self._session.streams)

    def judged(
        self, inputs: Mapping[str, Health], *, is_collecting: bool, now_s: float
    ) -> dict[str, Health]:
        """Return the inputs' health, with a problem where messages come and none is stored.

        Args:
            inputs: State of each subscription by stream.
            is_collecting: Whether messages are to be stored.
            now_s: Time of a steady clock.

        """
        found = {}
        for name, health in inputs.items():
            problem = self._problem(name, now_s, is_collecting=is_collecting)
            found[name] = health if health.problem else health._replace(problem=problem)
        return found

    def _problem(self, name: str, now_s: float, *, is_collecting: bool) -> str:
        counts = self._session.counts(name)
        mark = self._marks.setdefault(name, _Mark(now_s, counts))
        reason = _commonest(counts, mark.counts)
        # A detector in an empty room sends empty messages: that is as it should be.
        is_empty_room = reason == Drop.NOBODY and counts['kept'] > 0
        has_come = counts['received'] != mark.counts['received']
        is_taken = _n_stored(counts) != _n_stored(mark.counts)
        if not is_collecting or not has_come or is_taken or is_empty_room:
            self._marks[name] = _Mark(now_s, counts)
            return ''
        if now_s - mark.now_s <= STALE_SECONDS:
            return ''
        topic = shown(self._session.sources()[name])
        why = f': {reason}{ADVICE.get(reason, "")}' if reason else ''
        return f'messages arrive on {topic}, but none could be used{why}'


def _n_stored(counts: Mapping[str, int]) -> int:
    return sum(counts.get(key, 0) for key in STORED)


def _commonest(counts: Mapping[str, int], before: Mapping[str, int]) -> str:
    """Return why most messages were dropped since some earlier counts, '' = not counted."""
    dropped = {key: counts.get(key, 0) - before.get(key, 0) for key in DROPPED}
    reason = max(dropped, key=dropped.__getitem__)
    return reason if dropped[reason] > 0 else ''
