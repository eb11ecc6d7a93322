"""What every pose optimiser must do, as checks that raise AssertionError."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from covey.environment import Landmarks
from covey.geometry import Pose2, Region
from covey.optimize import PoseOptimizer, PoseProblem, PoseResult, Status
from covey.sensing import Anisotropic, VisibilityModel

ROUNDING = 1e-9
"""Scores of two ways to compute the same are compared up to this, times their size."""

REGIONS: dict[str, Callable[[], Region]] = {
    "box": lambda: Region.box(-5.0, 5.0, -5.0, 5.0),
    "hole": lambda: Region.polygon(
        [[-4.0, -4.0], [4.0, -4.0], [4.0, 4.0], [-4.0, 4.0]], [[[-3.0, -2.0], [2.0, -3.0], [3.0, 2.0], [-2.0, 3.0]]]
    ),
    "non-convex": lambda: Region.polygon([[-4.0, -4.0], [4.0, -3.0], [-2.0, -2.0], [4.0, 4.0], [-3.0, 1.0]]),
    "slanted": lambda: Region.polygon([[0.1, -3.3], [3.7, 0.3], [-0.9, 2.9]]),
    "sliver": lambda: Region.polygon([[-4.0, -1.0], [4.0, 1.0], [4.0, 1.0 + 1e-4], [-4.0, -1.0 + 1e-4]]),
    "pinhole": lambda: Region.box(1.0, 1.0 + 1e-5, 2.0, 2.0 + 1e-5),
}
"""Regions to solve problems in, some of them hard to stay in."""


def check_pose_optimizer(
    optimizer: PoseOptimizer, model: VisibilityModel | None = None, *, seed: int = 0, tolerance: float = 1e-2
) -> None:
    """Run every check of the suite on a pose optimiser.

    Parameters
    ----------
    optimizer : PoseOptimizer
    model : VisibilityModel, optional
        Whose poses to optimise; the thesis's camera by default.  Somewhere it must reach its `maximum`.
    seed : int
        Root of all random numbers.
    tolerance : float
        What the optimiser is asked for.

    Raises
    ------
    AssertionError
        If a check fails; the text says which and how.

    Examples
    --------
    >>> from covey.optimize import Search
    >>> check_pose_optimizer(Search())
    """
    model = Anisotropic() if model is None else model
    for number, (label, problem, start) in enumerate(sample_problems(model, rng=np.random.default_rng([seed, 1]))):
        try:
            check_problem(optimizer, problem, start, seed=seed + number, tolerance=tolerance)
        except AssertionError as error:
            raise AssertionError(f"{label}: {error}") from error
    check_one_landmark(optimizer, model, seed=seed, tolerance=tolerance)


def check_problem(
    optimizer: PoseOptimizer, problem: PoseProblem, start: Pose2 | None, *, seed: int, tolerance: float
) -> PoseResult:
    """Solve a problem, check the answer, and that the same seed gives it again."""
    result = optimizer.maximize(problem, start=start, tolerance=tolerance, rng=np.random.default_rng(seed))
    check_pose_result(problem, result, tolerance=tolerance, rng=np.random.default_rng([seed, 2]))
    if start is not None:
        before = problem.score(start)
        _require(result.score >= before, f"score: expected no less than the start's {before}, got {result.score}")
    again = optimizer.maximize(problem, start=start, tolerance=tolerance, rng=np.random.default_rng(seed))
    _require(again == result, f"the same seed must give the same answer, got {result} and {again}")
    return result


def check_pose_result(
    problem: PoseProblem,
    result: PoseResult,
    *,
    tolerance: float,
    rng: np.random.Generator,
    samples: int = 2000,
    rounding: float = ROUNDING,
) -> None:
    """Check an answer to a pose problem against the problem alone.

    The score is that of the pose, the pose lies in the region, the status says what the bound is worth, and no pose
    that sampling and refining finds scores above the bound.

    Parameters
    ----------
    problem : PoseProblem
    result : PoseResult
    tolerance : float
        The gap that was asked for.
    rng : numpy.random.Generator
    samples : int
        How many poses to try.
    rounding : float
        Relative error allowed to the computation of scores; larger where coordinates are large.

    Raises
    ------
    AssertionError
        If something is not as it should be.
    """
    import shapely

    score = problem.score(result.pose)
    _require(result.score == score, f"score: the pose gives {score}, the result says {result.score}")
    point = shapely.Point(result.pose.x, result.pose.y)
    _require(bool(problem.region.shape.covers(point)), f"pose: {result.pose} is outside the region")
    slack = rounding * max(1.0, abs(score))
    _require(result.upper_bound >= score, f"upper_bound: {result.upper_bound} is below the score {score}")
    if result.status is Status.PROVED:
        _require(result.gap <= tolerance + slack, f"status: proved, but the gap is {result.gap} and not {tolerance}")
    elif result.status is Status.LOCAL:
        _require(result.upper_bound == math.inf, f"upper_bound: nothing is proved, yet it is {result.upper_bound}")
    if result.upper_bound < math.inf:
        found, pose = best_sample(problem, result.pose, samples, rng=rng)
        text = f"upper_bound: {result.upper_bound} is claimed, but {Pose2.from_array(pose)} scores {found}"
        _require(found <= result.upper_bound + slack, text)


def best_sample(
    problem: PoseProblem, near: Pose2, samples: int, *, rng: np.random.Generator
) -> tuple[float, NDArray[np.float64]]:
    """Return the best (value, pose) among poses of the region: spread out, at landmarks, near one, and refined."""
    landmarks, region = problem.landmarks, problem.region
    model = problem.model
    unit = model.maximum / model.lipschitz[0] if model.lipschitz[0] > 0.0 else 1.0
    spread = np.column_stack([region.sample(samples // 4, rng=rng), rng.uniform(-math.pi, math.pi, samples // 4)])
    groups = [spread, near.as_array() + unit * _scaled(samples // 4, rng)]
    if len(landmarks):
        count = samples // 2
        heading = rng.uniform(-math.pi, math.pi, count)
        away = unit * rng.uniform(0.0, 2.0, count)
        back = away[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])
        places = landmarks.positions_W[rng.integers(0, len(landmarks), count)] - back
        groups.append(np.column_stack([places, heading + rng.normal(0.0, 0.3, count)]))
    poses = np.vstack(groups)
    poses = np.vstack([poses[_inside(region, poses)], near.as_array()[None]])
    scores = pose_scores(problem, poses)
    chosen = np.argsort(-scores)[:8]
    poses, scores = poses[chosen], scores[chosen]
    size = 0.3
    while size > 1e-7:
        steps = _scaled(16, rng, size) * np.array([unit, unit, 1.0])
        trials = (poses[:, None, :] + steps[None, :, :]).reshape(-1, 3)
        values = np.where(_inside(region, trials), pose_scores(problem, trials), -math.inf).reshape(len(poses), -1)
        best = values.argmax(axis=1)
        rows = np.arange(len(poses))
        better = values[rows, best] > scores
        poses[better] = trials.reshape(len(poses), -1, 3)[rows, best][better]
        scores[better] = values[rows, best][better]
        if better.sum() * 2 < len(better):
            size *= 0.6
    return float(scores.max()), poses[scores.argmax()]


def pose_scores(problem: PoseProblem, poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Objective at poses, shape (s, 3), computed by the model alone: shape (s,)."""
    thresholds = np.zeros(len(problem.landmarks)) if problem.thresholds is None else problem.thresholds
    parts = np.array_split(poses, 1 + len(poses) * len(problem.landmarks) // 2_000_000)
    gains = [np.maximum(0.0, problem.model.visibility(part, problem.landmarks) - thresholds) for part in parts]
    values: NDArray[np.float64] = np.concatenate([gain @ problem.landmarks.weights for gain in gains])
    return values


def sample_problems(
    model: VisibilityModel, *, rng: np.random.Generator
) -> Iterator[tuple[str, PoseProblem, Pose2 | None]]:
    """Yield (what is special, problem, start or None)."""
    usual = REGIONS["box"]()

    def problem(
        landmarks: Landmarks, region: Region = usual, thresholds: NDArray[np.float64] | None = None
    ) -> PoseProblem:
        return PoseProblem(model, landmarks, region, thresholds)

    for name, make in REGIONS.items():
        region = make()
        landmarks = _landmarks(rng.uniform(-4.0, 4.0, (12, 2)), rng)
        start = Pose2.from_array([*region.sample(1, rng=rng)[0], rng.uniform(-math.pi, math.pi)])
        yield f"region: {name}", problem(landmarks, region), start
    scattered = _landmarks(rng.uniform(-4.0, 4.0, (12, 2)), rng, weights=rng.uniform(0.0, 3.0, 12))
    corner = Pose2.from_array([*usual.exterior[0], 1.0])
    yield "weights, start at a corner of the region", problem(scattered), corner
    yield "no start", problem(scattered), None
    yield "thresholds", problem(scattered, thresholds=rng.uniform(0.0, 1.0, 12)), corner
    yield "thresholds that nothing exceeds", problem(scattered, thresholds=np.full(12, model.maximum)), corner
    empty = Landmarks(np.empty((0, 2)), normals_W=np.empty((0, 2)))
    yield "no landmarks", problem(empty), corner
    yield "no landmarks, no start", problem(empty), None
    yield "weights of zero", problem(_landmarks(scattered.positions_W, rng, weights=np.zeros(12))), corner
    yield "all landmarks in one point", problem(_landmarks(np.full((9, 2), 0.7), rng)), corner
    yield "each landmark twice", problem(_landmarks(np.repeat(scattered.positions_W[:6], 2, axis=0), rng)), corner
    yield "landmarks far outside the region", problem(_landmarks(scattered.positions_W + 300.0, rng)), corner
    yield "landmarks in a row along the boundary", problem(_landmarks(_row(), rng)), None
    # a start that cannot be improved
    yield "a landmark seen best already", problem(_landmarks(np.zeros((1, 2)), rng)), Pose2(-1.0, 0.0, 0.0)


def check_one_landmark(optimizer: PoseOptimizer, model: VisibilityModel, *, seed: int, tolerance: float) -> None:
    """A single landmark in the open can be seen as well as anything ever is."""
    landmarks = _landmarks(np.array([[0.3, -0.2]]), np.random.default_rng(seed), weights=np.array([2.0]))
    reach = 3.0 * model.maximum / max(model.lipschitz[0], 1e-9)
    problem = PoseProblem(model, landmarks, Region.box(-reach, reach, -reach, reach))
    result = check_problem(optimizer, problem, None, seed=seed, tolerance=tolerance)
    best = 2.0 * model.maximum
    _require(result.score <= best * (1.0 + 1e-12), f"one landmark: {result.score} is more than {best}, all there is")
    _require(result.score >= 0.99 * best, f"one landmark: expected about {best}, got {result.score}")


def _landmarks(
    positions: NDArray[np.float64], rng: np.random.Generator, weights: NDArray[np.float64] | None = None
) -> Landmarks:
    bearing = rng.uniform(-math.pi, math.pi, len(positions))
    normals = np.column_stack([np.cos(bearing), np.sin(bearing)])
    return Landmarks(positions, np.ones(len(positions)) if weights is None else weights, normals)


def _row() -> NDArray[np.float64]:
    return np.column_stack([np.full(10, 5.0), np.linspace(-4.5, 4.5, 10)])


def _scaled(count: int, rng: np.random.Generator, largest: float = 1.0) -> NDArray[np.float64]:
    """Steps of many sizes, shape (count, 3)."""
    return rng.normal(size=(count, 3)) * largest * 10.0 ** rng.uniform(-3.0, 0.0, (count, 1))


def _inside(region: Region, poses: NDArray[np.float64]) -> NDArray[np.bool_]:
    import shapely

    inside: NDArray[np.bool_] = shapely.covers(region.shape, shapely.points(poses[:, :2]))
    return inside


def _require(holds: bool, text: str) -> None:
    if not holds:
        raise AssertionError(text)


__all__ = ["check_pose_optimizer", "check_pose_result"]
