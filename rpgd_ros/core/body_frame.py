# SPDX-License-Identifier: Apache-2.0
"""The heading of the body at each instant, without knowing joints by name or which axis is up.

The trunk are the joints that keep their distances. Their mean shape, laid on the skeleton of an
instant, gives the rotation of the body; the heading is its part about the axis that a body turns
about. Leaning is left out: where a detector errs along the vertical, it may or may not lean with
the body, and a frame that leans would claim to see what no data shows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from rpgd_ros.core.geometry import Array, skew
from rpgd_ros.core.observations import is_there
from rpgd_ros.core.thin import spread

TEMPLATE_FRAMES = 150
ALIGNMENTS = 4  # rounds after which the mean shape stands still to 0.1 mm
LOOSENESS_M = 0.02  # a joint that keeps its distances to this is trunk
STIFFNESS_M = 0.005  # a pair that keeps its distance to this is of one part
LEAST_PART = 3.0  # joints, by weight
MOST_PARTS = 3
LEAST_JOINTS = 4
LEAST_EXTENT_M = 0.05  # of the second axis of the trunk: a line has no rotation
LONG_WEIGHT = 0.3  # of the long axis of a body that hardly turns
POLAR_STEPS = 10  # quadratic convergence from a condition number of 30


@dataclass(frozen=True, slots=True, eq=False)
class BodyFrame:
    """The mean shape of a body.

    Attributes:
        shape: (J, 3) metres about its weighted centre; zero where a joint is not used.
        weight: (J,) how much each joint says of the rotation.
        up: (3,) the axis that the body turns about, MoCap frame; its sign means nothing.

    """

    shape: Array
    weight: Array
    up: Array

    @classmethod
    def fit(cls, x: Array, weight: Array) -> Self | None:
        """Fit the mean shape to skeletons (F, J, 3), metres; None where it has no heading."""
        used = weight > 0.0
        whole = np.flatnonzero(np.isfinite(x[:, used]).all((1, 2)))
        if used.sum() < LEAST_JOINTS or not len(whole):
            return None
        shape = np.nan_to_num(x[whole[0]])
        for _ in range(ALIGNMENTS):
            found = cls(_centred(shape, weight), weight, np.zeros(3))
            turns = found._rotations(x)
            inside = np.einsum('fki,fjk->fji', turns, x - found._centres(x)[:, None])
            count = np.maximum(np.isfinite(inside).all(-1).sum(0), 1)
            shape = np.nansum(inside, 0) / count[:, None]
        rooted = found.shape * np.sqrt(weight / weight.sum())[:, None]
        if np.linalg.svd(rooted, compute_uv=False)[1] < LEAST_EXTENT_M:
            return None
        return replace(found, up=_turning_axis(turns, x - found._centres(x)[:, None]))

    def headings(self, x: Array) -> Array:
        """(F, 3, 3) rotations about `up` of skeletons (F, J, 3), metres; 1 for the mean shape.

        In a gap of the track it is the last one known.
        """
        turned = self._rotations(x)
        # Of all rotations about an axis the nearest to R has this angle.
        u, trace = self.up, np.trace(turned, axis1=1, axis2=2)
        sine = np.einsum('fij,ij->f', turned, skew(u))
        cosine = trace - np.einsum('i,fij,j->f', u, turned, u)
        length = np.maximum(np.hypot(sine, cosine), 1e-12)
        sine, cosine = (sine / length)[:, None, None], (cosine / length)[:, None, None]
        along = np.outer(u, u)
        out: Array = along + cosine * (np.eye(3) - along) + sine * skew(u)
        return out

    def _rotations(self, x: Array) -> Array:
        there = is_there(x)
        weight = np.where(there, self.weight, 0.0)
        shape = self.shape - (weight @ self.shape / _total(weight)[:, None])[:, None]
        product = np.einsum('fj,fji,fjk->fik', weight, np.where(there[..., None], x, 0.0), shape,
                            optimize=True)  # fmt: skip
        product /= np.maximum(np.linalg.norm(product, axis=(1, 2), keepdims=True), 1e-12)
        # A flat trunk leaves the sign of the third axis to noise. The cofactors have the same axes
        # and are largest along the third, with the sign of a proper rotation.
        product += _cofactors(product)
        good = (weight > 0.0).sum(1) >= LEAST_JOINTS
        good &= np.linalg.det(product) > 0.0
        out = np.broadcast_to(np.eye(3), product.shape).copy()
        if good.any():
            out[good] = _polar(product[good])
            known = np.maximum.accumulate(np.where(good, np.arange(len(good)), -1))
            out = out[np.where(known >= 0, known, int(np.argmax(good)))]
        return out

    def _centres(self, x: Array) -> Array:
        weight = np.where(is_there(x), self.weight, 0.0)
        middle: Array = np.einsum('fj,fji->fi', weight, np.nan_to_num(x)) / _total(weight)[:, None]
        return middle


def _total(weight: Array) -> Array:
    total: Array = np.maximum(weight.sum(1), 1e-12)
    return total


def _centred(shape: Array, weight: Array) -> Array:
    centred: Array = shape - weight @ shape / weight.sum()
    return centred


def body_frames(x: Array) -> list[BodyFrame]:
    """Propose frames for a track of skeletons (F, J, 3), metres: of the trunk, and of its parts.

    A pelvis turns against the shoulders at every step. Which of them the detector's errors follow
    is for the data to say.
    """
    x = x[spread(len(x), TEMPLATE_FRAMES)]
    there = is_there(x)
    x = x[there.sum(1) >= max(LEAST_JOINTS, 0.8 * there.sum(1).max(initial=0))]
    if len(x) < 2 or x.shape[1] < LEAST_JOINTS:
        return []
    wander = _wander(x)
    loose = np.sort(wander, axis=1)[:, : max(2, x.shape[1] // 3)].mean(1)
    weights = [np.where(np.isfinite(loose), 1.0 / (1.0 + (loose / LOOSENESS_M) ** 2), 0.0)]
    near = 1.0 / (1.0 + (wander / STIFFNESS_M) ** 2) + np.eye(len(wander))
    sizes = near.sum(1)
    for centre in np.argsort(-sizes, kind='stable'):
        row = near[centre]
        is_new = all((row * other).sum() < 0.5 * row.sum() for other in weights[1:])
        if sizes[centre] >= LEAST_PART and is_new and len(weights) <= MOST_PARTS:
            weights.append(row)
    frames = [f for w in weights if (f := BodyFrame.fit(x, w)) is not None]
    # A foot does not tell what is up: the axis is that of the trunk.
    return [replace(f, up=frames[0].up) for f in frames]


def _wander(x: Array) -> Array:
    """(J, J) standard deviation of the distances between joints; inf where it is not known."""
    apart = np.linalg.norm(x[:, :, None] - x[:, None], axis=-1)
    count = np.isfinite(apart).sum(0)
    middle = np.nansum(apart, 0) / np.maximum(count, 1)
    wander: Array = np.sqrt(np.nansum((apart - middle) ** 2, 0) / np.maximum(count, 1))
    wander[count < 2] = np.inf
    np.fill_diagonal(wander, np.inf)
    return wander


def _turning_axis(turns: Array, x: Array) -> Array:
    """(3,) axis that rotations (F, 3, 3) turn about, or along which skeletons are long."""
    mean = turns.mean(0)
    points = x[is_there(x)]
    spread_of = points.T @ points
    _, vectors = np.linalg.eigh(mean @ mean.T + LONG_WEIGHT * spread_of / np.trace(spread_of))
    axis: Array = vectors[:, -1]
    return axis


def _polar(m: Array) -> Array:
    """(n, 3, 3) nearest rotations of matrices of positive determinant (Newton's iteration)."""
    for _ in range(POLAR_STEPS):
        cofactors = _cofactors(m)
        det = np.einsum('fi,fi->f', m[:, 0], cofactors[:, 0])[:, None, None]
        inverse_t = cofactors / np.maximum(det, 1e-300)
        stretch = np.linalg.norm(inverse_t, axis=(1, 2)) / np.linalg.norm(m, axis=(1, 2))
        stretch = np.sqrt(stretch)[:, None, None]
        m = 0.5 * (stretch * m + inverse_t / stretch)
    return m


def _cofactors(m: Array) -> Array:
    a, b, c = m[:, 0], m[:, 1], m[:, 2]
    return np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], 1)
