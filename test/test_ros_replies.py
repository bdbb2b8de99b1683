# SPDX-License-Identifier: Apache-2.0
"""Answers of services to clients that the middleware has not found yet."""

from __future__ import annotations

import signal
import time
import warnings
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, cast

import pytest

pytest.importorskip('rclpy')

from fault_report import Measured
from harness import ros_environment, running
from rcl_interfaces.srv import ListParameters
from ros_live import WAIT_S, live

from rpgd_ros.ros import replies
from rpgd_ros.ros.client import NODE
from rpgd_ros.ros.domain import free_domain
from rpgd_ros.ros.replies import DROPPED, FIRST_WAIT_S, MAX_KEPT, REST_S, Replies

if TYPE_CHECKING:
    from rclpy.service import Service

HERE = Path(__file__).parent
FAULTY = str(HERE / 'faulty_calibrator.py')


@pytest.mark.fault(6)
def test_client_that_is_found_late_gets_its_answer(rig: Path, measured: Measured) -> None:
    """Of the node's own services and of those for parameters, once, and nobody sees a warning."""
    with live(rig, program=[FAULTY, 'late_clients']) as node:
        start = time.monotonic()
        assert node.calibrate()[1]['reason'] == 'no_data'
        measured('answered', time.monotonic() - start, 's')
        assert node.child.output.count('dropped\n') == 2
        called = node.peer.begin_call(
            f'{NODE}/list_parameters', seconds=WAIT_S, srv_type=ListParameters
        )
        assert called is not None
        node.wait_until('no answer', called.done)
        assert 'rig_file' in called.result().result.names
        assert node.child.output.count('dropped\n') == 4
        assert node.child.end(signal.SIGINT, seconds=WAIT_S) == 0
        assert 'Warning' not in node.child.output


@pytest.mark.fault(6)
def test_client_that_is_never_found_is_given_up_and_keeps_nobody_waiting(rig: Path) -> None:
    """The middleware drops its answers for real: the log says of which service."""
    domain = free_domain()
    deaf = ros_environment(
        domain,
        FASTRTPS_DEFAULT_PROFILES_FILE=str(HERE / 'deaf_readers.xml'),
        RMW_FASTRTPS_USE_QOS_FROM_XML='1',
    )
    with (
        live(rig, domain=domain, program=[FAULTY, 'hasty']) as node,
        running([str(HERE / 'ros_deaf_caller.py')], deaf) as caller,
    ):
        node.child.wait_for(f'an answer of /{NODE}/reset was not sent', seconds=WAIT_S)
        assert node.call('reset').success
        assert caller.process.poll() is None, caller.output
        assert node.child.end(signal.SIGINT, seconds=WAIT_S) == 0
        assert DROPPED not in node.child.output


class Client:
    """Takes answers after a number of them was dropped, as a service sees it."""

    service_name = 'reset'

    def __init__(self, n_dropped: int) -> None:
        """Drop so many."""
        self.n_dropped = n_dropped
        self.taken: list[object] = []
        self.tried_s: list[float] = []

    def send_response(self, response: object, _header: object) -> None:
        """Take or drop it."""
        self.tried_s.append(replies.time.monotonic())  # type: ignore[attr-defined]
        if len(self.tried_s) > self.n_dropped:
            self.taken.append(response)
        else:
            warnings.warn(f'{DROPPED} (timeout): client', RuntimeWarning, stacklevel=1)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Return a clock that stands until it is set."""
    now = [100.0]
    monkeypatch.setattr(replies, 'time', SimpleNamespace(monotonic=lambda: now[0]))
    return now


@pytest.mark.parametrize('n_dropped', range(9))
def test_answer_is_sent_once_at_the_first_trial_that_reaches(
    clock: list[float], n_dropped: int
) -> None:
    """Each wait is twice the one before; after 13 s the service is named."""
    client, kept = Client(n_dropped), Replies()
    service = kept.keep(cast('Service', client))
    service.send_response('answer', None)
    given_up = polled(kept, clock, 20.0)
    assert not kept.unsent
    is_found = n_dropped <= 6
    assert client.taken == ['answer'] * is_found
    assert given_up == ([] if is_found else ['reset'])
    waits = [b - a for a, b in zip(client.tried_s, client.tried_s[1:], strict=False)]
    assert waits == pytest.approx([0.2 * 2**n for n in range(len(waits))], abs=0.051)


def polled(kept: Replies, clock: list[float], seconds: float) -> list[str]:
    """Poll for some time as the node does; return the services of what was given up."""
    given_up = []
    for _ in range(round(seconds / 0.05)):
        clock[0] += 0.05
        given_up += kept.send_due()
    return given_up


def test_flood_of_clients_that_are_not_found_is_capped(clock: list[float]) -> None:
    """The oldest are given up, and most of the time is left for other work."""
    client, kept = Client(10**6), Replies()
    service = kept.keep(cast('Service', client))
    for n in range(3 * MAX_KEPT):
        service.send_response(n, None)
    assert len(kept.unsent) == MAX_KEPT
    n_trials = len(client.tried_s)
    assert polled(kept, clock, 10.0) == ['reset'] * 2 * MAX_KEPT
    assert 10.0 / (REST_S + 0.05) - 2 <= len(client.tried_s) - n_trials <= 10.0 / REST_S
    assert polled(kept, clock, 4.0) == ['reset'] * MAX_KEPT
    assert not kept.unsent


def test_caller_that_is_found_does_not_wait_for_those_that_have_gone(clock: list[float]) -> None:
    """Who came last is tried first."""
    gone, found, kept = Client(10**6), Client(3), Replies()
    for client, n in ((gone, 60), (found, 1)):
        service = kept.keep(cast('Service', client))
        for _ in range(n):
            service.send_response('answer', None)
        polled(kept, clock, 3.0)
    assert found.taken == ['answer']


def test_those_that_are_found_are_answered_at_once(clock: list[float]) -> None:
    """One at each poll: only trials in vain take time."""
    client, kept = Client(10), Replies()
    service = kept.keep(cast('Service', client))
    for n in range(10):
        service.send_response(n, None)
    clock[0] += FIRST_WAIT_S
    polled(kept, clock, 0.5)
    assert client.taken == list(range(10))


def test_other_warnings_are_shown_as_before() -> None:
    """Also where somebody else listens to them."""
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter('always')
        Replies()
        warnings.warn('something else', RuntimeWarning, stacklevel=1)
        warnings.warn(f'{DROPPED}: client', RuntimeWarning, stacklevel=1)
    assert [str(warning.message) for warning in heard] == ['something else']
