# SPDX-License-Identifier: Apache-2.0
"""What all tests share: a safe ROS environment, repeatable random cases, recorded data."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import pytest
from fault_report import IS_FULL, fault_round, measured
from hypothesis import settings
from ros_scene import Scene, make_scene

from rpgd_ros.ros import domain

# Before any test imports rclpy or a message: talk to this machine only, and check the fields.
os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
os.environ.setdefault('ROS_PYTHON_CHECK_FIELDS', '1')
# And find each other soon, but for `make faults`: its times are those of a user's machine.
if not IS_FULL:
    PROMPT = str(Path(__file__).with_name('prompt_discovery.xml'))
    os.environ.setdefault('FASTRTPS_DEFAULT_PROFILES_FILE', PROMPT)

# Workers side by side take turns with the ROS domains.
WORKERS = int(os.environ.get('PYTEST_XDIST_WORKER_COUNT', '1'))
WORKER = int(os.environ.get('PYTEST_XDIST_WORKER', 'gw0').removeprefix('gw'))
domain._numbers = itertools.count(WORKERS * os.getpid() + WORKER, WORKERS)  # noqa: SLF001

# The same cases in each run, and no time limit for one: a busy machine is no fault of the code.
settings.register_profile('repeatable', derandomize=True, deadline=None, database=None)
settings.load_profile('repeatable')

# Offline tests run where ROS was never installed.
collect_ignore_glob = [] if find_spec('rclpy') else ['test_ros_*.py']

__all__ = ['fault_round', 'measured', 'recording']

RECORDINGS = Path(
    os.environ.get('RPGD_ROS_RECORDINGS', Path(__file__).parents[2] / 'shared' / 'data')
)


@pytest.fixture(scope='session')
def recording() -> Callable[[str], Path]:
    """Return a function that finds a recorded file by name, or skips the test without it."""

    def find(name: str) -> Path:
        path = RECORDINGS / name
        if not path.is_file():
            pytest.skip(f'{name} is not in {RECORDINGS}: set RPGD_ROS_RECORDINGS to its folder')
        return path

    return find


@pytest.fixture(scope='module')
def walk(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """Return eight seconds of a walk before four cameras, in a folder that a node may write to."""
    return make_scene(tmp_path_factory.mktemp('walk'))


@pytest.fixture
def rig(walk: Scene, tmp_path: Path) -> Path:
    """Return the rig file of the walk in a folder of the test's own."""
    path = tmp_path / 'rig.yaml'
    path.write_bytes(walk.rig.read_bytes())
    return path
