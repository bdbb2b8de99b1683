# SPDX-License-Identifier: Apache-2.0
"""A stream stands what clocks and networks do to stamps."""

from __future__ import annotations

import numpy as np
import pytest
from streams import (
    BAG_AT_25_HZ,
    HOUR,
    MS,
    START,
    Message,
    S,
    check_counts,
    contents,
    damaged,
    make_stream,
    regular,
    send,
)


@pytest.mark.fault(12)
@pytest.mark.parametrize('together', [1, 333])
@pytest.mark.parametrize('seed', range(10))
def test_damaged_stream_equals_the_sorted_unique_messages(seed: int, together: int) -> None:
    """Shuffled, doubled, unstamped and far-future messages leave exactly the good ones."""
    rng = np.random.default_rng(seed)
    good = regular(2000)
    bad = damaged(rng, good)
    stream = make_stream()
    assert not send(stream, bad, together=together)
    assert contents(stream) == {m.stamp_ns: m.value for m in good}
    counts = stream.counts
    assert counts['zero_stamp'] == sum(m.stamp_ns == 0 for m in bad)
    assert counts['jump_held'] == sum(m.stamp_ns >= START + HOUR for m in bad)
    assert counts['duplicate'] == len(bad) - 2000 - counts['zero_stamp'] - counts['jump_held']
    check_counts(stream)


def test_stray_at_the_start_does_not_set_the_time() -> None:
    """The first message an hour ahead, as the first of a stream that boots, is dropped."""
    stream = make_stream()
    good = regular(20)
    went_back = send(
        stream, [Message(START + HOUR), *good[:2], Message(START + 2 * HOUR), *good[2:]]
    )
    assert not went_back
    assert contents(stream) == {m.stamp_ns: m.value for m in good}


@pytest.mark.fault(12)
def test_four_far_messages_are_refused_and_five_believed() -> None:
    """The clock of a stream is believed when five successive messages agree."""
    for n, kept in ((4, 21), (5, 26)):
        stream = make_stream(max_age_s=10_000.0)
        later = regular(n, start=START + HOUR)
        send(stream, [*regular(20), *later])
        send(
            stream,
            [Message(START + 20 * BAG_AT_25_HZ)] if n == 4 else [Message(later[-1].stamp_ns + MS)],
        )
        assert stream.counts['kept'] == kept
        assert stream.counts['jump_held'] == 20 + n + 1 - kept


def test_a_message_that_belongs_ends_the_row_of_far_ones() -> None:
    """Far messages between good ones never add up to a jump."""
    stream = make_stream()
    good, far = regular(60), regular(60, start=START + HOUR)
    send(stream, regular(20, start=START - S // 2))
    send(stream, [m for both in zip(far, good, strict=True) for m in both])
    assert stream.newest_ns == good[-1].stamp_ns
    assert stream.counts['jump_held'] == 60


def test_stream_slower_than_a_hertz_is_believed_in_fives() -> None:
    """A detector at 0.5 Hz gives its frames, at most four of them late."""
    stream = make_stream()
    send(stream, regular(23, period=2 * S))
    assert stream.counts['kept'] == 20


@pytest.mark.fault(13)
def test_bag_loop_clears_once_and_loses_nothing_after_it() -> None:
    """Three streams loop at slightly different moments: one epoch, one side only."""
    streams = [make_stream() for _ in range(3)]
    first, second = regular(500), regular(500)
    late = (0, 2, 7)  # messages of the old side that still arrive while the first one jumps
    epochs = 0
    for i in range(1000 + max(late)):
        for stream, delay in zip(streams, late, strict=True):
            if 0 <= i - delay < 1000 and send(stream, [(first + second)[i - delay]]):
                epochs += 1
                for other in streams:
                    if other is not stream:
                        other.start_epoch()
    assert epochs == 1
    for stream in streams:
        assert contents(stream) == {m.stamp_ns: m.value for m in second}
        check_counts(stream)


def test_stream_whose_clock_did_not_jump_comes_back_after_an_epoch() -> None:
    """One clock steps back by 3 s; the other streams lose a second, not the rest of the day."""
    stream = make_stream()
    send(stream, regular(100))
    stream.start_epoch()
    send(stream, regular(100, start=START + 100 * BAG_AT_25_HZ))
    assert 100 - 25 <= stream.counts['kept'] < 100


def test_cleared_stream_starts_over() -> None:
    """After a reset the stream takes any time, and the counts go on."""
    stream = make_stream()
    send(stream, regular(50))
    stream.clear()
    assert not contents(stream)
    assert not send(stream, regular(50, start=START - HOUR))
    assert stream.counts['kept'] == stream.counts['cleared'] == 50


def test_strays_of_many_kinds_do_not_pile_up() -> None:
    """Clocks gone mad: what is held back is bounded, and the stream goes on."""
    stream = make_stream()
    send(stream, regular(20))
    send(stream, [Message(START + (i + 1) * HOUR) for i in range(100)], together=7)
    assert stream.counts['jump_held'] == 100
    assert stream.counts['kept'] == 20
    send(stream, regular(20, start=START + 20 * BAG_AT_25_HZ))
    assert stream.counts['kept'] == 40
    check_counts(stream)


def test_second_epoch_forgets_the_half_done_jump_of_the_first() -> None:
    """Another stream jumps twice before this one has five messages of either side."""
    stream = make_stream()
    send(stream, regular(20, start=START + HOUR))
    send(stream, regular(3))
    stream.start_epoch()
    stream.start_epoch()
    send(stream, regular(4, start=START - HOUR))
    assert stream.counts['kept'] == 0
    send(stream, [Message(START - HOUR + 4 * BAG_AT_25_HZ)])
    assert list(contents(stream)) == [m.stamp_ns for m in regular(5, start=START - HOUR)]
    check_counts(stream)
