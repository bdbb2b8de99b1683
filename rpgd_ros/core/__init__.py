# SPDX-License-Identifier: Apache-2.0
"""The method: numpy, OpenCV and the standard library, pure functions, no I/O, no clock, no ROS."""

from rpgd_ros.core.calibrate import calibrate
from rpgd_ros.core.camera import Camera
from rpgd_ros.core.camera_pose import CameraPose
from rpgd_ros.core.candidates import Crowd, CrowdView
from rpgd_ros.core.config import CalibrationConfig
from rpgd_ros.core.errors import CalibrationError, InputError, Reason, RpgdError
from rpgd_ros.core.geometry import RigidTransform
from rpgd_ros.core.observations import MocapTrack, Observations, View
from rpgd_ros.core.persons import Picked, Shown, pick_persons
from rpgd_ros.core.result import Calibration, GroupFit
from rpgd_ros.core.rig_solve import RigCalibration, calibrate_cameras

__all__ = [
    'Calibration',
    'CalibrationConfig',
    'CalibrationError',
    'Camera',
    'CameraPose',
    'Crowd',
    'CrowdView',
    'GroupFit',
    'InputError',
    'MocapTrack',
    'Observations',
    'Picked',
    'Reason',
    'RigCalibration',
    'RigidTransform',
    'RpgdError',
    'Shown',
    'View',
    'calibrate',
    'calibrate_cameras',
    'pick_persons',
]
