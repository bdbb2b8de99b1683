# SPDX-License-Identifier: Apache-2.0
"""Plays a recording as a load, and takes it with the node or with bare rclpy, timed.

The latency of a message is the time from its publication, as DDS stamps it, to the end of the
callback that took it. Publisher and taker share the clock of one machine.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, cast
from unittest.mock import patch

import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile

from rpgd_ros.io.bag import open_bag
from rpgd_ros.messages import CAMERA_INFO
from rpgd_ros.ros import node as node_module
from rpgd_ros.ros.inputs import DEPTH, JointInput
from rpgd_ros.ros.player import PLAYABLE, Peer
from rpgd_ros.ros.process import run_node
from rpgd_ros.ros.signals import StopFlag

FIND_SECONDS = 60.0  # for publishers and subscribers to find each other on a busy machine
Figures = dict[str, float]


class Takings:
    """What was taken, when, and what it cost."""

    def __init__(self) -> None:
        """Start empty."""
        self._latency_ns: list[int] = []
        self._first = self._last = (0.0, 0.0)

    def add(self, sent_ns: Sequence[int]) -> None:
        """Note the end of a callback that took messages which were published then."""
        end_ns = time.time_ns()
        self._latency_ns += [end_ns - sent for sent in sent_ns]
        self._last = time.monotonic(), time.process_time()
        if not self._first[0]:
            self._first = self._last

    def figures(self) -> Figures:
        """Return count, latencies in ms, and the share of one processor."""
        ms = np.array(self._latency_ns or [0]) * 1e-6
        wall, cpu = (b - a for a, b in zip(self._first, self._last, strict=True))
        return {
            'received': float(len(self._latency_ns)),
            'p50_ms': float(np.percentile(ms, 50)),
            'p99_ms': float(np.percentile(ms, 99)),
            'max_ms': float(ms.max()),
            'cpu': cpu / wall if wall else 0.0,
        }


def take_with_node(arguments: Sequence[str]) -> Figures:
    """Run the calibrator until a signal ends it.

    Args:
        arguments: Command line of the node.

    """
    takings = Takings()

    class TimedInput(JointInput):
        """The input of the node, which notes when its callbacks end."""

        _sent_ns: list[int]

        def _on_message(self, payload: Any, info: dict[str, int]) -> None:
            self._sent_ns = []
            super()._on_message(payload, info)
            takings.add(self._sent_ns)

        def _take(self, payload: bytes, info: dict[str, int]) -> None:
            self._sent_ns.append(info['source_timestamp'])
            super()._take(payload, info)

    with patch.object(node_module, 'JointInput', TimedInput):
        run_node(['calibrator', *arguments], StopFlag())
    return takings.figures()


def take_with_rclpy(topics: Mapping[str, str]) -> Figures:
    """Take messages as rclpy gives them, and do nothing with them, until a signal ends it.

    Args:
        topics: Type by topic.

    """
    takings = Takings()
    stop = StopFlag()
    rclpy.init(signal_handler_options=rclpy.SignalHandlerOptions.NO)
    node = rclpy.create_node('bare')

    def take(_message: Any, info: Any) -> None:
        takings.add([info['source_timestamp']])

    for topic, msg_type in topics.items():
        callback = cast('Callable[[Any], None]', take)
        node.create_subscription(PLAYABLE[msg_type], topic, callback, QoSProfile(depth=DEPTH))
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while not stop.is_set:
        executor.spin_once(timeout_sec=0.1)
    executor.shutdown()
    node.destroy_node()
    rclpy.try_shutdown()
    return takings.figures()


def play(bag: Path, *, rate: float, n_messages: int) -> Figures:
    """Play a recording once everybody listens, from the memory of this process.

    Args:
        bag: Recording without topics that nobody takes.
        rate: How many times faster than recorded.
        n_messages: Most messages that are sent.

    Returns:
        Messages sent and the seconds that it took.

    """
    with open_bag(bag) as opened:
        topics = {
            t: info.msgtype for t, info in opened.topics.items() if info.msgtype != CAMERA_INFO
        }
        messages = list(itertools.islice(opened.stream(topics), n_messages))
    with Peer('load') as peer:
        peer.advertise(topics)
        if not peer.wait_until(lambda: not peer.without_subscriber(), seconds=FIND_SECONDS):
            return {'sent': 0.0, 'seconds': 0.0}
        start = time.monotonic()
        sent = peer.play(messages, rate=rate)
        seconds = time.monotonic() - start
        peer.wait_until(lambda: False, seconds=1.0)  # what is under way arrives
    return {'sent': float(sum(sent.values())), 'seconds': seconds}
