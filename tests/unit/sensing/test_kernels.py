"""The compiled formulas against the models, and the linear bounds against samples of what they bound."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from covey.environment import Landmarks
from covey.optimize.packing import landmark_columns
from covey.sensing import MODELS, CompiledModel, Isotropic, build_model
from covey.sensing.base import is_compiled
from covey.sensing.kernels import gain_gradient, linear_bounds, visibility_gradients
from covey.testing.visibility import sample_landmarks, sample_poses

seed = st.integers(0, 2**32 - 1)
name = st.sampled_from(sorted(MODELS))


def compiled(name: str, optimal_distance: float) -> CompiledModel:
    model = build_model(name, {"optimal_distance": optimal_distance})
    assert is_compiled(model)
    return model


def kernel_rows(model: CompiledModel, pose: NDArray[np.float64], landmarks: Landmarks) -> NDArray[np.float64]:
    out = np.empty((4, len(landmarks)))
    c, s = math.cos(pose[2]), math.sin(pose[2])
    columns = landmark_columns(landmarks)
    visibility_gradients(int(model.kernel), columns, 1.0 / model.optimal_distance, pose[0], pose[1], c, s, out)
    return out


@given(seed, name, st.sampled_from([0.1, 1.0, 7.0]))
def test_kernel_values_are_those_of_the_model(seed: int, name: str, distance: float) -> None:
    rng = np.random.default_rng(seed)
    model = compiled(name, distance)
    landmarks = sample_landmarks(model, 20, rng=rng)
    for pose in sample_poses(model, 10, landmarks, rng=rng):
        seen = model.visibility(pose[None], landmarks)[0]
        value = kernel_rows(model, pose, landmarks)[0]
        np.testing.assert_allclose(np.maximum(0.0, value), seen, rtol=1e-12, atol=1e-12)


@given(seed, name, st.sampled_from([0.1, 1.0, 7.0]))
def test_kernel_gradients_are_those_of_the_model(seed: int, name: str, distance: float) -> None:
    """Central differences, wherever neither the pose nor its neighbours are at a kink."""
    rng = np.random.default_rng(seed)
    model = compiled(name, distance)
    landmarks = sample_landmarks(model, 20, rng=rng)
    step = 1e-5
    compared = 0
    for pose in sample_poses(model, 20, landmarks, rng=rng):
        rows = kernel_rows(model, pose, landmarks)
        r = np.linalg.norm(landmarks.positions_W - pose[:2], axis=1) / distance
        smooth = (rows[0] > 1e-3) & (np.abs(r - 1.0) > 1e-3) & (r > 1e-2)
        for axis, row in enumerate((1, 2, 3)):
            # the derivatives are by q = (s - p) / distance
            unit = np.zeros(3)
            unit[axis] = step * (1.0 if axis == 2 else -distance)
            ahead = model.visibility((pose + unit)[None], landmarks)[0]
            behind = model.visibility((pose - unit)[None], landmarks)[0]
            slope = (ahead - behind) / (2.0 * step)
            np.testing.assert_allclose(rows[row][smooth], slope[smooth], rtol=1e-4, atol=1e-6)
        compared += int(smooth.sum())
    assert compared > 20


@given(seed, name, st.sampled_from([0.1, 1.0, 7.0]))
def test_the_sum_of_gains_is_that_of_the_single_ones(seed: int, name: str, distance: float) -> None:
    rng = np.random.default_rng(seed)
    model = compiled(name, distance)
    plain = sample_landmarks(model, 20, rng=rng)
    landmarks = Landmarks(plain.positions_W, rng.uniform(0.0, 3.0, 20), plain.normals_W)
    thresholds = np.where(rng.random(20) < 0.5, 0.0, rng.uniform(0.0, 0.5, 20))
    columns = landmark_columns(landmarks, thresholds)
    for pose in sample_poses(model, 10, landmarks, rng=rng):
        rows = kernel_rows(model, pose, landmarks)
        weights = np.where(rows[0] > thresholds, landmarks.weights, 0.0)
        c, s = math.cos(pose[2]), math.sin(pose[2])
        total, *gradient = gain_gradient(
            int(model.kernel), columns, 1.0 / model.optimal_distance, pose[0], pose[1], c, s
        )
        assert total == pytest.approx(weights @ (rows[0] - thresholds), rel=1e-12, abs=1e-12)
        # a pose forward is a landmark backward
        expected = np.array([-(weights @ rows[1]), -(weights @ rows[2]), weights @ rows[3]])
        np.testing.assert_allclose(gradient, expected, rtol=1e-9, atol=1e-9)


def bound_at(out: NDArray[np.float64], offset: NDArray[np.float64], psi: float, *, turn: float) -> NDArray[np.float64]:
    """Right side of what `linear_bounds` promises, for every landmark, at one offset and heading."""
    a, b, c = (out[i] + offset[0] * out[3 + i] + offset[1] * out[6 + i] for i in range(3))
    parts: NDArray[np.float64] = np.maximum(0.0, a * math.cos(turn * psi) + b * math.sin(turn * psi) + c)
    return parts


@given(
    seed,
    name,
    st.floats(1e-3, 3.0),
    st.floats(1e-3, 1.0),
    st.floats(1e-4, math.pi / 8),
)
def test_linear_bounds_hold_for_each_landmark_offset_and_heading(
    seed: int, name: str, half: float, aspect: float, width: float
) -> None:
    """In optimal distances; landmarks from inside the box to far away, with weights and thresholds."""
    rng = np.random.default_rng(seed)
    model = compiled(name, 1.0)
    turn = 2.0 if name == "oriented" else 1.0
    centre = rng.normal(size=2)
    size = np.array([half, half * aspect])[:: rng.choice([-1, 1])]
    psi = rng.uniform(-math.pi, math.pi)
    n = 40
    bearing = rng.uniform(-math.pi, math.pi, (2, n))
    away = 10.0 ** rng.uniform(-3.0, 1.5, n)
    away[: n // 4] = 1.0 + half * rng.uniform(-1.5, 1.5, n // 4)
    points = centre + np.abs(away)[:, None] * np.column_stack([np.cos(bearing[0]), np.sin(bearing[0])])
    # every third landmark lies ahead of the camera
    ahead = centre + np.abs(away)[:, None] * np.array([math.cos(psi), math.sin(psi)]) + 0.1 * rng.normal(size=(n, 2))
    points[::3] = ahead[::3]
    landmarks = Landmarks(points, rng.uniform(0.0, 3.0, n), np.column_stack([np.cos(bearing[1]), np.sin(bearing[1])]))
    thresholds = np.where(rng.random(n) < 0.5, 0.0, rng.uniform(0.0, 1.0, n))
    vertices = np.array(
        [
            [math.cos(psi - width), math.sin(psi - width)],
            [math.cos(psi + width), math.sin(psi + width)],
            [math.cos(psi) / math.cos(width), math.sin(psi) / math.cos(width)],
        ]
    )
    out = np.empty((9, n))
    linear_bounds(
        int(model.kernel),
        landmark_columns(landmarks, thresholds),
        centre[0],
        centre[1],
        size[0],
        size[1],
        vertices,
        out,
    )
    assert np.isfinite(out).all()
    corners = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]])
    offsets = np.vstack([corners, [[0.0, 0.0]], rng.uniform(-1.0, 1.0, (60, 2))])
    headings = psi + np.concatenate([[-width, 0.0, width] * 10, rng.uniform(-width, width, len(offsets) - 30)])
    for offset, heading in zip(offsets, rng.permutation(headings), strict=True):
        pose = np.array([*(centre + offset * size), heading])
        part = landmarks.weights * np.maximum(0.0, model.visibility(pose[None], landmarks)[0] - thresholds)
        excess = part - bound_at(out, offset, heading, turn=turn)
        assert excess.max() <= 1e-12, f"landmark {excess.argmax()} is underestimated by {excess.max()}"


@pytest.mark.parametrize("name", sorted(MODELS))
def test_linear_bounds_close_in_with_the_square_of_the_box(name: str) -> None:
    """For landmarks well away from the kinks; what makes the branch and bound fast."""
    rng = np.random.default_rng(8)
    model = compiled(name, 1.0)
    bearing = rng.uniform(-0.5, 0.5, 30)
    away = rng.uniform(1.5, 4.0, 30)
    points = away[:, None] * np.column_stack([np.cos(bearing), np.sin(bearing)])
    landmarks = Landmarks(points, normals_W=np.column_stack([np.full(30, -1.0), rng.uniform(-0.5, 0.5, 30)]))
    seen = model.visibility(np.zeros((1, 3)), landmarks)[0]
    turn = 2.0 if name == "oriented" else 1.0
    excess = []
    for half in (0.1, 0.05, 0.025, 0.0125):
        out = np.empty((9, 30))
        vertices = np.array([[1.0, -half], [1.0, half], [1.0, 0.0]])
        linear_bounds(int(model.kernel), landmark_columns(landmarks), 0.0, 0.0, half, half, vertices, out)
        excess.append((bound_at(out, np.zeros(2), 0.0, turn=turn) - seen).sum())
    ratios = np.array(excess[:-1]) / np.array(excess[1:])
    assert (ratios > 3.7).all(), ratios
    assert (ratios < 5.5).all(), ratios


def test_isotropic_bounds_do_not_depend_on_the_heading() -> None:
    out = np.empty((9, 1))
    columns = landmark_columns(Landmarks(np.array([[2.0, 0.3]])))
    linear_bounds(int(Isotropic().kernel), columns, 0.0, 0.0, 0.2, 0.2, np.zeros((3, 2)), out)
    assert not out[[0, 1, 3, 4, 6, 7]].any()
