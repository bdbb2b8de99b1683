# SPDX-License-Identifier: Apache-2.0
"""A shoot with known truth, and what is done with its files."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from camera_files import toml_text
from shoot_files import MOCAP_FPS, write_coco, write_trc

from rpgd_ros.apps import calibrate_bag, import_recording
from rpgd_ros.core import Camera, RigidTransform
from rpgd_ros.core.geometry import Array, rotation_angle
from rpgd_ros.io.result_file import read_result
from rpgd_ros.simulation import build_scene, preset, simulate
from rpgd_ros.skeletons import joint_names, match_joints

CAMERA_FPS = 50.0
SIGMA_PX = 0.7
MAX_ERROR_DEG, MAX_ERROR_M = 0.3, 0.012  # 8 s of two cameras: 0.05 deg and 2 mm


@dataclass(frozen=True, eq=False)
class Shoot:
    """What MoCap and cameras saw of one walk.

    Attributes:
        cameras: Calibrated.
        joints: (J,) of the MoCap.
        x_mocap: (T, J, 3) metres, at `MOCAP_FPS`.
        keypoints: (K,) of the detector.
        uv: (V, F, K, 2) pixels at `CAMERA_FPS`; NaN = not seen.
        world_T_mocap: What is to be found.

    """

    cameras: tuple[Camera, ...]
    joints: tuple[str, ...]
    x_mocap: Array
    keypoints: tuple[str, ...]
    uv: Array
    world_T_mocap: RigidTransform


@cache
def make_shoot(
    preset_name: str = 'studio', keypoints: str = 'coco17', seconds: float = 8.0
) -> Shoot:
    """Simulate a walk and resample it to the rates of the files."""
    recording = simulate(build_scene(preset(preset_name), 0, seconds=seconds))
    track = recording.mocap
    source_s = (track.stamp_ns - track.stamp_ns[0]) * 1e-9
    joints = joint_names(recording.preset.mocap_joints)
    names = joint_names(keypoints)
    pairs = match_joints(joints, names)
    x_mocap = _at(source_s, track.x_mocap, np.arange(int(seconds * MOCAP_FPS)) / MOCAP_FPS)
    seen = _at(source_s, track.x_mocap, np.arange(int(seconds * CAMERA_FPS)) / CAMERA_FPS)
    rng = np.random.default_rng(3)
    cameras = recording.cameras[:2]
    uv = np.full((len(cameras), len(seen), len(names), 2), np.nan)
    for camera, pixels in zip(cameras, uv, strict=True):
        exact = camera.project(recording.truth.world_T_mocap @ seen)
        noisy = exact + rng.normal(0.0, SIGMA_PX, exact.shape)
        for j, k in pairs:
            pixels[:, k] = noisy[:, j]
    return Shoot(cameras, joints, x_mocap, names, uv, recording.truth.world_T_mocap)


def _at(source_s: Array, values: Array, time_s: Array) -> Array:
    flat = values.reshape(len(values), -1)
    columns = [np.interp(time_s, source_s, column) for column in flat.T]
    return np.stack(columns, 1).reshape(len(time_s), *values.shape[1:])


def run_import(*words: object) -> int:
    """Run import_recording."""
    return import_recording.main([str(word) for word in words])


def assert_finds(output: Path, world_T_mocap: RigidTransform, x_mocap: Array) -> None:
    """Calibrate an imported recording, and compare with the truth at the body."""
    result = output.parent / 'result.yaml'
    words = [str(output / 'bag'), '--rig', str(output / 'rig.yaml'), '--output', str(result)]
    assert calibrate_bag.main(words) == 0
    found = read_result(result).world_T_mocap
    error = rotation_angle(found.rotation @ world_T_mocap.rotation.T)
    assert np.degrees(error) < MAX_ERROR_DEG
    centre = np.nanmean(x_mocap, axis=(0, 1))
    assert np.linalg.norm(found @ centre - world_T_mocap @ centre) < MAX_ERROR_M


def write_shoot(folder: Path, shoot: Shoot) -> None:
    """Write a shoot as TRC, Pose2Sim TOML and one COCO file per camera."""
    write_trc(folder / 'walk.trc', shoot.joints, shoot.x_mocap)
    (folder / 'Calib.toml').write_text(toml_text(shoot.cameras))
    (folder / 'pose').mkdir()
    for camera, uv in zip(shoot.cameras, shoot.uv, strict=True):
        write_coco(folder / 'pose' / f'{camera.name}.json', uv)


def words_of(folder: Path, **changes: object) -> list[object]:
    """Return a complete command line, with some of its options changed; None leaves one out."""
    options: dict[str, object] = {
        'skeleton': folder / 'walk.trc',
        'keypoints': folder / 'pose',
        'cameras': folder / 'Calib.toml',
        'camera_fps': 50,
        'keypoint_joints': 'coco17',
        'output': folder / 'out',
    }
    words: list[object] = []
    for key, value in (options | changes).items():
        if value is not None:
            values = value if isinstance(value, list) else [value]
            words += [f'--{key.replace("_", "-")}', *([] if value is True else values)]
    return words
