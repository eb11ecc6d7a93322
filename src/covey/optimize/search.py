"""`search`: a fast multi-start ascent, used at every trade."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from covey.compiled import kernel
from covey.environment import Landmarks
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
OFFSETS = (0.3, 1.2)
"""How far from a landmark a candidate stands that looks at it, optimal distances."""


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
    if not n:
        return np.empty((0, 3))
    chosen = np.resize(np.arange(n), anchors) if n <= anchors else rng.choice(n, anchors, replace=False)
    turn = 2.0 * math.pi / HEADINGS
    psi = turn * np.arange(HEADINGS)[None, :] + rng.uniform(0.0, turn, (len(chosen), 1))
    points = landmarks.positions_W[chosen]
    poses = np.empty((len(chosen), HEADINGS, 3))
    offset = unit * rng.uniform(*OFFSETS, psi.shape)
    poses[:, :, 0] = points[:, 0:1] - offset * np.cos(psi)
    poses[:, :, 1] = points[:, 1:2] - offset * np.sin(psi)
    poses[:, :, 2] = psi
    return into_region(poses.reshape(-1, 3), region)


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
        order = np.sort(np.argpartition(-values, POOL * count)[: POOL * count])
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
            turn = abs(poses[i, 2] - poses[j, 2]) % (2.0 * math.pi)
            turn = min(turn, 2.0 * math.pi - turn)
            away = math.hypot(poses[i, 0] - poses[j, 0], poses[i, 1] - poses[j, 1]) * inverse
            if away + 0.5 * turn < APART:
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
