"""`search`: a fast multi-start ascent, used at every trade."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from covey.compiled import kernel
from covey.geometry import Pose2, Region
from covey.optimize import blackbox
from covey.optimize.ascent import climb_all, contains_point, nearest_on_edges, pose_values
from covey.optimize.base import PoseProblem, PoseResult
from covey.optimize.packing import landmark_columns
from covey.sensing.base import is_compiled

CLIMB = 22
POLISH = 500
"""Evaluations for a first climb from a start, and for the last one from the best of them."""

POOL = 8
"""How many candidates are looked at for each start."""

HEADINGS = 8
APART = 0.5
ROUNDING = 1e-9
"""Scores that are further apart than this, times their size, are compared as the kernels sum them."""

NEAREST = 0.3
FURTHEST = 1.2
"""How far from a landmark a candidate stands that looks at it, optimal distances."""


def candidate_poses(
    columns: NDArray[np.float64], region: Region, unit: float, anchors: int, *, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Poses from which some landmark is seen well: shape (s, 3), all in the region.

    Parameters
    ----------
    columns : array, shape (6, n)
        The landmarks; see `landmark_columns`.
    unit : float
        The optimal distance, metres.
    anchors : int
        How many landmarks are looked at, from HEADINGS directions each.
    """
    if not columns.shape[1]:
        return np.empty((0, 3))
    poses = np.empty((anchors * HEADINGS, 3))
    _candidates(columns, region.inset_edges, unit, rng.random((anchors, HEADINGS + 2)), poses)
    return poses


@kernel
def _candidates(
    columns: NDArray[np.float64],
    edges: NDArray[np.float64],
    unit: float,
    draws: NDArray[np.float64],
    poses: NDArray[np.float64],
) -> None:
    """Fill poses, shape (anchors HEADINGS, 3), from uniform draws, shape (anchors, HEADINGS + 2)."""
    n = columns.shape[1]
    order = np.empty(n, dtype=np.int64)
    for k in range(n):
        order[k] = k
    turn = 2.0 * math.pi / HEADINGS
    for a in range(draws.shape[0]):
        if draws.shape[0] < n:
            # the first of a shuffled deck: no landmark is looked at twice
            swap = a + int(draws[a, 0] * (n - a))
            order[a], order[swap] = order[swap], order[a]
        k = order[a % n]
        for j in range(HEADINGS):
            psi = turn * (draws[a, 1] + j)
            offset = unit * (NEAREST + (FURTHEST - NEAREST) * draws[a, 2 + j])
            i = a * HEADINGS + j
            poses[i, 0] = columns[0, k] - offset * math.cos(psi)
            poses[i, 1] = columns[1, k] - offset * math.sin(psi)
            poses[i, 2] = psi
    _into_region(poses, edges)


def into_region(poses: NDArray[np.float64], region: Region) -> NDArray[np.float64]:
    """Move the poses, shape (s, 3), that lie outside the region to its nearest points, in place."""
    _into_region(poses, region.inset_edges)
    return poses


@kernel
def _into_region(poses: NDArray[np.float64], edges: NDArray[np.float64]) -> None:
    for i in range(poses.shape[0]):
        if not contains_point(edges, poses[i, 0], poses[i, 1]):
            poses[i, 0], poses[i, 1], _, _ = nearest_on_edges(edges, poses[i, 0], poses[i, 1])


def spread(poses: NDArray[np.float64], values: NDArray[np.float64], unit: float, count: int) -> NDArray[np.int64]:
    """Indices of the best poses that are not near a better one: at most `count`."""
    order = np.arange(len(values))
    if len(values) > POOL * count:
        order = np.flatnonzero(values >= np.partition(values, -POOL * count)[-POOL * count])
    order = order[np.argsort(-values[order], kind="stable")]
    chosen = np.empty(count, dtype=np.int64)
    return chosen[: _spread(poses, order, 1.0 / unit, chosen)]


@kernel
def _spread(poses: NDArray[np.float64], order: NDArray[np.int64], inverse: float, chosen: NDArray[np.int64]) -> int:
    found = 0
    for i in order:
        near = False
        for c in range(found):
            j = chosen[c]
            turn = (poses[i, 2] - poses[j, 2]) / (2.0 * math.pi)
            turn = 2.0 * math.pi * abs(turn - math.floor(turn + 0.5))
            dx = (poses[i, 0] - poses[j, 0]) * inverse
            dy = (poses[i, 1] - poses[j, 1]) * inverse
            room = max(0.0, APART - 0.5 * turn)
            if dx * dx + dy * dy < room * room:
                near = True
                break
        if not near:
            chosen[found] = i
            found += 1
            if found == chosen.shape[0]:
                break
    return found


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

    anchors: int = 100
    starts: int = 40
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
        if not is_compiled(model):
            return blackbox.search(problem, start=start, rng=rng)
        unit = model.optimal_distance
        columns = landmark_columns(problem.landmarks, problem.thresholds)
        candidates = candidate_poses(columns, region, unit, self.anchors, rng=rng)
        if start is not None:
            candidates = np.concatenate([candidates, start.as_array()[None, :]])
        if not len(candidates):
            candidates = np.array([[*region.sample(1, rng=rng)[0], 0.0]])
        values = np.empty(len(candidates))
        pose_values(int(model.kernel), columns, 1.0 / unit, candidates, values)
        chosen = spread(candidates, values, unit, self.starts)
        if start is not None:
            chosen = np.append(chosen, len(candidates) - 1)
        starts = candidates[chosen]
        _, poses, evaluations = climb_all(
            np.array([int(model.kernel)]),
            np.array([unit]),
            columns,
            region.inset_edges,
            np.array([0, len(region.inset_edges)]),
            0.0,
            starts[:, None, :],
            CLIMB,
            self.keep,
            POLISH,
            1e-10,
        )
        pose = Pose2.from_array(poses[0])
        score = problem.score(pose)
        # the start's value is known up to rounding
        if start is not None and score - values[-1] < ROUNDING * max(1.0, score) and problem.score(start) >= score:
            pose, score = start, problem.score(start)
        return PoseResult(pose, score, evaluations=evaluations + len(candidates))
