# SPDX-License-Identifier: Apache-2.0
"""Serialised messages to arrays and back, without ROS.

The bytes are those of the wire and of bags (CDR): a live node takes them from raw subscriptions.
"""

from rpgd_ros.messages.adapters import (
    HEADERLESS_TYPES,
    KEYPOINT_TYPES,
    NO_HEADER,
    NORMALISED_TYPES,
    PARTIAL_TYPES,
    POSE_STAMPED,
    SKELETON_TYPES,
    decode,
    decode_parts,
)
from rpgd_ros.messages.batch import Decoded, JointBatch
from rpgd_ros.messages.camera_info import (
    CAMERA_INFO,
    CameraInfo,
    decode_camera_info,
    encode_camera_info,
)
from rpgd_ros.messages.cdr import MAX_FRAME_ID, MAX_MESSAGE_BYTES
from rpgd_ros.messages.encode import MAX_JOINTS, encode_point_cloud2, encode_pose_array
from rpgd_ros.messages.frames import FrameTree
from rpgd_ros.messages.joints import decode_joints
from rpgd_ros.messages.layout import JOINT_TYPES, POINT_CLOUD2, POSE_ARRAY, Drop
from rpgd_ros.messages.tf import TF_MESSAGE, Link, decode_tf, encode_tf

__all__ = [
    'CAMERA_INFO',
    'HEADERLESS_TYPES',
    'JOINT_TYPES',
    'KEYPOINT_TYPES',
    'MAX_FRAME_ID',
    'MAX_JOINTS',
    'MAX_MESSAGE_BYTES',
    'NORMALISED_TYPES',
    'NO_HEADER',
    'PARTIAL_TYPES',
    'POINT_CLOUD2',
    'POSE_ARRAY',
    'POSE_STAMPED',
    'SKELETON_TYPES',
    'TF_MESSAGE',
    'CameraInfo',
    'Decoded',
    'Drop',
    'FrameTree',
    'JointBatch',
    'Link',
    'decode',
    'decode_camera_info',
    'decode_joints',
    'decode_parts',
    'decode_tf',
    'encode_camera_info',
    'encode_point_cloud2',
    'encode_pose_array',
    'encode_tf',
]
