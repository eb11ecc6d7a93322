"""The laws of SE(2), on random poses."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from covey.geometry import Pose2, wrap_angle

coordinates = st.floats(-100.0, 100.0, allow_nan=False)
angles = st.floats(-50.0, 50.0, allow_nan=False)
poses = st.builds(Pose2, coordinates, coordinates, angles)
points = st.lists(st.tuples(coordinates, coordinates), min_size=1, max_size=5).map(np.array)

IDENTITY = Pose2(0.0, 0.0, 0.0)


def assert_same(first: Pose2, second: Pose2) -> None:
    np.testing.assert_allclose(first.position_W, second.position_W, atol=1e-9)
    assert abs(wrap_angle(first.yaw - second.yaw)) < 1e-9


@given(poses)
def test_identity(a: Pose2) -> None:
    assert_same(a.compose(IDENTITY), a)
    assert_same(IDENTITY.compose(a), a)


@given(poses)
def test_inverse(a: Pose2) -> None:
    assert_same(a.compose(a.inverse()), IDENTITY)
    assert_same(a.inverse().compose(a), IDENTITY)
    assert_same(a.inverse().inverse(), a)


@given(poses, poses)
def test_inverse_of_a_product(a: Pose2, b: Pose2) -> None:
    assert_same(a.compose(b).inverse(), b.inverse().compose(a.inverse()))


@given(poses, poses, poses)
def test_associativity(a: Pose2, b: Pose2, c: Pose2) -> None:
    assert_same(a.compose(b).compose(c), a.compose(b.compose(c)))


@given(poses, poses)
def test_product_is_the_product_of_matrices(a: Pose2, b: Pose2) -> None:
    np.testing.assert_allclose(a.compose(b).matrix(), a.matrix() @ b.matrix(), atol=1e-9)


@given(poses, poses, points)
def test_transform_is_an_action(a: Pose2, b: Pose2, p_B: NDArray[np.float64]) -> None:
    np.testing.assert_allclose(a.compose(b).transform(p_B), a.transform(b.transform(p_B)), atol=1e-9)
    np.testing.assert_allclose(a.inverse().transform(a.transform(p_B)), p_B, atol=1e-9)


@given(poses, points)
def test_transform_keeps_distances_and_agrees_with_the_matrix(a: Pose2, p_B: NDArray[np.float64]) -> None:
    p_W = a.transform(p_B)
    np.testing.assert_allclose(np.linalg.norm(p_W - p_W[0], axis=1), np.linalg.norm(p_B - p_B[0], axis=1), atol=1e-9)
    homogeneous = np.column_stack([p_B, np.ones(len(p_B))])
    np.testing.assert_allclose(homogeneous @ a.matrix().T, np.column_stack([p_W, np.ones(len(p_W))]), atol=1e-9)


@given(st.floats(-1e6, 1e6))
def test_wrapped_angles_lie_in_one_turn_and_differ_by_whole_turns(angle: float) -> None:
    wrapped = wrap_angle(angle)
    assert -math.pi <= wrapped < math.pi
    turns = (angle - wrapped) / (2.0 * math.pi)
    assert abs(turns - round(turns)) < 1e-9
    assert wrap_angle(wrapped) == wrapped
