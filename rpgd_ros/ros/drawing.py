# SPDX-License-Identifier: Apache-2.0
"""The room as lines, points and colours: floor, cameras, skeleton, the way. Needs no ROS."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rpgd_ros.core.camera import Camera
from rpgd_ros.core.geometry import Array, RigidTransform
from rpgd_ros.session.recent import Pairs

FRUSTUM_M = 0.6  # depth of a drawn camera: seen across a room, and in nobody's way
FLOOR_CELL_M = 0.5  # between two lines, and of a square that was walked over
FLOOR_MARGIN_M = 0.5  # around cameras and way
MAX_FLOOR_M = 50.0  # of a side: a line more is no use, and a stray position would draw millions
PATH_STEP_M = 0.1  # between two points of the way
MAX_PATH = 1000  # points of the way: 100 m
SNAP = 0.9  # cosine to an axis of the world within which "up" is that axis

Rgba = tuple[float, float, float, float]
GREY: Rgba = (0.6, 0.6, 0.6, 0.6)
GREEN: Rgba = (0.15, 0.8, 0.25, 1.0)
RED: Rgba = (0.95, 0.2, 0.15, 1.0)
BLUE: Rgba = (0.3, 0.6, 1.0, 1.0)
FADED_GREEN: Rgba = (0.15, 0.8, 0.25, 0.25)


class Place(NamedTuple):
    """Where the person was, and how the cameras agreed with it.

    Attributes:
        x_mocap: (J, 3) metres; NaN = missing.
        agreement: (J,) share of the cameras that see a joint near its reprojection; NaN where
            none sees it.

    """

    x_mocap: Array
    agreement: Array


class Way:
    """The way that was walked, in steps."""

    def __init__(self) -> None:
        """Start empty."""
        self.places: deque[Place] = deque(maxlen=MAX_PATH)
        self.newest: Place | None = None

    def add(
        self, pairs: Sequence[Pairs], world_T_mocap: RigidTransform | None, threshold_px: float
    ) -> None:
        """Take the newest frame of each camera.

        Args:
            pairs: What the cameras saw since the last time.
            world_T_mocap: The published pose, None without one.
            threshold_px: Residual up to which a keypoint agrees.

        """
        if not pairs:
            return
        seen, near = np.zeros((2, pairs[0].view.n_joints))
        for new in pairs:
            x, uv = new.view.x_mocap[-1], new.view.uv[-1]
            there = new.view.seen()[-1]
            if world_T_mocap is None or not new.is_placed:
                continue
            apart = np.linalg.norm(new.camera.project(world_T_mocap @ x) - uv, axis=-1)
            seen += there
            near += there & (apart < threshold_px)  # False for NaN: not in view
        # A copy: a row of the view would keep all frames of the view as long as the place.
        x_mocap = pairs[0].view.x_mocap[-1].copy()
        with np.errstate(invalid='ignore'):
            place = Place(x_mocap, np.where(seen > 0, near / np.maximum(seen, 1), np.nan))
        middle = middle_of(x_mocap)
        if middle is None:
            return
        self.newest = place
        before = middle_of(self.places[-1].x_mocap) if self.places else None
        if before is None or np.linalg.norm(middle - before) >= PATH_STEP_M:
            self.places.append(place)

    def clear(self) -> None:
        """Forget the way."""
        self.places.clear()
        self.newest = None


def middle_of(x: Array) -> Array | None:
    """Return the middle of the joints (J, 3) that are there; None without any."""
    there = x[np.isfinite(x).all(-1)]
    return there.mean(0) if len(there) else None


def colour_of(agreement: float) -> Rgba:
    """Green where the cameras agree, red where they do not, grey where none says anything."""
    if np.isnan(agreement):
        return GREY
    mixed = [agreement * g + (1.0 - agreement) * r for g, r in zip(GREEN, RED, strict=True)]
    return mixed[0], mixed[1], mixed[2], mixed[3]


def frustum(camera: Camera) -> Array:
    """Return the lines of a camera's pyramid as pairs of world points: (16, 3)."""
    width, height = camera.size
    pixels = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float64) - 0.5
    fx, fy, cx, cy = camera.pinhole
    ideal = camera.normalise(pixels)
    # A corner that the lens model does not reach is drawn where a lens without distortion has it.
    ideal = np.where(np.isfinite(ideal), ideal, (pixels - [cx, cy]) / [fx, fy])
    corners = FRUSTUM_M * np.column_stack([ideal, np.ones(4)])
    lines = [point for i in range(4) for point in (np.zeros(3), corners[i])]
    lines += [point for i in range(4) for point in (corners[i], corners[(i + 1) % 4])]
    world_T_camera = (camera.camera_T_world or RigidTransform.identity()).inverse()
    drawn: Array = world_T_camera @ np.array(lines)
    return drawn


def centre_of(camera: Camera) -> Array:
    """Return where a camera stands in the world (3,), metres."""
    return (camera.camera_T_world or RigidTransform.identity()).inverse().translation


@dataclass(frozen=True, slots=True, eq=False)
class Floor:
    """The floor of the room.

    Attributes:
        axes: (3, 3) rows: along the floor, along the floor, up.
        height_m: Along `up`, from the origin of the world.

    """

    axes: Array
    height_m: float

    @classmethod
    def under(cls, cameras: Sequence[Camera], x_world: Array) -> Floor:
        """Find the floor: cameras hang upright on the mean, and feet stand on it.

        Args:
            cameras: With their poses.
            x_world: (n, J, 3) bodies, metres; NaN = missing.

        """
        up = np.zeros(3)
        for camera in cameras:
            up -= (camera.camera_T_world or RigidTransform.identity()).rotation[1]
        length = float(np.linalg.norm(up))
        up = up / length if length > 0.1 else np.array([0.0, 0.0, 1.0])
        main = int(np.argmax(np.abs(up)))
        if abs(up[main]) > SNAP:
            up = np.where(np.arange(3) == main, np.sign(up[main]), 0.0)
        along = np.eye(3)[(main + 1) % 3]
        along = along - (along @ up) * up
        along /= np.linalg.norm(along)
        axes = np.stack([along, np.cross(up, along), up])
        heights = x_world @ up
        lowest = np.nanmin(heights, axis=1) if heights.size else np.zeros(1)
        return cls(axes, float(np.quantile(lowest, 0.05)))

    def grid(self, x_world: Array) -> Array:
        """Return lines under points (n, 3), as pairs of world points (2 m, 3)."""
        flat = x_world @ self.axes[:2].T
        low = np.floor((flat.min(0) - FLOOR_MARGIN_M) / FLOOR_CELL_M) * FLOOR_CELL_M
        high = np.ceil((flat.max(0) + FLOOR_MARGIN_M) / FLOOR_CELL_M) * FLOOR_CELL_M
        high = np.minimum(high, low + MAX_FLOOR_M)
        lines = []
        for axis in (0, 1):
            for at in np.arange(low[axis], high[axis] + 1e-9, FLOOR_CELL_M).tolist():
                ends = np.array([low, high])
                ends[:, axis] = at
                lines += list(ends)
        return self._raised(np.array(lines))

    def covered(self, x_world: Array) -> Array:
        """Return the middles of the squares under points (n, 3): (m, 3) world."""
        cells = np.unique(np.floor(x_world @ self.axes[:2].T / FLOOR_CELL_M), axis=0)
        return self._raised((cells + 0.5) * FLOOR_CELL_M)

    def _raised(self, flat: Array) -> Array:
        world: Array = flat @ self.axes[:2] + self.height_m * self.axes[2]
        return world


def bones_there(x: Array, edges: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return the bones of which both ends (J, 3) are there."""
    there = np.isfinite(x.sum(-1))
    return [(a, b) for a, b in edges if there[a] and there[b]]
