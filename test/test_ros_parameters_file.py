# SPDX-License-Identifier: Apache-2.0
"""The node's parameter file means the same without ROS."""

from __future__ import annotations

from pathlib import Path

import pytest

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.ros.parameters import parameters, read_config
from rpgd_ros.ros.parameters_file import read_parameters
from rpgd_ros.ros.parameters_text import EXAMPLE_CAMERA, calibrator_yaml
from rpgd_ros.ros.settings import NodeConfig


def read(folder: Path, text: str) -> dict[str, object]:
    """Read a parameter file with this text."""
    (folder / 'p.yaml').write_text(text)
    return read_parameters(folder / 'p.yaml')


def test_the_example_file_is_read_as_the_defaults(tmp_path: Path) -> None:
    """Every parameter, each at its default."""
    given = read(tmp_path, calibrator_yaml())
    assert set(given) == {p.name for p in parameters([EXAMPLE_CAMERA]) if not p.is_from_rig}
    assert read_config(given, [EXAMPLE_CAMERA]).session() == NodeConfig().session()


def test_the_name_of_the_node_goes_before_the_wildcard(tmp_path: Path) -> None:
    """Wherever it stands, in any namespace; nodes of another name are left out."""
    given = read(
        tmp_path,
        """
/hall/rpgd_calibrator: {ros__parameters: {refine: {iterations: 7}}}
/**: {ros__parameters: {refine: {iterations: 5}, accept.min_pairs: 90, use_sim_time: true}}
yolo: {ros__parameters: {model: x}}
""",
    )
    assert given == {'refine.iterations': 7, 'accept.min_pairs': 90}


def test_namespaces_may_be_nested_as_rcl_allows(tmp_path: Path) -> None:
    """`hall:` above the node is the same as `/hall/` before it."""
    text = 'hall: {rpgd_calibrator: {ros__parameters: {ransac: {seed: 3}}}}'
    assert read(tmp_path, text) == {'ransac.seed': 3}


def test_number_may_be_marked_as_text(tmp_path: Path) -> None:
    """As rcl takes it, and as it is documented for ROS 2."""
    path = tmp_path / 'parameters.yaml'
    path.write_text('/**:\n  ros__parameters: {world_frame: !!str 1, auto.period_s: 1.0}\n')
    assert read_parameters(path) == {'world_frame': '1', 'auto.period_s': 1.0}


def test_numbers_are_those_of_rcl(tmp_path: Path) -> None:
    """1e-3 is a number there, and `off` is a word here."""
    given = read(
        tmp_path,
        '/**: {ros__parameters: {sync: {max_sigma_s: 1e-3, estimate_offset: off}, cameras: []}}',
    )
    config = read_config(given, [])
    assert config.clocks.max_sigma_s == 0.001
    assert config.clocks.estimate_offset == 'off'


@pytest.mark.fault(23)
@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('{}', 'need a section /\\*\\*: or rpgd_calibrator:'),
        ('other: {ros__parameters: {a: 1}}', 'found other'),
        ('/**: {ransac: {seed: 1}}', 'need a mapping, got 1'),
        ('/**: {ros__parameters: 3}', 'need a mapping, got 3'),
        ('a: &x {}\nb: *x', 'aliases'),
        ('/**: {ros__parameters: {1: 2}}', 'is no text'),
        ('', 'is empty'),
    ],
)
def test_what_is_no_parameter_file_is_refused(tmp_path: Path, text: str, message: str) -> None:
    """With the file's name and what is needed."""
    with pytest.raises(InputError, match=message) as refused:
        read(tmp_path, text)
    assert refused.value.reason is Reason.BAD_PARAMETER
    assert str(tmp_path) in refused.value.message
