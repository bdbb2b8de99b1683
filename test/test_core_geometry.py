# SPDX-License-Identifier: Apache-2.0
"""Rigid transforms are a group, rotations survive every representation, damage is refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numeric import jacobian, relative_error

from rpgd_ros.core import RigidTransform
from rpgd_ros.core.geometry import (
    Array,
    euler_zyx_from_rotation,
    euler_zyx_with_derivatives,
    nearest_rotation,
    quat_xyzw_from_rotation,
    rotation_angle,
    rotation_from_euler_zyx,
    rotation_from_quat_xyzw,
    skew,
    so3_exp,
    so3_log,
)

unit = st.floats(-1.0, 1.0, allow_subnormal=False)
# Anywhere, next to the identity, and next to a half turn, where formulas lose their digits.
angles = st.one_of(
    st.floats(0.0, np.pi), st.floats(0.0, 1e-7), st.floats(0.0, 1e-7).map(lambda a: np.pi - a)
)
pitches = st.one_of(
    st.floats(-np.pi / 2, np.pi / 2),
    st.floats(89.9, 90.0).map(np.radians),
    st.floats(-90.0, -89.9).map(np.radians),
    st.sampled_from([np.pi / 2, -np.pi / 2]),
)


@st.composite
def rotvecs(draw: st.DrawFn) -> Array:
    """Draw a rotation vector of at most half a turn."""
    axis = np.array([draw(unit), draw(unit), draw(unit)])
    length = float(np.linalg.norm(axis))
    assume(length > 1e-3)
    return axis / length * draw(angles)


@st.composite
def transforms(draw: st.DrawFn) -> RigidTransform:
    """Draw a transform with a translation of up to 100 m."""
    return RigidTransform(so3_exp(draw(rotvecs())), 100.0 * np.array([draw(unit) for _ in 'xyz']))


def assert_close(a: RigidTransform, b: RigidTransform) -> None:
    """Both transforms are finite and equal up to rounding at 300 m."""
    assert np.isfinite(a.matrix).all()
    np.testing.assert_allclose(a.matrix, b.matrix, rtol=0.0, atol=1e-12 * 300.0)


@settings(max_examples=200)
@given(a=transforms(), b=transforms(), c=transforms())
def test_transforms_are_a_group_that_acts_on_points(
    a: RigidTransform, b: RigidTransform, c: RigidTransform
) -> None:
    """Closure, identity, inverse, associativity; products move points one after the other."""
    one = RigidTransform.identity()
    points = np.array([[1.0, 2.0, 3.0], [-4.0, 0.0, 0.5]])
    RigidTransform((a @ b).rotation, (a @ b).translation)  # the checks of the border hold
    assert_close(a @ one, a)
    assert_close(one @ a, a)
    assert_close(a @ a.inverse(), one)
    assert_close(a.inverse() @ a, one)
    assert_close((a @ b) @ c, a @ (b @ c))
    np.testing.assert_allclose((a @ b) @ points, a @ (b @ points), rtol=0.0, atol=1e-10)


@settings(max_examples=200)
@given(v=rotvecs())
def test_rotation_vector_survives_exp_and_log(v: Array) -> None:
    """The rotation comes back to the last digits, near the identity and near a half turn too."""
    rotation = so3_exp(v)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(rotation) > 0.0
    back = so3_log(rotation)
    assert np.linalg.norm(back) <= np.pi + 1e-15
    np.testing.assert_allclose(so3_exp(back), rotation, atol=1e-14)
    if np.linalg.norm(v) < np.pi - 1e-6:
        np.testing.assert_allclose(back, v, rtol=1e-9, atol=1e-15)
    assert rotation_angle(rotation) == pytest.approx(np.linalg.norm(v), rel=1e-7, abs=1e-15)


@settings(max_examples=100)
@given(v=rotvecs())
def test_exp_turns_as_its_series_says(v: Array) -> None:
    """Rodrigues' formula is the matrix exponential, an implementation beside ours."""
    term, total = np.eye(3), np.eye(3)
    for n in range(1, 40):
        term = term @ skew(v) / n
        total = total + term
    np.testing.assert_allclose(so3_exp(v), total, atol=1e-13)


def test_exp_takes_many_vectors_at_once() -> None:
    """A stack gives what its members give one by one, zero among them."""
    vectors = np.array([[[0.0, 0.0, 0.0], [1e-9, 0.0, 0.0]], [[1.0, -2.0, 0.5], [0.0, 3.0, 0.0]]])
    stacked = so3_exp(vectors)
    assert stacked.shape == (2, 2, 3, 3)
    for k in np.ndindex(2, 2):
        np.testing.assert_array_equal(stacked[k], so3_exp(vectors[k]))


@settings(max_examples=200)
@given(v=rotvecs())
def test_quaternion_survives_the_round_trip(v: Array) -> None:
    """It has unit length, w >= 0, and gives its rotation back; its negative gives the same."""
    rotation = so3_exp(v)
    quat = quat_xyzw_from_rotation(rotation)
    assert np.linalg.norm(quat) == pytest.approx(1.0, abs=1e-15)
    assert quat[3] >= 0.0
    np.testing.assert_allclose(rotation_from_quat_xyzw(quat), rotation, atol=1e-14)
    np.testing.assert_allclose(rotation_from_quat_xyzw(-3.0 * quat), rotation, atol=1e-14)


def test_quaternion_is_hamilton_with_w_last() -> None:
    """A quarter turn about z takes x to y and reads (0, 0, sin 45, cos 45)."""
    quarter = so3_exp([0.0, 0.0, np.pi / 2])
    np.testing.assert_allclose(quarter @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-15)
    half = np.sqrt(0.5)
    np.testing.assert_allclose(quat_xyzw_from_rotation(quarter), [0, 0, half, half], atol=1e-15)
    transform = RigidTransform.from_quat_xyzw([1.0, 2.0, 3.0], [0.0, 0.0, 2.0, 2.0])
    np.testing.assert_allclose(transform.quat_xyzw, [0, 0, half, half], atol=1e-15)
    np.testing.assert_allclose(transform @ np.array([1.0, 0.0, 0.0]), [1, 3, 3], atol=1e-15)


@pytest.mark.parametrize(
    'quat', [[0.0] * 4, [np.nan, 0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [1e-12] * 4]
)
def test_what_is_no_quaternion_is_refused(quat: list[float]) -> None:
    """Zero, not finite, or not of four numbers."""
    with pytest.raises(ValueError, match='need a finite quaternion x, y, z, w'):
        rotation_from_quat_xyzw(quat)


@pytest.mark.fault(34)
@settings(max_examples=200)
@given(alpha=st.floats(-np.pi, np.pi), beta=pitches, gamma=st.floats(-np.pi, np.pi))
def test_euler_angles_are_z_times_y_times_x_with_true_derivatives(
    alpha: float, beta: float, gamma: float
) -> None:
    """The product of the three axes, and its derivatives, at every pitch."""
    angles = np.array([alpha, beta, gamma])
    rotation, by_angle = euler_zyx_with_derivatives(angles)
    x, y, z = (so3_exp(a * np.eye(3)[k]) for k, a in enumerate(angles))
    np.testing.assert_allclose(rotation, z @ y @ x, atol=1e-15)
    numeric = jacobian(rotation_from_euler_zyx, angles)
    assert relative_error(np.moveaxis(by_angle, 0, -1), numeric) < 1e-10


@pytest.mark.fault(34)
@settings(max_examples=300)
@given(alpha=st.floats(-np.pi, np.pi), beta=pitches, gamma=st.floats(-np.pi, np.pi))
def test_euler_angles_give_their_rotation_back_at_every_pitch(
    alpha: float, beta: float, gamma: float
) -> None:
    """At the gimbal the angles are not unique, but the rotation they stand for is."""
    rotation = rotation_from_euler_zyx([alpha, beta, gamma])
    back = euler_zyx_from_rotation(rotation)
    assert abs(back[1]) <= np.pi / 2
    # Within 1e-8 rad of the gimbal, roll and yaw share what digits there are.
    tolerance = 1e-12 if np.cos(beta) > 1e-3 else 2e-7
    np.testing.assert_allclose(rotation_from_euler_zyx(back), rotation, atol=tolerance)
    if np.cos(beta) > 1e-3:
        np.testing.assert_allclose(so3_exp([back[0] - alpha, 0, 0]), np.eye(3), atol=1e-9)


@settings(max_examples=100)
@given(v=rotvecs(), noise=st.lists(unit, min_size=9, max_size=9))
def test_nearest_rotation_is_proper_and_nearer_than_its_neighbours(
    v: Array, noise: list[float]
) -> None:
    """The projection is a rotation, and no small turn brings it closer."""
    matrix = so3_exp(v) + 0.1 * np.array(noise).reshape(3, 3)
    nearest = nearest_rotation(matrix)
    RigidTransform(nearest, np.zeros(3))
    distance = np.linalg.norm(nearest - matrix)
    for turn in np.vstack([np.eye(3), -np.eye(3)]) * 1e-3:
        assert np.linalg.norm(so3_exp(turn) @ nearest - matrix) >= distance - 1e-12
    mirrored = nearest_rotation(matrix @ np.diag([1.0, 1.0, -1.0]))
    assert np.linalg.det(mirrored) == pytest.approx(1.0)


def test_skew_is_the_cross_product() -> None:
    """The matrix of a vector crosses it with another."""
    a, b = np.array([1.0, -2.0, 3.0]), np.array([0.5, 4.0, -1.0])
    np.testing.assert_array_equal(skew(a) @ b, np.cross(a, b))


def test_matrix_and_transform_are_the_same() -> None:
    """Homogeneous matrices of three or four rows are read; other shapes are refused."""
    transform = RigidTransform(so3_exp([0.3, -1.0, 2.0]), np.array([1.0, 2.0, 3.0]))
    for matrix in (transform.matrix, transform.matrix[:3]):
        np.testing.assert_array_equal(RigidTransform.from_matrix(matrix).matrix, transform.matrix)
    with pytest.raises(ValueError, match=r'need a \(4, 4\) or \(3, 4\) matrix, got \(3, 3\)'):
        RigidTransform.from_matrix(np.eye(3))


@pytest.mark.parametrize(
    ('rotation', 'translation', 'words'),
    [
        (np.diag([1.0, 1.0, -1.0]), np.zeros(3), 'reflection .*left-handed'),
        (-np.eye(3), np.zeros(3), 'reflection'),
        (np.full((3, 3), np.nan), np.zeros(3), 'finite'),
        (np.eye(3), np.array([0.0, np.inf, 0.0]), 'finite'),
        (1.001 * np.eye(3), np.zeros(3), 'not orthonormal'),
        (np.zeros((3, 3)), np.zeros(3), 'not orthonormal'),
        (np.eye(3) + 1e-3 * skew([1, 0, 0]).T @ np.ones((3, 3)), np.zeros(3), 'not orthonormal'),
        (np.eye(4), np.zeros(3), r'need shapes \(3, 3\) and \(3,\), got \(4, 4\)'),
        (np.eye(3), np.zeros(2), r'got \(3, 3\) and \(2,\)'),
    ],
)
def test_what_is_no_rigid_transform_is_refused(
    rotation: Array, translation: Array, words: str
) -> None:
    """Reflections, scales, numbers that are none, wrong shapes: each with its word."""
    with pytest.raises(ValueError, match=words):
        RigidTransform(rotation, translation)


@settings(max_examples=300)
@given(v=rotvecs())
def test_a_rotation_with_six_decimals_passes(v: Array) -> None:
    """Files round; what they hold is still a rotation, and so are all products of it."""
    exact = so3_exp(v)
    pose = RigidTransform(np.round(exact, 6), np.zeros(3))
    assert rotation_angle(pose.rotation.T @ exact) < 2e-6
    for rotation in (pose.inverse().rotation, (pose @ pose @ pose).rotation):
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)


def test_a_transform_cannot_be_changed_from_outside() -> None:
    """It copies what it is made of, and hands out what cannot be written."""
    rotation, translation = np.eye(3), np.zeros(3)
    transform = RigidTransform(rotation, translation)
    rotation[0, 0], translation[0] = 2.0, 2.0
    np.testing.assert_array_equal(transform.matrix, np.eye(4))
    for part in (transform.rotation, transform.translation, transform.inverse().rotation):
        with pytest.raises(ValueError, match='read-only'):
            part[0] = 1.0
