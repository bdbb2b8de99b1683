# SPDX-License-Identifier: Apache-2.0
"""The messages of the published pose."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rpgd_ros.core.geometry import RigidTransform, so3_exp

pytest.importorskip('rclpy')

from rpgd_ros.ros.transforms import (
    Published,
    pose_message,
    time_message,
    transform_message,
)

numbers = st.floats(-3.0, 3.0, allow_subnormal=False)


def published(rotvec: list[float], xyz: list[float]) -> Published:
    """Return a pose with a covariance whose every element is its own number."""
    half = np.arange(36.0).reshape(6, 6)
    return Published(
        world_frame='studio',
        mocap_frame='vicon',
        world_T_mocap=RigidTransform(so3_exp(rotvec), np.array(xyz)),
        covariance=half + half.T,
        stamp_ns=1_700_000_000_123_456_789,
    )


@given(st.lists(numbers, min_size=3, max_size=3), st.lists(numbers, min_size=3, max_size=3))
@settings(derandomize=True, max_examples=50, deadline=None)
def test_transform_moves_points_of_the_child_frame_to_the_parent_frame(
    rotvec: list[float], xyz: list[float]
) -> None:
    """What a listener builds from the message is world_T_mocap, not its inverse."""
    pose = published(rotvec, xyz)
    message = transform_message(pose)
    t, q = message.transform.translation, message.transform.rotation
    heard = RigidTransform.from_quat_xyzw([t.x, t.y, t.z], [q.x, q.y, q.z, q.w])
    x_mocap = np.array([0.3, -1.2, 1.7])
    assert np.allclose(heard @ x_mocap, pose.world_T_mocap @ x_mocap, atol=1e-12)
    assert (message.header.frame_id, message.child_frame_id) == ('studio', 'vicon')
    assert q.w >= 0.0


def test_fields_are_python_floats() -> None:
    """Without field checks rclpy sends a numpy scalar as another number."""
    message = transform_message(published([0.1, 0.2, 0.3], [1.0, 2.0, 3.0]))
    assert type(message.transform.translation.x) is float
    assert type(message.transform.rotation.w) is float
    pose = pose_message(published([0.1, 0.2, 0.3], [1.0, 2.0, 3.0]))
    assert type(pose.pose.pose.position.z) is float
    assert {type(value) for value in pose.pose.covariance} <= {float, np.float64}


def test_covariance_is_sent_in_the_order_of_ros() -> None:
    """ROS has the position first: x y z rotX rotY rotZ, row by row."""
    pose = published([0.0, 0.0, 0.1], [1.0, 2.0, 3.0])
    sent = np.array(pose_message(pose).pose.covariance).reshape(6, 6)
    assert np.array_equal(sent[:3, :3], pose.covariance[3:, 3:])
    assert np.array_equal(sent[3:, 3:], pose.covariance[:3, :3])
    assert np.array_equal(sent[:3, 3:], pose.covariance[3:, :3])


def test_stamp_keeps_every_nanosecond() -> None:
    """A stamp is an integer; as a float it would be 200 ns off."""
    message = time_message(1_700_000_000_123_456_789)
    assert (message.sec, message.nanosec) == (1_700_000_000, 123_456_789)
