# SPDX-License-Identifier: Apache-2.0
"""Parameters of the running node: what may change, what may not, and when it counts."""

from __future__ import annotations

import signal
from typing import Any

import pytest
from rcl_interfaces.msg import Parameter, ParameterDescriptor, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, SetParameters
from ros_live import WAIT_S, Live, live
from ros_scene import Scene

from rpgd_ros.ros.client import NODE


@pytest.fixture(scope='module')
def node(walk: Scene) -> Any:
    """Return one running node for all tests of this file, with the walk played."""
    with live(walk.rig) as running:
        running.play(walk)
        yield running
        assert running.child.end(signal.SIGINT, seconds=WAIT_S) == 0


def ask(node: Live, service: str, srv_type: Any, **fields: Any) -> Any:
    """Call a service of the node and return its answer."""
    called = node.peer.begin_call(
        f'{NODE}/{service}', seconds=WAIT_S, srv_type=srv_type, request=srv_type.Request(**fields)
    )
    assert called is not None
    node.wait_until(f'no answer of {service}', called.done)
    return called.result()


def set_to(node: Live, name: str, value: ParameterValue) -> str:
    """Set a parameter; return why that was refused, '' = it was not."""
    parameters = [Parameter(name=name, value=value)]
    result = ask(node, 'set_parameters', SetParameters, parameters=parameters).results[0]
    assert result.successful == (not result.reason)
    return str(result.reason)


def integer(value: int) -> ParameterValue:
    """Return an integer as a parameter value."""
    return ParameterValue(type=ParameterType.PARAMETER_INTEGER, integer_value=value)


def double(value: float) -> ParameterValue:
    """Return a double as a parameter value."""
    return ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value)


def test_change_holds_from_the_next_run(node: Live) -> None:
    """The gates can be moved between two calls."""
    assert node.calibrate()[0]
    assert set_to(node, 'accept.min_pairs', integer(10**6)) == ''
    assert node.calibrate()[1]['reason'] == 'too_few_inliers'
    assert set_to(node, 'accept.min_pairs', integer(60)) == ''
    assert node.calibrate()[0]


def test_integer_may_stand_for_a_double(node: Live) -> None:
    """`ros2 param set ... 5` sends an integer, which rclpy would refuse."""
    assert set_to(node, 'buffer.max_age_s', integer(200)) == ''
    assert node.calibrate()[0]


def test_guidance_counts_no_more_than_a_buffer_that_was_shortened(walk: Scene) -> None:
    """Eight seconds were recorded; two of them are left."""
    with live(walk.rig) as running:
        running.play(walk)

        def recorded_s() -> float:
            return float(running.peer.diagnostics('calibration').get('recorded_s', 'nan'))

        running.wait_until('not recorded', lambda: recorded_s() >= 7.0)
        assert set_to(running, 'buffer.max_age_s', double(2.0)) == ''
        running.wait_until('not let go', lambda: recorded_s() <= 3.0)


@pytest.mark.parametrize(
    ('name', 'value', 'reason'),
    [
        ('accept.min_inlier_ratio', double(2.0), 'min_inlier_ratio'),
        ('accept.min_inlier_ratio', integer(2), '2.0 is outside 0 to 1'),
        ('accept.min_inlier_ratio', double(float('nan')), 'min_inlier_ratio'),
        ('accept.min_pairs', double(3.0), 'Wrong parameter type'),
        ('accept.min_inlier_ratio', ParameterValue(), 'need a number, got None'),
        ('rig_file', ParameterValue(type=ParameterType.PARAMETER_STRING), 'read-only'),
        ('ransac.seed', integer(4), 'read-only'),
        ('accept.min_piars', integer(60), 'undeclared'),
    ],
)
def test_bad_change_is_refused_with_a_reason(
    node: Live, name: str, value: ParameterValue, reason: str
) -> None:
    """A refused change changes nothing."""
    assert reason in set_to(node, name, value)
    assert node.calibrate()[0]


def test_camera_can_be_shifted_in_time_while_the_node_runs(node: Live) -> None:
    """Nine seconds too late, the keypoints of an eight second walk meet no skeleton."""
    names = [f'camera.cam{i}.time_offset' for i in range(4)]
    before = node.calibrate()[1]
    for name in names:
        assert set_to(node, name, double(9.0)) == ''
    assert node.calibrate()[1]['reason'] == 'no_data'
    assert set_to(node, 'mocap.time_offset', double(9.0)) == ''
    assert node.calibrate()[1]['xyz'] == before['xyz']
    for name in [*names, 'mocap.time_offset']:
        assert set_to(node, name, double(0.0)) == ''


def test_every_parameter_is_described(node: Live) -> None:
    """`ros2 param describe` gives meaning, range and whether it may change."""
    names = ['accept.max_sigma_deg', 'ransac.iterations', 'rig_file']
    described = ask(node, 'describe_parameters', DescribeParameters, names=names).descriptors
    sigma, iterations, rig_file = described
    assert isinstance(sigma, ParameterDescriptor)
    assert 'rotation' in sigma.description
    assert sigma.floating_point_range[0].to_value == 180.0
    assert iterations.integer_range[0].from_value == 1
    assert rig_file.read_only
    assert not sigma.read_only
