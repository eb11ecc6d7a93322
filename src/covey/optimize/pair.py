"""Two agents that meet: the best two poses and the best split of the landmarks they own together.

With poses fixed the best split gives each landmark to the agent that sees it better, so the joint problem is
``max over A_1, A_2 of sum_k w_k max(vis_1(A_1, s_k), vis_2(A_2, s_k))`` over the union.  Trading first and moving
afterwards, as the thesis does, stops at configurations that this improves (pairwise-optimal partitions: Durham, Carli,
Frasca, Bullo, *Discrete partitioning and coverage control for gossiping robots*, IEEE Transactions on Robotics 28,
2012).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from covey.compiled import fast_kernel, kernel
from covey.environment import Landmarks
from covey.geometry import Pose2, Region
from covey.optimize import blackbox
from covey.optimize.ascent import climb_all, pose_values
from covey.optimize.base import PoseProblem
from covey.optimize.packing import landmark_columns
from covey.optimize.pose_ascent import POLISH
from covey.optimize.search import candidate_poses, spread
from covey.sensing.base import CompiledModel, VisibilityModel, is_compiled
from covey.sensing.kernels import visibility_gradients

CLIMB = 60
"""Evaluations for a first climb from a pair of poses: two agents have twice the coordinates of one."""

MANY = 200
LEAST_STARTS = 12
"""Above this many landmarks fewer pairs are climbed from, in proportion, but at least so many."""


@dataclass(frozen=True, eq=False)
class PairProblem:
    """Two agents and the landmarks they own together.

    Parameters
    ----------
    models, regions, poses : tuples of two
        Each agent's sensor, region and present pose.
    landmarks : Landmarks
        The union of what they own.
    spacing : float
        How far apart new positions must be, metres; 0 if they need not.
    """

    models: tuple[VisibilityModel, VisibilityModel]
    regions: tuple[Region, Region]
    poses: tuple[Pose2, Pose2]
    landmarks: Landmarks
    spacing: float = 0.0

    def apart(self, poses: tuple[Pose2, Pose2]) -> bool:
        """Whether two poses are as far apart as they must be."""
        return math.hypot(poses[1].x - poses[0].x, poses[1].y - poses[0].y) >= self.spacing

    def visibility(self, poses: tuple[Pose2, Pose2]) -> NDArray[np.float64]:
        """Visibility of each landmark from both poses, shape (2, n)."""
        return np.vstack(
            [
                model.visibility(pose.as_array()[None, :], self.landmarks)
                for model, pose in zip(self.models, poses, strict=True)
            ]
        )

    def score(self, poses: tuple[Pose2, Pose2]) -> float:
        """Return the joint score of two poses with the best split."""
        return float(self.visibility(poses).max(axis=0) @ self.landmarks.weights)


@fast_kernel
def _pair_values(
    first: NDArray[np.float32], second: NDArray[np.float32], values: NDArray[np.float32], same: bool
) -> None:
    """Joint score of every pair of candidates, shape (a, b), from their weighted visibilities, (a, n) and (b, n)."""
    for i in range(first.shape[0]):
        for j in range(i if same else 0, second.shape[0]):
            total = np.float32(0.0)
            for k in range(first.shape[1]):
                total += max(first[i, k], second[j, k])
            values[i, j] = total


@fast_kernel
def _visibility_rows(
    kind: int,
    columns: NDArray[np.float64],
    inverse: float,
    poses: NDArray[np.float64],
    scratch: NDArray[np.float64],
    rows: NDArray[np.float32],
) -> None:
    for i in range(poses.shape[0]):
        c, s = math.cos(poses[i, 2]), math.sin(poses[i, 2])
        visibility_gradients(kind, columns, inverse, poses[i, 0], poses[i, 1], c, s, scratch)
        for k in range(columns.shape[1]):
            rows[i, k] = columns[4, k] * max(0.0, scratch[0, k])


@dataclass(frozen=True)
class PairSearch:
    """Score all pairs of a set of candidate poses, climb with both agents at once from the best pairs.

    Parameters
    ----------
    anchors : int
        How many landmarks the candidates look at.
    candidates : int
        How many candidates an agent has.
    starts : int
        From how many pairs it climbs, the present poses among them.
    keep : int
        How many of those are climbed to the end.

    Notes
    -----
    O(candidates^2 n + evaluations n).
    """

    anchors: int = 64
    candidates: int = 128
    starts: int = 40
    keep: int = 8

    def maximize(self, problem: PairProblem, *, rng: np.random.Generator) -> tuple[tuple[Pose2, Pose2], float]:
        """Return two poses and their joint score, which is never below that of the present poses."""
        models = problem.models
        present = problem.score(problem.poses)
        if not len(problem.landmarks):
            return problem.poses, present
        if not (is_compiled(models[0]) and is_compiled(models[1])):
            return _alternate(problem, present, rng=rng)
        columns = landmark_columns(problem.landmarks)
        pools = [self._pool(models[0], problem.regions[0], problem.landmarks, columns, rng)]
        same = models[0] == models[1] and problem.regions[0] is problem.regions[1]
        pools.append(pools[0] if same else self._pool(models[1], problem.regions[1], problem.landmarks, columns, rng))
        (first, first_rows), (second, second_rows) = pools
        values = np.full((len(first), len(second)), -np.inf, dtype=np.float32)
        _pair_values(first_rows, second_rows, values, same)
        unit = min(models[0].optimal_distance, models[1].optimal_distance)
        count = max(LEAST_STARTS, min(self.starts, self.starts * MANY // len(problem.landmarks)))
        pairs = _spread_pairs(first, second, values, unit, count - 1)
        starts = np.empty((len(pairs) + 1, 2, 3))
        starts[0, 0], starts[0, 1] = problem.poses[0].as_array(), problem.poses[1].as_array()
        for row, (i, j) in enumerate(pairs, start=1):
            starts[row, 0], starts[row, 1] = first[i], second[j]
        edges = [region.inset_edges for region in problem.regions]
        _, found, _ = climb_all(
            np.array([int(models[0].kernel), int(models[1].kernel)]),
            np.array([models[0].optimal_distance, models[1].optimal_distance]),
            columns,
            np.vstack(edges),
            np.array([0, len(edges[0]), len(edges[0]) + len(edges[1])]),
            problem.spacing,
            starts,
            CLIMB,
            max(1, self.keep * count // self.starts),
            POLISH,
            1e-8,
        )
        poses = (Pose2.from_array(found[0]), Pose2.from_array(found[1]))
        if same and problem.spacing > 0.0:
            poses = _nearer(problem.poses, poses)
        score = problem.score(poses)
        return (poses, score) if score > present and problem.apart(poses) else (problem.poses, present)

    def _pool(
        self,
        model: CompiledModel,
        region: Region,
        landmarks: Landmarks,
        columns: NDArray[np.float64],
        rng: np.random.Generator,
    ) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
        """Candidate poses, shape (c, 3), and how well they see the landmarks, shape (c, n)."""
        unit = model.optimal_distance
        poses = candidate_poses(columns, region, unit, self.anchors, rng=rng)
        values = np.empty(len(poses))
        pose_values(int(model.kernel), columns, 1.0 / unit, poses, values)
        chosen = poses[spread(poses, values, unit, self.candidates)]
        rows = np.empty((len(chosen), len(landmarks)), dtype=np.float32)
        _visibility_rows(int(model.kernel), columns, 1.0 / unit, chosen, np.empty((4, len(landmarks))), rows)
        return chosen, rows


def _nearer(present: tuple[Pose2, Pose2], poses: tuple[Pose2, Pose2]) -> tuple[Pose2, Pose2]:
    """Give each of two agents that are alike the pose that makes their ways shorter, so that they cross less often."""

    def way(first: Pose2, second: Pose2) -> float:
        (a, b) = present
        return math.hypot(first.x - a.x, first.y - a.y) + math.hypot(second.x - b.x, second.y - b.y)

    return poses if way(*poses) <= way(*poses[::-1]) else (poses[1], poses[0])


def _spread_pairs(
    first: NDArray[np.float64],
    second: NDArray[np.float64],
    values: NDArray[np.float32],
    unit: float,
    count: int,
) -> NDArray[np.int64]:
    """Return the best pairs, shape (c, 2), each of which differs from every better one."""
    flat = values.ravel()
    pool = min(len(flat), 30 * count)
    order = np.argpartition(-flat, pool - 1)[:pool]
    order = order[np.argsort(-flat[order], kind="stable")]
    order = order[np.isfinite(flat[order])]
    chosen = np.empty((count, 2), dtype=np.int64)
    return chosen[: _choose_pairs(first, second, order, unit, chosen)]


@kernel
def _choose_pairs(
    first: NDArray[np.float64],
    second: NDArray[np.float64],
    order: NDArray[np.int64],
    unit: float,
    chosen: NDArray[np.int64],
) -> int:
    found = 0
    for index in order:
        i = index // second.shape[0]
        j = index % second.shape[0]
        near = False
        for c in range(found):
            a, b = chosen[c, 0], chosen[c, 1]
            away = math.hypot(first[i, 0] - first[a, 0], first[i, 1] - first[a, 1])
            away += math.hypot(second[j, 0] - second[b, 0], second[j, 1] - second[b, 1])
            if away < unit:
                near = True
                break
        if not near:
            chosen[found, 0] = i
            chosen[found, 1] = j
            found += 1
            if found == chosen.shape[0]:
                break
    return found


def _alternate(problem: PairProblem, present: float, *, rng: np.random.Generator) -> tuple[tuple[Pose2, Pose2], float]:
    """Each agent in turn plays its best response to the other, for models without compiled gradients."""
    best, best_score = problem.poses, present
    for leader in (0, 1):
        poses = list(problem.poses)
        score = -math.inf
        for turn in range(12):
            i = (leader + turn) % 2
            other = problem.models[1 - i].visibility(poses[1 - i].as_array()[None, :], problem.landmarks)[0]
            region: Region | None = problem.regions[i]
            if problem.spacing > 0.0:
                region = problem.regions[i].without_discs(poses[1 - i].position_W, problem.spacing)
            if region is None:
                break
            response = blackbox.search(
                PoseProblem(problem.models[i], problem.landmarks, region, other), start=poses[i], rng=rng
            )
            poses[i] = response.pose
            improved = problem.score((poses[0], poses[1]))
            gained, score = improved - score, improved
            if turn and gained <= 1e-9:
                break
        if score > best_score:
            best, best_score = (poses[0], poses[1]), score
    return best, best_score
