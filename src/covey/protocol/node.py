"""One agent's part in the mission: messages and time in, messages and events out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from covey.geometry import Pose2
from covey.protocol.adoption import map_digest
from covey.protocol.catalogue import EMPTY, AgentChange, Catalogue
from covey.protocol.holdings import Memory
from covey.protocol.member import Member
from covey.protocol.membership import Status
from covey.protocol.messages import (
    Abort,
    Ack,
    Busy,
    Change,
    Commit,
    Heartbeat,
    Map,
    Message,
    Nothing,
    Offer,
    Reason,
    Request,
)
from covey.protocol.outputs import (
    Cause,
    GoTo,
    OfferStands,
    Output,
    Publish,
    Send,
    WaypointAbandoned,
)
from covey.protocol.partners import Links, NodeOptions, Order, random_order
from covey.protocol.planner import Planner
from covey.protocol.records import LandmarkRecords, PoseRecords
from covey.protocol.state import Lock, Trigger

_ACTIVE = (False, 0, b"")
"""What an agent says of itself while it has something to do."""


class Node(Member):
    """An agent of the team: it trades landmarks and decides where to go, with time and randomness from its caller.

    Parameters
    ----------
    agent : int
        This agent.
    team : sequence of int
        All agents, this one among them.
    records : LandmarkRecords
        Who owns what at the start, copied; `LandmarkRecords.unknown` for an agent that has lost its memory.
    poses : mapping of agent to Pose2, or PoseRecords
        The poses at the start, at least this agent's own.
    planner : Planner
    incarnation : int, keyword-only
        Which life of the agent this is; `records` must name its landmarks with the same number.
    order : Order, keyword-only
        Which partner is asked first; random by default.
    options : NodeOptions, keyword-only
    links : Links, keyword-only
        Which committed poses may trade with each other; all by default.  Needs ``options.membership``.
    avoid : tuple of Pose2, keyword-only
        Poses that the agent could not reach in an earlier life.
    catalogue : Catalogue, keyword-only
        What has changed since the mission began; `team` and `records` are those that it began with, but for what
        the agent remembers.
    assigned : array, shape (n,), keyword-only
        Which agent takes each landmark first that nobody has owned yet; whoever sees it best by default.  A team all of
        whose agents begin with `LandmarkRecords.unknown` starts from this.

    Raises
    ------
    ArgumentError
        If the agent is not in the team, is there twice, or has no pose, or there are links without membership.

    Notes
    -----
    Source: Sposato (2016), Algorithms 2, 4 and 5.  Deviation: V6, V7, V8, V9, V11.  Every method returns a list of
    outputs that the caller must carry out in order: `Send`, `Publish`, `GoTo`, and events for the log.  After each
    call, `next_deadline` tells when `poll` is wanted next.  See `covey.transports.Loopback` for an example.

    With ``options.membership`` the team survives crashes; the transport must then deliver heartbeats to nodes.
    """

    def __init__(
        self,
        agent: int,
        team: Sequence[int],
        records: LandmarkRecords,
        poses: Mapping[int, Pose2] | PoseRecords,
        planner: Planner,
        *,
        incarnation: int = 1,
        order: Order = random_order,
        options: NodeOptions | None = None,
        links: Links | None = None,
        avoid: tuple[Pose2, ...] = (),
        catalogue: Catalogue = EMPTY,
        assigned: NDArray[np.int64] | None = None,
    ) -> None:
        super().__init__(
            agent,
            team,
            records,
            poses,
            planner,
            incarnation=incarnation,
            order=order,
            options=options,
            links=links,
            avoid=avoid,
            catalogue=catalogue,
            assigned=assigned,
        )
        self._sequence = 0
        self._told_offer: Offer | None = None
        self._proved_at = -1
        self._digested_at: tuple[int, ...] = ()
        self._digest_then = b""

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
        """Build the node of an agent that has crashed, from what it remembers.

        The memory may be of any age.  What the earlier life owned is adopted like that of the dead, by whoever sees
        it best; `start` sends the vehicle to the remembered pose.

        Parameters
        ----------
        incarnation : int, keyword-only
            Above that of every earlier life.

        Raises
        ------
        ArgumentError
            As for a new node.
        """
        node = cls(
            agent,
            team,
            memory.records,
            memory.poses,
            planner,
            incarnation=incarnation,
            order=order,
            options=options,
            links=links,
            avoid=memory.avoid,
            catalogue=memory.catalogue,
            assigned=assigned,
        )
        node._waypoint = None
        return node

    def memory(self) -> Memory:
        """Return what a later life can be started from; one of any age will do."""
        own = self._holdings
        return Memory(own.records.copy(), own.poses.copy(), own.avoid, own.catalogue)

    @property
    def quiescent(self) -> bool:
        """Whether the agent has nothing left to do by itself.

        It is IDLE, at its waypoint, nobody is in Q that is in reach, and every landmark of its map has an owner that
        lives; or it has left.  With ``options.prove`` its pose has been proved as well.
        """
        return self._at_rest and not self.unproved

    @property
    def _at_rest(self) -> bool:
        return self.left or (super().quiescent and not self._orphaned)

    @property
    def unproved(self) -> bool:
        """Whether the agent has nothing left to do but to have its pose proved for its landmarks: see `pose_proved`."""
        return self._options.prove and self._proved_at != self.epoch and self._at_rest and not self.left

    @property
    def over(self) -> bool:
        """Whether the mission is over, as far as this agent knows: all that live are quiescent and have the same map.

        It may begin again, when somebody dies or returns.  Without ``options.membership`` the agent cannot know.
        """
        return self._membership is not None and self._detector.terminated

    def status(self, agent: int) -> Status:
        """Return what this agent thinks of another; without ``options.membership`` nobody dies."""
        return Status.ALIVE if self._membership is None else self._membership.status(agent)

    def next_deadline(self) -> float | None:
        """Return when `poll` is wanted, seconds; it may have passed already.  None: not before something comes in."""
        if self.left:
            return None
        if self.lock is not Lock.IDLE:
            deadline: float | None = self._resend_at
        else:
            deadline = self._partners.ask_at if self.at_waypoint and self._willing() else None
        if self._membership is None:
            return deadline
        tick = min(self._beat_at, self._map_at)
        return tick if deadline is None else min(deadline, tick)

    # What happens to the agent.

    def start(self, now: float, rng: np.random.Generator) -> list[Output]:
        """Begin the mission: fill Q and optimise the pose for the first landmarks (Algorithm 2)."""
        outputs: list[Output] = []
        if self.left:
            return outputs
        self._partners.refill()
        self._partners.rest(now, 0.0, rng)
        self._improve(outputs)
        if self._membership is not None:
            self._membership.start(now)
            self._beat_at = now + self._membership.options.heartbeat_every
            self._map_at = now + rng.random() * self._membership.options.map_every
        return self._finish(outputs)

    def poll(self, now: float, rng: np.random.Generator) -> list[Output]:
        """Do what is due: ask the next partner in Q, send again what got no answer, or tell the others of itself."""
        outputs: list[Output] = []
        if self.left:
            return outputs
        if self._membership is not None:
            self._tend(now, rng, outputs)
        if self.lock is Lock.IDLE:
            if self.at_waypoint and now >= self._partners.ask_at and self._willing():
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
        if isinstance(message, Change):
            return self.change(now, message.catalogue)
        if self.left:
            return outputs
        if isinstance(message, Map):  # it may be what introduces its sender
            self._take_in(now, message.catalogue, outputs)
        if self._membership is not None and not self._hear(now, message.sender, outputs):
            return self._finish(outputs)
        match message:
            case Request():
                self._on_request(now, message, outputs)
            case Nothing() if self._waits_for(message.trade):
                self.poses.merge(message.sender.agent, message.pose)
                if self.epoch == self._asked_in_epoch:
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
            case Ack():
                self._on_ack(now, message, rng, outputs)
            case Abort():
                self._on_abort(message)
            case Heartbeat() if message.sender.agent != self.agent:
                self._on_heartbeat(message)
            case Map():
                self._on_map(message)
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

    def pose_proved(self, now: float, epoch: int) -> list[Output]:
        """Report that no pose is better by more than counts for the landmarks that the agent had at this epoch.

        Nothing happens if its pose or landmarks have changed since.
        """
        self._proved_at = epoch
        return self._finish([])

    def suspect(self, agent: int) -> None:
        """Report that the transport has lost the connection to another; it is not asked until it is heard again."""
        if self._membership is not None:
            self._membership.lost(agent)

    def bury(self, now: float, agent: int) -> list[Output]:
        """Report that another is known to be dead, before its silence tells."""
        outputs: list[Output] = []
        if self._membership is not None and self._membership.bury(agent):
            self._on_death(agent, outputs)
        return self._finish(outputs)

    def change(self, now: float, catalogue: Catalogue) -> list[Output]:
        """Take in that landmarks or agents are others; Q is filled and Algorithm 3 follows.

        Added landmarks are nobody's at first and are adopted like those of the dead.  Who leaves is left out at once,
        and what it owned is adopted.  Who joins counts as dead until it is heard.  An agent that finds itself among
        those that leave says a last word, everything that it knows, and does nothing any more.

        Raises
        ------
        ArgumentError
            If the node has no ``options.membership``.
        """
        outputs: list[Output] = []
        if not self.left:
            self._take_in(now, catalogue, outputs)
        return self._finish(outputs)

    def leave(self, now: float) -> list[Output]:
        """Leave the mission; all others hear of it."""
        known = self.catalogue.agents.get(self.agent)
        specification = "" if known is None else known.specification
        gone = AgentChange(self.catalogue.version + 1, False, specification)
        return self.change(now, Catalogue(agents={self.agent: gone}))

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
            self._digest() if self.quiescent else b"",
        )

    def _digest(self) -> bytes:
        if self._membership is None:
            return b""
        known = (self.records.changes, self.poses.changes)
        if known != self._digested_at:
            self._digested_at, self._digest_then = known, map_digest(self.records, self.poses, self.catalogue)
        return self._digest_then

    def _tell_offer(self, outputs: list[Output]) -> None:
        """Report that an offer stands, or does so no more."""
        before, now = self._told_offer, self.offer
        if now is before:
            return
        for offer, stands in ((before, False), (now, True)):
            if offer is not None:
                client = offer.trade.client
                outputs.append(OfferStands(offer.trade, client, self.agent, offer.give, offer.want, stands))
        self._told_offer = now

    def _finish(self, outputs: list[Output]) -> list[Output]:
        self._tell_offer(outputs)
        if self.left:
            return outputs
        if self._membership is not None:
            self._adopt_orphans(outputs)
        if self.lock is Lock.IDLE:
            if self._pose_is_due and self.at_waypoint:
                self._pose_is_due = False
                self._improve(outputs)
            if self.pose != self._waypoint:
                self._waypoint = self.pose
                self.at_waypoint = False
                outputs.append(GoTo(self._waypoint))
        quiescent = self.quiescent
        status = (quiescent, self.epoch, self._digest()) if quiescent else _ACTIVE
        if status != self._published:
            self._published = status
            heartbeat = self.heartbeat()
            outputs.append(Publish(heartbeat))
            if self._membership is not None:
                self._detector.receive(heartbeat)
        return outputs
