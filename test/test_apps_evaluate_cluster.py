# SPDX-License-Identifier: Apache-2.0
"""Evaluation on a Dask cluster: a real scheduler and two workers, one of which dies."""

from __future__ import annotations

import csv
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from dataset_trees import plan

from rpgd_ros.apps import evaluate
from rpgd_ros.apps.evaluate_cluster import each_on_cluster
from rpgd_ros.core.errors import InputError
from rpgd_ros.simulation.dataset_writers import write_twin

TEST = Path(__file__).parent
ENVIRONMENT = os.environ | {
    'PYTHONPATH': os.pathsep.join([str(TEST), str(TEST.parent), *sys.path]),
    'DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES': '1',
}


class Cluster:
    """A scheduler and two workers of one thread each, as processes of this machine."""

    def __init__(self, folder: Path) -> None:
        """Start them; everything stays on the loopback interface."""
        self.folder = folder
        file = folder / 'scheduler.json'
        common = ['--scheduler-file', str(file)]
        quiet = ['--no-dashboard', '--host', '127.0.0.1']
        self.processes = [self.start('scheduler', *common, *quiet, '--port', '0')]
        wait_until(file.exists)
        lone = ['--nworkers', '1', '--nthreads', '1', '--no-nanny']
        self.processes += [self.start('worker', *common, *quiet, *lone) for _ in range(2)]
        text = file.read_text()
        self.address = text[text.index('tcp://') :].split('"')[0]

    def start(self, *command: str) -> subprocess.Popen[bytes]:
        """Start one process."""
        return subprocess.Popen(
            [sys.executable, '-m', 'distributed.cli.dask_' + command[0], *command[1:]],
            cwd=self.folder,
            env=ENVIRONMENT,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

    def stop(self) -> None:
        """End all of them."""
        for process in self.processes:
            process.kill()
            process.wait(timeout=20.0)


def wait_until(condition: object) -> None:
    """Wait for something that other processes do."""
    assert callable(condition)
    deadline = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < deadline, 'it did not come'
        time.sleep(0.02)


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    """Start a cluster, and end it."""
    pytest.importorskip('distributed')
    (tmp_path / 'cluster').mkdir()
    started = Cluster(tmp_path / 'cluster')
    try:
        yield started
    finally:
        started.stop()


def rows(path: Path) -> list[dict[str, str]]:
    """Return the lines of a CSV file without the times."""
    with path.open(newline='') as file:
        lines = list(csv.DictReader(file))
    return [{k: v for k, v in line.items() if not k.endswith('_ms')} for line in lines]


def test_cluster_that_loses_a_worker_finds_the_same_as_one_process(
    cluster: Cluster, tmp_path: Path
) -> None:
    """All sequences to the end, bit for bit but for the times; then nothing is left to do."""
    tree = tmp_path / 'tree'
    tree.mkdir()
    write_twin(plan('aistpp', sequences=3, seconds=0.5), tree)
    command = [str(tree), '--dataset', 'aistpp', '--results', str(tmp_path / 'results')]
    line = [sys.executable, '-m', 'rpgd_ros.apps.evaluate', *command]
    csv_file = tmp_path / 'cluster.csv'
    line += ['--scheduler', cluster.address, '--csv', str(csv_file)]
    program = subprocess.Popen(line, cwd=tmp_path, env=ENVIRONMENT, stdout=subprocess.DEVNULL)
    wait_until(lambda: list((tmp_path / 'results').glob('*.json')))
    cluster.processes[1].send_signal(signal.SIGKILL)
    assert program.wait(timeout=120.0) == 0
    serial = tmp_path / 'serial.csv'
    command[-1] = str(tmp_path / 'serial')
    assert evaluate.main([*command, '--jobs', '1', '--csv', str(serial)]) == 0
    assert rows(csv_file) == rows(serial)
    assert len(list((tmp_path / 'results').iterdir())) == 3


def test_stopped_run_takes_its_tasks_back(cluster: Cluster, tmp_path: Path) -> None:
    """Exit code 130; what is finished is kept, and the cluster does no more of the rest."""
    tree, results = tmp_path / 'tree', tmp_path / 'results'
    tree.mkdir()
    write_twin(plan('aistpp', sequences=6, seconds=0.5), tree)
    line = [sys.executable, '-m', 'rpgd_ros.apps.evaluate', str(tree), '--dataset', 'aistpp']
    line += ['--results', str(results), '--scheduler', cluster.address]
    program = subprocess.Popen(
        line, cwd=tmp_path, env=ENVIRONMENT, stderr=subprocess.PIPE, text=True
    )
    wait_until(lambda: list(results.glob('*.json')))
    program.send_signal(signal.SIGINT)
    _, complaint = program.communicate(timeout=60.0)
    assert program.returncode == 130
    assert 'goes on from here' in complaint
    assert 'Traceback' not in complaint
    assert list(each_on_cluster(str, [1], address=cluster.address)) == [(1, '1')]
    assert 1 <= len(list(results.glob('*.json'))) < 6


def kill_worker(number: int) -> int:
    """Kill the process that is told an odd number."""
    if number % 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return 10 * number


def test_task_that_kills_its_workers_is_given_up(cluster: Cluster) -> None:
    """It has killed two; a third, which a nanny would have started, goes on with the others."""
    lone = ['--nworkers', '1', '--nthreads', '1', '--scheduler-file', 'scheduler.json']
    assert list(each_on_cluster(kill_worker, [1], address=cluster.address)) == [(1, None)]
    cluster.processes.append(cluster.start('worker', *lone, '--no-dashboard'))
    found = dict(each_on_cluster(kill_worker, [0, 2], address=cluster.address))
    assert found == {0: 0, 2: 20}


def test_missing_scheduler_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    """With its address."""
    pytest.importorskip('distributed')
    monkeypatch.setattr('rpgd_ros.apps.evaluate_cluster.TIMEOUT_S', 0.5)
    with pytest.raises(InputError, match=r"no Dask scheduler answers at 'tcp://127\.0\.0\.1:9'"):
        next(each_on_cluster(kill_worker, [0], address='tcp://127.0.0.1:9'))
