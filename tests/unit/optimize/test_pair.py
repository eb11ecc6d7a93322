"""Two agents that meet: the joint search never loses, stays in both regions, and finds known optima."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from tests.conformance.models import Spotlight

from covey.environment import Landmarks
from covey.geometry import Pose2, Region
from covey.optimize import Exact, PairProblem, PairSearch, PoseProblem
from covey.optimize.ascent import objective
from covey.optimize.packing import landmark_columns
from covey.sensing import Anisotropic, Isotropic, Oriented, VisibilityModel

MODELS: list[tuple[VisibilityModel, VisibilityModel]] = [
    (Anisotropic(), Anisotropic()),
    (Anisotropic(0.5), Isotropic(2.0)),
    (Oriented(), Anisotropic()),
    (Spotlight(), Anisotropic()),
]


def problem(models: tuple[VisibilityModel, VisibilityModel], seed: int, n: int) -> PairProblem:
    rng = np.random.default_rng(seed)
    hole = Region.polygon([[-3, -3], [3, -3], [3, 3], [-3, 3]], [[[-1, -2], [2, -1], [1, 1]]])
    regions = (hole, Region.box(-3, 0, -3, 3)) if seed % 2 else (hole, hole)
    poses = tuple(Pose2.from_array([*region.sample(1, rng=rng)[0], rng.uniform(-3, 3)]) for region in regions)
    normals = rng.normal(size=(n, 2))
    landmarks = Landmarks(rng.uniform(-3, 3, (n, 2)), rng.uniform(0, 2, n), normals if n else None)
    if not n:
        landmarks = Landmarks(np.empty((0, 2)), normals_W=np.empty((0, 2)))
    return PairProblem(models, regions, (poses[0], poses[1]), landmarks)


@pytest.mark.parametrize("models", MODELS, ids=repr)
def test_it_never_loses_and_stays_in_both_regions(
    models: tuple[VisibilityModel, VisibilityModel], seeds: Callable[[int, int], range]
) -> None:
    for seed in seeds(4, 60):
        for n in (0, 1, 2, 25):
            pair = problem(models, seed, n)
            poses, score = PairSearch().maximize(pair, rng=np.random.default_rng(seed))
            assert score == pair.score(poses)
            assert score >= pair.score(pair.poses)
            for pose, region in zip(poses, pair.regions, strict=True):
                assert region.contains(pose.x, pose.y)
            again, _ = PairSearch().maximize(pair, rng=np.random.default_rng(seed))
            assert again == poses
            if n == 0:
                assert poses == pair.poses


def test_the_score_gives_each_landmark_to_who_sees_it_better() -> None:
    landmarks = Landmarks(np.array([[1.0, 0.0], [-2.0, 0.0]]), np.array([1.0, 3.0]))
    poses = (Pose2(0, 0, 0), Pose2(0, 0, np.pi))
    box = Region.box(-3, 3, -3, 3)
    assert PairProblem((Anisotropic(), Anisotropic()), (box, box), poses, landmarks).score(poses) == pytest.approx(2.5)


def test_two_landmarks_are_seen_best_by_two_agents() -> None:
    landmarks = Landmarks(np.array([[-2.0, 0.0], [2.0, 0.5]]), np.array([1.0, 2.0]))
    box = Region.box(-4, 4, -4, 4)
    for models in (MODELS[0], MODELS[1]):
        pair = PairProblem(models, (box, box), (Pose2(3, 3, 0), Pose2(3, 3, 0)), landmarks)
        _, score = PairSearch().maximize(pair, rng=np.random.default_rng(0))
        assert score == pytest.approx(3.0, abs=1e-6)


def test_neither_partner_has_a_better_answer_to_the_other() -> None:
    """At a summit of the joint problem each pose is about the best response to the other, by `exact`."""
    gains = []
    for seed in range(0, 12, 2):
        pair = problem((Anisotropic(), Anisotropic()), seed, 25)
        poses, score = PairSearch().maximize(pair, rng=np.random.default_rng(seed))
        seen = pair.visibility(poses)
        for i in (0, 1):
            response = PoseProblem(pair.models[i], pair.landmarks, pair.regions[i], seen[1 - i])
            best = Exact().maximize(response, start=poses[i], tolerance=1e-3, rng=np.random.default_rng(0))
            gains.append((best.score + seen[1 - i] @ pair.landmarks.weights - score) / score)
    assert min(gains) >= -1e-9
    assert np.median(gains) < 1e-6
    assert max(gains) < 0.02


@pytest.mark.parametrize("models", MODELS, ids=repr)
def test_two_that_must_keep_apart_do_and_still_never_lose(
    models: tuple[VisibilityModel, VisibilityModel], seeds: Callable[[int, int], range]
) -> None:
    for seed in seeds(4, 60):
        for spacing in (0.5, 1.5):
            pair = replace(problem(models, seed, 25), spacing=spacing)
            if not pair.apart(pair.poses):
                continue
            poses, score = PairSearch().maximize(pair, rng=np.random.default_rng(seed))
            assert np.hypot(poses[0].x - poses[1].x, poses[0].y - poses[1].y) >= spacing
            assert score == pair.score(poses)
            assert score >= pair.score(pair.poses)
            for pose, region in zip(poses, pair.regions, strict=True):
                assert region.contains(pose.x, pose.y)


def test_keeping_apart_costs_what_it_must_and_no_more() -> None:
    """Two landmarks beside a corridor, against all pairs of places far enough apart that look at one each."""
    landmarks = Landmarks(np.array([[-1.2, 0.0], [1.2, 0.0]]))
    region = Region.box(-3, 3, 0.6, 1.4)
    free = PairProblem((Anisotropic(),) * 2, (region,) * 2, (Pose2(-2.9, 1, 0), Pose2(2.9, 1, 0)), landmarks)
    assert PairSearch().maximize(free, rng=np.random.default_rng(0))[1] == pytest.approx(2.0, abs=1e-6)
    tight = replace(free, spacing=5.0)
    _, score = PairSearch().maximize(tight, rng=np.random.default_rng(0))
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(-3, 3, 121), np.linspace(0.6, 1.4, 17)))
    left, right = (np.hypot(x - side, y) for side in (-1.2, 1.2))
    apart = np.hypot(x[:, None] - x, y[:, None] - y) >= 5.0
    sums = np.minimum(left, 1.0 / left)[:, None] + np.minimum(right, 1.0 / right)
    best = sums[apart].max()
    assert best < 1.8
    assert best - 1e-3 <= score <= best + 0.05


def test_agents_that_are_alike_take_the_nearer_of_the_two_poses() -> None:
    landmarks = Landmarks(np.array([[-2.0, 0.0], [2.0, 0.0]]))
    box = Region.box(-4, 4, -4, 4)
    for side in (-1.0, 1.0):
        start = (Pose2(side * 3.9, -3.9, 0.0), Pose2(-side * 3.9, -3.9, 0.0))
        pair = PairProblem((Anisotropic(), Anisotropic()), (box, box), start, landmarks, spacing=1.0)
        poses, score = PairSearch().maximize(pair, rng=np.random.default_rng(0))
        assert score == pytest.approx(2.0, abs=1e-6)
        crossed = [np.hypot(p.x - q.x, p.y - q.y) for p, q in zip(poses[::-1], start, strict=True)]
        straight = [np.hypot(p.x - q.x, p.y - q.y) for p, q in zip(poses, start, strict=True)]
        assert sum(straight) <= sum(crossed)


def test_the_gradient_of_two_that_are_pushed_apart_is_that_of_differences() -> None:
    rng = np.random.default_rng(2)
    columns = landmark_columns(Landmarks(rng.uniform(-2, 2, (30, 2)), rng.uniform(0.5, 2, 30)))
    edges = Region.box(-9, 9, -9, 9).inset_edges
    kinds = np.array([int(Anisotropic().kernel), int(Isotropic().kernel)])
    offsets, spacing = np.array([0, len(edges), 2 * len(edges)]), 1.2
    for _ in range(50):
        scales = rng.uniform(0.5, 2.0, 2)
        middle, turn, away = rng.uniform(-2, 2, 2), rng.uniform(-3, 3), rng.uniform(0.3, 1.1)
        half = 0.5 * away * np.array([np.cos(turn), np.sin(turn)])
        x = np.array([*(middle - half) / scales[0], 0.3, *(middle + half) / scales[1], -1.0])

        def value(x: np.ndarray, gradient: np.ndarray, scales: np.ndarray = scales) -> float:
            room = np.empty((2, 5)), np.empty((2, 4, 30)), np.empty(30, dtype=np.int64)
            edges_of_both = np.vstack([edges, edges])
            return objective(kinds, scales, columns, edges_of_both, offsets, spacing, x, gradient, *room)

        gradient, step = np.empty(6), 1e-6
        value(x, gradient)
        for j in range(6):
            nudge = step * np.eye(6)[j]
            slope = (value(x + nudge, np.empty(6)) - value(x - nudge, np.empty(6))) / (2.0 * step)
            assert gradient[j] == pytest.approx(slope, rel=1e-4, abs=1e-4)
