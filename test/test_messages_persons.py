# SPDX-License-Identifier: Apache-2.0
"""Messages of several persons: one row of the cloud each."""

from __future__ import annotations

import numpy as np
import peers
import pytest

from rpgd_ros.core import InputError
from rpgd_ros.core.geometry import Array
from rpgd_ros.messages import POINT_CLOUD2, Decoded, decode_joints, encode_point_cloud2

J = 4
STAMP_NS = 1_500_000_000


def decode(payloads: list[bytes]) -> Decoded:
    """Decode keypoints of four joints."""
    return decode_joints(POINT_CLOUD2, payloads, n_joints=J, n_values=2)


def people(n: int, seed: int = 0) -> tuple[Array, Array]:
    """Return keypoints (n, 4, 2) and scores (n, 4) that floats hold exactly."""
    rng = np.random.default_rng(seed)
    return rng.integers(1, 999, (n, J, 2)) / 4.0, rng.integers(1, 9, (n, J)) / 8.0


def everybody(decoded: Decoded) -> tuple[Array, Array | None]:
    """Return values (B, P, J, 2) and scores (B, P, J)."""
    assert decoded.batch is not None
    values, scores = decoded.batch.take(np.arange(J))
    n = len(values)
    return values.reshape(n, -1, J, 2), None if scores is None else scores.reshape(n, -1, J)


@pytest.mark.parametrize('dtype', ['float32', 'float64'])
@pytest.mark.parametrize('with_scores', [False, True])
def test_persons_come_back_as_they_were_sent(dtype: str, with_scores: bool) -> None:  # noqa: FBT001
    """In their order, with and without scores."""
    uv, scores = people(3)
    payload = encode_point_cloud2(
        STAMP_NS,
        'cam',
        uv,
        scores if with_scores else None,
        dtype=dtype,  # type: ignore[arg-type]
    )
    values, rated = everybody(decode([payload]))
    np.testing.assert_array_equal(values[0], uv)
    if with_scores:
        assert rated is not None
        np.testing.assert_array_equal(rated[0], scores)
    else:
        assert rated is None


def test_messages_with_more_and_fewer_persons_make_one_batch() -> None:
    """In the order of their arrival; who is not there is NaN."""
    sizes = [2, 1, 3, 1, 2]
    sent = [people(n, i) for i, n in enumerate(sizes)]
    payloads = [
        encode_point_cloud2(STAMP_NS + i, 'cam', uv, scores if i % 2 else None)
        for i, (uv, scores) in enumerate(sent)
    ]
    decoded = decode(payloads)
    assert decoded.batch is not None
    assert decoded.batch.stamp_ns.tolist() == [STAMP_NS + i for i in range(5)]
    values, scores = everybody(decoded)
    assert scores is not None
    for i, (uv, rated) in enumerate(sent):
        np.testing.assert_array_equal(values[i, : sizes[i]], uv)
        assert np.isnan(values[i, sizes[i] :]).all()
        np.testing.assert_array_equal(
            scores[i, : sizes[i]], rated if i % 2 else np.full(rated.shape, np.nan)
        )


def test_unused_places_go_to_the_end_or_away() -> None:
    """Drivers with a fixed number of places send zeros or NaN in those that nobody has."""
    uv, _ = people(2)
    wide = np.full((5, J, 2), np.nan)
    wide[1], wide[2], wide[3] = uv[0], 0.0, uv[1]
    values, _ = everybody(decode([encode_point_cloud2(STAMP_NS, 'cam', wide)]))
    np.testing.assert_array_equal(values[0], uv)
    wide[3] = np.nan
    decoded = decode([encode_point_cloud2(STAMP_NS, 'cam', wide)])
    assert decoded.batch is not None
    assert decoded.batch.others is None
    np.testing.assert_array_equal(decoded.batch.values[0], uv[0])
    nobody = decode([encode_point_cloud2(STAMP_NS, 'cam', np.full((3, J, 2), np.nan))])
    assert nobody.batch is not None
    assert nobody.batch.values.shape == (1, J, 2)


@pytest.mark.parametrize('row_step', [None, 0])
@pytest.mark.parametrize('little_endian', [True, False])
def test_clouds_of_peers_are_read(row_step: int | None, little_endian: bool) -> None:  # noqa: FBT001
    """Some drivers leave row_step zero; bytes may come in either order."""
    uv, _ = people(3)
    rows = np.zeros(3 * J, [('u', '<f4'), ('v', '<f4'), ('id', '<i4')])
    rows['u'], rows['v'] = uv.reshape(-1, 2).T
    message = peers.point_cloud2(rows, height=3)
    if row_step is not None:
        message.row_step = row_step
    values, _ = everybody(decode([peers.serialise(message, little_endian=little_endian)]))
    np.testing.assert_array_equal(values[0], uv)


def test_rows_may_be_padded() -> None:
    """row_step may be longer than the joints of a person."""
    uv, _ = people(2)
    rows = np.zeros((2, J + 3), [('u', '<f4'), ('v', '<f4')])
    rows['u'][:, :J], rows['v'][:, :J] = uv[..., 0], uv[..., 1]
    message = peers.point_cloud2(rows.ravel(), height=2)
    message.width = J
    assert message.row_step == 8 * (J + 3)
    values, _ = everybody(decode([peers.serialise(message)]))
    np.testing.assert_array_equal(values[0], uv)
    message.row_step = 8 * (J - 1)
    assert decode([peers.serialise(message)]).dropped == {'malformed': 1}
    message.row_step = 8 * (2 * J + 3)
    assert decode([peers.serialise(message)]).dropped == {'malformed': 1}


def test_no_more_than_twenty_persons_are_read() -> None:
    """The others are counted."""
    rows = np.ones(25 * J, [('u', '<f4'), ('v', '<f4')])
    decoded = decode([peers.serialise(peers.point_cloud2(rows, height=25))] * 2)
    assert everybody(decoded)[0].shape == (2, 20, J, 2)
    assert decoded.missing == {'persons_beyond_20': 10}


@pytest.mark.parametrize('shape', [(21, J, 2), (0, J, 2), (2, 0, 2), (2, 300, 2), (2, J, 4)])
def test_what_cannot_be_sent_is_refused(shape: tuple[int, ...]) -> None:
    """Numbers of persons, joints and coordinates."""
    with pytest.raises(InputError):
        encode_point_cloud2(STAMP_NS, 'cam', np.ones(shape))
    with pytest.raises(InputError):
        encode_point_cloud2(STAMP_NS, 'cam', np.ones((2, J, 2)), np.ones(J))
