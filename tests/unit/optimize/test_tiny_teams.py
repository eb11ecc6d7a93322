"""Plans of tiny missions against the best deployment of all, found by trying every partition."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import pytest
from tests.unit.optimize.test_team_bound import tiny
from tests.unit.runtime.small import check_deployment, small

from covey import plan
from covey.mission import Mission
from covey.optimize import Exact, PoseProblem, Status
from covey.runtime.agent import build_models

PROVED = 1e-2
"""To how much the best pose of each part is proved: where one landmark is seen best from a whole circle of poses, no
proof gets much closer."""

FOUND = 1e-5
"""To how much the best pose of each part is found, about."""

WITHIN = 0.03
"""What a pairwise plan may miss of the optimum."""


def mission_of(seed: int, agents: int, n: int) -> Mission:
    """The landmarks of `tiny`, and agents with equal sensors (even seeds) or different ones (odd seeds)."""
    landmarks = tiny(seed, agents, n).landmarks
    assert landmarks.normals_W is not None
    sensors = [
        {"model": "anisotropic", "optimal_distance_m": 0.7},
        {"model": "oriented", "optimal_distance_m": 1.0},
        {"model": "isotropic", "optimal_distance_m": 0.5},
    ]
    team = [{"name": f"agent {i}", "sensor": sensors[i % 3 if seed % 2 else 0]} for i in range(agents)]
    return small(
        agents=team,
        points=landmarks.positions_W.tolist(),
        weights=landmarks.weights.tolist(),
        normals=landmarks.normals_W.tolist(),
        region={"box": {"x_m": [-3, 3], "y_m": [-3, 3]}},
    )


def enumerated_optimum(mission: Mission) -> float:
    """Score of the best deployment: every partition, each part's pose by `exact`."""
    models, n = build_models(mission), len(mission.landmarks)
    kinds = [models.index(model) for model in models]
    rng = np.random.default_rng(0)
    values = {}
    for kind, members in itertools.product(set(kinds), range(1 << n)):
        own = np.array([k for k in range(n) if members >> k & 1], dtype=np.int64)
        problem = PoseProblem(models[kind], mission.landmarks.subset(own), mission.agents[kind].region)
        found = Exact().maximize(problem, tolerance=PROVED, rng=rng)
        assert found.status is Status.PROVED
        values[kind, members] = found.score
    return max(
        sum(values[kind, sum(1 << k for k in range(n) if owner[k] == i)] for i, kind in enumerate(kinds))
        for owner in itertools.product(range(len(kinds)), repeat=n)
    )


@pytest.mark.parametrize(("agents", "n"), [(2, 5), (2, 6), (3, 4)])
def test_plans_of_tiny_missions(agents: int, n: int, seeds: Callable[[int, int], range]) -> None:
    for seed in seeds(6, 40):
        mission = mission_of(seed, agents, n)
        optimum = enumerated_optimum(mission)
        deployment = plan(mission, seed=seed, trade="pairwise", bound=True)
        assert deployment.bound is not None
        assert deployment.bound.team_upper_bound >= optimum - FOUND
        thesis = plan(mission, seed=seed, trade="thesis")
        for each in (deployment, thesis):
            check_deployment(each)
            assert each.score.final <= optimum + FOUND
        assert deployment.score.final >= (1.0 - WITHIN) * optimum
