# SPDX-License-Identifier: Apache-2.0
"""The message types of drivers and detectors, and what is particular about each."""

from __future__ import annotations

from typing import Final

from rpgd_ros.messages.layout import POINT_CLOUD2, POSE_ARRAY
from rpgd_ros.messages.tf import TF_MESSAGE

MARKERS: Final = 'mocap4r2_msgs/msg/Markers'
RIGID_BODIES: Final = 'mocap4r2_msgs/msg/RigidBodies'
NAMED_POSE_ARRAY: Final = 'motion_capture_tracking_interfaces/msg/NamedPoseArray'
LINK_STATE_ARRAY: Final = 'xsens_mvn_msgs/msg/LinkStateArray'
LINK_STATE_ARRAY_OLD: Final = 'xsens_mvn_ros_msgs/msg/LinkStateArray'
MARKER_ARRAY: Final = 'visualization_msgs/msg/MarkerArray'
OBJECTS: Final = 'zed_msgs/msg/ObjectsStamped'
OBJECTS_OLD: Final = 'zed_interfaces/msg/ObjectsStamped'
SKELETON_2D: Final = 'hri_msgs/msg/Skeleton2D'
DETECTIONS: Final = 'yolo_msgs/msg/DetectionArray'
DETECTIONS_OLD: Final = 'yolov8_msgs/msg/DetectionArray'
OPENPOSE_LIST: Final = 'openpose_ros2_msgs/msg/PoseKeyPointsList'
POSE_STAMPED: Final = 'geometry_msgs/msg/PoseStamped'

# One message holds one joint, or some: a skeleton is gathered from several by their stamps.
PARTIAL_TYPES: Final = (POSE_STAMPED, TF_MESSAGE)

SKELETON_TYPES: Final = (
    *(POINT_CLOUD2, POSE_ARRAY, MARKER_ARRAY, TF_MESSAGE, POSE_STAMPED, MARKERS, RIGID_BODIES),
    *(NAMED_POSE_ARRAY, LINK_STATE_ARRAY, LINK_STATE_ARRAY_OLD, OBJECTS, OBJECTS_OLD),
)
KEYPOINT_TYPES: Final = (
    *(POINT_CLOUD2, POSE_ARRAY, SKELETON_2D, DETECTIONS, DETECTIONS_OLD, OBJECTS, OBJECTS_OLD),
    OPENPOSE_LIST,
)
# Coordinates are shares of the image's width and height, whatever the rig file says.
NORMALISED_TYPES: Final = frozenset({SKELETON_2D})
# Messages may come without a header: their stamp is the time of their sending.
HEADERLESS_TYPES: Final = frozenset({OPENPOSE_LIST})
