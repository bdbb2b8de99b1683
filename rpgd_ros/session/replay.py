# SPDX-License-Identifier: Apache-2.0
"""Feeds a session with a recording."""

from __future__ import annotations

from collections.abc import Callable

from rpgd_ros.io.recording import Recording
from rpgd_ros.session.camera_facts import TF, TF_STATIC, CameraFacts
from rpgd_ros.session.collect import Session


def replay(
    recording: Recording,
    session: Session,
    *,
    progress: Callable[[str, float], None],
    tell: Callable[[str], None],
) -> None:
    """Feed a session with everything that its rig needs of a recording.

    The first CameraInfo and the first pose on TF of a camera hold from the beginning. Another one
    later starts the camera over, as it does live.

    Args:
        recording: Source, and the session's rig.
        session: Fed.
        progress: Told the stage and the share that was read.
        tell: Told what a person should know of the cameras.

    """
    facts = CameraFacts(session, recording.rig)
    told: set[str] = set()

    def note(sentence: str) -> None:
        told.add(sentence)
        tell(sentence)

    topics = _look_ahead(recording, facts, note)
    streams = session.topics()
    n_read, n_messages = 0, max(recording.n_messages, 1)
    for batch in recording.batches(topics):
        stream = streams.get(batch.topic)
        if stream is None:
            _take(facts, batch.topic, batch.payloads, note)
            continue
        session.add(stream, batch.msgtype, batch.payloads, batch.receive_ns)
        n_read += len(batch.payloads)
        progress('reading', n_read / n_messages)
    for camera, problem in facts.problems().items():
        if problem not in told:
            tell(f'camera {camera}: {problem}')


def _look_ahead(
    recording: Recording, facts: CameraFacts, tell: Callable[[str], None]
) -> tuple[str, ...]:
    """Read the first of all facts; return the topics on which others may follow."""
    infos = tuple(facts.info_topics)
    for topics in (infos, (TF_STATIC,), (TF,)):
        for topic, payload in () if _is_known(facts, topics) else recording.facts(topics):
            _take(facts, topic, [payload], tell)
            if _is_known(facts, topics):
                break
    if not facts.from_tf:
        return infos
    return (*infos, TF_STATIC, TF) if facts.needs_moving_tf else (*infos, TF_STATIC)


def _is_known(facts: CameraFacts, topics: tuple[str, ...]) -> bool:
    if TF_STATIC in topics or TF in topics:
        return facts.are_all_placed
    return facts.have_all_intrinsics


def _take(
    facts: CameraFacts, topic: str, payloads: list[bytes], tell: Callable[[str], None]
) -> None:
    if topic in {TF_STATIC, TF}:
        told = facts.take_tf(payloads, is_static=topic == TF_STATIC)
    else:
        camera = facts.info_topics[topic]
        told = [said for payload in payloads for said in facts.take_info(camera, payload)]
    for sentence in told:
        tell(sentence)
