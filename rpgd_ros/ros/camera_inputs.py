# SPDX-License-Identifier: Apache-2.0
"""Subscriptions to what is said of the cameras: CameraInfo and TF."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from sensor_msgs.msg import CameraInfo

from rpgd_ros.io.rig import Rig
from rpgd_ros.ros.inputs import LOG_SECONDS, JointInput
from rpgd_ros.ros.transforms import tf_message_class
from rpgd_ros.session import MOCAP, TF, TF_STATIC, CameraFacts, Session

TF_DEPTH = 100  # messages: the static transforms of as many publishers

# Hears every publisher, but not what one of them said before this node came.
FROM_NOW_ON = QoSProfile(
    depth=1, reliability=ReliabilityPolicy.BEST_EFFORT, durability=DurabilityPolicy.VOLATILE
)
# Hears what was said before, of publishers that keep it; does not hear the others at all.
KEPT = QoSProfile(
    depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)
KEPT_TF = QoSProfile(
    depth=TF_DEPTH,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
MOVING_TF = QoSProfile(depth=TF_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)

NO_TF = (
    'its pose is to come from TF, but tf2_msgs is not installed: install ros-jazzy-tf2-msgs, or '
    'give camera_T_world in the rig file'
)


class InfoInput:
    """The CameraInfo topic of one camera: the newest message counts, the others do not."""

    def __init__(self, node: Node, topic: str, take: Callable[[bytes], None]) -> None:
        """Subscribe.

        Args:
            node: The node.
            topic: Topic, relative names allowed.
            take: Called by `flush` with the newest payload.

        """
        self._node = node
        self._topic = topic
        self._take = take
        self._newest: bytes | None = None
        self._group = MutuallyExclusiveCallbackGroup()
        self._qos = FROM_NOW_ON
        self._subscription = self._subscribe()

    def poll(self) -> None:
        """Subscribe anew where publishers come that keep what they said, or others beside them."""
        name = self._node.resolve_topic_name(self._topic)
        found = [p.qos_profile for p in self._node.get_publishers_info_by_topic(name)]
        if not found:
            return
        keep = all(
            (p.durability, p.reliability) == (KEPT.durability, KEPT.reliability) for p in found
        )
        qos = KEPT if keep else FROM_NOW_ON
        if qos is not self._qos:
            self._node.destroy_subscription(self._subscription)
            self._qos = qos
            self._subscription = self._subscribe()

    def flush(self) -> None:
        """Hand on the newest message."""
        if self._newest is not None:
            payload, self._newest = self._newest, None
            self._take(payload)

    def _subscribe(self) -> Subscription:
        return self._node.create_subscription(
            CameraInfo,
            self._topic,
            self._on_message,
            self._qos,
            callback_group=self._group,
            raw=True,
        )

    def _on_message(self, payload: Any) -> None:
        self._newest = payload


class CameraInputs:
    """Hands CameraInfo and TF to the session, logs what changes, says what is missing."""

    def __init__(
        self,
        node: Node,
        session: Session,
        rig: Rig,
        joints: Sequence[JointInput],
        *,
        with_tf: bool,
    ) -> None:
        """Subscribe to what the rig file leaves open.

        Args:
            node: The node.
            session: What is told of the cameras.
            rig: The session's rig.
            joints: Inputs of the session's streams; complaints go there.
            with_tf: Whether the node publishes on TF: others may disagree with it there.

        """
        self._node = node
        self._session = session
        self._facts = CameraFacts(session, rig)
        self._joints = joints
        self._told_s: dict[str, float] = {}
        self._infos = [
            InfoInput(node, topic, self._taker(camera))
            for topic, camera in self._facts.info_topics.items()
        ]
        self._tf_message = tf_message_class()
        self._static: list[bytes] = []
        self._moving: list[bytes] = []
        self._moving_subscription: Subscription | None = None
        self._group = MutuallyExclusiveCallbackGroup()
        if self._tf_message is not None and (with_tf or self._facts.from_tf):
            self._subscribe(TF_STATIC, self._static, KEPT_TF)

    def poll(self) -> None:
        """Follow the graph, hand on what has come, and complain."""
        for info in self._infos:
            info.poll()
        self.flush()
        self._follow_moving_frames()
        self._complain()

    def flush(self) -> None:
        """Hand on what has come."""
        for info in self._infos:
            info.flush()
        self._tell(self._facts.take_tf(_taken(self._static), is_static=True))
        self._tell(self._facts.take_tf(_taken(self._moving), is_static=False))

    def _follow_moving_frames(self) -> None:
        # /tf may carry every joint of the MoCap 240 times a second: heard only where it is needed.
        is_needed = self._tf_message is not None and self._facts.needs_moving_tf
        if is_needed and self._moving_subscription is None:
            self._moving_subscription = self._subscribe(TF, self._moving, MOVING_TF)
        elif not is_needed and self._moving_subscription is not None:
            self._node.destroy_subscription(self._moving_subscription)
            self._moving_subscription = None
            self._moving.clear()

    def _complain(self) -> None:
        problems = self._facts.problems()
        frame = self._session.mocap_frame
        other = self._facts.other_parent(frame) if frame else ''
        if other:
            problems[MOCAP] = (
                f'TF already has frame {frame[:80]!r} below {other[:80]!r}: a frame has one '
                'parent, set mocap_frame to another name, or tf_mode to none'
            )
        for joints in self._joints:
            problem = problems.get(joints.stream, '')
            is_deaf = self._tf_message is None and joints.stream in self._facts.from_tf
            joints.is_complaint_hopeless = is_deaf
            joints.complaint = NO_TF if is_deaf else problem

    def _taker(self, camera: str) -> Callable[[bytes], None]:
        return lambda payload: self._tell(self._facts.take_info(camera, payload))

    def _tell(self, sentences: Sequence[str]) -> None:
        for sentence in sentences:
            subject = sentence.partition(':')[0]  # a camera that never stands still is told seldom
            now = time.monotonic()
            if now >= self._told_s.get(subject, -math.inf) + LOG_SECONDS:
                self._told_s[subject] = now
                self._node.get_logger().warning(sentence)

    def _subscribe(self, topic: str, payloads: list[bytes], qos: QoSProfile) -> Subscription:
        def append(payload: Any) -> None:
            payloads.append(payload)

        return self._node.create_subscription(
            self._tf_message, topic, append, qos, callback_group=self._group, raw=True
        )


def _taken(payloads: list[bytes]) -> list[bytes]:
    taken = payloads.copy()
    payloads.clear()
    return taken
