# SPDX-License-Identifier: Apache-2.0
"""What one solve is given, and the solve."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from rpgd_ros.core import calibrate
from rpgd_ros.core.camera import Camera
from rpgd_ros.core.config import CalibrationConfig
from rpgd_ros.core.observations import Observations
from rpgd_ros.core.result import Calibration
from rpgd_ros.pairing import PairCounts


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """What one solve is given; it shares nothing with the session that goes on.

    Attributes:
        cameras: Those with intrinsics, in the order of the rig file.
        observations: One view per camera, stamped on the MoCap's clock.
        config: Of the solve.
        time_offset_s: How late each video is known to be, already taken into account.
        pair_counts: Frames of each camera with and without a skeleton.
        left_out: Cameras whose intrinsics have not arrived.

    """

    cameras: tuple[Camera, ...]
    observations: Observations
    config: CalibrationConfig
    time_offset_s: Mapping[str, float]
    pair_counts: Mapping[str, PairCounts]
    left_out: tuple[str, ...] = ()


def solve(
    snapshot: Snapshot,
    *,
    progress: Callable[[str, float], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> Calibration:
    """Calibrate from a snapshot; may run in another thread than the session.

    Args:
        snapshot: Data and settings.
        progress: Told the stage and its fraction done.
        should_stop: Asked whether to end early.

    Returns:
        The calibration. Its time offsets are those of the stamps as sent, what the rig file says
        included; cameras that were left out are among its warnings.

    Raises:
        CalibrationError: The data do not give a pose that anybody should use.

    """
    calibration = calibrate(
        snapshot.cameras,
        snapshot.observations,
        config=snapshot.config,
        progress=progress,
        should_stop=should_stop,
    )
    offsets = {
        name: (offset_s + snapshot.time_offset_s.get(name, 0.0), sigma_s)
        for name, (offset_s, sigma_s) in calibration.time_offset_s.items()
    }
    warnings = calibration.warnings
    if snapshot.left_out:
        names = ', '.join(snapshot.left_out)
        warnings = (*warnings, f'left out, because no CameraInfo arrived: {names}')
    return replace(calibration, time_offset_s=offsets, warnings=warnings)
