# SPDX-License-Identifier: Apache-2.0
"""Extrinsics that were found, as a part of the result file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from rpgd_ros.core.camera_pose import CameraPose
from rpgd_ros.core.geometry import Array, RigidTransform
from rpgd_ros.io.frames import Frames
from rpgd_ros.io.strict import Node

AGREEMENT: Final = 1e-6  # between the two spellings of the transform: six decimals survive editing


def poses_tree(poses: Mapping[str, CameraPose], frames: Frames) -> dict[str, Any]:
    """Return what a result file says of the cameras that were placed."""
    return {
        name: {
            'frame': frames.optical_frame(name),
            'camera_T_world': transform_tree(pose.camera_T_world),
            'covariance': pose.covariance.tolist(),
            'centroid_world': pose.centroid_world.tolist(),
            'sigma': {
                'rotation_deg': pose.sigma_rotation_deg,
                'position_m': pose.sigma_position_m,
                'centre_m': pose.sigma_centre_m,
            },
        }
        for name, pose in poses.items()
    }


def read_poses(node: Node) -> tuple[dict[str, CameraPose], dict[str, str]]:
    """Read extrinsics and the names of the optical frames, by camera.

    Raises:
        InputError: The message names file, key, what was found and what is needed.

    """
    poses: dict[str, CameraPose] = {}
    frames: dict[str, str] = {}
    for name, entry in node.items():
        keys = ('frame', 'camera_T_world', 'covariance', 'centroid_world')
        parts = entry.mapping(keys, ('sigma',))
        frames[name] = parts['frame'].text()
        poses[name] = CameraPose(
            read_transform(parts['camera_T_world']),
            read_covariance(parts['covariance']),
            np.array(parts['centroid_world'].numbers(3)),
        )
    return poses, frames


def transform_tree(transform: RigidTransform) -> dict[str, Any]:
    """Return a transform in both spellings."""
    return {
        'xyz': transform.translation.tolist(),
        'quat_xyzw': transform.quat_xyzw.tolist(),
        'matrix': transform.matrix.tolist(),
    }


def read_transform(node: Node) -> RigidTransform:
    """Read the matrix, which has all digits, and check it against the other spelling."""
    entries = node.mapping(('xyz', 'quat_xyzw', 'matrix'))
    matrix = np.array([row.numbers(4) for row in entries['matrix'].sequence()])
    if matrix.shape != (4, 4) or matrix[3].tolist() != [0.0, 0.0, 0.0, 1.0]:
        entries['matrix'].refuse('need 4 rows of 4 numbers, the last of them 0, 0, 0, 1')
    quat_xyzw = entries['quat_xyzw'].numbers(4)
    try:
        transform = RigidTransform.from_matrix(matrix)
        other = RigidTransform.from_quat_xyzw(entries['xyz'].numbers(3), quat_xyzw)
    except ValueError as error:
        node.refuse(str(error))
    apart = float(np.abs(transform.matrix - other.matrix).max())
    if apart > AGREEMENT:
        node.refuse(f'xyz and quat_xyzw differ from matrix by {apart:.2g}: change all or none')
    return transform


def read_covariance(node: Node) -> Array:
    """Read a (6, 6) covariance."""
    rows = [row.numbers(6) for row in node.sequence()]
    covariance = np.array(rows)
    if covariance.shape != (6, 6) or not np.allclose(covariance, covariance.T, rtol=1e-6):
        node.refuse('need 6 rows of 6 numbers, symmetric')
    if (np.diag(covariance) < 0.0).any():
        node.refuse('need variances that are not negative on the diagonal')
    return covariance
