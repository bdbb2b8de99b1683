# SPDX-License-Identifier: Apache-2.0
"""What a solve found beside the pose: clocks, lenses, sizes, joints, persons, places."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from rpgd_ros.core.camera_pose import is_mocap_world
from rpgd_ros.core.geometry import Array
from rpgd_ros.core.result import Calibration
from rpgd_ros.report.blocks import (
    Block,
    Figure,
    Section,
    Table,
    Text,
    labels,
    number,
    percent,
    rounded,
)
from rpgd_ros.report.measure import Measured

PPM = 1e6  # parts per million: microseconds a second
MM = 1e3
DOUBTFUL = 3.0  # standard deviations: what is beyond is marked
LEAST_SHARE = 0.001  # of a length that is worth a mark: a chessboard is no better
MINUS = '\N{MINUS SIGN}'


def beside(measured: Measured) -> Section | None:
    """All that was asked of the recording beside the pose."""
    c = measured.case.calibration
    if c is None or not measured.looks:
        return None
    blocks = [*creep(c), *lenses(c), *clocks(c), *joint_offsets(c), *persons(c)]
    return Section('found', 'What else was found', tuple(blocks)) if blocks else None


def creep(c: Calibration) -> Iterator[Block]:
    """Yield how fast the MoCap frame moves through the room, where it does."""
    d = c.drift
    if d is None:
        return
    yield Text(
        'The MoCap frame creeps through the room, as those of inertial suits do. The transform is '
        'that of mid-recording.'
    )
    rows = (
        ('rotation', number(d.deg_per_min, 3, '°'), number(d.sigma_deg_per_min, 3, '°')),
        ('position', number(d.mm_per_min, 1, 'mm'), number(d.sigma_mm_per_min, 1, 'mm')),
    )
    yield Table(('drift', 'a minute', 'sigma'), rows, marked=frozenset({0, 1}))


def lenses(c: Calibration) -> Iterator[Block]:
    """Yield focal lengths and the size of the skeleton, as shares of what was given."""
    asked = [(f'focal length of {name}', *pair) for name, pair in c.focal_error.items()]
    if c.skeleton_scale is not None:
        asked.append(('size of the skeleton', *c.skeleton_scale))
    if not asked:
        return
    rows = tuple(
        (name, signed(100 * error, 2, '%'), number(100 * sigma, 2, '%'))
        for name, error, sigma in asked
    )
    wrong = frozenset(
        i
        for i, (_, error, sigma) in enumerate(asked)
        if abs(error) > max(DOUBTFUL * sigma, LEAST_SHARE)
    )
    estimated = [
        what
        for what, how in (('focal lengths', c.config.refine.focal), ('size', c.config.refine.size))
        if how == 'estimate'
    ]
    used = 'They were asked for, not corrected: the sigma holds what they may move.'
    if estimated:
        used = f'The transform was solved with the {" and ".join(estimated)} that fit.'
    yield Text(f'By how much the film shows lengths to be larger than what was given. {used}')
    yield Table(('length', 'larger by', 'sigma'), rows, marked=wrong)


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
    yield Text(f'How late each video is stamped: MoCap time = video stamp {MINUS} offset.')
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
    moved = {d.camera for d in c.disagreements} & c.camera_poses.keys()
    text = 'These cameras had no extrinsics. The walk told where they are.'
    if moved:
        text = (
            f'Where cameras are that were moved: {", ".join(sorted(moved))}. The walk told; the '
            'rig file has their old places.'
        )
        if moved != c.camera_poses.keys():
            text += ' The others had no extrinsics.'
    return Section('placed', 'Placed cameras', (Text(text), Table(head, rows)))


def joint_offsets(c: Calibration) -> Iterator[Block]:
    """Yield where the detector sees each joint, and what nobody can see of that."""
    if not c.joint_offset_m:
        return
    names = list(c.joint_offset_m)
    offset, sigma = (
        MM * np.array([getattr(c.joint_offset_m[n], key) for n in names])
        for key in ('offset_m', 'sigma_m')
    )
    rows = tuple(
        (
            name,
            ', '.join(signed(v, 0) for v in o),
            ', '.join(number(v, 1) for v in s),
            number(float(np.linalg.norm(o)), 0, 'mm'),
        )
        for name, o, s in zip(names, offset, sigma, strict=True)
    )
    yield Text(
        'Where the detector sees each joint, from where the MoCap has it: x, y, z in a frame '
        'that turns with the body. The transform was solved with these.'
    )
    yield _joint_figure(names, offset, sigma)
    yield Table(('joint', 'offset x, y, z, mm', 'sigma, mm', 'length'), rows)
    if not is_mocap_world(c.camera_poses, c.covariance):
        sigma_m, axis = weakest_axis(c)
        along = ', '.join(number(v, 2) for v in axis)
        yield Text(
            'What cannot be seen: an offset that all joints share along the vertical. It looks '
            'like a transform that is higher or lower, in every camera. That there is none is '
            'assumed, because the offsets of single joints tell how large it may be; it is in the '
            f'accuracy of the transform, {number(MM * sigma_m, 1, "mm")} along ({along}) of the '
            'world.'
        )


def weakest_axis(c: Calibration) -> tuple[float, tuple[float, float, float]]:
    """Return where the body's place is known least: sigma in metres, and a unit vector, world."""
    variance, axes = np.linalg.eigh(c.centroid_covariance)
    x, y, z = axes[:, -1] * np.copysign(1.0, axes[np.abs(axes[:, -1]).argmax(), -1])
    # Adding zero makes a plain zero of a negative one.
    return float(np.sqrt(max(variance[-1], 0.0))), (
        float(x.round(2) + 0.0),
        float(y.round(2) + 0.0),
        float(z.round(2) + 0.0),
    )


def _joint_figure(names: list[str], offset_mm: Array, sigma_mm: Array) -> Figure:
    traces = [
        {
            'type': 'scatter', 'mode': 'markers', 'name': axis,
            'x': labels(names), 'y': rounded(offset_mm[:, i], 1),
            'marker': {'color': colour, 'size': 7, 'symbol': symbol},
            'error_y': {'type': 'data', 'array': rounded(sigma_mm[:, i], 2), 'color': colour,
                        'thickness': 1.5, 'width': 3},
            'hovertemplate': f'%{{x}}, {axis}: %{{y:.1f}} mm<extra></extra>',
        }
        for i, (axis, colour, symbol) in enumerate(
            (('x', '@seen', 'circle'), ('y', '@made', 'square'), ('z', '@bad', 'diamond'))
        )
    ]  # fmt: skip
    layout = {
        'xaxis': {'tickangle': -60, 'automargin': True, 'type': 'category'},
        'yaxis': {'title': {'text': 'offset [mm]'}},
        'scattermode': 'group',
        'legend': {'orientation': 'h', 'y': 1.02, 'yanchor': 'bottom', 'x': 0},
    }
    text = 'Offsets of the joints, with one standard deviation.'
    return Figure('joint-offsets', text, traces, layout, 340)


def persons(c: Calibration) -> Iterator[Block]:
    """Yield how much of each video shows the persons with MoCap."""
    if c.shown:
        rows = tuple(
            (name, percent(shown.share), str(shown.frames)) for name, shown in c.shown.items()
        )
        yield Text('Several persons were in view. How much of each video shows those with MoCap:')
        yield Table(('camera', 'shown in', 'of frames'), rows)


def signed(value: float, digits: int, unit: str = '') -> str:
    """Set a number with its sign, where it has any digits."""
    # Adding zero makes a plain zero of a negative one.
    shown = round(value, digits) + 0.0
    return f'{"+" if shown > 0 else ""}{number(shown, digits, unit)}'
