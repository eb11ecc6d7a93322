"""Whole missions: thesis's trade with `search` and with differential evolution, pairwise trade beside the baseline."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from covey.mission import Mission, load_mission, parse_mission
from covey.runtime.plan import plan
from covey.runtime.result import Deployment

EXAMPLES = Path(__file__).parent.parent / "examples"


def timed(mission: Mission, **options: Any) -> tuple[float, Deployment]:
    """Wall-clock seconds of one plan, and what it gave."""
    begun = time.perf_counter()
    deployment = plan(mission, **options)
    return time.perf_counter() - begun, deployment


def scores(deployments: list[Deployment]) -> dict[str, float]:
    """Means of the four scores of which the thesis tells."""
    names = ("initial", "after_first_optimization", "after_first_trade", "final")
    return {name: float(np.mean([getattr(d.score, name) for d in deployments])) for name in names}


def thesis(quick: bool) -> dict[str, Any]:
    """Section 5.1 with the published rule."""
    mission = load_mission(EXAMPLES / "thesis-5.1.yaml")
    seeds = range(8 if quick else 40)
    runs = [timed(mission, seed=seed, trade="thesis") for seed in seeds]
    search_s = evolution_s = 0.0
    search_n = evolution_n = 0
    compared = seeds[: 2 if quick else 10]
    for seed in compared:
        # one search before and one after, so that both methods have the same share of a machine that others use too
        before, _ = timed(mission, seed=seed, trade="thesis")
        seconds, deployment = timed(mission, seed=seed, trade="thesis", optimizer="differential-evolution")
        after, found = timed(mission, seed=seed, trade="thesis")
        search_s += 0.5 * (before + after)
        search_n += found.pose_optimizations
        evolution_s += seconds
        evolution_n += deployment.pose_optimizations
    return {
        "seeds": len(seeds),
        "mean_scores": scores([deployment for _, deployment in runs]),
        "thesis_scores": {
            "initial": 21.39,
            "after_first_optimization": 72.55,
            "after_first_trade": 79.89,
            "final": 118.99,
        },
        "search_mission_s": search_s / len(compared),
        "de_mission_s": evolution_s / len(compared),
        "de_over_search": evolution_s / search_s,
        "de_over_search_per_optimization": (evolution_s / evolution_n) / (search_s / search_n),
    }


def pairwise(name: str, quick: bool) -> dict[str, Any]:
    """One of the examples as it comes by default, over seeds."""
    mission = load_mission(EXAMPLES / f"{name}.yaml")
    runs = [timed(mission, seed=seed, baseline=True) for seed in range(5 if quick else 20)]
    final = np.array([deployment.score.final for _, deployment in runs])
    base = np.array([d.baseline.greedy_lloyd for _, d in runs if d.baseline is not None])
    seconds = np.array([d.timing_s["total"] - d.timing_s["baseline"] for _, d in runs])
    return {
        "agents": len(mission.agents),
        "seeds": len(runs),
        "score_median": float(np.median(final)),
        "score_least": float(final.min()),
        "baseline": float(base.max()),
        "least_above_baseline": float((final - base).min()),
        "certificates_hold": all(d.certificate is not None and d.certificate.holds for _, d in runs),
        "plan_median_s": float(np.median(seconds)),
        "plan_most_s": float(seconds.max()),
    }


def bound(name: str) -> dict[str, Any]:
    """The proof that no deployment of a team is much better."""
    deployment = plan(load_mission(EXAMPLES / f"{name}.yaml"), bound=True)
    assert deployment.bound is not None
    return {
        "agents": len(deployment.agents),
        "score": deployment.score.final,
        "team_upper_bound": deployment.bound.team_upper_bound,
        "gap_percent": 100.0 * deployment.bound.gap,
        "seconds": deployment.timing_s["bound"],
    }


def large(quick: bool) -> dict[str, Any]:
    """64 agents and 10,000 landmarks; 16 and 2,500 when it has to be quick."""
    side, agents = (12.5, 16) if quick else (25.0, 64)
    text = f"""
schema_version: 1
name: large
seed: 1
environment:
  landmarks: {{grid: {{x_m: [{-side}, {side}], y_m: [{-side}, {side}], spacing_m: 0.5}}}}
  region: {{box: {{x_m: [{-side}, {side}], y_m: [{-side}, {side}]}}}}
sensor: {{model: anisotropic, optimal_distance_m: 1.0}}
agents: {{count: {agents}}}
"""
    seconds, deployment = timed(parse_mission(text, format="yaml"))
    assert deployment.certificate is not None
    return {
        "agents": agents,
        "landmarks": len(deployment.mission.landmarks),
        "seconds": seconds,
        "score": deployment.score.final,
        "trades": deployment.trades,
        "certificate_holds": deployment.certificate.holds,
        "timing_s": dict(deployment.timing_s),
    }


def run(quick: bool) -> dict[str, Any]:
    """Run all of it; the compiled kernels are warmed up first."""
    mission = load_mission(EXAMPLES / "thesis-5.1.yaml")
    for trade in ("thesis", "pairwise"):
        plan(replace(mission, name="warm-up"), trade=trade)
    return {
        "thesis": thesis(quick),
        "pairwise": [pairwise(name, quick) for name in ("thesis-5.1", "eight-agents", "sixteen-agents")],
        "bound": [bound(name) for name in ("thesis-5.1", "eight-agents")],
        "large": large(quick),
    }
