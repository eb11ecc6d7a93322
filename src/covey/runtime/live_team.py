"""A team in this process that can be played with: messages get lost, agents are killed and come back."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from covey.errors import InputError
from covey.mission import ChangeSpec, Mission
from covey.protocol import (
    AgentBuried,
    Event,
    GoTo,
    LandmarksAdopted,
    MembershipOptions,
    Node,
    NodeOptions,
)
from covey.protocol.records import OWNER
from covey.runtime.agent import build_planner, nearest_first
from covey.runtime.changing import catalogue_of
from covey.runtime.plan import software_versions
from covey.runtime.result import HistoryEntry, Progress
from covey.runtime.streams import Stream, generator
from covey.runtime.team import Team
from covey.runtime.watching.feed import Run, Watcher
from covey.runtime.watching.steering import Kill, Request, Revive, SetLoss, SetWeight, Steering
from covey.runtime.watching.telling import TeamTeller, describe

DELAY = (0.02, 0.08)
"""Shortest and longest time that a message takes, seconds: slow enough to watch."""

OPTIONS = NodeOptions(
    backoff=0.2,
    pause=0.5,
    resend_after=0.5,
    give_up_after=2.0,
    membership=MembershipOptions(heartbeat_every=0.5, dead_after=3.0, map_every=0.5),
)
"""Who is silent for six heartbeats is dead."""

MOST_LOSS = 0.95
"""With more nobody would hear of anybody."""


def check_playable(mission: Mission) -> None:
    """Check that a mission can be played with.

    Raises
    ------
    InputError
        If it has changes.
    """
    if mission.changes:
        where = mission.path or mission.name
        raise InputError(
            f"{where}: changes: only `covey plan` and `covey launch` act on them; leave the key out to play"
        )


class LiveTeam(Team):
    """A team whose agents can die and come back, on a bus that may lose messages.

    Parameters
    ----------
    mission : Mission
    watch : Watcher
    steering : Steering

    Attributes
    ----------
    dead : set of int
        The killed.

    Raises
    ------
    InputError
        If the mission has changes, or a sensor cannot be built.

    Notes
    -----
    Its clock is that of the bus: `Steering` holds it to the clock on the wall.
    """

    def __init__(self, mission: Mission, *, watch: Watcher, steering: Steering) -> None:
        check_playable(mission)
        planner = build_planner(mission)
        self.dead: set[int] = set()
        super().__init__(mission, planner, seed=mission.seed, options=OPTIONS, delay=DELAY)
        self._lives = [1] * len(self.nodes)
        self._steering = steering
        steering.measure(lambda: self.bus.now, 0.1)
        steering.offer(Kill, Revive, SetLoss, SetWeight)
        scene = describe(mission, planner.models, run=Run.NETWORK, software=software_versions())
        self._teller = TeamTeller(watch, self, scene)

    @property
    def over(self) -> bool:
        """Whether all that live know that nothing is left to do."""
        return all(node.over for agent, node in enumerate(self.nodes) if agent not in self.dead)

    def play(self, *, until: Callable[[], bool], on_progress: Callable[[Progress], object]) -> None:
        """Let things happen, as fast as `Steering` says.

        Parameters
        ----------
        until : callable
            Whether to stop.
        on_progress : callable
            Called often; KeyboardInterrupt from it ends the play.
        """

        def report() -> None:
            stage = "quiet" if self.over else "trading"
            on_progress(Progress(stage, self.score, self.trades, self.bus.messages))

        status = "interrupted"
        try:
            for _ in self.start():
                report()
            while not until():
                for request in self._steering.take():
                    self._grant(request)
                step = self.bus.step()
                assert step is not None, "agents that live wake up now and then"
                if step.agent is not None:
                    self._act(step.agent, step.outputs)
                    self._show(step.agent)
                if self.over:
                    self._agree()
                report()
                self._steering.hold(report)
            status = "settled" if self.over else status
        except KeyboardInterrupt:
            pass
        self._teller.end(status, None)

    def kill(self, agent: int) -> None:
        """End an agent's process without a word."""
        self.bus.detach(agent)
        self.dead.add(agent)
        self._log("death", (agent,))

    def revive(self, agent: int) -> None:
        """Start an agent again, with what it remembers."""
        self._lives[agent] += 1
        self.dead.discard(agent)
        self.nodes[agent] = Node.restart(
            agent,
            range(len(self.nodes)),
            self.nodes[agent].memory(),
            self.planner,
            incarnation=self._lives[agent],
            order=nearest_first,
            options=OPTIONS,
            links=self._links,
        )
        life = len(self.nodes) * self._lives[agent] + agent
        self.bus.attach(self.nodes[agent], generator(self.mission.seed, Stream.NODE, life), hears_heartbeats=True)
        self._act(agent, self.bus.start(agent))
        self._log("return", (agent,))

    def weigh(self, landmark: int, weight: float) -> None:
        """Let a landmark be worth something else; all that live hear of it at once, whatever the bus loses."""
        change = ChangeSpec(reweight={landmark: weight})
        news = catalogue_of(change, self.planner, [agent.name for agent in self.mission.agents])
        self.planner.learn(news.catalogue)
        self.mission = replace(self.mission, landmarks=self.planner.landmarks)
        self.rescore()
        self.history.append(HistoryEntry(news.event, (), self.score, news.detail))
        self._teller.reshaped(news.event, (), np.array([landmark], dtype=np.int64), news.detail)
        for agent, node in enumerate(self.nodes):
            if agent not in self.dead:
                self._act(agent, self.bus.apply(agent, node.change(self.bus.now, news.catalogue)))

    def _grant(self, request: Request) -> None:
        """Do what a visitor asks for, or say why not."""
        match request.command:
            case Kill(agent):
                if not 0 <= agent < len(self.nodes) or agent in self.dead:
                    request.refuse("agent: expected one that lives")
                elif len(self.dead) == len(self.nodes) - 1:
                    request.refuse("agent: it is the last one")
                else:
                    self.kill(agent)
            case Revive(agent):
                if agent not in self.dead:
                    request.refuse("agent: expected one that was killed")
                else:
                    self.revive(agent)
            case SetWeight(landmark, weight):
                if not 0 <= landmark < len(self.mission.landmarks):
                    request.refuse(f"landmark: expected one of {len(self.mission.landmarks)}, got {landmark}")
                elif not (math.isfinite(weight) and weight >= 0.0):
                    request.refuse(f"weight: expected a finite number from 0 on, got {weight:g}")
                else:
                    self.weigh(landmark, weight)
            case SetLoss(loss):
                if not 0.0 <= loss <= MOST_LOSS:
                    request.refuse(f"loss: expected 0 to {MOST_LOSS}, got {loss:g}")
                else:
                    self.bus.loss = self._steering.loss = loss

    def _act(self, agent: int, outputs: Sequence[GoTo | Event]) -> None:
        for output in outputs:
            if isinstance(output, LandmarksAdopted):
                self._adopt(output)
            elif isinstance(output, AgentBuried):
                names = [self.mission.agents[index].name for index in (output.agent, output.dead)]
                self._teller.note(self.bus.now, "buried", [output.agent], f"{names[0]} takes {names[1]} for dead")
            else:
                super()._act(agent, [output])

    def _adopt(self, adopted: LandmarksAdopted) -> None:
        landmarks = adopted.records.indices
        losers = np.unique(self.owner[landmarks])
        self.owner[landmarks] = adopted.agent
        if (losers != adopted.agent).any():
            self.rescore()
            self._log("adoption", (adopted.agent,))

    def _agree(self) -> None:
        """See who owns what in the end: of several that adopted a landmark one keeps it, and no event tells."""
        living = next(node for agent, node in enumerate(self.nodes) if agent not in self.dead)
        owner = living.records.values[:, OWNER]
        if not np.array_equal(owner, self.owner):
            self.owner[:] = owner
            self.rescore()
            self._log("agreed", ())

    def rescore(self) -> None:
        """Compute every score anew; the dead see nothing."""
        super().rescore()
        self.scores[list(self.dead)] = 0.0

    def _score_of(self, agent: int) -> float:
        return 0.0 if agent in self.dead else super()._score_of(agent)
