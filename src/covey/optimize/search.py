"""`search`: a fast multi-start ascent, used at every trade."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from covey.compiled import kernel
from covey.geometry import Pose2, Region
from covey.optimize import blackbox
from covey.optimize.ascent import contains_point, nearest_on_edges, pose_value, pose_values
from covey.optimize.base import PoseProblem, PoseResult
from covey.optimize.packing import landmark_columns
from covey.optimize.pose_ascent import summit
from covey.sensing.base import is_compiled
from covey.sensing.kernels import ANISOTROPIC, best_turn

PRECISION = 1e-10
"""What three steps gain at least, where a climb goes on; see `covey.optimize.pose_ascent.climb`."""

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
    chosen = np.empty(count, dtype=np.int64)
    return chosen[: _spread(poses, values, 1.0 / unit, chosen)]


@kernel
def _spread(poses: NDArray[np.float64], values: NDArray[np.float64], inverse: float, chosen: NDArray[np.int64]) -> int:
    size = values.shape[0]
    heap = np.empty(size, dtype=np.int64)
    for i in range(size):
        heap[i] = i
    for i in range(size // 2 - 1, -1, -1):
        _sink(heap, values, i, size)
    found = 0
    least = max(0, size - POOL * chosen.shape[0])
    while size > least and found < chosen.shape[0]:
        i = heap[0]
        size -= 1
        heap[0] = heap[size]
        _sink(heap, values, 0, size)
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
    return found


@kernel
def _sink(heap: NDArray[np.int64], values: NDArray[np.float64], i: int, size: int) -> None:
    """Let the i-th of a heap of indices, that of the largest value on top, sink to its place."""
    sunk = heap[i]
    child = 2 * i + 1
    while child < size:
        if child + 1 < size and values[heap[child + 1]] > values[heap[child]]:
            child += 1
        if values[heap[child]] <= values[sunk]:
            break
        heap[i] = heap[child]
        i = child
        child = 2 * i + 1
    heap[i] = sunk


@kernel
def _score_turned(
    columns: NDArray[np.float64],
    unit: float,
    poses: NDArray[np.float64],
    values: NDArray[np.float64],
    turns: NDArray[np.float64],
) -> None:
    """Fill what each pose is worth when it turns to what it sees, at least, and the tangent of that turn."""
    x0, y0 = columns[0, 0], columns[1, 0]  # single precision reaches far enough from here, not from any origin
    landmarks = np.empty(columns.shape, dtype=np.float32)
    for k in range(columns.shape[1]):
        landmarks[0, k], landmarks[1, k] = columns[0, k] - x0, columns[1, k] - y0
        for row in range(2, columns.shape[0]):
            landmarks[row, k] = columns[row, k]
    inverse = np.float32(1.0 / unit)
    for i in range(poses.shape[0]):
        c, s = np.float32(math.cos(poses[i, 2])), np.float32(math.sin(poses[i, 2]))
        px, py = np.float32(poses[i, 0] - x0), np.float32(poses[i, 1] - y0)
        ahead, across, values[i] = best_turn(landmarks, inverse, px, py, c, s)
        turns[i] = across / ahead if ahead > 0.0 else 0.0


@kernel
def _search(
    kind: int,
    columns: NDArray[np.float64],
    unit: float,
    edges: NDArray[np.float64],
    draws: NDArray[np.float64],
    count: int,
    start: NDArray[np.float64],
    rounds: NDArray[np.int64],
    best: NDArray[np.float64],
) -> tuple[float, float, int]:
    """Climb from `count` candidates and from the starts, shape (s, 3), and fill the best pose.

    Returns its value, the best value of a start, and the evaluations.
    """
    poses = np.empty((draws.shape[0] * HEADINGS, 3))
    _candidates(columns, edges, unit, draws, poses)
    values = np.empty(poses.shape[0])
    turns = np.zeros(poses.shape[0])
    if kind == ANISOTROPIC:
        _score_turned(columns, unit, poses, values, turns)
    else:
        pose_values(kind, columns, 1.0 / unit, poses, values)
    chosen = np.empty(count, dtype=np.int64)
    found = _spread(poses, values, 1.0 / unit, chosen)
    starts = np.empty((found + start.shape[0], 3))
    for i in range(found):
        starts[i, 0], starts[i, 1] = poses[chosen[i], 0], poses[chosen[i], 1]
        starts[i, 2] = poses[chosen[i], 2] + math.atan(turns[chosen[i]])
    known = -math.inf
    for i in range(start.shape[0]):
        for j in range(3):
            starts[found + i, j] = start[i, j]
        c, s = math.cos(start[i, 2]), math.sin(start[i, 2])
        known = max(known, pose_value(kind, columns, 1.0 / unit, start[i, 0], start[i, 1], c, s))
    value, evaluations = summit(kind, columns, unit, edges, starts, rounds, PRECISION, best)
    return value, known, evaluations + poses.shape[0]


@dataclass(frozen=True)
class Search:
    """Score many poses that look at a landmark, climb from the best of them, and keep the best summit.

    Parameters
    ----------
    anchors : int
        How many landmarks the candidates look at.
    starts : int
        From how many candidates it climbs.
    rounds : tuple of (int, int)
        Evaluations a climb in each round, and how many climbs go on after it; what is left is climbed to the end.

    Notes
    -----
    O(n) an evaluation, some thousand of them.  Nothing is proved: see `Exact`.  Source: Sposato (2016), Algorithm 3.
    Deviation: V1, V4.
    """

    anchors: int = 100
    starts: int = 40
    rounds: tuple[tuple[int, int], ...] = ((8, 16), (8, 6), (14, 2))
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
        if not len(problem.landmarks):
            return PoseResult(start or Pose2.from_array([*region.sample(1, rng=rng)[0], 0.0]), 0.0)
        best = np.empty(3)
        value, known, evaluations = _search(
            int(model.kernel),
            landmark_columns(problem.landmarks, problem.thresholds),
            model.optimal_distance,
            region.inset_edges,
            rng.random((self.anchors, HEADINGS + 2)),
            self.starts,
            np.empty((0, 3)) if start is None else start.as_array()[None, :],
            np.array(self.rounds),
            best,
        )
        pose = Pose2.from_array(best)
        score = problem.score(pose)
        # the start's value is known up to rounding
        if start is not None and value - known < ROUNDING * max(1.0, score) and problem.score(start) >= score:
            pose, score = start, problem.score(start)
        return PoseResult(pose, score, evaluations=evaluations)
