# SPDX-License-Identifier: Apache-2.0
"""Files of a shoot, skeletons and keypoints, as one recording."""

from rpgd_ros.importing.export import BAG, RIG, check_plan, write_plan
from rpgd_ros.importing.keypoints import Detections, camera_paths, read_keypoints
from rpgd_ros.importing.plan import CameraPlan, Plan, keypoint_joints, plan_camera
from rpgd_ros.importing.scale import check_scale
from rpgd_ros.importing.skeleton import AXES, MAX_FPS, MIN_FPS, Skeleton, SkeletonFile, settle
from rpgd_ros.importing.skeleton_files import read_skeleton
from rpgd_ros.importing.timecode import RATES as TIMECODE_RATES
from rpgd_ros.importing.timecode import Timecode, described, is_odd_rate, seconds_after

__all__ = [
    'AXES',
    'BAG',
    'MAX_FPS',
    'MIN_FPS',
    'RIG',
    'TIMECODE_RATES',
    'CameraPlan',
    'Detections',
    'Plan',
    'Skeleton',
    'SkeletonFile',
    'Timecode',
    'camera_paths',
    'check_plan',
    'check_scale',
    'described',
    'is_odd_rate',
    'keypoint_joints',
    'plan_camera',
    'read_keypoints',
    'read_skeleton',
    'seconds_after',
    'settle',
    'write_plan',
]
