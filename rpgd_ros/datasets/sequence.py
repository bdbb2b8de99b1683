# SPDX-License-Identifier: Apache-2.0
"""One sequence of a published dataset, as the solver takes it."""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from rpgd_ros.core.camera import Camera
from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import (
    Array,
    RigidTransform,
    nearest_rotation,
    rotation_from_quat_xyzw,
)
from rpgd_ros.core.observations import Observations

ORIGIN_M = 2.0  # the drawn MoCap origin lies within this of the dataset's, per axis
MAX_SKEW = 1e-4  # of a rotation in a file of five or more digits; beyond it is damage
MAX_SHOWN = 80  # characters of a foreign string in a message


@dataclass(frozen=True, slots=True, eq=False)
class DatasetSequence:
    """A recording with the pose that its dataset gives.

    Attributes:
        name: Of the sequence, unique in the dataset.
        cameras: With their extrinsics.
        observations: Skeletons in the MoCap frame, metres, and keypoints.
        world_T_mocap: The dataset's own pose.

    """

    name: str
    cameras: tuple[Camera, ...]
    observations: Observations
    world_T_mocap: RigidTransform


class Dataset(Protocol):
    """A folder in the layout of a published dataset.

    Attributes:
        names: Of its sequences, in reading order; nothing but their names has been read.

    """

    @property
    def names(self) -> tuple[str, ...]:
        """See above."""

    def read(self, name: str) -> DatasetSequence:
        """Read one sequence; nothing of it is kept.

        Raises:
            InputError: Its files cannot be used as they are; the message begins with the path.

        """

    def files(self, name: str) -> tuple[Path, ...]:
        """Return the files that one sequence is read from."""

    def objection(self, sequence: DatasetSequence) -> str:
        """Say why the publication left a sequence out; '' where it did not, or nobody asks."""


def refusal(path: Path, message: str) -> InputError:
    """Return the error of a file that cannot be used as it is."""
    return InputError(Reason.BAD_INPUT, f'{path}: {message}')


def shown(text: object) -> str:
    """Return a foreign string as it may stand in a message."""
    return repr(text)[:MAX_SHOWN]


def sequence_names(folder: Path, names: Iterable[str]) -> tuple[str, ...]:
    """Return names that files or folders of a dataset have, and that can be printed.

    Raises:
        InputError: One cannot: no table or message could name it.

    """
    found = tuple(names)
    for name in found:
        if not name.isprintable():
            raise refusal(folder, f'{shown(name)} is no name of a sequence: rename it')
    return found


def check_name(name: str, names: tuple[str, ...]) -> None:
    """Refuse a sequence that a dataset does not have."""
    if name not in names:
        msg = f'no sequence {shown(name)}: the dataset has {len(names)}'
        raise InputError(Reason.BAD_INPUT, msg)


def drawn_pose(name: str) -> RigidTransform:
    """Draw the world_T_mocap of a sequence whose skeletons are given in the world frame.

    A solver that starts at the identity would find the identity: each sequence is first moved by
    a transform that only its name decides.
    """
    rng = np.random.default_rng(zlib.crc32(name.encode()))
    rotation = rotation_from_quat_xyzw(rng.standard_normal(4))
    return RigidTransform(rotation, rng.uniform(-ORIGIN_M, ORIGIN_M, 3))


def sequence_from_world(
    name: str,
    cameras: tuple[Camera, ...],
    x_world: Array,
    uv: Array,
    *,
    joint_names: tuple[str, ...],
    confidence: Array | None = None,
    fps: float | None = None,
    stamps: Array | None = None,
) -> DatasetSequence:
    """Build a sequence whose MoCap frame is drawn by its name.

    Args:
        name: Of the sequence.
        cameras: V of them.
        x_world: (T, J, 3) metres, world frame; NaN = missing.
        uv: (V, T, J, 2) pixels; NaN = missing.
        joint_names: (J,) for reports.
        confidence: (V, T, J) detector scores.
        fps: Frames per second, or
        stamps: (T,) seconds.

    """
    world_T_mocap = drawn_pose(name)
    x_mocap = world_T_mocap.inverse() @ x_world
    observations = Observations.from_arrays(
        x_mocap, uv, confidence=confidence, fps=fps, stamps=stamps, joint_names=joint_names
    )
    return DatasetSequence(name, cameras, observations, world_T_mocap)


def camera_from_file(
    path: Path,
    name: str,
    *,
    matrix: Array,
    distortion: Array,
    size: tuple[int, int],
    rotation: Array,
    translation: Array,
) -> Camera:
    """Build a camera from what a file says.

    Args:
        path: The file, for messages.
        name: Of the camera.
        matrix: (3, 3) pixels.
        distortion: OpenCV's order.
        size: Width and height, pixels.
        rotation: (3, 3) world to camera, of as many digits as the file has.
        translation: (3,) of the world's origin in the camera frame, metres.

    Raises:
        InputError: No such camera is possible.

    """
    if not name.isprintable():
        raise refusal(path, f'{shown(name)} is no name of a camera')
    with np.errstate(all='ignore'):  # of numbers that are refused
        error = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if not error < MAX_SKEW:  # True for NaN
        raise refusal(path, f'camera {shown(name)}: the rotation is none (off by {error:.2g})')
    try:
        return Camera(
            name=name,
            matrix=matrix,
            distortion=distortion,
            size=size,
            camera_T_world=RigidTransform(nearest_rotation(rotation), translation),
        )
    except ValueError as reason:
        raise refusal(path, f'camera {shown(name)}: {reason}') from reason
