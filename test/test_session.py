# SPDX-License-Identifier: Apache-2.0
"""The whole job without ROS: bytes in, observations and a calibration out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from rpgd_ros.core import (
    Calibration,
    CalibrationConfig,
    CalibrationError,
    Camera,
    InputError,
    Reason,
    RigidTransform,
)
from rpgd_ros.core.geometry import Array, rotation_angle, so3_exp
from rpgd_ros.io.rig import MocapSource, Rig, RigCamera
from rpgd_ros.messages import (
    POINT_CLOUD2,
    POSE_ARRAY,
    encode_camera_info,
    encode_point_cloud2,
    encode_pose_array,
)
from rpgd_ros.pairing import BufferConfig, PairCounts, SyncConfig
from rpgd_ros.session import MOCAP, Session, SessionConfig, Snapshot, snapshot, solve
from rpgd_ros.skeletons import CONVENTIONS, match_joints

S = 1_000_000_000
START = 1_700_000_000 * S
SECONDS = 12
MOCAP_PERIOD = S // 120
CAMERA_PERIOD = S // 30
SIZE = (1280, 720)
MATRIX = np.array([[900.0, 0, 640.0], [0, 900.0, 360.0], [0, 0, 1.0]])
JOINTS = CONVENTIONS['plug_in_gait']
KEYPOINTS = CONVENTIONS['coco17']
PAIRS = match_joints(JOINTS, KEYPOINTS)
WORLD_T_MOCAP = RigidTransform(so3_exp([0.2, -0.4, 1.1]), np.array([0.5, -1.0, 0.3]))

Message = tuple[str, bytes, int]  # stream, payload, receive stamp


def camera_pose(angle: float) -> RigidTransform:
    """Return camera_T_world of a camera 5 m from the middle that looks at it; z is up."""
    x_axis = np.array([-np.sin(angle), np.cos(angle), 0.0])
    z_axis = -np.array([np.cos(angle), np.sin(angle), 0.0])
    rotation = np.stack([x_axis, np.cross(z_axis, x_axis), z_axis])
    return RigidTransform(rotation, -rotation @ (np.array([0.0, 0.0, 1.0]) - 5.0 * z_axis))


def body_at(stamps: Sequence[int]) -> Array:
    """Return a walking body (F, 12, 3) in the world: it crosses the room, turns, swings limbs."""
    t = (np.asarray(stamps)[:, None] - START) / S
    rest = np.random.default_rng(5).uniform([-0.4, -0.3, 0.1], [0.4, 0.3, 1.7], (12, 3))
    swing = 0.15 * np.sin(2.0 * t + np.arange(12))
    x, y = rest[:, 0] + swing, rest[:, 1]
    turn = 0.4 * t
    return np.stack(
        [
            x * np.cos(turn) - y * np.sin(turn) + 1.5 * np.sin(0.5 * t),
            x * np.sin(turn) + y * np.cos(turn) + 1.2 * np.cos(0.7 * t),
            np.broadcast_to(rest[:, 2], x.shape),
        ],
        -1,
    )


@dataclass(frozen=True)
class Studio:
    """A rig, and what its topics carry."""

    rig: Rig
    messages: tuple[Message, ...]

    def of(self, stream: str) -> list[Message]:
        """Return the messages of one stream."""
        return [m for m in self.messages if m[0] == stream]


def make_rig(n_cameras: int = 2) -> Rig:
    """Return cameras around the room, with everything known."""
    cameras = []
    for v in range(n_cameras):
        pose = camera_pose(0.3 + 1.9 * v)
        name = f'cam{v}'
        camera = Camera(name, MATRIX, np.zeros(0), SIZE, pose)
        cameras.append(
            RigCamera(name, f'{name}/kp', KEYPOINTS, PAIRS, camera=camera, extrinsics=pose)
        )
    return Rig('studio', MocapSource('mocap/skeleton', JOINTS), tuple(cameras))


def make_studio(n_cameras: int = 2, *, scale: float = 1.0, late_ns: int = 0) -> Studio:
    """Walk through the room.

    Args:
        n_cameras: Of the rig.
        scale: Units per metre of the skeleton.
        late_ns: How late the video is stamped.

    """
    rig = make_rig(n_cameras)
    messages: list[Message] = []
    mocap_ns = [START + i * MOCAP_PERIOD for i in range(SECONDS * 120)]
    x_mocap = WORLD_T_MOCAP.inverse() @ body_at(mocap_ns)
    for stamp, x in zip(mocap_ns, x_mocap, strict=True):
        messages.append((MOCAP, encode_point_cloud2(stamp, 'vicon', x * scale, None), stamp + 7))
    rng = np.random.default_rng(1)
    for v, camera in enumerate(rig.cameras):
        camera_ns = [START + v * 1_234_567 + i * CAMERA_PERIOD for i in range(SECONDS * 30)]
        assert camera.camera is not None
        seen = camera.camera.project(body_at(camera_ns)) + rng.normal(0, 0.5, (1, 12, 2))
        uv = np.full((len(camera_ns), 17, 2), np.nan)
        for j, k in PAIRS:
            uv[:, k] = seen[:, j]
        scores = np.linspace(0.1, 1.0, 17)
        for stamp, pixels in zip(camera_ns, uv, strict=True):
            payload = encode_point_cloud2(stamp + late_ns, camera.name, pixels, scores)
            messages.append((camera.name, payload, stamp + 9))
    messages.sort(key=lambda m: m[2])
    return Studio(rig, tuple(messages))


@pytest.fixture(scope='module')
def studio() -> Studio:
    """Two cameras, twelve seconds."""
    return make_studio()


def feed(session: Session, messages: Sequence[Message], *, together: int = 1) -> Session:
    """Hand messages to a session, in runs of one stream of at most so many."""
    for i in range(0, len(messages), together):
        by_stream: dict[str, list[Message]] = {}
        for m in messages[i : i + together]:
            by_stream.setdefault(m[0], []).append(m)
        for stream, part in by_stream.items():
            session.add(stream, POINT_CLOUD2, [m[1] for m in part], [m[2] for m in part])
    return session


def bits(taken: Snapshot) -> tuple[bytes, ...]:
    """Return all numbers of a snapshot's observations."""
    observations = taken.observations
    assert observations.mocap is not None
    arrays: list[NDArray[Any] | None] = [observations.mocap.x_mocap]
    for view in observations.views:
        arrays += [view.stamp_ns, view.x_mocap, view.uv, view.confidence]
    return tuple(a.tobytes() for a in arrays if a is not None)


def with_camera(rig: Rig, index: int, **changes: object) -> Rig:
    """Return a rig with one camera changed."""
    cameras = list(rig.cameras)
    cameras[index] = replace(cameras[index], **changes)  # type: ignore[arg-type]
    return replace(rig, cameras=tuple(cameras))


def without_poses(rig: Rig) -> Rig:
    """Return a rig whose cameras have no extrinsics."""
    cameras = []
    for c in rig.cameras:
        assert c.camera is not None
        blind = replace(c.camera, camera_T_world=None)
        cameras.append(replace(c, camera=blind, extrinsics=None))
    return replace(rig, cameras=tuple(cameras))


def errors(calibration: Calibration) -> tuple[float, float]:
    """Return the rotation error in degrees and the position error in the room in metres."""
    delta = calibration.world_T_mocap @ WORLD_T_MOCAP.inverse()
    return np.degrees(rotation_angle(delta.rotation)), float(
        np.linalg.norm(delta @ np.array([0.0, 0.0, 1.0]) - [0.0, 0.0, 1.0])
    )


def test_bytes_of_a_walk_give_the_transform(studio: Studio) -> None:
    """The main job: messages in, world_T_mocap out."""
    session = feed(Session(studio.rig), studio.messages)
    calibration = solve(session.snapshot())
    degrees, metres = errors(calibration)
    assert degrees < 0.1
    assert metres < 0.005
    assert set(calibration.per_camera) == {'cam0', 'cam1'}
    assert session.mocap_frame == 'vicon'


def test_replay_in_batches_gives_the_bits_of_the_live_run(studio: Studio) -> None:
    """One by one, in batches, shuffled or doubled: the same observations, the same pose."""
    live = feed(Session(studio.rig), studio.messages).snapshot()
    order = np.argsort(
        np.arange(len(studio.messages))
        + np.random.default_rng(3).uniform(0, 9, len(studio.messages))
    )
    shuffled = [studio.messages[i] for i in order]
    doubled = [m for i, m in enumerate(shuffled) for _ in range(1 + (i % 5 == 0))]
    for messages, together in ((studio.messages, 50), (studio.messages, 10**6), (doubled, 64)):
        replay = feed(Session(studio.rig), messages, together=together).snapshot()
        assert bits(replay) == bits(live)
    calibrations = [solve(taken) for taken in (live, replay)]
    first, second = (c.world_T_mocap.matrix.tobytes() for c in calibrations)
    assert first == second


def test_pose_arrays_are_read_as_well(studio: Studio) -> None:
    """A skeleton as PoseArray, keypoints as PointCloud2."""
    session = Session(studio.rig)
    stamps = [START + i * MOCAP_PERIOD for i in range(600)]
    x = WORLD_T_MOCAP.inverse() @ body_at(stamps)
    payloads = [encode_pose_array(s, 'vicon', p) for s, p in zip(stamps, x, strict=True)]
    session.add(MOCAP, POSE_ARRAY, payloads, stamps)
    feed(session, studio.of('cam0'), together=100)
    view = session.snapshot().observations.views[0]
    assert view.n_frames == 150
    np.testing.assert_allclose(view.x_mocap[0], x[0], atol=0.02)


@pytest.mark.parametrize(
    ('units', 'per_metre'), [('mm', 1000.0), ('cm', 100.0), ('inch', 1 / 0.0254)]
)
def test_units_are_turned_to_metres(units: str, per_metre: float) -> None:
    """What the rig file says of the skeleton's unit."""
    studio = make_studio(1, scale=per_metre)
    rig = replace(studio.rig, mocap=replace(studio.rig.mocap, units=units))  # type: ignore[arg-type]
    session = feed(Session(rig), studio.messages, together=500)
    assert errors(solve(session.snapshot()))[0] < 0.5


def test_columns_are_the_joints_that_some_camera_sees(studio: Studio) -> None:
    """In the MoCap's order; a camera has NaN in the columns of others."""
    rig = with_camera(studio.rig, 0, pairs=PAIRS[:5])
    rig = with_camera(rig, 1, pairs=PAIRS[3:8])
    taken = feed(Session(rig), studio.messages, together=1000).snapshot()
    columns = sorted({j for j, _ in PAIRS[:8]})
    assert taken.observations.joint_names == tuple(JOINTS[j] for j in columns)
    for view, pairs in zip(taken.observations.views, (PAIRS[:5], PAIRS[3:8]), strict=True):
        seen = ~np.isnan(view.uv[..., 0]).all(0)
        assert [columns[c] for c in np.flatnonzero(seen)] == sorted(j for j, _ in pairs)
        assert view.confidence is not None
        np.testing.assert_array_equal(np.isnan(view.confidence[0]), ~seen)


def test_keypoints_below_the_confidence_are_missing(studio: Studio) -> None:
    """Counted when they come, taken out of the snapshot; a new limit holds for all."""
    rig = with_camera(studio.rig, 0, min_confidence=0.45)
    session = feed(Session(rig), studio.messages, together=100)
    uv = session.snapshot().observations.views[0].uv
    # Scores rise with the keypoint's number: 5 and 6, the shoulders, are below 0.45.
    shoulders = [j for j, k in PAIRS if k in {5, 6}]
    assert np.isnan(uv[:, shoulders]).all()
    assert np.isfinite(np.delete(uv, shoulders, axis=1)).all()
    assert session.counts('cam0')['low_confidence'] == 2 * SECONDS * 30
    session.update_camera('cam0', time_offset_s=0.0, min_confidence=0.0)
    assert np.isfinite(session.snapshot().observations.views[0].uv).all()


@pytest.mark.parametrize('units', ['normalized', 'auto', 'pixels'])
def test_keypoints_may_be_shares_of_the_image(studio: Studio, units: str) -> None:
    """Said so, or told by their size; pixels stay pixels."""
    rig = with_camera(studio.rig, 0, units=units)
    session = feed(Session(rig), studio.of(MOCAP), together=1000)
    sent = np.full((17, 2), [0.5, 0.25])
    payloads = [encode_point_cloud2(START + i * CAMERA_PERIOD, 'c', sent, None) for i in range(30)]
    session.add('cam0', POINT_CLOUD2, payloads, [0] * 30)
    view = session.snapshot().observations.views[0]
    expected = [0.5, 0.25] if units == 'pixels' else [640.0, 180.0]
    np.testing.assert_allclose(view.uv, np.broadcast_to(expected, view.uv.shape))
    assert view.confidence is None


def test_known_offset_moves_the_video(monkeypatch: pytest.MonkeyPatch) -> None:
    """Views stand on the MoCap's clock; estimated offsets are told of the stamps as sent."""
    studio = make_studio(1, late_ns=50_000_000)
    rig = with_camera(studio.rig, 0, time_offset_s=0.07)
    rig = replace(rig, mocap=replace(rig.mocap, time_offset_s=0.02))
    taken = feed(Session(rig), studio.messages, together=500).snapshot()
    (view,) = taken.observations.views
    assert view.stamp_ns is not None
    assert (view.stamp_ns - START).tolist()[:2] == [0, CAMERA_PERIOD]
    calibration = solve(taken)
    assert errors(calibration)[0] < 0.5

    def estimate(*arguments: object, **keywords: object) -> Calibration:
        del arguments, keywords
        return replace(calibration, time_offset_s={'cam0': (0.001, 0.0005)})

    monkeypatch.setattr(snapshot, 'calibrate', estimate)
    offset_s, sigma_s = solve(taken).time_offset_s['cam0']
    assert offset_s == pytest.approx(0.051)
    assert sigma_s == 0.0005


def test_time_of_arrival_stands_in_for_missing_stamps(studio: Studio) -> None:
    """With use_receive_time, messages without a stamp are paired by their arrival."""
    stamps = [START + i * CAMERA_PERIOD for i in range(60)]
    x = np.zeros((12, 3)) + 1.0
    uv = np.zeros((17, 2)) + 100.0
    config = SessionConfig(sync=SyncConfig(use_receive_time=True))
    for chosen, kept in ((config, 60), (SessionConfig(), 0)):
        session = Session(studio.rig, chosen)
        session.add(MOCAP, POINT_CLOUD2, [encode_point_cloud2(0, 'm', x, None)] * 60, stamps)
        session.add('cam0', POINT_CLOUD2, [encode_point_cloud2(0, 'c', uv, None)] * 60, stamps)
        assert session.counts(MOCAP)['kept'] == kept
        assert session.counts(MOCAP).get('zero_stamp', 0) == 60 - kept
        assert session.pair_counts()['cam0'] == PairCounts(kept, 0)


def test_every_message_is_counted_under_one_reason(studio: Studio) -> None:
    """Received is the sum of kept and dropped; missing joints are counted beside."""
    session = Session(studio.rig)
    x = np.ones((12, 3))
    x[0], x[1] = np.nan, 0.0
    good = [encode_point_cloud2(START + i * MOCAP_PERIOD, 'vicon', x, None) for i in range(10)]
    cut = good[3][:-20]
    few = encode_point_cloud2(START, 'vicon', x[:11], None)
    other = encode_point_cloud2(START, 'vicon2', x, None)
    unstamped = encode_point_cloud2(0, 'vicon', x, None)
    far = encode_point_cloud2(START + 3600 * S, 'vicon', x, None)
    payloads = [*good, cut, b'', few, other, unstamped, far, good[4]]
    session.add(MOCAP, POINT_CLOUD2, payloads, [0] * len(payloads))
    session.add(MOCAP, 'std_msgs/msg/String', [b'abc'], [0])
    counts = dict(session.counts(MOCAP))
    assert counts.pop('nan') == 12
    assert counts.pop('zero') == 12
    assert counts.pop('received') == len(payloads) + 1 == sum(counts.values())
    assert counts['kept'] == 10
    for reason, n in {
        'malformed': 2,
        'wrong_joints': 1,
        'frame_changed': 1,
        'zero_stamp': 1,
        'jump_held': 1,
        'duplicate': 1,
        'wrong_type': 1,
    }.items():
        assert counts[reason] == n, reason


def test_zero_is_a_place_where_the_user_says_so(studio: Studio) -> None:
    """With zero_is_missing off, a joint at the origin is a joint."""
    x = np.ones((12, 3))
    x[1] = 0.0
    for is_missing in (True, False):
        session = Session(studio.rig, SessionConfig(zero_is_missing=is_missing))
        payloads = [encode_point_cloud2(START + i, 'vicon', x, None) for i in range(10)]
        session.add(MOCAP, POINT_CLOUD2, payloads, [0] * 10)
        assert session.counts(MOCAP).get('zero', 0) == 10 * is_missing


def test_empty_session_names_what_is_silent(studio: Studio) -> None:
    """Each silent stream with its topic, and what became of its messages."""
    session = Session(studio.rig)
    with pytest.raises(CalibrationError, match=r'mocap \(mocap/skeleton; 0 received') as refused:
        session.snapshot()
    assert refused.value.reason is Reason.NO_DATA
    feed(session, studio.of(MOCAP), together=100)
    few = encode_point_cloud2(START, 'c', np.ones((5, 2)), None)
    session.add('cam1', POINT_CLOUD2, [few] * 3, [0] * 3)
    with pytest.raises(
        CalibrationError, match=r'cam1 \(cam1/kp; 3 received: 3 wrong_joints'
    ) as refused:
        session.snapshot()
    assert 'mocap' not in refused.value.message
    assert session.motion_m() > 1.0


def test_one_silent_camera_does_not_stop_the_others(studio: Studio) -> None:
    """Its view is empty."""
    messages = studio.of(MOCAP) + studio.of('cam1')
    taken = feed(Session(studio.rig), messages, together=1000).snapshot()
    assert [view.n_frames for view in taken.observations.views] == [0, SECONDS * 30]
    assert taken.pair_counts['cam0'] == PairCounts(0, 0)
    assert errors(solve(taken))[0] < 0.5


def test_clocks_that_never_meet_are_named_with_their_distance() -> None:
    """An unsynchronised camera: how far apart, and what to do."""
    studio = make_studio(1, late_ns=-100 * S)
    session = feed(Session(studio.rig), studio.messages, together=1000)
    with pytest.raises(
        CalibrationError, match=r'cam0 88\.0\d\d s\. Synchronise the clocks'
    ) as refused:
        session.snapshot()
    assert refused.value.reason is Reason.NO_DATA


def test_single_camera_without_a_pose_is_the_world() -> None:
    """The answer is then the MoCap in that camera."""
    studio = make_studio(1)
    session = feed(Session(without_poses(studio.rig)), studio.messages, together=500)
    calibration = solve(session.snapshot())
    pose = studio.rig.cameras[0].extrinsics
    assert pose is not None
    expected = pose @ WORLD_T_MOCAP
    np.testing.assert_allclose(calibration.world_T_mocap.matrix, expected.matrix, atol=0.02)


def test_several_cameras_need_their_poses(studio: Studio) -> None:
    """Those without are named; a pose from TF helps, and a new one starts the camera over."""
    session = Session(without_poses(studio.rig))
    feed(session, studio.messages, together=500)
    with pytest.raises(CalibrationError, match='no extrinsics of cam0, cam1: each') as refused:
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


def test_looped_bag_starts_over_once(studio: Studio) -> None:
    """After the loop only the new side is there, in all streams, and nothing of it is lost."""
    session = Session(studio.rig)
    feed(session, studio.messages, together=12)
    expected = bits(session.snapshot())
    feed(session, studio.messages, together=12)
    assert session.n_epochs == 1
    assert bits(session.snapshot()) == expected


def test_snapshot_is_not_touched_by_what_comes_later(studio: Studio) -> None:
    """Late, doubled and further messages, a reset: the pairs are those of its moment."""
    half = len(studio.messages) // 2
    early = feed(Session(studio.rig), studio.messages[:half], together=100)
    expected = bits(early.snapshot())
    taken = early.snapshot()
    feed(early, studio.messages[half - 30 :], together=10)
    early.reset()
    feed(early, studio.messages[::-1], together=10)
    assert bits(taken) == expected


def test_reset_drops_messages_and_keeps_the_cameras(studio: Studio) -> None:
    """The next walk may even be in another frame."""
    session = feed(Session(studio.rig), studio.messages, together=1000)
    session.reset()
    assert session.counts(MOCAP)['kept'] == 0
    assert session.motion_m() == 0.0
    assert session.mocap_frame == ''
    feed(session, studio.messages, together=1000)
    assert session.counts(MOCAP)['kept'] == SECONDS * 120


def test_new_settings_hold_from_the_next_snapshot_on(studio: Studio) -> None:
    """Also the bounds of the buffers."""
    session = feed(Session(studio.rig), studio.messages, together=1000)
    before = session.snapshot()
    config = SessionConfig(
        calibration=CalibrationConfig.paper(), buffer=BufferConfig(max_frames=100)
    )
    session.update_config(config)
    assert session.counts(MOCAP)['kept'] == 100
    after = session.snapshot()
    assert after.config == config.calibration
    assert before.config == SessionConfig().calibration
    assert before.observations.views[0].n_frames == SECONDS * 30


def test_skeletons_in_the_world_frame_are_refused(studio: Studio) -> None:
    """A driver that calls its root like the rig's world: no transform could be published."""
    rig = replace(studio.rig, world_frame='vicon')
    session = feed(Session(rig), studio.messages, together=1000)
    with pytest.raises(CalibrationError, match="'vicon', which is also world_frame") as refused:
        session.snapshot()
    assert refused.value.reason is Reason.BAD_RIG
    renamed = replace(rig, mocap=replace(rig.mocap, frame='mocap_root'))
    session = feed(Session(renamed), studio.messages, together=1000)
    assert session.mocap_frame == 'mocap_root'
    assert session.snapshot().cameras


def test_motion_is_the_way_of_the_body(studio: Studio) -> None:
    """A walk over 3 by 2.4 m; a standing person does not move, whatever is missing."""
    assert 2.5 < feed(Session(studio.rig), studio.of(MOCAP), together=100).motion_m() < 4.5
    session = Session(studio.rig)
    rng = np.random.default_rng(0)
    payloads = []
    for i in range(200):
        x = np.ones((12, 3)) * np.arange(1, 13)[:, None] / 6.0
        x[rng.integers(12)] = np.nan
        payloads.append(encode_point_cloud2(START + i * MOCAP_PERIOD, 'v', x, None))
    session.add(MOCAP, POINT_CLOUD2, payloads, [0] * 200)
    assert session.motion_m() < 0.2


def test_streams_and_topics_are_those_of_the_rig(studio: Studio) -> None:
    """Names for the node's subscriptions."""
    session = Session(studio.rig)
    assert session.streams == (MOCAP, 'cam0', 'cam1')
    assert session.topics() == {
        'mocap/skeleton': MOCAP,
        'cam0/kp': 'cam0',
        'cam1/kp': 'cam1',
    }
    with pytest.raises(InputError, match="no stream 'cam7'; there are mocap, cam0, cam1"):
        session.add('cam7', POINT_CLOUD2, [], [])


def test_no_bytes_make_the_session_fail(studio: Studio) -> None:
    """Mutations of good messages are counted, and the good ones stay as they are."""
    session = feed(Session(studio.rig), studio.messages, together=500)
    rng = np.random.default_rng(0)
    n_bad = 0
    for stream in session.streams:
        for _, payload, receive_ns in studio.of(stream)[:60]:
            bad = bytearray(payload)
            for at in rng.integers(0, 60, 6):  # header, frame, layout
                bad[at] = rng.integers(256)
            n_before = session.counts(stream)['received'] - session.counts(stream)['kept']
            session.add(stream, POINT_CLOUD2, [bytes(bad)], [receive_ns])
            counts = session.counts(stream)
            n_bad += (counts['received'] - counts['kept']) > n_before
    assert n_bad >= 100
    assert session.snapshot().observations.views[0].n_frames >= SECONDS * 30
