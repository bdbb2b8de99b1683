# SPDX-License-Identifier: Apache-2.0
"""What the live node does for the person in the room, and after that for the transform."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import TransformStamped
from ros_live import Live, answered_bits, bits, live
from ros_scene import Scene, make_scene
from test_ros_live_parameters import double, integer, set_to
from walks import seen_after

from rpgd_ros.core.observations import NS_PER_S
from rpgd_ros.messages import CAMERA_INFO
from rpgd_ros.session import solve
from rpgd_ros.session.snapshot_file import read_snapshot
from rpgd_ros.simulation import SimulatedRecording
from rpgd_ros.simulation.export import messages_of

CALIBRATED_S = 10.0  # of the walk, before which nothing is wrong
BUMPED = 2
SOON_S = 10.0

Message = tuple[str, int, bytes]


@pytest.fixture(scope='module')
def walk(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """Return twenty seconds of a walk before four cameras."""
    return make_scene(tmp_path_factory.mktemp('walk'), seconds=CALIBRATED_S + SOON_S)


def messages(recording: SimulatedRecording, begin_s: float, end_s: float) -> list[Message]:
    """Return what is sent in a stretch of time."""
    sent = [m for m in messages_of(recording, 'PoseArray') if m.msgtype != CAMERA_INFO]
    start_ns = sent[0].receive_ns
    return [
        (m.topic, m.receive_ns, m.payload)
        for m in sent
        if begin_s <= (m.receive_ns - start_ns) / NS_PER_S < end_s
    ]


def bumped(recording: SimulatedRecording, turn_deg: float) -> SimulatedRecording:
    """Return the recording as it is when a camera is turned; nobody is told."""
    streams = list(recording.streams)
    stream, camera = streams[BUMPED], recording.cameras[BUMPED]
    turned = seen_after(camera, stream.uv, np.array([0.3, 0.9, 0.1]) * turn_deg)
    streams[BUMPED] = replace(stream, uv=turned)
    return replace(recording, streams=tuple(streams))


def shifted(recording: SimulatedRecording, metres: float) -> SimulatedRecording:
    """Return the recording as it is when the MoCap's origin was set anew."""
    x_mocap = recording.mocap.x_mocap + np.array([metres, 0.0, 0.0])
    return replace(recording, mocap=replace(recording.mocap, x_mocap=x_mocap))


def play_to(node: Live, walk: Scene, end_s: float) -> None:
    """Play the beginning of the walk, at four times its speed."""
    node.advertise(walk.topics)
    node.send(messages(walk.recording, 0.0, end_s), rate=4.0)


def test_bumped_camera_is_named_within_ten_seconds(walk: Scene, rig: Path) -> None:
    """In the status, in its own diagnostics, and in those of the calibration; no other is."""
    with live(rig) as node:
        play_to(node, walk, CALIBRATED_S)
        assert node.calibrate()[0]
        recording, rate = bumped(walk.recording, 0.5), 1.0  # as seconds pass, until it is named
        for second in np.arange(CALIBRATED_S, CALIBRATED_S + SOON_S):
            node.peer.play(messages(recording, second, second + 1.0), rate=rate)
            rate = 4.0 if 'Attention: ' in node.sentence() else 1.0
        node.wait_until('not named', lambda: 'Attention: ' in node.sentence(), seconds=1.0)
        assert re.search(r'Attention: camera cam2 is off by \d+\.\d px', node.sentence())
        assert 'bumped' in node.sentence()
        node.wait_until('no warning', lambda: 'off by' in node.peer.message('camera cam2'))
        assert 'cam2' in node.peer.message('calibration')
        for other in ('cam0', 'cam1', 'cam3'):
            assert node.peer.message(f'camera {other}') == 'receiving'
        found = node.peer.diagnostics('camera cam2')
        assert float(found['error_px']) > 2.0 * float(found['accepted_px'])


def test_clean_walk_after_acceptance_raises_nothing(walk: Scene, rig: Path) -> None:
    """The same seconds without a bump."""
    with live(rig) as node:
        play_to(node, walk, CALIBRATED_S)
        assert node.calibrate()[0]
        node.peer.play(messages(walk.recording, CALIBRATED_S, 20.0), rate=2.0)
        node.wait_until(
            'no error',
            lambda: float(node.peer.diagnostics('camera cam2').get('error_px', 'nan')) > 0.0,
        )
        assert node.sentence().startswith('Calibrated ')


def test_kept_result_is_watched_from_the_start(walk: Scene, rig: Path) -> None:
    """A camera that was bumped over night is named before anybody calibrates again."""
    with live(rig) as node:
        play_to(node, walk, CALIBRATED_S)
        assert node.calibrate()[0]
    with live(rig) as node:
        node.advertise(walk.topics)
        node.peer.play(messages(bumped(walk.recording, 0.8), 0.0, 10.0), rate=2.0)
        node.wait_until('not named', lambda: 'camera cam2' in node.sentence())
        assert 'Attention: ' in node.sentence()


def test_automatic_run_may_not_jump_and_a_call_may(walk: Scene, rig: Path) -> None:
    """The MoCap's origin was set anew: the transform in use stays until somebody says so."""
    with live(rig, 'auto.period_s:=0.5') as node:
        play_to(node, walk, CALIBRATED_S)
        first = node.calibrate()[1]
        assert node.call('reset').success
        again = messages(shifted(walk.recording, 0.4), 0.0, CALIBRATED_S)
        node.peer.play(again, rate=4.0)
        switch = double(0.5)
        assert set_to(node, 'auto.period_s', switch) == ''
        on = integer(0)
        on.type, on.bool_value = 1, True
        assert set_to(node, 'auto.enabled', on) == ''
        node.wait_until(
            'no jump', lambda: node.peer.diagnostics('calibration').get('last_result') == 'jump'
        )
        assert bits(node.latched('transform', TransformStamped)) == answered_bits(first)
        assert '~/calibrate' in node.peer.message('calibration')
        on.bool_value = False
        assert set_to(node, 'auto.enabled', on) == ''
        success, second = node.calibrate()
        assert success, second
        moved_m = np.linalg.norm(np.subtract(second['xyz'], first['xyz']))
        assert moved_m == pytest.approx(0.4, abs=0.01)


def test_person_is_told_what_is_still_missing(walk: Scene, rig: Path) -> None:
    """Which camera has seen too little, where to go, how long, and how exact it would be."""
    with live(rig, 'accept.max_sigma_deg:=0.001') as node:
        node.advertise(walk.topics)
        some = [m for m in messages(walk.recording, 0.0, 6.0) if not m[0].startswith('cam3')]
        node.peer.play(some, rate=4.0)
        node.wait_until('not told', lambda: 'cam3 has seen nobody yet' in node.sentence())
        node.wait_until('no time', lambda: bool(re.search(r'\d+ of 60 s', node.sentence())))
        rest = messages(walk.recording, 6.0, 12.0)
        node.peer.play(rest, rate=4.0)
        assert node.calibrate()[1]['reason'] == 'uncertain'
        node.wait_until('no sigma', lambda: 'if stopped now' in node.sentence())
        sentence = node.sentence()
        assert re.search(r'cam\d has seen \d+ % of its image: walk ', sentence.replace('%', ' %'))
        entry = node.peer.diagnostics('calibration')
        assert 0.0 < float(entry['expected_sigma_rotation_deg']) < 1.0
        assert 0.0 < float(entry['progress']) < 1.0
        assert float(entry['room_area_m2']) > 0.0
        assert 0.0 < float(node.peer.diagnostics('camera cam0')['coverage']) < 1.0


def test_observations_are_kept_beside_the_result(walk: Scene, rig: Path) -> None:
    """They give the published bits again, and go back with the result."""
    beside = rig.parent / 'result.npz'
    with live(rig) as node:
        play_to(node, walk, 8.0)
        first = node.calibrate()[1]
        assert solve(read_snapshot(beside)).world_T_mocap.translation.tolist() == first['xyz']
        rest = messages(walk.recording, 8.0, 16.0)
        total = len(messages(walk.recording, 0.0, 16.0))
        node.peer.play(rest, rate=4.0)
        node.wait_until('not counted', lambda: sum(node.received().values()) == total)
        second = node.calibrate()[1]
        assert solve(read_snapshot(beside)).world_T_mocap.translation.tolist() == second['xyz']
        assert node.call('revert').success
        assert solve(read_snapshot(beside)).world_T_mocap.translation.tolist() == first['xyz']
        offset = node.peer.diagnostics('camera cam1')['time_offset_ms']
        assert abs(float(offset)) < 2.0
