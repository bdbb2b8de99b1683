# SPDX-License-Identifier: Apache-2.0
"""The node under hostile and unlucky inputs: floods, giants, loops, cameras that die."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest
from fault_report import IS_FULL, Measured, repeats, within
from ros_live import assert_close, live
from ros_scene import MOCAP_FRAME, Scene

from rpgd_ros.core.geometry import RigidTransform
from rpgd_ros.messages import POINT_CLOUD2, POSE_ARRAY, decode_joints, encode_point_cloud2
from rpgd_ros.ros.player import Timed
from rpgd_ros.simulation.export import MOCAP_TOPIC

S = 1_000_000_000
MIB = 2**20
GIANT = 16 * MIB


def resident_mib(pid: int) -> float:
    """Return the memory that a process has now."""
    lines = Path(f'/proc/{pid}/status').read_text().splitlines()
    (kib,) = (line.split()[1] for line in lines if line.startswith('VmRSS'))
    return int(kib) / 1024


def restamped(payload: bytes, stamp_ns: int) -> bytes:
    """Return a little endian message whose header has another stamp."""
    seconds, ns = divmod(stamp_ns, S)
    return payload[:4] + seconds.to_bytes(4, 'little') + ns.to_bytes(4, 'little') + payload[12:]


def found(answer: dict[str, object]) -> RigidTransform:
    """Return the transform of an answer."""
    return RigidTransform.from_quat_xyzw(
        np.array(answer['xyz'], float), np.array(answer['quat_xyzw'], float)
    )


def flood(walk: Scene, seconds: float) -> Iterator[Timed]:
    """Yield skeletons as fast as they are taken, each later than the one before."""
    whole = [m[2] for m in walk.messages if m[0] == MOCAP_TOPIC]
    start_ns = walk.messages[-1][1]
    end, n = time.monotonic() + seconds, 0
    while time.monotonic() < end:
        n += 1
        # All are due at once: a replay does not wait for what is overdue.
        stamp_ns = start_ns + n * S // 1000
        yield MOCAP_TOPIC, walk.messages[0][1], restamped(whole[n % len(whole)], stamp_ns)


@pytest.mark.fault(8, rounds=3)
def test_flood_costs_no_memory_and_no_answer(walk: Scene, rig: Path, measured: Measured) -> None:
    """Skeletons as fast as a publisher can: the store stays bounded, the node answers."""
    with live(rig, 'buffer.max_frames:=5000') as node:
        node.play(walk)
        assert node.calibrate()[0]
        pid = node.child.process.pid
        # Once, to fill what is bounded: queues of the middleware and the store.
        node.peer.play(flood(walk, repeats(3, 2)), rate=1.0)
        before = resident_mib(pid)
        sent = node.peer.play(flood(walk, repeats(20, 2)), rate=1.0)[MOCAP_TOPIC]
        n_before = node.received()[MOCAP_TOPIC]
        start = time.monotonic()
        success, answer = node.calibrate()
        measured('calibrate answered', time.monotonic() - start, 's')
        growth = resident_mib(pid) - before
        measured('growth', growth, 'MiB', n=sent)
        assert growth < 30.0
        # The walk is older than the flood by then, and dropped; an answer there must be.
        assert success or answer['reason'] in {'no_data', 'degenerate_motion'}, answer
        node.wait_until('no count', lambda: node.received()[MOCAP_TOPIC] > n_before)
        entry = node.peer.diagnostics('mocap')
        assert int(entry['kept']) <= 5000
        assert int(entry['expired']) > 0


@pytest.mark.fault(9, rounds=10)
def test_giant_between_good_messages_is_refused_by_its_length(
    walk: Scene, rig: Path, measured: Measured
) -> None:
    """16 MiB on a topic of skeletons: counted, not read, and the next message is used."""
    giant = encode_point_cloud2(walk.messages[-1][1], MOCAP_FRAME, np.ones((12, 3)))
    giant += bytes(GIANT - len(giant))
    for msg_type in (POINT_CLOUD2, POSE_ARRAY):
        start = time.monotonic()
        decoded = decode_joints(msg_type, [giant], n_joints=12, n_values=3)
        measured('refused', (time.monotonic() - start) * 1e3, 'ms')
        assert dict(decoded.dropped) == {'oversized': 1}
        assert time.monotonic() - start < within(0.05)
    third = len(walk.messages) // 3
    n_skeletons = sum(m[0] == MOCAP_TOPIC for m in walk.messages)
    one: Timed = (MOCAP_TOPIC, walk.messages[third][1], giant[:MIB])
    with live(rig) as node:
        node.advertise(walk.topics)
        node.send([*walk.messages[:third], one, one, *walk.messages[third : 2 * third]])
        assert int(node.peer.diagnostics('mocap')['oversized']) == 2
        # Beside 16 MiB the middleware itself loses some messages, reliable as it may be.
        sent = node.peer.play(
            [(MOCAP_TOPIC, walk.messages[2 * third][1], giant), *walk.messages[2 * third :]],
            rate=8.0,
        )
        n_sent = n_skeletons + 3
        node.wait_until('not counted', lambda: node.received()[MOCAP_TOPIC] > n_sent - 20)
        success, answer = node.calibrate()
        assert success
        assert_close(found(answer), walk)
        kept = int(node.peer.diagnostics('mocap')['kept'])
        measured('skeletons lost beside it', n_skeletons - kept, n=3)
        assert sum(sent.values()) > third


@pytest.mark.fault(12, rounds=10)
def test_zero_and_future_stamps_are_refused_and_named_by_topic(
    walk: Scene, rig: Path, measured: Measured
) -> None:
    """Each has its own count in the diagnostics of its stream."""
    messages: list[Timed] = []
    n_zero = n_future = 0
    for i, (topic, time_ns, payload) in enumerate(walk.messages):
        messages.append((topic, time_ns, payload))
        if topic == MOCAP_TOPIC and i % 20 == 0:
            messages.append((topic, time_ns, restamped(payload, 0)))
            n_zero += 1
        if topic == MOCAP_TOPIC and i % 100 == 0:
            messages.append((topic, time_ns, restamped(payload, time_ns + 3600 * S)))
            n_future += 1
    with live(rig) as node:
        node.advertise(walk.topics)
        node.send(messages)
        entry = node.peer.diagnostics('mocap')
        assert int(entry['zero_stamp']) == n_zero
        assert int(entry['jump_held']) == n_future
        assert int(entry['kept']) == sum(m[0] == MOCAP_TOPIC for m in walk.messages)
        assert node.calibrate()[0]
    measured('zero and future stamps counted', n=n_zero + n_future)


@pytest.mark.fault(13, rounds=10)
def test_looped_bag_starts_over_once(walk: Scene, rig: Path, measured: Measured) -> None:
    """Without /clock: after the jump all pairs are there again, of one side only."""
    with live(rig) as node:
        node.play(walk)

        def pairs() -> int:
            names = [c.name for c in walk.recording.cameras]
            return sum(int(node.peer.diagnostics(f'camera {n}').get('pairs', '0')) for n in names)

        node.wait_until('no pairs', lambda: pairs() > 0)
        once = pairs()
        twice = 2 * len(walk.messages)
        node.peer.play(walk.messages, rate=8.0)
        node.wait_until('not counted', lambda: sum(node.received().values()) == twice)
        measured('pairs lost after the jump', 100.0 * (1 - pairs() / once), '%')
        assert pairs() >= 0.95 * once
        assert int(node.peer.diagnostics('mocap')['cleared']) > 0
        assert node.child.output.count('jumped back') == 1
        success, answer = node.calibrate()
        assert success
        assert_close(found(answer), walk)


@pytest.mark.fault(15, rounds=10)
def test_each_reliability_and_durability_is_heard_or_named(
    walk: Scene, rig: Path, measured: Measured
) -> None:
    """What cannot be heard is an ERROR that names topic and policy."""
    override = 'qos_overrides./mocap/skeleton.subscription.reliability:=reliable'
    with live(rig, override) as node:
        node.advertise({t: k for t, k in walk.topics.items() if t != MOCAP_TOPIC})
        start = time.monotonic()
        node.peer.advertise({MOCAP_TOPIC: POSE_ARRAY}, is_reliable=False)
        node.wait_until('not told', lambda: 'RELIABILITY' in node.peer.message('mocap') or None)
        measured('told', time.monotonic() - start, 's')
        assert time.monotonic() - start < within(2.0)
        assert '/mocap/skeleton' in node.peer.message('mocap')
        assert node.peer.level('mocap') == b'\x02'


def without(messages: Sequence[Timed], topic: str) -> list[Timed]:
    """Return messages without those of a topic."""
    return [m for m in messages if m[0] != topic]


@pytest.mark.fault(16, rounds=10)
def test_camera_that_dies_is_named_and_the_others_calibrate(
    walk: Scene, rig: Path, measured: Measured
) -> None:
    """One never starts, one stops midway: both are in the diagnostics, the result is right.

    The reports come as seldom as they do by default.
    """
    silent, dying = 'cam0/keypoints', 'cam1/keypoints'
    messages = without(walk.messages, silent)
    half = len(messages) // 2
    with live(rig, 'diagnostics_period:=1.0') as node:
        node.advertise({t: k for t, k in walk.topics.items() if t != silent})
        last = next(i for i in range(half, 0, -1) if messages[i][0] == dying)
        node.peer.play(messages[: last + 1], rate=8.0)
        died = time.monotonic()
        node.peer.play(without(messages[last + 1 :], dying), rate=8.0)
        node.wait_until('not told', lambda: 'no message' in node.peer.message('camera cam1'))
        measured('named', time.monotonic() - died, 's')
        assert time.monotonic() - died < within(3.0)
        assert 'nobody publishes /cam0/keypoints' in node.peer.message('camera cam0')
        assert node.peer.level('camera cam1') == b'\x01'
        success, answer = node.calibrate()
        assert success
        assert_close(found(answer), walk)


@pytest.mark.threat('S9')
def test_flood_of_bad_messages_does_not_flood_the_log(
    walk: Scene, rig: Path, measured: Measured
) -> None:
    """Damage, strange frames with terminal codes in them, wrong numbers of joints."""
    stamp_ns = walk.messages[-1][1]
    evil = '\x1b[2J\n[FATAL] all is well ' * 8
    whole = next(m[2] for m in walk.messages if m[0] == MOCAP_TOPIC)
    kinds = [
        whole[:40],
        encode_point_cloud2(stamp_ns, evil[:100], np.ones((12, 3))),
        bytes(300_000),
        restamped(whole, 0),
    ]
    n = 10_000 if IS_FULL else 1000
    with live(rig) as node:
        node.play(walk)
        n_before = len(node.child.output.splitlines())
        node.peer.play(
            [(MOCAP_TOPIC, stamp_ns + i * S // 2000, kinds[i % 4]) for i in range(n)], rate=1.0
        )
        assert node.calibrate()[0]
        lines = node.child.output.splitlines()[n_before:]
        measured('lines', len(lines), n=n)
        assert len(lines) <= 20, lines
        assert '\x1b[2J' not in node.child.output
        assert max(map(len, lines), default=0) < 1000
