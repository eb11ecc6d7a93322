"""Planning: the score never falls, every waypoint is allowed, the proof holds, and a seed means one deployment."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.unit.runtime.small import AGENTS, HOLE, POLYGON, check_deployment, small

from covey import plan
from covey.errors import InputError
from covey.geometry import Pose2
from covey.mission import Assignment, Mission, OptimizerName, SensorSpec, Trade
from covey.runtime import certify as certify_module
from covey.runtime.agent import TeamPlanner
from covey.runtime.result import Deployment, PlanStatus, Progress

Seeds = Callable[[int, int], range]

WEIGHTS = np.random.default_rng(1).uniform(0.0, 3.0, 64).round(3).tolist()
NORMALS = [[float(np.cos(a)), float(np.sin(a))] for a in np.random.default_rng(2).uniform(-3.1, 3.1, 64)]

HETEROGENEOUS = [
    {**AGENTS[0], "sensor": {"model": "isotropic", "optimal_distance_m": 0.4}},
    {**AGENTS[1], "sensor": {"model": "oriented", "optimal_distance_m": 1.0}},
    {**AGENTS[2], "region": {"box": {"x_m": [0.5, 1.5], "y_m": [1.0, 2.0]}}},
]

KINDS: dict[str, Callable[[], Mission]] = {
    "plain": small,
    "weights": lambda: small(weights=WEIGHTS),
    "hole": lambda: small(region=POLYGON),
    "heterogeneous": lambda: small(agents=HETEROGENEOUS, weights=WEIGHTS, normals=NORMALS, region=POLYGON),
    "nearest": lambda: small(assignment="nearest"),
    "drawn poses": lambda: small(agents={"count": 5}),
    "large sigma": lambda: small(sigma=0.3),
}


@pytest.mark.parametrize("kind", sorted(KINDS))
@pytest.mark.parametrize("optimizer", ["search", "exact"])
@pytest.mark.parametrize("trade", ["thesis", "pairwise"])
def test_every_plan_settles_with_a_proof(trade: str, optimizer: str, kind: str, seeds: Seeds) -> None:
    for seed in seeds(4, 60):
        deployment = plan(KINDS[kind](), seed=seed, trade=trade, optimizer=optimizer)
        assert deployment.status is PlanStatus.SETTLED
        assert (deployment.trade, deployment.optimizer) == (Trade(trade), OptimizerName(optimizer))
        check_deployment(deployment)
        assert deployment.certificate is not None
        assert certify_module.certify(deployment).holds


@pytest.mark.parametrize("trade", ["thesis", "pairwise"])
def test_the_optimiser_of_the_thesis_settles_too(trade: str, seeds: Seeds) -> None:
    for seed in seeds(2, 10):
        check_deployment(plan(small(weights=WEIGHTS), seed=seed, trade=trade, optimizer="differential-evolution"))


def fingerprint(deployment: Deployment) -> str:
    """A digest of every bit of the poses, the partition and the history."""
    digest = hashlib.sha256()
    for agent in deployment.agents:
        digest.update(agent.pose.as_array().tobytes() + agent.landmarks.astype("<i8").tobytes())
    for entry in deployment.history:
        digest.update(repr((entry.event, entry.agents, entry.score)).encode())
    digest.update(repr(deployment.score).encode())
    return digest.hexdigest()


PROGRAM = """
import sys
sys.path.insert(0, {root!r})
from covey import plan
from tests.unit.runtime.small import small
from tests.unit.runtime.test_plan import KINDS, fingerprint
print(fingerprint(plan(KINDS["hole"](), seed=5)), fingerprint(plan(KINDS["weights"](), seed=6, trade="thesis")))
"""


@pytest.mark.parametrize("threads", ["1", "2"])
def test_a_seed_means_the_same_in_another_process(root: Path, threads: str) -> None:
    environment = {
        **os.environ,
        "NUMBA_NUM_THREADS": threads,
        "OMP_NUM_THREADS": threads,
        "OPENBLAS_NUM_THREADS": threads,
    }
    environment["PYTHONHASHSEED"] = threads
    program = PROGRAM.format(root=str(root))
    done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    expected = [
        fingerprint(plan(KINDS["hole"](), seed=5)),
        fingerprint(plan(KINDS["weights"](), seed=6, trade="thesis")),
    ]
    assert done.stdout.split() == expected


def test_a_seed_means_the_same_again_and_on_any_number_of_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    once = fingerprint(plan(small(), seed=11))
    assert fingerprint(plan(small(), seed=11)) == once
    for cores in (1, 7):
        monkeypatch.setattr(os, "cpu_count", lambda cores=cores: cores)
        assert fingerprint(plan(small(), seed=11)) == once


def test_another_seed_means_another_course() -> None:
    assert len({fingerprint(plan(small(), seed=seed)) for seed in range(6)}) == 6
    assert len({plan(small(agents={"count": 2}), seed=seed).snapshots[0].poses for seed in range(4)}) == 4


def test_the_seed_of_the_mission_is_the_default() -> None:
    deployment = plan(small())
    assert deployment.seed == 3
    assert fingerprint(deployment) == fingerprint(plan(small(), seed=3))


def test_an_observer_changes_nothing() -> None:
    told: list[Progress] = []
    assert fingerprint(plan(small(), seed=2, on_progress=told.append)) == fingerprint(plan(small(), seed=2))
    assert told
    assert {progress.stage for progress in told} <= {"optimizing", "trading", "proving"}


def test_every_waypoint_is_in_the_region(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each that the planner ever hands out, not only those of the snapshots."""
    import shapely

    handed_out: list[Pose2] = []
    improve, propose = TeamPlanner.improve, TeamPlanner.propose

    def watch_improve(self: TeamPlanner, agent: int, pose: Pose2, landmarks: NDArray[np.int64]) -> Pose2 | None:
        found = improve(self, agent, pose, landmarks)
        handed_out.extend([found] if found is not None else [])
        return found

    def watch_propose(self: TeamPlanner, server: Any, client: Any) -> Any:
        proposal = propose(self, server, client)
        handed_out.extend([proposal.server_pose, proposal.client_pose] if proposal is not None else [])
        return proposal

    monkeypatch.setattr(TeamPlanner, "improve", watch_improve)
    monkeypatch.setattr(TeamPlanner, "propose", watch_propose)
    # landmarks in the hole draw the waypoints to its edge
    points = np.random.default_rng(0).uniform(-0.6, 0.6, (40, 2)).tolist()
    for seed in range(6):
        mission = small(region=POLYGON, points=points, sensor={"model": "anisotropic", "optimal_distance_m": 0.4})
        plan(mission, seed=seed, trade=["pairwise", "thesis"][seed % 2])
    region = shapely.Polygon([[-2, -2], [2, -2], [2, 2], [-2, 2]], [HOLE])
    assert len(handed_out) > 60
    assert all(region.covers(shapely.Point(pose.x, pose.y)) for pose in handed_out)
    edge = sum(region.boundary.distance(shapely.Point(pose.x, pose.y)) < 1e-6 for pose in handed_out)
    assert edge > 10, "no waypoint came near the boundary: the test does not test"


def test_landmarks_that_are_worth_nothing_have_an_owner_all_the_same() -> None:
    for trade in Trade:
        deployment = plan(small(weights=[0.0] * 63 + [1.0]), trade=trade)
        check_deployment(deployment)
        assert deployment.score.final == pytest.approx(1.0, abs=0.011)


@pytest.mark.parametrize("trade", list(Trade))
def test_more_agents_than_landmarks(trade: Trade) -> None:
    mission = small(agents={"count": 7}, points=[[0.0, 0.0], [1.5, 1.5], [-1.5, 0.5]])
    for seed in range(4):
        deployment = plan(mission, seed=seed, trade=trade)
        check_deployment(deployment)
        assert sum(len(agent.landmarks) == 0 for agent in deployment.agents) >= 4
        assert 1.0 - 0.01 <= deployment.score.final <= 3.0 + 1e-9
        if trade is Trade.PAIRWISE:
            assert deployment.score.final == pytest.approx(3.0, abs=0.05)


def test_an_agent_without_landmarks_keeps_its_pose() -> None:
    """Deviation V11: nothing can be better than nothing, so it does not fly for it."""
    mission = small(
        agents=[AGENTS[0], AGENTS[1]],
        points=[[1.9, -1.0]],
        assignment={"blue": [0]},
        sensor={"model": "anisotropic", "optimal_distance_m": 0.7},
    )
    deployment = plan(mission, trade="thesis")
    check_deployment(deployment)
    assert deployment.agents[1].pose == mission.agents[1].pose
    assert deployment.agents[0].score == pytest.approx(1.0, abs=0.01)


def test_one_agent_alone() -> None:
    deployment = plan(small(agents=[AGENTS[0]]), bound=True)
    check_deployment(deployment)
    assert deployment.trades == 0
    assert len(deployment.agents[0].landmarks) == 64
    assert np.isnan(deployment.score.after_first_trade)
    assert deployment.bound is not None
    assert 0.0 <= deployment.bound.gap < 0.01


def test_an_operator_may_assign() -> None:
    sets = {"blue": list(range(0, 64, 2)), "green": [k for k in range(64) if k % 2 and k != 7], "red": [7]}
    mission = small(assignment=sets)
    first = plan(mission).snapshots[0].owner
    names = [agent.name for agent in mission.agents]
    assert {name: np.flatnonzero(first == i).tolist() for i, name in enumerate(names)} == sets


def test_nearest_means_nearest() -> None:
    mission = small(assignment="nearest")
    assert mission.coverage.assignment is Assignment.NEAREST
    first = plan(mission).snapshots[0].owner
    for k, point in enumerate(mission.landmarks.positions_W):
        away = [np.hypot(*(point - agent.pose.position_W)) for agent in mission.agents]
        assert away[first[k]] == min(away)


def test_a_random_assignment_gives_everybody_about_the_same(seeds: Seeds) -> None:
    owners = np.concatenate([plan(small(agents={"count": 4}), seed=seed).snapshots[0].owner for seed in seeds(5, 20)])
    counts = np.bincount(owners, minlength=4)
    # binomial: five standard deviations
    assert np.abs(counts - len(owners) / 4).max() < 5.0 * np.sqrt(len(owners) * 3 / 16)


class StopAfter:
    """Press Ctrl-C at the n-th word of progress in a stage."""

    def __init__(self, stage: str, count: int) -> None:
        self.stage, self.count = stage, count

    def __call__(self, progress: Progress) -> None:
        if progress.stage == self.stage:
            self.count -= 1
            if self.count <= 0:
                raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("stage", "count"), [("optimizing", 1), ("optimizing", 2), ("trading", 1), ("trading", 9), ("proving", 1)]
)
@pytest.mark.parametrize("trade", list(Trade))
def test_ctrl_c_gives_what_is_known(trade: Trade, stage: str, count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    from covey.runtime import plan as module

    monkeypatch.setattr(module, "REPORT_EVERY", 0.0)
    deployment = plan(small(), seed=1, trade=trade, on_progress=StopAfter(stage, count))
    assert deployment.status is PlanStatus.INTERRUPTED
    assert deployment.certificate is None
    check_deployment(deployment)
    settled = plan(small(), seed=1, trade=trade)
    assert deployment.score.initial == settled.score.initial
    assert deployment.history == settled.history[: len(deployment.history)]


@pytest.mark.parametrize("stage", ["bounding", "baseline"])
def test_ctrl_c_in_the_extras_keeps_the_proof(stage: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from covey.runtime import plan as module

    monkeypatch.setattr(module, "REPORT_EVERY", 0.0)
    deployment = plan(small(), bound=True, baseline=True, on_progress=StopAfter(stage, 1))
    assert deployment.status is PlanStatus.SETTLED
    assert deployment.certificate is not None
    assert deployment.certificate.holds
    assert deployment.baseline is None


def test_a_pose_that_the_proof_finds_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    """With an optimiser that finds nothing, all comes from the proofs, and the certificate holds all the same."""
    monkeypatch.setattr(TeamPlanner, "improve", lambda self, agent, pose, landmarks: None)
    deployment = plan(small(), trade="thesis")
    check_deployment(deployment)
    events = [entry.event for entry in deployment.history]
    assert "proof" in events
    assert "optimization" not in events
    assert deployment.score.final > 1.5 * deployment.score.initial


def test_the_checks_notice_what_is_wrong() -> None:
    good = plan(small())
    history = (*good.history[:5], replace(good.history[5], score=good.history[4].score - 1e-6), *good.history[6:])
    with pytest.raises(AssertionError, match="the score fell"):
        check_deployment(replace(good, history=history))
    agents = (replace(good.agents[0], landmarks=good.agents[0].landmarks[1:]), *good.agents[1:])
    with pytest.raises(AssertionError, match="not disjoint and complete"):
        check_deployment(replace(good, agents=agents))
    snapshot = replace(good.snapshots[1], poses=(Pose2(2.0 + 1e-12, 0.0, 0.0), *good.snapshots[1].poses[1:]))
    with pytest.raises(AssertionError, match="outside its region"):
        check_deployment(replace(good, snapshots=(good.snapshots[0], snapshot, *good.snapshots[2:])))


def test_weights_scale_all_scores() -> None:
    plain = plan(small(weights=[1.0] * 64, sigma=0.01), seed=4, trade="thesis", optimizer="search")
    for factor in (0.5, 8.0):
        scaled = plan(small(weights=[factor] * 64, sigma=0.01), seed=4, trade="thesis", optimizer="search")
        assert scaled.score.initial == pytest.approx(factor * plain.score.initial, rel=1e-12)
        assert scaled.score.after_first_optimization == pytest.approx(
            factor * plain.score.after_first_optimization, rel=2e-3
        )


def test_baseline_and_bound_on_request() -> None:
    deployment = plan(small(), bound=True, baseline=True)
    assert deployment.bound is not None
    assert deployment.baseline is not None
    assert deployment.bound.team_upper_bound >= deployment.score.final - 1e-9
    assert deployment.bound.team_upper_bound >= deployment.baseline.greedy_lloyd >= deployment.baseline.greedy
    bare = plan(small())
    assert bare.bound is None
    assert bare.baseline is None


def test_a_sensor_that_cannot_be_built_is_reported() -> None:
    mission = small()
    agents = tuple(replace(agent, sensor=SensorSpec("gone.py:Model", {})) for agent in mission.agents)
    with pytest.raises(InputError, match="gone"):
        plan(replace(mission, agents=agents))


def test_an_unknown_rule_is_refused() -> None:
    with pytest.raises(ValueError, match="barter"):
        plan(small(), trade="barter")
