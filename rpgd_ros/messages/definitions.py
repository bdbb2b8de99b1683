# SPDX-License-Identifier: Apache-2.0
"""Definitions of third-party message types: for bags that are written, or that lack them.

Humble's sqlite3 recordings hold no definitions, and a recorder writes none of a type whose package
is not installed. Reading needs them not: the decoders know where the bytes lie.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

_MOCAP4R2: Final = {
    'Marker': """
        int8 USE_NAME=0
        int8 USE_INDEX=1
        int8 USE_BOTH=2
        int8 id_type
        int32 marker_index
        string marker_name
        geometry_msgs/Point translation
        """,
    'Markers': """
        std_msgs/Header header
        uint32 frame_number
        mocap4r2_msgs/Marker[] markers
        """,
    'RigidBody': """
        string rigid_body_name
        mocap4r2_msgs/Marker[] markers
        geometry_msgs/Pose pose
        """,
    'RigidBodies': """
        std_msgs/Header header
        uint32 frame_number
        mocap4r2_msgs/RigidBody[] rigidbodies
        """,
}
_MOTION_CAPTURE_TRACKING: Final = {
    'NamedPose': """
        string name
        geometry_msgs/Pose pose
        """,
    'NamedPoseArray': """
        std_msgs/Header header
        motion_capture_tracking_interfaces/NamedPose[] poses
        """,
}
_XSENS: Final = {
    'LinkState': """
        std_msgs/Header header
        geometry_msgs/Pose pose
        geometry_msgs/Twist twist
        geometry_msgs/Accel accel
        """,
    'LinkStateArray': """
        std_msgs/Header header
        PACKAGE/LinkState[] states
        """,
}
_ZED: Final = {
    'Keypoint2Df': 'float32[2] kp',
    'Keypoint2Di': 'uint32[2] kp',
    'Keypoint3D': 'float32[3] kp',
    'BoundingBox2Df': 'PACKAGE/Keypoint2Df[4] corners',
    'BoundingBox2Di': 'PACKAGE/Keypoint2Di[4] corners',
    'BoundingBox3D': 'PACKAGE/Keypoint3D[8] corners',
    'Skeleton2D': 'PACKAGE/Keypoint2Df[70] keypoints',
    'Skeleton3D': 'PACKAGE/Keypoint3D[70] keypoints',
    'Object': """
        string label
        int16 label_id
        string sublabel
        float32 confidence
        float32[3] position
        float32[6] position_covariance
        float32[3] velocity
        bool tracking_available
        int8 tracking_state
        int8 action_state
        PACKAGE/BoundingBox2Di bounding_box_2d
        PACKAGE/BoundingBox3D bounding_box_3d
        float32[3] dimensions_3d
        bool skeleton_available
        int8 body_format
        PACKAGE/BoundingBox2Df head_bounding_box_2d
        PACKAGE/BoundingBox3D head_bounding_box_3d
        float32[3] head_position
        PACKAGE/Skeleton2D skeleton_2d
        PACKAGE/Skeleton3D skeleton_3d
        """,
    'ObjectsStamped': """
        std_msgs/Header header
        PACKAGE/Object[] objects
        """,
}
_HRI: Final = {
    'NormalizedPointOfInterest2D': """
        float32 x
        float32 y
        float32 c
        """,
    'Skeleton2D': """
        std_msgs/Header header
        uint8 NOSE=0
        uint8 NECK=1
        uint8 RIGHT_SHOULDER=2
        uint8 RIGHT_ELBOW=3
        uint8 RIGHT_WRIST=4
        uint8 LEFT_SHOULDER=5
        uint8 LEFT_ELBOW=6
        uint8 LEFT_WRIST=7
        uint8 RIGHT_HIP=8
        uint8 RIGHT_KNEE=9
        uint8 RIGHT_ANKLE=10
        uint8 LEFT_HIP=11
        uint8 LEFT_KNEE=12
        uint8 LEFT_ANKLE=13
        uint8 LEFT_EYE=14
        uint8 RIGHT_EYE=15
        uint8 LEFT_EAR=16
        uint8 RIGHT_EAR=17
        hri_msgs/NormalizedPointOfInterest2D[18] skeleton
        """,
}
_YOLO: Final = {
    'Point2D': """
        float64 x
        float64 y
        """,
    'Vector2': """
        float64 x
        float64 y
        """,
    'Pose2D': """
        PACKAGE/Point2D position
        float64 theta
        """,
    'BoundingBox2D': """
        PACKAGE/Pose2D center
        PACKAGE/Vector2 size
        """,
    'BoundingBox3D': """
        geometry_msgs/Pose center
        geometry_msgs/Vector3 size
        string frame_id
        """,
    'Mask': """
        int32 height
        int32 width
        PACKAGE/Point2D[] data
        """,
    'KeyPoint2D': """
        int32 id
        PACKAGE/Point2D point
        float64 score
        """,
    'KeyPoint2DArray': 'PACKAGE/KeyPoint2D[] data',
    'KeyPoint3D': """
        int32 id
        geometry_msgs/Point point
        float64 score
        """,
    'KeyPoint3DArray': """
        PACKAGE/KeyPoint3D[] data
        string frame_id
        """,
    'Detection': """
        int32 class_id
        string class_name
        float64 score
        string id
        PACKAGE/BoundingBox2D bbox
        PACKAGE/BoundingBox3D bbox3d
        PACKAGE/Mask mask
        PACKAGE/KeyPoint2DArray keypoints
        PACKAGE/KeyPoint3DArray keypoints3d
        """,
    'DetectionArray': """
        std_msgs/Header header
        PACKAGE/Detection[] detections
        """,
}
_OPENPOSE: Final = {
    'PoseKeyPoint': """
        float32 x
        float32 y
        float32 score
        """,
    'PoseKeyPoints': 'openpose_ros2_msgs/PoseKeyPoint[] pose_key_points',
    'PoseKeyPointsList': """
        std_msgs/Header header
        openpose_ros2_msgs/PoseKeyPoints[] pose_key_points_list
        """,
}
# Two names of one package stand where it was renamed without a change of its messages.
_PACKAGES: Final = {
    'mocap4r2_msgs': _MOCAP4R2,
    'motion_capture_tracking_interfaces': _MOTION_CAPTURE_TRACKING,
    'xsens_mvn_msgs': _XSENS,
    'xsens_mvn_ros_msgs': _XSENS,
    'zed_msgs': _ZED,
    'zed_interfaces': _ZED,
    'hri_msgs': _HRI,
    'yolo_msgs': _YOLO,
    'yolov8_msgs': _YOLO,
    'openpose_ros2_msgs': _OPENPOSE,
}

DEFINITIONS: Mapping[str, str] = MappingProxyType({
    f'{package}/msg/{name}': '\n'.join(
        line.strip() for line in text.replace('PACKAGE', package).strip().splitlines()
    )
    for package, messages in _PACKAGES.items()
    for name, text in messages.items()
})  # fmt: skip
