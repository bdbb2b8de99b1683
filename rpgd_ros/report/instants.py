# SPDX-License-Identifier: Apache-2.0
"""Single instants of a camera: what the detector saw, and the reprojected skeleton."""

from __future__ import annotations

import base64
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

import cv2
import numpy as np

from rpgd_ros.core.geometry import Array
from rpgd_ros.report.blocks import Figure, label, number, rounded
from rpgd_ros.report.case import Case, Photo
from rpgd_ros.report.measure import Look, Measured, measure
from rpgd_ros.skeletons import edges

PHOTO_WIDTH, PHOTO_QUALITY = 960, 70  # pixels, JPEG: about 60 kB of an image
LEAST_PART = 0.4  # of the image that is shown where the body is small in it
MARGIN = 1.5  # times the box around both skeletons


def instants(
    measured: Measured, look: Look, key: str, photos: Sequence[Photo]
) -> Iterator[Figure]:
    """Yield a typical and the worst instant of a camera.

    Args:
        measured: The run.
        look: The camera.
        key: Of its section.
        photos: Its images, where there are any.

    """
    rows = _chosen(look, [photo.frame for photo in photos])
    for row, what in zip(rows, ('A typical instant', 'The worst instant'), strict=False):
        yield _instant(measured, look, row, what, key, photos)


def choose_instants(
    case: Case, pictured: Mapping[str, Collection[int]]
) -> dict[str, tuple[int, ...]]:
    """Return the instants that a report shows of each camera, for which an image is welcome.

    Args:
        case: The run.
        pictured: By camera, the numbers of the instants that there are images of.

    """
    return {
        look.camera.name: tuple(
            int(look.frames[row]) for row in _chosen(look, pictured.get(look.camera.name, ()))
        )
        for look in measure(case).looks
        if look.seen.any()
    }


def _chosen(look: Look, pictured: Collection[int]) -> list[int]:
    """Rows of a typical and of the worst instant, among those with an image where there are."""
    rows = np.flatnonzero(look.seen.sum(1) >= 0.5 * look.seen.sum(1).max())
    with_image = np.flatnonzero(np.isin(look.frames, list(pictured)))
    rows = np.intersect1d(rows, with_image) if np.isin(rows, with_image).any() else rows
    if not np.isfinite(look.error_px).any():
        return [int(rows[len(rows) // 2])]
    with np.errstate(invalid='ignore'):
        of_frame = np.nan_to_num(np.nanmedian(_filled(look.error_px[rows]), axis=1))
    order = rows[np.argsort(of_frame, kind='stable')]
    typical, worst = int(order[(len(order) - 1) // 2]), int(order[-1])
    return [typical] if typical == worst else [typical, worst]


def _filled(errors: Array) -> Array:
    """Give rows without any number a zero, so that their median is one."""
    rows = ~np.isfinite(errors).any(1)
    out = errors.copy()
    out[rows] = 0.0
    return out


def _instant(
    measured: Measured, look: Look, row: int, what: str, key: str, photos: Sequence[Photo]
) -> Figure:  # fmt: skip
    """Draw measured and reprojected skeleton of one instant."""
    bones = edges(measured.names)
    names = [label(name) for name in measured.names]
    seen = np.where(look.seen[row][:, None], look.view.uv[row], np.nan)
    traces = []
    if np.isfinite(look.uv[row]).any():
        traces += _drawn(look.uv[row], bones, names, 'MoCap, reprojected', '@made', 6)
    traces += _drawn(seen, bones, names, 'detector', '@seen', 2)
    traces.append(_apart(seen, look.uv[row]))
    when = (
        f'at {number(look.seconds[row] - measured.start_s, 2, "s")}'
        if measured.has_time
        else f'frame {int(look.frames[row])}'
    )
    error = look.error_px[row]
    how = (
        f'median residual {number(float(np.nanmedian(error)), 1, "px")}'
        if np.isfinite(error).any()
        else 'no transform to reproject with'
    )
    image = next((p.image for p in photos if p.frame == look.frames[row]), None)
    layout = over_image(look.camera.size, image)
    if image is None:
        _zoom(layout, look.camera.size, np.concatenate([seen, look.uv[row]]))
    layout['legend'] = {'orientation': 'h', 'y': 1.02, 'yanchor': 'bottom', 'x': 0.0}
    layout['margin'] = {'l': 4, 'r': 4, 't': 28, 'b': 4}
    ratio = round(look.camera.size[0] / look.camera.size[1] * 0.93, 3)
    caption = f'{what}, {when}: {how}.'
    return Figure(f'{key}-instant-{row}', caption, traces, layout, 420, ratio)


def _drawn(
    uv: Array,
    bones: Sequence[tuple[int, int]],
    names: list[str],
    name: str,
    colour: str,
    width: int,
) -> list[Mapping[str, Any]]:
    gap = np.full((1, 2), np.nan)
    line = np.concatenate([p for a, b in bones for p in (uv[[a, b]], gap)] or [gap])
    both = {'type': 'scatter', 'legendgroup': name, 'name': name}
    return [
        {
            **both, 'mode': 'lines', 'showlegend': False, 'hoverinfo': 'skip',
            'x': rounded(line[:, 0]), 'y': rounded(line[:, 1]),
            'line': {'color': colour, 'width': width},
        },
        {
            **both, 'mode': 'markers', 'x': rounded(uv[:, 0]), 'y': rounded(uv[:, 1]),
            'text': names, 'hovertemplate': '%{text}<br>%{x:.1f}, %{y:.1f} px',
            'marker': {'color': colour, 'size': 7},
        },
    ]  # fmt: skip


def _apart(seen: Array, uv: Array) -> Mapping[str, Any]:
    """Draw from each keypoint to where the reprojection has its joint."""
    pairs = np.stack([seen, uv, np.full_like(uv, np.nan)], 1).reshape(-1, 2)
    return {
        'type': 'scatter', 'mode': 'lines', 'name': 'apart', 'hoverinfo': 'skip',
        'x': rounded(pairs[:, 0]), 'y': rounded(pairs[:, 1]),
        'line': {'color': '@bad', 'width': 1.5, 'dash': 'dot'},
    }  # fmt: skip


def _zoom(layout: dict[str, Any], size: tuple[int, int], uv: Array) -> None:
    """Show the part of an empty image that the skeletons are in, in the image's proportions."""
    width, height = size
    there = uv[np.isfinite(uv).all(1)]
    low, high = there.min(0), there.max(0)
    spans = MARGIN * (high - low) / [width, height]
    part = float(np.clip(spans.max(), LEAST_PART, 1.0))
    half = part * np.array([width, height]) / 2.0
    middle = np.clip((low + high) / 2.0, half, np.array([width, height]) - half)
    layout['xaxis']['range'] = rounded(middle[0] + half[0] * np.array([-1.0, 1.0]))
    layout['yaxis']['range'] = rounded(middle[1] + half[1] * np.array([1.0, -1.0]))


def over_image(size: tuple[int, int], image: Any) -> dict[str, Any]:
    """Axes that are the pixels of an image, with the image where there is one."""
    width, height = size
    axis = {'showgrid': False, 'zeroline': False, 'showticklabels': False, 'ticks': '',
            'constrain': 'domain', 'mirror': True, 'showline': True,
            'linecolor': '@grid'}  # fmt: skip
    layout: dict[str, Any] = {
        'xaxis': {**axis, 'range': [-0.5, width - 0.5]},
        'yaxis': {**axis, 'range': [height - 0.5, -0.5], 'scaleanchor': 'x'},
        'margin': {'l': 4, 'r': 4, 't': 4, 'b': 4},
    }
    if image is not None:
        layout['images'] = [{
            'source': data_url(image), 'xref': 'x', 'yref': 'y', 'x': -0.5, 'y': -0.5,
            'sizex': width, 'sizey': height, 'sizing': 'stretch', 'layer': 'below',
        }]  # fmt: skip
    return layout


def data_url(image: Any) -> str:
    """Return an image as the address of itself, shrunk to what a page can show."""
    height, width = image.shape[:2]
    if width > PHOTO_WIDTH:
        small = PHOTO_WIDTH, max(1, round(height * PHOTO_WIDTH / width))
        image = cv2.resize(image, small, interpolation=cv2.INTER_AREA)
    _, encoded = cv2.imencode('.jpg', image, [cv2.IMWRITE_JPEG_QUALITY, PHOTO_QUALITY])
    return f'data:image/jpeg;base64,{base64.b64encode(encoded.tobytes()).decode()}'
