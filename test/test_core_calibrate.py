# SPDX-License-Identifier: Apache-2.0
"""The whole solve: its interface, its exactness, and its determinism."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from core_cases import camera_with
from scenes import errors, only, perfect, scene

from rpgd_ros.core import (
    Calibration,
    CalibrationConfig,
    CalibrationError,
    Camera,
    InputError,
    Observations,
    Reason,
    RigidTransform,
    calibrate,
)
from rpgd_ros.core.config import RansacConfig
from rpgd_ros.core.geometry import Array


def numbers(found: Calibration) -> list[Array]:
    """Return everything that a solve computed, except its duration."""
    fits = [*found.per_camera.values(), *found.per_joint.values()]
    figures = [
        [f.correspondences, f.inliers, f.mpjpe_px, f.inlier_mpjpe_px, *f.bias_px] for f in fits
    ]
    return [
        found.world_T_mocap.matrix, found.covariance, found.covariance_over_time,
        np.array([found.mpjpe_px, found.median_px, found.p95_px, found.threshold_px]),
        found.centroid_mocap, np.array(figures),
    ]  # fmt: skip


def assert_same_bits(a: Calibration, b: Calibration) -> None:
    """Both solves gave the same numbers, to the last bit."""
    for one, other in zip(numbers(a), numbers(b), strict=True):
        np.testing.assert_array_equal(one, other)


def test_the_interface_is_the_one_that_the_design_shows() -> None:
    """Cameras and arrays in, a transform with its figures out."""
    case = scene('human36m', 150, 7)
    joints = case.observations.views[0].x_mocap
    keypoints = np.stack([v.uv for v in case.observations.views])
    scores = np.stack([v.confidence for v in case.observations.views if v.confidence is not None])
    cameras = [
        Camera(
            name=c.name, matrix=c.matrix, distortion=c.distortion, size=c.size,
            camera_T_world=RigidTransform(c.camera_T_world.rotation, c.camera_T_world.translation),
        )
        for c in case.cameras if c.camera_T_world is not None
    ]  # fmt: skip
    observations = Observations.from_arrays(
        x_mocap=joints, uv=keypoints, confidence=scores, fps=50.0
    )
    calibration = calibrate(cameras, observations, config=CalibrationConfig(), seed=0)
    angle_deg, shift_m = errors(calibration.world_T_mocap, case.truth.world_T_mocap, observations)
    assert angle_deg < 0.05
    assert shift_m < 1e-3
    assert calibration.world_T_mocap.rotation.shape == (3, 3)
    assert calibration.world_T_mocap.translation.shape == (3,)
    assert calibration.covariance.shape == (6, 6)
    assert (np.linalg.eigvalsh(calibration.covariance) > 0.0).all()
    assert 0.0 < calibration.mpjpe_px < 2.0
    assert 0.9 < calibration.inlier_ratio <= 1.0
    assert set(calibration.per_camera) == {c.name for c in cameras}
    assert len(calibration.per_joint) == joints.shape[1]
    assert calibration.seconds > 0.0
    assert calibration.config == CalibrationConfig()


@pytest.mark.parametrize('shape', ['mpi_inf_3dhp', 'human36m', 'aistpp', 'kinect', 'studio'])
def test_exact_keypoints_give_the_exact_transform(shape: str) -> None:
    """Without noise the answer is right to the rounding of the columns."""
    case = perfect(shape, 100, 1)
    found = calibrate(case.cameras, case.observations)
    angle_deg, shift_m = errors(found.world_T_mocap, case.truth.world_T_mocap, case.observations)
    assert angle_deg < 1e-4
    assert shift_m < 1e-5
    assert found.mpjpe_px < 1e-3


@pytest.mark.parametrize('sampling', ['same_frame', 'any_frame'])
@pytest.mark.parametrize('score', ['inliers', 'likelihood'])
@pytest.mark.parametrize('method', ['newton', 'adam', 'none'])
@pytest.mark.parametrize('loss', ['robust', 'squared'])
def test_every_combination_of_settings_solves(
    sampling: str, score: str, method: str, loss: str
) -> None:
    """Each stage works with each other; a frame stride and a threshold go along."""
    case = scene('human36m', 60, 3)
    config = (
        CalibrationConfig()
        .with_stage('ransac', sampling=sampling, score=score, iterations=64, threshold_px=8.0)
        .with_stage('refine', method=method, loss=loss, iterations=150, frame_stride=2)
    )
    found = calibrate(case.cameras, case.observations, config=config)
    angle_deg, shift_m = errors(found.world_T_mocap, case.truth.world_T_mocap, case.observations)
    # Newton's method ends at the optimum; Adam is on its way; without either a triplet is left.
    assert angle_deg < {'newton': 0.05, 'adam': 0.5, 'none': 2.0}[method]
    assert shift_m < {'newton': 2e-3, 'adam': 0.02, 'none': 0.04}[method]
    assert found.threshold_px == 8.0


@pytest.mark.fault(31)
@pytest.mark.parametrize('config', [CalibrationConfig(), CalibrationConfig.paper()])
def test_the_same_input_gives_the_same_bits(config: CalibrationConfig) -> None:
    """Twice, with everything else that draws random numbers disturbed in between."""
    case = scene('human36m', 60, 5)
    config = replace(config, ransac=replace(config.ransac, iterations=100))
    first = calibrate(case.cameras, case.observations, config=config, seed=3)
    np.random.default_rng().normal(size=17)
    copied = replace(
        case.observations,
        views=tuple(
            replace(v, x_mocap=v.x_mocap.copy(), uv=np.asfortranarray(v.uv))
            for v in case.observations.views
        ),
    )
    again = calibrate(case.cameras, copied, config=config, seed=3)
    assert_same_bits(first, again)


def test_the_order_of_the_cameras_does_not_matter() -> None:
    """The same cameras in another order: the same bits, each under its name."""
    case = scene('human36m', 150, 5, outlier_ratio=0.3)
    first = calibrate(case.cameras, case.observations)
    other = only(case, 2, 0, 3, 1)
    again = calibrate(other.cameras, other.observations)
    np.testing.assert_array_equal(first.world_T_mocap.matrix, again.world_T_mocap.matrix)
    np.testing.assert_array_equal(first.covariance, again.covariance)
    assert dict(first.per_camera) == dict(again.per_camera)
    assert list(again.per_camera) == [c.name for c in other.cameras]


def test_the_order_of_frames_without_time_hardly_matters() -> None:
    """Without stamps the order is part of the input; the optimum it ends at is the same."""
    case = scene('human36m', 150, 5, outlier_ratio=0.3)
    order = np.random.default_rng(0).permutation(150)
    views = [replace(v, stamp_ns=None) for v in case.observations.views]
    shuffled = [replace(v, x_mocap=v.x_mocap[order], uv=v.uv[order]) for v in views]
    first = calibrate(case.cameras, Observations(tuple(views)))
    again = calibrate(case.cameras, Observations(tuple(shuffled)))
    angle_deg, shift_m = errors(again.world_T_mocap, first.world_T_mocap, case.observations)
    assert angle_deg < 1e-4
    assert shift_m < 1e-6


def test_another_seed_reaches_the_same_optimum() -> None:
    """The draws decide where the descent begins, not where it ends."""
    case = scene('human36m', 150, 5, outlier_ratio=0.5, kind='mixed')
    found = [calibrate(case.cameras, case.observations, seed=seed) for seed in range(4)]
    for one in found[1:]:
        angle_deg, shift_m = errors(one.world_T_mocap, found[0].world_T_mocap, case.observations)
        assert angle_deg < 1e-3
        assert shift_m < 1e-5


def test_the_seed_of_the_settings_is_used_where_none_is_given() -> None:
    """`seed=None` means `config.ransac.seed`."""
    case = scene('human36m', 60, 5, outlier_ratio=0.3)
    config = CalibrationConfig(ransac=RansacConfig(seed=11))
    assert_same_bits(
        calibrate(case.cameras, case.observations, config=config),
        calibrate(case.cameras, case.observations, seed=11),
    )


def test_a_single_camera_without_extrinsics_is_the_world() -> None:
    """The result is then camera_T_mocap."""
    case = only(scene('human36m', 150, 2), 1)
    camera = case.cameras[0]
    alone = calibrate([replace(camera, camera_T_world=None)], case.observations)
    placed = calibrate([camera], case.observations)
    assert camera.camera_T_world is not None
    np.testing.assert_allclose(
        alone.world_T_mocap.matrix,
        (camera.camera_T_world @ placed.world_T_mocap).matrix,
        atol=1e-6,
    )


def test_several_cameras_without_extrinsics_are_refused() -> None:
    """They are named."""
    case = scene('human36m', 60, 2)
    cameras = [
        replace(c, camera_T_world=None) if k == 2 else c for k, c in enumerate(case.cameras)
    ]
    with pytest.raises(CalibrationError, match=f'no extrinsics for {cameras[2].name}') as refused:
        calibrate(cameras, case.observations)
    assert refused.value.reason is Reason.NO_EXTRINSICS


def test_cameras_must_fit_their_views() -> None:
    """One per view, each with a name of its own."""
    case = scene('human36m', 60, 2)
    with pytest.raises(InputError, match='3 cameras for 4 views'):
        calibrate(case.cameras[:3], case.observations)
    twins = [replace(c, name='hall') for c in case.cameras]
    with pytest.raises(InputError, match='cameras need different names, got hall, hall'):
        calibrate(twins, case.observations)


def test_a_lens_of_any_model_is_solved() -> None:
    """One camera of each model, exact keypoints."""
    case = perfect('kinect', 100, 2)
    view, truth = case.observations.views[0], case.truth.world_T_mocap
    for lens in ('none', 'four', 'five', 'eight', 'fisheye'):
        camera = camera_with(lens, case.cameras[0].camera_T_world)
        uv = camera.project(truth @ view.x_mocap)
        found = calibrate([camera], Observations((replace(view, uv=uv),)))
        angle_deg, shift_m = errors(found.world_T_mocap, truth, case.observations)
        assert angle_deg < 1e-4
        assert shift_m < 1e-5
