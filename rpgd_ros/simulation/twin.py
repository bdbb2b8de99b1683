# SPDX-License-Identifier: Apache-2.0
"""Twins of published datasets as arrays, for tests and benchmarks."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from rpgd_ros.core.camera import Camera
from rpgd_ros.core.observations import Observations
from rpgd_ros.simulation.detector import Corruption
from rpgd_ros.simulation.faults import BiasFrame, Faults
from rpgd_ros.simulation.motion import MotionName
from rpgd_ros.simulation.presets import OutlierKind, preset
from rpgd_ros.simulation.recording import Truth
from rpgd_ros.simulation.scene import build_scene, simulate


class Twin(NamedTuple):
    """A calibration case with its answer.

    Attributes:
        cameras: The rig.
        observations: What a solver is given.
        truth: What it has to find; masks have the columns of the observations.

    """

    cameras: tuple[Camera, ...]
    observations: Observations
    truth: Truth


def twin(
    shape: str,
    frames: int,
    seed: int,
    *,
    outlier_ratio: float = 0.0,
    kind: OutlierKind = 'uniform',
    lag_s: float | tuple[float, ...] = 0.0,
    bias_m: float = 0.0,
    bias_px: float = 0.0,
    bias_frame: BiasFrame = 'heading',
    motion: MotionName = 'walk',
    centre: tuple[float, float] = (0.0, 0.0),
) -> Twin:
    """Simulate a preset for a number of camera frames.

    Args:
        shape: Name of a preset: `human36m`, ...
        frames: Of each camera.
        seed: Of everything random; the same seed keeps rig, walk and noise whatever the faults.
        outlier_ratio: Share of the observations that become outliers beyond the preset's own.
        kind: Of those outliers.
        lag_s: How late the video is stamped, seconds; one for all cameras, or one each.
        bias_m: Standard deviation per axis of joint-definition offsets, metres.
        bias_px: Standard deviation per axis of a constant pixel offset of each joint.
        bias_frame: In which frame a joint keeps its offset.
        motion: What the person does.
        centre: Where on the floor, metres.

    Raises:
        InputError: Unknown names, values out of range.

    """
    settings = preset(shape)
    faults = Faults(Corruption(outlier_ratio, kind, bias_px), bias_m, bias_frame, lag_s)
    seconds = frames / settings.camera_hz
    scene = build_scene(
        settings, seed, seconds=seconds, motion=motion, centre=centre, faults=faults
    )
    recording = simulate(scene)
    pick = [k for _, k in recording.pairs]
    inliers = tuple(inlier[:, pick] for inlier in recording.truth.inliers)
    truth = replace(recording.truth, inliers=inliers)
    return Twin(recording.cameras, recording.observations(), truth)
