"""One agent among others: who lives, who comes and goes, and what there is to see."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from covey.errors import ArgumentError
from covey.geometry import Pose2
from covey.protocol.adoption import adopters, orphans
from covey.protocol.catalogue import Catalogue
from covey.protocol.membership import Hearing
from covey.protocol.messages import Abort, Commit, Heartbeat, Map, Reason, Sender
from covey.protocol.outputs import (
    AgentBuried,
    AgentJoined,
    AgentLeft,
    AgentReturned,
    LandmarksAdopted,
    LandmarksChanged,
    Output,
    Send,
)
from covey.protocol.partners import Links, NodeOptions, Order
from covey.protocol.planner import Planner
from covey.protocol.records import LandmarkRecords, PoseRecords
from covey.protocol.state import Lock, Trigger
from covey.protocol.termination import TerminationDetector
from covey.protocol.trader import Trader


class Member(Trader):
    """The part of a `Node` that reckons with others: heartbeats, maps, adoption, and changes of the mission."""

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
        assigned: NDArray[np.int64] | None,
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
        )
        self._detector = TerminationDetector(team if self._membership is None else self._membership.living)
        self._beat_at = 0.0
        self._map_at = 0.0
        self._maps_from: set[int] = set()  # whose map has arrived in this life
        self._orphaned = False
        self._assigned = assigned
        self._adopted_at: tuple[int, ...] = ()
        self._published: tuple[bool, int, bytes] | None = None

    @property
    def left(self) -> bool:
        """Whether the agent takes part no more: it says nothing and does nothing."""
        return not self._holdings.present

    # Landmarks and agents come and go.

    def _take_in(self, now: float, catalogue: Catalogue, outputs: list[Output]) -> None:
        """Go by what is newer in a catalogue."""
        known, own = self.catalogue, self._holdings
        merged = known.merged(catalogue)
        if merged is known:
            return
        if self._membership is None:
            raise ArgumentError("change: expected options.membership; landmarks are adopted by who lives")
        before = self._score(self.pose)
        self._planner.learn(merged)
        own.change(merged)
        landmarks = [k for k, record in merged.landmarks.items() if record != known.landmarks.get(k)]
        if landmarks:
            changed = np.array(sorted(landmarks), dtype=np.int64)
            outputs.append(LandmarksChanged(self.agent, changed, before, self._score(self.pose)))
        for agent, record in sorted(merged.agents.items()):
            if record == known.agents.get(agent) or agent == self.agent:
                continue
            if record.present:
                self._membership.join(now, agent)
                outputs.append(AgentJoined(self.agent, agent))
            else:
                self._on_leave(agent, outputs)
        self._changed_from_outside()
        if self.left:
            self._say_farewell(outputs)

    def _on_leave(self, agent: int, outputs: list[Output]) -> None:
        assert self._membership is not None
        self._membership.leave(agent)
        outputs.append(AgentLeft(self.agent, agent))
        self._part_with(agent, outputs)

    def _say_farewell(self, outputs: list[Output]) -> None:
        """Withdraw an open request, and tell all others everything: above all that this agent has left."""
        if self.lock is Lock.CLIENT_WAIT and self._pending is not None:
            outputs.append(Send(self._pending.to, Abort(self.sender, self._open, Reason.STALE)))
        self._tell_all(outputs)
        outputs.append(AgentLeft(self.agent, self.agent))

    def _tell_all(self, outputs: list[Output]) -> None:
        """Tell all that live everything."""
        assert self._membership is not None
        for agent in self._membership.living:
            if agent != self.agent:
                self._send_map(agent, outputs)

    # Others live and die.

    def _tend(self, now: float, rng: np.random.Generator, outputs: list[Output]) -> None:
        """Do what is due with or without trades: look who is silent, and tell the others of itself."""
        assert self._membership is not None
        if now >= self._beat_at:
            self._beat_at = now + self._membership.options.heartbeat_every
            for agent in self._membership.silenced(now):
                self._on_death(agent, outputs)
            self._published = None
        if now >= self._map_at:
            self._map_at = now + self._membership.options.map_every
            others = [agent for agent in self._membership.living if agent != self.agent]
            if others:
                self._send_map(others[int(rng.integers(len(others)))], outputs)

    def _send_map(self, to: int, outputs: list[Output]) -> None:
        outputs.append(Send(to, Map(self.sender, self.records.known(), self.poses.as_mapping(), self.catalogue)))

    def _hear(self, now: float, sender: Sender, outputs: list[Output]) -> bool:
        """Note that a message has come; whether to take it in."""
        assert self._membership is not None
        hearing = self._membership.hear(now, sender)
        if not self.catalogue.is_present(sender.agent):
            self._send_map(sender.agent, outputs)  # it has yet to hear that it has left
        if hearing not in (Hearing.OLD, Hearing.KNOWN):
            self._send_map(sender.agent, outputs)
        if hearing in (Hearing.RETURNED, Hearing.REBORN):
            self._detector.admit(sender.agent)
            self._partners.join(sender.agent)
            outputs.append(AgentReturned(self.agent, sender))
        if hearing is Hearing.REBORN:
            self._maps_from.discard(sender.agent)
            self._take_back(sender.agent, outputs)
        return hearing is not Hearing.OLD

    def _on_death(self, agent: int, outputs: list[Output]) -> None:
        outputs.append(AgentBuried(self.agent, agent))
        self._part_with(agent, outputs)

    def _part_with(self, agent: int, outputs: list[Output]) -> None:
        """Go on without an agent."""
        self._detector.bury(agent)
        self._partners.leave(agent)
        self._take_back(agent, outputs)
        if self.lock is Lock.CLIENT_DONE and self._pending is not None and self._pending.to == agent:
            if isinstance(self._pending.message, Commit):
                self._unsettled[agent] = self._pending.message
            self._move(Trigger.PARTNER_DEAD)
            self._pose_is_due = True

    def _take_back(self, client: int, outputs: list[Output]) -> None:
        """Leave a trade whose client is no more: what was on offer is adopted by this agent itself."""
        escrow = self._holdings.escrow
        if self.lock is not Lock.SERVER_PREPARED or self._pending is None or self._pending.to != client:
            return
        self._release(client, Trigger.PARTNER_DEAD)
        self._holdings.overrule_pose()
        if escrow is not None and len(escrow.landmarks):
            outputs.append(LandmarksAdopted(self.agent, self._holdings.adopt(escrow.landmarks)))
            self._changed_from_outside()

    def _adopt_orphans(self, outputs: list[Output]) -> None:
        """Take over what has no living owner and this agent sees best."""
        membership, own = self._membership, self._holdings
        assert membership is not None
        known = (own.records.changes, own.poses.changes, membership.changes, len(self._maps_from))
        if known == self._adopted_at or self.lock is Lock.SERVER_PREPARED:
            return
        self._adopted_at = known
        living = membership.living
        without = self._orphans()
        self._orphaned = len(without) > 0
        if not self._orphaned or not self._maps_from >= living.keys() - {self.agent}:
            return  # somebody who lives may know another owner
        best = adopters(self._planner, own.records, own.poses, living, self._assigned)
        if best is not None and (best[without] == self.agent).any():
            outputs.append(LandmarksAdopted(self.agent, own.adopt(without[best[without] == self.agent])))
            self._orphaned = len(self._orphans()) > 0
            self._changed_from_outside()
            self._tell_all(outputs)  # before somebody adopts them as well

    def _orphans(self) -> NDArray[np.int64]:
        """Return the sorted landmarks that are to be seen and have no owner that lives."""
        assert self._membership is not None
        return orphans(self.records, self._membership.living, self._holdings.alive)

    def _on_heartbeat(self, heartbeat: Heartbeat) -> None:
        self.poses.merge(heartbeat.sender.agent, heartbeat.pose)
        if self._membership is not None:
            self._detector.receive(heartbeat)

    def _on_map(self, message: Map) -> None:
        if self._membership is not None and self.lock is not Lock.SERVER_PREPARED and not self.left:
            self._maps_from.add(message.sender.agent)
            self._learn(message.records, message.poses)
