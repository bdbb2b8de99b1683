# SPDX-License-Identifier: Apache-2.0
"""What an adapter reads out of one message."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import isfinite
from typing import Literal

import numpy as np

from rpgd_ros.core.geometry import Array
from rpgd_ros.messages.adapters.cursor import Place
from rpgd_ros.messages.layout import Drop, DropError


@dataclass(frozen=True, slots=True)
class Asked:
    """What is wanted of the messages of one stream.

    Attributes:
        names: (J,) what the messages call the joints, in the order of the result.
        n_values: 3 for skeletons, 2 for keypoints.
        index: Column of each name.

    """

    names: tuple[str, ...]
    n_values: Literal[2, 3]
    index: Mapping[str, int] = field(init=False)

    def __post_init__(self) -> None:
        """Index the names."""
        object.__setattr__(self, 'index', {name: j for j, name in enumerate(self.names)})

    @property
    def n_joints(self) -> int:
        """J."""
        return len(self.names)

    def empty(self) -> Array:
        """Return (J, C) joints, all of them missing."""
        return np.full((len(self.names), self.n_values), np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class Person:
    """One body of a message.

    Attributes:
        values: (J, C), NaN = absent; zeros and damaged numbers as sent.
        confidence: (J,), or None where the type has no scores.

    """

    values: Array
    confidence: Array | None = None


@dataclass(frozen=True, slots=True, eq=False)
class People:
    """One message.

    Attributes:
        stamp_ns: From the header; 0 = it has none.
        frame_id: From the header; '' = it has none.
        persons: The bodies, at least one.
        has_header: Whether the type has a header at all.

    """

    stamp_ns: int
    frame_id: str
    persons: tuple[Person, ...]
    has_header: bool = True


class Named:
    """Joints that come under their names, in any order."""

    def __init__(self, asked: Asked) -> None:
        """Start without any."""
        self._asked = asked
        self._places: dict[int, Place] = {}
        self._n_found = 0
        self._n_named = 0

    def put(self, name: str, place: Place, is_missing: bool = False) -> None:  # noqa: FBT001, FBT002
        """Take one joint; names that nobody asked for are left out.

        Raises:
            DropError: SEVERAL_PERSONS. The name stands at two places.

        """
        self._n_named += 1
        j = self._asked.index.get(name)
        if j is None:
            return
        self._n_found += 1
        if is_missing:
            return
        known = self._places.get(j)
        # Zeros stay what they are where nothing better comes: the caller judges them.
        if known is None or not _is_place(known):
            self._places[j] = place
        elif _is_place(place) and known != place:
            raise DropError(Drop.SEVERAL_PERSONS)

    def person(self) -> Person:
        """Return the body.

        Raises:
            DropError: NOBODY, or WRONG_JOINTS: there are names, but none of those asked for.

        """
        if not self._n_found:
            raise DropError(Drop.WRONG_JOINTS if self._n_named else Drop.NOBODY)
        values = self._asked.empty()
        for j, place in self._places.items():
            values[j] = place
        return Person(values)


def _is_place(place: Place) -> bool:
    return any(place) and all(map(isfinite, place))
