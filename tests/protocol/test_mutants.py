"""Protocols that are wrong in one place; the checks of `World` must catch each."""

from __future__ import annotations

import numpy as np
import pytest
from tests.protocol.world import FAIR, Violation, Weather, World

from covey.errors import CoveyError
from covey.geometry import Pose2
from covey.protocol import (
    Ack,
    AgentState,
    Busy,
    Cause,
    Commit,
    Lock,
    Message,
    Node,
    Offer,
    Output,
    Proposal,
    Request,
    Verdict,
)

SEEDS = 200


class NoEscrow(Node):
    """A prepared server goes on claiming what it has offered."""

    def _prepare(self, now: float, client: int, offer: Offer) -> None:
        super()._prepare(now, client, offer)
        self._holdings.escrow = None


class PoseMovesWhileLocked(Node):
    """A better pose is committed at once, whatever the lock says."""

    def adopt_pose(self, now: float, pose: Pose2) -> list[Output]:
        outputs: list[Output] = []
        self._adopt(pose, Cause.PROOF, outputs)
        return self._finish(outputs)


class ServerGivesUp(Node):
    """A prepared server that hears nothing takes back what it has offered."""

    def poll(self, now: float, rng: np.random.Generator) -> list[Output]:
        if self.lock is Lock.SERVER_PREPARED and now >= self._resend_at and self._pending is not None:
            self._release(self._pending.to)
        return super().poll(now, rng)


class CommitsInTwoSteps(Node):
    """A client takes what it is given at once, and writes the rest when the server has answered."""

    _rest: Commit | None = None

    def _apply(self, commit: Commit, server: int) -> None:
        mine = commit.records.indices[commit.records.values[:, 2] == self.agent]
        if server != self.agent:
            self._rest = commit
            before = self.poses[server]
            commit = Commit(commit.sender, commit.trade, commit.records.select(mine), before, commit.client_pose)
        super()._apply(commit, server)

    def receive(self, now: float, message: Message, rng: np.random.Generator) -> list[Output]:
        if self._rest is not None and isinstance(message, Ack) and message.trade == self._rest.trade:
            rest, self._rest = self._rest, None
            super()._apply(rest, message.sender.agent)
        return super().receive(now, message, rng)


class ForgetsItsAnswers(Node):
    """A server takes each copy of a request for a new one."""

    def _on_request(self, now: float, request: Request, outputs: list[Output]) -> None:
        self._answers.pop(request.sender.agent, None)
        super()._on_request(now, request, outputs)


class BusyIsFailure(Node):
    """A client drops a partner that was busy."""

    def receive(self, now: float, message: Message, rng: np.random.Generator) -> list[Output]:
        if isinstance(message, Busy) and self._waits_for(message.trade):
            self._partners.drop(message.sender.agent)
        return super().receive(now, message, rng)


class NeverRefills(Node):
    """An agent that has changed does not ask again whom it has asked before."""

    def _commit_pose(self, pose: Pose2) -> None:
        self._holdings.commit_pose(pose)

    def _apply(self, commit: Commit, server: int) -> None:
        self._holdings.apply(commit, server)


class TradesWhileMoving(Node):
    """A pose that the vehicle has not reached counts as held: a waypoint given up later breaks an open trade."""

    def _finish(self, outputs: list[Output]) -> list[Output]:
        outputs = super()._finish(outputs)
        self.at_waypoint = True
        return outputs

    def waypoint_unreachable(self, now: float, held_pose: Pose2) -> list[Output]:
        self._commit_pose(held_pose)
        return super()._finish([])


class TrustsOffers(Node):
    """A client commits an offer whatever has become of the records since it asked."""

    def _on_offer(self, now: float, offer: Offer, rng: np.random.Generator, outputs: list[Output]) -> None:
        if self.lock is Lock.IDLE:
            self._open, self.lock = offer.trade, Lock.CLIENT_WAIT
        self._asked_in_epoch = self.epoch
        super()._on_offer(now, offer, rng, outputs)

    def _judge(self, server: AgentState, client: AgentState, proposal: Proposal) -> Verdict:
        verdict = super()._judge(server, client, proposal)
        return Verdict(True, verdict.before, verdict.after) if client.agent == self.agent else verdict


ROUGH = Weather(loss=0.1, duplicates=0.2, spread=0.05)
MUTANTS: dict[str, tuple[type[Node], Weather]] = {
    "no escrow": (NoEscrow, FAIR),
    "pose moves while locked": (PoseMovesWhileLocked, Weather(proofs=0.3)),
    "server gives up by itself": (ServerGivesUp, ROUGH),
    "commit in two steps": (CommitsInTwoSteps, FAIR),
    "forgets its answers": (ForgetsItsAnswers, ROUGH),
    "busy is a failure": (BusyIsFailure, FAIR),
    "never refills Q": (NeverRefills, FAIR),
    "trades while moving": (TradesWhileMoving, Weather(flying=1.0, unreachable=0.5)),
    "trusts offers": (TrustsOffers, ROUGH),
}


def caught(mutant: type[Node], weather: Weather) -> tuple[int, str] | None:
    """The first seed that shows the mutant, and how."""
    for seed in range(SEEDS):
        try:
            World(seed, weather, eager=seed % 2 == 0, pairwise=seed % 4 < 2, node=mutant).run()
        except (Violation, CoveyError, AssertionError) as error:
            return seed, str(error)
    return None


@pytest.mark.parametrize("weather", {weather for _, weather in MUTANTS.values()}, ids=str)
def test_the_protocol_itself_passes_where_mutants_fail(weather: Weather) -> None:
    for seed in range(30):
        world = World(seed, weather, eager=seed % 2 == 0, pairwise=seed % 4 < 2)
        world.run()
        assert world.detector.terminated


@pytest.mark.parametrize("name", MUTANTS)
def test_the_mutant_is_caught(name: str) -> None:
    found = caught(*MUTANTS[name])
    assert found is not None, f"no seed below {SEEDS} shows it"
