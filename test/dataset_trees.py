# SPDX-License-Identifier: Apache-2.0
"""Trees of simulated sequences in the layouts of datasets, for the tests of their readers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rpgd_ros.datasets import DatasetSequence
from rpgd_ros.simulation import Faults, preset
from rpgd_ros.simulation.dataset_scenes import TwinPlan
from rpgd_ros.simulation.dataset_writers import write_twin

SECONDS = 2.0


def plan(name: str, sequences: int = 2, seconds: float = SECONDS) -> TwinPlan:
    """Return the plan of a small tree without faults."""
    return TwinPlan(preset(name), sequences, seconds, 3, 'walk', Faults())


def write_tree(name: str, folder: Path, sequences: int = 2) -> Path:
    """Write a small tree and return its folder."""
    folder.mkdir()
    write_twin(plan(name, sequences), folder)
    return folder


def residuals_px(sequence: DatasetSequence) -> NDArray[np.float64]:
    """Return the distances of keypoints and joints at the dataset's own pose, all that are known.

    The projection is written out, so that a wrong convention of the reader cannot hide in it.
    """
    found = []
    for camera, view in zip(sequence.cameras, sequence.observations.views, strict=True):
        pose = camera.camera_T_world
        assert pose is not None
        x_world = view.x_mocap @ sequence.world_T_mocap.rotation.T
        x_camera = (x_world + sequence.world_T_mocap.translation) @ pose.rotation.T
        x_camera += pose.translation
        x, y = x_camera[..., 0] / x_camera[..., 2], x_camera[..., 1] / x_camera[..., 2]
        k1, k2, p1, p2, k3 = camera.distortion if camera.distortion.size else np.zeros(5)
        r2 = x * x + y * y
        radial = 1.0 + k1 * r2 + k2 * r2**2 + k3 * r2**3
        u = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
        v = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
        k = camera.matrix
        projected = np.stack([k[0, 0] * u + k[0, 2], k[1, 1] * v + k[1, 2]], -1)
        found.append(np.linalg.norm(projected - view.uv, axis=-1).ravel())
    lengths = np.concatenate(found)
    known: NDArray[np.float64] = lengths[np.isfinite(lengths)]
    return known
