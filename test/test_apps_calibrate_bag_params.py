# SPDX-License-Identifier: Apache-2.0
"""`calibrate_bag --params`: the node's parameter file, with the node's strictness."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from rpgd_ros.apps import calibrate_bag
from rpgd_ros.ros.parameters_text import calibrator_yaml, paper_yaml
from rpgd_ros.simulation import build_scene, preset, simulate
from rpgd_ros.simulation.export import write_recording


class Outcome(NamedTuple):
    """What a run gave."""

    code: int
    told: Any
    err: str


Run = Callable[..., Outcome]


@pytest.fixture(scope='module')
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a walk before four cameras."""
    folder = tmp_path_factory.mktemp('walk')
    write_recording(simulate(build_scene(preset('studio'), 0, seconds=8.0)), folder)
    return folder


@pytest.fixture
def run(walk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Run:
    """Return a function that calibrates with a parameter file of this text."""

    def run(text: str, *words: object, rig: bool = True) -> Outcome:
        (tmp_path / 'p.yaml').write_text(text)
        given = ['--rig', walk / 'rig.yaml'] if rig else []
        arguments = [walk / 'bag', *given, '--json', '--params', tmp_path / 'p.yaml', *words]
        code = calibrate_bag.main([str(word) for word in arguments])
        captured = capsys.readouterr()
        assert 'Traceback' not in captured.err
        return Outcome(code, json.loads(captured.out), ' '.join(captured.err.split()))

    return run


def of(**values: object) -> str:
    """Return a parameter file with these values; `__` stands for the dot."""
    flat = {name.replace('__', '.'): value for name, value in values.items()}
    return json.dumps({'/**': {'ros__parameters': flat}})


def test_the_example_file_changes_nothing_but_the_time_limit(
    run: Run, walk: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It holds the defaults; the same transform comes out, bit for bit."""
    with_file = run(calibrator_yaml())
    words = [str(walk / 'bag'), '--rig', str(walk / 'rig.yaml'), '--json']
    assert calibrate_bag.main(words) == with_file.code == 0
    without = json.loads(capsys.readouterr().out)
    assert with_file.told['result']['world_T_mocap'] == without['result']['world_T_mocap']
    parameters = with_file.told['result']['parameters']
    assert parameters.pop('max_seconds') == 60.0
    without['result']['parameters'].pop('max_seconds')
    assert parameters == without['result']['parameters']


def test_the_paper_file_runs_the_published_method(run: Run) -> None:
    """As it does in the node."""
    outcome = run(paper_yaml())
    assert outcome.code == 0
    used = outcome.told['result']['parameters']
    assert (used['refine']['method'], used['ransac']['sampling']) == ('adam', 'same_frame')


def test_gates_frames_and_cameras_are_those_of_the_file(run: Run) -> None:
    """Every parameter that means something for a recording does the same as live."""
    outcome = run(of(world_frame='hall', cameras=['cam0', 'cam2'], camera__cam2__time_offset=0.02))
    assert outcome.code == 0
    result = outcome.told['result']
    assert result['world_frame'] == 'hall'
    assert set(result['cameras']) == {'cam0', 'cam2'}
    assert run(of(accept__min_pairs=10**8)).told['reason'] == 'too_few_inliers'


def test_the_command_line_goes_before_the_file(run: Run) -> None:
    """Cameras and rig file."""
    outcome = run(of(cameras=['cam0', 'cam2'], rig_file='nowhere'), '--cameras', 'cam1', 'cam3')
    assert outcome.code == 0
    assert set(outcome.told['result']['cameras']) == {'cam1', 'cam3'}


def test_the_rig_file_may_be_that_of_the_parameters(run: Run, walk: Path) -> None:
    """One file then says everything; without either it is asked for."""
    assert run(of(rig_file=str(walk / 'rig.yaml')), rig=False).code == 0
    outcome = run(of(ransac__seed=1), rig=False)
    assert outcome.code == calibrate_bag.EXIT_BAD_INPUT
    assert 'no rig file: give --rig' in outcome.err


@pytest.mark.parametrize(
    ('values', 'message'),
    [
        ({'ransac__sead': 1}, "unknown parameter 'ransac.sead': did you mean ransac.seed?"),
        ({'ransac__seed': 'one'}, "parameter ransac.seed: need an integer, got 'one'"),
        ({'accept__min_inlier_ratio': 2.0}, 'outside 0 to 1'),
        ({'cameras': ['cam9']}, "the rig file has no 'cam9', it has cam0"),
        ({'camera__cam9__type': ''}, "the rig file has no camera 'cam9'"),
        ({'world_frame': 'mocap', 'mocap_frame': 'mocap'}, 'needs two names'),
    ],
)
def test_what_the_node_would_refuse_is_refused(
    run: Run, values: dict[str, object], message: str
) -> None:
    """Unknown names, wrong types, values out of range, cameras that are not there."""
    outcome = run(of(**values))
    assert outcome.code == calibrate_bag.EXIT_BAD_INPUT
    assert outcome.told['status'] == 'bad_input'
    assert message in outcome.err


def test_a_parameter_file_that_is_not_there_is_bad_input(
    walk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Said with its name."""
    words = [walk / 'bag', '--rig', walk / 'rig.yaml', '--params', tmp_path / 'none.yaml']
    assert calibrate_bag.main([str(w) for w in words]) == calibrate_bag.EXIT_BAD_INPUT
    assert 'none.yaml cannot be read' in capsys.readouterr().err
