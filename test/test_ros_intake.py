# SPDX-License-Identifier: Apache-2.0
"""What became of the messages: when an automatic run has something new, and what is told."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import drivers
import numpy as np
import pytest

pytest.importorskip('rclpy')

from studio import START, S, Studio, feed, make_studio

from rpgd_ros.messages import POINT_CLOUD2, encode_point_cloud2
from rpgd_ros.messages.adapters.types import OPENPOSE_LIST
from rpgd_ros.ros import health
from rpgd_ros.ros.inputs import LOG_SECONDS, STALE_SECONDS, Health
from rpgd_ros.ros.intake import NOT_COLLECTING, Intake
from rpgd_ros.ros.node import CalibratorNode
from rpgd_ros.session import MOCAP, Session
from rpgd_ros.session.monitor import Monitor

if TYPE_CHECKING:
    from collections.abc import Sequence

FINE = Health('', False, POINT_CLOUD2, 'RELIABLE', 100, 30.0, 0.01)  # noqa: FBT003
LATER_NS = START + 20 * S
LONG = STALE_SECONDS + 1.0


@pytest.fixture(scope='module')
def studio() -> Studio:
    """Return a walk of twelve seconds before two cameras."""
    return make_studio()


@pytest.fixture
def session(studio: Studio) -> Session:
    """Return a session that holds the walk."""
    return feed(Session(studio.rig), studio.messages, together=600)


def keypoints(n: int, *, frame: str = 'cam0', n_joints: int = 17) -> list[bytes]:
    """Return a second or more of keypoints that come after the walk."""
    uv = np.random.default_rng(3).uniform(0.0, 700.0, (n_joints, 2))
    return [encode_point_cloud2(LATER_NS + i * S // 30, frame, uv) for i in range(n)]


def send(session: Session, payloads: Sequence[bytes]) -> None:
    """Hand messages of cam0 to a session."""
    session.add('cam0', POINT_CLOUD2, payloads, [0] * len(payloads))


def told(intake: Intake, now_s: float, *, is_collecting: bool = True) -> str:
    """Return what is said of cam0."""
    found = intake.judged({'cam0': FINE}, is_collecting=is_collecting, now_s=now_s)
    return found['cam0'].problem


class Automatic:
    """The timer of automatic calibrations, around a session; counts the runs it begins."""

    def __init__(self, session: Session) -> None:
        """Begin enabled, with nothing calibrated."""
        self.n_runs = 0
        auto = SimpleNamespace(enabled=True)
        buffer = SimpleNamespace(min_motion=0.5)
        self.node = SimpleNamespace(
            _joints=[SimpleNamespace(n_received=0)],
            _live=SimpleNamespace(config=SimpleNamespace(auto=auto, buffer=buffer)),
            _engine=SimpleNamespace(session=session, calibrate=self.calibrate),
            _intake=Intake(session),
            _flush=lambda: None,
            _is_enabled=True,
            _n_at_last_run=0,
            is_busy=False,
        )

    async def calibrate(self, *, is_automatic: bool) -> None:
        """Count a run."""
        assert is_automatic
        self.n_runs += 1

    def tick(self, n_received: int = 100) -> int:
        """Let messages come and the timer fire; return the number of runs so far."""
        self.node._joints[0].n_received += n_received  # noqa: SLF001
        asyncio.run(CalibratorNode._on_auto(cast('Any', self.node)))  # noqa: SLF001
        return self.n_runs


def test_automatic_run_needs_newly_stored_messages(session: Session) -> None:
    """Messages that are all dropped change nothing that could be calibrated."""
    automatic = Automatic(session)
    assert automatic.tick() == 1
    send(session, keypoints(30, n_joints=5))
    assert automatic.tick() == 1
    send(session, keypoints(30))
    assert automatic.tick() == 2
    assert automatic.tick() == 2


def test_no_automatic_run_is_begun_while_collecting_is_off(session: Session) -> None:
    """What was stored before is calibrated once collecting goes on."""
    automatic = Automatic(session)
    automatic.node._is_enabled = False  # noqa: SLF001
    assert [automatic.tick() for _ in range(5)] == [0] * 5
    automatic.node._is_enabled = True  # noqa: SLF001
    assert automatic.tick() == 1


def test_clearing_is_nothing_new_to_calibrate(session: Session) -> None:
    """After ~/reset the number of stored messages is what it was."""
    automatic = Automatic(session)
    assert automatic.tick() == 1
    n_stored = automatic.node._intake.n_stored()  # noqa: SLF001
    session.reset()
    assert automatic.node._intake.n_stored() == n_stored  # noqa: SLF001


@pytest.mark.parametrize(
    ('payloads', 'reason'),
    [
        (keypoints(60, frame='other'), 'frame_changed'),
        (keypoints(60, n_joints=5), 'wrong_joints'),
        ([encode_point_cloud2(0, 'cam0', np.ones((17, 2)))] * 60, 'zero_stamp'),
    ],
)
def test_stream_that_nothing_is_taken_from_any_more_is_told_with_the_reason(
    session: Session, payloads: list[bytes], reason: str
) -> None:
    """Although what it sent before is still kept."""
    intake = Intake(session)
    assert told(intake, 0.0) == ''
    send(session, payloads)
    assert told(intake, 1.0) == ''
    said = told(intake, LONG)
    assert said.startswith("messages arrive on 'cam0/kp', but none could be used: " + reason)
    assert ('~/reset' in said) == (reason == 'frame_changed')
    judged = intake.judged({'cam0': FINE}, is_collecting=True, now_s=LONG)
    (entry,) = health.input_statuses(session, judged, Monitor(session, max_age_s=300.0))
    assert (entry.level, entry.message) == (health.WARN, said)


def test_reset_makes_an_end_of_a_changed_frame(session: Session) -> None:
    """The next messages are taken, and nothing is told any more."""
    intake = Intake(session)
    told(intake, 0.0)
    send(session, keypoints(60, frame='other'))
    assert told(intake, LONG)
    session.reset()
    send(session, keypoints(60, frame='other'))
    assert told(intake, LONG + 1.0) == ''


def test_some_dropped_messages_are_not_told(session: Session) -> None:
    """One of another frame between good ones costs itself only."""
    intake = Intake(session)
    told(intake, 0.0)
    send(session, [*keypoints(60), *keypoints(300, frame='other')])
    assert told(intake, LONG) == ''


def test_stream_that_never_gave_anything_is_told(studio: Studio) -> None:
    """From the first message on nothing fits."""
    session = Session(studio.rig)
    intake = Intake(session)
    told(intake, 0.0)
    send(session, keypoints(60, n_joints=5))
    assert 'none could be used: wrong_joints' in told(intake, LONG)


def test_empty_messages_of_an_empty_room_are_not_told(session: Session) -> None:
    """A detector says so when nobody is there; later the person comes back."""
    intake = Intake(session)
    told(intake, 0.0)
    empty = drivers.serialise(drivers.openpose_list([]))
    session.add('cam0', OPENPOSE_LIST, [empty] * 60, [LATER_NS] * 60)
    assert session.counts('cam0')['nobody'] == 60
    assert told(intake, LONG) == ''


def test_nothing_is_told_of_dropped_messages_while_collecting_is_off(session: Session) -> None:
    """Nor at once when it goes on: the time counts from there."""
    intake = Intake(session)
    told(intake, 0.0)
    send(session, keypoints(60, n_joints=5))
    assert told(intake, LONG, is_collecting=False) == ''
    assert told(intake, LONG + 1.0) == ''
    (entry,) = health.input_statuses(
        session, {'cam0': FINE}, Monitor(session, max_age_s=300.0), is_collecting=False
    )
    assert (entry.level, entry.message) == (health.OK, NOT_COLLECTING)


def test_problem_of_the_subscription_goes_before(session: Session) -> None:
    """A stream that fell silent is told to be silent."""
    intake = Intake(session)
    told(intake, 0.0)
    send(session, keypoints(60, n_joints=5))
    silent = FINE._replace(problem='no message on cam0/kp for 3 s')
    assert intake.judged({'cam0': silent}, is_collecting=True, now_s=LONG) == {'cam0': silent}


def test_jumping_clock_is_logged_with_a_throttle(
    studio: Studio, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two publishers with two clocks on one topic would fill the disk."""
    logged: list[tuple[str, dict[str, float]]] = []

    def warning(message: str, **keywords: float) -> None:
        logged.append((message, keywords))

    logger = SimpleNamespace(warning=warning)
    monkeypatch.setattr('rclpy.node.Node.get_logger', lambda _: logger)
    node = SimpleNamespace(_is_enabled=True, _engine=SimpleNamespace(session=Session(studio.rig)))
    walk = [payload for _, payload, _ in studio.of(MOCAP)]
    for part in (walk[600:610], walk[:10]):
        late = [encode_later(payload, 0 if part[0] is walk[0] else 3600) for payload in part]
        CalibratorNode._on_joints(  # noqa: SLF001
            cast('Any', node), MOCAP, POINT_CLOUD2, late, [0] * len(late)
        )
    assert [keywords for _, keywords in logged] == [{'throttle_duration_sec': LOG_SECONDS}]


def encode_later(payload: bytes, seconds: int) -> bytes:
    """Return a little endian message whose stamp is later."""
    stamp = int.from_bytes(payload[4:8], 'little') + seconds
    return payload[:4] + stamp.to_bytes(4, 'little') + payload[8:]
