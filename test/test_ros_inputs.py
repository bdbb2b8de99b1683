# SPDX-License-Identifier: Apache-2.0
"""Subscriptions that find type and reliability in the graph."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence

import numpy as np
import pytest
from geometry_msgs.msg import TransformStamped

from rpgd_ros.messages import POINT_CLOUD2, POSE_ARRAY, encode_point_cloud2, encode_pose_array
from rpgd_ros.ros.domain import free_domain
from rpgd_ros.ros.inputs import MAX_PENDING_BYTES, STALE_SECONDS, JointInput
from rpgd_ros.ros.player import Peer

TOPIC = 'mocap/skeleton'
WAIT_S = 20.0
JOINTS = np.arange(12.0).reshape(4, 3)
CLOUD = encode_point_cloud2(1, 'mocap', JOINTS)
POSES = encode_pose_array(2, 'mocap', JOINTS)


class Bench:
    """A listener and its input, a talker, and what was handed on."""

    def __init__(self, domain: int, msg_type: str) -> None:
        """Join the graph."""
        self.domain = domain
        self.taken: list[tuple[str, str, bytes]] = []
        self.n_batches = 0
        self.listener = Peer('listener', domain_id=domain)
        self.talker = Peer('talker', domain_id=domain)
        self.input = JointInput(self.listener.node, 'mocap', TOPIC, msg_type, self.input_deliver)

    def close(self) -> None:
        """Leave the graph."""
        self.talker.close()
        self.listener.close()

    def is_found(self) -> bool:
        """Poll the graph and say whether the talker has been found."""
        self.input.poll()
        return self.input.is_subscribed and not self.talker.without_subscriber()

    def n_publishers(self) -> int:
        """Return how many publishers the listener knows of."""
        return len(self.listener.node.get_publishers_info_by_topic(TOPIC))

    def receive(self, payload: bytes) -> None:
        """Publish a message and wait until it has arrived."""
        n_before = self.input.n_received
        self.talker.play([(TOPIC, 1, payload)], rate=1.0)
        self.wait(lambda: self.input.n_received > n_before)

    def wait(self, condition: object) -> None:
        """Take messages until a condition holds."""
        assert callable(condition)
        assert self.listener.wait_until(condition, seconds=WAIT_S)

    def input_deliver(
        self, stream: str, msg_type: str, payloads: Sequence[bytes], receive_ns: Sequence[int]
    ) -> None:
        """Note what is handed on."""
        assert len(payloads) == len(receive_ns)
        self.n_batches += 1
        self.taken += [(stream, msg_type, bytes(payload)) for payload in payloads]


@pytest.fixture
def bench() -> Iterator[Bench]:
    """Return a bench whose input takes the publisher's type."""
    made = Bench(free_domain(), '')
    yield made
    made.close()


def test_messages_are_handed_on_in_one_go_by_flush(bench: Bench) -> None:
    """The bytes are those that were sent, under the type of their publisher."""
    bench.talker.advertise({TOPIC: POINT_CLOUD2})
    bench.wait(bench.is_found)
    for _ in range(3):
        bench.receive(CLOUD)
    assert bench.taken == []
    bench.input.flush()
    assert bench.taken == [('mocap', POINT_CLOUD2, CLOUD)] * 3
    assert bench.n_batches == 1


@pytest.mark.fault(16)
def test_silence_is_a_problem_that_may_pass(bench: Bench) -> None:
    """Before there is a publisher, the topic is named."""
    bench.input.poll()
    health = bench.input.health()
    assert 'nobody publishes /mocap/skeleton' in health.problem
    assert not health.is_hopeless
    assert np.isnan(health.age_s)


def test_unreadable_type_is_a_problem_that_stays(bench: Bench) -> None:
    """Found and needed types are named."""
    bench.talker.node.create_publisher(TransformStamped, TOPIC, 1)

    def is_seen() -> bool:
        bench.input.poll()
        return 'TransformStamped' in bench.input.health().problem

    bench.wait(is_seen)
    assert bench.input.health().is_hopeless
    assert POINT_CLOUD2 in bench.input.health().problem
    assert not bench.input.is_subscribed


def test_second_type_on_a_topic_is_named(bench: Bench) -> None:
    """One of the types is read, the other is not passed over in silence."""
    with Peer('stranger', domain_id=bench.domain) as stranger:
        stranger.node.create_publisher(TransformStamped, TOPIC, 1)
        bench.talker.advertise({TOPIC: POSE_ARRAY})

        def is_seen() -> bool:
            return bench.is_found() and 'beside' in bench.input.health().problem

        bench.wait(is_seen)
        bench.receive(POSES)
        assert not bench.input.health().is_hopeless


@pytest.mark.fault(15)
def test_reliability_follows_the_publishers(bench: Bench) -> None:
    """A best-effort publisher that comes later is heard as well."""
    bench.talker.advertise({TOPIC: POINT_CLOUD2})
    bench.wait(bench.is_found)
    assert bench.input.health().qos == 'RELIABLE'
    bench.talker.advertise({TOPIC: POINT_CLOUD2}, is_reliable=False)

    def is_best_effort() -> bool:
        return bench.is_found() and bench.input.health().qos == 'BEST_EFFORT'

    bench.wait(is_best_effort)
    bench.receive(CLOUD)


def test_publisher_that_never_sends_is_a_problem_that_may_pass(bench: Bench) -> None:
    """Not at once: the time counts from the subscription."""
    start_s = time.monotonic()
    bench.talker.advertise({TOPIC: POSE_ARRAY})
    bench.wait(bench.is_found)
    bench.wait(lambda: bool(bench.input.health().problem))
    assert time.monotonic() - start_s > STALE_SECONDS
    assert bench.input.health().problem == "no message on 'mocap/skeleton' yet"
    assert not bench.input.health().is_hopeless
    bench.receive(POSES)
    assert bench.input.health().problem == ''


def test_time_without_a_publisher_is_no_time_of_silence() -> None:
    """Subscribed long before, because the type is given: the publisher may take its time too."""
    bench = Bench(free_domain(), POSE_ARRAY)
    try:
        end_s = time.monotonic() + STALE_SECONDS + 0.5

        def is_over() -> bool:
            bench.input.poll()
            return time.monotonic() > end_s

        bench.wait(is_over)
        assert 'nobody publishes' in bench.input.health().problem
        bench.talker.advertise({TOPIC: POSE_ARRAY})
        bench.wait(lambda: bench.is_found() and bench.n_publishers() == 1)
        bench.input.poll()
        assert bench.input.health().problem == ''
    finally:
        bench.close()


@pytest.mark.fault(15)
def test_best_effort_publisher_that_comes_and_goes_is_forgotten(bench: Bench) -> None:
    """Within two looks at the graph: the error lasts no longer than its publisher."""
    bench.talker.advertise({TOPIC: POSE_ARRAY})
    bench.wait(bench.is_found)
    with Peer('stranger', domain_id=bench.domain) as stranger:
        stranger.advertise({TOPIC: POSE_ARRAY}, is_reliable=False)
        bench.wait(lambda: bench.n_publishers() == 2 and bool(bench.input._incompatible))  # noqa: SLF001
    bench.wait(lambda: bench.n_publishers() == 1)
    bench.input.poll()
    assert bench.input.health().qos == 'RELIABLE'
    assert bench.input.health().problem == ''
    assert not bench.input.health().is_hopeless


def test_given_type_is_subscribed_before_there_is_a_publisher() -> None:
    """With the type as a parameter, a replay finds its subscriber at once."""
    bench = Bench(free_domain(), POSE_ARRAY)
    try:
        assert bench.input.is_subscribed
        bench.talker.advertise({TOPIC: POSE_ARRAY})
        bench.wait(lambda: not bench.talker.without_subscriber())
        bench.receive(POSES)
    finally:
        bench.close()


def test_topic_that_the_middleware_refuses_is_said_in_plain_words(bench: Bench) -> None:
    """A participant cannot hold two types under one topic name, for instance after a remapping."""
    bench.listener.node.create_publisher(TransformStamped, TOPIC, 1)
    taken = JointInput(bench.listener.node, 'mocap', TOPIC, POSE_ARRAY, bench.input_deliver)
    health = taken.health()
    assert 'cannot be subscribed to as geometry_msgs/msg/PoseArray' in health.problem
    assert health.is_hopeless


@pytest.mark.fault(8)
def test_flood_is_handed_on_before_it_grows(bench: Bench) -> None:
    """What is pending between two flushes is bounded in bytes."""
    bench.talker.advertise({TOPIC: POINT_CLOUD2})
    bench.wait(bench.is_found)
    big = CLOUD + bytes(1 << 20)
    for _ in range(1 + MAX_PENDING_BYTES // len(big)):
        bench.receive(big)
    assert bench.n_batches == 1
