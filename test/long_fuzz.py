# SPDX-License-Identifier: Apache-2.0
"""Fuzzing by time: ten minutes for each target, or RPGD_ROS_FUZZ_SECONDS.

Run it by name: `pytest test/long_fuzz.py`. The inputs are new at each run; a failure names its
number, and `fuzzing.fuzz(target, number, n_inputs=1)` repeats it.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

import fuzzing
import pytest
from fault_report import Measured

pytestmark = pytest.mark.long

SECONDS = float(os.environ.get('RPGD_ROS_FUZZ_SECONDS', '600'))
TARGETS: dict[str, tuple[int, Callable[[Path], fuzzing.Target]]] = {
    'messages': (10, lambda _: fuzzing.decoder()),
    'rig file': (23, lambda _: fuzzing.rig_file()),
    'result file': (23, fuzzing.result_file),
    'recording': (22, fuzzing.bag),
}


@pytest.mark.parametrize(
    'name', [pytest.param(name, marks=pytest.mark.fault(TARGETS[name][0])) for name in TARGETS]
)
def test_target_bears_damaged_input_for_long(
    tmp_path: Path, name: str, measured: Measured
) -> None:
    """No crash, no hang, no memory without bound."""
    done = fuzzing.fuzz(TARGETS[name][1](tmp_path), time.time_ns() % 10**15, seconds=SECONDS)
    measured(f'{name}: {done.n_inputs} inputs, slowest', done.slowest_s, 's', n=done.n_inputs)
    measured('growth', done.growth_mib, 'MiB', n=done.n_inputs)
