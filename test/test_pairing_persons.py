# SPDX-License-Identifier: Apache-2.0
"""Samples of several persons: stored as a set, and followed where they have MoCap."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from streams import MS, START, S

from rpgd_ros.core.geometry import Array, IntArray
from rpgd_ros.pairing import JointStream, Persons, follow

PERIOD = 33 * MS
J = 3


def crowd(n: int, sizes: list[int], seed: int = 0) -> tuple[IntArray, list[Array]]:
    """Return n stamps and the joints (P J, 2) of as many persons as `sizes` says, in turn."""
    rng = np.random.default_rng(seed)
    stamps = START + PERIOD * np.arange(n)
    return stamps, [rng.random((sizes[i % len(sizes)] * J, 2)) for i in range(n)]


def stream(max_frames: int = 1000) -> JointStream:
    """Return a stream of three joints in two dimensions."""
    return JointStream(max_frames, 1000.0, n_joints=J, n_values=2)


def bits(found: Persons | None) -> tuple[object, ...]:
    """Return all that is in a lent crowd."""
    assert found is not None
    scores = None if found.confidence is None else found.confidence.tobytes()
    return found.values.shape, found.stamp_ns.tobytes(), found.values.tobytes(), scores


def test_order_batches_and_duplicates_change_nothing() -> None:
    """Live, replayed in padded batches, shuffled, twice: the same bits, nobody lost."""
    stamps, values = crowd(300, [2, 1, 3])
    live = stream()
    for stamp, v in zip(stamps, values, strict=True):
        live.add(np.array([stamp]), v[None], v[None, :, 0])
    expected = bits(live.lend_persons())
    assert expected[0] == (300, 3, J, 2)
    order = np.argsort(np.arange(300) + np.random.default_rng(1).uniform(0, 9, 300))
    for rows in (np.arange(300), order, np.repeat(order, 2)):
        replay = stream()
        for part in np.array_split(rows, 7):
            width = max(len(values[i]) for i in part)
            padded = np.full((len(part), width, 2), np.nan)
            for k, i in enumerate(part):
                padded[k, : len(values[i])] = values[i]
            replay.add(stamps[part], padded, padded[..., 0])
        assert bits(replay.lend_persons()) == expected


def test_first_person_is_what_everybody_else_sees() -> None:
    """Samples stay one per stamp, of J joints."""
    stamps, values = crowd(40, [1, 2])
    one = stream()
    for stamp, v in zip(stamps, values, strict=True):
        one.add(np.array([stamp]), v[None], None)
    samples = one.arrays()
    assert samples.values.shape == (40, J, 2)
    np.testing.assert_array_equal(samples.values[7], values[7][:J])
    np.testing.assert_array_equal(one.stamps(), samples.stamp_ns)
    assert one.counts['kept'] == 40


def test_stream_of_one_person_has_no_crowd() -> None:
    """Also where a batch was padded for a message that was not believed."""
    stamps, values = crowd(40, [1])
    one = stream()
    one.add(stamps, np.stack(values), None)
    assert one.lend_persons() is None
    far = np.full((2, 2 * J, 2), np.nan)
    far[0, :J], far[1] = values[0], 7.0
    one.add(np.array([stamps[-1] + PERIOD, stamps[-1] + 3600 * S]), far, None)
    assert one.lend_persons() is None
    assert one.arrays().values.shape == (41, J, 2)


def test_what_was_lent_stays_what_it_is() -> None:
    """A wider message, a late one and a doubled one come afterwards."""
    stamps, values = crowd(60, [1])
    one = stream()
    one.add(stamps[::2], np.stack(values[::2]), None)
    lent = one.lend()
    before = lent.values.tobytes(), lent.stamp_ns.tobytes()
    one.add(stamps[57:58], np.full((1, 3 * J, 2), 5.0), None)
    crowded = one.lend_persons()
    assert crowded is not None
    seen = crowded.values.tobytes()
    one.add(stamps[55:56], np.full((1, 4 * J, 2), 6.0), None)
    one.stamps()
    assert (lent.values.tobytes(), lent.stamp_ns.tobytes()) == before
    assert crowded.values.tobytes() == seen


def test_crowd_takes_no_more_room_than_four_persons() -> None:
    """Twenty persons leave a fifth of the samples; the newest stay."""
    stamps, values = crowd(400, [20])
    one = stream(max_frames=200)
    for stamp, v in zip(stamps, values, strict=True):
        one.add(np.array([stamp]), v[None], None)
    found = one.lend_persons()
    assert found is not None
    assert found.values.shape == (40, 20, J, 2)
    assert found.stamp_ns[-1] == stamps[-1]
    counts = dict(one.counts)
    assert counts.pop('received') == sum(counts.values())


def test_one_crowded_message_takes_no_room_once_it_is_too_long_ago() -> None:
    """Twenty people walk by; afterwards the buffer holds as much of one person as before."""
    stamps, values = crowd(700, [1])
    values[300] = crowd(1, [20])[1][0]
    one = stream(max_frames=200)
    for stamp, v in zip(stamps[:320], values, strict=False):
        one.add(np.array([stamp]), v[None], v[None, :, 0])
    found = one.lend_persons()
    assert found is not None
    assert found.values.shape == (40, 20, J, 2)
    lent = found.values.tobytes(), found.stamp_ns.tobytes()
    for stamp, v in zip(stamps[320:], values[320:], strict=True):
        one.add(np.array([stamp]), v[None], v[None, :, 0])
    assert one.lend_persons() is None
    samples = one.arrays()
    np.testing.assert_array_equal(samples.stamp_ns, stamps[-200:])
    np.testing.assert_array_equal(samples.values, np.stack(values[-200:]))
    assert samples.confidence is not None
    np.testing.assert_array_equal(samples.confidence, samples.values[..., 0])
    assert (found.values.tobytes(), found.stamp_ns.tobytes()) == lent
    counts = dict(one.counts)
    assert counts.pop('received') == sum(counts.values())


def held_bytes(one: JointStream) -> int:
    """Return what the arrays behind lent samples take."""
    samples = one.lend()
    return sum(a.base.nbytes if a.base is not None else a.nbytes for a in samples[:2])


def test_one_crowded_message_does_not_widen_all_that_was_there() -> None:
    """Memory is that of four persons, also where the buffer was full of one before."""
    stamps, values = crowd(4000, [1])
    one = stream(max_frames=3000)
    one.add(stamps, np.stack(values), None)
    alone = held_bytes(one)
    one.add(stamps[-1:] + PERIOD, crowd(1, [20])[1][0][None], None)
    assert one.arrays().values.shape == (600, J, 2)
    assert held_bytes(one) < 6 * alone


@given(
    sizes=st.lists(st.sampled_from([1, 1, 1, 2, 5, 20]), min_size=1, max_size=60),
    cuts=st.lists(st.integers(0, 60), max_size=6),
    seed=st.integers(0, 9),
)
@settings(max_examples=60, derandomize=True, deadline=None)
def test_what_is_kept_of_crowds_is_a_function_of_the_set_of_messages(
    sizes: list[int], cuts: list[int], seed: int
) -> None:
    """However often somebody looks, whatever comes together, and in whatever order."""
    stamps, values = crowd(len(sizes), sizes)
    live = stream(max_frames=12)
    for stamp, v in zip(stamps, values, strict=True):
        live.add(np.array([stamp]), v[None], None)
        live.stamps()
    rng = np.random.default_rng(seed)
    order = np.argsort(np.arange(len(sizes)) + rng.uniform(0, 9, len(sizes)))
    replay = stream(max_frames=12)
    for part in np.split(order, sorted(cuts)):
        width = max((len(values[i]) for i in part), default=J)
        padded = np.full((len(part), width, 2), np.nan)
        for k, i in enumerate(part):
            padded[k, : len(values[i])] = values[i]
        replay.add(stamps[part], padded, None)
    np.testing.assert_array_equal(live.stamps(), replay.stamps())
    np.testing.assert_array_equal(live.arrays().values, replay.arrays().values)
    crowds = live.lend_persons(), replay.lend_persons()
    if crowds[0] is None:
        assert crowds[1] is None
    else:
        assert bits(crowds[0]) == bits(crowds[1])


def test_clearing_forgets_the_crowd() -> None:
    """The next recording may be of one person."""
    stamps, values = crowd(40, [3])
    one = stream()
    one.add(stamps, np.stack(values), None)
    one.clear()
    one.add(stamps, np.stack(values)[:, :J], None)
    assert one.lend_persons() is None


def test_of_two_messages_of_one_stamp_the_fuller_one_stays() -> None:
    """Whichever comes first, also while the stream waits for its time to be believed."""
    stamps, values = crowd(20, [1])
    for lead in (0, 10):
        kept = []
        for widths in ((1, 2), (2, 1)):
            one = stream()
            one.add(stamps[:lead], np.reshape(values[:lead], (-1, J, 2)), None)
            for width in widths:
                one.add(stamps[lead : lead + 1], np.full((1, width * J, 2), float(width)), None)
            one.add(stamps[lead + 1 :], np.stack(values[lead + 1 :]), None)
            kept.append(bits(one.lend_persons()))
        assert kept[0] == kept[1]


def walkers(n: int, rng: np.random.Generator) -> Array:
    """Return three bodies (n, 3, J, 3) that walk about at 100 Hz and pass each other."""
    t = np.arange(n)[:, None, None] / 100.0
    k = np.arange(3)[None, :, None]
    centre = 1.5 * np.concatenate(
        [np.sin(0.7 * t + 2 * k), np.cos(0.9 * t + k), 0 * t + 0.3 * k], 2
    )
    rest = rng.normal(0, 0.3, (3, J, 3))
    return np.asarray(centre[:, :, None] + rest)


def test_skeletons_in_any_order_keep_their_places() -> None:
    """Shuffled in every message; each track is one body."""
    rng = np.random.default_rng(2)
    x = walkers(800, rng)
    order = rng.random((800, 3)).argsort(1)
    stamps = START + 10 * MS * np.arange(800)
    tracks = follow(Persons(stamps, np.take_along_axis(x, order[..., None, None], 1), None))
    assert len(tracks) == 3
    bodies = {int(order[0, k]): k for k in range(3)}
    for body, k in bodies.items():
        np.testing.assert_array_equal(tracks[k].values, x[:, body])


def test_who_leaves_and_comes_back_breaks_no_track() -> None:
    """A place is not taken by another body within a second; joints may be missing."""
    rng = np.random.default_rng(3)
    x = walkers(1000, rng)
    x[300:350, 1] = np.nan  # half a second
    x[600:850, 2] = np.nan
    x[rng.random(x.shape[:3]) < 0.2] = np.nan
    stamps = START + 10 * MS * np.arange(1000)
    tracks = follow(Persons(stamps, x, None))
    assert 3 <= len(tracks) <= 4
    for track in tracks:
        gap = np.diff(track.stamp_ns)
        step = np.linalg.norm(np.diff(track.values, axis=0), axis=-1)
        assert not (step[gap <= 50 * MS] > 0.2).any()
    n_seen = int(np.isfinite(x[..., 0]).any(2).sum())
    assert sum(len(track.stamp_ns) for track in tracks) == n_seen


@pytest.mark.parametrize('n_persons', [1, 2])
def test_nobody_has_no_track(n_persons: int) -> None:
    """Messages without one joint."""
    stamps = START + 10 * MS * np.arange(5)
    assert follow(Persons(stamps, np.full((5, n_persons, J, 3), np.nan), None)) == []


def test_person_who_left_long_ago_makes_no_crowd() -> None:
    """Nobody has to be picked among those whose frames are forgotten."""
    stamps, values = crowd(40, [2])
    store = stream(max_frames=10)
    store.add(stamps[:20], np.stack(values[:20]), None)
    assert store.lend_persons() is not None
    alone = np.stack(values[20:])
    alone[:, J:] = np.nan
    store.add(stamps[20:], alone, None)
    assert store.lend_persons() is None
    np.testing.assert_array_equal(store.arrays().values, alone[-10:, :J])
