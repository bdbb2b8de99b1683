# SPDX-License-Identifier: Apache-2.0
"""A peer of the node: plays recordings to it over DDS, listens to it and calls its services."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from types import TracebackType
from typing import Any, Self

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.client import Client
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.task import Future
from sensor_msgs.msg import CameraInfo
from std_srvs.srv import Trigger

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.messages import CAMERA_INFO
from rpgd_ros.ros.health import who
from rpgd_ros.ros.message_classes import OWN
from rpgd_ros.ros.parameters import listed, shown
from rpgd_ros.ros.transforms import LATCHED

PLAYABLE: dict[str, type] = {**OWN, CAMERA_INFO: CameraInfo}

SPIN_SECONDS = 0.05  # longest time without a look at the caller's condition
PLAY_DEPTH = 1000  # messages kept for a subscriber that is behind: 1 s at 1000 messages per second
NS_PER_S = 1_000_000_000


Timed = tuple[str, int, bytes]  # topic, time of the recording in ns, serialised message


class Peer:
    """A node in a context of its own, which leaves the signals of the process alone.

    Everything happens in the calling thread: messages are taken while `wait_until` runs.
    """

    def __init__(
        self,
        name: str,
        *,
        domain_id: int | None = None,
        namespace: str = '',
        check: Callable[[], None] | None = None,
    ) -> None:
        """Join the graph.

        Args:
            name: Name of the node.
            domain_id: Domain; None = that of the environment.
            namespace: For topics and services with relative names.
            check: Called at every step of a wait and of a replay; ends either by raising.

        """
        self._check = check or (lambda: None)
        self._context = Context()
        self._context.init(domain_id=domain_id)
        self.node = Node(
            name, namespace=namespace, context=self._context, start_parameter_services=False
        )
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._publishers: dict[str, Publisher] = {}
        self._newest: dict[str, Any] = {}
        self._clients: dict[str, Client] = {}

    def __enter__(self) -> Self:
        """Return the peer."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Leave the graph."""
        self.close()

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()

    def wait_until(self, condition: Callable[[], bool], *, seconds: float) -> bool:
        """Take messages until a condition holds.

        Args:
            condition: Asked after each message and at least every `SPIN_SECONDS`.
            seconds: Longest wait.

        Returns:
            Whether it held in time.

        """
        end = time.monotonic() + seconds
        while not condition():
            self._check()
            left = end - time.monotonic()
            if left <= 0.0:
                return False
            self._executor.spin_once(timeout_sec=min(left, SPIN_SECONDS))
        return True

    def advertise(self, topics: Mapping[str, str], *, is_reliable: bool = True) -> None:
        """Open a publisher for each topic.

        Args:
            topics: Type by topic.
            is_reliable: Whether to offer RELIABLE, else BEST_EFFORT.

        Raises:
            InputError: A type that cannot be played.

        """
        policy = ReliabilityPolicy.RELIABLE if is_reliable else ReliabilityPolicy.BEST_EFFORT
        qos = QoSProfile(depth=PLAY_DEPTH, reliability=policy)
        for topic, msg_type in topics.items():
            if msg_type not in PLAYABLE:
                known = listed(list(PLAYABLE))
                msg = f'{topic}: {shown(msg_type)} cannot be played, only {known}'
                raise InputError(Reason.BAD_BAG, msg)
            cls = PLAYABLE[msg_type]
            self._publishers[topic] = self.node.create_publisher(cls, topic, qos)

    @property
    def advertised(self) -> list[str]:
        """The advertised topics."""
        return list(self._publishers)

    def without_subscriber(self) -> list[str]:
        """Return the advertised topics that nobody listens to."""
        return [
            topic
            for topic, publisher in self._publishers.items()
            if not publisher.get_subscription_count()
        ]

    def play(
        self,
        messages: Iterable[Timed],
        *,
        rate: float,
        on_sent: Callable[[int], None] | None = None,
    ) -> dict[str, int]:
        """Publish messages at the distances in time at which they were recorded.

        Args:
            messages: In the order of their times.
            rate: How many times faster than recorded.
            on_sent: Told the number of messages sent so far, after each.

        Returns:
            Number of messages published by topic.

        """
        sent = dict.fromkeys(self._publishers, 0)
        start_s, start_ns = time.monotonic(), 0
        for n_sent, (topic, time_ns, payload) in enumerate(messages, 1):
            start_ns = start_ns or time_ns
            due = start_s + (time_ns - start_ns) / (NS_PER_S * rate)
            while (wait := due - time.monotonic()) > 0.0:
                time.sleep(min(wait, SPIN_SECONDS))
                self._check()
            self._publishers[topic].publish(payload)
            sent[topic] += 1
            if on_sent is not None:
                on_sent(n_sent)
        return sent

    def listen(self, topic: str, msg_type: type, *, qos: QoSProfile = LATCHED) -> None:
        """Keep the newest message of a topic for `newest`."""
        self.node.create_subscription(
            msg_type, topic, lambda message: self._newest.__setitem__(topic, message), qos
        )

    def newest(self, topic: str) -> Any:
        """Return the newest message of a topic listened to, or None."""
        return self._newest.get(topic)

    def listen_diagnostics(self) -> None:
        """Begin to listen to /diagnostics for `diagnostics`."""
        self.node.create_subscription(
            DiagnosticArray,
            '/diagnostics',
            self._on_diagnostics,
            10,
        )

    def diagnostics(self, name: str) -> dict[str, str]:
        """Return the newest figures of one entry of /diagnostics, {} before the first."""
        status = self._entry(name)
        return {pair.key: pair.value for pair in status.values} if status else {}

    def message(self, name: str) -> str:
        """Return the newest sentence of one entry of /diagnostics, '' before the first."""
        status = self._entry(name)
        return str(status.message) if status else ''

    def level(self, name: str) -> bytes:
        """Return the newest level of one entry of /diagnostics, b'' before the first."""
        status = self._entry(name)
        return bytes(status.level) if status else b''

    def call(self, service: str, *, seconds: float) -> Trigger.Response | None:
        """Call a Trigger service.

        Args:
            service: Full name.
            seconds: Longest wait, for the service to appear and for its answer.

        Returns:
            Its answer, or None where none came in time.

        """
        future = self.begin_call(service, seconds=seconds)
        if future is None:
            return None
        if not self.wait_until(future.done, seconds=seconds):
            self._clients[service].remove_pending_request(future)
            return None
        return future.result()

    def begin_call(
        self, service: str, *, seconds: float, srv_type: Any = Trigger, request: Any = None
    ) -> Future | None:
        """Call a service without waiting for its answer.

        Args:
            service: Full name.
            seconds: Longest wait for the service to appear.
            srv_type: Type of the service.
            request: What to send; None = an empty request.

        Returns:
            A future of the answer, completed while `wait_until` runs; None without the service.

        """
        if service not in self._clients:
            self._clients[service] = self.node.create_client(srv_type, service)
        client = self._clients[service]
        if not self.wait_until(client.service_is_ready, seconds=seconds):
            return None
        return client.call_async(srv_type.Request() if request is None else request)

    def _entry(self, name: str) -> Any:
        return self._newest.get(f'{who(self.node.get_namespace())}: {name}')

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        self._newest.update({status.name: status for status in array.status})
