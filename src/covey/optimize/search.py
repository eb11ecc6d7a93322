"""`search`: a fast multi-start ascent, used at every trade."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from covey.environment import Landmarks
from covey.geometry import Pose2, Region
from covey.optimize import blackbox
from covey.optimize.ascent import climb_all, nearest_on_edges, pose_values
from covey.optimize.base import PoseProblem, PoseResult
from covey.optimize.packing import landmark_columns
from covey.sensing.base import CompiledModel

CLIMB = 30
POLISH = 500
"""Evaluations for a first climb from a start, and for the last one from the best of them."""

HEADINGS = 8
OFFSET = 0.8
"""How far behind a landmark a candidate stands that looks at it, optimal distances."""


def candidate_poses(
    landmarks: Landmarks, region: Region, unit: float, anchors: int, *, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Poses from which some landmark is seen well: shape (s, 3), all in the region.

    Parameters
    ----------
    unit : float
        The optimal distance, metres.
    anchors : int
        How many landmarks are looked at, from HEADINGS directions each.
    """
    n = len(landmarks)
    chosen = np.arange(n) if n <= anchors else rng.choice(n, anchors, replace=False)
    turn = 2.0 * math.pi / HEADINGS
    psi = turn * np.arange(HEADINGS)[None, :] + rng.uniform(0.0, turn, (len(chosen), 1))
    points = landmarks.positions_W[chosen]
    poses = np.empty((len(chosen), HEADINGS, 3))
    poses[:, :, 0] = points[:, 0:1] - OFFSET * unit * np.cos(psi)
    poses[:, :, 1] = points[:, 1:2] - OFFSET * unit * np.sin(psi)
    poses[:, :, 2] = psi
    return into_region(poses.reshape(-1, 3), region)


def into_region(poses: NDArray[np.float64], region: Region) -> NDArray[np.float64]:
    """Move the poses, shape (s, 3), that lie outside the region to its nearest points, in place."""
    inside = region.contains_points(poses[:, :2])
    for i in np.flatnonzero(~inside):
        poses[i, 0], poses[i, 1], _, _ = nearest_on_edges(region.inset_edges, poses[i, 0], poses[i, 1])
    return poses


def spread(poses: NDArray[np.float64], values: NDArray[np.float64], unit: float, count: int) -> NDArray[np.int64]:
    """Indices of the best poses that are not near a better one: at most `count`."""
    chosen: list[int] = []
    order = np.argsort(-values, kind="stable")[: 20 * count]
    kept = np.empty((count, 3))
    for i in order:
        k = len(chosen)
        if k:
            away = np.hypot(kept[:k, 0] - poses[i, 0], kept[:k, 1] - poses[i, 1]) / unit
            turned = np.abs(np.remainder(kept[:k, 2] - poses[i, 2] + math.pi, 2 * math.pi) - math.pi)
            if (away + 0.5 * turned < 0.5).any():
                continue
        kept[k] = poses[i]
        chosen.append(int(i))
        if len(chosen) == count:
            break
    return np.array(chosen, dtype=np.int64)


@dataclass(frozen=True)
class Search:
    """Score many poses that look at a landmark, climb from the best of them, and keep the best summit.

    Parameters
    ----------
    anchors : int
        How many landmarks the candidates look at.
    starts : int
        From how many candidates it climbs.
    keep : int
        How many of those are climbed to the end.

    Notes
    -----
    O(n) an evaluation, some thousand of them.  Nothing is proved: see `Exact`.  Source: Sposato (2016), Algorithm 3.
    Deviation: V1, V4.
    """

    anchors: int = 64
    starts: int = 24
    keep: int = 5
    name: str = "search"

    def maximize(
        self,
        problem: PoseProblem,
        *,
        start: Pose2 | None = None,
        tolerance: float = 1e-3,
        rng: np.random.Generator,
    ) -> PoseResult:
        """Search; see `PoseOptimizer.maximize`."""
        model, region = problem.model, problem.region
        if not isinstance(model, CompiledModel):
            return blackbox.search(problem, start=start, rng=rng)
        unit = model.optimal_distance
        columns = landmark_columns(problem.landmarks, problem.thresholds)
        candidates = candidate_poses(problem.landmarks, region, unit, self.anchors, rng=rng)
        if start is not None:
            candidates = np.vstack([candidates, start.as_array()[None, :]])
        if not len(candidates):
            candidates = np.array([[*region.sample(1, rng=rng)[0], 0.0]])
        values = np.empty(len(candidates))
        pose_values(int(model.kernel), columns, 1.0 / unit, candidates, values)
        chosen = spread(candidates, values, unit, self.starts)
        starts = candidates[chosen]
        if start is not None:
            starts = np.vstack([starts, start.as_array()[None, :]])
        _, poses, evaluations = climb_all(
            np.array([int(model.kernel)]),
            np.array([unit]),
            columns,
            region.inset_edges,
            np.array([0, len(region.inset_edges)]),
            np.ascontiguousarray(starts[:, None, :]),
            CLIMB,
            self.keep,
            POLISH,
            1e-9,
        )
        pose = Pose2.from_array(poses[0])
        score = problem.score(pose)
        if start is not None and problem.score(start) >= score:
            pose, score = start, problem.score(start)
        return PoseResult(pose, score, evaluations=evaluations + len(candidates))
