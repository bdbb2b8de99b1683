# SPDX-License-Identifier: Apache-2.0
"""What the README says is what the code does."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from rpgd_ros.core import Camera, Observations, RigidTransform
from rpgd_ros.io.rig import read_rig
from rpgd_ros.ros.parameters_text import markdown_table
from rpgd_ros.simulation import twin

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / 'README.md').read_text()


def block(language: str, containing: str) -> str:
    """Return the code block that contains a text."""
    blocks = re.findall(rf'```{language}\n(.*?)```', README, re.DOTALL)
    return str(next(b for b in blocks if containing in b))


def test_the_table_of_parameters_is_the_one_of_the_code() -> None:
    """Names, defaults, ranges and meanings are derived, not written."""
    table = README.split('<!-- parameters: begin -->\n')[1].split('<!-- parameters: end -->')[0]
    assert table == markdown_table()


def test_the_rig_file_of_the_readme_is_read(tmp_path: Path) -> None:
    """Whoever copies it gets no error."""
    text = block('yaml', 'schema: 1')
    (tmp_path / 'rig.yaml').write_text(text)
    rig = read_rig(tmp_path / 'rig.yaml')
    assert rig.world_frame == yaml.safe_load(text)['world_frame']
    assert rig.cameras[0].camera is not None


def test_the_python_example_runs_as_it_stands() -> None:
    """The public API is what is shown."""
    case = twin('human36m', 200, 0)
    first, view = case.cameras[0], case.observations.views[0]
    assert first.camera_T_world is not None
    names = {
        'K': first.matrix,
        'd': first.distortion,
        'R': first.camera_T_world.rotation,
        't': first.camera_T_world.translation,
        'joints': view.x_mocap,
        'keypoints': view.uv[None],
    }
    code = block('python', 'Observations.from_arrays')
    code = code.replace('(1920, 1080)', str(first.size))
    exec(compile(code, 'README.md', 'exec'), names)  # noqa: S102 - our own file
    calibration = names['calibration']
    assert isinstance(names['camera'], Camera)
    assert isinstance(names['observations'], Observations)
    pose: RigidTransform = calibration.world_T_mocap
    truth = case.truth.world_T_mocap
    assert np.abs(pose.rotation - truth.rotation).max() < 0.01


@pytest.mark.parametrize('target', re.findall(r'\]\((?!http)([^)#]+)\)', README))
def test_every_link_of_the_readme_leads_somewhere(target: str) -> None:
    """Files that were moved are noticed."""
    assert (ROOT / target).exists()


def test_every_make_target_that_is_named_exists() -> None:
    """`make` does what the README says."""
    makefile = (ROOT / 'Makefile').read_text()
    for target in set(re.findall(r'`make ([a-z-]+)', README)):
        assert re.search(rf'^{target}:', makefile, re.MULTILINE), target
