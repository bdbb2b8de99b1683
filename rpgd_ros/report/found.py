# SPDX-License-Identifier: Apache-2.0
"""What a solve found beside the pose: clocks, places of cameras, offsets of joints, persons."""

from __future__ import annotations

from collections.abc import Iterator

from rpgd_ros.core.result import Calibration
from rpgd_ros.report.blocks import Block, Section, Table, Text, number, percent
from rpgd_ros.report.measure import Measured

PPM = 1e6  # parts per million: microseconds a second


def clocks(c: Calibration) -> Iterator[Block]:
    """Yield what is known of each camera's clock."""
    if not c.time_offset_s:
        yield Text('Clock offsets were not estimated.')
        return
    rows = []
    for name, (offset, sigma) in c.time_offset_s.items():
        drift = ''
        if name in c.clock_rate:
            rate, rate_sigma = (PPM * value for value in c.clock_rate[name])
            drift = f'{number(rate, 1)} ± {number(rate_sigma, 1, "µs/s")}'
        rows.append((name, number(1000 * offset, 2, 'ms'), number(1000 * sigma, 2, 'ms'), drift))
    head = ('camera', 'late by', 'one standard deviation', 'later and later by')
    n_columns = 4 if c.clock_rate else 3
    yield Text('How late each video is stamped: MoCap time = video stamp \N{MINUS SIGN} offset.')
    yield Table(head[:n_columns], tuple(row[:n_columns] for row in rows))


def placed(measured: Measured) -> Section | None:
    """Cameras that had no extrinsics, and where they were found."""
    c = measured.case.calibration
    if c is None or not c.camera_poses:
        return None
    rows = tuple(
        (
            name,
            ', '.join(number(float(v), 4) for v in pose.world_T_camera.translation),
            number(pose.sigma_rotation_deg, 3, '°'),
            number(1000 * pose.sigma_position_m, 1, 'mm'),
            number(1000 * pose.sigma_centre_m, 1, 'mm'),
        )
        for name, pose in c.camera_poses.items()
    )
    head = ('camera', 'x, y, z in the world, m', 'rotation to', 'at the body to', 'its place to')
    text = 'These cameras had no extrinsics. The walk told where they are.'
    return Section('placed', 'Placed cameras', (Text(text), Table(head, rows)))


def joint_offsets(c: Calibration) -> Iterator[Block]:
    """Yield where the detector sees each joint."""
    if not c.joint_offset_m:
        return
    rows = tuple(
        (
            name,
            ', '.join(number(1000 * v, 0) for v in found.offset_m),
            ', '.join(number(1000 * v, 0) for v in found.sigma_m),
        )
        for name, found in c.joint_offset_m.items()
    )
    text = (
        'Where the detector sees each joint, from where the MoCap has it: x, y, z in a frame that '
        'turns with the body.'
    )
    yield Text(text)
    yield Table(('joint', 'offset, mm', 'one standard deviation, mm'), rows)


def persons(c: Calibration) -> Iterator[Block]:
    """Yield how much of each video shows the persons with MoCap."""
    if c.shown:
        rows = tuple(
            (name, percent(shown.share), str(shown.frames)) for name, shown in c.shown.items()
        )
        yield Text('Several persons were in view. How much of each video shows those with MoCap:')
        yield Table(('camera', 'shown in', 'of frames'), rows)
