"""Rotations against matrices, and against scipy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from covey.flight import rotation

RNG = np.random.default_rng(4)
QUATS = [q / np.linalg.norm(q) for q in RNG.standard_normal((20, 4))]


def matrix(quat: np.ndarray) -> np.ndarray:
    out = np.empty((3, 3))
    rotation.matrix(quat, out)
    return out


@pytest.mark.parametrize("quat", QUATS)
def test_agrees_with_scipy(quat: np.ndarray) -> None:
    theirs = Rotation.from_quat(quat, scalar_first=True)
    np.testing.assert_allclose(matrix(quat), theirs.as_matrix(), atol=1e-14)
    vector, out = np.array([0.3, -2.0, 1.1]), np.empty(3)
    rotation.rotate(quat, vector, out)
    np.testing.assert_allclose(out, theirs.apply(vector), atol=1e-14)
    rotation.rotate_back(quat, out, out)
    np.testing.assert_allclose(out, vector, atol=1e-14)
    rotation.thrust_axis(quat, out)
    np.testing.assert_allclose(out, theirs.as_matrix()[:, 2], atol=1e-14)
    assert rotation.tilt_of(quat) == pytest.approx(np.arccos(theirs.as_matrix()[2, 2]), abs=1e-7)


def test_product_is_the_product_of_matrices() -> None:
    out = np.empty(4)
    for a, b in zip(QUATS[:10], QUATS[10:], strict=True):
        rotation.product(a, b, out)
        np.testing.assert_allclose(matrix(out), matrix(a) @ matrix(b), atol=1e-14)


def test_yaw_pitch_roll_is_rz_ry_rx() -> None:
    # C4: not the order that section 2.1 prints
    quat = np.empty(4)
    for yaw, pitch, roll in RNG.uniform(-1.5, 1.5, (20, 3)):
        rotation.from_yaw_pitch_roll(yaw, pitch, roll, quat)
        expected = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
        np.testing.assert_allclose(matrix(quat), expected, atol=1e-14)
        angles = rotation.yaw_of(quat), rotation.pitch_of(quat), rotation.roll_of(quat)
        np.testing.assert_allclose(angles, (yaw, pitch, roll), atol=1e-12)


def test_normalise() -> None:
    quat = np.array([2.0, 0.0, 0.0, 2.0])
    rotation.normalise(quat)
    np.testing.assert_allclose(quat, [np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])
