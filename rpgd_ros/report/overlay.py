# SPDX-License-Identifier: Apache-2.0
"""The detector's keypoints beside the reprojected MoCap skeleton, drawn with OpenCV."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from rpgd_ros.core import Camera, Observations, RigidTransform
from rpgd_ros.core.geometry import Array
from rpgd_ros.io.atomic import write_atomic

if TYPE_CHECKING:
    from collections.abc import Sequence

Image = NDArray[np.uint8]
Colour = tuple[int, int, int]

# Blue, green, red. Light enough for the dark ground, apart for every kind of colour vision.
GROUND: Colour = (38, 30, 27)
DETECTED: Colour = (230, 159, 86)
REPROJECTED: Colour = (0, 159, 230)
INK: Colour = (225, 225, 225)

FAINTEST = 0.25  # of a colour, for the earliest instant: still to be seen on paper
TILE_WIDTH = 640  # pixels: two of them fit a README
SUBPIXEL_BITS = 4  # OpenCV draws at sixteenths of a pixel


def overlay_sheet(
    cameras: Sequence[Camera],
    observations: Observations,
    world_T_mocap: RigidTransform,
    *,
    edges: Sequence[tuple[int, int]],
    instants: int = 5,
    columns: int = 2,
) -> Image:
    """Draw the walk in all cameras: keypoints as dots, the reprojected skeleton as lines.

    Args:
        cameras: One per view.
        observations: Skeletons and keypoints.
        world_T_mocap: The calibration.
        edges: Bones, as pairs of joint numbers.
        instants: How many instants, evenly spread; the earlier, the fainter.
        columns: Tiles beside each other.

    Returns:
        (height, width, 3) blue, green, red.

    """
    tiles = []
    for camera, view in zip(cameras, observations.views, strict=True):
        tile = np.full((camera.size[1], camera.size[0], 3), GROUND, np.uint8)
        camera_T_mocap = (camera.camera_T_world or RigidTransform.identity()) @ world_T_mocap
        for k in range(instants if view.n_frames else 0):
            frame = (2 * k + 1) * view.n_frames // (2 * instants)
            strength = FAINTEST + (1.0 - FAINTEST) * (k + 1) / instants
            uv = camera.project_camera(camera_T_mocap @ view.x_mocap[frame])
            draw_skeleton(tile, uv, edges, _faded(REPROJECTED, strength))
            draw_skeleton(tile, view.uv[frame], (), _faded(DETECTED, strength))
        tiles.append(_labelled(tile, camera.name))
    return _arrange(tiles, columns)


def draw_skeleton(
    image: Image, uv: Array, edges: Sequence[tuple[int, int]], colour: Colour
) -> None:
    """Draw bones and joints into an image.

    Args:
        image: (height, width, 3), changed in place.
        uv: (J, 2) pixels; NaN is left out.
        edges: Pairs of joint numbers; none = dots only.
        colour: Blue, green, red.

    """
    unit = max(1, image.shape[1] // 400)
    there = np.abs(uv).max(-1) < 10 * max(image.shape)  # False for NaN
    fixed = np.round(np.where(there[:, None], uv, 0.0) * 2**SUBPIXEL_BITS).astype(int)
    for a, b in edges:
        if there[a] and there[b]:
            cv2.line(image, _point(fixed[a]), _point(fixed[b]), colour, 2 * unit, cv2.LINE_AA,
                     SUBPIXEL_BITS)  # fmt: skip
    radius = 2 * unit << SUBPIXEL_BITS
    for joint in np.flatnonzero(there):
        cv2.circle(image, _point(fixed[joint]), radius, colour, -1, cv2.LINE_AA, SUBPIXEL_BITS)


def write_png(path: str | Path, image: Image) -> None:
    """Write an image whole or not at all.

    Raises:
        InputError: The folder cannot be written (NOT_WRITABLE).

    """
    _, encoded = cv2.imencode('.png', image)
    write_atomic(Path(path), encoded.tobytes())


def _faded(colour: Colour, strength: float) -> Colour:
    """Mix a colour with the ground."""
    b, g, r = (
        round(strength * c + (1.0 - strength) * g) for c, g in zip(colour, GROUND, strict=True)
    )
    return b, g, r


def _point(fixed: NDArray[np.int64]) -> tuple[int, int]:
    return int(fixed[0]), int(fixed[1])


def _labelled(tile: Image, name: str) -> Image:
    """Shrink to the width of a tile and name it."""
    height = round(tile.shape[0] * TILE_WIDTH / tile.shape[1])
    small = cv2.resize(tile, (TILE_WIDTH, height), interpolation=cv2.INTER_AREA)
    cv2.putText(small, name, (14, 30), cv2.FONT_HERSHEY_SIMPLEX, 0.7, INK, 1, cv2.LINE_AA)
    return np.asarray(small, np.uint8)


def _arrange(tiles: Sequence[Image], columns: int) -> Image:
    """Set tiles in rows, over a legend."""
    height = max(tile.shape[0] for tile in tiles)
    columns = min(columns, len(tiles))
    rows = -(-len(tiles) // columns)
    sheet = np.full((rows * height + 44, columns * TILE_WIDTH, 3), GROUND, np.uint8)
    for k, tile in enumerate(tiles):
        row, column = divmod(k, columns)
        top, left = row * height, column * TILE_WIDTH
        sheet[top : top + tile.shape[0], left : left + TILE_WIDTH] = tile
        cv2.rectangle(sheet, (left, top), (left + TILE_WIDTH - 1, top + height - 1), (70, 62, 58))
    x, y = 14, rows * height + 28
    for colour, text in ((DETECTED, 'detector'), (REPROJECTED, 'MoCap, through the calibration')):
        cv2.circle(sheet, (x + 5, y - 5), 6, colour, -1, cv2.LINE_AA)
        cv2.putText(sheet, text, (x + 20, y), cv2.FONT_HERSHEY_SIMPLEX, 0.55, INK, 1, cv2.LINE_AA)
        x += 130
    return sheet
