# SPDX-License-Identifier: Apache-2.0
"""Intrinsics and poses from topics reach the session, and what changes is said once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from studio import (
    MATRIX,
    SECONDS,
    Studio,
    camera_pose,
    errors,
    feed,
    make_studio,
    with_camera,
    without_poses,
)

from rpgd_ros.core import RigidTransform
from rpgd_ros.core.geometry import so3_exp
from rpgd_ros.io.rig import Rig
from rpgd_ros.messages import Link, encode_camera_info, encode_tf
from rpgd_ros.session import CameraFacts, Session, solve

STUDIO_T_RIG = RigidTransform(so3_exp([0.0, 0.0, 0.7]), np.array([1.0, 2.0, 0.5]))
N_FRAMES = SECONDS * 30


@pytest.fixture(scope='module')
def studio() -> Studio:
    """Two cameras, twelve seconds."""
    return make_studio()


def placed_by_tf(rig: Rig) -> Rig:
    """Return a rig whose poses come from TF."""
    rig = without_poses(rig)
    return replace(
        rig, cameras=tuple(replace(c, frame_id=f'{c.name}_optical') for c in rig.cameras)
    )


def chain(name: str, camera_T_world: RigidTransform) -> list[Link]:
    """Return the way from the world to a camera's optical frame, over a mount."""
    rig_T_optical = STUDIO_T_RIG.inverse() @ camera_T_world.inverse()
    return [
        Link('studio', f'{name}_mount', STUDIO_T_RIG),
        Link(f'{name}_mount', f'{name}_optical', rig_T_optical),
    ]


def pose_of(rig: Rig, index: int) -> RigidTransform:
    """Return the true camera_T_world of a camera."""
    pose = rig.cameras[index].extrinsics
    assert pose is not None
    return pose


def test_cameras_are_placed_by_their_chains(studio: Studio) -> None:
    """Until then it is said what TF knows of their frames."""
    rig = placed_by_tf(studio.rig)
    session = feed(Session(rig), studio.messages, together=500)
    facts = CameraFacts(session, rig)
    assert set(facts.from_tf) == {'cam0', 'cam1'}
    assert 'TF has not named it yet' in facts.problems()['cam0']
    mount, optical = chain('cam0', pose_of(studio.rig, 0))
    facts.take_tf([encode_tf([optical])], is_static=True)
    assert "'cam0_optical' is not connected with 'studio'" in facts.problems()['cam0']
    assert "its parent there is 'cam0_mount'" in facts.problems()['cam0']
    facts.take_tf([encode_tf([mount])], is_static=True)
    assert set(facts.problems()) == {'cam1'}
    assert facts.take_tf([encode_tf(chain('cam1', pose_of(studio.rig, 1)))], is_static=True) == []
    assert facts.problems() == {}
    assert errors(solve(session.snapshot()))[0] < 0.1


def test_moving_frames_are_needed_only_where_the_static_ones_end(studio: Studio) -> None:
    """/tf carries every joint of a MoCap: nobody wants to hear it without need."""
    rig = placed_by_tf(studio.rig)
    facts = CameraFacts(Session(rig), rig)
    mount, optical = chain('cam0', pose_of(studio.rig, 0))
    facts.take_tf([encode_tf([mount])], is_static=False)
    facts.take_tf([encode_tf([optical, *chain('cam1', pose_of(studio.rig, 1))])], is_static=True)
    assert facts.are_all_placed
    assert facts.needs_moving_tf
    facts.take_tf([encode_tf([mount])], is_static=True)
    assert not facts.needs_moving_tf
    assert not CameraFacts(Session(studio.rig), studio.rig).needs_moving_tf


def test_a_moved_mount_starts_its_camera_over_and_is_said_with_figures(studio: Studio) -> None:
    """Noise of a repeated message is no movement; the other camera keeps its keypoints."""
    rig = placed_by_tf(studio.rig)
    session = feed(Session(rig), studio.messages, together=500)
    facts = CameraFacts(session, rig)
    for v in range(2):
        links = chain(f'cam{v}', pose_of(studio.rig, v))
        assert facts.take_tf([encode_tf(links)], is_static=False) == []
    nudge = RigidTransform(so3_exp([1e-7, 0.0, 0.0]), np.array([1e-6, 0.0, 0.0]))
    links = chain('cam0', nudge @ pose_of(studio.rig, 0))
    assert facts.take_tf([encode_tf(links)], is_static=False) == []
    assert session.counts('cam0')['kept'] == N_FRAMES
    moved = RigidTransform(so3_exp([0.0, np.radians(2.0), 0.0]), np.zeros(3))
    links = chain('cam0', moved @ pose_of(studio.rig, 0))
    (told,) = facts.take_tf([encode_tf(links)], is_static=False)
    assert 'camera cam0: its pose on TF moved by' in told
    assert '2.000 deg' in told
    assert f'its {N_FRAMES} messages of keypoints from before are dropped' in told
    assert session.counts('cam0')['kept'] == 0
    assert session.counts('cam1')['kept'] == N_FRAMES


def test_a_zoom_starts_its_camera_over_and_is_said_with_figures(studio: Studio) -> None:
    """The same message with another stamp is nothing new."""
    rig = with_camera(studio.rig, 0, camera=None, camera_info_topic='i')
    session = feed(Session(rig), studio.messages, together=500)
    facts = CameraFacts(session, rig)
    camera = studio.rig.cameras[0].camera
    assert camera is not None
    assert facts.problems() == {'cam0': 'no CameraInfo of cam0 has come on i'}
    assert facts.take_info('cam0', encode_camera_info(camera, 1, 'cam0')) == []
    assert facts.problems() == {}
    assert facts.have_all_intrinsics
    assert facts.take_info('cam0', encode_camera_info(camera, 2, 'cam0')) == []
    zoomed = replace(camera, matrix=MATRIX * [[1.1], [1.0], [1.0]])
    (told,) = facts.take_info('cam0', encode_camera_info(zoomed, 3, 'cam0'))
    assert 'camera cam0: its CameraInfo changed' in told
    assert 'fx 900 to 990 px' in told
    assert f'its {N_FRAMES} messages' in told
    assert session.counts('cam0')['kept'] == 0


def test_an_uncalibrated_camera_is_told_until_it_is_calibrated(studio: Studio) -> None:
    """The complaint comes once for the log, and stays for the status."""
    rig = with_camera(studio.rig, 0, camera=None, camera_info_topic='i')
    facts = CameraFacts(Session(rig), rig)
    camera = studio.rig.cameras[0].camera
    assert camera is not None
    good = encode_camera_info(camera, 1, 'cam0')
    start = good.index(MATRIX.astype('<f8').tobytes())
    bare = good[:start] + bytes(72) + good[start + 72 :]
    (told,) = facts.take_info('cam0', bare)
    assert "camera cam0: CameraInfo of 'cam0' is uncalibrated" in told
    assert facts.take_info('cam0', bare) == []
    assert facts.problems() == {'cam0': told}
    assert facts.take_info('cam0', good) == []
    assert facts.problems() == {}


def test_bytes_that_are_no_tf_are_said_once(studio: Studio) -> None:
    """What else comes is taken."""
    rig = placed_by_tf(studio.rig)
    facts = CameraFacts(Session(rig), rig)
    (told,) = facts.take_tf([b'\x00\x01\x00\x00ab'], is_static=True)
    assert 'not a tf2_msgs/msg/TFMessage' in told
    good = encode_tf(chain('cam0', pose_of(studio.rig, 0)))
    assert facts.take_tf([b'', good], is_static=True) == []
    assert set(facts.problems()) == {'cam1'}


def test_another_parent_of_the_mocap_frame_is_named(studio: Studio) -> None:
    """On TF a frame has one parent; below the world it is our own."""
    facts = CameraFacts(Session(studio.rig), studio.rig)
    assert facts.other_parent('vicon') == ''
    facts.take_tf([encode_tf([Link('studio', 'vicon', camera_pose(0.0))])], is_static=True)
    assert facts.other_parent('vicon') == ''
    facts.take_tf([encode_tf([Link('odom', 'vicon', camera_pose(0.0))])], is_static=True)
    assert facts.other_parent('vicon') == 'odom'
