# SPDX-License-Identifier: Apache-2.0
"""The demo as a user runs it: to its end, and into Ctrl-C."""

from __future__ import annotations

import re
import signal
from importlib.util import find_spec
from pathlib import Path

from harness import ros_environment, running
from scenes import errors

from rpgd_ros.io.result_file import read_result
from rpgd_ros.ros.domain import free_domain
from rpgd_ros.simulation import build_scene, preset, simulate

DEMO = ['-m', 'rpgd_ros.apps.demo']
WAIT_S = 60.0


def processes_with(word: str) -> list[int]:
    """Return the processes that have a word in their command line."""
    found = []
    for path in Path('/proc').glob('[0-9]*/cmdline'):
        try:
            if word.encode() in path.read_bytes():
                found.append(int(path.parent.name))
        except OSError:  # ended meanwhile
            continue
    return found


def test_demo_finds_the_truth_and_leaves_its_result_and_report(tmp_path: Path) -> None:
    """Simulated, played over DDS, calibrated by the real node, compared with the truth.

    The page that it tells people to look at is there and begins with the verdict.
    """
    output = tmp_path / 'demo'
    arguments = [*DEMO, '--output', str(output), '--seconds', '10', '--rate', '8']
    with running(arguments, ros_environment(free_domain())) as demo:
        assert demo.wait(seconds=WAIT_S) == 0, demo.output
        said = re.search(r'rotation error +([\d.]+) deg', demo.output)
        told = demo.output
    assert said
    if all(map(find_spec, ('plotly', 'jinja2'))):
        page = output / 'result.html'
        assert f'look at it: {page}' in told.replace('\n', '')
        assert '<h1>Accepted' in page.read_text()
    recording = simulate(build_scene(preset('studio'), 0, seconds=10.0))
    found = read_result(output / 'result.yaml').world_T_mocap
    error_deg, error_m = errors(found, recording.truth.world_T_mocap, recording.observations())
    assert abs(error_deg - float(said[1])) < 1e-4
    assert error_m < 0.005
    assert (output / 'recording' / 'truth.yaml').is_file()
    assert not processes_with(str(output))


def test_ctrl_c_leaves_nothing_running_and_no_temporary_file(tmp_path: Path) -> None:
    """Stopped while it plays: the node goes with it, what was finished stays."""
    output, scratch = tmp_path / 'demo', tmp_path / 'scratch'
    scratch.mkdir()
    environment = ros_environment(free_domain(), TMPDIR=str(scratch))
    # So slow that it cannot have ended by itself.
    arguments = [*DEMO, '--output', str(output), '--seconds', '10', '--rate', '0.1']
    with running(arguments, environment) as demo:
        demo.wait_for('starting the calibrator', seconds=WAIT_S)
        assert demo.end(signal.SIGINT, seconds=WAIT_S) == 130, demo.output
        assert 'Traceback' not in demo.output
    assert not processes_with(str(output))
    assert not list(scratch.iterdir())
    assert not [path for path in output.rglob('*') if path.name.endswith('.tmp')]


def test_output_that_cannot_be_made_is_said(tmp_path: Path) -> None:
    """A file where the folder should be ends the demo before it begins."""
    (tmp_path / 'demo').write_text('')
    with running([*DEMO, '--output', str(tmp_path / 'demo')], ros_environment(1)) as demo:
        assert demo.wait(seconds=WAIT_S) == 2
        assert 'cannot be made' in demo.output
