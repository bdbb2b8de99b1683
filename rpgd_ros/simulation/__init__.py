# SPDX-License-Identifier: Apache-2.0
"""Scenes with known truth: a rig, a walking body, a detector with its faults."""

from rpgd_ros.simulation.detector import Corruption
from rpgd_ros.simulation.faults import Faults
from rpgd_ros.simulation.presets import PRESETS, Preset, preset
from rpgd_ros.simulation.recording import SimulatedRecording, Truth
from rpgd_ros.simulation.scene import Scene, build_scene, simulate
from rpgd_ros.simulation.twin import Twin, twin

__all__ = [
    'PRESETS',
    'Corruption',
    'Faults',
    'Preset',
    'Scene',
    'SimulatedRecording',
    'Truth',
    'Twin',
    'build_scene',
    'preset',
    'simulate',
    'twin',
]
