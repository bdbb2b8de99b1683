# SPDX-License-Identifier: Apache-2.0
"""A rig and what its topics carry while somebody walks, for the tests of the session."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rpgd_ros.core import (
    Calibration,
    Camera,
    RigidTransform,
)
from rpgd_ros.core.geometry import Array, rotation_angle, so3_exp
from rpgd_ros.io.rig import MocapSource, Rig, RigCamera
from rpgd_ros.messages import (
    POINT_CLOUD2,
    encode_point_cloud2,
)
from rpgd_ros.session import MOCAP, Session, Snapshot
from rpgd_ros.skeletons import CONVENTIONS, match_joints

S = 1_000_000_000
START = 1_700_000_000 * S
SECONDS = 12
MOCAP_PERIOD = S // 120
CAMERA_PERIOD = S // 30
SIZE = (1280, 720)
MATRIX = np.array([[900.0, 0, 640.0], [0, 900.0, 360.0], [0, 0, 1.0]])
JOINTS = CONVENTIONS['plug_in_gait']
KEYPOINTS = CONVENTIONS['coco17']
PAIRS = match_joints(JOINTS, KEYPOINTS)
WORLD_T_MOCAP = RigidTransform(so3_exp([0.2, -0.4, 1.1]), np.array([0.5, -1.0, 0.3]))

Message = tuple[str, bytes, int]  # stream, payload, receive stamp


def camera_pose(angle: float) -> RigidTransform:
    """Return camera_T_world of a camera 5 m from the middle that looks at it; z is up."""
    x_axis = np.array([-np.sin(angle), np.cos(angle), 0.0])
    z_axis = -np.array([np.cos(angle), np.sin(angle), 0.0])
    rotation = np.stack([x_axis, np.cross(z_axis, x_axis), z_axis])
    return RigidTransform(rotation, -rotation @ (np.array([0.0, 0.0, 1.0]) - 5.0 * z_axis))


def body_at(stamps: Sequence[int]) -> Array:
    """Return a walking body (F, 12, 3) in the world: it crosses the room, turns, swings limbs."""
    t = (np.asarray(stamps)[:, None] - START) / S
    rest = np.random.default_rng(5).uniform([-0.4, -0.3, 0.1], [0.4, 0.3, 1.7], (12, 3))
    swing = 0.15 * np.sin(2.0 * t + np.arange(12))
    x, y = rest[:, 0] + swing, rest[:, 1]
    turn = 0.4 * t
    return np.stack(
        [
            x * np.cos(turn) - y * np.sin(turn) + 1.5 * np.sin(0.5 * t),
            x * np.sin(turn) + y * np.cos(turn) + 1.2 * np.cos(0.7 * t),
            np.broadcast_to(rest[:, 2], x.shape),
        ],
        -1,
    )


@dataclass(frozen=True)
class Studio:
    """A rig, and what its topics carry."""

    rig: Rig
    messages: tuple[Message, ...]

    def of(self, stream: str) -> list[Message]:
        """Return the messages of one stream."""
        return [m for m in self.messages if m[0] == stream]


def make_rig(n_cameras: int = 2) -> Rig:
    """Return cameras around the room, with everything known."""
    cameras = []
    for v in range(n_cameras):
        pose = camera_pose(0.3 + 1.9 * v)
        name = f'cam{v}'
        camera = Camera(name, MATRIX, np.zeros(0), SIZE, pose)
        cameras.append(
            RigCamera(name, f'{name}/kp', KEYPOINTS, PAIRS, camera=camera, extrinsics=pose)
        )
    return Rig('studio', MocapSource('mocap/skeleton', JOINTS), tuple(cameras))


def make_studio(n_cameras: int = 2, *, scale: float = 1.0, late_ns: int = 0) -> Studio:
    """Walk through the room.

    Args:
        n_cameras: Of the rig.
        scale: Units per metre of the skeleton.
        late_ns: How late the video is stamped.

    """
    rig = make_rig(n_cameras)
    messages: list[Message] = []
    mocap_ns = [START + i * MOCAP_PERIOD for i in range(SECONDS * 120)]
    x_mocap = WORLD_T_MOCAP.inverse() @ body_at(mocap_ns)
    for stamp, x in zip(mocap_ns, x_mocap, strict=True):
        messages.append((MOCAP, encode_point_cloud2(stamp, 'vicon', x * scale, None), stamp + 7))
    rng = np.random.default_rng(1)
    for v, camera in enumerate(rig.cameras):
        camera_ns = [START + v * 1_234_567 + i * CAMERA_PERIOD for i in range(SECONDS * 30)]
        assert camera.camera is not None
        seen = camera.camera.project(body_at(camera_ns)) + rng.normal(0, 0.5, (1, 12, 2))
        uv = np.full((len(camera_ns), 17, 2), np.nan)
        for j, k in PAIRS:
            uv[:, k] = seen[:, j]
        scores = np.linspace(0.1, 1.0, 17)
        for stamp, pixels in zip(camera_ns, uv, strict=True):
            payload = encode_point_cloud2(stamp + late_ns, camera.name, pixels, scores)
            messages.append((camera.name, payload, stamp + 9))
    messages.sort(key=lambda m: m[2])
    return Studio(rig, tuple(messages))


def feed(session: Session, messages: Sequence[Message], *, together: int = 1) -> Session:
    """Hand messages to a session, in runs of one stream of at most so many."""
    for i in range(0, len(messages), together):
        by_stream: dict[str, list[Message]] = {}
        for m in messages[i : i + together]:
            by_stream.setdefault(m[0], []).append(m)
        for stream, part in by_stream.items():
            session.add(stream, POINT_CLOUD2, [m[1] for m in part], [m[2] for m in part])
    return session


def bits(taken: Snapshot) -> tuple[bytes, ...]:
    """Return all numbers of a snapshot's observations."""
    observations = taken.observations
    assert observations.mocap is not None
    arrays: list[NDArray[Any] | None] = [observations.mocap.x_mocap]
    for view in observations.views:
        arrays += [view.stamp_ns, view.x_mocap, view.uv, view.confidence]
    return tuple(a.tobytes() for a in arrays if a is not None)


def with_camera(rig: Rig, index: int, **changes: object) -> Rig:
    """Return a rig with one camera changed."""
    cameras = list(rig.cameras)
    cameras[index] = replace(cameras[index], **changes)  # type: ignore[arg-type]
    return replace(rig, cameras=tuple(cameras))


def without_poses(rig: Rig) -> Rig:
    """Return a rig whose cameras have no extrinsics."""
    cameras = []
    for c in rig.cameras:
        assert c.camera is not None
        blind = replace(c.camera, camera_T_world=None)
        cameras.append(replace(c, camera=blind, extrinsics=None))
    return replace(rig, cameras=tuple(cameras))


def errors(calibration: Calibration) -> tuple[float, float]:
    """Return the rotation error in degrees and the position error in the room in metres."""
    delta = calibration.world_T_mocap @ WORLD_T_MOCAP.inverse()
    return np.degrees(rotation_angle(delta.rotation)), float(
        np.linalg.norm(delta @ np.array([0.0, 0.0, 1.0]) - [0.0, 0.0, 1.0])
    )
