# SPDX-License-Identifier: Apache-2.0
"""The options of import_recording, put together: which camera has which file, rate and start."""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rpgd_ros.core.camera import Camera
from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.importing import MAX_FPS, MIN_FPS, camera_paths, keypoint_joints
from rpgd_ros.io.camera_files import read_cameras
from rpgd_ros.io.rig_types import Units
from rpgd_ros.skeletons import hint

MAX_START_S = 2.0**31  # dates of Unix, up to 2038


@dataclass(frozen=True, eq=False)
class Inputs:
    """What is to be read, and how.

    Attributes:
        arguments: Of the command line.
        cameras: All that the calibration holds.
        formats: Of the calibration files.
        paths: Keypoints by camera.
        fps: Rate by camera.
        start_s: Start by camera, where one was given.
        first_frame: Number of the first frame by camera, where one was given.
        timecodes: Of the first frame by camera, where one was given.
        joints: Names of the keypoints; None = as the files state.
        joint_map: MoCap joint by keypoint.

    """

    arguments: argparse.Namespace
    cameras: tuple[Camera, ...]
    formats: tuple[str, ...]
    paths: Mapping[str, Path]
    fps: Mapping[str, float]
    start_s: Mapping[str, float]
    first_frame: Mapping[str, int]
    timecodes: Mapping[str, str]
    joints: tuple[str, ...] | None
    joint_map: Mapping[str, str | None]

    @property
    def with_keypoints(self) -> list[Camera]:
        """The cameras that have keypoints."""
        return [camera for camera in self.cameras if camera.name in self.paths]

    @property
    def without_keypoints(self) -> list[str]:
        """Names of the cameras that have none."""
        return [camera.name for camera in self.cameras if camera.name not in self.paths]


def parse_inputs(arguments: argparse.Namespace) -> Inputs:
    """Read the calibration and find everything else.

    Raises:
        InputError: A camera that there is not, a number that is none, files without a camera.

    """
    cameras, formats = _cameras(arguments.cameras, arguments.camera_units)
    names = [camera.name for camera in cameras]
    paths = _paths(arguments.keypoints, names)
    fps = _numbers(arguments.camera_fps, '--camera-fps', [*paths], (MIN_FPS, MAX_FPS))
    start_s = _numbers(
        arguments.camera_start, '--camera-start', [*paths], (-MAX_START_S, MAX_START_S)
    )
    without = [name for name in paths if name not in fps]
    if without:
        msg = f'camera {without[0]} has no frame rate: give --camera-fps {without[0]}=HZ'
        raise InputError(Reason.BAD_INPUT, msg)
    if arguments.mocap_fps is not None and not MIN_FPS <= arguments.mocap_fps <= MAX_FPS:
        msg = f'--mocap-fps must be {MIN_FPS:g} to {MAX_FPS:g}, got {arguments.mocap_fps:g}'
        raise InputError(Reason.BAD_INPUT, msg)
    joints = keypoint_joints(arguments.keypoint_joints) if arguments.keypoint_joints else None
    timecodes = _by_camera(arguments.camera_timecode, '--camera-timecode', [*paths])
    return Inputs(
        arguments,
        cameras,
        formats,
        paths,
        fps,
        start_s,
        _first_frames(arguments.first_frame, [*paths]),
        timecodes,
        joints,
        _joint_map(arguments.joint_map),
    )


def _cameras(
    files: Sequence[Path], units: Units | None
) -> tuple[tuple[Camera, ...], tuple[str, ...]]:
    found = [read_cameras(path, units) for path in files]
    cameras = tuple(camera for file in found for camera in file.cameras)
    for i, camera in enumerate(cameras):
        if camera.name in {c.name for c in cameras[:i]}:
            msg = f'camera {camera.name} comes twice among the calibration files: rename one'
            raise InputError(Reason.BAD_INPUT, msg)
    return cameras, tuple(dict.fromkeys(file.format for file in found))


def _paths(texts: Sequence[str], names: Sequence[str]) -> dict[str, Path]:
    """Return the keypoints of each camera, from NAME=PATH or from one folder of all."""
    pairs = [_split(text) for text in texts]
    named = [(name, Path(path)) for name, path in pairs if name]
    bare = [Path(path) for name, path in pairs if not name]
    if named and not bare:
        found: dict[str, Path] = {}
        for name, path in named:
            _check_name(name, names, '--keypoints')
            if name in found:
                msg = f'--keypoints gives camera {name} twice'
                raise InputError(Reason.BAD_INPUT, msg)
            found[name] = path
        return {name: found[name] for name in names if name in found}
    if named or len(bare) != 1:
        msg = '--keypoints needs either one folder with all cameras, or CAMERA=PATH for each'
        raise InputError(Reason.BAD_INPUT, msg)
    root = bare[0]
    if len(names) == 1 and (not root.is_dir() or any(root.glob('*.json'))):
        return {names[0]: root}
    return camera_paths(root, names)


def _split(text: str) -> tuple[str, str]:
    """Return name and value of NAME=VALUE, '' and the text without a name."""
    name, equals, value = text.partition('=')
    return (name, value) if equals and '/' not in name else ('', text)


def _check_name(name: str, names: Sequence[str], option: str) -> None:
    if name not in names:
        msg = f'{option}: no camera {name[:80]!r} in the calibration, {hint(name, names)}'
        raise InputError(Reason.UNKNOWN_CAMERA, msg)


def _numbers(
    texts: Sequence[str], option: str, names: Sequence[str], bounds: tuple[float, float]
) -> dict[str, float]:
    """Return a number by camera: one for all, or CAMERA=NUMBER."""
    found: dict[str, float] = {}
    for name, value in _by_camera(texts, option, names).items():
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if not bounds[0] <= number <= bounds[1]:
            msg = (
                f'{option} needs a number from {bounds[0]:g} to {bounds[1]:g}, got {value[:80]!r}'
            )
            raise InputError(Reason.BAD_INPUT, msg)
        found[name] = number
    return found


def _first_frames(texts: Sequence[str], names: Sequence[str]) -> dict[str, int]:
    """Return 0 or 1 by camera."""
    found = _by_camera(texts, '--first-frame', names)
    for value in found.values():
        if value not in {'0', '1'}:
            msg = f'--first-frame needs 0 or 1, got {value[:80]!r}'
            raise InputError(Reason.BAD_INPUT, msg)
    return {name: int(value) for name, value in found.items()}


def _by_camera(texts: Sequence[str], option: str, names: Sequence[str]) -> dict[str, str]:
    """Return a value by camera: one for all, or CAMERA=VALUE."""
    found: dict[str, str] = {}
    for text in texts:
        name, value = _split(text)
        if name:
            _check_name(name, names, option)
        found |= {name: value} if name else {n: value for n in names if n not in found}
    return found


def _joint_map(texts: Sequence[str]) -> dict[str, str | None]:
    found: dict[str, str | None] = {}
    for text in texts:
        keypoint, equals, joint = text.partition('=')
        if not keypoint or not equals or not joint:
            msg = f'--joint-map needs KEYPOINT=JOINT, or KEYPOINT=none, got {text[:80]!r}'
            raise InputError(Reason.BAD_INPUT, msg)
        found[keypoint] = None if joint == 'none' else joint
    return found
