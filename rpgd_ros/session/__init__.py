# SPDX-License-Identifier: Apache-2.0
"""The whole job without ROS: messages in, a snapshot of observations out, and its solve.

The live node and `calibrate_bag` are thin shells around it. A `Session` belongs to one thread; a
`Snapshot` is complete in itself and may be solved in another.
"""

from rpgd_ros.session.camera_facts import TF, TF_STATIC, CameraFacts
from rpgd_ros.session.collect import MOCAP, Session
from rpgd_ros.session.config import SessionConfig
from rpgd_ros.session.snapshot import Snapshot, solve

__all__ = [
    'MOCAP',
    'TF',
    'TF_STATIC',
    'CameraFacts',
    'Session',
    'SessionConfig',
    'Snapshot',
    'solve',
]
