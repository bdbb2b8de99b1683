# SPDX-License-Identifier: Apache-2.0
"""Streams are stored by stamp, whatever the order; pairing interpolates to the camera."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule, run_state_machine_as_test

from rpgd_ros.core import InputError
from rpgd_ros.core.geometry import Array, IntArray
from rpgd_ros.pairing import BufferConfig, JointStream, Samples, SyncConfig, match, pair

S = 1_000_000_000
MS = 1_000_000
START = 1_700_000_000 * S
HOUR = 3600 * S
BAG_AT_25_HZ = 40 * MS


class Message(NamedTuple):
    """One message: a stamp and one joint."""

    stamp_ns: int
    value: float = 1.0


def joint(stamp_ns: int) -> float:
    """Return a coordinate that tells its stamp."""
    return (stamp_ns - START) / S


def send(stream: JointStream, messages: Sequence[Message], *, together: int = 1) -> bool:
    """Feed messages in batches; return whether a backward jump was believed."""
    went_back = False
    for i in range(0, len(messages), together):
        batch = messages[i : i + together]
        stamps = np.array([m.stamp_ns for m in batch], np.int64)
        values = np.array([m.value for m in batch])[:, None, None] * np.ones((1, 2, 3))
        went_back |= stream.add(stamps, values, values[:, :, 0])
    return went_back


def make_stream(max_frames: int = 20_000, max_age_s: float = 1000.0) -> JointStream:
    """Return a stream of two joints in 3D."""
    return JointStream(max_frames, max_age_s, n_joints=2, n_values=3)


def regular(n: int, *, start: int = START, period: int = BAG_AT_25_HZ) -> list[Message]:
    """Return n messages at a constant rate."""
    return [Message(start + i * period, joint(start + i * period)) for i in range(n)]


def first_bytes(*values: float) -> float:
    """Return the value whose bytes come first."""
    return min(values, key=lambda v: np.float64(v).tobytes())


class Reference:
    """The same rules, one message at a time, in plain Python."""

    def __init__(self, max_frames: int, max_age_ns: int) -> None:
        """Start empty."""
        self.max_frames, self.max_age_ns = max_frames, max_age_ns
        self.kept: dict[int, float] = {}
        self.held: dict[int, float] = {}
        self.newest: int | None = None

    def add(self, m: Message) -> None:
        """Take one message."""
        if m.stamp_ns <= 0:
            return
        if self.newest is not None and abs(m.stamp_ns - self.newest) <= S:
            self.held = {}
            self.keep(m.stamp_ns, m.value)
            return
        self.held[m.stamp_ns] = first_bytes(m.value, self.held.get(m.stamp_ns, m.value))
        if len(self.held) > 20:
            del self.held[next(iter(self.held))]
        agreed = self.linked(m.stamp_ns)
        if len(agreed) < 5:
            return
        if self.newest is not None and max(agreed) < self.newest:
            self.kept = {}
        self.newest = max(agreed)
        for stamp in agreed:
            self.keep(stamp, self.held[stamp])
        self.held = {}

    def linked(self, stamp: int) -> set[int]:
        """Return the held stamps reachable by steps of at most 10 s on one side of the newest."""
        found = {stamp}
        side = [
            s for s in self.held if not self.newest or (s > self.newest) == (stamp > self.newest)
        ]
        for _ in side:
            found |= {s for s in side if any(abs(s - f) <= 10 * S for f in found)}
        return found

    def keep(self, stamp: int, value: float) -> None:
        """Store one sample and drop the oldest beyond the bounds."""
        self.newest = max(stamp, self.newest or 0)
        self.kept[stamp] = first_bytes(value, self.kept.get(stamp, value))

    def result(self) -> dict[int, float]:
        """Return what the bounds leave."""
        stamps = sorted(self.kept)[-self.max_frames :]
        return {s: self.kept[s] for s in stamps if s >= stamps[-1] - self.max_age_ns}


def contents(stream: JointStream) -> dict[int, float]:
    """Return what a stream holds, by stamp."""
    samples = stream.arrays()
    assert (np.diff(samples.stamp_ns) > 0).all()
    return dict(zip(samples.stamp_ns.tolist(), samples.values[:, 0, 0].tolist(), strict=True))


def check_counts(stream: JointStream) -> None:
    """Every message received is in exactly one of the other counts."""
    counts = dict(stream.counts)
    assert counts.pop('received') == sum(counts.values())


steps = st.one_of(
    st.integers(-30, 30).map(lambda n: n * BAG_AT_25_HZ),
    st.sampled_from([-HOUR, -20 * S, -3 * S, 3 * S, 20 * S, HOUR, -START * 2]),
)
walks = st.lists(st.tuples(steps, st.sampled_from([1.0, 2.0, 3.0])), max_size=80)


def walk_to_messages(walk: list[tuple[int, float]]) -> list[Message]:
    """Turn steps into messages: large steps are strays half of the time, jumps otherwise."""
    messages, now = [], START
    for i, (step, value) in enumerate(walk):
        messages.append(Message(now + step, value))
        if abs(step) < 2 * S or i % 2:
            now += step if now + step > 0 else BAG_AT_25_HZ
    return messages


@settings(derandomize=True, max_examples=200, deadline=None)
@given(walk=walks, max_frames=st.integers(10, 40), together=st.sampled_from([1, 2, 7, 100]))
def test_stream_holds_what_the_plain_rules_say(
    walk: list[tuple[int, float]], max_frames: int, together: int
) -> None:
    """Rings, stretches and late sorting change nothing, in batches of any size."""
    stream, plain = make_stream(max_frames, 5.0), Reference(max_frames, 5 * S)
    messages = walk_to_messages(walk)
    for m in messages:
        plain.add(m)
    send(stream, messages, together=together)
    assert contents(stream) == plain.result()
    check_counts(stream)


class StreamMachine(RuleBasedStateMachine):
    """Any sequence of events, looked at in between."""

    def __init__(self) -> None:
        """Start with an empty stream beside the plain rules."""
        super().__init__()
        self.stream, self.plain = make_stream(30, 4.0), Reference(30, 4 * S)
        self.now = START
        self.sent: list[Message] = [Message(START)]
        self.lent: list[tuple[Samples, bytes]] = []

    def _send(self, messages: list[Message]) -> None:
        for m in messages:
            self.plain.add(m)
        send(self.stream, messages, together=len(messages))
        self.sent = messages

    @rule(n=st.integers(1, 40))
    def go_on(self, n: int) -> None:
        """Messages in order."""
        self._send([Message(self.now + i * BAG_AT_25_HZ, 1.0 + i % 3) for i in range(n)])
        self.now += n * BAG_AT_25_HZ

    @rule(seed=st.integers(0, 10))
    def shuffle(self, seed: int) -> None:
        """Ten messages out of order."""
        order = np.random.default_rng(seed).permutation(10)
        self._send([Message(self.now + int(i) * BAG_AT_25_HZ) for i in order])
        self.now += 10 * BAG_AT_25_HZ

    @rule(value=st.sampled_from([0.5, 1.0, 7.0]))
    def repeat(self, value: float) -> None:
        """The last messages again, perhaps with other contents."""
        self._send([Message(m.stamp_ns, value) for m in self.sent])

    @rule(by=st.sampled_from([0, -START, -HOUR, 2 * S, HOUR]))
    def stray(self, by: int) -> None:
        """One bad stamp."""
        self._send([Message(self.now + by if by else 0)])

    @rule(by=st.sampled_from([-HOUR, -5 * S, 5 * S, HOUR]))
    def jump(self, by: int) -> None:
        """The clock is set."""
        self.now += by

    @rule()
    def lend(self) -> None:
        """Somebody keeps what is there now."""
        samples = self.stream.lend()
        self.lent.append((samples, samples.stamp_ns.tobytes() + samples.values.tobytes()))

    @invariant()
    def leaves_alone_what_was_lent(self) -> None:
        """Whatever came after."""
        for samples, before in self.lent:
            assert samples.stamp_ns.tobytes() + samples.values.tobytes() == before

    @invariant()
    def holds_what_the_plain_rules_say(self) -> None:
        """After each event."""
        assert contents(self.stream) == self.plain.result()
        assert len(self.stream.stamps()) <= 30
        check_counts(self.stream)


def test_stream_follows_the_plain_rules_through_any_events() -> None:
    """A state machine mixes order, repeats, strays and jumps, and looks after each."""
    run_state_machine_as_test(
        StreamMachine,
        settings=settings(
            derandomize=True, max_examples=40, stateful_step_count=25, deadline=None
        ),
    )


def damaged(rng: np.random.Generator, messages: list[Message]) -> list[Message]:
    """Double 20 %, put 5 % without and 1 % with a far stamp, then shuffle within 5."""
    out: list[Message] = []
    for m in messages:
        out += [m] * (1 + (rng.random() < 0.20))
        if rng.random() < 0.05:
            out.append(Message(0, m.value))
        if rng.random() < 0.01:
            out.append(Message(m.stamp_ns + HOUR, m.value))
    places = np.arange(len(out)) + rng.uniform(0, 5, len(out))
    return [out[i] for i in np.argsort(places)]


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


def test_duplicates_with_other_contents_do_not_depend_on_the_order() -> None:
    """The fuller sample of one stamp stays; between equally full ones, the bytes decide."""
    base = regular(10)
    full, fuller = np.full((1, 2, 3), 5.0), np.full((1, 2, 3), 3.0)
    partial = full.copy()
    partial[0, 1] = np.nan
    stamp = np.array([base[7].stamp_ns])
    results = []
    for order in ([full, partial, fuller], [fuller, full, partial], [partial, fuller, full]):
        stream = make_stream()
        send(stream, [m for m in base if m.stamp_ns != stamp[0]])
        for values in order:
            stream.add(stamp, values, None)
        assert stream.counts['duplicate'] == 2
        results.append(stream.arrays().values.tobytes())
    assert results[0] == results[1] == results[2]
    assert stream.arrays().values[7, 1, 0] in {3.0, 5.0}


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


def test_store_is_bounded_in_number_and_age() -> None:
    """The newest stay; a smaller bound takes effect at once."""
    stream = make_stream(max_frames=100)
    send(stream, regular(5000), together=64)
    assert list(contents(stream)) == [m.stamp_ns for m in regular(5000)[-100:]]
    stream.resize(100, 1.0)
    assert list(contents(stream)) == [m.stamp_ns for m in regular(5000)[-26:]]
    assert stream.counts['expired'] == 5000 - 26


def test_confidence_is_none_only_where_no_message_had_any() -> None:
    """A message without scores among others has NaN scores."""
    stream = make_stream()
    for m in regular(6):
        stream.add(np.array([m.stamp_ns]), np.ones((1, 2, 3)), None)
    assert stream.arrays().confidence is None
    stream.add(np.array([START + S // 2]), np.ones((1, 2, 3)), np.ones((1, 2)))
    confidence = stream.arrays().confidence
    assert confidence is not None
    assert np.isnan(confidence[:6]).all()
    assert (confidence[6] == 1.0).all()


def seconds_per_message(messages: int, together: int) -> float:
    """Return the time of adding a studio's MoCap messages, best of three."""
    stamps = START + np.arange(messages) * 4_166_667
    values, scores = np.ones((messages, 28, 3)), np.ones((messages, 28))
    best = float('inf')
    for _ in range(3):
        stream = JointStream(20_000, 300.0, n_joints=28, n_values=3)
        start = time.perf_counter()
        for i in range(0, messages, together):
            rows = slice(i, i + together)
            stream.add(stamps[rows], values[rows], scores[rows])
        best = min(best, (time.perf_counter() - start) / messages)
    return best


def test_adding_is_fast_enough_for_a_studio() -> None:
    """1080 messages a second take a few percent of a core; bags go faster still."""
    assert seconds_per_message(4000, 1) < 50e-6  # 4 us on an idle core; CI shares its cores
    assert seconds_per_message(20_000, 1000) < 10e-6


# Pairing


def track(stamps: IntArray, f: Callable[[Array], Array], n_values: int = 3) -> Samples:
    """Return samples of two joints whose coordinates are a function of time in seconds."""
    values = f((stamps - START) / S)[:, None, None] * np.ones((1, 2, n_values))
    return Samples(stamps, values, None)


mocap_ns = START + np.arange(200) * 10 * MS


@settings(derandomize=True, max_examples=100, deadline=None)
@given(
    mocap=st.lists(st.integers(1, 300), min_size=0, max_size=25, unique=True).map(sorted),
    camera=st.lists(st.integers(1, 300), min_size=0, max_size=25, unique=True).map(sorted),
    interpolate=st.booleans(),
    gap_ms=st.integers(0, 60),
    offset_ms=st.integers(-20, 20),
)
def test_match_equals_a_search_through_all_neighbours(
    mocap: list[int], camera: list[int], *, interpolate: bool, gap_ms: int, offset_ms: int
) -> None:
    """Vectorised matching is the plain definition, frame by frame."""
    config = SyncConfig(interpolate=interpolate, max_gap=gap_ms / 1e3, max_dt=gap_ms / 1e3)
    found = match(
        np.array(mocap, np.int64) * MS,
        np.array(camera, np.int64) * MS,
        settings=config,
        time_offset_s=offset_ms / 1e3,
    )
    expected = []
    for row, t in enumerate(c - offset_ms for c in camera):
        before = max((m for m in mocap if m <= t), default=None)
        after = min((m for m in mocap if m >= t), default=None)
        if interpolate:
            if before is not None and after is not None and after - before <= gap_ms:
                share = 0.0 if before == after else (t - before) / (after - before)
                expected.append((row, t * MS, before, after, share))
            continue
        near = [m for m in (before, after) if m is not None and abs(m - t) <= gap_ms]
        if near:
            nearest = min(near, key=lambda m: abs(m - t))
            expected.append((row, t * MS, nearest, nearest, 0.0))
    got = [
        (int(r), int(s), mocap[b], mocap[a], float(w))
        for r, s, b, a, w in zip(*found, strict=True)
    ]
    assert [g[:4] for g in got] == [e[:4] for e in expected]
    assert [g[4] for g in got] == pytest.approx([e[4] for e in expected])


def test_skeleton_is_interpolated_to_the_camera_stamp() -> None:
    """A body in uniform motion is met exactly, wherever the camera's stamps fall."""
    camera_ns = START + 3 * MS + np.arange(60) * 33_333_333
    camera_ns = camera_ns[camera_ns <= mocap_ns[-1]]
    view, counts = pair(
        track(mocap_ns, lambda t: 2.0 * t),
        track(camera_ns, lambda t: 100.0 * t, 2),
        settings=SyncConfig(),
    )
    assert counts == (len(camera_ns), 0)
    np.testing.assert_allclose(view.x_mocap[:, 0, 0] * 50.0, view.uv[:, 0, 0], atol=1e-9)


def test_video_stamped_late_is_moved_back() -> None:
    """Mocap time = video stamp - offset; the view is stamped on the MoCap's clock."""
    camera_ns = mocap_ns[50:100] + 40 * MS
    view, _ = pair(
        track(mocap_ns, lambda t: t),
        track(camera_ns, lambda t: t, 2),
        settings=SyncConfig(),
        time_offset_s=0.04,
    )
    assert view.stamp_ns is not None
    np.testing.assert_array_equal(view.stamp_ns, mocap_ns[50:100])
    np.testing.assert_allclose(view.x_mocap[:, 0, 0], view.uv[:, 0, 0] - 0.04)


def test_joint_missing_beside_the_stamp_is_missing() -> None:
    """No value is made up from one neighbour, but an exact stamp needs none."""
    mocap = track(mocap_ns, lambda t: t)
    mocap.values[10, 0] = np.nan
    camera_ns = np.array([mocap_ns[9], mocap_ns[9] + 5 * MS, mocap_ns[10], mocap_ns[11]])
    view, _ = pair(mocap, track(camera_ns, lambda t: t, 2), settings=SyncConfig())
    np.testing.assert_array_equal(np.isnan(view.x_mocap[:, 0, 0]), [False, True, True, False])
    assert not np.isnan(view.x_mocap[:, 1]).any()


def test_no_pair_across_a_gap_of_the_mocap() -> None:
    """While the skeleton is lost for longer than max_gap, the camera's frames find none."""
    lost = (mocap_ns > START + 500 * MS) & (mocap_ns < START + 700 * MS)
    camera_ns = START + np.arange(45) * 33 * MS
    _, counts = pair(
        track(mocap_ns[~lost], lambda t: t),
        track(camera_ns, lambda t: t, 2),
        settings=SyncConfig(),
    )
    assert counts == (39, 6)


def test_pairs_do_not_depend_on_the_order_of_arrival() -> None:
    """The same messages, damaged in two ways, give the same bits."""
    views = []
    for seed in (1, 2):
        rng = np.random.default_rng(seed)
        mocap, camera = make_stream(), make_stream()
        send(mocap, damaged(rng, regular(1000, period=10 * MS)))
        send(camera, damaged(rng, regular(250, start=START + MS, period=33_333_333)), together=50)
        view, _ = pair(mocap.arrays(), camera.arrays(), settings=SyncConfig())
        views.append((view.x_mocap.tobytes(), view.uv.tobytes()))
    assert views[0] == views[1]


def test_infinite_coordinates_pass_without_a_warning() -> None:
    """Damaged numbers are the solver's to discard; interpolation does not trip over them."""
    mocap = track(mocap_ns, lambda t: t)
    mocap.values[5, 0], mocap.values[6, 0], mocap.values[7, 0] = np.inf, np.inf, -1e308
    camera = track(mocap_ns[:20] + MS, lambda t: t, 2)
    view, _ = pair(mocap, camera, settings=SyncConfig())
    assert np.isfinite(view.x_mocap[:, 1]).all()


def test_settings_refuse_what_makes_no_sense() -> None:
    """A negative gap or an empty buffer is named."""
    with pytest.raises(InputError, match='max_gap'):
        SyncConfig(max_gap=-0.1)
    with pytest.raises(InputError, match='max_frames'):
        BufferConfig(max_frames=0)
