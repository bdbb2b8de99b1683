# SPDX-License-Identifier: Apache-2.0
"""What messages are decoded to: joints of one person, or of several."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from rpgd_ros.core.geometry import Array, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class JointBatch:
    """The messages of one stream that can be used, B of them, in the order they came.

    Attributes:
        index: (B,) position of each among the payloads.
        stamp_ns: (B,) acquisition stamps of the headers.
        frame_id: Frame of the headers.
        values: (B, J, C) metres as sent (C = 3) or pixels as sent (C = 2); NaN = missing, in all
            C or none.
        confidence: (B, J) scores, NaN = none given; None where no message has scores.
        others: (B, P - 1, J, C) the persons after the first, NaN = not there; None where no
            message has more than one.
        others_confidence: (B, P - 1, J) their scores, as `confidence`.

    """

    index: IntArray
    stamp_ns: IntArray
    frame_id: str
    values: Array
    confidence: Array | None
    others: Array | None = None
    others_confidence: Array | None = None

    def take(self, joints: IntArray) -> tuple[Array, Array | None]:
        """Return K joints of all P persons: values (B, P K, C) and scores (B, P K), or None.

        Person by person; those that are not there are NaN.
        """
        values = self.values.take(joints, axis=1)
        scores = None if self.confidence is None else self.confidence.take(joints, axis=1)
        if self.others is None:
            return values, scores
        n, n_values = len(values), values.shape[2]
        others = self.others.take(joints, axis=2).reshape(n, -1, n_values)
        if scores is not None and self.others_confidence is not None:
            more = self.others_confidence.take(joints, axis=2).reshape(n, -1)
            scores = np.concatenate([scores, more], 1)
        return np.concatenate([values, others], 1), scores


@dataclass(frozen=True, slots=True, eq=False)
class Decoded:
    """What became of the payloads.

    Attributes:
        batch: The usable ones; None without any.
        dropped: Messages dropped, by `Drop` reason.
        missing: Joints missing in the others: `nan` (also infinite, or absurdly large), `zero`;
            and `persons_beyond_20`, of which none is read.

    """

    batch: JointBatch | None
    dropped: Mapping[str, int]
    missing: Mapping[str, int]


def crowd_batch(
    head: tuple[IntArray, IntArray, str], values: Array, scores: Array | None
) -> JointBatch:
    """Make a batch of messages of several persons; those that are there come first.

    Args:
        head: Index, stamps and frame of the batch.
        values: (B, P, J, C); NaN = missing.
        scores: (B, P, J), or None.

    """
    is_empty = np.isnan(values[..., 0]).all(2)
    order = np.argsort(is_empty, axis=1, kind='stable')
    n_persons = max(1, int((~is_empty).sum(1).max()))
    order = order[:, :n_persons]
    values = np.take_along_axis(values, order[..., None, None], 1)
    if scores is not None:
        scores = np.take_along_axis(scores, order[..., None], 1)
    if n_persons == 1:
        return JointBatch(*head, values[:, 0], None if scores is None else scores[:, 0])
    if scores is None:
        return JointBatch(*head, values[:, 0], None, values[:, 1:])
    return JointBatch(*head, values[:, 0], scores[:, 0], values[:, 1:], scores[:, 1:])


def merge(parts: list[JointBatch]) -> JointBatch:
    """Put messages of several layouts back into the order they came in."""
    if len(parts) == 1:
        return parts[0]
    index = np.concatenate([part.index for part in parts])
    order = np.argsort(index)
    confidence = None
    if any(part.confidence is not None for part in parts):
        confidence = np.concatenate([_scores(part) for part in parts])[order]
    others, others_confidence = _merge_others(parts, order, has_scores=confidence is not None)
    return JointBatch(
        index[order],
        np.concatenate([part.stamp_ns for part in parts])[order],
        parts[0].frame_id,
        np.concatenate([part.values for part in parts])[order],
        confidence,
        others,
        others_confidence,
    )


def _merge_others(
    parts: list[JointBatch], order: IntArray, *, has_scores: bool
) -> tuple[Array | None, Array | None]:
    """Put further persons into the order of their messages, as many places for each."""
    n_others = max(0 if part.others is None else part.others.shape[1] for part in parts)
    if not n_others:
        return None, None
    values, scores = [], []
    for part in parts:
        n, n_joints, n_values = part.values.shape
        padded = np.full((n, n_others, n_joints, n_values), np.nan)
        rated = np.full((n, n_others, n_joints), np.nan)
        if part.others is not None:
            padded[:, : part.others.shape[1]] = part.others
        if part.others_confidence is not None:
            rated[:, : part.others_confidence.shape[1]] = part.others_confidence
        values.append(padded)
        scores.append(rated)
    return np.concatenate(values)[order], np.concatenate(scores)[order] if has_scores else None


def _scores(part: JointBatch) -> Array:
    if part.confidence is not None:
        return part.confidence
    return np.full(part.values.shape[:2], np.nan)
