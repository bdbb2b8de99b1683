# SPDX-License-Identifier: Apache-2.0
"""The parameters of the node, without ROS."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest
import yaml

from rpgd_ros.core.config import CalibrationConfig
from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.ros.parameters import parameters, read_config
from rpgd_ros.ros.parameters_text import (
    EXAMPLE_CAMERA,
    calibrator_yaml,
    markdown_table,
    paper_yaml,
)
from rpgd_ros.ros.settings import NodeConfig
from rpgd_ros.ros.setup import read_setup

CONFIG = Path(__file__).parent.parent / 'config'
CAMERAS = ('cam0', 'cam1')


def flat(tree: Mapping[str, object], prefix: str = '') -> dict[str, object]:
    """Return a parameter file's values by full name, as rcl does."""
    found: dict[str, object] = {}
    for key, value in tree.items():
        if isinstance(value, Mapping):
            found |= flat(value, f'{prefix}{key}.')
        else:
            found[prefix + key] = value
    return found


def values_of(text: str) -> dict[str, object]:
    """Return the values of a parameter file by full name."""
    return flat(yaml.safe_load(text)['/**']['ros__parameters'])


def test_example_file_holds_every_parameter_at_its_default() -> None:
    """Starting with the example file is starting without one."""
    given = values_of(calibrator_yaml())
    assert set(given) == {p.name for p in parameters([EXAMPLE_CAMERA]) if not p.is_from_rig}
    config = read_config(given, [EXAMPLE_CAMERA])
    assert config.session() == NodeConfig().session()
    assert config.node == NodeConfig().node


def test_paper_file_gives_the_published_method() -> None:
    """The node with config/paper.yaml runs CalibrationConfig.paper()."""
    calibration = read_config(values_of(paper_yaml()), CAMERAS).session().calibration
    paper = CalibrationConfig.paper()
    assert (calibration.ransac, calibration.refine) == (paper.ransac, paper.refine)
    assert calibration.accept == paper.accept


@pytest.mark.parametrize(
    ('name', 'text'), [('calibrator.yaml', calibrator_yaml()), ('paper.yaml', paper_yaml())]
)
def test_files_in_config_are_those_of_the_code(name: str, text: str) -> None:
    """What users copy cannot drift from what the code does."""
    assert (CONFIG / name).read_text() == text, (
        'write them anew: from rpgd_ros.ros.parameters_text import Path, write_config; '
        'write_config(Path("config"))'
    )


def test_table_names_every_parameter() -> None:
    """The table of the README leaves none out."""
    table = markdown_table()
    assert all(f'`{p.name}`' in table for p in parameters(['<name>']))


def test_integer_stands_for_a_float() -> None:
    """`-p auto.period_s:=5` means 5.0."""
    period = read_config({'auto.period_s': 5}, CAMERAS).auto.period_s
    assert (period, type(period)) == (5.0, float)


@pytest.mark.parametrize(
    ('name', 'value', 'match'),
    [
        ('auto.period_s', 'ten', "auto.period_s: need a number, got 'ten'"),
        ('auto.period_s', True, 'need a number, got True'),
        ('auto.period_s', 0.1, r'0.1 is outside 0.5 to 3600 s'),
        ('auto.period_s', float('nan'), 'nan is outside'),
        ('auto.enabled', 1, 'auto.enabled: need true or false, got 1'),
        ('ransac.iterations', 2.5, 'ransac.iterations: need an integer, got 2.5'),
        ('refine.method', 'lm', "'lm' is none of newton, adam, none"),
        ('cameras', 'cam0', "cameras: need a list of strings, got 'cam0'"),
        ('rig_file', 3, 'rig_file: need a string, got 3'),
        ('ransac.treshold_px', 3.0, 'did you mean ransac.threshold_px?'),
        ('auto', 3.0, 'unknown parameter'),
    ],
)
def test_bad_value_is_refused_with_its_name(name: str, value: object, match: str) -> None:
    """The message says what was found and what is needed."""
    with pytest.raises(InputError, match=match) as refused:
        read_config({name: value}, CAMERAS)
    assert refused.value.reason is Reason.BAD_PARAMETER


@pytest.mark.parametrize(
    ('name', 'value'), [('cameras', ['cam0', 'cam7']), ('camera.cam7.type', '')]
)
def test_unknown_camera_is_refused_with_those_that_exist(name: str, value: object) -> None:
    """A camera of another rig is not silently ignored."""
    with pytest.raises(InputError, match=r"no (camera )?'cam7', it has cam0, cam1") as refused:
        read_config({name: value}, CAMERAS)
    assert refused.value.reason is Reason.UNKNOWN_CAMERA


@pytest.mark.parametrize('empty', [None, [], ['']])
def test_empty_list_of_cameras_means_all(empty: object) -> None:
    """Neither rcl nor rclpy can say 'empty list of strings'."""
    assert read_config({'cameras': empty}, CAMERAS).node.cameras == ()


def test_later_values_build_on_earlier_ones() -> None:
    """A change at run time leaves everything else as it was."""
    first = read_config({'ransac.iterations': 7, 'camera.cam1.type': ''}, CAMERAS)
    second = read_config({'accept.min_pairs': 5}, CAMERAS, base=first)
    assert (second.ransac.iterations, second.accept.min_pairs) == (7, 5)
    assert second.cameras == first.cameras


@pytest.mark.threat('S9')
def test_long_foreign_names_are_cut() -> None:
    """A message of any length would be a way to flood the log."""
    with pytest.raises(InputError) as refused:
        read_config({'x' * 10_000: 1}, CAMERAS)
    assert len(refused.value.message) < 200


@pytest.mark.parametrize('frame', ['/world', ' ', 'a b', '\n', ''])
@pytest.mark.parametrize('name', ['world_frame', 'mocap_frame', 'camera.cam0.frame_id'])
def test_frame_that_a_rig_file_may_not_name_is_refused_as_a_parameter(
    name: str, frame: str
) -> None:
    """TF would have it under another name, or a result file could not be read back."""
    rig = Path(__file__).parents[1] / 'config' / 'rigs' / 'example_rig.yaml'
    given = {'rig_file': str(rig), name: frame}
    if not frame and name != 'world_frame':
        read_setup(given)  # nothing is given
        return
    with pytest.raises(InputError, match=f'{name}: need a frame without blanks') as refused:
        read_setup(given)
    assert refused.value.reason is Reason.BAD_PARAMETER


def test_frame_given_as_a_parameter_goes_before_the_pose_of_the_rig_file(tmp_path: Path) -> None:
    """The user who names a frame wants the pose of TF."""
    pose = 'camera_T_world: {xyz: [0, 0, 5], quat_xyzw: [0, 0, 0, 1]}'
    camera = f'{{name: cam0, keypoints: coco17, {pose}}}'
    path = tmp_path / 'rig.yaml'
    path.write_text(
        f'schema: 1\nworld_frame: studio\nmocap: {{joints: plug_in_gait}}\ncameras: [{camera}]\n'
    )
    rig, _ = read_setup({'rig_file': str(path)})
    assert rig.cameras[0].extrinsics is not None
    rig, _ = read_setup({'rig_file': str(path), 'camera.cam0.frame_id': 'cam0_optical'})
    assert rig.cameras[0].extrinsics is None
    assert rig.cameras[0].frame_id == 'cam0_optical'
