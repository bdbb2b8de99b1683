# SPDX-License-Identifier: Apache-2.0
"""Many sequences at once, a worker killed among them: minutes, so not collected by itself.

Run it by name: `pytest test/long_evaluate.py`. RPGD_ROS_SEQUENCES and RPGD_ROS_FRAMES say how many
sequences of how many frames; a million frames are 1000 of 1000, which takes an hour.
"""

from __future__ import annotations

import csv
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from dataset_trees import plan

from rpgd_ros.simulation import preset
from rpgd_ros.simulation.dataset_writers import write_twin

pytestmark = pytest.mark.long

SEQUENCES = int(os.environ.get('RPGD_ROS_SEQUENCES', '120'))
FRAMES = int(os.environ.get('RPGD_ROS_FRAMES', '60'))
HOUR_S = 3600.0


def children(pid: int) -> list[int]:
    """Return the processes that a process has started, and that have not ended."""
    try:
        tasks = list(Path(f'/proc/{pid}/task').iterdir())
        return [int(n) for task in tasks for n in (task / 'children').read_text().split()]
    except OSError:
        return []


def workers(pid: int) -> list[int]:
    """Return the processes of a program's pool: its grandchildren, by way of the fork server."""
    return [worker for child in children(pid) for worker in children(child)]


def rows(path: Path) -> list[dict[str, str]]:
    """Return the lines of a CSV file without the times."""
    with path.open(newline='') as file:
        lines = list(csv.DictReader(file))
    return [{k: v for k, v in line.items() if not k.endswith('_ms')} for line in lines]


def command(tree: Path, folder: Path, jobs: int) -> list[str]:
    """Return the line that evaluates a tree by the default solver."""
    line = [sys.executable, '-m', 'rpgd_ros.apps.evaluate', str(tree), '--dataset', 'aistpp']
    line += ['--methods', 'default', '--jobs', str(jobs), '--csv', f'{folder}.csv']
    return [*line, '--results', str(folder)]


def test_many_sequences_survive_the_death_of_a_worker_bit_for_bit(tmp_path: Path) -> None:
    """Two workers, one of them killed in the midst: the rows of one process, all of them."""
    tree = tmp_path / 'tree'
    tree.mkdir()
    write_twin(plan('aistpp', SEQUENCES, FRAMES / preset('aistpp').camera_hz), tree)
    killed, serial = tmp_path / 'killed', tmp_path / 'serial'
    root = Path(__file__).parents[1]
    program = subprocess.Popen(command(tree, killed, 2), cwd=root)
    deadline = time.monotonic() + HOUR_S
    while len(list(killed.glob('*.json'))) < SEQUENCES // 4:
        assert program.poll() is None, 'it ended before a worker could be killed'
        assert time.monotonic() < deadline
        time.sleep(0.01)
    victim, *others = workers(program.pid)
    assert others
    os.kill(victim, signal.SIGKILL)
    assert len(list(killed.glob('*.json'))) < SEQUENCES
    assert program.wait(timeout=HOUR_S) == 0
    assert subprocess.run(command(tree, serial, 1), cwd=root, check=False).returncode == 0
    ours, theirs = rows(tmp_path / 'killed.csv'), rows(tmp_path / 'serial.csv')
    assert len(ours) == SEQUENCES
    assert all(row['frames'] == str(FRAMES) and float(row['default_mm']) >= 0.0 for row in ours)
    assert ours == theirs
