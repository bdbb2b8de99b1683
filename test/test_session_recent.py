# SPDX-License-Identifier: Apache-2.0
"""What is handed out once: new pairs, the newest skeleton, the cameras that stand somewhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from studio import JOINTS, START, S, Studio, feed, make_studio, with_camera, without_poses

from rpgd_ros.core import RigidTransform
from rpgd_ros.core.config import AcceptConfig
from rpgd_ros.session import MOCAP, Session
from rpgd_ros.session.monitor import Monitor
from rpgd_ros.session.recent import Recent


@pytest.fixture(scope='module')
def studio() -> Studio:
    """Two cameras, twelve seconds."""
    return make_studio()


def sent(
    studio: Studio, begin_s: float, end_s: float, *streams: str
) -> list[tuple[str, bytes, int]]:
    """Return the messages of a stretch of time, of some streams or all."""
    return [
        m
        for m in studio.messages
        if begin_s <= (m[2] - START) / S < end_s and (not streams or m[0] in streams)
    ]


def handed_out(recent: Recent) -> dict[str, int]:
    """Return the number of frames of each camera that has new ones."""
    return {new.camera.name: new.view.n_frames for new in recent.take()}


def test_newest_skeleton_is_nobodys_but_the_askers(studio: Studio) -> None:
    """None before the first; then a copy, which later messages leave alone."""
    session = Session(studio.rig)
    recent = Recent(session)
    assert recent.skeleton() is None
    skeletons = studio.of(MOCAP)
    feed(session, skeletons[:100])
    newest = recent.skeleton()
    assert newest is not None
    stamp_ns, x = newest
    assert stamp_ns == skeletons[99][2] - 7
    before = x.copy()
    feed(session, skeletons[100:200])
    assert np.array_equal(x, before)
    again = recent.skeleton()
    assert again is not None
    assert again[0] == skeletons[199][2] - 7
    assert x.shape == (len(recent.joint_names()), 3)
    assert set(recent.joint_names()) <= set(JOINTS)


def test_keypoints_wait_for_skeletons_and_intrinsics(studio: Studio) -> None:
    """Neither a camera of unknown lens nor one without MoCap is handed out, nor drawn."""
    session = Session(with_camera(studio.rig, 0, camera=None, camera_info_topic='i'))
    recent = Recent(session)
    feed(session, sent(studio, 0.0, 1.0, 'cam0', 'cam1'), together=100)
    assert handed_out(recent) == {}
    feed(session, sent(studio, 0.0, 1.0, MOCAP), together=100)
    assert handed_out(recent) == {'cam1': 30}
    assert [camera.name for camera in recent.cameras()] == ['cam1']


def test_frames_before_the_first_skeleton_are_not_handed_out(studio: Studio) -> None:
    """They will never have one."""
    session = Session(studio.rig)
    recent = Recent(session)
    feed(session, sent(studio, 0.0, 1.0, 'cam0'), together=100)
    feed(session, sent(studio, 2.0, 3.0, MOCAP), together=100)
    assert handed_out(recent) == {}
    feed(session, sent(studio, 2.0, 3.0, 'cam0'), together=100)
    assert handed_out(recent)['cam0'] in {29, 30}


def test_recording_that_begins_again_is_handed_out_again(studio: Studio) -> None:
    """After a reset, which no clock tells of."""
    session = Session(studio.rig)
    recent = Recent(session)
    feed(session, sent(studio, 0.0, 2.0), together=100)
    first = handed_out(recent)
    assert handed_out(recent) == {}
    session.reset()
    feed(session, sent(studio, 0.0, 1.0), together=100)
    again = handed_out(recent)
    assert set(again) == set(first) == {'cam0', 'cam1'}
    assert all(again[name] < first[name] for name in first)


def test_looped_recording_is_seen_from_its_start(studio: Studio) -> None:
    """The clock jumps back: coverage begins anew, and the new side is handed out whole."""
    session = Session(studio.rig)
    monitor = Monitor(session, max_age_s=300.0)
    assert monitor.look() == []
    feed(session, sent(studio, 0.0, 12.0), together=12)
    monitor.look()
    assert monitor.guidance(AcceptConfig(), 1.0).seconds == pytest.approx(12.0, abs=1.1)
    feed(session, sent(studio, 0.0, 3.0), together=12)
    assert session.n_epochs == 1
    assert {new.camera.name: new.view.n_frames for new in monitor.look()} == {
        'cam0': 90,
        'cam1': 90,
    }
    assert monitor.guidance(AcceptConfig(), 1.0).seconds == pytest.approx(3.0, abs=1.1)


def test_only_camera_of_a_rig_is_the_world(studio: Studio) -> None:
    """It stands at the origin; of two without poses nobody knows where they stand."""
    both = without_poses(studio.rig)
    assert Recent(Session(both)).cameras() == []
    (camera,) = Recent(Session(replace(both, cameras=both.cameras[:1]))).cameras()
    assert camera.camera_T_world is not None
    assert np.array_equal(camera.camera_T_world.matrix, np.eye(4))
    placed = Recent(Session(both), poses={'cam1': RigidTransform.identity()})
    assert [camera.name for camera in placed.cameras()] == ['cam1']
