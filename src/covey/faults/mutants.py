"""Protocols that are wrong in one place each; the simulator must find every one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from covey.geometry import Pose2
from covey.protocol import (
    Ack,
    AgentState,
    Busy,
    Catalogue,
    Cause,
    Commit,
    Links,
    Lock,
    Map,
    Memory,
    Message,
    Node,
    NodeOptions,
    Offer,
    Order,
    Output,
    Planner,
    Proposal,
    Request,
    Send,
    Sender,
    Trigger,
    Verdict,
    random_order,
)
from covey.protocol.records import NOBODY, OWNER


class NoEscrow(Node):
    """A prepared server goes on claiming what it has offered."""

    def _prepare(self, now: float, client: int, offer: Offer) -> None:
        super()._prepare(now, client, offer)
        self._holdings.escrow = None


class PoseMovesWhileLocked(Node):
    """A better pose is committed at once, whatever the lock says."""

    def adopt_pose(self, now: float, pose: Pose2) -> list[Output]:
        """Commit a better pose at any time."""
        outputs: list[Output] = []
        self._adopt(pose, Cause.PROOF, outputs)
        return self._finish(outputs)


class ServerGivesUp(Node):
    """A prepared server that hears nothing takes back what it has offered."""

    def poll(self, now: float, rng: np.random.Generator) -> list[Output]:
        """Give up instead of sending the offer again."""
        if self.lock is Lock.SERVER_PREPARED and now >= self._resend_at and self._pending is not None:
            self._release(self._pending.to)
        return super().poll(now, rng)


class CommitsInTwoSteps(Node):
    """A client takes what it is given at once, and writes the rest when the server has answered."""

    _rest: Commit | None = None

    def _apply(self, commit: Commit, server: int) -> None:
        mine = commit.records.indices[commit.records.values[:, OWNER] == self.agent]
        if server != self.agent:
            self._rest = commit
            before = self.poses[server]
            commit = Commit(commit.sender, commit.trade, commit.records.select(mine), before, commit.client_pose)
        super()._apply(commit, server)

    def receive(self, now: float, message: Message, rng: np.random.Generator) -> list[Output]:
        """Take the second step with the acknowledgement."""
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
        """Drop the partner before anything else."""
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
        """Commit the held pose, whatever goes on."""
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


class NoAdoption(Node):
    """What the dead owned is left to nobody."""

    def _adopt_orphans(self, outputs: list[Output]) -> None:
        pass


class NoAntiEntropy(Node):
    """Agents never tell each other their maps."""

    def _send_map(self, to: int, outputs: list[Output]) -> None:
        pass


class BuriedForEver(Node):
    """An agent that was declared dead is not listened to when it comes back."""

    def _hear(self, now: float, sender: Sender, outputs: list[Output]) -> bool:
        assert self._membership is not None
        return sender.agent in self._membership.living and super()._hear(now, sender, outputs)


class ForgetsUnsettledTrades(Node):
    """A client whose server was declared dead forgets that it has committed."""

    def _on_death(self, agent: int, outputs: list[Output]) -> None:
        super()._on_death(agent, outputs)
        self._unsettled.clear()


class ReclaimsWithoutGeneration(Node):
    """A server whose client was declared dead goes on as if the trade had never been offered."""

    def _take_back(self, client: int, outputs: list[Output]) -> None:
        if self.lock is Lock.SERVER_PREPARED and self._pending is not None and self._pending.to == client:
            self._release(client, Trigger.PARTNER_DEAD)


class WaitsForTheDead(Node):
    """A server stays prepared for a client that is dead."""

    def _take_back(self, client: int, outputs: list[Output]) -> None:
        pass


class RestartsInTheSameLife(Node):
    """An agent that starts again with an old memory believes that nothing has happened meanwhile."""

    @classmethod
    def restart(
        cls,
        agent: int,
        team: Sequence[int],
        memory: Memory,
        planner: Planner,
        *,
        incarnation: int,
        order: Order = random_order,
        options: NodeOptions | None = None,
        links: Links | None = None,
        assigned: NDArray[np.int64] | None = None,
    ) -> Node:
        """Start in the first life again."""
        return super().restart(
            agent,
            team,
            memory,
            planner,
            incarnation=1,
            order=order,
            options=options,
            links=links,
            assigned=assigned,
        )


class RemovedLandmarksComeBack(Node):
    """An agent forgets what was removed: what others still remember of it counts as news."""

    def _take_in(self, now: float, catalogue: Catalogue, outputs: list[Output]) -> None:
        landmarks = {k: record for k, record in catalogue.landmarks.items() if record.alive}
        super()._take_in(now, Catalogue(landmarks, catalogue.agents), outputs)


class LosesWhatALeaverOwned(Node):
    """What an agent owned that leaves is left to nobody: it is not among the dead."""

    def _orphans(self) -> NDArray[np.int64]:
        without = super()._orphans()
        owners = self.records.values[without, OWNER]
        stays = np.array([self.catalogue.is_present(int(owner)) for owner in owners], dtype=np.bool_)
        kept: NDArray[np.int64] = without[stays]
        return kept


class IgnoresNewWeights(Node):
    """An agent learns what landmarks are worth now, and goes on as before."""

    def _changed_from_outside(self) -> None:
        pass


class MapsWithoutChanges(Node):
    """Agents do not tell each other what an operator has changed."""

    def _send_map(self, to: int, outputs: list[Output]) -> None:
        outputs.append(Send(to, Map(self.sender, self.records.known(), self.poses.as_mapping())))


class AddedLandmarksAreNobodys(Node):
    """Only what somebody has owned is adopted."""

    def _orphans(self) -> NDArray[np.int64]:
        without = super()._orphans()
        kept: NDArray[np.int64] = without[self.records.values[without, OWNER] != NOBODY]
        return kept


MUTANTS: Mapping[str, type[Node]] = MappingProxyType(
    {
        "no-escrow": NoEscrow,
        "pose-moves-while-locked": PoseMovesWhileLocked,
        "no-adoption": NoAdoption,
        "server-gives-up": ServerGivesUp,
        "no-anti-entropy": NoAntiEntropy,
        "buried-for-ever": BuriedForEver,
        "commit-in-two-steps": CommitsInTwoSteps,
        "forgets-answers": ForgetsItsAnswers,
        "busy-is-failure": BusyIsFailure,
        "never-refills": NeverRefills,
        "trades-while-moving": TradesWhileMoving,
        "trusts-offers": TrustsOffers,
        "forgets-unsettled-trades": ForgetsUnsettledTrades,
        "reclaims-without-generation": ReclaimsWithoutGeneration,
        "waits-for-the-dead": WaitsForTheDead,
        "restarts-in-the-same-life": RestartsInTheSameLife,
        "removed-landmarks-come-back": RemovedLandmarksComeBack,
        "loses-what-a-leaver-owned": LosesWhatALeaverOwned,
        "ignores-new-weights": IgnoresNewWeights,
        "maps-without-changes": MapsWithoutChanges,
        "added-landmarks-are-nobodys": AddedLandmarksAreNobodys,
    }
)
"""The protocols by name."""
