"""Small missions, planned in a few hundredths of a second."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from covey.mission import Mission, parse_mission
from covey.runtime.result import Deployment

AGENTS = [
    {"name": "blue", "pose": {"x_m": 1.5, "y_m": -1.0, "yaw_deg": 0}},
    {"name": "red", "pose": {"x_m": -2.0, "y_m": 2.0, "yaw_deg": 90}},
    {"name": "green", "pose": {"x_m": 0.9, "y_m": 1.8, "yaw_deg": 180}},
]

HOLE = [[-0.9, -0.9], [0.9, -0.7], [0.7, 0.9], [-0.9, 0.7]]
POLYGON = {"polygon": {"exterior": [[-2, -2], [2, -2], [2, 2], [-2, 2]], "holes": [HOLE]}}


def small(
    *,
    agents: list[dict[str, Any]] | dict[str, Any] | None = None,
    spacing: float = 0.5,
    weights: list[float] | None = None,
    normals: list[list[float]] | None = None,
    points: list[list[float]] | None = None,
    region: dict[str, Any] | None = None,
    sensor: dict[str, Any] | None = None,
    **coverage: Any,
) -> Mission:
    """Build a mission on a floor of 4 m by 4 m, 64 landmarks."""
    import json

    if points is None and (weights is not None or normals is not None):
        count = round(4.0 / spacing)
        line = (np.arange(count) + 0.5) * spacing - 2.0
        points = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2).tolist()
    landmarks: dict[str, Any] = {"grid": {"x_m": [-2, 2], "y_m": [-2, 2], "spacing_m": spacing}}
    if points is not None:
        landmarks = {"points": points}
    if weights is not None:
        landmarks["weights"] = weights
    if normals is not None:
        landmarks["normals"] = normals
    document = {
        "schema_version": 1,
        "name": "small",
        "seed": 3,
        "environment": {
            "landmarks": landmarks,
            "region": region or {"box": {"x_m": [-2, 2], "y_m": [-2, 2]}},
        },
        "sensor": sensor or {"model": "anisotropic", "optimal_distance_m": 0.7},
        "agents": AGENTS if agents is None else agents,
        "coverage": {"sigma": 0.01, **coverage},
    }
    return parse_mission(json.dumps(document), format="json")


def check_deployment(deployment: Deployment) -> None:
    """Check what every settled deployment must be, from what it says."""
    from covey.runtime.result import PlanStatus

    mission = deployment.mission
    n = len(mission.landmarks)
    owned = np.concatenate([agent.landmarks for agent in deployment.agents])
    assert np.array_equal(np.sort(owned), np.arange(n)), "the partition is not disjoint and complete"
    scores = [entry.score for entry in deployment.history]
    falls = {late.event for early, late in pairwise(deployment.history) if late.score < early.score - 1e-9}
    assert falls <= {"death", "return", "adoption"}, "the score fell"  # a death, true or not, may cost score
    assert abs(deployment.score.final - scores[-1]) <= 1e-12 * max(1.0, scores[-1])
    assert deployment.score.initial == scores[0]
    total = sum(agent.score for agent in deployment.agents)
    assert abs(total - deployment.score.final) <= 1e-9 * max(1.0, total)
    for snapshot in deployment.snapshots:
        for pose, agent in zip(snapshot.poses, mission.agents, strict=True):
            assert agent.region.contains(pose.x, pose.y), f"{snapshot.label}: {pose} is outside its region"
        assert set(np.unique(snapshot.owner)) <= set(range(len(mission.agents)))
    if deployment.status is PlanStatus.SETTLED:
        assert deployment.certificate is not None
        assert deployment.certificate.holds, deployment.certificate.violations
        assert deployment.certificate.worst_pose_gap <= mission.coverage.sigma + 1e-9
        assert deployment.certificate.worst_trade_gain <= mission.coverage.sigma + 1e-9
