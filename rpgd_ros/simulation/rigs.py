# SPDX-License-Identifier: Apache-2.0
"""Camera rigs: where cameras hang, what lenses they have, and how far both scatter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from rpgd_ros.core.camera import Camera
from rpgd_ros.core.geometry import RigidTransform
from rpgd_ros.core.lens import Model

Position = tuple[float, float, float]

ROLL_RAD = 0.02  # cameras are levelled by eye: about 1 deg
FOCAL_SCATTER = 0.01  # two lenses of one type differ by 1 %
CENTRE_SCATTER = 0.008  # of the image size: sensors sit a few pixels off the optical axis
DISTORTION_SCATTER = 0.15


@dataclass(frozen=True, slots=True)
class RigPlan:
    """A rig before anybody screwed it to the wall.

    Attributes:
        mounts: Camera positions, metres, world frame (z up, floor at 0).
        size: Width and height of the images, pixels.
        focal_px: Nominal focal length, pixels.
        distortion: Nominal coefficients, OpenCV order; empty = none.
        target: Where the cameras look, metres, world frame.
        mount_scatter_m: Standard deviation of the positions, metres per axis.
        model: Lens model.

    """

    mounts: tuple[Position, ...]
    size: tuple[int, int]
    focal_px: float
    distortion: tuple[float, ...] = ()
    target: Position = (0.0, 0.0, 1.0)
    mount_scatter_m: float = 0.08
    model: Model = 'pinhole'


def ring(
    count: int, *, radius: float, height: float, start_deg: float = 0.0
) -> tuple[Position, ...]:
    """Return positions evenly spread on a circle about the room's middle, metres."""
    angles = np.radians(start_deg) + 2.0 * np.pi * np.arange(count) / count
    return tuple((float(radius * np.cos(a)), float(radius * np.sin(a)), height) for a in angles)


def look_at(position: ArrayLike, target: ArrayLike, *, roll: float = 0.0) -> RigidTransform:
    """Return camera_T_world of a camera that looks at a target with the horizon level.

    Args:
        position: (3,) of the camera, metres, world frame.
        target: (3,) metres, world frame.
        roll: About the optical axis, radians, after levelling.

    Raises:
        ValueError: The camera sits in its target.

    """
    at = np.asarray(position, dtype=np.float64)
    forward = np.asarray(target, dtype=np.float64) - at
    distance = float(np.linalg.norm(forward))
    if distance < 1e-6:
        msg = f'a camera at {at.tolist()} cannot look at itself'
        raise ValueError(msg)
    z = forward / distance
    # Straight down (or up) no horizon is left: the image's top then points along world y.
    up = np.array([0.0, 0.0, 1.0]) if abs(z[2]) < 0.999 else np.array([0.0, 1.0, 0.0])
    x = np.cross(z, up)
    x /= np.linalg.norm(x)
    c, s = np.cos(roll), np.sin(roll)
    level = np.stack([x, np.cross(z, x), z])
    rotation = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ level
    return RigidTransform(rotation, -rotation @ at)


def build_rig(plan: RigPlan, rng: np.random.Generator) -> tuple[Camera, ...]:
    """Mount the cameras of a plan, each a little off; names cam0, cam1, ..."""
    cameras = []
    width, height = plan.size
    for number, mount in enumerate(plan.mounts):
        position = np.array(mount) + rng.normal(0.0, plan.mount_scatter_m, 3)
        fx, fy = plan.focal_px * rng.uniform(1.0 - FOCAL_SCATTER, 1.0 + FOCAL_SCATTER, 2)
        centre = np.array([0.5 * (width - 1), 0.5 * (height - 1)])
        cx, cy = centre + rng.normal(0.0, CENTRE_SCATTER, 2) * plan.size
        scatter = rng.uniform(
            1.0 - DISTORTION_SCATTER, 1.0 + DISTORTION_SCATTER, len(plan.distortion)
        )
        cameras.append(
            Camera(
                name=f'cam{number}',
                matrix=np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]),
                distortion=np.array(plan.distortion) * scatter,
                size=plan.size,
                camera_T_world=look_at(
                    position, plan.target, roll=float(rng.normal(0.0, ROLL_RAD))
                ),
                model=plan.model,
            )
        )
    return tuple(cameras)
