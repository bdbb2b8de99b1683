# SPDX-License-Identifier: Apache-2.0
"""Settings of a session."""

from __future__ import annotations

from dataclasses import dataclass, field

from rpgd_ros.core.config import CalibrationConfig
from rpgd_ros.pairing import BufferConfig, SyncConfig


@dataclass(frozen=True)
class SessionConfig:
    """Everything a session can be told.

    Attributes:
        calibration: Of the solve.
        sync: Of the pairing.
        buffer: Bounds of the stores.
        zero_is_missing: Whether a joint at exactly zero was not seen.

    """

    calibration: CalibrationConfig = field(default_factory=CalibrationConfig.thorough)
    sync: SyncConfig = field(default_factory=SyncConfig)
    buffer: BufferConfig = field(default_factory=BufferConfig)
    zero_is_missing: bool = True
