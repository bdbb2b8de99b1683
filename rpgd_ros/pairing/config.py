# SPDX-License-Identifier: Apache-2.0
"""Settings of the pairing and of the buffers."""

from __future__ import annotations

from dataclasses import dataclass

from rpgd_ros.core.config import Stage, setting


@dataclass(frozen=True)
class SyncConfig(Stage):
    """How a skeleton is found for each camera stamp.

    Linear interpolation over 50 ms is 2 to 6 mm off (root mean square over eight recorded
    motions), over 100 ms 3 to 18 mm. 50 ms hold one period of every MoCap from 25 Hz on.
    """

    interpolate: bool = setting(
        default=True,
        help='Interpolate the skeleton to the camera stamp; false: take the nearest one',
    )
    max_gap: float = setting(
        0.05, 'Longest time between the two skeletons of an interpolation',
        unit='s', low=0.0, high=10.0,
    )  # fmt: skip
    max_dt: float = setting(
        0.01, 'Longest time to the nearest skeleton where interpolate is false',
        unit='s', low=0.0, high=10.0, is_live=True,
    )  # fmt: skip
    use_receive_time: bool = setting(
        default=False,
        help='Take the time of arrival as stamp: for drivers without stamps or a common clock',
    )


@dataclass(frozen=True)
class BufferConfig(Stage):
    """How much of the past is kept, per stream."""

    max_frames: int = setting(
        20_000, 'Most messages kept of one stream (60 s at 240 Hz are 14400)',
        low=10, high=10_000_000, is_live=True,
    )  # fmt: skip
    max_age_s: float = setting(
        300.0, 'Messages older than the newest by more are dropped (in stamps)',
        unit='s', low=1.0, high=86_400.0, is_live=True,
    )  # fmt: skip
    min_motion: float = setting(
        1.0, 'Automatic calibration waits until the subject has covered this distance',
        unit='m', low=0.0, high=100.0, is_live=True,
    )  # fmt: skip
