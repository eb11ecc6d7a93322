"""An upper bound on the score of any deployment of a team.

Each landmark has one owner.  With a price mu_k >= 0 a landmark,

    score <= sum_k w_k mu_k + sum_i max over A in SE(2)_Omega_i of sum_k w_k max(0, vis_i(A, s_k) - mu_k)

whatever the prices are, because the owner i of landmark k adds ``w_k vis_i = w_k mu_k + w_k (vis_i - mu_k)`` at most.
The inner maximum is a pose problem with thresholds mu, which `exact` bounds over all poses, not over a grid.  Good
prices minimise the right side over a growing pool of poses, smoothed so that a quasi-Newton method works on it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from covey.compiled import fast_kernel
from covey.coverage import TeamBound
from covey.environment import Landmarks
from covey.errors import SolverError
from covey.geometry import Pose2, Region
from covey.optimize.ascent import pose_values
from covey.optimize.base import PoseProblem
from covey.optimize.branch_and_bound import Exact
from covey.optimize.packing import landmark_columns
from covey.optimize.pose_ascent import summit
from covey.optimize.search import candidate_poses, spread
from covey.sensing.base import CompiledModel, VisibilityModel, is_compiled

ROUNDS = 60
STEPS = 100
SUMMITS = 64
CLIMBS = np.array([[22, 8]])
"""How many poses of the pool are climbed from in a round, with how many evaluations, and how many to the end."""

TEMPERATURES = (0.3, 0.1, 0.03, 0.01)
"""Smoothing of the inner maximum, in hundredths of the score."""
POOL_ENTRIES = 1_000_000
"""Poses times landmarks in the first pool, about."""
PROOFS = 12
PROOF_BOXES = 4_000_000


@dataclass(eq=False)
class _Group:
    """Agents of one sensor and one region: their inner problems are the same."""

    model: CompiledModel
    region: Region
    count: int
    poses: NDArray[np.float64]  # the pool, shape (p, 3)
    visibility: NDArray[np.float64]  # of each landmark from each pose of the pool, shape (p, n)

    def add(self, poses: NDArray[np.float64], landmarks: Landmarks) -> None:
        self.poses = np.vstack([self.poses, poses])
        self.visibility = np.vstack([self.visibility, self.model.visibility(poses, landmarks)])


@fast_kernel
def _smoothed_maximum(
    visibility: NDArray[np.float64],
    weights: NDArray[np.float64],
    prices: NDArray[np.float64],
    temperature: float,
    values: NDArray[np.float64],
    gradient: NDArray[np.float64],
) -> float:
    """Return ``T log sum_A exp(f_A / T)``, f_A the inner objective of pool pose A, and fill its negative gradient."""
    top = 0.0
    for i in range(visibility.shape[0]):
        total = 0.0
        for k in range(visibility.shape[1]):
            total += weights[k] * max(0.0, visibility[i, k] - prices[k])
        values[i] = total
        top = max(top, total)
    norm = 0.0
    for i in range(visibility.shape[0]):
        values[i] = np.exp((values[i] - top) / temperature)
        norm += values[i]
    for k in range(visibility.shape[1]):
        gradient[k] = 0.0
    for i in range(visibility.shape[0]):
        share = values[i] / norm
        if share > 1e-9:
            for k in range(visibility.shape[1]):
                gradient[k] += share * weights[k] if visibility[i, k] > prices[k] else 0.0
    return top + temperature * math.log(norm)


def require_built_in(models: Sequence[VisibilityModel]) -> list[CompiledModel]:
    """Return the models if each is a built-in one, and raise SolverError otherwise."""
    compiled = [model for model in models if is_compiled(model)]
    if len(compiled) < len(models):
        raise SolverError("team bound: only the built-in sensor models can be bounded; leave out --bound")
    return compiled


def team_bound(
    models: Sequence[VisibilityModel],
    regions: Sequence[Region],
    poses: Sequence[Pose2],
    landmarks: Landmarks,
    score: float,
    *,
    rng: np.random.Generator,
    accuracy: float = 5e-4,
    on_progress: Callable[[float, float], None] | None = None,
) -> TeamBound:
    """Bound the score of every deployment of a team.

    Parameters
    ----------
    models, regions : sequences
        Each agent's.
    poses : sequence of Pose2
        A good deployment, to start from.
    landmarks : Landmarks
    score : float
        Score of that deployment.
    rng : numpy.random.Generator
    accuracy : float
        How much of the score may be left to the proofs of the inner problems.
    on_progress : callable, optional
        Called with (fraction done, best bound so far).

    Raises
    ------
    SolverError
        If a sensor is not a built-in model: its inner problems take too long to bound; or if the score is above the
        bound, so that it cannot be that of a deployment of this team.

    Notes
    -----
    Each round costs some hundred sums over pool times landmarks; the proof at the end one `exact` for each kind of
    agent, with the many poses of nearly equal value that good prices leave.
    """
    compiled = require_built_in(models)
    weights = landmarks.weights
    if not weights.any():
        return TeamBound(0.0, 0.0)
    groups = _groups(compiled, regions, poses, landmarks, rng)
    visible = np.vstack([m.visibility(p.as_array()[None], landmarks) for m, p in zip(compiled, poses, strict=True)])
    prices = 0.7 * visible.max(axis=0)
    bound, unchanged, proofs = float(weights.sum() * max(model.maximum for model in compiled)), 0, 0
    scale = max(score, 1e-3 * bound)
    tolerance = accuracy * scale
    lowest, step = np.inf, 0

    def alive() -> bool:
        """Let the caller speak up during a long proof."""
        if on_progress is not None:
            on_progress(step / ROUNDS, bound)
        return False

    for step in range(ROUNDS):
        for temperature in TEMPERATURES if step == 0 else TEMPERATURES[-1:]:
            prices = _minimise(groups, weights, prices, temperature * scale / 100.0)
        value = pooled = float(weights @ prices)
        for group in groups:
            pooled += group.count * float(_gains(group, weights, prices).max())
            value += group.count * _climb(group, landmarks, prices, rng)
        unchanged = 0 if value < lowest - 0.2 * tolerance else unchanged + 1
        lowest = min(lowest, value)
        if value - pooled < tolerance or unchanged >= 4:
            proved = float(weights @ prices)
            for group in groups:
                proved += group.count * _prove(group, landmarks, prices, tolerance / len(models), rng, alive)
            bound = min(bound, proved)
            proofs += 1
            unchanged = 0
            if proved - pooled < 2.0 * tolerance or proofs == PROOFS:
                break
        if on_progress is not None:
            on_progress((step + 1) / ROUNDS, bound)
    if score > bound * (1.0 + 1e-9):
        raise SolverError(f"team bound: the score {score:.6f} exceeds what any deployment can have, {bound:.6f}")
    bound = max(bound, score)
    return TeamBound(bound, (bound - score) / bound if bound > 0.0 else 0.0)


def _prove(
    group: _Group,
    landmarks: Landmarks,
    prices: NDArray[np.float64],
    tolerance: float,
    rng: np.random.Generator,
    cancelled: Callable[[], bool],
) -> float:
    """Bound the inner problem over all poses; the best pose found joins the pool."""
    problem = PoseProblem(group.model, landmarks, group.region, prices)
    start = Pose2.from_array(group.poses[_gains(group, landmarks.weights, prices).argmax()])
    proof = Exact(limit=PROOF_BOXES, cancelled=cancelled).maximize(problem, start=start, tolerance=tolerance, rng=rng)
    group.add(proof.pose.as_array()[None], landmarks)
    return proof.upper_bound


def _groups(
    models: Sequence[CompiledModel],
    regions: Sequence[Region],
    poses: Sequence[Pose2],
    landmarks: Landmarks,
    rng: np.random.Generator,
) -> list[_Group]:
    groups: list[_Group] = []
    for model, region in zip(models, regions, strict=True):
        for group in groups:
            if group.model == model and np.array_equal(group.region.edges, region.edges):
                group.count += 1
                break
        else:
            groups.append(_Group(model, region, 1, np.zeros((0, 3)), np.zeros((0, len(landmarks)))))
    own = np.array([pose.as_array() for pose in poses])
    size = min(2500, max(200, POOL_ENTRIES // len(landmarks)) // len(groups))
    columns = landmark_columns(landmarks)
    for group in groups:
        anchors = candidate_poses(columns, group.region, group.model.optimal_distance, max(1, size // 8), rng=rng)
        inside = group.region.contains_points(own[:, :2])
        group.add(np.vstack([own[inside], anchors]), landmarks)
    return groups


def _gains(group: _Group, weights: NDArray[np.float64], prices: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.maximum(0.0, group.visibility - prices) @ weights


def _climb(group: _Group, landmarks: Landmarks, prices: NDArray[np.float64], rng: np.random.Generator) -> float:
    """Climb from the most promising poses, add the summits to the pool, and return the highest value."""
    model, region = group.model, group.region
    unit, kind = model.optimal_distance, int(model.kernel)
    columns = landmark_columns(landmarks, prices)
    fresh = candidate_poses(columns, region, unit, 128, rng=rng)
    candidates = np.vstack([group.poses, fresh])
    values = np.empty(len(candidates))
    pose_values(kind, columns, 1.0 / unit, candidates, values)
    starts, top = candidates[spread(candidates, values, unit, SUMMITS)], np.empty(3)
    value, _ = summit(kind, columns, unit, region.inset_edges, starts, CLIMBS, 1e-9, top)
    group.add(np.vstack([starts, top]), landmarks)
    most = max(1000, 4 * POOL_ENTRIES // len(landmarks))
    if len(group.poses) > most:
        kept = np.sort(np.argsort(-_gains(group, landmarks.weights, prices), kind="stable")[: most // 2])
        group.poses, group.visibility = group.poses[kept], group.visibility[kept]
    return float(value)


def _minimise(
    groups: Sequence[_Group], weights: NDArray[np.float64], prices: NDArray[np.float64], temperature: float
) -> NDArray[np.float64]:
    from scipy.optimize import minimize

    part = np.empty_like(weights)
    scratch = [np.empty(len(group.poses)) for group in groups]

    def smoothed(mu: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        total = float(weights @ mu)
        gradient = weights.copy()
        for group, values in zip(groups, scratch, strict=True):
            total += group.count * _smoothed_maximum(group.visibility, weights, mu, temperature, values, part)
            gradient -= group.count * part
        return total, gradient

    found = minimize(
        smoothed, prices, jac=True, method="L-BFGS-B", bounds=[(0.0, None)] * len(prices), options={"maxiter": STEPS}
    )
    result: NDArray[np.float64] = np.maximum(0.0, found.x)
    return result
