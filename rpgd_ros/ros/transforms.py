# SPDX-License-Identifier: Apache-2.0
"""The published pose: messages of it, and the latched topics that carry them.

Every number is cast to a Python float before it goes into a message: without its field checks
rclpy sends a numpy scalar as another number.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64

from rpgd_ros.core.camera_pose import CameraPose, is_mocap_world
from rpgd_ros.core.geometry import Array, RigidTransform
from rpgd_ros.messages.markers import ros_covariance

NS_PER_S = 1_000_000_000

LATCHED = QoSProfile(
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)


@dataclass(frozen=True, slots=True, eq=False)
class Published:
    """What stands on the output topics.

    Attributes:
        world_frame: Parent frame.
        mocap_frame: Child frame.
        world_T_mocap: Pose of the MoCap origin in the world.
        covariance: (6, 6) of (d_rot [rad], d_t [m]), world frame.
        stamp_ns: When it was published, by the clock of the node.
        cameras: Poses of the cameras that were placed, by camera.
        optical_frames: Names of their frames.

    """

    world_frame: str
    mocap_frame: str
    world_T_mocap: RigidTransform
    covariance: Array
    stamp_ns: int
    cameras: Mapping[str, CameraPose] = field(default_factory=dict)
    optical_frames: Mapping[str, str] = field(default_factory=dict)

    @property
    def camera_parent(self) -> str:
        """Parent frame of the cameras: the MoCap frame where that is the world."""
        is_mocap = is_mocap_world(self.cameras, self.covariance)
        return self.mocap_frame if is_mocap else self.world_frame


def time_message(stamp_ns: int) -> Time:
    """Return nanoseconds as a ROS time."""
    sec, nanosec = divmod(int(stamp_ns), NS_PER_S)
    return Time(sec=sec, nanosec=nanosec)


def transform_message(published: Published) -> TransformStamped:
    """Return the transform parent -> child: `x_world = world_T_mocap @ x_mocap`."""
    return _transform(
        published.stamp_ns, published.world_frame, published.mocap_frame, published.world_T_mocap
    )


def camera_transforms(published: Published) -> list[TransformStamped]:
    """Return the transforms to the optical frames of the cameras that were placed."""
    frames, parent = published.optical_frames, published.camera_parent
    return [
        _transform(published.stamp_ns, parent, frames[name], pose.world_T_camera)
        for name, pose in published.cameras.items()
    ]


def pose_message(published: Published) -> PoseWithCovarianceStamped:
    """Return the pose of the MoCap origin in the world, with its covariance in ROS order."""
    return _pose(
        published.stamp_ns, published.world_frame, published.world_T_mocap, published.covariance
    )


def camera_pose_message(published: Published, camera: str) -> PoseWithCovarianceStamped:
    """Return the pose of a placed camera's optical frame, with its covariance in ROS order."""
    pose = published.cameras[camera]
    return _pose(
        published.stamp_ns, published.camera_parent, pose.world_T_camera, pose.world_covariance
    )


def _transform(
    stamp_ns: int, parent: str, child: str, parent_T_child: RigidTransform
) -> TransformStamped:
    message = TransformStamped()
    message.header.stamp = time_message(stamp_ns)
    message.header.frame_id = parent
    message.child_frame_id = child
    t, q = message.transform.translation, message.transform.rotation
    t.x, t.y, t.z = (float(v) for v in parent_T_child.translation)
    q.x, q.y, q.z, q.w = (float(v) for v in parent_T_child.quat_xyzw)
    return message


def _pose(
    stamp_ns: int, parent: str, parent_T_child: RigidTransform, covariance: Array
) -> PoseWithCovarianceStamped:
    message = PoseWithCovarianceStamped()
    message.header.stamp = time_message(stamp_ns)
    message.header.frame_id = parent
    p, q = message.pose.pose.position, message.pose.pose.orientation
    p.x, p.y, p.z = (float(v) for v in parent_T_child.translation)
    q.x, q.y, q.z, q.w = (float(v) for v in parent_T_child.quat_xyzw)
    message.pose.covariance = ros_covariance(covariance)
    return message


class TransformOutput:
    """The latched topics ~/transform, ~/pose, ~/reprojection_error, and /tf_static if possible.

    For each camera that was placed, also ~/<camera>/pose.

    /tf_static has a publisher of our own: that of tf2_ros in Jazzy never sends a changed
    transform of a child frame it has sent before (geometry2 #704).
    """

    def __init__(self, node: Node, *, with_tf: bool) -> None:
        """Create the publishers.

        Args:
            node: The node.
            with_tf: Whether /tf_static is wanted.

        """
        self._transform = node.create_publisher(TransformStamped, '~/transform', LATCHED)
        self._pose = node.create_publisher(PoseWithCovarianceStamped, '~/pose', LATCHED)
        self._error = node.create_publisher(Float64, '~/reprojection_error', LATCHED)
        self._node = node
        self._cameras: dict[str, Publisher] = {}
        self._tf: Any = None
        self._tf_message: Any = None
        if with_tf:
            self._open_tf(node)

    def publish(self, published: Published) -> None:
        """Publish a pose on every topic; whoever joins later gets it too."""
        transform = transform_message(published)
        self._transform.publish(transform)
        self._pose.publish(pose_message(published))
        for name in published.cameras:
            self._camera(name).publish(camera_pose_message(published, name))
        if self._tf is not None:
            # One message with all children: a latched topic keeps only its last.
            transforms = [transform, *camera_transforms(published)]
            self._tf.publish(self._tf_message(transforms=transforms))

    def publish_error(self, error_px: float) -> None:
        """Publish the mean reprojection error of the published pose, pixels."""
        self._error.publish(Float64(data=float(error_px)))

    def _camera(self, name: str) -> Publisher:
        if name not in self._cameras:
            self._cameras[name] = self._node.create_publisher(
                PoseWithCovarianceStamped, f'~/{name}/pose', LATCHED
            )
        return self._cameras[name]

    def _open_tf(self, node: Node) -> None:
        self._tf_message = tf_message_class()
        if self._tf_message is None:
            node.get_logger().warning(
                'tf2_msgs is not installed: /tf_static is not published, ~/transform is. '
                'Install ros-jazzy-tf2-msgs, or set tf_mode to none to silence this.'
            )
            return
        self._tf = node.create_publisher(self._tf_message, '/tf_static', LATCHED)


def tf_message_class() -> Any:
    """Return the class of tf2_msgs/TFMessage, or None where it is not installed."""
    try:
        return importlib.import_module('tf2_msgs.msg').TFMessage
    except ImportError:
        return None
