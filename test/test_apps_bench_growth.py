# SPDX-License-Identifier: Apache-2.0
"""The two measurements of size: frames of a recording, and the reading of a bag."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rpgd_ros.apps import bench, bench_growth, bench_reading
from rpgd_ros.apps.bench_problems import judge
from rpgd_ros.apps.bench_run import prepare
from rpgd_ros.core.geometry import rotation_angle
from rpgd_ros.io.rig import read_rig
from rpgd_ros.simulation import build_scene, preset, simulate
from rpgd_ros.simulation.export import BAG, RIG, write_recording


def quietly(items: Iterable[Any], _what: str, _count: int) -> Iterable[Any]:
    """Show no bar."""
    return items


def cells(text: str) -> list[list[str]]:
    """Return the cells of a table without its header."""
    lines = [line for line in text.splitlines() if line.startswith('|')]
    return [[cell.strip() for cell in line.strip('|').split('|')] for line in lines[2:]]


def test_long_sequence_of_chunks_is_one_recording(monkeypatch: pytest.MonkeyPatch) -> None:
    """One rig, one transform, increasing stamps, another walk in each chunk, noise as it was."""
    monkeypatch.setattr(bench_growth, 'CHUNK', 100)
    problem = bench_growth.long_problem(250, 3)
    view = problem.observations.views[0]
    assert view.uv.shape == (250, 17, 2)
    assert view.stamp_ns is not None
    assert set(np.diff(view.stamp_ns)) == {20_000_000}
    assert np.linalg.norm(view.x_mocap[0] - view.x_mocap[100]) > 0.1
    assert all(v.x_mocap is view.x_mocap for v in problem.observations.views)
    exact = judge(problem, problem.truth.world_T_mocap)
    assert exact.mpjpe_px == pytest.approx(1.2299, rel=0.01)
    assert rotation_angle(problem.truth.world_T_mocap.rotation) > 0.1
    assert [mask.shape for mask in problem.truth.inliers] == [(250, 17)] * 4


def test_growth_tells_time_and_accuracy_of_both_kinds(monkeypatch: pytest.MonkeyPatch) -> None:
    """As many short sequences as make up the frames; growth against the line above."""
    prepare()
    monkeypatch.setattr(bench_growth, 'SHORT', 1000)
    table = bench_growth.measure([0], frames=[3000, 1000], track=quietly)
    lines = cells(table.text)
    found = [' '.join(line[:3]) for line in lines]
    assert found == ['long 1 1000', 'long 1 3000', 'short 1 1000', 'short 3 3000']
    assert lines[0][5] == '-'
    assert lines[1][5].endswith('(3)')
    for row in table.rows:
        assert 0.0 < row['seconds'] < 60.0
        assert 0.0 < row['mm'] < 4.0 * row['bound_mm']
        assert 20.0 < row['peak_mb'] < 4000.0
    assert table.rows[1]['bound_mm'] < table.rows[0]['bound_mm']


def test_reading_counts_the_same_messages_in_all_ways() -> None:
    """And gives the ratio of one run."""
    prepare()
    table = bench_reading.measure(track=quietly, seconds=5.0, repeats=1)
    assert [line[0] for line in cells(table.text)] == ['mcap', 'sqlite3']
    for row in table.rows:
        assert row['messages'] == table.rows[0]['messages'] > 1000
        assert row['s'] > 0.0
    (mcap, _) = cells(table.text)
    bare, decoded, stored = (row['s'] for row in table.rows[:3])
    assert float(mcap[5]) == pytest.approx(decoded / bare, rel=0.01)
    assert float(mcap[6]) == pytest.approx(stored / bare, rel=0.01)


@pytest.mark.parametrize('storage', bench_reading.STORAGES)
def test_bare_reading_yields_every_message_of_the_rig(storage: Any, tmp_path: Path) -> None:
    """CameraInfo is not among them."""
    recording = simulate(build_scene(preset('studio'), 0, seconds=2.0))
    write_recording(recording, tmp_path, storage=storage)
    sent = len(recording.mocap.stamp_ns) + sum(int(s.is_sent.sum()) for s in recording.streams)
    bag, rig = tmp_path / BAG, read_rig(tmp_path / RIG)
    for how in (bench_reading.bare, bench_reading.decoded, bench_reading.stored):
        assert how(bag, rig) == sent


def test_measurements_of_size_are_named_by_the_program(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """They are not among those that are made without being asked for."""
    monkeypatch.setattr(bench_growth, 'SHORT', 300)
    assert bench.main(['growth', '--frames', '300']) == 0
    assert '## growth' in capsys.readouterr().out
    assert 'growth' not in bench.USUAL
