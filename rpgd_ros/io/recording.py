# SPDX-License-Identifier: Apache-2.0
"""A recording: a rig and the streams that belong to it, whatever they came from."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, Protocol

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.io.bag import TopicInfo, absolute_name, open_bag
from rpgd_ros.io.rig import Rig, RigCamera
from rpgd_ros.messages import CAMERA_INFO, KEYPOINT_TYPES, POSE_STAMPED, SKELETON_TYPES
from rpgd_ros.messages.cdr import FRAME_OFFSET

# Messages gathered before they are handed on by topic: batches of about 100 decode fastest, and
# the order between topics is off by less than the jitter of a network.
WINDOW = 256
MAX_TOPICS_SHOWN = 20


class Source(Protocol):
    """Where messages come from: a `io.bag.Bag`, or a reader that gives the same."""

    @property
    def topics(self) -> Mapping[str, TopicInfo]:
        """What there is, by absolute topic name."""
        ...

    @property
    def problem(self) -> str:
        """What is missing, '' = nothing; complete after `stream` only."""
        ...

    def stream(self, topics: Collection[str]) -> Iterator[tuple[str, int, bytes]]:
        """Yield topic, arrival (ns) and serialised message, in the order of the recording."""
        ...


class MessageBatch(NamedTuple):
    """Messages of one topic that follow each other.

    Attributes:
        topic: As the rig file names it.
        msgtype: Their type.
        receive_ns: (B,) arrivals.
        payloads: (B,) serialised messages.

    """

    topic: str
    msgtype: str
    receive_ns: list[int]
    payloads: list[bytes]


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """A rig with its streams.

    Attributes:
        rig: Who is who.
        source: Where the messages come from.
        name: Of the source, for messages to people.
        warnings: Cameras of the rig that the source knows nothing of.

    Raises:
        InputError: MISSING_TOPIC, MISSING_INTRINSICS or BAD_BAG: without what is missing, there
            is no calibration.

    """

    rig: Rig
    source: Source
    name: str
    warnings: tuple[str, ...] = field(init=False)

    def __post_init__(self) -> None:
        """Check that the topics are there and can be read."""
        if not any(info.n_messages for info in self.source.topics.values()):
            raise InputError(Reason.BAD_BAG, f'{self.name} holds no messages at all')
        mocap = self.rig.mocap
        skeletons = [
            topic
            for topic, joint in self.rig.mocap_topics.items()
            if self._has(topic, mocap.type or (POSE_STAMPED if joint else ''))
        ]
        if not skeletons:
            raise self._missing([mocap.topic], 'the skeleton')
        absent = [
            c for c in self.rig.cameras
            if not self._has(c.keypoints_topic, c.type, known=KEYPOINT_TYPES)
        ]  # fmt: skip
        if len(absent) == len(self.rig.cameras):
            raise self._missing([c.keypoints_topic for c in absent], 'any keypoints')
        for camera in self.rig.cameras:
            if camera not in absent and camera.camera is None:
                self._check_camera_info(camera)
        object.__setattr__(
            self,
            'warnings',
            tuple(
                f'camera {c.name}: no messages on {absolute_name(c.keypoints_topic)!r}, so it is '
                'not calibrated against'
                for c in absent
            ),
        )

    @property
    def topics(self) -> dict[str, str]:
        """Topics of skeletons and keypoints that have messages: absolute name to the rig's."""
        names = [*self.rig.mocap_topics, *(c.keypoints_topic for c in self.rig.cameras)]
        return {absolute_name(name): name for name in names if self._count(name)}

    @property
    def n_messages(self) -> int:
        """Number of skeletons and keypoints."""
        return sum(self._count(topic) for topic in self.topics)

    def facts(self, topics: Collection[str]) -> Iterator[tuple[str, bytes]]:
        """Yield what some other topics of the rig say (CameraInfo, TF), in their order.

        Args:
            topics: As the rig file names them; those that there are not are left out.

        Yields:
            Topic and serialised message.

        """
        wanted = {absolute_name(topic): topic for topic in topics if self._count(topic)}
        for topic, _, payload in self.source.stream(wanted) if wanted else ():
            yield wanted[topic], payload

    def batches(self, facts: Collection[str] = ()) -> Iterator[MessageBatch]:
        """Yield skeletons and keypoints, about in the order of the recording.

        Messages of one topic keep their order.

        Args:
            facts: Topics of CameraInfo or TF that are yielded with them. A message that says
                something new stands between the joints of before and after.

        Raises:
            InputError: Nothing at all can be read.

        """
        topics = {absolute_name(topic): topic for topic in facts if self._count(topic)}
        last = dict.fromkeys(topics, b'')
        topics |= self.topics
        pending: dict[str, MessageBatch] = {}
        n_pending = 0
        for topic, receive_ns, payload in self.source.stream(topics):
            msgtype = self.source.topics[topic].msgtype
            if topic in last:
                if payload[FRAME_OFFSET:] == last[topic]:
                    continue
                last[topic] = payload[FRAME_OFFSET:]
                yield from pending.values()
                pending, n_pending = {}, 0
                yield MessageBatch(topics[topic], msgtype, [receive_ns], [payload])
                continue
            batch = pending.get(topic)
            if batch is None:
                batch = pending[topic] = MessageBatch(topics[topic], msgtype, [], [])
            batch.receive_ns.append(receive_ns)
            batch.payloads.append(payload)
            n_pending += 1
            if n_pending == WINDOW:
                yield from pending.values()
                pending, n_pending = {}, 0
        yield from pending.values()

    def _count(self, topic: str) -> int:
        info = self.source.topics.get(absolute_name(topic))
        return info.n_messages if info else 0

    def _has(
        self, topic: str, expected_type: str, known: Collection[str] = SKELETON_TYPES
    ) -> bool:
        """Tell whether a stream of joints is there; refuse a type that is none."""
        if not self._count(topic):
            return False
        msgtype = self.source.topics[absolute_name(topic)].msgtype
        allowed = (expected_type,) if expected_type else known
        if msgtype not in allowed:
            msg = (
                f'{self.name}: topic {absolute_name(topic)!r} has type {msgtype!r}; '
                f'needed: {" or ".join(allowed)}'
            )
            raise InputError(Reason.BAD_BAG, msg)
        return True

    def _check_camera_info(self, camera: RigCamera) -> None:
        topic = camera.camera_info_topic
        info = self.source.topics.get(absolute_name(topic))
        if not topic or info is None or not info.n_messages or info.msgtype != CAMERA_INFO:
            where = f'a {CAMERA_INFO} on {absolute_name(topic)!r}' if topic else 'a topic of it'
            msg = (
                f'camera {camera.name} has no intrinsics: the rig file has none, and {self.name} '
                f'has not {where}. {self._inventory()}'
            )
            raise InputError(Reason.MISSING_INTRINSICS, msg)

    def _missing(self, topics: list[str], what: str) -> InputError:
        names = ', '.join(repr(absolute_name(topic)) for topic in topics)
        msg = f'{self.name} has no messages for {what}: looked for {names}. {self._inventory()}'
        return InputError(Reason.MISSING_TOPIC, msg)

    def _inventory(self) -> str:
        """Say which topics there are."""
        shown = [
            f'{topic[:80]} ({info.msgtype[:80]}, {info.n_messages} messages)'
            for topic, info in self.source.topics.items()
        ]
        n_more = len(shown) - MAX_TOPICS_SHOWN
        more = f', and {n_more} more' if n_more > 0 else ''
        return f'It has: {", ".join(shown[:MAX_TOPICS_SHOWN])}{more}'


@contextmanager
def open_recording(path: Path | str, rig: Rig) -> Iterator[Recording]:
    """Open a bag as a recording, for a `with` statement.

    Raises:
        InputError: The bag cannot be read, or has not what the rig needs.

    """
    with open_bag(path) as bag:
        yield Recording(rig, bag, str(path))
