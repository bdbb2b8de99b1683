# SPDX-License-Identifier: Apache-2.0
"""Other people in the room: detected like the subject, in any order, some with MoCap too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rpgd_ros.core.camera import Camera
from rpgd_ros.core.geometry import Array, IntArray, RigidTransform
from rpgd_ros.simulation.body import Body
from rpgd_ros.simulation.detector import Corruption, Shot, detect
from rpgd_ros.simulation.joints import landmarks_of
from rpgd_ros.simulation.presets import Preset
from rpgd_ros.skeletons import joint_names, mirror


@dataclass(frozen=True, slots=True, eq=False)
class Company:
    """What the sensors report of all persons but the first.

    Attributes:
        x_mocap: (M, S - 1, J, 3) skeletons of the other persons that have MoCap, metres.
        uv: Per camera (F, P - 1, J, 2) pixels; NaN = not reported.
        confidence: Per camera (F, P - 1, J) scores.
        order: Per camera (F, P) in which order the P persons, the subject being 0, are sent.
        skeleton_order: (M, S) in which order the skeletons are sent.

    """

    x_mocap: Array
    uv: tuple[Array, ...]
    confidence: tuple[Array, ...]
    order: tuple[IntArray, ...]
    skeleton_order: IntArray


def record_company(
    preset: Preset,
    cameras: Sequence[Camera],
    others: Sequence[Body],
    *,
    n_subjects: int,
    captures: Sequence[Array],
    mocap_t: Array,
    world_T_mocap: RigidTransform,
    rng: np.random.Generator,
) -> Company:
    """Film other people.

    Args:
        preset: Settings.
        cameras: The rig.
        others: Who is there beside the subject.
        n_subjects: Persons with MoCap, the subject included.
        captures: Per camera (F,) instants, seconds.
        mocap_t: (M,) instants of the MoCap, seconds.
        world_T_mocap: The truth.
        rng: Source of everything random.

    """
    landmarks = landmarks_of(preset.keypoint_joints)
    mirrored = np.array(mirror(joint_names(preset.keypoint_joints)))
    reports = []
    for body in others:
        shots = [
            Shot.of(camera, camera.project(body.at(t).place(landmarks)), None)
            for camera, t in zip(cameras, captures, strict=True)
        ]
        found, _ = detect(
            shots, preset.detector, Corruption(), mirror=mirrored, hz=preset.camera_hz, rng=rng
        )
        reports.append(found)
    by_camera = list(zip(*reports, strict=True))
    skeletons = [
        _skeleton(preset, body, mocap_t, world_T_mocap, rng) for body in others[: n_subjects - 1]
    ]
    n_joints = len(landmarks_of(preset.mocap_joints))
    return Company(
        x_mocap=np.stack(skeletons, 1) if skeletons else np.empty((len(mocap_t), 0, n_joints, 3)),
        uv=tuple(np.stack([d.uv for d in found], 1) for found in by_camera),
        confidence=tuple(np.stack([d.confidence for d in found], 1) for found in by_camera),
        order=tuple(_shuffled(len(t), len(others) + 1, rng) for t in captures),
        skeleton_order=_shuffled(len(mocap_t), n_subjects, rng),
    )


def _skeleton(
    preset: Preset, body: Body, t: Array, world_T_mocap: RigidTransform, rng: np.random.Generator
) -> Array:
    """Return what the MoCap sends of a person: (M, J, 3) metres."""
    x_world = body.at(t).place(landmarks_of(preset.mocap_joints))
    # Written out, as for the subject.
    x_mocap: Array = (x_world - world_T_mocap.translation) @ world_T_mocap.rotation
    return x_mocap + rng.normal(0.0, 1.0, x_mocap.shape) * preset.joint_noise_m


def _shuffled(n: int, k: int, rng: np.random.Generator) -> IntArray:
    """Return n permutations of k."""
    order: IntArray = rng.random((n, k)).argsort(1)
    return order
