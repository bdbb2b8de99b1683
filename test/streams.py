# SPDX-License-Identifier: Apache-2.0
"""Streams of messages of two joints, whole and damaged, for the tests of the pairing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from rpgd_ros.pairing import JointStream

S = 1_000_000_000
MS = 1_000_000
START = 1_700_000_000 * S
HOUR = 3600 * S
BAG_AT_25_HZ = 40 * MS


class Message(NamedTuple):
    """One message: a stamp and one joint."""

    stamp_ns: int
    value: float = 1.0


def joint(stamp_ns: int) -> float:
    """Return a coordinate that tells its stamp."""
    return (stamp_ns - START) / S


def send(stream: JointStream, messages: Sequence[Message], *, together: int = 1) -> bool:
    """Feed messages in batches; return whether a backward jump was believed."""
    went_back = False
    for i in range(0, len(messages), together):
        batch = messages[i : i + together]
        stamps = np.array([m.stamp_ns for m in batch], np.int64)
        values = np.array([m.value for m in batch])[:, None, None] * np.ones((1, 2, 3))
        went_back |= stream.add(stamps, values, values[:, :, 0])
    return went_back


def make_stream(max_frames: int = 20_000, max_age_s: float = 1000.0) -> JointStream:
    """Return a stream of two joints in 3D."""
    return JointStream(max_frames, max_age_s, n_joints=2, n_values=3)


def regular(n: int, *, start: int = START, period: int = BAG_AT_25_HZ) -> list[Message]:
    """Return n messages at a constant rate."""
    return [Message(start + i * period, joint(start + i * period)) for i in range(n)]


def contents(stream: JointStream) -> dict[int, float]:
    """Return what a stream holds, by stamp."""
    samples = stream.arrays()
    assert (np.diff(samples.stamp_ns) > 0).all()
    return dict(zip(samples.stamp_ns.tolist(), samples.values[:, 0, 0].tolist(), strict=True))


def check_counts(stream: JointStream) -> None:
    """Every message received is in exactly one of the other counts."""
    counts = dict(stream.counts)
    assert counts.pop('received') == sum(counts.values())


def damaged(rng: np.random.Generator, messages: list[Message]) -> list[Message]:
    """Double 20 %, put 5 % without and 1 % with a far stamp, then shuffle within 5."""
    out: list[Message] = []
    for m in messages:
        out += [m] * (1 + (rng.random() < 0.20))
        if rng.random() < 0.05:
            out.append(Message(0, m.value))
        if rng.random() < 0.01:
            out.append(Message(m.stamp_ns + HOUR, m.value))
    places = np.arange(len(out)) + rng.uniform(0, 5, len(out))
    return [out[i] for i in np.argsort(places)]
