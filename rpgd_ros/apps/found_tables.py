# SPDX-License-Identifier: Apache-2.0
"""What was found beside the transform, as lines and tables for people."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from rpgd_ros.core.camera_pose import is_mocap_world
from rpgd_ros.core.result import Calibration
from rpgd_ros.report.found import weakest_axis

PERCENT, MM, MS, PPM = 100.0, 1e3, 1e3, 1e6

Row = tuple[str, str]


def found_rows(c: Calibration) -> Iterator[Row]:
    """Yield clocks, lenses, the size of the skeleton, moved cameras and persons, line by line."""
    for camera, (offset_s, sigma_s) in c.time_offset_s.items():
        late = f'{MS * offset_s:.1f} +- {MS * sigma_s:.1f} ms'
        if camera in c.clock_rate:
            rate, sigma = c.clock_rate[camera]
            late += f', later by {PPM * rate:.1f} +- {PPM * sigma:.1f} us every second'
        yield f'{camera} is late', late
    for camera, (error, sigma) in c.focal_error.items():
        yield (
            f'{camera} focal length',
            f'{PERCENT * error:+.2f} +- {PERCENT * sigma:.2f} % longer than given',
        )
    if c.skeleton_scale is not None:
        error, sigma = c.skeleton_scale
        yield (
            'skeleton',
            f'{PERCENT * error:+.2f} +- {PERCENT * sigma:.2f} % larger than given',
        )
    if c.drift is not None:
        turn = f'{c.drift.deg_per_min:.2f} +- {c.drift.sigma_deg_per_min:.2f} deg'
        way = f'{c.drift.mm_per_min:.0f} +- {c.drift.sigma_mm_per_min:.0f} mm'
        yield 'MoCap frame drifts', f'{turn} and {way} a minute'
    for d in c.disagreements:
        who = d.camera if d.rival is None else f'{d.camera} or {d.rival}'
        turned = f'{d.rotation_deg:.2f} +- {d.sigma_deg:.2f} deg'
        when = '' if d.since_s is None else f', {d.since_s:.1f} s after the begin'
        shift = f'{MM * d.shift_m:.0f} +- {MM * d.sigma_m:.0f} mm'
        yield f'{who} was moved', f'{turned}, {shift}{when}'
    for camera, shown in c.shown.items():
        yield (
            f'{camera} shows it',
            f'shown in {PERCENT * shown.share:.0f} % of {shown.frames} frames',
        )


def joint_rows(c: Calibration) -> Iterator[tuple[str, str, str]]:
    """Yield where the detector sees each joint: name, offset and sigma, the largest first."""
    found = c.joint_offset_m
    for name in sorted(found, key=lambda n: -float(np.linalg.norm(found[n].offset_m))):
        offset, sigma = found[name]
        yield name, ' '.join(f'{MM * v:+.0f}' for v in offset), f'{MM * max(sigma):.1f}'


def unseen_sentence(c: Calibration) -> str:
    """Say what no camera sees where joints were given offsets; '' where none were."""
    if not c.joint_offset_m or is_mocap_world(c.camera_poses, c.covariance):
        return ''
    sigma_m, (x, y, z) = weakest_axis(c)
    return (
        'an offset that all joints share along the vertical cannot be seen: that there is none is '
        f'assumed. The sigma holds it: {MM * sigma_m:.1f} mm along ({x:.2f}, {y:.2f}, {z:.2f})'
    )
