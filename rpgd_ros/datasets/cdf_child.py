# SPDX-License-Identifier: Apache-2.0
"""Reads the variable Pose of a CDF file, in a process of its own: see `child_main.py`."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np


def read(path: str) -> tuple[None, list[Any]]:
    """Return no facts, and the values."""
    cdflib = importlib.import_module('cdflib')
    return None, [np.asarray(cdflib.CDF(path).varget('Pose'), dtype=np.float64)]
