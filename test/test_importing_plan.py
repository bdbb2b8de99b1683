# SPDX-License-Identifier: Apache-2.0
"""Streams on one clock: what frame numbers, rates and starts mean."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rpgd_ros.core.camera import Camera
from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import IntArray, RigidTransform
from rpgd_ros.importing.export import START_NS, rig_of, stamps, write_plan
from rpgd_ros.importing.keypoints import Detections
from rpgd_ros.importing.plan import ORDERS, CameraPlan, Plan, keypoint_joints, plan_camera
from rpgd_ros.importing.skeleton import Skeleton, SkeletonFile, settle
from rpgd_ros.io.recording import open_recording
from rpgd_ros.io.rig import read_rig
from rpgd_ros.messages import decode_joints
from rpgd_ros.skeletons import CONVENTIONS

MATRIX = np.array([[1000.0, 0, 960], [0, 1000, 540], [0, 0, 1]])
POSE = RigidTransform(np.eye(3), np.array([0.0, 0.0, 4.0]))
CAMERA = Camera('cam0', MATRIX, np.zeros(0), (1920, 1080), POSE)
JOINTS = CONVENTIONS['plug_in_gait']
KEYPOINTS = CONVENTIONS['coco17']


def make_skeleton(n_frames: int = 1000, start_s: float = 0.0) -> Skeleton:
    """Return 10 s of a body at 100 Hz."""
    values = np.random.default_rng(0).uniform(0.0, 1.0, (n_frames, len(JOINTS), 3))
    time_s = start_s + np.arange(n_frames) / 100.0
    return settle(SkeletonFile(Path('walk.trc'), 'TRC', JOINTS, time_s, values, 'm', 3))


def make_detections(frames: IntArray, **changes: Any) -> Detections:
    """Return keypoints in some frames."""
    uv = np.random.default_rng(1).uniform(100.0, 900.0, (len(frames), 17, 2))
    fields: dict[str, Any] = {'joints': None, 'n_empty': 0, 'n_others': 0, 'first': int(frames[0])}
    fields |= {'uv': uv, 'scores': np.ones((len(frames), 17))} | changes
    return Detections(Path('video.json'), 'COCO JSON', frames, **fields)


def plan(frames: IntArray, fps: float = 50.0, **options: Any) -> CameraPlan:
    """Plan one camera beside 10 s of a skeleton."""
    settings: dict[str, Any] = {'joints': KEYPOINTS, 'fps': fps} | options
    return plan_camera(make_skeleton(), CAMERA, make_detections(frames), **settings)


@pytest.mark.parametrize(
    ('frames', 'start_s', 'expected'),
    [
        (np.arange(500), None, 0.0),
        (np.arange(1, 501), None, 0.0),
        (np.arange(100, 500), None, 2.0),
        (np.arange(500), 1.5, 1.5),
        (np.arange(1, 501), -0.25, -0.25),
    ],
)
def test_first_frame_has_its_number_as_time(
    frames: IntArray, start_s: float | None, expected: float
) -> None:
    """Counted from 0, or from 1 where the first is number 1; moved by the start."""
    found = plan(frames, start_s=start_s)
    np.testing.assert_allclose(found.time_s, expected + np.arange(len(frames)) / 50.0)


@pytest.mark.parametrize(
    ('lowest', 'is_whole', 'taken'), [(1, True, 1), (0, False, 0), (1, False, 1), (7, True, 0)]
)
def test_number_of_the_first_frame_is_asked_for_where_it_is_in_doubt(
    lowest: int,
    is_whole: bool,  # noqa: FBT001
    taken: int,
) -> None:
    """Frames without anybody may come before the lowest, or it is a part of a video."""
    detections = make_detections(np.arange(lowest, 500), is_whole=is_whole)
    found = plan_camera(make_skeleton(), CAMERA, detections, joints=KEYPOINTS, fps=50.0)
    assert found.time_s[0] == pytest.approx((lowest - taken) / 50.0)
    is_sure = lowest == 0 or (lowest == 1 and is_whole)
    doubt = f'cam0: the lowest frame number is {lowest}, .* taken from {taken}, .*--first-frame'
    assert [w for w in found.warnings if re.search(doubt, w)] == [*found.warnings]
    assert bool(found.warnings) is not is_sure
    for asked in (0, 1):
        if asked <= lowest:
            options: dict[str, Any] = {'joints': KEYPOINTS, 'fps': 50.0, 'first_frame': asked}
            said = plan_camera(make_skeleton(), CAMERA, detections, **options)
            assert said.time_s[0] == pytest.approx((lowest - asked) / 50.0)
            assert said.warnings == ()


def test_first_frame_above_the_lowest_is_refused() -> None:
    """One of the two is wrong."""
    with pytest.raises(InputError, match=r'video.json: has a frame 0, but --first-frame says 1'):
        plan(np.arange(500), first_frame=1)


def test_frames_without_anybody_leave_gaps() -> None:
    """The clock goes on."""
    found = plan(np.array([0, 1, 5, 499]))
    np.testing.assert_allclose(found.time_s, [0.0, 0.02, 0.1, 9.98])


@pytest.mark.parametrize(('fps', 'right'), [(25.0, 50), (100.0, 50), (30.0, 50)])
def test_rate_that_contradicts_the_length_is_refused(fps: float, right: float) -> None:
    """500 frames beside 10 s are 50 Hz; a start that is given says that it is chance."""
    frames = np.arange(500)
    with pytest.raises(InputError, match=rf'--camera-fps cam0={right:g} .or --mocap-fps .*chance'):
        plan(frames, fps)
    assert plan(frames, fps, start_s=0.0).fps == fps


def test_recordings_of_different_length_are_taken() -> None:
    """The camera was switched off earlier; no common rate explains it."""
    assert len(plan(np.arange(430)).time_s) == 430


def test_recordings_that_never_meet_are_refused() -> None:
    """With both spans and the option that moves one."""
    with pytest.raises(InputError, match=r'from 20.000 to 29.980 s, the skeleton from 0.000 to'):
        plan(np.arange(500), start_s=20.0)


@pytest.mark.parametrize('last', [10**9, 5_000_000])
def test_frame_number_that_makes_a_recording_last_for_days_is_refused(last: int) -> None:
    """Of the identifiers of images, some are hashes; nothing is sampled along such a time."""
    frames = np.array([*range(499), last])
    with pytest.raises(InputError, match=rf'video.json: frames 0 to {last} last \S+ s at 50 Hz'):
        plan(frames, start_s=0.0)


@pytest.mark.parametrize('fps', [0.0, 1e-320, 1e-3, 3000.0, float('nan')])
def test_rate_that_no_camera_has_is_refused(fps: float) -> None:
    """The bounds are in the message."""
    with pytest.raises(InputError, match='is no frame rate, need 1 to 2000 Hz'):
        plan(np.arange(500), fps)


def test_names_of_the_files_need_no_option() -> None:
    """And an option goes before them."""
    detections = make_detections(np.arange(500), joints=KEYPOINTS)
    found = plan_camera(make_skeleton(), CAMERA, detections, joints=None, fps=50.0)
    assert found.joints == KEYPOINTS


def test_joints_that_do_not_match_are_refused_with_both_files() -> None:
    """Three pairs are the least."""
    names = tuple(f'marker{k}' for k in range(17))
    with pytest.raises(InputError, match=r'walk.trc, video.json: 0 .* Give joint_map') as no:
        plan(np.arange(500), joints=names)
    assert no.value.reason is Reason.BAD_RIG
    joint_map = {'marker0': 'LHipJC', 'marker1': 'RHipJC', 'marker2': 'LKneeJC'}
    assert len(plan(np.arange(500), joints=names, joint_map=joint_map).pairs) == 3


@pytest.mark.parametrize(
    ('text', 'joints'),
    [
        ('coco17', CONVENTIONS['coco17']),
        ('body25b', ORDERS['body25b']),
        ('a, b,c', ('a', 'b', 'c')),
    ],
)
def test_keypoint_names_are_a_convention_or_a_list(text: str, joints: tuple[str, ...]) -> None:
    """Also the orders that only files have."""
    assert keypoint_joints(text) == joints


def test_bag_and_rig_hold_what_was_planned(tmp_path: Path) -> None:
    """Bit for bit up to float32, in the order of time, with the rig's topics."""
    skeleton = make_skeleton(50, start_s=0.005)
    camera = plan(np.arange(25), start_s=0.0)
    whole = Plan(skeleton, (camera,), 'studio')
    write_plan(whole, tmp_path)
    rig = read_rig(tmp_path / 'rig.yaml')
    assert rig.world_frame == 'studio'
    assert rig.cameras[0].pairs == rig_of(whole).cameras[0].pairs == camera.pairs
    with open_recording(tmp_path / 'bag', rig) as recording:
        batches = list(recording.batches())
        assert recording.warnings == ()
    for batch in batches:
        is_mocap = batch.topic == rig.mocap.topic
        n_joints, n_values = (len(JOINTS), 3) if is_mocap else (17, 2)
        found = decode_joints(
            batch.msgtype,
            batch.payloads,
            n_joints=n_joints,
            n_values=3 if n_values == 3 else 2,
        ).batch
        assert found is not None
        source = skeleton if is_mocap else camera
        values = skeleton.x_mocap if is_mocap else camera.detections.uv
        np.testing.assert_array_equal(found.stamp_ns, stamps(source.time_s))
        np.testing.assert_allclose(found.values, values, rtol=1e-6)
        assert batch.receive_ns == sorted(batch.receive_ns)


def test_times_that_are_dates_become_stamps_of_the_same_day(tmp_path: Path) -> None:
    """Of Unix, as loggers write them: the first stamp of the recording is the first of the bag."""
    skeleton = make_skeleton(50, start_s=1.7e9)
    options: dict[str, Any] = {'joints': KEYPOINTS, 'fps': 50.0}
    detections = make_detections(np.arange(25))
    with pytest.raises(InputError, match=r'the skeleton from 1700000000.000 to .* --camera-start'):
        plan_camera(skeleton, CAMERA, detections, **options)
    camera = plan_camera(skeleton, CAMERA, detections, start_s=1.7e9 + 0.25, **options)
    write_plan(Plan(skeleton, (camera,), 'studio'), tmp_path)
    with open_recording(tmp_path / 'bag', read_rig(tmp_path / 'rig.yaml')) as recording:
        first: dict[str, int] = {}
        for batch in recording.batches():
            first.setdefault(batch.topic, batch.receive_ns[0])
    assert sorted(first.values()) == [START_NS, START_NS + 250_000_000]


def test_rate_that_is_asked_for_moves_no_date() -> None:
    """It stretches the recording, not the years before it."""
    file = make_skeleton(start_s=1.7e9).source
    found = settle(file, fps=50.0)
    np.testing.assert_allclose(found.time_s, 1.7e9 + np.arange(1000) / 50.0, rtol=0, atol=1e-6)


def test_stamps_count_from_a_fixed_day() -> None:
    """The same files give the same bag, and no stamp is zero."""
    assert stamps(np.array([0.0, 0.5, -0.5])).tolist() == [
        START_NS,
        START_NS + 500_000_000,
        START_NS - 500_000_000,
    ]
