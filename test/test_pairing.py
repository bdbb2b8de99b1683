# SPDX-License-Identifier: Apache-2.0
"""Pairing finds a skeleton for every camera stamp, as a pure function of the two tracks."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from streams import MS, START, S, damaged, make_stream, regular, send

from rpgd_ros.core import InputError
from rpgd_ros.core.geometry import Array, IntArray
from rpgd_ros.pairing import BufferConfig, Samples, SyncConfig, match, pair


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
