# SPDX-License-Identifier: Apache-2.0
"""Observations are checked once, where they come in."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rpgd_ros.core import InputError, MocapTrack, Observations, Reason, View

X, UV = np.zeros((4, 3, 3)), np.zeros((2, 4, 3, 2))


def test_arrays_become_one_view_per_camera() -> None:
    """Skeletons and stamps are shared, nothing is copied."""
    x, uv, scores = np.ones((4, 3, 3)), np.ones((2, 4, 3, 2)), np.ones((2, 4, 3))
    out = Observations.from_arrays(x, uv, confidence=scores, fps=50.0, joint_names=('a', 'b', 'c'))
    assert len(out.views) == 2
    assert out.n_joints == out.views[0].n_joints == 3
    assert out.views[1].n_frames == 4
    for view, keypoints, score in zip(out.views, uv, scores, strict=True):
        assert view.x_mocap is x
        assert np.shares_memory(view.uv, keypoints)
        assert view.confidence is not None
        assert np.shares_memory(view.confidence, score)
        assert view.stamp_ns is not None
        assert view.stamp_ns.tolist() == [0, 20_000_000, 40_000_000, 60_000_000]
    assert out.mocap is not None
    assert out.mocap.x_mocap is x


def test_time_is_known_only_where_it_was_told() -> None:
    """Neither rate nor stamps: no track, no stamps."""
    out = Observations.from_arrays(X, UV)
    assert out.mocap is None
    assert out.views[0].stamp_ns is None
    stamped = Observations.from_arrays(X, UV, stamps=[1.5, 2.0, 2.25, 7.0])
    assert stamped.mocap is not None
    assert stamped.mocap.stamp_ns.tolist() == [
        1_500_000_000,
        2_000_000_000,
        2_250_000_000,
        7 * 10**9,
    ]


def test_question_of_time_without_stamps_is_refused() -> None:
    """The message says what is needed."""
    assert Observations.from_arrays(X, UV, fps=1.0).views[0].known_stamp_ns[1] == 10**9
    with pytest.raises(
        InputError, match='frames without stamps: need the time of each'
    ) as refused:
        _ = Observations.from_arrays(X, UV).views[0].known_stamp_ns
    assert refused.value.reason is Reason.BAD_INPUT


@pytest.mark.parametrize(
    ('arguments', 'words'),
    [
        ({'x_mocap': np.zeros((4, 3))}, r'x_mocap must be \(T, J, 3\), got \(4, 3\)'),
        ({'x_mocap': np.zeros((4, 3, 2))}, r'x_mocap must be \(T, J, 3\)'),
        (
            {'uv': np.zeros((4, 3, 2))},
            r'uv must be \(V, 4, 3, 2\) to fit x_mocap, got \(4, 3, 2\)',
        ),
        ({'uv': np.zeros((2, 5, 3, 2))}, r'uv must be \(V, 4, 3, 2\)'),
        ({'confidence': np.zeros((2, 4))}, r'confidence must be \(2, 4, 3\) to fit uv'),
        ({'joint_names': ('a', 'b')}, '2 different joint names for 3 joints'),
        ({'joint_names': ('a', 'b', 'a')}, '2 different joint names for 3 joints'),
        ({'fps': 0.0}, 'fps must be a number from'),
        ({'fps': -25.0}, 'fps must be .*, got -25'),
        ({'fps': np.nan}, 'fps must be .*, got nan'),
        ({'fps': np.inf}, 'fps must be .*, got inf'),
        ({'fps': 1e-300}, 'fps must be .*, got 1e-300'),
        (
            {'stamps': [0.0, 1.0, 2.0]},
            r'stamps must be \(4,\) increasing seconds, got shape \(3,\)',
        ),
        ({'stamps': [0.0, 1.0, 1.0, 2.0]}, 'increasing'),
        ({'stamps': [0.0, 2.0, 1.0, 3.0]}, 'increasing'),
        ({'stamps': [0.0, np.nan, 1.0, 3.0]}, 'increasing'),
        ({'stamps': [0.0, 1.0, 2.0, np.inf]}, 'increasing'),
        ({'stamps': [0.0, 1.0, 2.0, 1e300]}, 'increasing'),
    ],
)
def test_arrays_that_do_not_fit_are_refused(arguments: dict[str, Any], words: str) -> None:
    """Shapes, names and times: found and needed, without a numpy error."""
    with pytest.raises(InputError, match=words) as refused:
        Observations.from_arrays(**({'x_mocap': X, 'uv': UV} | arguments))
    assert refused.value.reason is Reason.BAD_INPUT


@pytest.mark.parametrize(
    'view',
    [
        View(None, np.zeros((4, 5, 3)), np.zeros((4, 5, 2))),
        View(None, np.zeros((3, 3, 3)), np.zeros((4, 3, 2))),
        View(None, np.zeros((4, 3, 2)), np.zeros((4, 3, 2))),
        View(None, np.zeros((4, 3, 3)), np.zeros((4, 3, 3))),
        View(None, np.zeros((12, 3)), np.zeros((12, 2))),
    ],
    ids=['joints', 'frames', 'skeleton', 'keypoints', 'flat'],
)
def test_views_that_do_not_fit_each_other_are_refused(view: View) -> None:
    """Built by hand or by another room, they are checked all the same."""
    good = View(None, np.zeros((9, 3, 3)), np.zeros((9, 3, 2)))
    with pytest.raises(InputError, match=r'view 1 has skeletons .* need \(F, 3, 3\)'):
        Observations((good, view))


def test_cameras_may_have_different_numbers_of_frames() -> None:
    """Each runs at its own rate."""
    views = (View(None, np.zeros((9, 3, 3)), np.zeros((9, 3, 2))), View(None, X, UV[0]))
    track = MocapTrack(np.arange(9), np.zeros((9, 3, 3)))
    assert Observations(views, track, ('a', 'b', 'c')).n_joints == 3


@pytest.mark.parametrize('damage', [np.nan, np.inf, -np.inf, 1e300, -2e6])
def test_only_numbers_of_this_world_are_seen(damage: float) -> None:
    """Both sides of a correspondence, every coordinate of them."""
    x, uv = np.ones((2, 3, 3)), np.ones((2, 3, 2))
    x[0, 0, 2], uv[0, 1, 0] = damage, damage
    with np.errstate(all='raise'):
        seen = View(None, x, uv).seen()
    np.testing.assert_array_equal(seen, [[False, False, True], [True, True, True]])


@pytest.mark.parametrize(
    ('view', 'words'),
    [
        (View(np.arange(3), X, UV[0]), r'stamps of view 1 must be \(4,\), got \(3,\)'),
        (View(None, X, UV[0], np.ones((4, 2))), r'confidence of view 1 must be \(4, 3\)'),
        (View(None, X, np.zeros(4)), 'view 1 has skeletons'),
    ],
)
def test_views_that_do_not_fit_are_refused(view: View, words: str) -> None:
    """Each part of a view is one per frame and joint."""
    with pytest.raises(InputError, match=words):
        Observations((View(None, X, UV[0]), view))
    with pytest.raises(InputError, match=words.replace('1', '0', 1)):
        Observations((view,))


def test_track_of_other_joints_is_refused() -> None:
    """It would be read at the joints of the views."""
    with pytest.raises(InputError, match=r'skeletons of the MoCap track must be \(5, 3, 3\)'):
        Observations((View(None, X, UV[0]),), MocapTrack(np.arange(5), np.zeros((5, 4, 3))))
