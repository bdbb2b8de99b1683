# SPDX-License-Identifier: Apache-2.0
"""TFMessage to transforms, and the tree that they make."""

from __future__ import annotations

import contextlib
from typing import Any

import numpy as np
import peers
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rpgd_ros.core import InputError, Reason, RigidTransform
from rpgd_ros.core.geometry import so3_exp
from rpgd_ros.messages import TF_MESSAGE, FrameTree, Link, decode_tf, encode_tf
from rpgd_ros.messages.frames import MAX_FRAMES

NAN = float('nan')


def pose(seed: int) -> RigidTransform:
    """Return some transform."""
    rng = np.random.default_rng(seed)
    return RigidTransform(so3_exp(rng.normal(size=3)), rng.normal(size=3))


def link(parent: str, child: str, seed: int = 0) -> Link:
    """Return some edge between two frames."""
    return Link(parent, child, pose(seed), 7)


def tf_message(*transforms: tuple[str, str, list[float], list[float]]) -> Any:
    """Make a TFMessage as rosbags knows it."""
    made = []
    for parent, child, xyz, quat in transforms:
        t = peers.make('geometry_msgs/msg/Vector3', *xyz)
        q = peers.make('geometry_msgs/msg/Quaternion', *quat)
        transform = peers.make('geometry_msgs/msg/Transform', t, q)
        header = peers.header(12_000_000_034, parent)
        made.append(peers.make('geometry_msgs/msg/TransformStamped', header, child, transform))
    return peers.make(TF_MESSAGE, made)


@pytest.mark.parametrize('little_endian', [True, False])
def test_transforms_of_another_implementation_are_read(*, little_endian: bool) -> None:
    """Names, numbers and stamp; both byte orders; several in one message."""
    half = np.sqrt(0.5)
    message = tf_message(
        ('studio', 'rig', [1.0, 2.0, 3.0], [0.0, 0.0, half, half]),
        ('/rig', '/cam0_optical_frame', [0.5, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]),
    )
    first, second = decode_tf(peers.serialise(message, little_endian=little_endian))
    assert (first.parent, first.child, first.stamp_ns) == ('studio', 'rig', 12_000_000_034)
    np.testing.assert_allclose(first.parent_T_child @ np.array([1.0, 0, 0]), [1, 3, 3])
    assert (second.parent, second.child) == ('rig', 'cam0_optical_frame')


def test_what_is_sent_is_what_another_implementation_reads() -> None:
    """The same bytes from both."""
    sent = encode_tf([link('studio', 'a'), link('a', 'camera_frame', 1)])
    message = peers.read(sent, TF_MESSAGE)
    assert peers.serialise(message) == sent
    assert [t.child_frame_id for t in message.transforms] == ['a', 'camera_frame']
    for found, seed in zip(decode_tf(sent), (0, 1), strict=True):
        np.testing.assert_allclose(found.parent_T_child.matrix, pose(seed).matrix, atol=1e-12)


@pytest.mark.parametrize(
    'bad',
    [
        ('studio', 'a', [0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0]),
        ('studio', 'a', [NAN, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]),
        ('studio', 'a', [0.0, 0.0, 0.0], [NAN, 0.0, 0.0, 1.0]),
        ('studio', 'a', [1e300, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]),
        ('studio', 'studio', [0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]),
        ('', 'a', [0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]),
        ('studio', '/', [0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]),
    ],
)
def test_a_transform_that_is_none_does_not_spoil_its_message(
    bad: tuple[str, str, list[float], list[float]],
) -> None:
    """tf2 leaves it out, too."""
    good = ('studio', 'b', [0.0, 0.0, 1.0], [0.0, 0.0, 0.0, 1.0])
    assert [f.child for f in decode_tf(peers.serialise(tf_message(bad, good)))] == ['b']


def test_a_count_beyond_the_bytes_is_refused_at_once() -> None:
    """Four billion transforms in a hundred bytes."""
    damaged = bytearray(encode_tf([link('studio', 'a')]))
    damaged[4:8] = b'\xff\xff\xff\xff'
    with pytest.raises(InputError, match='4294967295 transforms') as refused:
        decode_tf(bytes(damaged))
    assert refused.value.reason is Reason.BAD_MESSAGE


@settings(max_examples=200)
@given(
    st.lists(st.tuples(st.integers(0, 400), st.integers(0, 255)), max_size=5),
    st.integers(0, 400) | st.none(),
)
def test_damaged_bytes_give_transforms_or_a_reason(
    edits: list[tuple[int, int]], cut: int | None
) -> None:
    """No other error leaves the decoder."""
    damaged = bytearray(encode_tf([link('studio', 'a'), link('a', 'b', 1)]))
    for position, value in edits:
        damaged[position % len(damaged)] = value
    with contextlib.suppress(InputError):
        decode_tf(bytes(damaged)[:cut])


def test_a_chain_is_composed_whatever_the_order_of_its_links() -> None:
    """Four frames, told from the far end."""
    tree = FrameTree()
    links = [link('mount', 'optical', 2), link('rig', 'mount', 1), link('studio', 'rig', 0)]
    for edge in links:
        assert tree.path('studio', 'optical') is None
        tree.add([edge], is_static=True)
    found = tree.path('studio', 'optical')
    assert found is not None
    expected = pose(0) @ pose(1) @ pose(2)
    np.testing.assert_allclose(found.pose.matrix, expected.matrix, atol=1e-12)
    assert found.is_static


def test_two_branches_meet_in_their_common_ancestor() -> None:
    """The world need not be the root: map -> studio and map -> rig -> optical."""
    tree = FrameTree()
    tree.add([link('map', 'studio', 0), link('map', 'rig', 1)], is_static=True)
    tree.add([link('rig', 'optical', 2)], is_static=False)
    found = tree.path('studio', 'optical')
    assert found is not None
    expected = pose(0).inverse() @ pose(1) @ pose(2)
    np.testing.assert_allclose(found.pose.matrix, expected.matrix, atol=1e-12)
    assert not found.is_static
    back = tree.path('optical', 'studio')
    assert back is not None
    np.testing.assert_allclose((back.pose @ found.pose).matrix, np.eye(4), atol=1e-12)


def test_a_frame_has_one_parent_the_newest() -> None:
    """As in tf2; but what is static does not yield to /tf."""
    tree = FrameTree()
    tree.add([link('studio', 'a', 0)], is_static=False)
    tree.add([link('other', 'a', 1)], is_static=False)
    assert tree.parent('a') == 'other'
    tree.add([link('studio', 'a', 2)], is_static=True)
    tree.add([link('other', 'a', 3)], is_static=False)
    assert tree.parent('/a') == 'studio'
    assert tree.parent('studio') == ''


def test_a_loop_of_frames_ends() -> None:
    """Two publishers at odds make one; what hangs on it is not connected with the world."""
    tree = FrameTree()
    tree.add([link('a', 'b', 0), link('b', 'a', 1), link('b', 'optical', 2)], is_static=True)
    assert tree.path('studio', 'optical') is None
    assert tree.path('a', 'optical') is not None


def test_a_flood_of_names_ends() -> None:
    """Memory is bounded; known frames go on to be updated."""
    tree = FrameTree()
    tree.add([link('studio', 'a', 0)], is_static=False)
    tree.add((link('studio', f'f{i}') for i in range(MAX_FRAMES + 10)), is_static=False)
    assert len(tree) == MAX_FRAMES
    tree.add([link('other', 'a', 0)], is_static=False)
    assert tree.parent('a') == 'other'


def test_frames_that_come_after_a_flood_are_known() -> None:
    """What moved longest ago gives way; what is static, and what goes on to move, stays."""
    tree = FrameTree()
    tree.add([link('studio', 'rig', 0)], is_static=True)
    tree.add([link('rig', 'mount', 1)], is_static=False)
    for i in range(2 * MAX_FRAMES):
        tree.add([link('studio', f'f{i}')], is_static=False)
        if i % 1000 == 0:
            tree.add([link('rig', 'mount', 1)], is_static=False)
    assert len(tree) == MAX_FRAMES + 1
    tree.add([link('mount', 'optical', 2)], is_static=True)
    found = tree.path('studio', 'optical')
    assert found is not None
    expected = pose(0) @ pose(1) @ pose(2)
    np.testing.assert_allclose(found.pose.matrix, expected.matrix, atol=1e-12)
    tree.add([link('studio', 'late')], is_static=False)
    assert tree.parent('late') == 'studio'
    assert tree.parent('f0') == ''


def test_a_flood_of_static_names_ends() -> None:
    """The newest are known, and a frame that becomes static is kept once."""
    tree = FrameTree()
    tree.add([link('studio', 'a', 0)], is_static=False)
    tree.add([link('studio', 'a', 0)], is_static=True)
    assert len(tree) == 1
    tree.add((link('studio', f'f{i}') for i in range(MAX_FRAMES + 10)), is_static=True)
    assert len(tree) == MAX_FRAMES
    tree.add([link('studio', 'b')], is_static=True)
    assert tree.parent('b') == 'studio'
