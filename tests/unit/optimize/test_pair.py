"""Two agents that meet: the joint search never loses, stays in both regions, and finds known optima."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from tests.conformance.models import Spotlight

from covey.environment import Landmarks
from covey.geometry import Pose2, Region
from covey.optimize import Exact, PairProblem, PairSearch, PoseProblem
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
