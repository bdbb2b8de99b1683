# SPDX-License-Identifier: Apache-2.0
"""Recorded motion before the cameras of recorded rigs, and the bound of what can be known."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from rpgd_ros.core import Camera, Observations, RigidTransform, View
from rpgd_ros.core.covariance import invert
from rpgd_ros.core.geometry import Array, BoolArray, nearest_rotation, so3_exp, so3_log
from rpgd_ros.core.linearise import Sight
from rpgd_ros.core.noise import SquaredLoss
from rpgd_ros.core.normal import normal_equations

DATA = Path(__file__).resolve().parents[2] / 'shared' / 'data'
RIGS = {'h36m': (4, (0.0, 0.0, 1.0)), 'mpi3dhp': (8, (0.0, 1.0, 0.0))}  # cameras, up
MISSED = 0.03  # share of keypoints that the detector does not send


class Case(NamedTuple):
    """What cameras saw of a person, and the truth.

    Attributes:
        cameras: With their extrinsics.
        observations: Stamped at 60 Hz.
        world_T_mocap: The truth.
        is_clean: (V, T, J) whether a keypoint carries noise only.
        noise_px: Of these, per axis.

    """

    cameras: tuple[Camera, ...]
    observations: Observations
    world_T_mocap: RigidTransform
    is_clean: BoolArray
    noise_px: float

    def pose(self, v: int) -> RigidTransform:
        """Return the true camera_T_mocap of a camera."""
        camera_T_world = self.cameras[v].camera_T_world
        assert camera_T_world is not None
        return camera_T_world @ self.world_T_mocap


def motions() -> list[str]:
    """Return the names of the recorded motions."""
    return sorted(path.stem for path in DATA.glob('motion_cmu_*.npz'))


def rig_cameras(rig: str, group: int) -> tuple[Camera, ...]:
    """Return the cameras of one room of a recorded rig."""
    file = np.load(DATA / f'rig_{rig}.npz')
    n, _ = RIGS[rig]
    return tuple(
        Camera(
            f'cam{i}', _without_skew(file['K'][v]), file['dist'][v],
            (int(file['image_size'][v][0]), int(file['image_size'][v][1])),
            RigidTransform(nearest_rotation(file['R_c'][v]), file['t_c'][v]),
        )
        for i, v in enumerate(range(group * n, (group + 1) * n))
    )  # fmt: skip


def make_case(
    rig: str, group: int, motion: str, seed: int, *, noise_px: float = 3.0, outliers: float = 0.3
) -> Case:
    """Put a recorded motion where the cameras of a recorded rig look, and let them see it.

    Args:
        rig: One of `RIGS`.
        group: Which room.
        motion: One of `motions`.
        seed: Of heading, place, MoCap frame and noise.
        noise_px: Gaussian, per axis.
        outliers: Share of keypoints that lie anywhere in the image.

    """
    rng = np.random.default_rng([seed, group, len(rig), *motion.encode()])
    cameras = rig_cameras(rig, group)
    file = np.load(DATA / f'{motion}.npz')
    x_world = _placed(file['joints3d'], cameras, np.array(RIGS[rig][1]), rng)
    truth = RigidTransform(so3_exp(rng.normal(0.0, 1.5, 3)), rng.uniform(-2.0, 2.0, 3))
    uv = np.stack([_seen(camera, x_world, rng) for camera in cameras])
    uv += rng.normal(0.0, noise_px, uv.shape)
    is_gross = rng.random(uv.shape[:3]) < outliers
    anywhere = rng.uniform(0.0, 1.0, uv.shape) * np.array([c.size for c in cameras])[:, None, None]
    is_there = np.isfinite(uv[..., 0])
    uv = np.where((is_gross & is_there)[..., None], anywhere, uv)
    observations = Observations.from_arrays(truth.inverse() @ x_world, uv, fps=float(file['fps']))
    return Case(cameras, observations, truth, is_there & ~is_gross, noise_px)


def bound(case: Case, v: int) -> Array:
    """Return the (6, 6) Cramer-Rao bound of camera_T_mocap, turned about the body's centroid."""
    view = case.observations.views[v]
    uv = np.where(case.is_clean[v][..., None], view.uv, np.nan)
    sight = Sight(_world_itself(case.cameras[v]), View(None, view.x_mocap, uv))
    pose = case.pose(v)
    normal = normal_equations([sight], pose, pose @ centroid(case), SquaredLoss())
    information = normal.information / case.noise_px**2
    return invert(information, information)


def centroid(case: Case) -> Array:
    """(3,) centre of the body, MoCap frame."""
    centre: Array = case.observations.views[0].x_mocap.reshape(-1, 3).mean(0)
    return centre


def step_from(found: RigidTransform, truth: RigidTransform, pivot_mocap: Array) -> Array:
    """(6,) what leads from a pose to the true one: rotation, and the pivot's displacement."""
    turn = so3_log(truth.rotation @ found.rotation.T)
    return np.concatenate([turn, truth @ pivot_mocap - found @ pivot_mocap])


def displacement_m(step: Array, covariance: Array, pose: RigidTransform, case: Case) -> Array:
    """Root mean square displacement of the body's points: by a step, and by a covariance."""
    x = case.observations.views[0].x_mocap.reshape(-1, 3)[::7]
    arm = (x - centroid(case)) @ pose.rotation.T
    second = arm.T @ arm / len(arm)
    spread = np.zeros((6, 6))
    spread[:3, :3] = np.trace(second) * np.eye(3) - second  # |w x arm|^2, on the mean
    spread[3:, 3:] = np.eye(3)
    mean = arm.mean(0)
    spread[:3, 3:] = [[0, -mean[2], mean[1]], [mean[2], 0, -mean[0]], [-mean[1], mean[0], 0]]
    spread[3:, :3] = spread[:3, 3:].T
    return np.sqrt([step @ spread @ step, np.trace(spread @ covariance)])


def _without_skew(matrix: Array) -> Array:
    out = np.eye(3)
    out[[0, 1], [0, 1]], out[:2, 2] = np.diag(matrix)[:2], matrix[:2, 2]
    return out


def _world_itself(camera: Camera) -> Camera:
    return Camera(camera.name, camera.matrix, camera.distortion, camera.size)


def _placed(x: Array, cameras: tuple[Camera, ...], up: Array, rng: np.random.Generator) -> Array:
    """Turn and move a motion (y up) to the point that the cameras look at, feet on the floor."""
    poses = [c.camera_T_world for c in cameras if c.camera_T_world is not None]
    axes = np.stack([pose.rotation[2] for pose in poses])
    centres = np.stack([pose.inverse().translation for pose in poses])
    across: Array = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    target = np.linalg.solve(across.sum(0), np.einsum('nij,nj->i', across, centres))
    side: Array = np.cross([0.3, 0.5, 0.7], up)
    side /= float(np.linalg.norm(side))
    world_R_motion = _frame(up, side)
    turned = x @ (so3_exp(rng.uniform(-np.pi, np.pi) * up) @ world_R_motion).T
    turned -= np.median(turned.mean(1), axis=0)
    moved: Array = turned + target + rng.normal(0.0, 0.3, 3) * (1.0 - up)
    return moved


def _frame(up: Array, side: Array) -> Array:
    """(3, 3) rotation that takes y to `up` and x to `side`."""
    return np.stack([side, up, np.cross(side, up)], 1)


def _seen(camera: Camera, x_world: Array, rng: np.random.Generator) -> Array:
    """(T, J, 2) exact pixels; NaN outside the image, too near, and where the detector misses."""
    uv = camera.project(x_world)
    assert camera.camera_T_world is not None
    is_seen = (camera.camera_T_world @ x_world)[..., 2] > 0.3
    with np.errstate(invalid='ignore'):
        is_seen &= ((uv > 0.0) & (uv < camera.size)).all(-1)
    is_seen &= rng.random(is_seen.shape) > MISSED
    return np.where(is_seen[..., None], uv, np.nan)
