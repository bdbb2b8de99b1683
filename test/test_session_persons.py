# SPDX-License-Identifier: Apache-2.0
"""Several persons in the messages: bytes of a crowd in, the transform out."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from studio import bits

from rpgd_ros.core import Calibration, CalibrationConfig, CalibrationError, Reason
from rpgd_ros.core.candidates import assemble
from rpgd_ros.messages import CAMERA_INFO, POINT_CLOUD2, encode_point_cloud2
from rpgd_ros.session import MOCAP, Session, SessionConfig, Snapshot, solve
from rpgd_ros.session.snapshot_file import read_snapshot, write_snapshot
from rpgd_ros.simulation import SimulatedRecording, build_scene, preset, simulate
from rpgd_ros.simulation.export import messages_of, rig_of

Sent = tuple[str, bytes, int]  # stream, payload, arrival


@cache
def film(subjects: int = 1, persons: int = 3, rig: str = 'studio') -> SimulatedRecording:
    """Record a crowd for eight seconds."""
    scene = build_scene(preset(rig), 5, seconds=8.0, persons=persons, subjects=subjects)
    return simulate(scene)


def sent_of(recording: SimulatedRecording) -> list[Sent]:
    """Return the messages of joints in the order of their arrival."""
    names = {rig.keypoints_topic: rig.name for rig in rig_of(recording).cameras}
    return [
        (names.get(m.topic, MOCAP), m.payload, m.receive_ns)
        for m in messages_of(recording)
        if m.msgtype != CAMERA_INFO
    ]


def collected(recording: SimulatedRecording, sent: Sequence[Sent], together: int = 1) -> Session:
    """Hand messages to a new session in batches of one stream."""
    session = Session(rig_of(recording))
    for i in range(0, len(sent), together):
        by_stream: dict[str, list[Sent]] = {}
        for one in sent[i : i + together]:
            by_stream.setdefault(one[0], []).append(one)
        for stream, part in by_stream.items():
            session.add(stream, POINT_CLOUD2, [p for _, p, _ in part], [at for *_, at in part])
    return session


def rms_mm(found: Calibration, recording: SimulatedRecording) -> float:
    """Return how far the body's points are off."""
    x = recording.mocap.x_mocap[::20].reshape(-1, 3)
    off = (found.world_T_mocap @ x) - (recording.truth.world_T_mocap @ x)
    return 1000.0 * float(np.sqrt((off**2).sum(-1).mean()))


@pytest.mark.parametrize(('subjects', 'persons'), [(1, 3), (2, 3), (2, 2)])
def test_crowd_gives_the_transform(subjects: int, persons: int) -> None:
    """Detections and skeletons shuffled in every message."""
    recording = film(subjects, persons)
    snapshot = collected(recording, sent_of(recording), 64).snapshot()
    calibration = solve(snapshot)
    assert rms_mm(calibration, recording) < 1.0
    assert set(calibration.shown) == set(calibration.per_camera)
    assert min(shown.share for shown in calibration.shown.values()) > 0.9


def test_replay_of_a_crowd_gives_the_bits_of_the_live_run() -> None:
    """One by one, in batches, shuffled and doubled, with two subjects: the same observations."""
    recording = film(2)
    sent = sent_of(recording)
    live = collected(recording, sent).snapshot()
    rng = np.random.default_rng(3)
    order = np.argsort(np.arange(len(sent)) + rng.uniform(0, 9, len(sent)))
    shuffled = [sent[i] for i in order]
    doubled = [m for i, m in enumerate(shuffled) for _ in range(1 + (i % 5 == 0))]
    expected = bits(live)
    for messages, together in ((sent, 50), (shuffled, 1), (doubled, 10**6)):
        assert bits(collected(recording, messages, together).snapshot()) == expected


def test_single_person_in_wide_messages_is_a_single_person() -> None:
    """Unused places of a message of three change no bit."""
    recording = simulate(build_scene(preset('studio'), 5, seconds=4.0))
    plain = collected(recording, sent_of(recording), 32).snapshot()
    wide = Session(rig_of(recording))
    for stream, payload, at in sent_of(recording):
        if stream == MOCAP:
            wide.add(stream, POINT_CLOUD2, [payload], [at])
    for v, (camera, seen) in enumerate(zip(recording.cameras, recording.streams, strict=True)):
        for row in np.flatnonzero(seen.is_sent):
            uv, scores = np.full((3, *seen.uv[row].shape), np.nan), np.zeros((3, 17))
            uv[v % 3], scores[v % 3] = seen.uv[row], seen.confidence[row]
            stamp_ns = int(seen.stamp_ns[row])
            payload = encode_point_cloud2(stamp_ns, camera.name, uv, scores)
            wide.add(camera.name, POINT_CLOUD2, [payload], [stamp_ns])
    taken = wide.snapshot()
    assert not taken.is_crowd
    assert bits(taken) == bits(plain)


def test_solve_is_that_of_the_right_detections() -> None:
    """The observations that were picked are bit for bit those of a recording of one person."""
    recording = film()
    snapshot = collected(recording, sent_of(recording), 64).snapshot()
    alone = simulate(build_scene(preset('studio'), 5, seconds=8.0))
    told = collected(alone, sent_of(alone), 64).snapshot()
    n_same = 0
    for one, other in zip(snapshot.observations.views, told.observations.views, strict=True):
        assert one.stamp_ns is not None
        assert other.stamp_ns is not None
        rows = np.searchsorted(other.stamp_ns, one.stamp_ns)
        same = (one.uv.view(np.int64) == other.uv[rows].view(np.int64)).all((1, 2))
        assert one.x_mocap[same].tobytes() == other.x_mocap[rows][same].tobytes()
        assert same.mean() > 0.99
        n_same += int(same.sum())
    found, single = (rms_mm(solve(taken), recording) for taken in (snapshot, told))
    assert found < 1.05 * single + 0.02


def test_counts_tell_of_further_persons() -> None:
    """Detections beside the first of each message."""
    recording = film()
    session = collected(recording, sent_of(recording), 64)
    camera = recording.cameras[0].name
    counts = session.counts(camera)
    assert counts['further_persons'] > 0.9 * counts['kept']


def test_crowd_in_one_camera_only_is_picked_as_well() -> None:
    """The other detectors report the subject alone."""
    recording = film()
    alone = simulate(build_scene(preset('studio'), 5, seconds=8.0))
    camera = recording.cameras[0].name
    sent = [m for m in sent_of(recording) if m[0] == camera]
    sent += [m for m in sent_of(alone) if m[0] != camera]
    sent.sort(key=lambda m: m[2])
    snapshot = collected(recording, sent, 64).snapshot()
    assert snapshot.is_crowd
    assert rms_mm(solve(snapshot), recording) < 1.0


def test_picking_can_be_stopped_and_is_told() -> None:
    """It is a stage like the others."""
    recording = film()
    snapshot: Snapshot = collected(recording, sent_of(recording), 64).snapshot()
    with pytest.raises(CalibrationError) as caught:
        solve(snapshot, should_stop=lambda: True)
    assert caught.value.reason is Reason.CANCELLED
    told: list[tuple[str, float]] = []
    solve(snapshot, progress=lambda stage, fraction: told.append((stage, fraction)))
    fractions = [fraction for stage, fraction in told if stage == 'persons']
    assert fractions == sorted(fractions)
    assert told[0][0] == 'persons'


def test_candidates_of_messages_are_those_of_the_arrays() -> None:
    """What arrives is what was sent: the same pairs are right."""
    recording = film()
    snapshot = collected(recording, sent_of(recording), 64).snapshot()
    picked = snapshot.pick()
    assert picked is not None
    crowd = recording.crowd()
    assert recording.company is not None
    truth = [np.argsort(order, 1)[:, :1] for order in recording.company.order]
    exact = assemble(crowd, truth)
    for found, right in zip(picked.observations.views, exact.views, strict=True):
        assert found.stamp_ns is not None
        assert right.stamp_ns is not None
        rows = np.searchsorted(right.stamp_ns, found.stamp_ns)
        off = np.abs(found.uv - right.uv[rows])
        assert float(np.nanquantile(off, 0.99)) < 1e-3


@pytest.mark.parametrize('subjects', [1, 2])
def test_what_was_picked_is_a_recording_by_itself(subjects: int, tmp_path: Path) -> None:
    """Nobody else is in it; written and read back, its solve gives the same bits."""
    recording = film(subjects)
    snapshot = collected(recording, sent_of(recording), 64).snapshot()
    picked = snapshot.pick()
    assert picked is not None
    alone = snapshot.alone()
    assert not alone.is_crowd
    for one, other in zip(alone.observations.views, picked.observations.views, strict=True):
        assert one.uv.tobytes() == other.uv.tobytes()
        assert one.x_mocap.tobytes() == other.x_mocap.tobytes()
        np.testing.assert_array_equal(one.stamp_ns, other.stamp_ns)
    write_snapshot(tmp_path / 'data.npz', snapshot)
    again = solve(read_snapshot(tmp_path / 'data.npz'))
    found = solve(snapshot)
    assert again.world_T_mocap.matrix.tobytes() == found.world_T_mocap.matrix.tobytes()


def test_two_subjects_are_kept_one_after_the_other() -> None:
    """Where no rate of the clocks is estimated: of each its skeletons, and no instant twice."""
    recording = film(2, 2)
    session = collected(recording, sent_of(recording), 64)
    calibration = CalibrationConfig().with_stage('time', estimate_rate=False)
    session.update_config(SessionConfig(calibration=calibration))
    snapshot = session.snapshot()
    picked = snapshot.pick()
    assert picked is not None
    assert picked.used == (0, 1)
    alone = snapshot.alone()
    assert len(alone.skeletons.stamp_ns) == 2 * len(recording.mocap.stamp_ns)
    assert (np.diff(alone.skeletons.stamp_ns) > 0).all()
    for one, other in zip(alone.observations.views, picked.observations.views, strict=True):
        assert one.uv.tobytes() == other.uv.tobytes()
        assert one.x_mocap.tobytes() == other.x_mocap.tobytes()


def test_snapshot_without_the_subject_is_refused_once() -> None:
    """What failed is not tried again, and may still be looked at."""
    recording = film()
    sent = [m for m in sent_of(recording) if m[0] == MOCAP]
    camera = recording.cameras[0]
    rng = np.random.default_rng(0)
    stamps = recording.streams[0].stamp_ns
    for stamp_ns in stamps.tolist():
        uv = np.full((2, 17, 2), np.nan)
        uv[:, 5:8] = rng.uniform(0, 900, (2, 3, 2))
        sent.append((camera.name, encode_point_cloud2(stamp_ns, 'c', uv), stamp_ns))
    snapshot = collected(recording, sent, 64).snapshot()
    with pytest.raises(CalibrationError) as caught:
        solve(snapshot)
    assert caught.value.reason is Reason.TOO_FEW_INLIERS
    with pytest.raises(CalibrationError) as again:
        snapshot.pick()
    assert again.value is caught.value
    assert snapshot.observations.views[0].n_frames > 0
