# SPDX-License-Identifier: Apache-2.0
"""One section per camera: what it measured on an instant, and its residuals over the image."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from rpgd_ros.core.geometry import Array, IntArray
from rpgd_ros.core.result import GroupFit
from rpgd_ros.report.blocks import (
    Block,
    Bullets,
    Figure,
    Link,
    Section,
    Side,
    Table,
    Text,
    number,
    percent,
    rounded,
)
from rpgd_ros.report.instants import instants, over_image
from rpgd_ros.report.measure import Look, Measured
from rpgd_ros.report.verdict import camera_key, said_of

CELLS = 18  # of the longer side of the image: a keypoint every few in a minute of walking
MIN_IN_CELL = 3  # keypoints of which a cell says the median
ARROW_CELLS = 1.2  # length of the longest arrow
MOST_OF_WIDTH = 0.25  # of an image; a residual beyond is that of another thing
CLIP = 3.0  # times the usual cell: what is beyond has the last colour and the longest arrow
BINS = 60
TAIL = 4.0  # times the threshold: a histogram ends there, what is beyond stands in its last bar


def cameras(measured: Measured) -> Iterator[Section]:
    """Yield an overview, then a section per camera."""
    if not measured.looks:
        return
    c = measured.case.calibration
    head = ('camera', 'keypoints agree', 'keypoints', 'MPJPE', 'of those that agree', 'bias u, v')
    fits = [] if c is None else list(c.per_camera.values())
    marked = frozenset(
        i for i, fit in enumerate(fits) if fit.name in measured.moved | set(measured.lost)
    )
    blocks: tuple[Block, ...] = (Text('No residuals: no transform was found.'),)
    if fits:
        rows = tuple(_fit_row(fit) for fit in fits)
        blocks = (Table(head, rows, marked=marked),)
    yield Section('cameras', 'Cameras', blocks)
    for look in measured.looks:
        name = look.camera.name
        yield Section(
            camera_key(measured, name),
            name,
            tuple(_blocks(measured, look)),
            level=3,
            is_marked=name in measured.moved or name in measured.lost,
        )


def _fit_row(fit: GroupFit) -> tuple[str, ...]:
    u, v = fit.bias_px
    return (
        fit.name,
        percent(fit.inlier_ratio),
        str(fit.correspondences),
        number(fit.mpjpe_px, 2, 'px'),
        number(fit.inlier_mpjpe_px, 2, 'px'),
        f'{number(u)}, {number(v, 2, "px")}',
    )


def _blocks(measured: Measured, look: Look) -> Iterator[Block]:
    key = camera_key(measured, look.camera.name)
    c = measured.case.calibration
    said = [
        Link(said_of(d))
        for d in (c.disagreements if c else ())
        if look.camera.name in {d.camera, d.rival}
    ]
    if look.camera.name in set(measured.lost) - measured.moved:
        share = percent(measured.lost[look.camera.name])
        said.append(Link(f'Most of its keypoints are elsewhere in {share} of its frames.'))
    if said:
        yield Bullets(tuple(said))
    if not look.seen.any():
        yield Text('It saw no joint of the skeleton at any instant.')
        return
    photos = measured.case.photos.get(look.camera.name, ())
    yield Side(tuple(instants(measured, look, key, photos)))
    if not np.isfinite(look.error_px).any():
        yield _coverage(look, key)
        return
    yield Side((_residual_map(look, key), _coverage(look, key)))
    yield _histogram(look, key)


def _residual_map(look: Look, key: str) -> Figure:
    """Median residual per cell of the image, and its direction."""
    cell, number_of, size = _grid(look)
    errors, residuals = look.error_px[look.seen], look.residual[look.seen]
    good = np.isfinite(errors)
    cell, errors, residuals = cell[good], errors[good], residuals[good]
    medians = np.full(number_of, np.nan)
    vectors = np.full((number_of, 2), np.nan)
    order = np.argsort(cell, kind='stable')
    starts = np.searchsorted(cell[order], np.arange(number_of + 1))
    for i in range(number_of):
        members = order[starts[i] : starts[i + 1]]
        if len(members) >= MIN_IN_CELL:
            medians[i] = np.median(errors[members])
            vectors[i] = np.median(residuals[members], axis=0)
    x, y = _centres(look, size)
    # As in its usual cell, or in noise: a few cells with another person's keypoints do not count.
    usual = float(np.nanmedian(medians)) if np.isfinite(medians).any() else 0.0
    longest = max(CLIP * usual, look.threshold_px)
    length = np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-9)
    scale = ARROW_CELLS * look.camera.size[0] / size[0] / longest
    vectors *= np.minimum(1.0, longest / length)
    start = np.stack([np.tile(x, size[1]), np.repeat(y, size[0])], -1)
    gap = np.full_like(start, np.nan)
    arrows = np.stack([start, start + scale * vectors, gap], 1).reshape(-1, 2)
    traces = [
        {**_heat(medians.reshape(size[::-1]), x, y, 'median residual', 'px', 'Cividis'),
         'zmin': 0, 'zmax': round(longest, 2)},
        {
            'type': 'scatter', 'mode': 'lines', 'hoverinfo': 'skip', 'showlegend': False,
            'x': rounded(arrows[:, 0]), 'y': rounded(arrows[:, 1]),
            'line': {'color': '@bad', 'width': 1.5},
        },
    ]  # fmt: skip
    text = (
        'Residuals over the image, from keypoint to reprojection: lines are '
        f'{scale:.2g} times as long. Noise has no direction; a moved camera or a wrong '
        'lens gives a pattern.'
    )
    layout, ratio = over_image(look.camera.size, None), _ratio(look)
    return Figure(f'{key}-residuals', text, traces, layout, 320, ratio)


def _coverage(look: Look, key: str) -> Figure:
    cell, number_of, size = _grid(look)
    counts = np.bincount(cell, minlength=number_of).astype(np.float64)
    counts[counts == 0.0] = np.nan
    x, y = _centres(look, size)
    share = np.isfinite(counts).mean()
    traces = [_heat(counts.reshape(size[::-1]), x, y, 'keypoints', '', 'Viridis')]
    text = f'Coverage: keypoints with a skeleton in {percent(share)} of the image.'
    layout, ratio = over_image(look.camera.size, None), _ratio(look)
    return Figure(f'{key}-coverage', text, traces, layout, 320, ratio)


def _histogram(look: Look, key: str) -> Figure:
    errors = look.error_px[np.isfinite(look.error_px)]
    # Where hardly anything agrees, up to where most of it is.
    end = max(TAIL * look.threshold_px, 1.2 * float(np.quantile(errors, 0.9)))
    end = min(end, MOST_OF_WIDTH * look.camera.size[0])
    n_beyond = int((errors > end).sum())
    counts, bounds = np.histogram(np.minimum(errors, end), BINS, (0.0, end))
    traces = [
        {
            'type': 'bar', 'x': rounded((bounds[1:] + bounds[:-1]) / 2, 2), 'y': rounded(counts),
            'width': round(end / BINS, 3), 'marker': {'color': '@seen'},
            'hovertemplate': '%{x:.1f} px: %{y}<extra></extra>',
        }
    ]  # fmt: skip
    threshold = round(look.threshold_px, 3)
    layout = {
        'xaxis': {'title': {'text': 'residual [px]'}, 'rangemode': 'tozero'},
        'yaxis': {'title': {'text': 'keypoints'}},
        'bargap': 0,
        'shapes': [{'type': 'line', 'x0': threshold, 'x1': threshold, 'yref': 'paper', 'y0': 0,
                    'y1': 1, 'line': {'color': '@bad', 'width': 1.5, 'dash': 'dot'}}],
        'annotations': [{'x': threshold, 'y': 1, 'yref': 'paper', 'text': 'agrees below',
                         'showarrow': False, 'xanchor': 'left', 'font': {'color': '@bad'}}],
    }  # fmt: skip
    text = f'Histogram of the residuals: median {number(float(np.median(errors)), 2, "px")}'
    text += f'; the last bar holds the {n_beyond} beyond.' if n_beyond else '.'
    return Figure(f'{key}-histogram', text, traces, layout, 240)


def _ratio(look: Look) -> float:
    """Width over height of a map, with the place of its scale."""
    return round(1.15 * look.camera.size[0] / look.camera.size[1], 3)


def _grid(look: Look) -> tuple[IntArray, int, tuple[int, int]]:
    """Cell of each seen keypoint, number of cells, and cells across and down."""
    width, height = look.camera.size
    longer = max(width, height)
    size = max(1, round(CELLS * width / longer)), max(1, round(CELLS * height / longer))
    uv = look.view.uv[look.seen]
    column = np.clip((uv[:, 0] + 0.5) * size[0] / width, 0, size[0] - 1).astype(np.int64)
    row = np.clip((uv[:, 1] + 0.5) * size[1] / height, 0, size[1] - 1).astype(np.int64)
    return row * size[0] + column, size[0] * size[1], size


def _centres(look: Look, size: tuple[int, int]) -> tuple[Array, Array]:
    width, height = look.camera.size
    x = (np.arange(size[0]) + 0.5) * width / size[0] - 0.5
    y = (np.arange(size[1]) + 0.5) * height / size[1] - 0.5
    return x, y


def _heat(table: Array, x: Array, y: Array, what: str, unit: str, scale: str) -> Mapping[str, Any]:
    return {
        'type': 'heatmap', 'x': rounded(x), 'y': rounded(y), 'z': rounded(table, 2),
        'colorscale': scale, 'hoverongaps': False,
        'hovertemplate': f'{what} %{{z}} {unit}<extra></extra>',
        'colorbar': {'thickness': 10, 'title': {'text': unit}, 'outlinewidth': 0},
    }  # fmt: skip
