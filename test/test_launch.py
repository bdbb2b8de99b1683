# SPDX-License-Identifier: Apache-2.0
"""The launch files, as far as they can be checked where `launch` is not installed."""

from __future__ import annotations

import ast
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from rpgd_ros.ros.parameters import parameters
from rpgd_ros.ros.settings import NodeConfig

FOLDER = Path(__file__).resolve().parents[1] / 'rpgd_ros/launch'
FILES = sorted(FOLDER.glob('*.launch.py'))


def constants(path: Path) -> dict[str, Any]:
    """Return the tables at the top of a launch file."""
    found = {}
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            found[node.targets[0].id] = ast.literal_eval(node.value)
    return found


CALIBRATE = constants(FOLDER / 'calibrate.launch.py')
REPLAY = constants(FOLDER / 'replay.launch.py')


def test_there_are_two_launch_files() -> None:
    """One for the studio, one for its recordings."""
    assert [path.name for path in FILES] == ['calibrate.launch.py', 'replay.launch.py']


@pytest.mark.parametrize('path', FILES, ids=lambda path: path.name)
def test_launch_file_compiles_and_has_the_entry_that_launch_calls(path: Path) -> None:
    """Without that function `ros2 launch` refuses the file."""
    module = ast.parse(path.read_text())
    compile(module, path, 'exec')
    names = [node.name for node in module.body if isinstance(node, ast.FunctionDef)]
    assert 'generate_launch_description' in names


@pytest.mark.parametrize('path', FILES, ids=lambda path: path.name)
def test_launch_file_gives_a_description(path: Path) -> None:
    """Where launch is installed, its own loader reads the file."""
    if find_spec('launch') is None or find_spec('launch_ros') is None:
        pytest.skip('launch is not installed')
    from launch import LaunchContext  # noqa: PLC0415
    from launch.launch_description_sources import (  # noqa: PLC0415
        PythonLaunchDescriptionSource,
    )

    source = PythonLaunchDescriptionSource(str(path))
    description = source.get_launch_description(LaunchContext())
    declared = {argument.name for argument in description.get_launch_arguments()}
    tables = CALIBRATE if path.name.startswith('calibrate') else REPLAY
    assert declared == {*tables.get('PARAMETERS', ()), *tables.get('OTHERS', ())} | {
        *tables.get('ARGUMENTS', ())
    }


def test_parameters_that_are_handed_on_exist() -> None:
    """The node refuses unknown ones, so a misspelt one would keep it from starting."""
    known = {p.name for p in parameters((), defaults=NodeConfig())}
    assert set(CALIBRATE['PARAMETERS']) <= known


def test_replay_hands_on_what_calibrate_takes() -> None:
    """Arguments of an included launch file are checked by nobody else."""
    takes = {*CALIBRATE['PARAMETERS'], *CALIBRATE['OTHERS']}
    assert set(REPLAY['PASSED_ON']) <= takes & set(REPLAY['ARGUMENTS'])


def test_replay_leaves_the_result_of_the_studio_alone() -> None:
    """Its result has a file of its own."""
    default, _ = REPLAY['ARGUMENTS']['result_file']
    assert default
    assert 'rpgd_calibrator' not in default
