"""Poses in the plane: what they accept and a few values worked out by hand."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from covey.errors import ArgumentError, CoveyError
from covey.geometry import Pose2, wrap_angle


@pytest.mark.parametrize(
    ("angle", "wrapped"),
    [(0.0, 0.0), (math.pi, -math.pi), (-math.pi, -math.pi), (1.5 * math.pi, -0.5 * math.pi), (7.0, 7.0 - 2 * math.pi)],
)
def test_angles_are_wrapped_into_a_half_open_turn(angle: float, wrapped: float) -> None:
    assert wrap_angle(angle) == pytest.approx(wrapped, abs=1e-15)
    assert Pose2(0.0, 0.0, angle).yaw == pytest.approx(wrapped, abs=1e-15)


def test_yaw_turns_counter_clockwise_from_x() -> None:
    pose = Pose2(1.0, 2.0, math.pi / 2)
    np.testing.assert_allclose(pose.transform(np.array([[1.0, 0.0], [0.0, 1.0]])), [[1.0, 3.0], [0.0, 2.0]], atol=1e-15)


def test_array_and_matrix_hold_the_same_pose() -> None:
    pose = Pose2(1.0, -2.0, 0.5)
    assert Pose2.from_array(pose.as_array()) == pose
    np.testing.assert_array_equal(pose.position_W, [1.0, -2.0])
    matrix = pose.matrix()
    np.testing.assert_allclose(matrix[:2, :2] @ matrix[:2, :2].T, np.eye(2), atol=1e-15)
    np.testing.assert_array_equal(matrix[:, 2], [1.0, -2.0, 1.0])


@pytest.mark.parametrize("field", ["x", "y", "yaw"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_pose_is_finite(field: str, value: float) -> None:
    with pytest.raises(ArgumentError, match=f"{field}: expected a finite number"):
        dataclasses.replace(Pose2(0.0, 0.0, 0.0), **{field: value})


def test_argument_errors_are_value_errors_and_covey_errors() -> None:
    assert issubclass(ArgumentError, ValueError)
    assert issubclass(ArgumentError, CoveyError)
    assert ArgumentError("x").exit_code == 2


def test_numbers_of_any_kind_become_floats() -> None:
    numbers: list[Any] = [np.float32(1.0), 2, np.int64(0)]
    pose = Pose2(*numbers)
    assert all(type(value) is float for value in dataclasses.astuple(pose))
