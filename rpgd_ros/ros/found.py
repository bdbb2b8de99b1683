# SPDX-License-Identifier: Apache-2.0
"""What a calibration found beside the transform, as figures of /diagnostics. Needs no ROS."""

from __future__ import annotations

from collections.abc import Iterator

from rpgd_ros.core.result import Calibration

MS, MM, PERCENT, PPM = 1e3, 1e3, 100.0, 1e6


def found_figures(calibration: Calibration) -> dict[str, object]:
    """Return clocks, lenses, sizes, joints, moved cameras and persons by diagnostic key."""
    return dict(_figures(calibration))


def _figures(c: Calibration) -> Iterator[tuple[str, object]]:
    for camera, (offset_s, sigma_s) in c.time_offset_s.items():
        yield f'time_offset_ms {camera}', MS * float(offset_s)
        yield f'time_offset_sigma_ms {camera}', MS * float(sigma_s)
    for camera, (rate, sigma) in c.clock_rate.items():
        yield f'clock_rate_ppm {camera}', PPM * float(rate)
        yield f'clock_rate_sigma_ppm {camera}', PPM * float(sigma)
    for camera, (error, sigma) in c.focal_error.items():
        yield f'focal_error_percent {camera}', PERCENT * float(error)
        yield f'focal_error_sigma_percent {camera}', PERCENT * float(sigma)
    if c.skeleton_scale is not None:
        error, sigma = c.skeleton_scale
        yield 'skeleton_scale_percent', PERCENT * float(error)
        yield 'skeleton_scale_sigma_percent', PERCENT * float(sigma)
    for joint, (offset_m, sigma_m) in c.joint_offset_m.items():
        yield f'joint_offset_mm {joint}', _millimetres(offset_m)
        yield f'joint_offset_sigma_mm {joint}', _millimetres(sigma_m)
    if c.drift is not None:
        yield 'drift_deg_per_min', float(c.drift.deg_per_min)
        yield 'drift_sigma_deg_per_min', float(c.drift.sigma_deg_per_min)
        yield 'drift_mm_per_min', float(c.drift.mm_per_min)
        yield 'drift_sigma_mm_per_min', float(c.drift.sigma_mm_per_min)
    for d in c.disagreements:
        yield f'moved_deg {d.camera}', float(d.rotation_deg)
        yield f'moved_mm {d.camera}', MM * float(d.shift_m)
        if d.since_s is not None:
            yield f'moved_since_s {d.camera}', float(d.since_s)
    for camera, shown in c.shown.items():
        yield f'shown_percent {camera}', PERCENT * shown.share


def _millimetres(values: tuple[float, float, float]) -> str:
    return ' '.join(f'{MM * value:.1f}' for value in values)
