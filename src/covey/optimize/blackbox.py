"""Pose problems for models of which only values and Lipschitz constants are known: a user's own.

Slower than the compiled models, and the same promises: `search` never returns less than its start, `prove` returns an
upper bound that holds as long as the model's `maximum` and `lipschitz` are true (it raises where they are seen not to
be).
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from covey.errors import SolverError
from covey.geometry import Pose2
from covey.optimize.base import PoseProblem, PoseResult, Status

STARTS = 24
BATCH = 256
ROUNDS = 1000
"""Steps of the compass search at most: where the boundary cuts off most directions its steps shrink slowly."""


def values(problem: PoseProblem, poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Objective at poses, shape (s, 3): shape (s,)."""
    visibility = problem.model.visibility(poses, problem.landmarks)
    if problem.thresholds is not None:
        visibility = np.maximum(0.0, visibility - problem.thresholds)
    return visibility @ problem.landmarks.weights


def search(problem: PoseProblem, *, start: Pose2 | None, rng: np.random.Generator) -> PoseResult:
    """Compass search from the best of many random poses, some of them near a landmark, all starts at once."""
    region, landmarks = problem.region, problem.landmarks
    x0, x1, y0, y1 = region.bounds
    size = max(x1 - x0, y1 - y0)
    poses = np.column_stack([region.sample(512, rng=rng), rng.uniform(-math.pi, math.pi, 512)])
    near = _near_landmarks(problem, 512, rng=rng)
    poses = np.vstack([poses, near[region.contains_points(near[:, :2])]])
    if start is not None:
        poses = np.vstack([poses, start.as_array()])
    scores = values(problem, poses)
    least = 1e-13 * float(landmarks.weights.sum()) * problem.model.maximum
    evaluations = len(poses)
    chosen = np.argsort(-scores, kind="stable")[:STARTS]
    if start is not None:
        chosen = np.append(chosen, len(poses) - 1)
    poses, scores = poses[chosen], scores[chosen]
    reach = np.full(len(poses), 1.0 / 16.0)
    for _ in range(ROUNDS):
        if not (reach > 1e-9).any():
            break
        turns = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        moves = np.vstack([turns, -turns]) * np.array([size, size, math.pi])
        trials = poses[:, None, :] + reach[:, None, None] * moves[None, :, :]
        flat = trials.reshape(-1, 3)
        trial_scores = values(problem, flat)
        trial_scores[~region.contains_points(flat[:, :2])] = -math.inf
        evaluations += len(flat)
        trial_scores = trial_scores.reshape(len(poses), -1)
        best = trial_scores.argmax(axis=1)
        rows = np.arange(len(poses))
        better = trial_scores[rows, best] > scores + least
        poses[better] = trials[rows, best][better]
        scores[better] = trial_scores[rows, best][better]
        reach = np.where(better, np.minimum(2.0 * reach, 0.125), 0.5 * reach)
        if len(poses) > 4 and reach.min() < 1e-3:
            kept = np.argsort(-scores, kind="stable")[: max(4, len(poses) // 2)]
            poses, scores, reach = poses[kept], scores[kept], reach[kept]
    pose = Pose2.from_array(poses[scores.argmax()])
    score = problem.score(pose)
    if start is not None and problem.score(start) >= score:
        pose, score = start, problem.score(start)
    return PoseResult(pose, score, evaluations=evaluations)


def _near_landmarks(problem: PoseProblem, count: int, *, rng: np.random.Generator) -> NDArray[np.float64]:
    """Poses around landmarks, looking at them or elsewhere, inside the region or not: shape (count, 3)."""
    points = problem.landmarks.positions_W
    per_metre = problem.model.lipschitz[0]
    if not len(points) or per_metre <= 0.0:
        return np.empty((0, 3))
    # nothing is seen from further away unless the visibility falls more slowly than it may
    away = 2.0 * problem.model.maximum / per_metre * rng.random(count)
    bearing = rng.uniform(-math.pi, math.pi, count)
    aside = np.where(rng.random(count) < 0.5, 0.0, rng.uniform(-math.pi, math.pi, count))
    centre = points[rng.integers(0, len(points), count)]
    x, y = centre[:, 0] - away * np.cos(bearing), centre[:, 1] - away * np.sin(bearing)
    return np.column_stack([x, y, bearing + aside])


def prove(
    problem: PoseProblem,
    known: PoseResult,
    *,
    tolerance: float,
    limit: int,
    cancelled: Callable[[], bool] | None = None,
) -> PoseResult:
    """Best-first branch and bound on ``vis(A') <= min(maximum, vis(A) + L_p |p' - p| + L_psi |psi' - psi|)``.

    The number of boxes grows like a power of 1/tolerance, so it stops after `limit` / 10 boxes with the bound it has.

    Raises
    ------
    SolverError
        If a pose scores more than the bound over all poses: then `maximum` or `lipschitz` is not true.
    """
    region, model, landmarks = problem.region, problem.model, problem.landmarks
    x0, x1, y0, y1 = region.bounds
    thresholds = np.zeros(len(landmarks)) if problem.thresholds is None else problem.thresholds
    per_metre, per_radian = model.lipschitz
    best, pose = known.score, known.pose
    root = (0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.0, 0.5 * (x1 - x0), 0.5 * (y1 - y0), math.pi)
    everything = float(np.maximum(0.0, model.maximum - thresholds) @ landmarks.weights)
    heap: list[tuple[float, tuple[float, ...]]] = [(-everything, root)]
    closed, evaluations = -math.inf, known.evaluations
    rounding = 1e-13 * len(landmarks) * (1.0 + everything)
    while heap and -heap[0][0] > best + tolerance and evaluations < limit / 10:
        if cancelled is not None and cancelled():
            break
        parents = np.array([heapq.heappop(heap)[1] for _ in range(min(BATCH, len(heap)))])
        reach = parents[:, 3:] * np.array([per_metre, per_metre, per_radian])
        rows, axis = np.arange(len(parents)), reach.argmax(axis=1)
        boxes = np.concatenate([parents, parents])
        half = parents[rows, 3 + axis] / 2.0
        for side, sign in ((0, -1.0), (len(parents), 1.0)):
            boxes[side + rows, 3 + axis] = half
            boxes[side + rows, axis] += sign * half
        radius = np.hypot(boxes[:, 3], boxes[:, 4])
        kept = np.array([_touches(problem, box, r) for box, r in zip(boxes, radius, strict=True)])
        boxes, radius = boxes[kept], radius[kept]
        if not len(boxes):
            continue
        visibility = model.visibility(boxes[:, :3], landmarks)
        slack = per_metre * radius + per_radian * boxes[:, 5]
        upper = np.minimum(model.maximum, visibility + slack[:, None])
        bounds = np.maximum(0.0, upper - thresholds) @ landmarks.weights + rounding
        scores = np.maximum(0.0, visibility - thresholds) @ landmarks.weights
        scores[~region.contains_points(boxes[:, :2])] = -math.inf
        evaluations += len(boxes)
        top = int(scores.argmax())
        if scores[top] > best:
            best, pose = float(scores[top]), Pose2.from_array(boxes[top, :3])
        for bound, box in zip(bounds, boxes, strict=True):
            if bound > best + tolerance:
                heapq.heappush(heap, (-float(bound), tuple(box)))
            else:
                closed = max(closed, float(bound))
    score = problem.score(pose)
    upper_bound = max(closed, -heap[0][0] if heap else -math.inf)
    # regions hold their points to a micrometre
    slack = 1e-9 * (1.0 + everything) + 2e-6 * per_metre * float(landmarks.weights.sum())
    if score > min(upper_bound, everything) + slack:
        raise SolverError(
            f"sensor model {model.name!r}: a pose scores {score:.9g}, but by its maximum and its lipschitz no pose can "
            f"score more than {min(upper_bound, everything):.9g}: they are too low"
        )
    upper_bound = max(score, upper_bound)
    proved = upper_bound <= score + tolerance * (1.0 + 1e-9)
    return PoseResult(pose, score, upper_bound, Status.PROVED if proved else Status.BUDGET, evaluations)


def _touches(problem: PoseProblem, box: NDArray[np.float64], radius: float) -> bool:
    """Whether the box may hold a position of the region."""
    x, y = problem.region.project(float(box[0]), float(box[1]))
    return math.hypot(x - box[0], y - box[1]) <= radius + 1e-6
