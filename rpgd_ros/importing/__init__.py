# SPDX-License-Identifier: Apache-2.0
"""Files of a shoot, skeletons and keypoints, as one recording."""

from rpgd_ros.importing.export import BAG, RIG, check_plan, write_plan
from rpgd_ros.importing.keypoints import Detections, camera_paths, read_keypoints
from rpgd_ros.importing.plan import CameraPlan, Plan, keypoint_joints, plan_camera
from rpgd_ros.importing.skeleton import AXES, MAX_FPS, Skeleton, SkeletonFile, settle
from rpgd_ros.importing.skeleton_files import read_skeleton

__all__ = [
    'AXES',
    'BAG',
    'MAX_FPS',
    'RIG',
    'CameraPlan',
    'Detections',
    'Plan',
    'Skeleton',
    'SkeletonFile',
    'camera_paths',
    'check_plan',
    'keypoint_joints',
    'plan_camera',
    'read_keypoints',
    'read_skeleton',
    'settle',
    'write_plan',
]
