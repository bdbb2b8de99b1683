# SPDX-License-Identifier: Apache-2.0
"""The programs with several persons in view: simulated, recorded, calibrated."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from rpgd_ros.apps import calibrate_bag, simulate


def made(folder: Path, *words: str) -> Path:
    """Run simulate for eight seconds."""
    output = folder / 'crowd'
    command = ['--preset', 'studio', '--output', str(output), '--seconds', '8', *words]
    assert simulate.main(command) == 0
    return output


@pytest.mark.parametrize('subjects', [1, 2])
def test_bag_of_three_persons_gives_the_transform(
    tmp_path: Path, subjects: int, capsys: pytest.CaptureFixture[str]
) -> None:
    """Shuffled in every message; the share of the frames that show the subjects is printed."""
    output = made(tmp_path, '--persons', '3', '--subjects', str(subjects))
    truth = yaml.safe_load((output / 'truth.yaml').read_text())
    assert (truth['persons'], truth['subjects']) == (3, subjects)
    result = tmp_path / 'result.yaml'
    words = [str(output / 'bag'), '--rig', str(output / 'rig.yaml'), '--output', str(result)]
    assert calibrate_bag.main(words) == calibrate_bag.EXIT_ACCEPTED
    found = yaml.safe_load(result.read_text())['world_T_mocap']
    np.testing.assert_allclose(found['xyz'], truth['world_T_mocap']['xyz'], atol=2e-3)
    np.testing.assert_allclose(found['quat_xyzw'], truth['world_T_mocap']['quat_xyzw'], atol=1e-3)
    out = capsys.readouterr().out
    assert 'shown in' in out
    assert 'further_persons' in out


def test_report_and_json_of_a_crowd_are_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What looks at the data afterwards sees the persons with MoCap only."""
    pytest.importorskip('plotly')
    output = made(tmp_path, '--persons', '3')
    words = [str(output / 'bag'), '--rig', str(output / 'rig.yaml'), '--json']
    capsys.readouterr()
    code = calibrate_bag.main([*words, '--report', str(tmp_path / 'report.html')])
    assert code == calibrate_bag.EXIT_ACCEPTED
    assert json.loads(capsys.readouterr().out)['status'] == 'accepted'
    assert (tmp_path / 'report.html').stat().st_size > 1000


@pytest.mark.parametrize(
    'words',
    [
        ('--persons', '0'),
        ('--persons', '21'),
        ('--persons', '2', '--subjects', '3'),
        ('--persons', '2', '--subjects', '2', '--mocap-type', 'PoseArray'),
        ('--persons', '2', '--format', 'dataset'),
    ],
)
def test_crowds_that_cannot_be_are_bad_input(tmp_path: Path, words: tuple[str, ...]) -> None:
    """Said in one line; nothing is left behind."""
    output = tmp_path / 'crowd'
    command = ['--preset', 'studio', '--output', str(output), '--seconds', '2', *words]
    assert simulate.main(command) == simulate.EXIT_BAD_INPUT
    assert not output.exists()
