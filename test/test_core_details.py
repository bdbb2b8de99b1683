# SPDX-License-Identifier: Apache-2.0
"""What the thorough settings estimate beside the pose, and what that is worth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import scenes

from rpgd_ros.core import Calibration, CalibrationConfig, Observations, RigidTransform, calibrate
from rpgd_ros.core.geometry import Array, IntArray, so3_exp
from rpgd_ros.core.observations import MocapTrack
from rpgd_ros.simulation import Twin

THOROUGH = CalibrationConfig.thorough()


def solved(case: Twin, config: CalibrationConfig = THOROUGH) -> tuple[Calibration, float]:
    """Return the calibration and the RMS displacement of the body's points, metres."""
    found = calibrate(case.cameras, case.observations, config=config)
    x = case.observations.views[0].x_mocap.reshape(-1, 3)
    apart = (found.world_T_mocap @ x) - (case.truth.world_T_mocap @ x)
    return found, float(np.sqrt(np.nanmean((apart**2).sum(-1))))


def rms(values: list[float]) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.parametrize('frames', [300, 1500])
@pytest.mark.parametrize('frame', ['heading', 'bone'])
def test_misplaced_joints_cost_less_once_they_are_estimated(frames: int, frame: str) -> None:
    """2 cm per axis. What all joints share along the vertical nobody can see: it is left out."""
    plain, mended = [], []
    for seed in range(4 if frames == 300 else 2):  # the longer, the less by chance
        case = scenes.scene(frames=frames, seed=seed, bias_m=0.02, bias_frame=frame)
        plain.append(level_error_m(case, solved(case, CalibrationConfig())[0]))
        found, _ = solved(case)
        mended.append(level_error_m(case, found))
        spread = np.std([o.offset_m for o in found.joint_offset_m.values()])
        assert spread == pytest.approx(0.02, rel=0.4)
    assert rms(mended) < (0.3 if frame == 'heading' else 0.7) * rms(plain)


def level_error_m(case: Twin, found: Calibration) -> float:
    """RMS displacement of the body's points over the floor, metres."""
    x = case.observations.views[0].x_mocap.reshape(-1, 3)
    apart = (found.world_T_mocap @ x) - (case.truth.world_T_mocap @ x)
    return float(np.sqrt(np.nanmean((apart[:, :2] ** 2).sum(-1))))


def test_joints_that_are_where_they_should_be_are_left_there() -> None:
    """The spread of the offsets is chosen by the data: none here, and nothing is lost."""
    plain, thorough = [], []
    for seed in range(3):
        case = scenes.scene(frames=600, seed=seed)
        plain.append(solved(case, CalibrationConfig())[1])
        found, error_m = solved(case)
        thorough.append(error_m)
        assert found.joint_offset_m == {}
        assert found.warnings == ()
    assert rms(thorough) < 1.1 * rms(plain)


def test_a_late_video_of_misplaced_joints_is_dated_to_a_millisecond() -> None:
    """Without the joints' offsets it errs by twice that."""
    for seed in range(3):
        found, _ = solved(scenes.scene(frames=1500, seed=seed, lag_s=0.02, bias_m=0.02))
        for offset_s, _ in found.time_offset_s.values():
            assert offset_s == pytest.approx(0.02, abs=0.001)


@pytest.mark.parametrize(('rate', 'seed'), [(1e-3, 2), (-1e-3, 1)])
def test_a_clock_that_runs_wrong_is_told_to_a_tenth(rate: float, seed: int) -> None:
    """59.94 against 60 fps: half a frame after eight seconds; a right clock is not accused."""
    case = scenes.scene(frames=1500, seed=seed)
    late = list(case.observations.views)
    stamp_ns = late[2].stamp_ns
    assert stamp_ns is not None
    late[2] = replace(
        late[2], stamp_ns=stamp_ns + np.round(rate * (stamp_ns - stamp_ns[0])).astype(np.int64)
    )
    found, error_m = solved(
        case._replace(observations=replace(case.observations, views=tuple(late)))
    )
    assert list(found.clock_rate) == [case.cameras[2].name]
    assert found.clock_rate[case.cameras[2].name][0] == pytest.approx(rate, rel=0.1)
    assert error_m < 0.001


@pytest.mark.fault(33)
def test_one_wrong_focal_length_is_named_with_its_error() -> None:
    """1 % of one camera, known to 0.3 %."""
    case = scenes.scene(frames=1000, seed=2)
    cameras = (case.cameras[0].with_focal(1.01), *case.cameras[1:])
    found, _ = solved(case._replace(cameras=cameras))
    error, sigma = found.focal_error[cameras[0].name]
    assert error == pytest.approx(-0.01, abs=0.003)
    assert sigma < 0.003
    assert any(f'camera {cameras[0].name} looks' in w for w in found.warnings)
    mended, error_m = solved(
        case._replace(cameras=cameras), THOROUGH.with_stage('refine', focal='estimate')
    )
    assert mended.warnings == ()
    assert error_m < 0.001


def test_a_suit_of_the_wrong_size_is_told_from_wrong_lenses() -> None:
    """2 % too large; no camera and no lens is blamed, and the size is known to 0.3 %."""
    case = scenes.scene(frames=1000, seed=0)
    grown = moved(case, lambda x, _: 1.02 * x)
    found, _ = solved(grown)
    assert found.skeleton_scale is not None
    assert found.skeleton_scale[0] == pytest.approx(1.0 / 1.02 - 1.0, abs=0.004)
    assert [w for w in found.warnings if 'too large' in w] == list(found.warnings)
    assert found.disagreements == ()


def test_a_frame_that_drifts_is_told_with_its_rate() -> None:
    """Half a degree and 20 mm a minute; the pose is that of mid-recording."""
    case = scenes.scene(frames=1500, seed=0)
    track = case.observations.mocap
    assert track is not None
    centre = np.nanmean(track.x_mocap, axis=(0, 1))
    middle = 0.5 * track.stamp_ns[-1] / 1e9

    def creep(x: Array, t: float) -> Array:
        minutes = (t - middle) / 60.0
        turn = so3_exp(np.radians(0.5) * minutes * np.array([0.0, 0.6, 0.8]))
        there: Array = (x - centre) @ turn.T + centre + [0.02 * minutes, 0.0, 0.0]
        return there

    found, _ = solved(moved(case, creep))
    assert found.drift is not None
    assert found.drift.deg_per_min == pytest.approx(0.5, rel=0.2)
    assert found.drift.mm_per_min == pytest.approx(20.0, rel=0.25)
    assert solved(case)[0].drift is None


def test_a_bump_in_mid_recording_is_dated_and_the_camera_placed_again() -> None:
    """Half a degree and 2 cm, half way through."""
    case = scenes.scene(frames=1000, seed=1)
    camera, view = case.cameras[1], case.observations.views[1]
    assert camera.camera_T_world is not None
    turned = RigidTransform(so3_exp([0.0, np.radians(0.5), 0.0]), np.array([0.02, 0.0, 0.0]))
    bumped = replace(camera, camera_T_world=turned @ camera.camera_T_world)
    x = case.truth.world_T_mocap @ view.x_mocap
    uv = view.uv.copy()
    uv[500:] += (bumped.project(x) - camera.project(x))[500:]
    views = list(case.observations.views)
    views[1] = replace(view, uv=uv)
    found, error_m = solved(
        case._replace(observations=replace(case.observations, views=tuple(views))),
        THOROUGH.with_stage('rig', on_bumped_camera='re-estimate'),
    )
    (named,) = found.disagreements
    assert named.camera == camera.name
    assert view.stamp_ns is not None
    assert named.since_s == pytest.approx((view.stamp_ns[500] - view.stamp_ns[0]) / 1e9, abs=0.1)
    assert error_m < 0.0005
    placed = found.camera_poses[camera.name].camera_T_world
    assert bumped.camera_T_world is not None
    centre = placed.inverse().translation - bumped.camera_T_world.inverse().translation
    assert np.linalg.norm(centre) < 0.005


def test_a_moved_camera_is_not_explained_away_by_its_clock() -> None:
    """Few of its keypoints agree, at any offset: it is named, and the others keep their clocks."""
    case = scenes.scene('studio', frames=300, seed=0)
    third = case.cameras[2]
    assert third.camera_T_world is not None
    turned = RigidTransform(so3_exp([0.0, np.radians(1.0), 0.0]), np.array([0.03, 0.0, 0.0]))
    bumped = replace(third, camera_T_world=turned @ third.camera_T_world)
    cameras = tuple(bumped if c is third else c for c in case.cameras)
    found, _ = solved(case._replace(cameras=cameras))
    assert [d.camera for d in found.disagreements] == [third.name]
    assert all(abs(offset_s) < 0.005 for offset_s, _ in found.time_offset_s.values())


def moved(case: Twin, change: Callable[[Array, float], Array]) -> Twin:
    """Return the scene with every skeleton changed: change(x (J, 3), seconds)."""
    track = case.observations.mocap
    assert track is not None

    def all_of(x: Array, stamp_ns: IntArray) -> Array:
        return np.stack([change(s, t / 1e9) for s, t in zip(x, stamp_ns, strict=True)])

    views = []
    for view in case.observations.views:
        assert view.stamp_ns is not None
        views.append(replace(view, x_mocap=all_of(view.x_mocap, view.stamp_ns)))
    creeping = MocapTrack(track.stamp_ns, all_of(track.x_mocap, track.stamp_ns))
    return case._replace(observations=Observations(tuple(views), creeping))


def test_the_published_descent_may_follow_the_settled_clocks() -> None:
    """A method that was asked for is used, whatever else is estimated: it takes its steps."""
    case = scenes.scene(frames=300, seed=0, lag_s=0.02)
    stages: list[float] = []
    calibrate(
        case.cameras,
        case.observations,
        config=THOROUGH.with_stage('refine', method='adam', iterations=70),
        progress=lambda stage, fraction: (
            stages.append(fraction) if stage == 'refinement' else None
        ),
    )
    assert len(stages) >= 70
