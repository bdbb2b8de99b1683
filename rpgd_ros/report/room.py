# SPDX-License-Identifier: Apache-2.0
"""The room: cameras, the way of the body, and the body itself, in space and from above."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from rpgd_ros.core import Camera, RigidTransform
from rpgd_ros.core.geometry import Array
from rpgd_ros.report.blocks import Block, Figure, Section, Side, Text, label, number, rounded
from rpgd_ros.report.measure import Measured
from rpgd_ros.skeletons import edges

BODIES = 6  # instants at which the skeleton is drawn
PATH_POINTS = 600
FRUSTUM_M = 0.45  # depth of the drawn pyramid of view
GAP = np.full((1, 3), np.nan)  # ends a line


def room(measured: Measured) -> Section | None:
    """Return the section of the room, None where nobody walked."""
    if not any(look.seen.any() for look in measured.looks):
        return None
    case = measured.case
    frame = case.world_frame if case.calibration else case.mocap_frame
    walked = number(case.moved_m, 2, 'm')
    intro = f'Seen in the frame {frame}. The person walked within {walked}.'
    if case.calibration is None:
        intro += ' No transform is known, so only the MoCap side is drawn.'
    blocks: tuple[Block, ...] = (
        Text(intro),
        Side((_space(measured), _plan(measured))),
    )
    is_marked = case.refusal is not None and 'motion' in case.refusal.reason
    return Section('room', 'Room', blocks, is_marked=is_marked)


def _space(measured: Measured) -> Figure:
    t, path = measured.path
    few = np.linspace(0, len(t) - 1, min(len(t), PATH_POINTS)).astype(int)
    traces: list[Mapping[str, Any]] = [
        {
            **_xyz(path[few], 3),
            'type': 'scatter3d',
            'mode': 'lines+markers',
            'name': 'way of the body',
            'line': {'color': '@quiet', 'width': 3},
            'marker': {'size': 2.5, 'color': rounded(t[few]), 'colorscale': 'Viridis'},
            'hovertemplate': '%{marker.color:.1f} s<extra></extra>',
        },
        _lines3d(_bodies(measured), 'MoCap skeleton', '@made', 4),
    ]
    traces += list(_cameras3d(measured))
    axis = {'showbackground': False, 'gridcolor': '@grid', 'zerolinecolor': '@grid',
            'color': '@quiet', 'showspikes': False}  # fmt: skip
    up = measured.up
    # From the side and a little above, whichever axis is the vertical.
    ahead = np.roll(np.abs(up), 1)
    eye = 1.6 * ahead + 1.35 * np.roll(np.abs(up), 2) + 1.0 * up
    return Figure(
        'room-3d',
        'Drag to turn, wheel or pinch to zoom. The way is coloured from the first second (dark) '
        'to the last (light).',
        traces,
        {
            'scene': {
                'aspectmode': 'data',
                'xaxis': {**axis, 'title': {'text': 'x [m]'}},
                'yaxis': {**axis, 'title': {'text': 'y [m]'}},
                'zaxis': {**axis, 'title': {'text': 'z [m]'}},
                'camera': {'up': _point(up), 'eye': _point(eye)},
            },
            'margin': {'l': 0, 'r': 0, 't': 0, 'b': 0},
            'legend': {'orientation': 'h', 'y': 0.0},
        },
        height=480,
    )


def _plan(measured: Measured) -> Figure:
    """The same from above: for paper, and where a browser has no WebGL."""
    t, path = measured.path
    axis = int(np.argmax(np.abs(measured.up)))
    right, ahead = (1, 2) if axis == 0 else (2, 0) if axis == 1 else (0, 1)
    if measured.up[axis] < 0:
        right, ahead = ahead, right
    few = np.linspace(0, len(t) - 1, min(len(t), PATH_POINTS)).astype(int)
    traces: list[Mapping[str, Any]] = [
        {
            'type': 'scatter',
            'mode': 'lines+markers',
            'x': rounded(path[few, right], 3),
            'y': rounded(path[few, ahead], 3),
            'name': 'way of the body',
            'line': {'color': '@quiet', 'width': 1},
            'marker': {'size': 4, 'color': rounded(t[few]), 'colorscale': 'Viridis'},
            'hovertemplate': '%{marker.color:.1f} s<extra></extra>',
        }
    ]
    for group, colour in (('camera', '@ink'), ('moved camera', '@bad')):
        is_moved = group != 'camera'
        members = [c for c in _placed(measured) if (c.name in measured.moved) == is_moved]
        if not members:
            continue
        centres = np.stack([_centre(c) for c in members])
        ends = np.stack([_centre(c) + _forward(c) for c in members])
        way = _joined([np.stack(pair) for pair in zip(centres, ends, strict=True)])
        traces += [
            {
                'type': 'scatter', 'mode': 'lines', 'hoverinfo': 'skip', 'showlegend': False,
                'x': rounded(way[:, right], 3), 'y': rounded(way[:, ahead], 3),
                'line': {'color': colour, 'width': 1.5},
            },
            {
                'type': 'scatter', 'mode': 'markers+text', 'name': group,
                'x': rounded(centres[:, right], 3), 'y': rounded(centres[:, ahead], 3),
                'text': [label(c.name) for c in members], 'textposition': 'top center',
                'textfont': {'color': colour}, 'hoverinfo': 'text', 'cliponaxis': False,
                'marker': {'symbol': 'square', 'size': 9, 'color': colour},
            },
        ]  # fmt: skip
    names = 'xyz'
    return Figure(
        'room-plan',
        'From above. A line shows where a camera looks.',
        traces,
        {
            'xaxis': {'title': {'text': f'{names[right]} [m]'}, 'constrain': 'domain'},
            'yaxis': {
                'title': {'text': f'{names[ahead]} [m]'},
                'scaleanchor': 'x',
                'constrain': 'domain',
            },
            'showlegend': False,
            'margin': {'l': 50, 'r': 20, 't': 30, 'b': 44},
        },
        height=480,
    )


def _bodies(measured: Measured) -> Array:
    """Bones at some instants, as one line with gaps: (N, 3)."""
    look = max(measured.looks, key=lambda look: int(look.seen.any(1).sum()))
    rows = np.flatnonzero(look.seen.any(1))
    some = rows[np.linspace(0, len(rows) - 1, min(BODIES, len(rows))).astype(int)]
    x = measured.to_world(look.view.x_mocap[some])
    bones = edges(measured.names)
    return _joined([body[[a, b]] for body in x for a, b in bones])


def _cameras3d(measured: Measured) -> Iterator[Mapping[str, Any]]:
    cameras = _placed(measured)
    for name, colour in (('cameras', '@ink'), ('moved', '@bad')):
        members = [c for c in cameras if (c.name in measured.moved) == (name == 'moved')]
        if not members:
            continue
        yield _lines3d(_joined([pyramid(c) for c in members]), name, colour, 3)
        centres = np.stack([_centre(c) for c in members])
        yield {
            **_xyz(centres, 3),
            'type': 'scatter3d', 'mode': 'markers+text', 'hoverinfo': 'text',
            'text': [label(c.name) for c in members], 'textfont': {'color': colour},
            'marker': {'size': 3, 'color': colour}, 'showlegend': False,
        }  # fmt: skip


def _placed(measured: Measured) -> list[Camera]:
    """Cameras whose place is known in the frame of the picture."""
    return [look.camera for look in measured.looks] if measured.case.calibration else []


def pyramid(camera: Camera) -> Array:
    """The pyramid of view as one line (N, 3), world."""
    width, height = camera.size
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float64)
    rays = camera.normalise(corners)
    if not np.isfinite(rays).all():  # beyond the lens model
        fx, fy, cx, cy = camera.pinhole
        rays = np.clip((corners - [cx, cy]) / [fx, fy], -1.5, 1.5)
    x = np.column_stack([rays, np.ones(4)]) * FRUSTUM_M
    o = np.zeros(3)
    line = np.stack([o, x[0], x[1], o, x[2], x[3], o, x[1], x[2], x[3], x[0]])
    return _pose(camera).inverse() @ line


def _pose(camera: Camera) -> RigidTransform:
    return camera.camera_T_world or RigidTransform.identity()


def _centre(camera: Camera) -> Array:
    return _pose(camera).inverse().translation


def _forward(camera: Camera) -> Array:
    """Where a camera looks, world: a metre long."""
    forward: Array = _pose(camera).rotation[2]
    return forward


def _joined(parts: list[Array]) -> Array:
    """Several lines (n, 3) as one with gaps."""
    return np.concatenate([piece for part in parts for piece in (part, GAP)] or [GAP])


def _lines3d(points: Array, name: str, colour: str, width: int) -> Mapping[str, Any]:
    return {
        **_xyz(points, 3),
        'type': 'scatter3d',
        'mode': 'lines',
        'name': name,
        'hoverinfo': 'skip',
        'connectgaps': False,
        'line': {'color': colour, 'width': width},
    }


def _xyz(points: Array, digits: int) -> dict[str, Any]:
    return {name: rounded(points[:, i], digits) for i, name in enumerate('xyz')}


def _point(vector: Array) -> dict[str, float]:
    return dict(zip('xyz', vector.tolist(), strict=True))
