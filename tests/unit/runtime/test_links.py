"""Teams of which not all can trade with all: what is proved, and what is said to be proved."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.unit.runtime.small import small

from covey import certify, plan
from covey.cli.summary import certificate_line, link_lines
from covey.coverage import LinkedPairs, team_visibility
from covey.mission import CommunicationSpec, Mission
from covey.runtime.agent import build_models
from covey.runtime.links import link_matrix
from covey.runtime.records.record import read_result

SIX = {"count": 6}
CHAIN = CommunicationSpec(links=tuple((f"agent-{i}", f"agent-{i + 1}") for i in range(1, 6)))


def limited(communication: CommunicationSpec, seed: int = 3) -> Mission:
    return replace(small(agents=SIX).with_seed(seed), communication=communication)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("communication", [CHAIN, CommunicationSpec(range=2.0)], ids=["links", "range"])
def test_no_linked_pair_can_improve(communication: CommunicationSpec, seed: int) -> None:
    mission = limited(communication, seed)
    deployment = plan(mission)
    assert deployment.certificate is not None
    assert deployment.certificate.holds
    linked = link_matrix(mission, deployment.poses)
    assert linked is not None
    assert deployment.certificate.links == LinkedPairs.of([agent.name for agent in mission.agents], linked)
    seen = team_visibility(build_models(mission), deployment.poses, mission.landmarks)
    for i, j in np.argwhere(linked):
        own = deployment.agents[i].landmarks
        assert (seen[j, own] - seen[i, own] <= deployment.sigma + 1e-9).all()


def test_agents_that_are_not_linked_are_not_compared_and_it_says_so(tmp_path: Path) -> None:
    mission = limited(CommunicationSpec(links=(("agent-1", "agent-2"), ("agent-3", "agent-4"))))
    deployment = plan(mission)
    certificate = deployment.certificate
    assert certificate is not None
    assert certificate.holds
    assert certificate.links is not None
    assert certificate.links.groups == (
        ("agent-1", "agent-2"),
        ("agent-3", "agent-4"),
        ("agent-5",),
        ("agent-6",),
    )
    assert not certify(replace(deployment, mission=replace(mission, communication=None))).holds
    assert "2 of 15 pairs; the others were not compared" in certificate_line(certificate)
    assert "not connected: 4 groups" in link_lines(certificate)[0]
    deployment.save(tmp_path / "out")
    again = read_result(tmp_path / "out")
    assert again.certificate == certificate
    assert again.mission.communication == mission.communication
    assert certify(tmp_path / "out").links == certificate.links


def test_a_violation_between_linked_agents_is_found() -> None:
    apart = plan(limited(CommunicationSpec(links=())))
    joined = replace(apart, mission=replace(apart.mission, communication=CHAIN))
    assert any(violation.kind == "trade" for violation in certify(joined).violations)


def test_everybody_in_range_is_as_good_as_no_limit() -> None:
    everybody = plan(limited(CommunicationSpec(range=100.0)))
    assert everybody.certificate is not None
    assert everybody.certificate.holds
    assert everybody.certificate.links is not None
    assert everybody.certificate.links.linked == everybody.certificate.links.pairs
    assert link_lines(everybody.certificate) == []
    without = replace(everybody, mission=replace(everybody.mission, communication=None))
    assert certify(without).holds


def test_the_same_seed_gives_the_same_deployment() -> None:
    first, second = (plan(limited(CHAIN)) for _ in range(2))
    assert first.poses == second.poses
    assert first.history == second.history
