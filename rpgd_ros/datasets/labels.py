# SPDX-License-Identifier: Apache-2.0
"""Writes what dataset builders need: joints in each camera's frame, and labels in its image.

<name>.npz    arrays, see `label_arrays`
<name>.json   the reprojected joints as COCO keypoints; one image per camera and instant
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rpgd_ros.core.camera import Camera
from rpgd_ros.core.geometry import Array, BoolArray, RigidTransform
from rpgd_ros.core.observations import Observations
from rpgd_ros.core.result import Calibration
from rpgd_ros.io.atomic import write_atomic
from rpgd_ros.skeletons import edges

IN_IMAGE = 2  # COCO: labelled and visible; whether something hides the joint is not known
PERSON = 1
DIGITS = 2  # of a pixel


def write_labels(
    folder: Path,
    name: str,
    cameras: Sequence[Camera],
    observations: Observations,
    calibration: Calibration,
) -> None:
    """Write both files of a recording.

    Args:
        folder: Where; must exist.
        name: Of the files, without an ending.
        cameras: One per view.
        observations: What the calibration was made from.
        calibration: An accepted result.

    Raises:
        InputError: NOT_WRITABLE.

    """
    arrays: dict[str, Any] = label_arrays(cameras, observations, calibration)
    with io.BytesIO() as file:
        np.savez_compressed(file, **arrays)
        write_atomic(folder / f'{name}.npz', file.getvalue())
    write_atomic(folder / f'{name}.json', json.dumps(_coco(cameras, observations, arrays)))


def label_arrays(
    cameras: Sequence[Camera], observations: Observations, calibration: Calibration
) -> dict[str, NDArray[Any]]:
    """Return the arrays of the .npz file.

    Returns:
        `world_T_mocap` (4, 4); `covariance` (6, 6) of it, see `Calibration`; `sigma_deg`,
        `sigma_m`: standard deviations of the rotation and of the body's place; `camera_names`,
        `joint_names`; and per camera number i `camera_T_world_i` (4, 4), `stamp_ns_i` (F,) where
        time is known, `x_camera_i` (F, J, 3), metres, and `uv_i` (F, J, 2), pixels, NaN where
        the joint is missing or not before the lens.

    """
    arrays: dict[str, NDArray[Any]] = {
        'world_T_mocap': calibration.world_T_mocap.matrix,
        'covariance': calibration.covariance,
        'sigma_deg': np.array(calibration.sigma_rotation_deg),
        'sigma_m': np.array(calibration.sigma_position_m),
        'camera_names': np.array([camera.name for camera in cameras]),
        'joint_names': np.array(_joint_names(observations)),
    }
    for i, (camera, view) in enumerate(zip(cameras, observations.views, strict=True)):
        camera_T_world = camera.camera_T_world or RigidTransform.identity()
        x_camera = (camera_T_world @ calibration.world_T_mocap) @ view.x_mocap
        arrays[f'camera_T_world_{i}'] = camera_T_world.matrix
        arrays[f'x_camera_{i}'] = x_camera
        arrays[f'uv_{i}'] = camera.project_camera(x_camera)
        if view.stamp_ns is not None:
            arrays[f'stamp_ns_{i}'] = view.stamp_ns
    return arrays


def _joint_names(observations: Observations) -> tuple[str, ...]:
    return observations.joint_names or tuple(str(j) for j in range(observations.n_joints))


def _coco(
    cameras: Sequence[Camera], observations: Observations, arrays: dict[str, NDArray[Any]]
) -> dict[str, Any]:
    names = _joint_names(observations)
    images: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    for i, camera in enumerate(cameras):
        for frame, annotation in enumerate(_annotations(camera, arrays[f'uv_{i}'])):
            number = len(images) + 1
            images.append(
                {
                    'id': number,
                    'file_name': f'{camera.name}/{frame:06d}.jpg',
                    'width': camera.size[0],
                    'height': camera.size[1],
                }
            )
            if annotation['num_keypoints']:
                annotations.append({'id': number, 'image_id': number, **annotation})
    skeleton = [[a + 1, b + 1] for a, b in edges(names)]
    category = {'id': PERSON, 'name': 'person', 'keypoints': list(names), 'skeleton': skeleton}
    return {'images': images, 'annotations': annotations, 'categories': [category]}


def _annotations(camera: Camera, uv: Array) -> Iterator[dict[str, Any]]:
    """Yield an annotation for each instant of a camera, without its numbers."""
    width, height = camera.size
    with np.errstate(invalid='ignore'):
        inside: BoolArray = np.asarray(
            ((uv > -0.5) & (uv < np.array([width, height]) - 0.5)).all(-1)
        )
    labelled = np.where(inside[..., None], uv, 0.0).round(DIGITS)
    keypoints = np.concatenate([labelled, np.where(inside, IN_IMAGE, 0)[..., None]], -1)
    for row, pixels, seen in zip(keypoints.reshape(len(uv), -1).tolist(), uv, inside, strict=True):
        low, high = (
            (pixels[seen].min(0), pixels[seen].max(0)) if seen.any() else (np.zeros(2),) * 2
        )
        box = [*low.round(DIGITS).tolist(), *(high - low).round(DIGITS).tolist()]
        yield {
            'category_id': PERSON,
            'keypoints': row,
            'num_keypoints': int(seen.sum()),
            'bbox': box,
            'area': round(box[2] * box[3], DIGITS),
            'iscrowd': 0,
        }
