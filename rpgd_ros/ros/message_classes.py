# SPDX-License-Identifier: Apache-2.0
"""Python classes of message types: those of ROS itself, and what drivers brought with them.

rclpy subscribes, to bytes too, only where the class of the type can be imported.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from functools import cache
from types import ModuleType
from typing import Final

from geometry_msgs.msg import PoseArray, PoseStamped
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

from rpgd_ros.messages import KEYPOINT_TYPES, POSE_STAMPED, SKELETON_TYPES
from rpgd_ros.session import MOCAP

# Imported when a topic asks for them; spelt out, so that no topic's type can name a module.
PACKAGES: Final[dict[str, Callable[[], ModuleType]]] = {
    'hri_msgs': lambda: importlib.import_module('hri_msgs.msg'),
    'mocap4r2_msgs': lambda: importlib.import_module('mocap4r2_msgs.msg'),
    'motion_capture_tracking_interfaces': lambda: importlib.import_module(
        'motion_capture_tracking_interfaces.msg'
    ),
    'openpose_ros2_msgs': lambda: importlib.import_module('openpose_ros2_msgs.msg'),
    'tf2_msgs': lambda: importlib.import_module('tf2_msgs.msg'),
    'xsens_mvn_msgs': lambda: importlib.import_module('xsens_mvn_msgs.msg'),
    'xsens_mvn_ros_msgs': lambda: importlib.import_module('xsens_mvn_ros_msgs.msg'),
    'yolo_msgs': lambda: importlib.import_module('yolo_msgs.msg'),
    'yolov8_msgs': lambda: importlib.import_module('yolov8_msgs.msg'),
    'zed_interfaces': lambda: importlib.import_module('zed_interfaces.msg'),
    'zed_msgs': lambda: importlib.import_module('zed_msgs.msg'),
}
OWN: Final[dict[str, type]] = {
    'geometry_msgs/msg/PoseArray': PoseArray,
    'geometry_msgs/msg/PoseStamped': PoseStamped,
    'sensor_msgs/msg/PointCloud2': PointCloud2,
    'visualization_msgs/msg/MarkerArray': MarkerArray,
}


@cache
def message_class(msg_type: str) -> type | None:
    """Return the class of a type that this package reads, None where it is not installed."""
    if msg_type in OWN:
        return OWN[msg_type]
    package, _, name = msg_type.partition('/msg/')
    try:
        found = getattr(PACKAGES[package](), name, None)
    except (ImportError, KeyError):
        return None
    return found if isinstance(found, type) else None


def not_installed(topic: str, msg_type: str) -> str:
    """Say what is to be installed for a topic to be read."""
    package = msg_type.partition('/')[0]
    return (
        f'{topic} has type {msg_type}, but Python has no {package} here: install the package '
        f'{package} (ros-jazzy-{package.replace("_", "-")}, or build it with the driver), source '
        'its setup.bash and start again; a recording of the topic can be read without it'
    )


def readable_types(stream: str) -> tuple[str, ...]:
    """Return the types that a stream of the session may have."""
    name, _, part = stream.partition('/')
    if part:
        return (POSE_STAMPED,)
    return SKELETON_TYPES if name == MOCAP else KEYPOINT_TYPES
