# SPDX-License-Identifier: Apache-2.0
"""Simulated recordings agree with their truth, seen by OpenCV and not by our own projection."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from rpgd_ros.core import Camera, InputError
from rpgd_ros.core.geometry import Array
from rpgd_ros.simulation import Faults, Preset, build_scene, preset, simulate
from rpgd_ros.simulation.joints import landmarks_of
from rpgd_ros.simulation.presets import Detector
from rpgd_ros.simulation.rigs import RigPlan
from rpgd_ros.simulation.scene import EPOCH_NS

FISHEYE = RigPlan(
    mounts=((2.0, 0.0, 1.5), (0.0, -2.5, 2.2)),
    size=(1280, 960),
    focal_px=400.0,
    distortion=(-0.02, 0.005, -0.001, 0.0002),
    model='equidistant',
)


def noiseless(name: str, *, rig: RigPlan | None = None) -> Preset:
    """Return a preset whose sensors make no error."""
    plain = preset(name)
    return replace(
        plain, rig=rig or plain.rig, detector=Detector(keypoint_dropout=0.0), joint_noise_m=0.0
    )


def cv2_project(camera: Camera, x_world: Array) -> Array:
    """Project world points (N, 3) by OpenCV alone."""
    pose = camera.camera_T_world
    assert pose is not None
    rvec = cv2.Rodrigues(np.array(pose.rotation))[0]
    tvec = np.array(pose.translation)
    points = np.ascontiguousarray(x_world[:, None])
    if camera.model == 'equidistant':
        uv, _ = cv2.fisheye.projectPoints(points, rvec, tvec, camera.matrix, camera.distortion)
    else:
        uv, _ = cv2.projectPoints(points, rvec, tvec, camera.matrix, camera.distortion)
    return np.asarray(uv, dtype=np.float64).reshape(-1, 2)


@pytest.mark.parametrize(
    ('name', 'rig'),
    [('human36m', None), ('mpi_inf_3dhp', None), ('kinect', None), ('kinect', FISHEYE)],
)
def test_keypoints_are_opencvs_projections_of_the_mocap_joints(
    name: str, rig: RigPlan | None
) -> None:
    """`K [R|t] (R_m W + t_m)`, written out here, is where the detector sees every joint."""
    recording = simulate(build_scene(noiseless(name, rig=rig), 4, seconds=4.0))
    truth = recording.truth.world_T_mocap.matrix
    x_world = recording.mocap.x_mocap @ truth[:3, :3].T + truth[:3, 3]
    checked = 0
    for camera, stream in zip(recording.cameras, recording.streams, strict=True):
        seen = np.isfinite(stream.uv).all(-1)
        difference = stream.uv[seen] - cv2_project(camera, x_world[seen])
        assert np.abs(difference).max() < 1e-6
        checked += int(seen.sum())
    assert checked > 0.8 * x_world.shape[0] * x_world.shape[1] * len(recording.cameras)


def test_control_points_lie_where_the_truth_puts_them() -> None:
    """They come straight from the body, so an inverted transform cannot agree with them."""
    truth = simulate(build_scene(preset('studio'), 0, seconds=2.0)).truth
    matrix = truth.world_T_mocap.matrix
    moved = truth.control_mocap @ matrix[:3, :3].T + matrix[:3, 3]
    np.testing.assert_allclose(moved, truth.control_world, atol=1e-12)
    inverse = np.linalg.inv(matrix)
    wrong = truth.control_mocap @ inverse[:3, :3].T + inverse[:3, 3]
    assert np.abs(wrong - truth.control_world).max() > 0.1
    assert len(truth.control_world) >= 6
    assert (truth.control_world[:, 2] > 0.0).all()


@pytest.mark.parametrize('name', ['studio', 'human36m', 'aistpp', 'mpi_inf_3dhp', 'kinect'])
def test_people_stand_upright_in_the_images(name: str) -> None:
    """World z points up in every image: heads above feet, and mostly inside."""
    scene = build_scene(preset(name), 1, seconds=10.0)
    x = scene.body.at(np.arange(0.0, 10.0, 0.5)).place(('head_top', 'pelvis', 'left_ankle'))
    for camera in scene.cameras:
        head, pelvis, ankle = np.moveaxis(camera.project(x), 1, 0)
        assert (head[:, 1] < pelvis[:, 1]).all()
        assert (pelvis[:, 1] < ankle[:, 1]).all()


def test_same_seed_gives_the_same_recording() -> None:
    """Bit for bit; another seed gives another."""
    first, again, other = (
        simulate(build_scene(preset('studio'), seed, seconds=2.0)) for seed in (5, 5, 6)
    )
    np.testing.assert_array_equal(first.mocap.x_mocap, again.mocap.x_mocap)
    for a, b in zip(first.streams, again.streams, strict=True):
        np.testing.assert_array_equal(a.uv, b.uv)
        np.testing.assert_array_equal(a.stamp_ns, b.stamp_ns)
        np.testing.assert_array_equal(a.confidence, b.confidence)
    assert np.abs(first.mocap.x_mocap - other.mocap.x_mocap).max() > 0.01


def test_studio_runs_on_free_clocks() -> None:
    """120 Hz MoCap, 30 Hz cameras, each at a phase of its own, with a millisecond of jitter."""
    recording = simulate(build_scene(preset('studio'), 0, seconds=10.0))
    assert len(recording.mocap.stamp_ns) == 1200
    phases = []
    for stream in recording.streams:
        assert len(stream.stamp_ns) == 300
        steps = np.diff(stream.stamp_ns) / 1e9
        assert (steps > 0.0).all()
        assert steps.mean() == pytest.approx(1.0 / 30.0, abs=1e-4)
        assert 0.0007 < steps.std() < 0.003  # of two stamps: 1.4 ms
        phases.append(((stream.stamp_ns - EPOCH_NS) / 1e9 - np.arange(300) / 30.0).mean())
    assert np.diff(np.sort(phases)).min() > 0.0005
    assert (np.diff(recording.mocap.stamp_ns) > 0).all()


def test_messages_arrive_after_they_were_stamped() -> None:
    """Skeletons at once, detections a tenth of a second late."""
    recording = simulate(build_scene(preset('studio'), 0, seconds=1.0))
    assert (recording.mocap.receive_ns - recording.mocap.stamp_ns == 5_000_000).all()
    assert (recording.streams[0].receive_ns - recording.streams[0].stamp_ns == 100_000_000).all()


def test_late_stamps_show_an_earlier_body() -> None:
    """MoCap time = video stamp - lag: a video late by two frames shows the pose of two ago."""
    lag_s = 2.0 / 50.0
    plain = noiseless('human36m')
    on_time = simulate(build_scene(plain, 3, seconds=2.0))
    late = simulate(build_scene(plain, 3, seconds=2.0, faults=Faults(lag_s=lag_s)))
    np.testing.assert_array_equal(on_time.streams[0].stamp_ns, late.streams[0].stamp_ns)
    np.testing.assert_allclose(late.streams[0].uv[2:], on_time.streams[0].uv[:-2], atol=1e-9)
    assert late.truth.lags_s == (lag_s,) * 4


def test_cameras_may_lag_differently() -> None:
    """One lag per camera, each told by the truth."""
    lags = (0.0, 0.02, -0.04, 0.0)
    plain = noiseless('human36m')
    on_time = simulate(build_scene(plain, 3, seconds=2.0))
    late = simulate(build_scene(plain, 3, seconds=2.0, faults=Faults(lag_s=lags)))
    assert late.truth.lags_s == lags
    same = [
        np.array_equal(a.uv, b.uv, equal_nan=True)
        for a, b in zip(on_time.streams, late.streams, strict=True)
    ]
    assert same == [True, False, False, True]
    np.testing.assert_allclose(late.streams[2].uv[:-2], on_time.streams[2].uv[2:], atol=1e-9)


@pytest.mark.parametrize(
    ('lag_s', 'message'),
    [(5.0, 'within 1.5 s'), ((0.0, 0.1), '2 lags for 4'), (float('nan'), 'nan')],
)
def test_lags_that_do_not_fit_are_refused(lag_s: float | tuple[float, ...], message: str) -> None:
    """The body's course does not reach that far, or a camera has none."""
    scene = build_scene(preset('human36m'), 0, seconds=1.0, faults=Faults(lag_s=lag_s))
    with pytest.raises(InputError, match=message):
        simulate(scene)


def test_heading_bias_turns_with_the_body() -> None:
    """Each joint keeps its offset forward, left and up of the body."""
    plain = noiseless('human36m')
    clean = build_scene(plain, 2, seconds=20.0)
    shifts = _world_shifts(plain, Faults(bias_m=0.02))
    heading = clean.body.at(np.arange(1000) / 50.0).heading
    c, s = np.cos(heading)[:, None], np.sin(heading)[:, None]
    forward = c * shifts[..., 0] + s * shifts[..., 1]
    left = -s * shifts[..., 0] + c * shifts[..., 1]
    for component in (forward, left, shifts[..., 2]):
        assert np.ptp(component, axis=0).max() < 1e-9
    assert 0.01 < np.std([forward[0], left[0], shifts[0, :, 2]]) < 0.03
    assert np.ptp(shifts[..., 0], axis=0).max() > 0.02


def test_bone_bias_turns_with_the_bone() -> None:
    """Each joint keeps its distance, but not its direction in the body."""
    plain = noiseless('human36m')
    shifts = _world_shifts(plain, Faults(bias_m=0.02, bias_frame='bone'))
    assert np.ptp(np.linalg.norm(shifts, axis=-1), axis=0).max() < 1e-9
    wrist = landmarks_of('h36m32').index('left_wrist')
    assert np.ptp(shifts[:, wrist, 2]) > 0.003


def _world_shifts(plain: Preset, faults: Faults) -> Array:
    """Return (T, J, 3) by how much the faults move the MoCap joints, metres, world frame."""
    clean = simulate(build_scene(plain, 2, seconds=20.0))
    biased = simulate(build_scene(plain, 2, seconds=20.0, faults=faults))
    shift = biased.mocap.x_mocap - clean.mocap.x_mocap
    return shift @ clean.truth.world_T_mocap.rotation.T


def test_kinect_joints_are_noisy_in_space() -> None:
    """1.5 cm per axis."""
    noisy = preset('kinect')
    clean = replace(noisy, joint_noise_m=0.0)
    difference = (
        simulate(build_scene(noisy, 0, seconds=10.0)).mocap.x_mocap
        - simulate(build_scene(clean, 0, seconds=10.0)).mocap.x_mocap
    )
    assert difference.std() == pytest.approx(0.015, rel=0.03)


@pytest.mark.parametrize('seconds', [0.0, -1.0, float('nan'), 1e6])
def test_length_out_of_range_is_refused(seconds: float) -> None:
    """A recording lasts more than nothing and less than a day."""
    with pytest.raises(InputError, match='at most a day'):
        build_scene(preset('kinect'), 0, seconds=seconds)


def test_progress_is_told_per_camera() -> None:
    """The fractions rise to one."""
    told: list[tuple[str, float]] = []
    simulate(
        build_scene(preset('human36m'), 0, seconds=0.2),
        progress=lambda stage, fraction: told.append((stage, fraction)),
    )
    assert told == [('filming', 0.25), ('filming', 0.5), ('filming', 0.75), ('filming', 1.0)]


@pytest.mark.parametrize(
    ('faults', 'message'),
    [
        ({'bias_m': -0.1}, '0 or more metres, got -0.1'),
        ({'bias_frame': 'moon'}, "'moon'; known: h"),
    ],
)
def test_faults_out_of_range_are_refused(faults: dict[str, object], message: str) -> None:
    """Found, needed."""
    with pytest.raises(InputError, match=message):
        Faults(**faults)  # type: ignore[arg-type]


def test_person_whom_no_camera_sees_gives_an_empty_recording() -> None:
    """Nothing to scale the noise by is no reason to fail."""
    far_aside = build_scene(preset('human36m'), 0, seconds=0.5, centre=(50.0, 0.0))
    for stream in simulate(far_aside).streams:
        assert not stream.is_sent.any()
