"""Checks a deployment from the result alone, and bounds what any deployment could score."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from covey.coverage import Certificate, LinkedPairs, TeamBound, Violation, team_visibility
from covey.coverage.certificate import ROUNDING, partition_violations, pose_violations, trade_violations
from covey.errors import ResultError
from covey.geometry import Pose2
from covey.mission import Mission
from covey.mission.flight_build import CLOSE
from covey.optimize import Exact, PoseProblem, PoseResult
from covey.optimize.team_bound import team_bound
from covey.runtime.agent import build_models
from covey.runtime.airspace import room_of
from covey.runtime.links import link_matrix
from covey.runtime.records.record import read_result
from covey.runtime.result import Deployment, Progress
from covey.runtime.streams import Stream, generator
from covey.sensing import VisibilityModel

ProgressCallback = Callable[[Progress], None]


def prove_poses(
    mission: Mission,
    models: Sequence[VisibilityModel],
    poses: Sequence[Pose2],
    sets: Sequence[NDArray[np.int64]],
    agents: Sequence[int],
    *,
    seed: int,
    on_done: Callable[[int], None] | None = None,
) -> dict[int, PoseResult]:
    """Prove some agents' poses for their landmarks to half of sigma, on all cores, however many there are.

    Where agents share a layer each is proved over what the committed positions of the others leave of its region.

    Parameters
    ----------
    poses, sets : sequences
        Pose and landmarks of every agent.
    agents : sequence of int
        Whose poses to prove.
    on_done : callable, optional
        Called with the number of proofs done, ten times a second at least; raises what shall end it.
    """
    stop = threading.Event()
    exact = Exact(cancelled=stop.is_set)

    def prove(agent: int) -> PoseResult:
        region, pose = room_of(mission, poses, agent), poses[agent]
        problem = PoseProblem(models[agent], mission.landmarks.subset(sets[agent]), region)
        start = pose if region.contains(pose.x, pose.y) else None
        tolerance = 0.5 * mission.coverage.sigma
        return exact.maximize(problem, start=start, tolerance=tolerance, rng=generator(seed, Stream.PROOF, agent))

    with ThreadPoolExecutor(max_workers=os.cpu_count()) as pool:
        futures = [pool.submit(prove, agent) for agent in agents]
        pending = set(futures)
        try:
            while pending:
                done, pending = wait(pending, timeout=0.1, return_when=FIRST_COMPLETED)
                for future in done:
                    future.result()
                if on_done is not None:
                    on_done(len(futures) - len(pending))
        except BaseException:
            stop.set()
            pool.shutdown(cancel_futures=True)
            raise
    return {agent: future.result() for agent, future in zip(agents, futures, strict=True)}


def admissibility_violations(
    mission: Mission, poses: Sequence[Pose2], sets: Sequence[NDArray[np.int64]]
) -> list[Violation]:
    """Check that it is a deployment at all.

    Each landmark has one owner, each pose is inside its region, and agents that share a layer keep their distance.
    """
    violations = partition_violations([agent.name for agent in mission.agents], sets, len(mission.landmarks))
    for agent, pose in zip(mission.agents, poses, strict=True):
        if not agent.region.contains(pose.x, pose.y):
            x, y = agent.region.project(pose.x, pose.y)
            away = float(np.hypot(x - pose.x, y - pose.y))
            message = f"{agent.name} is outside its region, by {away:.6g} m"
            violations.append(Violation("region", (agent.name,), None, away, message))
    if mission.separation is not None:
        spacing = mission.separation.spacing
        for i, j, away in mission.separation.too_close(poses, spacing - CLOSE):
            names = mission.agents[i].name, mission.agents[j].name
            message = f"{names[0]} and {names[1]} share a layer {away:.6g} m apart; at least {spacing:.6g} is asked for"
            violations.append(Violation("separation", names, None, spacing - away, message))
    return violations


def build_certificate(
    mission: Mission,
    models: Sequence[VisibilityModel],
    poses: Sequence[Pose2],
    sets: Sequence[NDArray[np.int64]],
    proofs: dict[int, PoseResult],
) -> Certificate:
    """Check Definition 3 with the proofs of all poses at hand."""
    names = [agent.name for agent in mission.agents]
    sigma = mission.coverage.sigma
    violations = admissibility_violations(mission, poses, sets)
    visibility = team_visibility(models, poses, mission.landmarks)
    worst_gap = 0.0
    for i, name in enumerate(names):
        score = float(visibility[i, sets[i]] @ mission.landmarks.weights[sets[i]])
        gap, found = pose_violations(name, score, proofs[i].score, proofs[i].upper_bound, sigma)
        worst_gap = max(worst_gap, gap)
        violations += found
    linked = link_matrix(mission, poses)
    worst_gain, found = trade_violations(names, visibility, sets, sigma, linked)
    violations += found
    links = None if linked is None else LinkedPairs.of(names, linked)
    return Certificate(not violations, sigma, worst_gap, worst_gain, tuple(violations), links)


def certify(source: Deployment | str | Path, *, on_progress: ProgressCallback | None = None) -> Certificate:
    """Check a deployment from what it says alone: landmarks, sensors, regions, poses, and who owns what.

    Parameters
    ----------
    source : Deployment, str or Path
        A deployment, or the directory that holds its result.
    on_progress : callable, optional
        Called with a `Progress` as the proofs go on.

    Returns
    -------
    Certificate
        Whether the partition is disjoint and complete, each pose inside its region and within sigma of the best for
        its landmarks (proved by `exact`), agents that share a layer as far apart as they must be, no landmark better
        seen by another agent (one that is linked to its owner, where not all are) by more than sigma, the stated scores
        those that the poses give, and a stated bound not below them; what is violated, where.

    Raises
    ------
    ResultError
        If the directory holds no usable result.

    Notes
    -----
    Source: Sposato (2016), Definition 3.  Deviation: V2, V4.
    """
    deployment = source if isinstance(source, Deployment) else read_result(source)
    mission = deployment.mission
    models = build_models(mission)
    poses = deployment.poses
    sets = [agent.landmarks for agent in deployment.agents]
    total = len(sets)

    def report(done: int) -> None:
        if on_progress is not None:
            on_progress(Progress("proving", deployment.score.final, fraction=done / total))

    proofs = prove_poses(mission, models, poses, sets, range(total), seed=deployment.seed, on_done=report)
    certificate = build_certificate(mission, models, poses, sets, proofs)
    stated = _stated_violations(deployment, _scores(deployment, models))
    if not stated:
        return certificate
    return replace(certificate, holds=False, violations=(*certificate.violations, *stated))


def bound_team(source: Deployment | str | Path, *, on_progress: ProgressCallback | None = None) -> TeamBound:
    """Bound the score of every deployment of the team; see `covey.optimize.team_bound`.

    Parameters
    ----------
    source : Deployment, str or Path
        A deployment, or the directory that holds its result.
    on_progress : callable, optional
        Called with a `Progress` as it goes on.

    Raises
    ------
    ResultError
        If the directory holds no usable result, a landmark has no owner or several, or a pose is outside its region:
        a bound says nothing about the score of such a deployment.
    SolverError
        If a sensor is not a built-in model.
    """
    deployment = source if isinstance(source, Deployment) else read_result(source)
    mission = deployment.mission
    wrong = admissibility_violations(mission, deployment.poses, [agent.landmarks for agent in deployment.agents])
    if wrong:
        raise ResultError(f"no bound can be compared with the score of this deployment: {wrong[0].message}")
    models = build_models(mission)
    score = float(_scores(deployment, models).sum())

    def report(fraction: float, bound: float) -> None:
        if on_progress is not None:
            on_progress(Progress("bounding", bound, fraction=fraction))

    return team_bound(
        models,
        [agent.region for agent in mission.agents],
        deployment.poses,
        mission.landmarks,
        score,
        rng=generator(deployment.seed, Stream.BOUND),
        on_progress=report,
    )


def _stated_violations(deployment: Deployment, scores: NDArray[np.float64]) -> list[Violation]:
    """Compare what a deployment says of itself with the agents' true scores."""
    total, final = float(scores.sum()), deployment.score.final
    checks: list[tuple[float, float, tuple[str, ...], str, str]] = [
        (agent.score, float(score), (agent.name,), f"{agent.name} is said to score", "its pose and landmarks give")
        for agent, score in zip(deployment.agents, scores, strict=True)
    ]
    checks.append((final, total, (), "the team is said to score", "its poses and landmarks give"))
    if deployment.history:
        checks.append((deployment.history[-1].score, total, (), "the history ends with", "poses and landmarks give"))
    violations = [
        Violation("score", names, None, abs(stated - true), f"{claim} {stated:.6f}; {truth} {true:.6f}")
        for stated, true, names, claim, truth in checks
        if not abs(stated - true) <= ROUNDING * max(1.0, true)  # nor if it is NaN: not stated
    ]
    bound = deployment.bound
    if bound is not None and not bound.team_upper_bound >= final - ROUNDING * max(1.0, abs(final)):
        below = final - bound.team_upper_bound
        message = f"the stated bound {bound.team_upper_bound:.6f} lies below the stated score {final:.6f}"
        violations.append(Violation("bound", (), None, below, message))
    return violations


def _scores(deployment: Deployment, models: Sequence[VisibilityModel]) -> NDArray[np.float64]:
    visibility = team_visibility(models, deployment.poses, deployment.mission.landmarks)
    weights = deployment.mission.landmarks.weights
    sets = [agent.landmarks for agent in deployment.agents]
    return np.array([row[own] @ weights[own] for row, own in zip(visibility, sets, strict=True)])
