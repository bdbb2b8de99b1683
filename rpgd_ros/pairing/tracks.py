# SPDX-License-Identifier: Apache-2.0
"""Follows skeletons from message to message: their order there need not stay the same.

In three dimensions and at the rate of a MoCap this is no question of likelihood: between two
samples a body moves centimetres, and two bodies are never in one place.
"""

from __future__ import annotations

import numpy as np

from rpgd_ros.core.geometry import Array, BoolArray, IntArray
from rpgd_ros.core.matching import best_matching
from rpgd_ros.core.observations import NS_PER_S
from rpgd_ros.pairing.store import Persons, Samples

FASTEST_M_S = 8.0  # of the mean of a body's joints: a sprinter
NOISE_M = 0.3  # and what a depth camera's skeleton jumps besides
FORGET_NS = NS_PER_S  # after which a place may be taken by somebody else


def follow(persons: Persons) -> list[Samples]:
    """Give each skeleton a place that it keeps.

    Args:
        persons: As sent, (M, P, J, 3) metres.

    Returns:
        One track per place with the samples in which somebody has it. Who leaves and comes back
        may come back to another place; nobody comes to a place that was somebody else's within
        the last second.

    """
    place = _places(persons)
    n_places = int(place.max(initial=-1)) + 1
    tracks = []
    for number in range(n_places):
        frame, person = np.nonzero(place == number)
        scores = None if persons.confidence is None else persons.confidence[frame, person]
        tracks.append(Samples(persons.stamp_ns[frame], persons.values[frame, person], scores))
    return tracks


def _places(persons: Persons) -> IntArray:
    """(M, P) place of each skeleton; -1 where there is none."""
    seen = ~np.isnan(persons.values[..., 0])
    is_there: BoolArray = np.asarray(seen.any(2))
    place = np.full(is_there.shape, -1)
    last = np.empty((0, *persons.values.shape[2:]))  # newest joints at each place
    when = np.empty(0, np.int64)
    for m, stamp_ns in enumerate(persons.stamp_ns.tolist()):
        who = np.flatnonzero(is_there[m])
        x = persons.values[m, who]
        elapsed_s = (stamp_ns - when) / NS_PER_S
        reach = NOISE_M + FASTEST_M_S * elapsed_s
        apart = _apart(x, last)
        gain = np.where(apart < reach, 1.0 + 1.0 / (1.0 + apart), 0.0)
        gain[:, when < stamp_ns - FORGET_NS] = 0.0
        found: IntArray = best_matching(gain[None])[0] if len(when) else np.full(len(who), -1)
        free: list[int] = np.flatnonzero(when < stamp_ns - FORGET_NS).tolist()
        for k in np.flatnonzero(found < 0).tolist():
            if free:
                found[k] = free.pop(0)
                last[found[k]] = x[k]
            else:
                found[k] = len(when)
                when = np.append(when, 0)
                last = np.concatenate([last, x[k : k + 1]])
        # A joint that is missing for once is near where it was.
        last[found], when[found] = np.where(np.isnan(x), last[found], x), stamp_ns
        place[m, who] = found
    return place


def _apart(x: Array, last: Array) -> Array:
    """(S, N) mean distance of the joints that both have, metres; infinite without any."""
    apart = np.linalg.norm(x[:, None] - last[None], axis=-1)
    both = ~np.isnan(apart)
    n = both.sum(2)
    mean: Array = np.where(both, apart, 0.0).sum(2) / np.maximum(n, 1)
    return np.where(n > 0, mean, np.inf)
