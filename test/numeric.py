# SPDX-License-Identifier: Apache-2.0
"""Numeric derivatives, to hold the analytic ones against."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from rpgd_ros.core.geometry import Array

STEP = 1e-3  # of quantities near 1: the five-point rule is then exact to 1e-12, rounding to 1e-13
# Two steps to either side, and their weights in the five-point rule.
STENCIL = ((-2.0, 1.0), (-1.0, -8.0), (1.0, 8.0), (2.0, -1.0))


def jacobian(f: Callable[[Array], ArrayLike], x: ArrayLike, step: float = STEP) -> Array:
    """Differentiate f (...) by x (n,) with the five-point rule: (..., n)."""
    at = np.asarray(x, dtype=np.float64)
    columns = []
    for k in range(len(at)):
        along = np.zeros_like(at)
        along[k] = step
        terms = [weight * np.asarray(f(at + far * along)) for far, weight in STENCIL]
        columns.append(np.sum(terms, axis=0) / (12.0 * step))
    return np.stack(columns, -1)


def relative_error(analytic: Array, numeric: Array) -> float:
    """Return the largest difference, by the largest number; infinite where one is no number."""
    if analytic.shape != numeric.shape or not (
        np.isfinite(analytic).all() and np.isfinite(numeric).all()
    ):
        return np.inf
    return float(np.abs(analytic - numeric).max(initial=0.0) / np.abs(numeric).max(initial=1e-12))
