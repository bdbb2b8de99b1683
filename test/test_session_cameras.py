# SPDX-License-Identifier: Apache-2.0
"""Intrinsics and poses of a session's cameras: from the file, from topics, missing, changed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from studio import (
    MATRIX,
    SECONDS,
    WORLD_T_MOCAP,
    Studio,
    camera_pose,
    errors,
    feed,
    make_studio,
    with_camera,
    without_poses,
)

from rpgd_ros.core import (
    CalibrationError,
    Camera,
    InputError,
    Reason,
    RigidTransform,
)
from rpgd_ros.messages import (
    encode_camera_info,
)
from rpgd_ros.session import MOCAP, Session, solve


@pytest.fixture(scope='module')
def studio() -> Studio:
    """Two cameras, twelve seconds."""
    return make_studio()


def test_single_camera_without_a_pose_is_the_world() -> None:
    """The answer is then the MoCap in that camera."""
    studio = make_studio(1)
    session = feed(Session(without_poses(studio.rig)), studio.messages, together=500)
    calibration = solve(session.snapshot())
    pose = studio.rig.cameras[0].extrinsics
    assert pose is not None
    expected = pose @ WORLD_T_MOCAP
    np.testing.assert_allclose(calibration.world_T_mocap.matrix, expected.matrix, atol=0.02)


def test_camera_that_tf_does_not_place_is_left_out_beside_one_that_has_a_pose(
    studio: Studio,
) -> None:
    """It is named, and the calibration is that of the others."""
    last = studio.rig.cameras[-1].name
    rig = with_camera(studio.rig, len(studio.rig.cameras) - 1, frame_id='eye', extrinsics=None)
    session = feed(Session(rig), studio.messages, together=500)
    found = solve(session.snapshot())
    assert list(found.per_camera) == [c.name for c in rig.cameras if c.name != last]
    assert any('a pose from TF' in w and last in w for w in found.warnings)
    assert errors(found)[0] < 0.2


def test_several_cameras_need_the_poses_that_tf_was_to_give(studio: Studio) -> None:
    """Those without are named; a pose from TF helps, and a new one starts the camera over."""
    rig = without_poses(studio.rig)
    for v in (0, 1):
        rig = with_camera(rig, v, frame_id=f'eye{v}')
    session = Session(rig)
    feed(session, studio.messages, together=500)
    with pytest.raises(
        CalibrationError, match=r"no extrinsics of cam0 \('eye0'\), cam1 \('eye1'\): TF"
    ) as refused:
        session.snapshot()
    assert refused.value.reason is Reason.NO_EXTRINSICS
    for camera in studio.rig.cameras:
        assert camera.extrinsics is not None
        session.set_extrinsics(camera.name, camera.extrinsics)
    assert errors(solve(session.snapshot()))[0] < 0.1
    session.set_extrinsics('cam0', camera_pose(0.3))
    assert session.counts('cam0')['kept'] == SECONDS * 30
    session.set_extrinsics('cam0', camera_pose(0.4))
    assert session.counts('cam0')['kept'] == 0
    session.set_extrinsics('cam1', camera_pose(0.3 + 1.9))
    assert session.counts('cam1')['kept'] == SECONDS * 30


def test_pose_of_the_rig_file_goes_before_tf(studio: Studio) -> None:
    """A transform on TF does not move a camera that the file places."""
    session = feed(Session(studio.rig), studio.messages, together=500)
    session.set_extrinsics('cam0', RigidTransform.identity())
    assert errors(solve(session.snapshot()))[0] < 0.1


def info_of(camera: Camera, stamp_ns: int = 1) -> bytes:
    """Return the CameraInfo of a camera."""
    return encode_camera_info(camera, stamp_ns, f'{camera.name}_optical_frame')


def test_camera_without_intrinsics_is_left_out_with_a_warning(studio: Studio) -> None:
    """The rest is calibrated; when the CameraInfo comes, the camera takes part."""
    rig = studio.rig
    for v in range(2):
        rig = with_camera(rig, v, camera=None, camera_info_topic=f'cam{v}/info')
    session = feed(Session(rig), studio.messages, together=500)
    assert session.camera_info_topics() == {'cam0/info': 'cam0', 'cam1/info': 'cam1'}
    with pytest.raises(CalibrationError, match='arrived on cam0/info, cam1/info') as refused:
        session.snapshot()
    assert refused.value.reason is Reason.MISSING_INTRINSICS
    cameras = [c.camera for c in studio.rig.cameras if c.camera is not None]
    session.set_intrinsics('cam1', info_of(cameras[1]))
    taken = session.snapshot()
    assert taken.left_out == ('cam0',)
    assert [c.name for c in taken.cameras] == ['cam1']
    calibration = solve(taken)
    assert any('cam0' in warning for warning in calibration.warnings)
    session.set_intrinsics('cam0', info_of(cameras[0]))
    assert session.snapshot().left_out == ()
    assert errors(solve(session.snapshot()))[0] < 0.1


@pytest.mark.fault(16)
def test_changed_intrinsics_start_the_camera_over(studio: Studio) -> None:
    """The same CameraInfo again changes nothing; another one is never mixed with the old."""
    rig = with_camera(studio.rig, 0, camera=None, camera_info_topic='i')
    session = feed(Session(rig), studio.messages, together=500)
    camera = studio.rig.cameras[0].camera
    assert camera is not None
    for stamp in (5, 6):
        session.set_intrinsics('cam0', info_of(camera, stamp))
        assert session.counts('cam0')['kept'] == SECONDS * 30
    zoomed = replace(camera, matrix=MATRIX * [[1.1], [1.1], [1.0]])
    session.set_intrinsics('cam0', info_of(zoomed))
    assert session.counts('cam0')['kept'] == 0
    assert session.counts('cam0')['cleared'] == SECONDS * 30
    assert session.counts('cam1')['kept'] == SECONDS * 30
    assert session.snapshot().cameras[0].matrix[0, 0] == pytest.approx(990.0)


def test_what_changed_in_a_camera_info_is_said(studio: Studio) -> None:
    """Size and frame with both values; what has no short figure by its kind."""
    rig = with_camera(studio.rig, 0, camera=None, camera_info_topic='i')
    session = Session(rig)
    camera = studio.rig.cameras[0].camera
    assert camera is not None
    halved = replace(camera, size=(640, 360))
    bent = replace(halved, distortion=np.array([0.1, 0.0, 0.0, 0.0, 0.0]))
    told = []
    for sent, frame in ((camera, 'a'), (halved, 'a'), (halved, 'b'), (bent, 'b')):
        feed(session, studio.of('cam0')[:9])
        told.append(session.set_intrinsics('cam0', encode_camera_info(sent, 1, frame)))
    assert [text.partition('; ')[0] for text in told] == [
        '',
        'camera cam0: its CameraInfo changed (size 1280 x 720 to 640 x 360)',
        "camera cam0: its CameraInfo changed (frame 'a' to 'b')",
        'camera cam0: its CameraInfo changed (distortion or rectification)',
    ]


def test_intrinsics_of_the_rig_file_go_before_camera_info(studio: Studio) -> None:
    """A driver's default CameraInfo does not overrule what the user wrote."""
    session = feed(Session(studio.rig), studio.messages, together=500)
    camera = studio.rig.cameras[0].camera
    assert camera is not None
    session.set_intrinsics('cam0', info_of(replace(camera, matrix=np.diag([1.0, 1.0, 1.0]))))
    assert session.snapshot().cameras[0].matrix[0, 0] == 900.0


def test_bad_camera_info_is_refused_and_changes_nothing(studio: Studio) -> None:
    """Cut bytes, or a camera that was never calibrated."""
    session = Session(with_camera(studio.rig, 0, camera=None, camera_info_topic='i'))
    with pytest.raises(InputError):
        session.set_intrinsics('cam0', b'\x00\x01\x00\x00abc')
    with pytest.raises(InputError, match='no camera') as refused:
        session.set_intrinsics('cam9', b'')
    assert refused.value.reason is Reason.UNKNOWN_CAMERA


def test_silent_camera_beside_one_without_intrinsics_is_named(studio: Studio) -> None:
    """The only camera that could be used sends nothing, and the other cannot be used."""
    rig = with_camera(studio.rig, 0, camera=None, camera_info_topic='i')
    session = feed(Session(rig), studio.of(MOCAP) + studio.of('cam0'), together=500)
    with pytest.raises(CalibrationError, match=r'cam1 .*; without intrinsics: cam0') as refused:
        session.snapshot()
    assert refused.value.reason is Reason.NO_DATA


def test_pose_from_tf_reaches_a_camera_with_camera_info(studio: Studio) -> None:
    """Intrinsics and pose may come in either order."""
    camera = studio.rig.cameras[0].camera
    pose = studio.rig.cameras[0].extrinsics
    assert camera is not None
    assert pose is not None
    bare = with_camera(studio.rig, 0, camera=None, camera_info_topic='i', extrinsics=None)
    for pose_first in (True, False):
        session = feed(Session(bare), studio.messages, together=500)
        if pose_first:
            session.set_extrinsics('cam0', pose)
        session.set_intrinsics('cam0', info_of(camera))
        if not pose_first:
            session.set_extrinsics('cam0', pose)
        assert errors(solve(session.snapshot()))[0] < 0.1
