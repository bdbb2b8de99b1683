# SPDX-License-Identifier: Apache-2.0
"""What may be begun while something else runs, and once the node is to end."""

from __future__ import annotations

import json
import threading
from collections.abc import Coroutine
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import pytest

pytest.importorskip('rclpy')

from ros_live import WAIT_S
from studio import make_rig

from rpgd_ros.ros.engine import Engine
from rpgd_ros.ros.job import Outcome
from rpgd_ros.session import Session
from rpgd_ros.session.monitor import Monitor

if TYPE_CHECKING:
    from rclpy.node import Node

    from rpgd_ros.ros.results import Results


class SlowResults:
    """Results whose save takes until it is let go."""

    path = 'result.yaml'

    def __init__(self) -> None:
        """Begin nothing."""
        self.may_end = threading.Event()

    def write_again(self, _worker: object) -> None:
        """Wait."""
        assert self.may_end.wait(WAIT_S)


@pytest.fixture
def results() -> SlowResults:
    """Return results of which no save ends by itself."""
    return SlowResults()


@pytest.fixture
def engine(results: SlowResults) -> Engine:
    """Return an engine without a node around it."""
    session = Session(make_rig())
    node = cast('Node', SimpleNamespace(executor=None))
    monitor = Monitor(session, max_age_s=300.0)
    return Engine(node, session, cast('Results', results), monitor=monitor, flush=lambda: None)


def at_once(job: Coroutine[Any, Any, Any]) -> Any:
    """Return what a coroutine returns without waiting for anything."""
    with pytest.raises(StopIteration) as ended:
        job.send(None)
    return ended.value.value


def answers(engine: Engine) -> list[dict[str, str]]:
    """Return what all that can be begun is refused with."""
    calibrated = at_once(engine.calibrate(is_automatic=False))
    assert isinstance(calibrated, Outcome)
    found = [{'reason': str(calibrated.reason), 'message': calibrated.message}]
    for job in (engine.save(), engine.revert(), engine.load()):
        success, message = at_once(job)
        assert not success
        found.append(json.loads(message))
    return found


def test_nothing_is_begun_while_a_result_is_saved(engine: Engine, results: SlowResults) -> None:
    """And it is said that a save runs, not a calibration."""
    save = engine.save()
    save.send(None)
    assert engine.is_busy
    for refused in answers(engine):
        assert refused['reason'] == 'busy'
        assert 'a result is being saved' in refused['message']
    results.may_end.set()
    engine._worker._thread.join(WAIT_S)  # type: ignore[union-attr]  # noqa: SLF001
    assert at_once(save) == (True, 'saved to result.yaml')
    assert not engine.is_busy


def test_nothing_is_begun_once_the_node_is_to_end(engine: Engine) -> None:
    """Neither a calibration nor a save, which the end would not wait for."""
    engine.request_stop()
    for refused in answers(engine):
        assert refused['reason'] == 'cancelled'


def test_job_that_cannot_be_begun_does_not_keep_the_node_busy(
    engine: Engine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The system has no thread left: the next call may find one."""

    def no_thread(_self: threading.Thread) -> None:
        msg = "can't start new thread"
        raise RuntimeError(msg)

    monkeypatch.setattr(threading.Thread, 'start', no_thread)
    with pytest.raises(RuntimeError, match='new thread'):
        engine.save().send(None)
    assert not engine.is_busy
