# SPDX-License-Identifier: Apache-2.0
"""What the node keeps of a stream and of solves that do not end, without the middleware."""

from __future__ import annotations

import gc
import os
import tracemalloc
from itertools import count
from threading import Event

import numpy as np
import pytest
from fault_report import Measured
from ros_scene import Scene
from test_ros_faults_inputs import resident_mib, restamped

from rpgd_ros.core.geometry import Array
from rpgd_ros.io.rig import read_rig
from rpgd_ros.pairing import BufferConfig
from rpgd_ros.ros.drawing import MAX_PATH, PATH_STEP_M, Way
from rpgd_ros.ros.worker import Worker
from rpgd_ros.session import Session, SessionConfig, solve
from rpgd_ros.session.monitor import Monitor, appraise

S = 1_000_000_000
MIB = 2**20
POLL_NS = S // 2  # of the stamps: 0.1 s where a walk of 240 messages/s is played at 1080
MAX_FRAMES = 1000
WARM_WALKS, N_WALKS = 6, 24  # of 8 s of stamps; the stores are full after five


class Room:
    """The parts of the node that keep something of the messages, fed like its poll does."""

    def __init__(self, walk: Scene) -> None:
        """Start empty."""
        config = SessionConfig(buffer=BufferConfig(max_frames=MAX_FRAMES))
        self.session = Session(read_rig(walk.rig), config)
        self.monitor = Monitor(self.session, max_age_s=config.buffer.max_age_s)
        self.way = Way()
        self._walk = walk
        self._rounds = count()

    def walk_through(self) -> None:
        """Take one walk, later than the one before."""
        messages, topics = self._walk.messages, self.session.topics()
        first = messages[0][1]
        shift = next(self._rounds) * (messages[-1][1] - first + S // 100)
        pose = self.monitor.recent.pose
        polls: dict[int, dict[str, list[tuple[bytes, int]]]] = {}
        for topic, time_ns, payload in messages:
            sec, ns = (int.from_bytes(payload[i : i + 4], 'little') for i in (4, 8))
            later = restamped(payload, sec * S + ns + shift)
            batch = polls.setdefault((time_ns - first) // POLL_NS, {})
            batch.setdefault(topic, []).append((later, time_ns + shift))
        for batch in polls.values():
            for topic, sent in batch.items():
                payloads, receive_ns = zip(*sent, strict=True)
                self.session.add(topics[topic], self._walk.topics[topic], payloads, receive_ns)
            self.way.add(self.monitor.look(at_all=False), pose, 15.0)


@pytest.mark.fault(35)
def test_memory_stays_flat_once_the_stores_are_full(walk: Scene, measured: Measured) -> None:
    """Minutes of studio after a calibration: watch and drawing keep nothing they looked at."""
    room = Room(walk)
    room.walk_through()
    snapshot = room.session.snapshot()
    appraisal = appraise(snapshot, solve(snapshot))
    room.monitor.conclude(appraisal, is_accepted=True, is_automatic=False)
    tracemalloc.start()
    try:
        for n in range(N_WALKS):
            if n == WARM_WALKS:
                gc.collect()
                before = tracemalloc.get_traced_memory()[0]
                n_places = len(room.way.places)
            room.walk_through()
        gc.collect()
        growth = tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()
    n_places = len(room.way.places) - n_places
    measured('growth', growth / MIB, 'MiB', n=n_places)
    # The way itself is still growing: its places have to be small.
    assert 100 < n_places < MAX_PATH
    assert growth < MIB, f'{n_places} places of {PATH_STEP_M} m'


def small_result_of_much_work() -> list[Array]:
    """Use 64 MiB in small blocks, and keep one in a thousand of them, as a solve does."""
    return [np.zeros(128) for _ in range(64 * 1024)][::1000]


def test_what_a_job_has_freed_goes_back_to_the_system() -> None:
    """The blocks that live on lie between those that were freed."""
    worker, kept = Worker(), []
    before = resident_mib(os.getpid())
    for _ in range(3):
        future, is_done = worker.start(small_result_of_much_work, None), Event()
        future.add_done_callback(lambda _, is_done=is_done: is_done.set())
        assert is_done.wait(60.0)
        worker.join()
        kept.append(future.result())
    assert len(kept[0]) > 50
    assert resident_mib(os.getpid()) - before < 10.0
