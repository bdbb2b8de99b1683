# SPDX-License-Identifier: Apache-2.0
"""Twins of published datasets: the sequences that are written in their layouts."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from rpgd_ros.core.camera import Camera
from rpgd_ros.core.geometry import Array
from rpgd_ros.simulation.faults import Faults
from rpgd_ros.simulation.motion import MotionName
from rpgd_ros.simulation.presets import Preset
from rpgd_ros.simulation.scene import build_scene, simulate


@dataclass(frozen=True, slots=True)
class TwinPlan:
    """What a tree of simulated sequences holds.

    Attributes:
        preset: Of the dataset; MoCap and cameras are synchronous and name the same joints.
        sequences: How many.
        seconds: Length of each.
        seed: Of everything random.
        motion: What the person does.
        faults: What goes wrong.

    """

    preset: Preset
    sequences: int
    seconds: float
    seed: int
    motion: MotionName
    faults: Faults


@dataclass(frozen=True, slots=True, eq=False)
class TwinSequence:
    """One simulated sequence.

    Attributes:
        cameras: The rig.
        x_world: (T, J, 3) metres, world frame.
        uv: (V, T, J, 2) pixels; NaN = not reported.
        confidence: (V, T, J) scores; 0 = not reported.

    """

    cameras: tuple[Camera, ...]
    x_world: Array
    uv: Array
    confidence: Array


def rig_of(plan: TwinPlan, number: int) -> tuple[Camera, ...]:
    """Return the rig of that number: datasets film many sequences with one."""
    scene = build_scene(plan.preset, plan.seed + number, seconds=plan.seconds)
    return scene.cameras


def sequences_of(
    plan: TwinPlan,
    rig: Callable[[int], tuple[Camera, ...]],
    progress: Callable[[str, float], None] | None = None,
) -> Iterator[TwinSequence]:
    """Simulate the sequences, one after the other.

    Args:
        plan: What to simulate.
        rig: Which cameras film the k-th sequence.
        progress: Called with a stage and the fraction of it that is done.

    """
    for k in range(plan.sequences):
        scene = build_scene(
            plan.preset, plan.seed + k, seconds=plan.seconds, motion=plan.motion,
            faults=plan.faults,
        )  # fmt: skip
        recording = simulate(replace(scene, cameras=rig(k)))
        yield TwinSequence(
            recording.cameras,
            recording.truth.world_T_mocap @ recording.mocap.x_mocap,
            np.stack([stream.uv for stream in recording.streams]),
            np.stack([stream.confidence for stream in recording.streams]),
        )
        if progress:
            progress('filming', (k + 1) / plan.sequences)
