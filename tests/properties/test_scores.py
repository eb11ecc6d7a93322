"""Laws of the pose problem that hold for every model, pose, weight and threshold."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from tests.conformance.models import Lantern, Spotlight

from covey.environment import Landmarks
from covey.geometry import Pose2, Region
from covey.optimize import Exact, PoseProblem, Search, Status
from covey.optimize.ascent import pose_values
from covey.optimize.packing import landmark_columns
from covey.sensing import Anisotropic, CompiledModel, Isotropic, Oriented, VisibilityModel

BOX = Region.box(-3, 3, -3, 3)
COMPILED: list[CompiledModel] = [Anisotropic(), Oriented(0.6), Isotropic(2.0)]
MODELS: list[VisibilityModel] = [*COMPILED, Spotlight(), Lantern()]

seeds = st.integers(0, 2**32 - 1)


def scene(seed: int, n: int = 12) -> tuple[Landmarks, Pose2, np.random.Generator]:
    rng = np.random.default_rng(seed)
    landmarks = Landmarks(rng.uniform(-3, 3, (n, 2)), rng.uniform(0, 2, n), rng.normal(size=(n, 2)))
    return landmarks, Pose2.from_array([*rng.uniform(-3, 3, 2), rng.uniform(-math.pi, math.pi)]), rng


def reweighted(landmarks: Landmarks, weights: np.ndarray[tuple[int], np.dtype[np.float64]]) -> Landmarks:
    return Landmarks(landmarks.positions_W, weights, landmarks.normals_W)


@given(seeds, st.sampled_from(MODELS), st.floats(1e-3, 1e3))
def test_scaling_all_weights_scales_the_score(seed: int, model: VisibilityModel, factor: float) -> None:
    landmarks, pose, rng = scene(seed)
    thresholds = rng.uniform(0, 1, 12)
    for limits in (None, thresholds):
        plain = PoseProblem(model, landmarks, BOX, limits).score(pose)
        scaled = PoseProblem(model, reweighted(landmarks, factor * landmarks.weights), BOX, limits).score(pose)
        np.testing.assert_allclose(scaled, factor * plain, rtol=1e-12)


@given(seeds, st.sampled_from(MODELS))
def test_a_doubled_landmark_is_one_of_twice_the_weight(seed: int, model: VisibilityModel) -> None:
    landmarks, pose, _ = scene(seed)
    twice = landmarks.subset(np.repeat(np.arange(12), 2))
    doubled = reweighted(landmarks, 2.0 * landmarks.weights)
    score = PoseProblem(model, twice, BOX).score(pose)
    np.testing.assert_allclose(score, PoseProblem(model, doubled, BOX).score(pose), rtol=1e-12)


@given(seeds, st.sampled_from(MODELS))
def test_landmarks_add_up_and_thresholds_take_away(seed: int, model: VisibilityModel) -> None:
    landmarks, pose, rng = scene(seed)
    parts = [PoseProblem(model, landmarks.subset(part), BOX).score(pose) for part in (np.arange(5), np.arange(5, 12))]
    whole = PoseProblem(model, landmarks, BOX).score(pose)
    np.testing.assert_allclose(sum(parts), whole, rtol=1e-12)
    low = rng.uniform(0, 1, 12)
    limited = [PoseProblem(model, landmarks, BOX, limits).score(pose) for limits in (0.0 * low, low, low + 0.1)]
    np.testing.assert_allclose(limited[0], whole, rtol=1e-12)
    assert limited[0] >= limited[1] >= limited[2] >= 0.0
    assert limited[0] - limited[1] <= low @ landmarks.weights + 1e-12


@given(seeds, st.sampled_from(COMPILED))
def test_compiled_values_are_the_problems_scores(seed: int, model: CompiledModel) -> None:
    landmarks, _, rng = scene(seed)
    thresholds = rng.uniform(0, 0.5, 12)
    poses = np.column_stack([rng.uniform(-5, 5, (20, 2)), rng.uniform(-4, 4, 20)])
    values = np.empty(20)
    columns = landmark_columns(landmarks, thresholds)
    pose_values(int(model.kernel), columns, 1.0 / model.optimal_distance, poses, values)
    problem = PoseProblem(model, landmarks, BOX, thresholds)
    expected = [problem.score(Pose2.from_array(pose)) for pose in poses]
    np.testing.assert_allclose(values, expected, rtol=1e-11, atol=1e-11)


@given(seeds, st.sampled_from(COMPILED))
def test_the_optimum_grows_with_region_and_landmarks(seed: int, model: CompiledModel) -> None:
    """Proved both ways: what is proved for less is never above what is proved for more."""
    landmarks, _, rng = scene(seed, 8)
    small = Region.polygon([[-2, -2], [2, -1], [1, 2]], [[[-0.5, -0.5], [0.5, -0.5], [0.2, 0.5]]])
    more = Exact().maximize(PoseProblem(model, landmarks, BOX), tolerance=1e-2, rng=rng)
    less = Exact().maximize(PoseProblem(model, landmarks, small), tolerance=1e-2, rng=rng)
    fewer = Exact().maximize(PoseProblem(model, landmarks.subset(np.arange(5)), BOX), tolerance=1e-2, rng=rng)
    assert more.status is less.status is fewer.status is Status.PROVED
    assert less.score <= more.upper_bound + 1e-9
    assert fewer.score <= more.upper_bound + 1e-9
    assert more.score <= landmarks.weights.sum() * model.maximum + 1e-9


@given(seeds, st.sampled_from(COMPILED))
def test_the_search_never_exceeds_the_proof_and_comes_near(seed: int, model: CompiledModel) -> None:
    landmarks, start, rng = scene(seed, 10)
    problem = PoseProblem(model, landmarks, BOX)
    found = Search().maximize(problem, start=start, rng=rng)
    proof = Exact().maximize(problem, tolerance=1e-2, rng=rng)
    assert found.score <= proof.upper_bound + 1e-9
    assert found.score >= 0.97 * proof.score


def test_a_motion_of_the_plane_moves_the_optimum_with_it() -> None:
    landmarks, _, rng = scene(5, 10)
    motion = Pose2(20.0, -7.0, 0.7)
    turned = Pose2(0.0, 0.0, 0.7).transform(landmarks.normals_W) if landmarks.normals_W is not None else None
    moved = Landmarks(motion.transform(landmarks.positions_W), landmarks.weights, turned)
    region = Region(motion.transform(BOX.exterior))
    for model in COMPILED:
        here = Exact().maximize(PoseProblem(model, landmarks, BOX), tolerance=1e-4, rng=rng)
        there = Exact().maximize(PoseProblem(model, moved, region), tolerance=1e-4, rng=rng)
        assert abs(here.score - there.score) <= 1e-4
        back = PoseProblem(model, moved, region).score(motion.compose(here.pose))
        assert abs(back - here.score) <= 1e-9
