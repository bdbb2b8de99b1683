# SPDX-License-Identifier: Apache-2.0
"""Recordings of which a report has something to say: good, and bad in one way each."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from rpgd_ros.apps import calibrate_bag
from rpgd_ros.core import RigidTransform
from rpgd_ros.io.rig import read_rig, write_rig
from rpgd_ros.simulation import Corruption, Faults, SimulatedRecording, build_scene, preset
from rpgd_ros.simulation import simulate as film
from rpgd_ros.simulation.export import write_recording
from rpgd_ros.simulation.motion import MotionName

SECONDS, SEED = 10.0, 3


class Made(NamedTuple):
    """A run with its page.

    Attributes:
        code: Exit code.
        page: Where the page is.
        outcome: What `--json` printed.

    """

    code: int
    page: Path
    outcome: Mapping[str, Any]


def studio(motion: MotionName = 'walk', faults: Faults | None = None) -> SimulatedRecording:
    """Film somebody before four cameras; the person is the same in all of them."""
    return film(build_scene(preset('studio'), SEED, seconds=SECONDS, motion=motion, faults=faults))


def good(folder: Path) -> None:
    """A walk."""
    write_recording(studio(), folder)


def still(folder: Path) -> None:
    """Somebody who stands."""
    write_recording(studio('still'), folder)


def bumped(folder: Path) -> None:
    """A camera that hangs elsewhere than the rig file says: 0.5 deg and 10 mm."""
    write_recording(studio(), folder)
    rig = read_rig(folder / 'rig.yaml')
    cameras = list(rig.cameras)
    half = np.radians(0.5) / 2
    moved = RigidTransform.from_quat_xyzw([0.01, 0, 0], [0, np.sin(half), 0, np.cos(half)])
    third = cameras[2]
    assert third.camera is not None
    assert third.extrinsics is not None
    pose = moved @ third.extrinsics
    camera = replace(third.camera, camera_T_world=pose)
    cameras[2] = replace(third, camera=camera, extrinsics=pose)
    write_rig(folder / 'rig.yaml', replace(rig, cameras=tuple(cameras)))


def one_wrong_person(folder: Path) -> None:
    """One camera whose detector follows somebody else."""
    recording = studio()
    other = studio(faults=Faults(Corruption(0.97, 'person')))
    streams = list(recording.streams)
    streams[1] = other.streams[1]
    write_recording(replace(recording, streams=tuple(streams)), folder)


def wrong_person(folder: Path) -> None:
    """All detectors follow somebody else."""
    write_recording(studio(faults=Faults(Corruption(0.97, 'person'))), folder)


def swapped(folder: Path) -> None:
    """All detectors take left for right: of a body without a midline, its own mirror."""
    write_recording(studio(faults=Faults(Corruption(1.0, 'swap'))), folder)


BAD: Mapping[str, Callable[[Path], None]] = {
    make.__name__: make for make in (still, bumped, one_wrong_person, wrong_person, swapped)
}


def run_on(folder: Path, capture: Callable[[], str]) -> Made:
    """Calibrate from a recording, with a page.

    Args:
        folder: Bag and rig file.
        capture: Returns what was printed since it was asked last.

    """
    page = folder / 'report.html'
    capture()
    words = [folder / 'bag', '--rig', folder / 'rig.yaml', '--report', page, '--json']
    code = calibrate_bag.main([str(word) for word in words])
    return Made(code, page, json.loads(capture()))
