"""The bound on the whole team, against every partition of tiny instances and against deployments of larger ones."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from tests.conformance.models import Spotlight

from covey.coverage import team_visibility
from covey.environment import Landmarks
from covey.errors import SolverError
from covey.geometry import Pose2, Region
from covey.optimize import Exact, PoseProblem, Search
from covey.optimize import team_bound as module
from covey.optimize.team_bound import team_bound
from covey.sensing import Anisotropic, Isotropic, Oriented, VisibilityModel

TOLERANCE = 1e-2


@dataclass(frozen=True)
class Team:
    models: Sequence[VisibilityModel]
    regions: Sequence[Region]
    landmarks: Landmarks


BOX = Region.box(-3, 3, -3, 3)
HOLE = Region.polygon([[-3, -3], [3, -3], [3, 3], [-3, 3]], [[[-1, -2], [2, -1], [1, 1]]])


def tiny(seed: int, agents: int, n: int) -> Team:
    """A few landmarks and agents, of equal or different sensors and regions."""
    rng = np.random.default_rng(seed)
    bearing = rng.uniform(-np.pi, np.pi, n)
    normals = np.column_stack([np.cos(bearing), np.sin(bearing)])
    landmarks = Landmarks(rng.uniform(-2.5, 2.5, (n, 2)), rng.uniform(0.2, 2.0, n), normals)
    if seed % 2:
        kinds: list[VisibilityModel] = [Anisotropic(0.7), Oriented(), Isotropic(0.5)]
        return Team([kinds[i % 3] for i in range(agents)], [BOX if i % 2 else HOLE for i in range(agents)], landmarks)
    return Team([Anisotropic()] * agents, [BOX] * agents, landmarks)


def enumerated_optimum(team: Team) -> float:
    """Score of the best deployment: every partition, each part by `exact`."""
    n = len(team.landmarks)
    rng = np.random.default_rng(0)
    values: dict[tuple[int, int], float] = {}
    kinds = [
        next(j for j in range(i + 1) if (team.models[j], team.regions[j]) == (team.models[i], team.regions[i]))
        for i in range(len(team.models))
    ]

    def value(kind: int, members: int) -> float:
        if (kind, members) not in values:
            own = np.array([k for k in range(n) if members >> k & 1], dtype=np.int64)
            problem = PoseProblem(team.models[kind], team.landmarks.subset(own), team.regions[kind])
            values[kind, members] = Exact().maximize(problem, tolerance=TOLERANCE, rng=rng).score
        return values[kind, members]

    best = 0.0
    for owner in itertools.product(range(len(kinds)), repeat=n):
        parts = [sum(1 << k for k in range(n) if owner[k] == i) for i in range(len(kinds))]
        best = max(best, sum(value(kind, part) for kind, part in zip(kinds, parts, strict=True)))
    return best


def check_team_bound(team: Team, *, seed: int = 0) -> float:
    """The bound is at least what enumeration reaches, and never below the deployment it starts from: the gap."""
    rng = np.random.default_rng(seed)
    poses = [Pose2.from_array([*region.sample(1, rng=rng)[0], 0.0]) for region in team.regions]
    visible = team_visibility(team.models, poses, team.landmarks)
    score = float(visible.max(axis=0) @ team.landmarks.weights)
    bound = team_bound(team.models, team.regions, poses, team.landmarks, score, rng=rng)
    best = enumerated_optimum(team)
    assert bound.team_upper_bound >= score
    assert bound.gap == pytest.approx((bound.team_upper_bound - score) / bound.team_upper_bound)
    assert bound.team_upper_bound >= best - 1e-9, f"claimed {bound.team_upper_bound}, a deployment scores {best}"
    return (bound.team_upper_bound - best) / best


def check_team_bounds(teams: Sequence[Team]) -> None:
    for seed, team in enumerate(teams):
        check_team_bound(team, seed=seed)


@pytest.mark.parametrize(("agents", "n"), [(1, 5), (2, 5), (2, 6), (3, 4)])
def test_no_partition_of_a_tiny_instance_exceeds_the_bound(
    agents: int, n: int, seeds: Callable[[int, int], range]
) -> None:
    for seed in seeds(4, 60):
        gap = check_team_bound(tiny(seed, agents, n), seed=seed)
        assert gap < 0.05  # the relaxation may have a gap of its own
        if agents == 1:
            assert gap < 5e-3


def understated(original: Callable[..., Any]) -> Callable[..., float]:
    return lambda *arguments: float(0.9 * original(*arguments))


def local_only(original: Callable[..., Any]) -> Callable[..., float]:
    """Take the best pose of the pool for the proof."""

    def prove(group: Any, landmarks: Landmarks, prices: Any, *rest: object) -> float:
        return float(module._gains(group, landmarks.weights, prices).mean())

    return prove


@pytest.mark.parametrize("mutant", [understated, local_only])
def test_an_inner_bound_that_is_too_low_is_caught(
    mutant: Callable[[Any], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_prove", mutant(module._prove))
    with pytest.raises(AssertionError, match="claimed"):
        check_team_bounds([tiny(seed, 2, 5) for seed in range(4)])


def test_agents_that_are_counted_once_are_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    original = module._groups

    def groups(*arguments: Any) -> Any:
        found = original(*arguments)
        for group in found:
            group.count = 1
        return found

    monkeypatch.setattr(module, "_groups", groups)
    with pytest.raises(AssertionError, match="claimed"):
        check_team_bounds([tiny(seed, 3, 4) for seed in (0, 2)])


def test_the_bound_is_tight_on_many_landmarks() -> None:
    """64 landmarks, 3 agents: 3^64 partitions, and the best deployment found is within 3 % of the bound."""
    line = np.linspace(-1.75, 1.75, 8)
    landmarks = Landmarks(np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2))
    rng = np.random.default_rng(1)
    region = Region.box(-2, 2, -2, 2)
    poses = [Pose2(-1.0, -1.0, 0.5), Pose2(1.0, -1.0, 2.0), Pose2(0.0, 1.0, 1.0)]
    models = [Anisotropic()] * 3
    for _ in range(10):
        owner = team_visibility(models, poses, landmarks).argmax(axis=0)
        poses = [
            Search()
            .maximize(
                PoseProblem(models[i], landmarks.subset(np.flatnonzero(owner == i)), region), start=poses[i], rng=rng
            )
            .pose
            for i in range(3)
        ]
    score = float(team_visibility(models, poses, landmarks).max(axis=0).sum())
    bound = team_bound(models, [region] * 3, poses, landmarks, score, rng=rng)
    assert score <= bound.team_upper_bound <= score / 0.97


def test_weights_scale_the_bound() -> None:
    team = tiny(2, 2, 6)
    poses = [Pose2(0.0, 0.0, 0.0), Pose2(1.0, 1.0, 1.0)]
    bounds = []
    for factor in (1.0, 50.0):
        landmarks = Landmarks(team.landmarks.positions_W, factor * team.landmarks.weights)
        score = float(team_visibility(team.models, poses, landmarks).max(axis=0) @ landmarks.weights)
        rng = np.random.default_rng(0)
        bounds.append(team_bound(team.models, team.regions, poses, landmarks, score, rng=rng).team_upper_bound)
    assert bounds[1] == pytest.approx(50.0 * bounds[0], rel=0.02)


def test_nothing_to_see_is_bounded_by_nothing() -> None:
    rng = np.random.default_rng(0)
    poses = [Pose2(0.0, 0.0, 0.0)]
    nothing = team_bound([Anisotropic()], [BOX], poses, Landmarks(np.empty((0, 2))), 0.0, rng=rng)
    assert (nothing.team_upper_bound, nothing.gap) == (0.0, 0.0)
    worthless = Landmarks(np.zeros((3, 2)), np.zeros(3))
    bound = team_bound([Anisotropic()], [BOX], poses, worthless, 0.0, rng=rng)
    assert (bound.team_upper_bound, bound.gap) == (0.0, 0.0)


def test_a_model_of_a_user_is_refused() -> None:
    with pytest.raises(SolverError, match="only the built-in"):
        team_bound(
            [Spotlight()], [BOX], [Pose2(0.0, 0.0, 0.0)], Landmarks(np.zeros((1, 2))), 0.0, rng=np.random.default_rng(0)
        )


def test_progress_is_told_and_the_bound_falls() -> None:
    team = tiny(1, 2, 6)
    told: list[tuple[float, float]] = []
    poses = [Pose2.from_array([*region.sample(1, rng=np.random.default_rng(0))[0], 0.0]) for region in team.regions]
    team_bound(
        team.models,
        team.regions,
        poses,
        team.landmarks,
        0.1,
        rng=np.random.default_rng(0),
        on_progress=lambda fraction, bound: told.append((fraction, bound)),
    )
    fractions, bounds = zip(*told, strict=True)
    assert list(fractions) == sorted(fractions)
    assert 0.0 < fractions[0] <= fractions[-1] <= 1.0
    assert list(bounds) == sorted(bounds, reverse=True)
