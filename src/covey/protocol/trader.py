"""How one agent trades: the client's part, the server's part, and what both share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet

import numpy as np
from numpy.typing import NDArray

from covey.errors import ArgumentError
from covey.geometry import Pose2, wrap_angle
from covey.protocol.catalogue import Catalogue
from covey.protocol.holdings import Escrow, Holdings
from covey.protocol.membership import Membership, Status
from covey.protocol.messages import Abort, Ack, Busy, Commit, Nothing, Offer, Reason, Request, Sender, TradeId
from covey.protocol.outputs import Cause, OfferDeclined, Output, PoseOptimized, Send, TradeCommitted
from covey.protocol.partners import Links, NodeOptions, Order, Partners
from covey.protocol.planner import AgentState, Planner, Proposal, Verdict, coverage_score, is_better, judge
from covey.protocol.records import LandmarkRecords, PoseRecord, PoseRecords, RecordSlice, difference
from covey.protocol.state import Lock, Trigger, next_state


class Trader:
    """The trading half of a `Node`: what it holds, what others may look at, and Algorithms 3 to 6.

    Notes
    -----
    Source: Sposato (2016), Algorithms 2, 4 and 5.  Deviation: V6, V7, V8, V9, V11.
    """

    def __init__(
        self,
        agent: int,
        team: Sequence[int],
        records: LandmarkRecords,
        poses: Mapping[int, Pose2] | PoseRecords,
        planner: Planner,
        *,
        incarnation: int,
        order: Order,
        options: NodeOptions | None,
        links: Links | None,
        avoid: tuple[Pose2, ...],
        catalogue: Catalogue,
    ) -> None:
        team = [other for other in [*team, *(set(catalogue.agents) - set(team))] if catalogue.is_present(other)]
        if team.count(agent) != 1 and catalogue.is_present(agent):
            raise ArgumentError(f"team: expected agent {agent} once among the agents, got {team}")
        if agent not in poses:
            raise ArgumentError(f"poses: expected the pose of agent {agent}, got those of {sorted(poses)}")
        if links is not None and (options is None or options.membership is None):
            raise ArgumentError("links: expected options.membership as well; who is in reach is heard from heartbeats")
        if catalogue:
            planner.learn(catalogue)
        self.agent = agent
        self.sender = Sender(agent, incarnation)
        self.lock = Lock.IDLE
        self.at_waypoint = True
        self._planner = planner
        self._options = options or NodeOptions()
        self._links = links
        self._holdings = Holdings(self.sender, records, poses, avoid, catalogue)
        others = [other for other in team if other != agent]
        self._membership = (
            None if self._options.membership is None else Membership(self.sender, others, self._options.membership)
        )
        self._partners = Partners(agent, others, order, self._options)
        self._waypoint: Pose2 | None = self.pose
        self._pose_is_due = False  # the landmarks changed from outside: Algorithm 3 at the next chance
        self._trades = 0  # opened as client
        self._open = TradeId(agent, incarnation, 0)  # the newest trade opened as client
        self._asked_at = 0.0
        self._asked_in_epoch = 0
        self._pending: Send | None = None  # sent again until it is answered
        self._resend_at = 0.0
        self._give_up_at = 0.0
        self._answers: dict[int, tuple[TradeId, Busy | Nothing | Offer | Ack | None]] = {}  # the newest, by client
        self._unsettled: dict[int, Commit] = {}  # committed, but not acknowledged when the server was declared dead
        self._committed: dict[int, int] = {}
        self._served: dict[int, int] = {}

    # What others may look at.

    @property
    def pose(self) -> Pose2:
        """The committed pose: what trades are judged at, whether or not the vehicle is there yet."""
        return self._holdings.pose_record.pose

    @property
    def landmarks(self) -> NDArray[np.int64]:
        """Sorted landmarks that the agent watches, those in escrow among them, shape (k,)."""
        return self._holdings.own.indices

    @property
    def records(self) -> LandmarkRecords:
        """The agent's map: the newest record it knows of each landmark."""
        return self._holdings.records

    @property
    def poses(self) -> PoseRecords:
        """The newest committed pose it knows of each agent."""
        return self._holdings.poses

    @property
    def escrow(self) -> Escrow | None:
        """What the agent holds in escrow as a prepared server."""
        return self._holdings.escrow

    @property
    def options(self) -> NodeOptions:
        """Waiting times, and what is asked of the agent."""
        return self._options

    @property
    def offer(self) -> Offer | None:
        """The offer that stands while the agent is a prepared server."""
        message = None if self._pending is None else self._pending.message
        return message if isinstance(message, Offer) else None

    @property
    def avoid(self) -> tuple[Pose2, ...]:
        """Poses that the agent could not reach."""
        return self._holdings.avoid

    @property
    def catalogue(self) -> Catalogue:
        """What it knows to have changed since the mission began."""
        return self._holdings.catalogue

    @property
    def partners(self) -> frozenset[int]:
        """The set Q: whom the agent still has to ask."""
        return frozenset(self._partners.waiting)

    @property
    def epoch(self) -> int:
        """How often the agent's own pose or landmarks have changed."""
        return self._holdings.epoch

    @property
    def quiescent(self) -> bool:
        """Whether the agent has nothing left to do by itself: IDLE, at its waypoint, nobody in Q that is in reach."""
        return self.lock is Lock.IDLE and self.at_waypoint and not self._to_ask()

    def claims(self) -> NDArray[np.int64]:
        """Return the sorted landmarks that the agent claims: owned and not in escrow."""
        return self._holdings.claims()

    # Client.

    def _ask(self, now: float, rng: np.random.Generator, outputs: list[Output]) -> None:
        server = self._partners.next(self.poses, rng, self._willing())
        self._asked_at = now
        if server in self._unsettled:
            self._open = self._unsettled[server].trade
            self._move(Trigger.RESUME)
            self._send_until_answered(now, Send(server, self._unsettled[server]), outputs)
            return
        own = self._holdings
        self._trades += 1
        self._open = TradeId(*self.sender, self._trades)
        self._asked_in_epoch = own.epoch
        self._give_up_at = now + self._partners.patience()
        self._move(Trigger.ASK)
        request = Request(self.sender, self._open, own.pose_record, own.own, own.avoid)
        self._send_until_answered(now, Send(server, request), outputs)

    def _waits_for(self, trade: TradeId) -> bool:
        return self.lock is Lock.CLIENT_WAIT and trade == self._open

    def _on_offer(self, now: float, offer: Offer, rng: np.random.Generator, outputs: list[Output]) -> None:
        server = offer.sender.agent
        if self.lock is Lock.CLIENT_DONE and offer.trade == self._open and self._pending is not None:
            outputs.append(self._pending)
            return
        if server in self._unsettled and self._unsettled[server].trade == offer.trade:
            outputs.append(Send(server, self._unsettled[server]))
            return
        if not self._waits_for(offer.trade):
            outputs.append(Send(server, Abort(self.sender, offer.trade, Reason.STALE)))
            return
        own = self._holdings
        reason = Reason.STALE
        fresh = own.epoch == self._asked_in_epoch and own.are_alive(offer.records.indices)
        if fresh and not own.contradicts(offer.records) and not own.is_ahead(offer.records):
            proposal = _proposal(offer, self.landmarks)
            verdict = self._judge(AgentState(server, offer.pose.pose, offer.records.indices), own.state, proposal)
            if verdict.accepted:
                self._commit(now, offer, proposal, verdict, outputs)
                return
            reason = Reason.NO_GAIN
            self._partners.drop(server)
        self._move(Trigger.DECLINE)
        self._partners.back_off(now, now - self._asked_at, rng)
        outputs.append(Send(server, Abort(self.sender, offer.trade, reason)))
        outputs.append(OfferDeclined(offer.trade, self.agent, server, reason))

    def _commit(self, now: float, offer: Offer, proposal: Proposal, verdict: Verdict, outputs: list[Output]) -> None:
        """Apply both sets and both poses: the commit point, one step with no message in the middle."""
        server = offer.sender.agent
        records = RecordSlice.join(
            offer.records.select(offer.give).next(*self.sender),
            self._holdings.own.select(offer.want).next(*offer.sender),
        )
        commit = Commit(
            self.sender,
            offer.trade,
            records,
            offer.pose.next(proposal.server_pose),
            self._holdings.pose_record.next(proposal.client_pose),
        )
        self._apply(commit, server)
        self._committed[server] = self._committed.get(server, 0) + 1
        self._move(Trigger.ACCEPT)
        self._send_until_answered(now, Send(server, commit), outputs)
        outputs.append(
            TradeCommitted(
                offer.trade,
                self.agent,
                server,
                proposal.client_pose,
                proposal.server_pose,
                self.landmarks,
                proposal.server_landmarks,
                len(records.indices),
                verdict.before,
                verdict.after,
            )
        )

    def _on_ack(self, now: float, ack: Ack, rng: np.random.Generator, outputs: list[Output]) -> None:
        unsettled = self._unsettled.get(ack.sender.agent)
        if unsettled is not None and unsettled.trade == ack.trade:
            del self._unsettled[ack.sender.agent]
        if self.lock is Lock.CLIENT_DONE and ack.trade == self._open:
            self._move(Trigger.ACK)
            self._partners.rest(now, now - self._asked_at, rng)
            self._improve(outputs)

    # Server.

    def _on_request(self, now: float, request: Request, outputs: list[Output]) -> None:
        client, trade = request.sender.agent, request.trade
        newest, answer = self._answers.get(client, (None, None))
        if newest is None or trade > newest:
            if isinstance(answer, Offer):
                self._release(client)  # a client that opens another trade has closed the one before
            answer = self._answer(now, request)
            self._answers[client] = (trade, answer)
        elif trade < newest or answer is None:
            return  # the client has gone on
        outputs.append(Send(client, answer))

    def _answer(self, now: float, request: Request) -> Busy | Nothing | Offer:
        own, client = self._holdings, request.sender.agent
        if self.lock is not Lock.IDLE or not self.at_waypoint or own.contradicts(request.records):
            return Busy(self.sender, request.trade)
        known = own.are_alive(request.records.indices)  # else one of the two has yet to hear of a change
        if not known or (self._membership is not None and own.is_ahead(request.records)):
            return Busy(self.sender, request.trade)
        self.poses.merge(client, request.pose)
        if self._links is not None and not self._links(self.agent, self.pose, client, request.pose.pose):
            self._partners.drop(client)
            return Nothing(self.sender, request.trade, own.pose_record)
        state = AgentState(client, request.pose.pose, request.records.indices, request.avoid)
        proposal = self._planner.propose(own.state, state)
        if proposal is None or not self._judge(own.state, state, proposal).accepted:
            self._partners.drop(client)
            return Nothing(self.sender, request.trade, own.pose_record)
        offer = Offer(
            self.sender,
            request.trade,
            own.pose_record,
            own.own,
            difference(self.landmarks, proposal.server_landmarks),
            difference(state.landmarks, proposal.client_landmarks),
            proposal.server_pose,
            proposal.client_pose,
        )
        self._prepare(now, client, offer)
        return offer

    def _prepare(self, now: float, client: int, offer: Offer) -> None:
        self._move(Trigger.OFFER)
        self._holdings.escrow = Escrow(offer.trade, offer.give)
        self._send_until_answered(now, Send(client, offer), [])

    def _release(self, client: int, trigger: Trigger = Trigger.ABORT) -> None:
        newest, _ = self._answers[client]
        self._answers[client] = (newest, None)
        self._holdings.escrow = None
        self._move(trigger)

    def _on_commit(self, now: float, commit: Commit, rng: np.random.Generator, outputs: list[Output]) -> None:
        client = commit.sender.agent
        newest, answer = self._answers.get(client, (None, None))
        if newest is not None and commit.trade < newest:
            return
        if commit.trade == newest and isinstance(answer, Offer):
            self._answers[client] = (commit.trade, Ack(self.sender, commit.trade))
            self._holdings.escrow = None
            self._apply(commit, self.agent)
            self._served[client] = self._served.get(client, 0) + 1
            self._move(Trigger.COMMIT)
            self._partners.rest(now, 0.0, rng)
            self._improve(outputs)
        elif commit.trade != newest or not isinstance(answer, Ack):
            # Prepared by an earlier life, or before the client was declared dead: the records decide.
            if self.lock is Lock.SERVER_PREPARED:
                return
            self._answers[client] = (commit.trade, Ack(self.sender, commit.trade))
            self._learn(commit.records, {client: commit.client_pose, self.agent: commit.server_pose})
        outputs.append(Send(client, Ack(self.sender, commit.trade)))

    def _on_abort(self, abort: Abort) -> None:
        client = abort.sender.agent
        newest, answer = self._answers.get(client, (None, None))
        if newest is not None and (abort.trade < newest or (isinstance(answer, Ack) and abort.trade == newest)):
            return
        if isinstance(answer, Offer):
            if abort.reason is Reason.NO_GAIN and abort.trade == newest:
                self._partners.drop(client)
            self._release(client)
        self._answers[client] = (abort.trade, None)

    # Both.

    def _willing(self) -> AbstractSet[int]:
        """Return whom of Q it makes sense to ask now: those that are in reach and not suspect."""
        asked = self._to_ask()
        if self._membership is None:
            return asked
        return {agent for agent in asked if self._membership.status(agent) is Status.ALIVE}

    def _to_ask(self) -> AbstractSet[int]:
        """Return whom of Q the agent can ask, suspects among them."""
        waiting = self._partners.waiting
        if self._links is None:
            return waiting
        return {a for a in waiting if a in self.poses and self._links(self.agent, self.pose, a, self.poses.pose(a))}

    def _move(self, trigger: Trigger) -> None:
        self.lock = next_state(self.lock, trigger)
        if self.lock is Lock.IDLE:
            self._pending = None

    def _send_until_answered(self, now: float, send: Send, outputs: list[Output]) -> None:
        self._pending = send
        self._resend_at = now + self._options.resend_after
        outputs.append(send)

    def _apply(self, commit: Commit, server: int) -> None:
        self._holdings.apply(commit, server)
        self._partners.refill()

    def _commit_pose(self, pose: Pose2) -> None:
        self._holdings.commit_pose(pose)
        self._partners.refill()

    def _score(self, pose: Pose2) -> float:
        return coverage_score(self._planner, self.agent, pose, self.landmarks)

    def _judge(self, server: AgentState, client: AgentState, proposal: Proposal) -> Verdict:
        for state, pose in ((server, proposal.server_pose), (client, proposal.client_pose)):
            if pose != state.pose and self._is_avoided(pose, state.avoid):
                return Verdict(False, 0.0, 0.0)
        return judge(self._planner, server, client, proposal)

    def _is_avoided(self, pose: Pose2, avoid: tuple[Pose2, ...]) -> bool:
        return any(
            np.hypot(pose.x - other.x, pose.y - other.y) <= self._options.same_position
            and abs(wrap_angle(pose.yaw - other.yaw)) <= self._options.same_yaw
            for other in avoid
        )

    def _improve(self, outputs: list[Output]) -> None:
        if len(self.landmarks) == 0:
            return  # every pose is as good: keep this one (V11)
        pose = self._planner.improve(self.agent, self.pose, self.landmarks)
        if pose is not None:
            self._adopt(pose, Cause.OPTIMIZER, outputs)

    def _adopt(self, pose: Pose2, cause: Cause, outputs: list[Output]) -> None:
        before, after = self._score(self.pose), self._score(pose)
        if is_better(before, after) and not self._is_avoided(pose, self._holdings.avoid):
            self._commit_pose(pose)
            outputs.append(PoseOptimized(self.agent, pose, before, after, cause))

    def _learn(self, records: RecordSlice, poses: Mapping[int, PoseRecord]) -> None:
        """Merge what another knows, outside of a trade."""
        if self._holdings.learn(records, poses):
            self._changed_from_outside()

    def _changed_from_outside(self) -> None:
        self._partners.refill()
        self._pose_is_due = True


def _proposal(offer: Offer, client_landmarks: NDArray[np.int64]) -> Proposal:
    server = np.concatenate([difference(offer.records.indices, offer.give), offer.want])
    client = np.concatenate([difference(client_landmarks, offer.want), offer.give])
    server.sort()
    client.sort()
    return Proposal(offer.server_pose, offer.client_pose, server, client)
