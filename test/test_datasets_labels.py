# SPDX-License-Identifier: Apache-2.0
"""Labels for dataset builders: arrays in the cameras' frames, and COCO keypoints."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from rpgd_ros.core import Calibration, calibrate
from rpgd_ros.datasets.labels import write_labels
from rpgd_ros.simulation import Twin, twin


@pytest.fixture(scope='module')
def case() -> tuple[Twin, Calibration]:
    """Calibrate a small twin once."""
    problem = twin('human36m', 40, 0)
    return problem, calibrate(problem.cameras, problem.observations)


def test_arrays_hold_joints_in_the_frame_of_each_camera(
    case: tuple[Twin, Calibration], tmp_path: Path
) -> None:
    """They project to the labels, which lie on what the detector saw."""
    problem, calibration = case
    write_labels(tmp_path, 'walk', problem.cameras, problem.observations, calibration)
    with np.load(tmp_path / 'walk.npz', allow_pickle=False) as arrays:
        assert arrays['camera_names'].tolist() == [c.name for c in problem.cameras]
        assert arrays['joint_names'][4] == 'RightToeBase'
        np.testing.assert_array_equal(arrays['world_T_mocap'], calibration.world_T_mocap.matrix)
        np.testing.assert_array_equal(arrays['covariance'], calibration.covariance)
        assert float(arrays['sigma_deg']) == calibration.sigma_rotation_deg
        for i, (camera, view) in enumerate(
            zip(problem.cameras, problem.observations.views, strict=True)
        ):
            pose = arrays[f'camera_T_world_{i}'] @ arrays['world_T_mocap']
            x = view.x_mocap @ pose[:3, :3].T + pose[:3, 3]
            np.testing.assert_allclose(arrays[f'x_camera_{i}'], x, atol=1e-12)
            uv = arrays[f'uv_{i}']
            np.testing.assert_allclose(camera.project_camera(x), uv)
            assert np.nanmedian(np.linalg.norm(uv - view.uv, axis=-1)) < 3.0
            np.testing.assert_array_equal(arrays[f'stamp_ns_{i}'], view.stamp_ns)


def test_coco_file_labels_every_image(case: tuple[Twin, Calibration], tmp_path: Path) -> None:
    """One image per camera and instant; joints outside the image are not labelled."""
    problem, calibration = case
    write_labels(tmp_path, 'walk', problem.cameras, problem.observations, calibration)
    coco = json.loads((tmp_path / 'walk.json').read_text())
    assert len(coco['images']) == len(problem.cameras) * 40
    sizes = {image['id']: (image['width'], image['height']) for image in coco['images']}
    assert len(sizes) == len(coco['images'])
    (category,) = coco['categories']
    assert len(category['keypoints']) == 32
    assert all(1 <= joint <= 32 for bone in category['skeleton'] for joint in bone)
    with np.load(tmp_path / 'walk.npz') as arrays:
        second_camera = arrays['uv_1']
    annotation = next(a for a in coco['annotations'] if a['image_id'] == 41)
    u, v, flag = np.reshape(annotation['keypoints'], (32, 3)).T
    assert set(flag) <= {0, 2}
    assert annotation['num_keypoints'] == (flag == 2).sum() > 0
    labelled = flag == 2
    np.testing.assert_allclose(
        np.stack([u, v], -1)[labelled], second_camera[0][labelled], atol=0.006
    )
    x, y, width, height = annotation['bbox']
    assert (u[labelled] >= x - 0.01).all()
    assert (u[labelled] <= x + width + 0.02).all()
    assert (v[labelled] >= y - 0.01).all()
    assert (v[labelled] <= y + height + 0.02).all()


def test_missing_joints_and_empty_instants_are_left_out(
    case: tuple[Twin, Calibration], tmp_path: Path
) -> None:
    """An image without any joint has no annotation."""
    problem, calibration = case
    view = problem.observations.views[0]
    x = view.x_mocap.copy()
    x[0] = np.nan
    x[1, 3:] = np.nan
    observations = type(problem.observations).from_arrays(x, view.uv[None])
    write_labels(tmp_path, 'few', problem.cameras[:1], observations, calibration)
    coco = json.loads((tmp_path / 'few.json').read_text())
    assert len(coco['images']) == 40
    assert 1 not in {annotation['image_id'] for annotation in coco['annotations']}
    assert coco['annotations'][0]['num_keypoints'] <= 3
    with np.load(tmp_path / 'few.npz') as arrays:
        assert 'stamp_ns_0' not in arrays
        assert arrays['joint_names'].tolist() == [str(j) for j in range(32)]
