"""One agent's part in the trading: messages and time in, messages and events out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from covey.errors import ArgumentError
from covey.geometry import Pose2, wrap_angle
from covey.protocol.holdings import Escrow, Holdings
from covey.protocol.messages import (
    Abort,
    Ack,
    Busy,
    Commit,
    Heartbeat,
    Message,
    Nothing,
    Offer,
    Reason,
    Request,
    Sender,
    TradeId,
)
from covey.protocol.outputs import (
    Cause,
    GoTo,
    OfferDeclined,
    Output,
    PoseOptimized,
    Publish,
    Send,
    TradeCommitted,
    WaypointAbandoned,
)
from covey.protocol.partners import NodeOptions, Order, Partners, random_order
from covey.protocol.planner import AgentState, Planner, Proposal, Verdict, coverage_score, is_better, judge
from covey.protocol.records import LandmarkRecords, PoseRecords, RecordSlice, difference
from covey.protocol.state import Lock, Trigger, next_state


class Node:
    """An agent of the team: it trades landmarks and decides where to go, with time and randomness from its caller.

    Parameters
    ----------
    agent : int
        This agent.
    team : sequence of int
        All agents, this one among them.
    records : LandmarkRecords
        Who owns what at the start; copied.
    poses : mapping of agent to Pose2
        The poses at the start, at least this agent's own.
    planner : Planner
    incarnation : int, keyword-only
        Which life of the agent this is; `records` must name its landmarks with the same number.
    order : Order, keyword-only
        Which partner is asked first; random by default.
    options : NodeOptions, keyword-only

    Raises
    ------
    ArgumentError
        If the agent is not in the team, is there twice, or has no pose.

    Notes
    -----
    Source: Sposato (2016), Algorithms 2, 4 and 5.  Deviation: V6, V7, V8, V9, V11.  Every method returns a list of
    outputs that the caller must carry out in order: `Send`, `Publish`, `GoTo`, and events for the log.  After each
    call, `next_deadline` tells when `poll` is wanted next.  See `covey.transports.Loopback` for an example.
    """

    def __init__(
        self,
        agent: int,
        team: Sequence[int],
        records: LandmarkRecords,
        poses: Mapping[int, Pose2],
        planner: Planner,
        *,
        incarnation: int = 1,
        order: Order = random_order,
        options: NodeOptions | None = None,
    ) -> None:
        if list(team).count(agent) != 1:
            raise ArgumentError(f"team: expected agent {agent} once among the agents, got {list(team)}")
        if agent not in poses:
            raise ArgumentError(f"poses: expected the pose of agent {agent}, got those of {sorted(poses)}")
        self.agent = agent
        self.sender = Sender(agent, incarnation)
        self.lock = Lock.IDLE
        self.at_waypoint = True
        self._planner = planner
        self._options = options or NodeOptions()
        self._holdings = Holdings(self.sender, records, poses)
        self._partners = Partners(agent, [other for other in team if other != agent], order, self._options)
        self._waypoint = self.pose
        self._open = TradeId(agent, incarnation, 0)  # the newest trade opened as client
        self._asked_at = 0.0
        self._asked_in_epoch = 0
        self._pending: Send | None = None  # sent again until it is answered
        self._resend_at = 0.0
        self._give_up_at = 0.0
        self._answers: dict[int, tuple[TradeId, Busy | Nothing | Offer | Ack | None]] = {}  # the newest, by client
        self._committed: dict[int, int] = {}
        self._served: dict[int, int] = {}
        self._sequence = 0
        self._published: tuple[bool, int] | None = None

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
    def avoid(self) -> tuple[Pose2, ...]:
        """Poses that the agent could not reach."""
        return self._holdings.avoid

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
        """Whether the agent has nothing left to do by itself: IDLE, at its waypoint, Q empty."""
        return self.lock is Lock.IDLE and self.at_waypoint and not self._partners.waiting

    def claims(self) -> NDArray[np.int64]:
        """Return the sorted landmarks that the agent claims: owned and not in escrow."""
        return self._holdings.claims()

    def next_deadline(self) -> float | None:
        """Return when `poll` is wanted, seconds; it may have passed already.  None: not before something comes in."""
        if self.lock is not Lock.IDLE:
            return self._resend_at
        return self._partners.ask_at if self.at_waypoint and self._partners.waiting else None

    # What happens to the agent.

    def start(self, now: float, rng: np.random.Generator) -> list[Output]:
        """Begin the mission: fill Q and optimise the pose for the first landmarks (Algorithm 2)."""
        outputs: list[Output] = []
        self._partners.refill()
        self._partners.rest(now, 0.0, rng)
        self._improve(outputs)
        return self._finish(outputs)

    def poll(self, now: float, rng: np.random.Generator) -> list[Output]:
        """Do what is due: ask the next partner in Q, or send again what got no answer."""
        outputs: list[Output] = []
        if self.lock is Lock.IDLE:
            if self.at_waypoint and self._partners.waiting and now >= self._partners.ask_at:
                self._ask(now, rng, outputs)
        elif now >= self._resend_at and self._pending is not None:
            if self.lock is Lock.CLIENT_WAIT and now >= self._give_up_at:
                outputs.append(Send(self._pending.to, Abort(self.sender, self._open, Reason.STALE)))
                self._move(Trigger.GIVE_UP)
                self._partners.back_off(now, 0.0, rng)
            else:
                self._send_until_answered(now, self._pending, outputs)
        return self._finish(outputs)

    def receive(self, now: float, message: Message, rng: np.random.Generator) -> list[Output]:
        """Take a message in; one that was seen before changes nothing and gets the same answer."""
        outputs: list[Output] = []
        match message:
            case Request():
                self._on_request(now, message, outputs)
            case Nothing() if self._waits_for(message.trade):
                self.poses.merge(message.sender.agent, message.pose)
                self._partners.drop(message.sender.agent)
                self._move(Trigger.NOTHING)
                self._partners.rest(now, now - self._asked_at, rng)
            case Busy() if self._waits_for(message.trade):
                self._move(Trigger.BUSY)
                self._partners.back_off(now, now - self._asked_at, rng)
            case Offer():
                self._on_offer(now, message, rng, outputs)
            case Commit():
                self._on_commit(now, message, rng, outputs)
            case Ack() if self.lock is Lock.CLIENT_DONE and message.trade == self._open:
                self._move(Trigger.ACK)
                self._partners.rest(now, now - self._asked_at, rng)
                self._improve(outputs)
            case Abort():
                self._on_abort(message)
            case Heartbeat() if message.sender.agent != self.agent:
                self.poses.merge(message.sender.agent, message.pose)
            case _:
                pass  # a late answer to a trade that is over
        return self._finish(outputs)

    def waypoint_reached(self, now: float) -> list[Output]:
        """Report that the vehicle is at the pose of the last `GoTo`; trading may go on."""
        self.at_waypoint = True
        return self._finish([])

    def waypoint_unreachable(self, now: float, held_pose: Pose2) -> list[Output]:
        """Report that the pose of the last `GoTo` cannot be reached, or not be kept, and the vehicle holds another.

        The pose held is committed, Q is filled again, the waypoint is never offered again, and `WaypointAbandoned`
        reports what it cost: the one place where the team's score may fall.  Does nothing while a trade goes on, which
        is judged at the committed pose; to hold the committed pose is to have reached it.

        Notes
        -----
        Deviation: V8.
        """
        outputs: list[Output] = []
        if self.lock is Lock.IDLE and held_pose == self.pose:
            self.at_waypoint = True
        elif self.lock is Lock.IDLE:
            abandoned = self.pose
            before, after = self._score(abandoned), self._score(held_pose)
            self._holdings.never_again(abandoned)
            self._commit_pose(held_pose)
            self._waypoint = held_pose
            self.at_waypoint = True
            outputs.append(WaypointAbandoned(self.agent, abandoned, held_pose, before, after))
        return self._finish(outputs)

    def adopt_pose(self, now: float, pose: Pose2) -> list[Output]:
        """Commit a better pose that was found elsewhere, for example by a proof.

        Nothing happens, and no event is returned, unless the agent is IDLE, at its waypoint, and the pose is strictly
        better for its landmarks and not one that it could not reach.
        """
        outputs: list[Output] = []
        if self.lock is Lock.IDLE and self.at_waypoint:
            self._adopt(pose, Cause.PROOF, outputs)
        return self._finish(outputs)

    def heartbeat(self) -> Heartbeat:
        """Return a new heartbeat that tells how the agent is now."""
        self._sequence += 1
        return Heartbeat(
            self.sender,
            self._sequence,
            self.quiescent,
            self.epoch,
            self._holdings.pose_record,
            MappingProxyType(dict(self._committed)),
            MappingProxyType(dict(self._served)),
        )

    # Client.

    def _ask(self, now: float, rng: np.random.Generator, outputs: list[Output]) -> None:
        server = self._partners.next(self.poses, rng)
        own = self._holdings
        self._open = TradeId(*self.sender, self._open.number + 1)
        self._asked_at = now
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
        if not self._waits_for(offer.trade):
            outputs.append(Send(server, Abort(self.sender, offer.trade, Reason.STALE)))
            return
        own = self._holdings
        reason = Reason.STALE
        if own.epoch == self._asked_in_epoch and not own.contradicts(offer.records) and not own.is_ahead(offer.records):
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
        self.poses.merge(client, request.pose)
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

    def _release(self, client: int) -> None:
        newest, _ = self._answers[client]
        self._answers[client] = (newest, None)
        self._holdings.escrow = None
        self._move(Trigger.ABORT)

    def _on_commit(self, now: float, commit: Commit, rng: np.random.Generator, outputs: list[Output]) -> None:
        client = commit.sender.agent
        newest, answer = self._answers.get(client, (None, None))
        if commit.trade != newest or not isinstance(answer, Offer | Ack):
            return
        if isinstance(answer, Offer):
            answer = Ack(self.sender, commit.trade)
            self._answers[client] = (commit.trade, answer)
            self._holdings.escrow = None
            self._apply(commit, self.agent)
            self._served[client] = self._served.get(client, 0) + 1
            self._move(Trigger.COMMIT)
            self._partners.rest(now, 0.0, rng)
            self._improve(outputs)
        outputs.append(Send(client, answer))

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

    def _finish(self, outputs: list[Output]) -> list[Output]:
        if self.lock is Lock.IDLE and self.pose != self._waypoint:
            self._waypoint = self.pose
            self.at_waypoint = False
            outputs.append(GoTo(self._waypoint))
        quiescent = self.quiescent
        status = (quiescent, self.epoch if quiescent else 0)
        if status != self._published:
            self._published = status
            outputs.append(Publish(self.heartbeat()))
        return outputs


def _proposal(offer: Offer, client_landmarks: NDArray[np.int64]) -> Proposal:
    server = np.concatenate([difference(offer.records.indices, offer.give), offer.want])
    client = np.concatenate([difference(client_landmarks, offer.want), offer.give])
    server.sort()
    client.sort()
    return Proposal(offer.server_pose, offer.client_pose, server, client)
