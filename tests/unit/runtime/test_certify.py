"""`certify` on deployments that somebody tampered with: what is wrong, whose it is, and by how much."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.unit.runtime.small import POLYGON, small

from covey import certify, plan
from covey.coverage import Certificate, TeamBound, Violation
from covey.errors import ResultError
from covey.geometry import Pose2
from covey.optimize import Exact, PoseResult, Status
from covey.runtime import certify as module
from covey.runtime.agent import build_models
from covey.runtime.certify import bound_team
from covey.runtime.result import AgentResult, Deployment


@pytest.fixture(scope="module")
def good() -> Deployment:
    return plan(small(region=POLYGON))


def changed(deployment: Deployment, agent: int, **changes: object) -> Deployment:
    agents = list(deployment.agents)
    agents[agent] = replace(agents[agent], **changes)  # type: ignore[arg-type]
    return replace(deployment, agents=tuple(agents))


def honest_scores(deployment: Deployment) -> Deployment:
    """State the scores that poses and sets really give, so that only the deployment is at fault."""
    models = build_models(deployment.mission)
    agents = []
    for agent, model in zip(deployment.agents, models, strict=True):
        seen = model.visibility(agent.pose.as_array()[None], deployment.mission.landmarks)[0]
        agents.append(replace(agent, score=float(seen[agent.landmarks].sum())))
    total = sum(agent.score for agent in agents)
    history = (*deployment.history[:-1], replace(deployment.history[-1], score=total))
    score = replace(deployment.score, final=total)
    return replace(deployment, agents=tuple(agents), score=score, history=history)


def violations(certificate: Certificate, kind: str) -> list[Violation]:
    return [violation for violation in certificate.violations if violation.kind == kind]


def test_a_good_deployment_is_certified(good: Deployment) -> None:
    certificate = certify(good)
    assert certificate.holds
    assert certificate.violations == ()
    assert 0.0 <= certificate.worst_pose_gap <= good.sigma
    assert 0.0 <= certificate.worst_trade_gain <= good.sigma
    assert certificate == good.certificate or certificate.holds


def test_the_same_from_its_files(good: Deployment, tmp_path: Path) -> None:
    good.save(tmp_path / "out")
    certificate = certify(tmp_path / "out")
    assert certificate.holds
    bad = honest_scores(changed(good, 0, pose=Pose2(1.9, -1.9, 0.0)))
    bad.save(tmp_path / "bad")
    assert not certify(tmp_path / "bad").holds


def test_a_pose_that_was_moved(good: Deployment) -> None:
    pose = good.agents[1].pose
    x, y = good.mission.agents[1].region.project(pose.x + 0.1, pose.y + 0.05)
    certificate = certify(honest_scores(changed(good, 1, pose=Pose2(x, y, pose.yaw + 0.1))))
    found = violations(certificate, "pose")
    assert not certificate.holds
    assert [violation.agents for violation in found] == [(good.agents[1].name,)]
    assert good.sigma < found[0].amount <= certificate.worst_pose_gap
    assert {violation.kind for violation in certificate.violations} <= {"pose", "trade"}


def test_two_landmarks_that_were_swapped(good: Deployment) -> None:
    """Those that are seen much better by their owners: the two are named, with who sees them better."""
    models = build_models(good.mission)
    seen = np.array(
        [
            m.visibility(a.pose.as_array()[None], good.mission.landmarks)[0]
            for m, a in zip(models, good.agents, strict=True)
        ]
    )
    mine, yours = good.agents[0].landmarks, good.agents[1].landmarks
    a = int(mine[(seen[0, mine] - seen[1, mine]).argmax()])
    b = int(yours[(seen[1, yours] - seen[0, yours]).argmax()])
    swapped = changed(good, 0, landmarks=np.sort(np.append(mine[mine != a], b)))
    swapped = changed(swapped, 1, landmarks=np.sort(np.append(yours[yours != b], a)))
    certificate = certify(honest_scores(swapped))
    found = {violation.landmark: violation for violation in violations(certificate, "trade")}
    assert set(found) == {a, b}
    assert found[a].agents == (good.agents[1].name, good.agents[0].name)
    assert found[b].agents == (good.agents[0].name, good.agents[1].name)
    assert found[a].amount == pytest.approx(seen[0, a] - seen[1, a])
    assert certificate.worst_trade_gain == pytest.approx(max(found[a].amount, found[b].amount))


def test_a_landmark_that_was_dropped(good: Deployment) -> None:
    landmark = int(good.agents[2].landmarks[3])
    certificate = certify(honest_scores(changed(good, 2, landmarks=np.delete(good.agents[2].landmarks, 3))))
    assert [(v.agents, v.landmark) for v in violations(certificate, "incomplete")] == [((), landmark)]


def test_a_landmark_that_two_own(good: Deployment) -> None:
    landmark = good.agents[2].landmarks[3]
    both = np.sort(np.append(good.agents[0].landmarks, landmark))
    certificate = certify(honest_scores(changed(good, 0, landmarks=both)))
    (found,) = violations(certificate, "overlap")
    assert (found.agents, found.landmark) == ((good.agents[0].name, good.agents[2].name), int(landmark))


def test_a_landmark_that_one_owns_twice(good: Deployment) -> None:
    twice = np.sort(np.append(good.agents[0].landmarks, good.agents[0].landmarks[4]))
    certificate = certify(honest_scores(changed(good, 0, landmarks=twice)))
    (found,) = violations(certificate, "overlap")
    assert (found.agents, found.landmark) == ((good.agents[0].name,), int(good.agents[0].landmarks[4]))


@pytest.mark.parametrize(("x", "y", "away"), [(0.0, 0.0, None), (2.0 + 1e-6, 0.5, 1e-6), (-30.0, 0.0, 28.0)])
def test_a_pose_outside_its_region(good: Deployment, x: float, y: float, away: float | None) -> None:
    """In the hole, just over the fence, and far away."""
    certificate = certify(honest_scores(changed(good, 0, pose=Pose2(x, y, 1.0))))
    (found,) = violations(certificate, "region")
    assert found.agents == (good.agents[0].name,)
    assert found.amount > 0.0
    if away is not None:
        assert found.amount == pytest.approx(away, rel=0.1)


@pytest.mark.parametrize("error", [1e-6, -1e-6, 5.0, math.inf])
def test_a_score_that_was_falsified(good: Deployment, error: float) -> None:
    certificate = certify(changed(good, 1, score=good.agents[1].score + error))
    (found,) = certificate.violations
    assert (found.kind, found.agents) == ("score", (good.agents[1].name,))
    assert found.amount == pytest.approx(abs(error))
    assert not certificate.holds


@pytest.mark.parametrize("error", [1e-6, -3.0, math.nan])
@pytest.mark.parametrize("place", ["team", "history"])
def test_a_team_score_that_was_falsified(good: Deployment, place: str, error: float) -> None:
    if place == "team":
        bad = replace(good, score=replace(good.score, final=good.score.final + error))
    else:
        last = good.history[-1]
        bad = replace(good, history=(*good.history[:-1], replace(last, score=last.score + error)))
    (found,) = certify(bad).violations
    assert (found.kind, found.agents) == ("score", ())
    assert place in found.message
    assert found.amount == pytest.approx(abs(error), nan_ok=True)


def test_a_stated_bound_below_the_score_is_a_contradiction(good: Deployment) -> None:
    final = good.score.final
    assert certify(replace(good, bound=TeamBound(final, 0.0))).holds
    (found,) = certify(replace(good, bound=TeamBound(final - 0.5, 0.0))).violations
    assert (found.kind, found.agents) == ("bound", ())
    assert found.amount == pytest.approx(0.5)


def test_what_is_no_deployment_has_no_bound(good: Deployment) -> None:
    both = np.sort(np.append(good.agents[0].landmarks, good.agents[2].landmarks[3]))
    bad = honest_scores(changed(good, 0, landmarks=both))
    with pytest.raises(ResultError, match=f"landmark {good.agents[2].landmarks[3]} is owned 2 times"):
        bound_team(bad)
    with pytest.raises(ResultError, match="no owner"):
        bound_team(honest_scores(changed(good, 1, landmarks=good.agents[1].landmarks[1:])))
    with pytest.raises(ResultError, match="is outside its region"):
        bound_team(honest_scores(changed(good, 1, pose=Pose2(0.0, 0.0, 0.0))))


def test_everything_at_once_is_reported_at_once(good: Deployment) -> None:
    bad = changed(good, 0, pose=Pose2(0.0, 0.0, 0.0), score=99.0)
    bad = changed(bad, 1, landmarks=bad.agents[1].landmarks[1:])
    assert {"region", "score", "incomplete"} <= {violation.kind for violation in certify(bad).violations}


def test_an_exchange_of_poses_is_found(good: Deployment) -> None:
    first, second = good.agents[0].pose, good.agents[1].pose
    certificate = certify(honest_scores(changed(changed(good, 0, pose=second), 1, pose=first)))
    assert violations(certificate, "pose")
    assert violations(certificate, "trade")


def test_a_proof_without_end_is_no_proof(good: Deployment, monkeypatch: pytest.MonkeyPatch) -> None:
    class Tired:
        def __init__(self, **options: object) -> None:
            self.exact = Exact()

        def maximize(self, *arguments: object, **options: object) -> PoseResult:
            result = self.exact.maximize(*arguments, **options)  # type: ignore[arg-type]
            return replace(result, upper_bound=result.score + 1.0, status=Status.BUDGET)

    monkeypatch.setattr(module, "Exact", Tired)
    certificate = certify(good)
    assert [violation.kind for violation in certificate.violations] == ["unproved"] * 3
    assert certificate.worst_pose_gap == pytest.approx(1.0, abs=good.sigma)


@pytest.mark.parametrize("sigma", [1e-3, 0.01, 0.1])
def test_the_tolerance_is_the_missions(sigma: float) -> None:
    deployment = plan(small(sigma=sigma))
    strict = replace(deployment.mission, coverage=replace(deployment.mission.coverage, sigma=1e-6))
    assert certify(deployment).holds
    assert certify(replace(deployment, mission=strict)).sigma == 1e-6


def test_a_falsified_gap_shows_in_a_fine_tolerance() -> None:
    """Planned with sigma 0.3, checked with 0.001: what was allowed is not any more."""
    deployment = plan(small(sigma=0.3), trade="thesis")
    strict = replace(deployment.mission, coverage=replace(deployment.mission.coverage, sigma=1e-3))
    certificate = certify(replace(deployment, mission=strict))
    assert {violation.kind for violation in certificate.violations} <= {"pose", "trade"}
    assert not certificate.holds


def test_an_agent_too_few_is_found(good: Deployment) -> None:
    nobody = AgentResult(good.agents[0].name, good.agents[0].pose, 0.0, np.empty(0, dtype=np.int64))
    certificate = certify(replace(good, agents=(nobody, *good.agents[1:])))
    assert {violation.landmark for violation in violations(certificate, "incomplete")} == set(
        good.agents[0].landmarks.tolist()
    )


def test_progress_is_told(good: Deployment) -> None:
    told: list[float | None] = []
    certify(good, on_progress=lambda progress: told.append(progress.fraction))
    assert told[-1] == 1.0
    assert set(told) <= {0.0, 1 / 3, 2 / 3, 1.0}
