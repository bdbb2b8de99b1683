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


@pytest.mark.parametrize('number', SIGNALS)
def test_the_first_signal_stops_and_the_second_does_not(number: signal.Signals) -> None:
    """The clean-up that the first one started is not cut."""
    cleaned = False
    with stop_on_signals() as stop, pytest.raises(Stopped):
        try:
            signal.raise_signal(number)
        finally:
            signal.raise_signal(number)
            cleaned = True
    assert cleaned
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
