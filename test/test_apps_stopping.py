# SPDX-License-Identifier: Apache-2.0
"""A signal ends a program once, through its clean-up."""

from __future__ import annotations

import signal

import pytest

from rpgd_ros.apps.stopping import Stopped, stop_on_signals

SIGNALS = [signal.SIGINT, signal.SIGTERM]


class _Noisy:
    """Something whose destructor is running while a signal comes."""

    def __del__(self) -> None:
        signal.raise_signal(signal.SIGINT)


def interrupted_twice(number: int) -> None:
    """Be interrupted, and again within the clean-up, which must come to its end."""
    try:
        signal.raise_signal(number)
    finally:
        signal.raise_signal(number)


@pytest.mark.parametrize('number', SIGNALS)
def test_the_first_signal_stops_and_the_second_does_not(number: signal.Signals) -> None:
    """The clean-up that the first one started is not cut."""
    with stop_on_signals() as stop:
        with pytest.raises(Stopped) as stopped:
            interrupted_twice(number)
        assert stopped.value.__context__ is None  # no second one was raised on top of it
        assert stop.is_set()


@pytest.mark.filterwarnings('ignore::pytest.PytestUnraisableExceptionWarning')
def test_a_stop_that_python_drops_can_still_be_seen() -> None:
    """No exception leaves a destructor; the event is there for that."""
    with stop_on_signals() as stop:
        _Noisy()
        assert stop.is_set()


def test_the_handlers_are_put_back() -> None:
    """What comes after is none of our business."""
    before = [signal.getsignal(number) for number in SIGNALS]
    with stop_on_signals():
        assert [signal.getsignal(number) for number in SIGNALS] != before
    assert [signal.getsignal(number) for number in SIGNALS] == before
