# SPDX-License-Identifier: Apache-2.0
"""Subscriptions to joints that find type and QoS in the graph and hand on serialised messages.

A callback only appends bytes to a list. `flush` hands them on in one go: the decoder takes a batch
for little more than one message, so that the executor stays free for the middleware's queues.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, cast

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.event_handler import QoSRequestedIncompatibleQoSInfo, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import (
    DurabilityPolicy,
    QoSPolicyKind,
    QoSProfile,
    ReliabilityPolicy,
    qos_policy_name_from_kind,
)
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from rpgd_ros.messages import HEADERLESS_TYPES
from rpgd_ros.ros.declare import is_given
from rpgd_ros.ros.message_classes import message_class, not_installed, readable_types
from rpgd_ros.ros.parameters import listed, shown

# Messages that wait while a callback runs, or while other programs have the processors. At 6000
# per second on 15 topics, with 200 a stall of 0.24 s lost 115 of 17 280, with 1000 one of 0.58 s
# lost none.
DEPTH = 1000
MAX_DRAINED = 50  # messages of one topic at a turn, so that the others get theirs
MAX_PENDING_BYTES = 4 * 2**20  # handed on at once beyond it: 0.1 s of a flood stays small
LOG_SECONDS = 5.0  # between two log lines of one kind
# A camera at 1 fps is still alive; a dead one is named within 3 s, reports coming each second.
STALE_SECONDS = 1.8

Deliver = Callable[[str, str, Sequence[bytes], Sequence[int]], None]


class Health(NamedTuple):
    """What is to be said of one input.

    Attributes:
        problem: Sentence; '' = none.
        is_hopeless: Whether waiting does not help against it.
        msg_type: Type subscribed to, '' = none yet.
        qos: Reliability subscribed with, '' = none yet.
        n_received: Messages since start.
        rate_hz: Messages per second since the last question.
        age_s: Time since the last message, NaN before the first.

    """

    problem: str
    is_hopeless: bool
    msg_type: str
    qos: str
    n_received: int
    rate_hz: float
    age_s: float


class JointInput:
    """One topic of skeletons or keypoints.

    Attributes:
        stream: Name of the stream in the session.
        topic: As the rig file has it.
        n_received: Messages since start.
        complaint: What else keeps the stream from being used, '' = nothing: shown with its health.
        is_complaint_hopeless: Whether waiting does not help against that.

    """

    def __init__(
        self,
        node: Node,
        stream: str,
        topic: str,
        msg_type: str,
        deliver: Deliver,
    ) -> None:
        """Look for the topic; subscribe at once where the type is given.

        Args:
            node: The node.
            stream: Name of the stream in the session.
            topic: Topic, relative names allowed.
            msg_type: One of `readable_types`, or '' for the publisher's.
            deliver: Called by `flush` with stream, type, payloads and receive stamps.

        """
        self.stream = stream
        self.topic = topic
        self._node = node
        self._given_type = msg_type
        self._deliver = deliver
        self._group = MutuallyExclusiveCallbackGroup()
        self._subscription: Subscription | None = None
        self._msg_type = ''
        self._class: type | None = None
        self._is_headerless = False
        self._reliability = self._asked = ReliabilityPolicy.RELIABLE
        self._problem = ''
        self._is_hopeless = False
        self._incompatible = ''
        self._payloads: list[bytes] = []
        self._receive_ns: list[int] = []
        self._pending_bytes = 0
        self.n_received = 0
        self.complaint = ''
        self.is_complaint_hopeless = False
        self._n_at_last_question = 0
        self._last_question_s = time.monotonic()
        self._last_message_s = float('nan')
        self._awaited_s = self._last_question_s  # since when a publisher could have sent
        self.poll()

    @property
    def is_subscribed(self) -> bool:
        """Whether a subscription stands."""
        return self._subscription is not None

    def poll(self) -> None:
        """Ask the graph who publishes, and subscribe, or subscribe anew, to fit."""
        name = self._node.resolve_topic_name(self.topic)
        publishers = self._node.get_publishers_info_by_topic(name)
        types = sorted({p.topic_type for p in publishers})
        known = readable_types(self.stream)
        wanted = self._given_type or next((t for t in types if t in known), '')
        self._problem = _problem(name, wanted, types, known)
        self._is_hopeless = bool(types) and wanted not in types
        if wanted and not self._is_hopeless and message_class(wanted) is None:
            self._problem, self._is_hopeless = not_installed(name, wanted), True
            return
        if not publishers:
            self._awaited_s = time.monotonic()
        is_fit = self._asked == ReliabilityPolicy.BEST_EFFORT or _is_reliable(publishers)
        if self._incompatible and not (self._problem or is_fit):  # fit: the other is gone again
            self._problem, self._is_hopeless = self._incompatible, True
        if not wanted:
            return
        reliability = _fitting(publishers)
        if self.is_subscribed and not publishers:
            return
        if (wanted, reliability) != (self._msg_type, self._reliability) or not self.is_subscribed:
            self._subscribe(wanted, reliability)

    def flush(self) -> None:
        """Hand on what has arrived."""
        if not self._payloads:
            return
        payloads, receive_ns = self._payloads, self._receive_ns
        self._payloads, self._receive_ns, self._pending_bytes = [], [], 0
        self._deliver(self.stream, self._msg_type, payloads, receive_ns)

    def health(self) -> Health:
        """Say how the input is doing; the rate counts from the last call."""
        now = time.monotonic()
        elapsed = max(now - self._last_question_s, 1e-3)
        rate = (self.n_received - self._n_at_last_question) / elapsed
        self._n_at_last_question, self._last_question_s = self.n_received, now
        age = now - self._last_message_s
        problem = self._problem
        if not problem and age > STALE_SECONDS:
            problem = f'no message on {shown(self.topic)} for {age:.0f} s'
        if not problem and not self.n_received and now - self._awaited_s > STALE_SECONDS:
            problem = f'no message on {shown(self.topic)} yet'
        problem = '; '.join(filter(None, [problem, self.complaint]))
        is_hopeless = self._is_hopeless or self.is_complaint_hopeless
        qos = self._reliability.name if self.is_subscribed else ''
        return Health(problem, is_hopeless, self._msg_type, qos, self.n_received, rate, age)

    def _subscribe(self, msg_type: str, reliability: ReliabilityPolicy) -> None:
        self.flush()
        if self._subscription is not None:
            # First, because one participant cannot hold two types under one topic name.
            self._node.destroy_subscription(self._subscription)
            self._subscription = None
        self._msg_type, self._reliability, self._incompatible = msg_type, reliability, ''
        self._awaited_s = time.monotonic()
        self._class = message_class(msg_type)
        if self._class is None:  # given, and nobody publishes it yet
            return
        self._is_headerless = msg_type in HEADERLESS_TYPES
        qos = QoSProfile(
            depth=DEPTH, reliability=reliability, durability=DurabilityPolicy.VOLATILE
        )
        try:
            self._subscription = self._node.create_subscription(
                self._class,
                self.topic,
                cast('Callable[[Any], None]', self._on_message),
                qos,
                callback_group=self._group,
                event_callbacks=SubscriptionEventCallbacks(
                    incompatible_qos=self._on_incompatible, use_default_callbacks=False
                ),
                qos_overriding_options=QoSOverridingOptions(self._overridable()),
                raw=True,
            )
            self._asked = qos.reliability  # after the user's overrides, which rclpy writes there
        except RuntimeError as error:  # of rcl, for instance: the topic has another type here
            self._problem = f'{self.topic} cannot be subscribed to as {msg_type}: {error}'
            self._is_hopeless = True

    def _overridable(self) -> list[QoSPolicyKind]:
        # A policy once declared as a parameter keeps its first value: the reliability would no
        # longer follow the publishers, so it is declared only where the user has set it.
        name = self._node.resolve_topic_name(self.topic)
        kinds = [QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH]
        if is_given(self._node, f'qos_overrides.{name}.subscription.reliability'):
            kinds.append(QoSPolicyKind.RELIABILITY)
        return kinds

    def _on_message(self, payload: Any, info: dict[str, int]) -> None:
        self._take(payload, info)
        if self._subscription is None:
            return
        # The executor takes one message per turn, and beside a busy solver a turn is several
        # milliseconds: of 1000 skeletons per second 3 % were lost, and of 3000 none this way.
        handle = self._subscription.handle
        with handle:
            for _ in range(MAX_DRAINED):
                taken = handle.take_message(self._class, True)  # noqa: FBT003
                if taken is None:
                    break
                self._take(*taken)

    def _take(self, payload: bytes, info: dict[str, int]) -> None:
        self._payloads.append(payload)
        # Where messages may lack a header, the time of sending is the nearest to a stamp.
        name = 'source_timestamp' if self._is_headerless else 'received_timestamp'
        self._receive_ns.append(info[name])
        self.n_received += 1
        self._last_message_s = time.monotonic()
        self._pending_bytes += len(payload)
        if self._pending_bytes > MAX_PENDING_BYTES:
            self.flush()

    def _on_incompatible(self, event: QoSRequestedIncompatibleQoSInfo) -> None:
        policy = qos_policy_name_from_kind(event.last_policy_kind)
        self._incompatible = (
            f'a publisher of {self.topic} offers another {policy} than this node asks for: '
            f'set qos_overrides.{self._node.resolve_topic_name(self.topic)}.subscription'
        )
        self._node.get_logger().warning(self._incompatible, throttle_duration_sec=LOG_SECONDS)


def health_by_stream(inputs: Sequence[JointInput]) -> dict[str, Health]:
    """Ask all inputs how they are; those of the parts of one stream answer together."""
    found: dict[str, list[Health]] = {}
    for joints in inputs:
        found.setdefault(joints.stream.partition('/')[0], []).append(joints.health())
    return {stream: _together(parts) for stream, parts in found.items()}


def _together(parts: Sequence[Health]) -> Health:
    if len(parts) == 1:
        return parts[0]
    problems = [part.problem for part in parts if part.problem]
    problem = problems[0] if problems else ''
    if len(problems) > 1:
        problem += f', and the like of {len(problems) - 1} more of {len(parts)} topics'
    ages = [part.age_s for part in parts if part.age_s == part.age_s]  # not NaN
    return parts[0]._replace(
        problem=problem,
        is_hopeless=any(part.is_hopeless for part in parts),
        n_received=sum(part.n_received for part in parts),
        rate_hz=sum(part.rate_hz for part in parts),
        age_s=max(ages, default=float('nan')),
    )


def _fitting(publishers: Sequence[TopicEndpointInfo]) -> ReliabilityPolicy:
    """RELIABLE where every publisher is, else BEST_EFFORT, which hears both."""
    reliable, unreliable = ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT
    return reliable if _is_reliable(publishers) else unreliable


def _is_reliable(publishers: Sequence[TopicEndpointInfo]) -> bool:
    return all(p.qos_profile.reliability == ReliabilityPolicy.RELIABLE for p in publishers)


def _problem(name: str, wanted: str, types: Sequence[str], readable: Sequence[str]) -> str:
    if not types:
        return f'nobody publishes {name}'
    if not wanted:
        known = listed(readable)
        return f'{name} carries {listed([shown(t) for t in types])}; this node reads {known}'
    others = listed([shown(t) for t in types if t != wanted])
    if wanted not in types:
        return f'{name} carries {others}, but its type is given as {wanted}'
    return '' if types == [wanted] else f'{name} carries {others} beside {wanted}'
