# SPDX-License-Identifier: Apache-2.0
"""Rigs of which some or all extrinsics are absent: the session finds them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from studio import (
    KEYPOINTS,
    MATRIX,
    PAIRS,
    SECONDS,
    SIZE,
    START,
    WORLD_T_MOCAP,
    S,
    Studio,
    body_at,
    errors,
    feed,
    make_studio,
    with_camera,
    without_poses,
)

from rpgd_ros.core import Camera, RigidTransform
from rpgd_ros.core.geometry import rotation_angle, so3_exp
from rpgd_ros.io.rig import Rig
from rpgd_ros.messages import POINT_CLOUD2, encode_camera_info, encode_point_cloud2
from rpgd_ros.messages.camera_info import CameraInfo
from rpgd_ros.session import Session, solve
from rpgd_ros.session.monitor import Monitor, appraise


@pytest.fixture(scope='module')
def studio() -> Studio:
    """Three cameras, twelve seconds."""
    return make_studio(3)


def one_blind(rig: Rig, index: int) -> Rig:
    """Return a rig of which one camera has no extrinsics."""
    rigs = without_poses(rig)
    return with_camera(rig, index, camera=rigs.cameras[index].camera, extrinsics=None)


def apart(found: RigidTransform, truth: RigidTransform) -> tuple[float, float]:
    """Return degrees, and metres in the middle of the room."""
    delta = found @ truth.inverse()
    middle = truth @ np.array([0.0, 0.0, 1.0])
    return (
        float(np.degrees(rotation_angle(delta.rotation))),
        float(np.linalg.norm(delta @ middle - middle)),
    )


def test_rig_without_extrinsics_gets_them_in_the_mocap_frame(studio: Studio) -> None:
    """The MoCap is then the world."""
    session = feed(Session(without_poses(studio.rig)), studio.messages, together=500)
    calibration = solve(session.snapshot())
    assert np.array_equal(calibration.world_T_mocap.matrix, np.eye(4))
    assert list(calibration.camera_poses) == ['cam0', 'cam1', 'cam2']
    for camera in studio.rig.cameras:
        assert camera.extrinsics is not None
        found = calibration.camera_poses[camera.name].camera_T_world
        # The detector's joints are 0.5 px off for good, in each camera otherwise.
        error_deg, error_m = apart(found, camera.extrinsics @ WORLD_T_MOCAP)
        assert error_deg < 0.2
        assert error_m < 0.01


def test_camera_without_extrinsics_is_placed_in_the_world_of_the_others(studio: Studio) -> None:
    """And world_T_mocap is that of the cameras that know theirs."""
    session = feed(Session(one_blind(studio.rig, 1)), studio.messages, together=500)
    snapshot = session.snapshot()
    calibration = solve(snapshot)
    assert errors(calibration)[0] < 0.1
    assert list(calibration.camera_poses) == ['cam1']
    truth = studio.rig.cameras[1].extrinsics
    assert truth is not None
    error_deg, error_m = apart(calibration.camera_poses['cam1'].camera_T_world, truth)
    assert error_deg < 0.2
    assert error_m < 0.01
    placed = snapshot.placed(calibration.camera_poses)
    assert [c.name for c in placed if c.camera_T_world is None] == []
    assert [c.name for c in snapshot.placed({}) if c.camera_T_world is None] == ['cam1']


def test_pose_from_elsewhere_ends_the_search(studio: Studio) -> None:
    """Once a camera has been given its pose it is no longer sought."""
    session = feed(Session(one_blind(studio.rig, 1)), studio.messages, together=500)
    truth = studio.rig.cameras[1].extrinsics
    assert truth is not None
    session.set_extrinsics('cam1', truth)
    assert not solve(session.snapshot()).camera_poses


def rectified(studio: Studio) -> tuple[Session, Camera]:
    """Return a session of a rig without poses, its last camera rectified, and that as it sees."""
    turn = so3_exp([0.02, -0.1, 0.05])
    rig = without_poses(studio.rig)
    rig = with_camera(rig, 2, camera=None, rectified=True, camera_info_topic='cam2/camera_info')
    session = Session(rig)
    info = CameraInfo(
        stamp_ns=START, frame_id='eye', size=SIZE, model='pinhole', matrix=MATRIX,
        distortion=np.zeros(5), rectified_matrix=MATRIX, rectification=turn,
    )  # fmt: skip
    session._camera('cam2').set_info(info)  # noqa: SLF001
    raw = studio.rig.cameras[2].extrinsics
    assert raw is not None
    seen_by = Camera('cam2', MATRIX, np.zeros(0), SIZE, RigidTransform(turn, np.zeros(3)) @ raw)
    feed(session, [m for m in studio.messages if m[0] != 'cam2'], together=500)
    feed(session, _as_seen_by(seen_by), together=500)
    return session, seen_by


def test_rectified_camera_is_placed_by_its_optical_frame(studio: Studio) -> None:
    """Its keypoints are of an image that is turned against that frame."""
    session, seen_by = rectified(studio)
    raw = studio.rig.cameras[2].extrinsics
    assert raw is not None
    snapshot = session.snapshot()
    calibration = solve(snapshot)
    error_deg, error_m = apart(
        calibration.camera_poses['cam2'].camera_T_world, raw @ WORLD_T_MOCAP
    )
    assert error_deg < 0.2
    assert error_m < 0.01
    assert seen_by.camera_T_world is not None
    placed = snapshot.placed(calibration.camera_poses)[2].camera_T_world
    assert placed is not None
    assert apart(placed, seen_by.camera_T_world @ WORLD_T_MOCAP)[0] < 0.2


def test_rectified_camera_is_watched_where_it_was_placed(studio: Studio) -> None:
    """Until then it stands nowhere: how it is turned against its optical frame is no pose."""
    session, _ = rectified(studio)
    monitor = Monitor(session, max_age_s=300.0)
    assert monitor.recent.cameras() == []
    assert not any(new.is_placed for new in monitor.recent.take())
    snapshot = session.snapshot()
    calibration = solve(snapshot)
    appraisal = appraise(snapshot, calibration)
    monitor.conclude(appraisal, is_accepted=True, is_automatic=False)
    for drawn, used in zip(
        monitor.recent.cameras(), snapshot.placed(calibration.camera_poses), strict=True
    ):
        assert drawn.camera_T_world is not None
        assert used.camera_T_world is not None
        assert np.array_equal(drawn.camera_T_world.matrix, used.camera_T_world.matrix)


def _as_seen_by(camera: Camera) -> list[tuple[str, bytes, int]]:
    """Return the keypoints of a camera instead of those that the studio has under its name."""
    stamps = [START + i * (S // 30) for i in range(SECONDS * 30)]
    seen = camera.project(body_at(stamps))
    uv = np.full((len(stamps), len(KEYPOINTS), 2), np.nan)
    for j, k in PAIRS:
        uv[:, k] = seen[:, j]
    return [
        (camera.name, encode_point_cloud2(stamp, camera.name, pixels, None), stamp + 9)
        for stamp, pixels in zip(stamps, uv, strict=True)
    ]


def test_late_clocks_and_known_offsets_are_added_up() -> None:
    """The offset that is reported is that of the stamps as sent."""
    late = make_studio(2, late_ns=80_000_000)
    rig = without_poses(late.rig)
    rig = with_camera(rig, 0, time_offset_s=0.05)
    calibration = solve(feed(Session(rig), late.messages, together=500).snapshot())
    for name in ('cam0', 'cam1'):
        assert calibration.time_offset_s[name][0] == pytest.approx(0.08, abs=2e-3)


def test_optical_frames_are_those_that_drivers_name(studio: Studio) -> None:
    """Unless two share one, or the name is not that of an optical frame."""
    rig = without_poses(studio.rig)
    session = Session(rig)
    payload = encode_point_cloud2(START, 'left_optical_frame', np.zeros((17, 2)), np.ones(17))
    session.add('cam0', POINT_CLOUD2, [payload], [START])
    payload = encode_point_cloud2(START, 'camera_link', np.zeros((17, 2)), np.ones(17))
    session.add('cam1', POINT_CLOUD2, [payload], [START])
    assert session.optical_frames() == {
        'cam0': 'left_optical_frame',
        'cam1': 'cam1_optical_frame',
        'cam2': 'cam2_optical_frame',
    }
    payload = encode_point_cloud2(START, 'left_optical_frame', np.zeros((17, 2)), np.ones(17))
    session.add('cam2', POINT_CLOUD2, [payload], [START])
    assert session.optical_frames()['cam0'] == 'cam0_optical_frame'
    assert session.optical_frames()['cam2'] == 'cam2_optical_frame'


def test_optical_frame_of_camera_info_is_taken(studio: Studio) -> None:
    """Drivers name it there first of all."""
    rig = without_poses(studio.rig)
    intrinsics = rig.cameras[0].camera
    assert intrinsics is not None
    rig = with_camera(rig, 0, camera=None, camera_info_topic='cam0/camera_info')
    session = Session(rig)
    session.set_intrinsics('cam0', encode_camera_info(intrinsics, START, 'eye_optical'))
    assert session.optical_frames()['cam0'] == 'eye_optical'
    other = replace(rig, world_frame='eye_optical')
    session = Session(other)
    session.set_intrinsics('cam0', encode_camera_info(intrinsics, START, 'eye_optical'))
    assert session.optical_frames()['cam0'] == 'cam0_optical_frame'
