"""Deployments made up for tests of what is done with results."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from covey.coverage import TeamBound
from covey.coverage.certificate import Certificate, Violation
from covey.environment import GeoReference, Landmarks
from covey.geometry import Pose2, Region
from covey.mission import AgentSpec, Assignment, CoverageSpec, Mission, OptimizerName, SensorSpec, Trade
from covey.runtime.result import AgentResult, Baseline, Deployment, HistoryEntry, PlanStatus, Scores, Snapshot

MakeDeployment = Callable[..., Deployment]


def synthetic(
    *,
    agents: int = 4,
    side: int = 20,
    spacing: float | None = 0.5,
    geographic: bool = False,
    names: tuple[str, ...] | None = None,
    normals: bool = False,
    region: Region | None = None,
    own_region: bool = False,
    seed: int = 7,
    evidence: bool = True,
    **changes: Any,
) -> Deployment:
    """Make up a deployment: poses at random, each landmark owned by the nearest agent."""
    rng = np.random.default_rng(seed)
    step = 0.5 if spacing is None else spacing
    half = side * step / 2
    line = (np.arange(side) + 0.5) * step - half
    positions = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    if spacing is None:
        positions = positions + rng.uniform(-0.2, 0.2, positions.shape) * step
    region = region or Region.box(-half, half, -half, half)
    sensor = SensorSpec()
    names = names or tuple(f"agent {index + 1}" for index in range(agents))
    places = region.sample(agents, rng=rng)
    specs = [
        AgentSpec(name, Pose2(x, y, rng.uniform(-math.pi, math.pi)), sensor, region)
        for name, (x, y) in zip(names, places, strict=True)
    ]
    if own_region:
        specs[0] = AgentSpec(names[0], Pose2(0.0, 0.0, 0.0), sensor, Region.box(-1.0, 1.0, -1.0, 1.0))
    facing = -positions / np.linalg.norm(positions, axis=1, keepdims=True) if normals else None
    mission = Mission(
        schema_version=1,
        name="made up",
        seed=seed,
        landmarks=Landmarks(positions, rng.uniform(0.5, 2.0, len(positions)), facing, spacing),
        region=region,
        sensor=sensor,
        agents=tuple(specs),
        coverage=CoverageSpec(assignment=Assignment.RANDOM),
        georeference=GeoReference(-3.707398, 40.415364, 650.0) if geographic else None,
        source={"schema_version": 1, "name": "made up", "environment": {"date": None, "list": [1, 2.5, "x"]}},
        path=Path("missions/made-up.yaml"),
    )
    end = np.array([spec.pose.position_W for spec in specs])
    owner = np.argmin(((positions[:, None, :] - end[None, :, :]) ** 2).sum(axis=2), axis=1)
    results = tuple(
        AgentResult(spec.name, spec.pose, 10.0 + index / 3.0, np.flatnonzero(owner == index).astype(np.int64))
        for index, spec in enumerate(specs)
    )
    final = sum(result.score for result in results)
    rise = np.sort(rng.uniform(0.5, 1.0, 40)) ** 0.3
    history = [HistoryEntry("initial", (), 0.2 * final)]
    history += [
        HistoryEntry("optimization", (name,), final * (0.2 + 0.4 * (i + 1) / agents)) for i, name in enumerate(names)
    ]
    history += [HistoryEntry("trade", (names[0], names[-1]), final * (0.6 + 0.4 * float(r / rise[-1]))) for r in rise]
    scores = Scores(history[0].score, history[agents].score, history[agents + 1].score, final)
    shuffled = rng.integers(0, agents, len(positions))
    fields: dict[str, Any] = {
        "mission": mission,
        "seed": seed,
        "sigma": 0.01,
        "trade": Trade.PAIRWISE,
        "optimizer": OptimizerName.SEARCH,
        "status": PlanStatus.SETTLED,
        "score": scores,
        "history": tuple(history),
        "trades": 40,
        "pose_optimizations": 84,
        "agents": results,
        "timing_s": {"plan": 0.75, "certificate": 0.1},
        "software": {"covey": "0.1.0", "python": "3.11"},
        "snapshots": tuple(
            Snapshot(label, tuple(spec.pose for spec in specs), owned, getattr(scores, label))
            for label, owned in (
                ("initial", shuffled),
                ("after_first_optimization", shuffled),
                ("after_first_trade", shuffled),
                ("final", owner),
            )
        ),
    }
    if evidence:
        violation = Violation("trade", (names[0], names[-1]), 3, 0.25, "landmark 3 is better seen by another agent")
        fields |= {
            "certificate": Certificate(False, 0.01, 0.001, 0.25, (violation,)),
            "bound": TeamBound(final * 1.01, 1.0 - 1.0 / 1.01),
            "baseline": Baseline(final * 0.95, final * 0.97),
        }
    return Deployment(**{**fields, **changes})


@pytest.fixture
def make_deployment() -> MakeDeployment:
    """Return the function that makes up deployments."""
    return synthetic
