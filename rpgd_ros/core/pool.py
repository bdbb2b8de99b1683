# SPDX-License-Identifier: Apache-2.0
"""A small sample of the correspondences in ideal image coordinates, all cameras side by side.

The robust start draws its triplets from it, scores and polishes its hypotheses on it. Cameras
share it equally, however many keypoints each has, so that no minority camera goes unheard.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from rpgd_ros.core.camera import MIN_DEPTH
from rpgd_ros.core.geometry import Array, BoolArray, IntArray
from rpgd_ros.core.observations import is_there

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rpgd_ros.core.linearise import Sight

OVERDRAW = 4  # draws per wanted point: enough while a quarter of the keypoints is there


@dataclass(frozen=True, slots=True, eq=False)
class Pool:
    """n correspondences in view of their lens models.

    Attributes:
        camera: (n,) index of the camera, ascending.
        frame: (n,) index of that camera's frame.
        x_mocap: (n, 3) metres.
        ideal: (n, 2) keypoints without intrinsics and distortion.
        focal_px: (n,) of each point's camera.
        camera_R_world: (V, 3, 3).
        camera_t_world: (V, 3) metres.

    """

    camera: IntArray
    frame: IntArray
    x_mocap: Array
    ideal: Array
    focal_px: Array
    camera_R_world: Array
    camera_t_world: Array

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.camera)

    @property
    def centroid_mocap(self) -> Array:
        """(3,) mean of the points, metres, MoCap frame."""
        centroid: Array = self.x_mocap.mean(0)
        return centroid

    def take(self, index: IntArray) -> Pool:
        """Return a part of the pool; the index must ascend."""
        return Pool(
            self.camera[index], self.frame[index], self.x_mocap[index], self.ideal[index],
            self.focal_px[index], self.camera_R_world, self.camera_t_world,
        )  # fmt: skip

    def squared_residuals(self, rotation: Array, translation: Array) -> Array:
        """Squared residuals of many hypotheses, pixels by focal length; inf behind a camera.

        Args:
            rotation: (H, 3, 3) world_R_mocap.
            translation: (H, 3) metres.

        Returns:
            (H, n) px^2.

        """
        out = np.empty((len(rotation), len(self)))
        bounds = np.searchsorted(self.camera, np.arange(len(self.camera_R_world) + 1))
        for c, (start, stop) in enumerate(pairwise(bounds)):
            if start == stop:
                continue
            part = slice(start, stop)
            r = self.camera_R_world[c] @ rotation
            t = translation @ self.camera_R_world[c].T + self.camera_t_world[c]
            moved = r.transpose(1, 0, 2).reshape(-1, 3) @ self.x_mocap[part].T
            a, b, z = moved.reshape(3, len(r), stop - start) + t.T[:, :, None]
            behind = z < MIN_DEPTH
            iz = 1.0 / np.where(behind, 1.0, z)
            a *= iz
            b *= iz
            a -= self.ideal[part, 0]
            b -= self.ideal[part, 1]
            a *= a
            b *= b
            a += b
            a *= self.focal_px[start] ** 2
            a[behind] = np.inf
            out[:, part] = a
        return out


def make_pool(sights: Sequence[Sight], per_camera: int, rng: np.random.Generator) -> Pool:
    """Draw up to `per_camera` correspondences of each camera, spread over its frames."""
    parts = [_draw_camera(sight, per_camera, rng) for sight in sights]
    counts = [len(frame) for frame, _, _ in parts]
    frame, x, ideal = (np.concatenate(column) for column in zip(*parts, strict=True))
    focal = np.array([s.camera.focal_px for s in sights])
    return Pool(
        camera=np.repeat(np.arange(len(sights)), counts),
        frame=frame,
        x_mocap=x,
        ideal=ideal,
        focal_px=np.repeat(focal, counts),
        camera_R_world=np.stack([s.camera_T_world.rotation for s in sights]),
        camera_t_world=np.stack([s.camera_T_world.translation for s in sights]),
    )


def _draw_camera(
    sight: Sight, wanted: int, rng: np.random.Generator
) -> tuple[IntArray, Array, Array]:
    """Return frames (m,), x_mocap (m, 3), ideal keypoints (m, 2) of one camera."""
    view = sight.view
    total = view.n_frames * view.n_joints
    index = np.unique(rng.integers(0, max(total, 1), OVERDRAW * wanted))
    index = index[_is_seen(sight, index)] if total else index[:0]
    if len(index) < wanted and total:
        index = np.flatnonzero(view.seen())  # few keypoints are there: look at all of them
    if len(index) > wanted:
        index = np.sort(rng.choice(index, wanted, replace=False))
    frame, joint = np.divmod(index, max(1, view.n_joints))
    ideal = sight.camera.normalise(view.uv[frame, joint])
    good = np.isfinite(ideal).all(-1)
    return frame[good], view.x_mocap[frame, joint][good], ideal[good]


def _is_seen(sight: Sight, index: IntArray) -> BoolArray:
    """Whether the flat (frame, joint) indices have both sides of a correspondence."""
    frame, joint = np.divmod(index, max(1, sight.view.n_joints))
    x, uv = sight.view.x_mocap[frame, joint], sight.view.uv[frame, joint]
    return is_there(x) & is_there(uv)
