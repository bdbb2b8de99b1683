# SPDX-License-Identifier: Apache-2.0
"""The settings of the node beside those of core and pairing. Needs no ROS."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from rpgd_ros.core.config import (
    AcceptConfig,
    CalibrationConfig,
    RansacConfig,
    RefineConfig,
    RigConfig,
    Stage,
    TimeConfig,
    setting,
)
from rpgd_ros.io.rig_types import KEYPOINT_UNITS, METRES_PER
from rpgd_ros.messages import KEYPOINT_TYPES, SKELETON_TYPES
from rpgd_ros.pairing import BufferConfig, SyncConfig
from rpgd_ros.session import SessionConfig


@dataclass(frozen=True)
class NodeSettings(Stage):
    """What belongs to the node as a whole."""

    rig_file: str = setting('', 'Path of the rig file: cameras, joints, topics. Always needed')
    cameras: tuple[str, ...] = setting((), 'Cameras of the rig file to use; empty = all of them')
    world_frame: str = setting('', 'Parent frame of the published transform')
    mocap_frame: str = setting(
        '', 'Child frame of the published transform; empty = that of the messages'
    )
    tf_mode: Literal['static', 'none'] = setting(
        'static', 'static: publish /tf_static; none: leave TF alone', choices=('static', 'none')
    )
    result_file: str = setting(
        '', 'Where results are kept; empty = ~/.ros/rpgd/<namespace>/<node name>.yaml'
    )
    load_on_start: bool = setting(default=True, help='Publish the kept result at start')
    zero_is_missing: bool = setting(
        default=True,
        help='Exact zeros in messages mean that the joint was not seen (many drivers do so)',
    )
    max_seconds: float = setting(
        60.0, 'Time limit of one calibration; 0 = none', unit='s', low=0.0, high=3600.0
    )
    diagnostics_period: float = setting(
        1.0, 'Time between two /diagnostics and ~/status messages', unit='s', low=0.1, high=60.0
    )


@dataclass(frozen=True)
class AutoConfig(Stage):
    """Calibration without a call."""

    enabled: bool = setting(
        default=True, help='Calibrate by itself whenever new data came', is_live=True
    )
    period_s: float = setting(
        10.0, 'Time between two such calibrations', unit='s', low=0.5, high=3600.0, is_live=True
    )


@dataclass(frozen=True)
class MocapSettings(Stage):
    """What the rig file says of the MoCap system, and a parameter may say instead."""

    topic: str = setting('', 'Topic of the skeleton')
    type: str = setting(
        '', 'Type of that topic; empty = what its publisher says', choices=('', *SKELETON_TYPES)
    )
    units: Literal['m', 'cm', 'mm', 'inch'] = setting(
        'm', 'Unit of the positions', choices=tuple(METRES_PER)
    )
    time_offset: float = setting(
        0.0, 'How late the skeleton is stamped', unit='s', low=-10.0, high=10.0, is_live=True
    )


@dataclass(frozen=True)
class CameraSettings(Stage):
    """What the rig file says of one camera, and a parameter may say instead."""

    keypoints_topic: str = setting('', 'Topic of the keypoints')
    type: str = setting(
        '', 'Type of that topic; empty = what its publisher says', choices=('', *KEYPOINT_TYPES)
    )
    camera_info_topic: str = setting('', 'Topic of the CameraInfo; empty = rig file has K')
    frame_id: str = setting('', 'Optical frame, for its pose from TF; empty = rig file has it')
    units: Literal['pixels', 'normalized', 'auto'] = setting(
        'pixels', 'Unit of the keypoints', choices=KEYPOINT_UNITS
    )
    rectified: bool = setting(
        default=False, help='Whether the keypoints were found in rectified images'
    )
    time_offset: float = setting(
        0.0, 'How late the video is stamped', unit='s', low=-10.0, high=10.0, is_live=True
    )
    min_confidence: float = setting(
        0.0, 'Keypoints with a lower score are missing', low=0.0, high=1e6, is_live=True
    )


@dataclass(frozen=True)
class NodeConfig:
    """Every parameter of the node.

    Attributes:
        node: What belongs to the node as a whole.
        mocap: The MoCap system.
        auto: Calibration without a call.
        sync: Pairing in time.
        clocks: Offsets between the clocks.
        buffer: Bounds of the store.
        rig: Cameras that contradict the others.
        ransac: Robust start.
        refine: Refinement.
        accept: Gates.
        cameras: The cameras by name.

    """

    node: NodeSettings = field(default_factory=NodeSettings)
    mocap: MocapSettings = field(default_factory=MocapSettings)
    auto: AutoConfig = field(default_factory=AutoConfig)
    sync: SyncConfig = field(default_factory=SyncConfig)
    clocks: TimeConfig = field(default_factory=lambda: CalibrationConfig.thorough().time)
    buffer: BufferConfig = field(default_factory=BufferConfig)
    rig: RigConfig = field(default_factory=lambda: CalibrationConfig.thorough().rig)
    ransac: RansacConfig = field(default_factory=lambda: CalibrationConfig.thorough().ransac)
    refine: RefineConfig = field(default_factory=lambda: CalibrationConfig.thorough().refine)
    accept: AcceptConfig = field(default_factory=lambda: CalibrationConfig.thorough().accept)
    cameras: Mapping[str, CameraSettings] = field(default_factory=dict)

    @classmethod
    def paper(cls) -> NodeConfig:
        """Return the settings with which the node runs the published method."""
        config = CalibrationConfig.paper()
        return cls(
            clocks=config.time,
            rig=config.rig,
            ransac=config.ransac,
            refine=config.refine,
            accept=config.accept,
        )

    def session(self) -> SessionConfig:
        """Return the part that the session needs."""
        calibration = CalibrationConfig(
            ransac=self.ransac,
            refine=self.refine,
            time=self.clocks,
            rig=self.rig,
            accept=self.accept,
            max_seconds=self.node.max_seconds,
        )
        return SessionConfig(
            calibration=calibration,
            sync=self.sync,
            buffer=self.buffer,
            zero_is_missing=self.node.zero_is_missing,
        )
