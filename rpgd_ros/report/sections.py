# SPDX-License-Identifier: Apache-2.0
"""The sections of a report, in their order. A new one is a function here or beside, and a name."""

from __future__ import annotations

import platform
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from importlib.metadata import version
from importlib.util import find_spec
from typing import Any

import numpy as np

from rpgd_ros import __version__
from rpgd_ros.core.errors import Reason
from rpgd_ros.core.geometry import Array
from rpgd_ros.report.blocks import (
    Block,
    Bullets,
    Figure,
    Link,
    Section,
    Side,
    Table,
    Text,
    labels,
    number,
    percent,
    rounded,
)
from rpgd_ros.report.cameras import cameras
from rpgd_ros.report.forms import forms
from rpgd_ros.report.found import beside, placed
from rpgd_ros.report.measure import TIME_BINS, Measured, swapped_names
from rpgd_ros.report.room import room
from rpgd_ros.report.verdict import FEW

TWO_THIRDS = (0.16, 0.5, 0.84)  # quantiles
ROW_PX, MAP_PX = 26, 110  # height of a camera's row in a map, and of what is around


def transform(measured: Measured) -> Section:
    """The transform, to look at and to paste."""
    case = measured.case
    c = case.calibration
    if c is None or case.refusal is not None:
        text = (
            'There is no transform to use. '
            'What the page shows below is drawn with the best one that was found, or with none.'
        )
        return Section('transform', 'Transform', (Text(text),))
    names = {'world_frame': case.world_frame, 'mocap_frame': case.mocap_frame}
    turned, moved = np.sqrt(np.diag(c.covariance)).reshape(2, 3)
    axes = Table(
        ('one standard deviation', 'x', 'y', 'z'),
        (
            ('rotation about', *(number(v, 4, '°') for v in np.degrees(turned))),
            ('translation along', *(number(1000 * v, 2, 'mm') for v in moved)),
        ),
    )
    intro = (
        f'x_world = R x_mocap + t, from {case.mocap_frame} to {case.world_frame}. The translation '
        'is that of the MoCap origin, which may lie far from the person: what counts for the '
        'person stands in the first line.'
    )
    codes = forms(c.world_T_mocap, case.cameras, **names)
    return Section('transform', 'Transform', (Text(intro), *codes, axes))


def joints(measured: Measured) -> Section | None:
    """Bias and spread of each joint over all cameras."""
    c = measured.case.calibration
    if c is None or not measured.looks:
        return None
    rows, marked = [], set()
    bands: list[Array] = []
    swapped = {name for pair in swapped_names(measured) for name in pair}
    for j, (name, fit) in enumerate(c.per_joint.items()):
        near = _pooled(measured, j)
        every = np.concatenate([look.error_px[:, j] for look in measured.used])
        every = every[np.isfinite(every)]
        bands.append(np.quantile(every, TWO_THIRDS) if len(every) else np.full(3, np.nan))
        if name in swapped:
            marked.add(j)
        spread = float(np.sqrt(near.var(0).mean())) if len(near) > 1 else np.nan
        u, v = fit.bias_px
        rows.append((
            name, percent(fit.inlier_ratio), str(fit.correspondences),
            f'{number(u)}, {number(v, 2, "px")}', number(float(np.hypot(u, v)), 2, 'px'),
            number(spread, 2, 'px'), number(fit.mpjpe_px, 2, 'px'),
        ))  # fmt: skip
    head = ('joint', 'agree', 'keypoints', 'bias u, v', 'bias', 'spread per axis', 'MPJPE')
    text = (
        'Bias is the mean residual of the keypoints that agree, spread what they scatter around '
        'it. Detectors put joints elsewhere than MoCap systems do: a bias of some pixels that '
        'differs from joint to joint is usual, and is in the reported accuracy.'
    )
    blocks: list[Block] = [Text(text)]
    if swapped:
        pairs = ', '.join(f'{a} and {b}' for a, b in swapped_names(measured))
        blocks.insert(0, Bullets((Link(f'Lie on each other instead of on themselves: {pairs}.'),)))
    figure = _joint_figure(list(c.per_joint), np.array(bands).T)
    blocks += [figure, Table(head, tuple(rows), marked=frozenset(marked))]
    return Section('joints', 'Joints', tuple(blocks), is_marked=bool(swapped))


def _pooled(measured: Measured, joint: int) -> Array:
    """Residuals (n, 2) of one joint's inliers in all cameras."""
    return np.concatenate(
        [look.residual[:, joint][look.is_near[:, joint]] for look in measured.used]
    )


def _joint_figure(names: list[str], bands: Array) -> Figure:
    low, middle, high = bands
    trace = {
        'type': 'scatter', 'mode': 'markers', 'x': labels(names),
        'y': rounded(middle, 2), 'marker': {'color': '@seen', 'size': 8},
        'error_y': {'type': 'data', 'symmetric': False, 'array': rounded(high - middle, 2),
                    'arrayminus': rounded(middle - low, 2), 'color': '@seen', 'thickness': 1.5},
        'hovertemplate': '%{x}: %{y:.2f} px<extra></extra>',
    }  # fmt: skip
    layout = {
        'xaxis': {'tickangle': -60, 'automargin': True, 'type': 'category'},
        'yaxis': {'title': {'text': 'residual [px]'}, 'rangemode': 'tozero'},
    }
    text = 'Residuals of each joint: median, and the range that two thirds of them lie in.'
    return Figure('joint-residuals', text, [trace], layout, 340)


def times(measured: Measured) -> Section | None:
    """Who agreed when."""
    c = measured.case.calibration
    if c is None or not measured.looks:
        return None
    refusal = measured.case.refusal
    is_nobody = refusal is not None and refusal.reason is Reason.TOO_FEW_INLIERS
    is_lost = is_nobody or c.inlier_ratio < FEW
    return Section('time', 'Time', (_agreement(measured),), is_marked=is_lost)


def _agreement(measured: Measured) -> Figure:
    """Share of inliers by camera and time."""
    end = max((float(look.seconds[-1]) for look in measured.looks if len(look.frames)), default=0)
    start = measured.start_s
    n_bins = min(TIME_BINS, max(1, int(end - start))) if measured.has_time else TIME_BINS
    bounds = np.linspace(start, max(end, start + 1e-3), n_bins + 1)
    table = np.full((len(measured.looks), n_bins), np.nan)
    for row, look in zip(table, measured.looks, strict=True):
        if len(look.frames):
            at = np.clip(np.searchsorted(bounds, look.seconds, 'right') - 1, 0, n_bins - 1)
            n = np.bincount(at, look.seen.sum(1), n_bins)
            near = np.bincount(at, look.is_near.sum(1), n_bins)
            row[:] = np.where(n > 0, near / np.maximum(n, 1), np.nan)
    trace = {
        'type': 'heatmap', 'z': rounded(table, 3), 'zmin': 0, 'zmax': 1, 'hoverongaps': False,
        'x': rounded((bounds[1:] + bounds[:-1]) / 2 - start, 2),
        'y': labels([look.camera.name for look in measured.looks]), 'ygap': 2,
        'colorscale': 'Cividis',
        'colorbar': {'thickness': 10, 'outlinewidth': 0, 'tickformat': '.0%'},
        'hovertemplate': '%{y}, %{x:.1f} s: %{z:.1%}<extra></extra>',
    }  # fmt: skip
    layout = {
        'xaxis': {'title': {'text': 'time [s]' if measured.has_time else 'frame'}},
        'yaxis': {'autorange': 'reversed', 'automargin': True, 'type': 'category'},
    }
    text = (
        'Share of the keypoints that agree with the transform. Light: all. Dark: the camera sees '
        'somebody or something else. Empty: nobody.'
    )
    height = MAP_PX + ROW_PX * len(measured.looks)
    return Figure('agreement', text, [trace], layout, height)


def convergence(measured: Measured) -> Section | None:
    """How the result settles as the recording goes on."""
    steps = measured.case.steps
    if not steps:
        return None
    x = [round(step.seconds, 2) for step in steps]
    unit = 's' if measured.has_time else 'frames'
    plots = []
    for key, axis, found, reported in (
        ('rotation', '°', [s.apart_deg for s in steps], [s.sigma_deg for s in steps]),
        ('position', 'mm', [1e3 * s.apart_m for s in steps], [1e3 * s.sigma_m for s in steps]),
    ):
        traces = [
            {
                'type': 'scatter', 'mode': 'lines+markers', 'x': x,
                'y': rounded(np.array(y), 4), 'name': name,
                'line': {'color': colour, 'dash': dash}, 'marker': {'size': 7},
            }
            for name, y, colour, dash in (
                ('from the result of all', found, '@seen', 'solid'),
                ('reported sigma', reported, '@made', 'dot'),
            )
        ]  # fmt: skip
        layout = {
            'xaxis': {'title': {'text': f'length of the recording used [{unit}]'}},
            'yaxis': {'title': {'text': f'{key} [{axis}]'}, 'rangemode': 'tozero'},
            'legend': {'orientation': 'h', 'y': 1.02, 'yanchor': 'bottom', 'x': 0},
        }
        plots.append(Figure(f'convergence-{key}', f'How the {key} settles.', traces, layout, 280))
    text = (
        'The pose from only the beginning of the recording, beside that from all of it, both at '
        'the clock offsets above. Where the curves have not come down yet, a longer walk makes '
        'the result better. Where the solid one is far above the dotted, something has changed.'
    )
    return Section('convergence', 'Convergence', (Text(text), Side(tuple(plots))))


def streams(measured: Measured) -> Section | None:
    """What came in, what was refused, and why."""
    case = measured.case
    if not case.streams:
        return None
    rows = tuple(
        (
            s.stream,
            s.topic,
            ', '.join(f'{n} {reason.replace("_", " ")}' for reason, n in s.dropped.items()) or '–',  # noqa: RUF001
            str(s.received),
            str(s.kept),
            '' if s.paired is None else str(s.paired),
        )
        for s in case.streams
    )
    marked = frozenset(i for i, s in enumerate(case.streams) if not s.kept or s.paired == 0)
    head = ('stream', 'topic', 'refused, or missing in them', 'messages', 'kept', 'paired')
    text = (
        'Messages, how many of them could be used, and how many keypoints met a skeleton of their '
        'time. Missing joints (nan, zero, low confidence) are counted one by one.'
    )
    blocks = (Text(text), Table(head, rows, n_words=3, marked=marked))
    return Section('streams', 'What came in', blocks, is_marked=bool(marked))


def settings(measured: Measured) -> Section:
    """Parameters and versions."""
    c = measured.case.calibration
    versions = {
        'rpgd_ros': __version__,
        'python': platform.python_version(),
        'numpy': np.__version__,
        'opencv': getattr(sys.modules.get('cv2'), '__version__', 'not loaded'),
        'plotly': version('plotly') if find_spec('plotly') else 'not installed',
    }
    of_versions = Table(('version', ''), tuple(versions.items()), n_words=2)
    if c is None:
        return Section('settings', 'Settings and versions', (of_versions,))
    rows = tuple(_flat('', c.config))
    half = -(-len(rows) // 2)
    blocks = (
        Text(f'The solve took {number(c.seconds, 2, "s")}.'),
        Side(tuple(
            Table(('parameter', ''), part, n_words=2) for part in (rows[:half], rows[half:])
        )),
        of_versions,
    )  # fmt: skip
    return Section('settings', 'Settings and versions', blocks)


def _flat(prefix: str, stage: Any) -> Iterator[tuple[str, str]]:
    for field in fields(stage):
        value = getattr(stage, field.name)
        name = f'{prefix}{field.name}'
        if is_dataclass(value):
            yield from _flat(f'{name}.', value)
        elif isinstance(value, Mapping):
            yield name, ', '.join(f'{key}: {item}' for key, item in value.items())
        else:
            yield name, str(value).lower() if isinstance(value, bool) else str(value)


def _optional(
    section: Callable[[Measured], Section | None],
) -> Callable[[Measured], Iterator[Section]]:
    def several(measured: Measured) -> Iterator[Section]:
        found = section(measured)
        if found is not None:
            yield found

    return several


# Each is asked for its sections, in this order; one that has nothing to say gives none.
SECTIONS: tuple[Callable[[Measured], Iterator[Section]], ...] = (
    _optional(transform),
    _optional(room),
    _optional(placed),
    cameras,
    _optional(joints),
    _optional(beside),
    _optional(times),
    _optional(convergence),
    _optional(streams),
    _optional(settings),
)
