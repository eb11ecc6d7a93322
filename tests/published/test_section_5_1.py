"""Section 5.1 of the thesis (from p. 46, Figures 5.3 to 5.6): the rise of the score, and what pairwise trades add."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from covey import load_mission, plan
from covey.coverage import agent_scores, team_visibility
from covey.runtime.agent import build_models
from covey.runtime.baseline import greedy_lloyd
from covey.runtime.certify import bound_team

Seeds = Callable[[int, int], range]


def test_the_rise_of_the_score(root: Path) -> None:
    """Means of 40 seeds against the four scores of the reference, which a separate implementation gave.

    The thesis prints one draw: 21.39, 72.55, 79.89, 118.99.  Single runs spread by about 2.3, 1.3, 2.9 and 1.9
    (standard deviation), so means of 40 spread by 0.45 at most: 1.5 is more than three times that.
    """
    mission = load_mission(root / "examples" / "thesis-5.1.yaml")
    scores = [plan(mission, seed=seed, trade="thesis").score for seed in range(40)]
    columns = np.array([(s.initial, s.after_first_optimization, s.after_first_trade, s.final) for s in scores])
    np.testing.assert_allclose(columns.mean(axis=0), [20.1, 73.3, 81.0, 117.5], rtol=0.0, atol=1.5)
    # what the thesis prints is one draw of these
    for column, printed in zip(columns.T, (21.39, 72.55, 79.89, 118.99), strict=True):
        assert column.min() - 0.5 <= printed <= column.max() + 0.5
    assert (np.diff(columns, axis=1) > 0.0).all()


@pytest.mark.parametrize(
    ("name", "median", "slack", "few"),
    [("thesis-5.1", 120.5, 0.2, 8), ("eight-agents", 158.8, 0.3, 6), ("sixteen-agents", 204.0, 0.5, 4)],
)
def test_pairwise_trades_beat_the_baseline(
    name: str, median: float, slack: float, few: int, root: Path, seeds: Seeds, soak: bool
) -> None:
    """Medians of 20 seeds in `make soak`, above the baseline in every seed.

    Single runs spread by about 0.13 (4 agents), 0.2 (8) and 0.4 (16), standard deviation.  A median of the few seeds of
    `make test` spreads by about half of that, so it is allowed to lie lower by `slack`, more than twice its spread; the
    thesis's own rule, which reaches 117.5, 154 and less, fails by far.
    """
    mission = load_mission(root / "examples" / f"{name}.yaml")
    models = build_models(mission)
    baseline = greedy_lloyd(mission, models, rng=np.random.default_rng(0))
    finals = []
    for seed in seeds(few, 20):
        deployment = plan(mission, seed=seed)
        assert deployment.certificate is not None
        assert deployment.certificate.holds
        assert deployment.score.final > max(baseline.greedy, baseline.greedy_lloyd)
        finals.append(deployment.score.final)
    assert np.median(finals) >= median - (0.0 if soak else slack)


@pytest.mark.parametrize(
    ("name", "greedy", "lloyd"),
    [("thesis-5.1", 118.37, 119.76), ("eight-agents", 153.44, 155.57)],
)
def test_the_baseline(name: str, greedy: float, lloyd: float, root: Path) -> None:
    """Greedy on a 21 x 21 x 16 grid, then Lloyd with local refinement: one value each, no seed.

    Ours leaves out the edge of the region, and ties of the symmetric scene are broken in another order, on which the
    later agents' places depend: within 1 %.
    """
    mission = load_mission(root / "examples" / f"{name}.yaml")
    models = build_models(mission)
    baseline = greedy_lloyd(mission, models, rng=np.random.default_rng(0))
    assert baseline.greedy == pytest.approx(greedy, rel=0.01)
    assert baseline.greedy_lloyd == pytest.approx(lloyd, rel=0.01)
    assert baseline.greedy_lloyd >= baseline.greedy


def test_the_bound_on_the_team(root: Path) -> None:
    """Reference: 120.91 for 4 agents by a first try on a grid, 120.85 the best deployment known.

    The bound cannot be below the best deployment, and 0.5 % above ours is what covey promises.
    """
    deployment = plan(load_mission(root / "examples" / "thesis-5.1.yaml"), seed=1)
    bound = bound_team(deployment)
    assert bound.team_upper_bound >= 120.85
    assert bound.gap <= 0.005


def test_random_assignments_see_little(root: Path) -> None:
    """Random assignments of scene T score 20.1 on average, 14 to 24.7 (40 seeds): the mean of 4000 is exact to 0.1."""
    mission = load_mission(root / "examples" / "thesis-5.1.yaml")
    poses = [agent.pose for agent in mission.agents]
    visibility = team_visibility(build_models(mission), poses, mission.landmarks)
    rng = np.random.default_rng(0)
    weights = mission.landmarks.weights
    draws = [agent_scores(visibility, rng.integers(0, 4, 400), weights).sum() for _ in range(4000)]
    assert np.mean(draws) == pytest.approx(20.1, abs=0.3)
    assert np.mean(draws) == pytest.approx(visibility.sum() / 4.0, abs=0.2)
