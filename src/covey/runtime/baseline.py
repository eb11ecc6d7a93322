"""What simpler methods reach: greedy placement on a grid of poses, and Lloyd's iteration from there.

They know everything at once, with no trading, so they show what the trading buys.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from covey.coverage import agent_scores, team_visibility
from covey.environment import Landmarks
from covey.geometry import Pose2, Region
from covey.mission import Mission
from covey.optimize import PoseProblem, blackbox
from covey.optimize.ascent import pose_values
from covey.optimize.packing import landmark_columns
from covey.optimize.pose_ascent import summit
from covey.runtime.result import Baseline
from covey.sensing import VisibilityModel, is_compiled

CELLS, MOST_CELLS, HEADINGS = 21, 61, 16
"""Positions along each side of the grid of poses, at least and at most, and headings at each."""

LLOYD_ROUNDS = 100
CLIMBS = np.array([[22, 3]])
"""Evaluations of each climb of a refinement, and how many are climbed to the end."""

STARTS, NEARBY = 12, 0.5
"""Starts of a refinement, and how far around the pose they lie, in optimal distances and radians."""


def greedy_lloyd(mission: Mission, models: Sequence[VisibilityModel], *, rng: np.random.Generator) -> Baseline:
    """Deploy a mission's team greedily, then by Lloyd's iteration with local refinement of each pose.

    Parameters
    ----------
    mission : Mission
    models : sequence of VisibilityModel
        Each agent's sensor.
    rng : numpy.random.Generator
        Draws the starts of each refinement.
    """
    landmarks = mission.landmarks
    regions = [agent.region for agent in mission.agents]
    poses = _greedy(models, regions, [agent.pose for agent in mission.agents], landmarks)
    visibility = team_visibility(models, poses, landmarks)
    greedy = float(visibility.max(axis=0, initial=0.0) @ landmarks.weights)
    score = greedy
    for _ in range(LLOYD_ROUNDS):
        owner = visibility.argmax(axis=0)
        poses = [
            _refine(model, region, landmarks.subset(np.flatnonzero(owner == i)), pose, rng)
            for i, (model, region, pose) in enumerate(zip(models, regions, poses, strict=True))
        ]
        visibility = team_visibility(models, poses, landmarks)
        improved = float(agent_scores(visibility, visibility.argmax(axis=0), landmarks.weights).sum())
        if improved <= score + 1e-9:
            break
        score = improved
    return Baseline(greedy, score)


def _greedy(
    models: Sequence[VisibilityModel], regions: Sequence[Region], poses: Sequence[Pose2], landmarks: Landmarks
) -> list[Pose2]:
    """Place one agent after the other where it adds most to what the others see already."""
    best = np.zeros(len(landmarks))
    placed = []
    grids: list[tuple[Region, object, NDArray[np.float64]]] = []
    for model, region, pose in zip(models, regions, poses, strict=True):
        unit = getattr(model, "optimal_distance", 1.0)
        grid = next((known for r, u, known in grids if r is region and u == unit), None)
        if grid is None:
            grid = _grid(region, unit)
            grids.append((region, unit, grid))
        values = _values(model, landmarks, grid, best)
        chosen = Pose2.from_array(grid[values.argmax()]) if len(grid) else pose
        placed.append(chosen)
        best = np.maximum(best, model.visibility(chosen.as_array()[None], landmarks)[0])
    return placed


def _grid(region: Region, unit: float) -> NDArray[np.float64]:
    corners = region.inset_edges[:, :2]
    (x0, y0), (x1, y1) = corners.min(axis=0), corners.max(axis=0)
    nx, ny = (min(MOST_CELLS, max(CELLS, math.ceil(2.0 * size / unit))) for size in (x1 - x0, y1 - y0))
    x, y, psi = np.meshgrid(
        np.linspace(x0, x1, nx), np.linspace(y0, y1, ny), 2 * math.pi / HEADINGS * np.arange(HEADINGS), indexing="ij"
    )
    poses = np.column_stack([x.ravel(), y.ravel(), psi.ravel()])
    return poses if region.is_box else poses[region.contains_points(poses[:, :2])]


def _values(
    model: VisibilityModel, landmarks: Landmarks, grid: NDArray[np.float64], best: NDArray[np.float64]
) -> NDArray[np.float64]:
    values = np.empty(len(grid))
    if is_compiled(model):
        columns = landmark_columns(landmarks, best)
        pose_values(int(model.kernel), columns, 1.0 / model.optimal_distance, grid, values)
        return values
    problem = PoseProblem(model, landmarks, Region.box(-1, 1, -1, 1), best)
    for part in np.array_split(np.arange(len(grid)), max(1, len(grid) // 512)):
        values[part] = blackbox.values(problem, grid[part])
    return values


def _refine(
    model: VisibilityModel, region: Region, landmarks: Landmarks, pose: Pose2, rng: np.random.Generator
) -> Pose2:
    """Climb from where the agent is and from places nearby."""
    if not len(landmarks):
        return pose
    problem = PoseProblem(model, landmarks, region)
    if not is_compiled(model):
        return blackbox.search(problem, start=pose, rng=rng).pose
    unit = model.optimal_distance
    starts = pose.as_array() + rng.normal(size=(STARTS, 3)) * np.array([unit, unit, 1.0]) * NEARBY
    starts[0] = pose.as_array()
    best = np.empty(3)
    columns = landmark_columns(landmarks)
    summit(int(model.kernel), columns, unit, region.inset_edges, starts, CLIMBS, 1e-9, best)
    refined = Pose2.from_array(best)
    return refined if problem.score(refined) > problem.score(pose) else pose
