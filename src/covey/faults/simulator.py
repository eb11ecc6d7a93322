"""A team of real nodes in a simulated world: network, clocks, vehicles, crashes and memories, all from one seed."""

from __future__ import annotations

import heapq
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from covey.errors import CoveyError
from covey.faults.checks import Checker, Violation, require
from covey.faults.operator import Operator
from covey.faults.scenario import Alteration, Crash, Cut, Isolation, Kind, Mode, Scenario
from covey.faults.table import TablePlanner, extended, pose_at, random_partition, random_planner
from covey.faults.trace import describe, describe_catalogue
from covey.geometry import Pose2
from covey.protocol import (
    EMPTY,
    OPERATOR,
    AgentBuried,
    AgentReturned,
    Catalogue,
    Change,
    Event,
    GoTo,
    LandmarkRecords,
    LandmarksAdopted,
    Lock,
    Message,
    Node,
    Output,
    Publish,
    Send,
    Sender,
    Status,
    TradeCommitted,
    WaypointAbandoned,
    within,
)

CALM_STEPS = 20_000
"""Steps within which the mission must end once the faults have stopped."""


@dataclass(frozen=True)
class Outcome:
    """How a run ended.

    Parameters
    ----------
    violation : Violation or None
    steps : int
    coverage : mapping of str to int
        How often what happened.
    trace : tuple of str
        One line a step, if it was asked for.
    """

    violation: Violation | None
    steps: int
    coverage: Counter[str]
    trace: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class _Delivery:
    sender: int
    to: int
    message: Message


@dataclass(frozen=True)
class _Wake:
    agent: int
    life: int
    deadline: float


@dataclass(frozen=True)
class _Arrival:
    agent: int
    life: int
    number: int


@dataclass(frozen=True)
class _Restart:
    agent: int
    remembers: bool


_Item: TypeAlias = _Delivery | _Wake | _Arrival | _Restart

_COUNTED: dict[type[Event], str] = {
    TradeCommitted: "trades",
    LandmarksAdopted: "adoptions",
    AgentBuried: "burials",
    AgentReturned: "returns",
    WaypointAbandoned: "waypoints_abandoned",
}


def run(scenario: Scenario, node: type[Node] = Node, *, traced: bool = False) -> Outcome:
    """Run a scenario.

    Parameters
    ----------
    scenario : Scenario
    node : type
        The protocol: `Node`, or one of `covey.faults.MUTANTS`.
    traced : bool, keyword-only
        Whether to tell what happened.

    Returns
    -------
    Outcome

    Examples
    --------
    >>> from covey.faults import draw
    >>> outcome = run(draw(3))
    >>> outcome.violation is None, outcome == run(draw(3))
    (True, True)
    """
    simulation = Simulation(scenario, node, traced=traced)
    violation: Violation | None = None
    try:
        simulation.run()
    except Violation as found:
        violation = found
    except (CoveyError, AssertionError, LookupError, ValueError) as error:
        violation = Violation("no error", f"{type(error).__name__}: {error}")
    simulation.count()
    if traced and violation is not None:
        simulation.trace.append(f"violation of {violation}")
    return Outcome(violation, simulation.steps, simulation.coverage, tuple(simulation.trace))


class Simulation:
    """The world of one scenario; `run` plays it.

    Parameters
    ----------
    scenario : Scenario
    node : type
    traced : bool, keyword-only
    """

    def __init__(self, scenario: Scenario, node: type[Node], *, traced: bool) -> None:
        self.scenario = scenario
        self.coverage: Counter[str] = Counter()
        self.trace: list[str] = []
        self.steps = 0
        self._traced = traced
        self._kind = node
        m = scenario.agents
        # The table does not depend on the seed's other draws, so that a smaller team keeps what it has in common.
        scene, self._rng, *self._rngs = np.random.default_rng([scenario.seed, 1]).spawn(m + 2)
        # Who is there at the beginning does not depend on what changes later.
        joins, additions = scenario.count(Kind.JOIN), scenario.count(Kind.ADD)
        later, *more = np.random.default_rng([scenario.seed, 3]).spawn(joins + 1)
        self._rngs += more
        self._planner = random_planner(
            scene,
            agents=m,
            poses=scenario.poses,
            landmarks=scenario.landmarks,
            pairwise=scenario.pairwise,
            eager=scenario.eager,
        )
        if scenario.changes:
            self._planner = extended(self._planner, later, agents=joins, landmarks=additions, poses=scenario.poses)
        self._original = self._planner.copy()
        self._links = None if scenario.reach is None else within(scenario.reach)
        records = LandmarkRecords.initial(
            scenario.landmarks, random_partition(scene, agents=m, landmarks=scenario.landmarks)
        )
        start = {agent: pose_at(int(scene.integers(scenario.poses))) for agent in range(m)}
        self._rates = [1.0 + scenario.skew * float(scene.uniform(-1.0, 1.0)) for _ in range(m)]
        self._offsets = [1e3 * scenario.skew * float(scene.random()) for _ in range(m)]
        self._rates += [1.0] * joins
        self._offsets += [0.0] * joins
        self._lives = [1] * (m + joins)
        self._operator = Operator(scenario)
        self.nodes: dict[int, Node] = {
            agent: node(agent, range(m), records, start, self._thinker(), options=scenario.options, links=self._links)
            for agent in range(m)
        }
        self._checker = Checker(self._planner, self.nodes)
        self._memories = {agent: one.memory() for agent, one in self.nodes.items()}
        self._crashes = sorted((f for f in scenario.faults if isinstance(f, Crash)), key=lambda crash: crash.step)
        self._lonely: dict[int, tuple[Lock, Cut]] = {}  # what cuts agents off while they are in a state
        self._isolations = [fault for fault in scenario.faults if isinstance(fault, Isolation)]
        self._cuts = [fault for fault in scenario.faults if isinstance(fault, Cut)]
        self._now = 0.0
        self._queue: list[tuple[float, int, _Item]] = []
        self._count = 0
        self._wakes = [math.inf] * (m + joins)
        self._legs = [0] * (m + joins)

    def run(self) -> None:
        """Play the scenario.

        Raises
        ------
        Violation
            If an invariant does not hold.
        """
        for agent, node in list(self.nodes.items()):
            self._say(f"agent {agent} starts at pose {node.pose.x:.0f} with {node.landmarks.tolist()}")
            self._act(agent, node.start(self._clock(agent), self._rngs[agent]))
        if self.scenario.mode is Mode.SAFETY:
            while self.steps < self.scenario.steps and self._queue:
                self._step()
            return
        last = math.inf
        while not self._is_over():
            require(bool(self._queue), "I4", "nothing will happen any more, and the mission is not over")
            self._step()
            if self._calm and last == math.inf:
                last = self.steps + CALM_STEPS
            require(self.steps < last, "I4", f"the mission is not over {CALM_STEPS} steps after the last fault")
        self._checker.check_end(self._links, eager=self.scenario.eager)
        self.coverage["missions_ended"] += 1

    def count(self) -> None:
        """Add to the coverage what is known only at the end."""
        for cut in self._cuts:
            self.coverage["partitions" if cut.both_ways else "one_way_cuts"] += cut.at < self._now
            self.coverage["heals"] += cut.until < self._now
        self.coverage["scores_compared"] += self._checker.checked_scores
        self.coverage["steps"] += self.steps

    @property
    def _calm(self) -> bool:
        return self.scenario.mode is Mode.LIVENESS and self._now >= self.scenario.calm_after

    def _is_over(self) -> bool:
        if not self._calm or any(isinstance(item, _Restart) for _, _, item in self._queue):
            return False
        return all(node.over and self._sees_truth(node) for node in self.nodes.values())

    def _sees_truth(self, node: Node) -> bool:
        """Whether a node knows who lives and what has changed; before, its mission may be over and begin again."""
        if node.catalogue != self._operator.known:
            return False
        others = (agent for agent in range(len(self._lives)) if agent != node.agent)
        return all((node.status(agent) is not Status.DEAD) == (agent in self.nodes) for agent in others)

    def _step(self) -> None:
        self._now, _, item = heapq.heappop(self._queue)
        self.steps += 1
        operator = self._operator
        while operator.pending and (self._calm or operator.pending[0].step <= self.steps):
            self._change(operator.pending.pop(0))
        if self._calm and not operator.has_repeated:
            operator.has_repeated = True
            stays = [agent for agent in self.nodes if operator.known.is_present(agent)]
            self._post(OPERATOR, min(stays, default=0), Change(Sender(OPERATOR, 1), operator.known))
        if self._rng.random() < self.scenario.proofs and not self._calm:
            self._prove(int(self._rng.integers(self.scenario.agents)))
        match item:
            case _Restart():
                self._restart(item)
            case _Delivery() if any(cut.loses(self._now, item.sender, item.to) for cut in self._cuts):
                self.coverage["cut"] += 1
            case _Delivery():
                self._deliver(item)
            case _Wake():
                self._wake(item)
            case _Arrival():
                self._arrive(item)

    def _deliver(self, item: _Delivery) -> None:
        node = self.nodes.get(item.to)
        if node is not None:
            self._say(f"agent {item.to} hears {describe(item.message)}")
            self._act(item.to, node.receive(self._clock(item.to), item.message, self._rngs[item.to]))

    def _wake(self, item: _Wake) -> None:
        node = self.nodes.get(item.agent)
        if node is not None and item.life == self._lives[item.agent] and item.deadline == self._wakes[item.agent]:
            self._wakes[item.agent] = math.inf
            now = max(item.deadline, self._clock(item.agent))  # rounding must not wake it too early for ever
            self._act(item.agent, node.poll(now, self._rngs[item.agent]))

    def _arrive(self, item: _Arrival) -> None:
        node = self.nodes.get(item.agent)
        if node is None or item.life != self._lives[item.agent] or item.number != self._legs[item.agent]:
            return
        if self._rng.random() < self.scenario.unreachable and not self._calm:
            held = pose_at(int(self._rng.integers(self.scenario.poses)))
            self._say(f"agent {item.agent} cannot reach its waypoint and holds pose {held.x:.0f}")
            self._act(item.agent, node.waypoint_unreachable(self._clock(item.agent), held))
            if not node.at_waypoint:
                self._fly(item.agent)
        else:
            self._say(f"agent {item.agent} is at its waypoint")
            self._act(item.agent, node.waypoint_reached(self._clock(item.agent)))

    def _prove(self, agent: int) -> None:
        node = self.nodes.get(agent)
        if node is not None:
            best = int(self._planner.scores(agent, node.landmarks).argmax())
            self._act(agent, node.adopt_pose(self._clock(agent), pose_at(best)))

    # What a node asks for.

    def _act(self, agent: int, outputs: Sequence[Output]) -> None:
        """Carry out what a node asks for, or only the beginning of it if the agent dies now."""
        crash = self._due_crash(agent)
        if crash is not None:
            outputs = outputs[: int(self._rng.integers(len(outputs) + 1))]
        else:
            self._checker.check(agent, outputs)
        for output in outputs:
            self._carry_out(agent, output)
        if crash is not None:
            self._die(crash)
            return
        if self.nodes[agent].left:
            self._depart(agent)
            return
        node = self.nodes[agent]
        deadline = node.next_deadline()
        if deadline is not None and deadline != self._wakes[agent]:
            self._wakes[agent] = deadline
            due = (deadline - self._offsets[agent]) / self._rates[agent]
            self._push(max(0.0, due - self._now), _Wake(agent, self._lives[agent], deadline))
        self._isolate(agent)
        if self._crashes and self._rng.random() < 0.1:
            self._memories[agent] = node.memory()

    def _carry_out(self, agent: int, output: Output) -> None:
        match output:
            case Send():
                self._post(agent, output.to, output.message)
            case Publish():
                for other in range(self.scenario.agents + self._operator.joined):
                    if other != agent:
                        self._post(agent, other, output.heartbeat)
            case GoTo():
                self._say(f"agent {agent} goes to pose {output.pose.x:.0f}")
                self._fly(agent)
            case _:
                self._say(f"agent {agent}: {describe(output)}")
                name = _COUNTED.get(type(output))
                if name is not None:
                    self.coverage[name] += 1

    def _fly(self, agent: int) -> None:
        self._legs[agent] += 1
        flying = self._rng.random() < self.scenario.flying
        away = 0.3 * self._rng.random() if flying else 0.0
        self._push(away, _Arrival(agent, self._lives[agent], self._legs[agent]))

    def _post(self, sender: int, to: int, message: Message) -> None:
        copies = 1
        if not self._calm:
            lost = self._rng.random() < self.scenario.loss
            doubled = self._rng.random() < self.scenario.duplicates
            self.coverage["drops"] += lost
            self.coverage["duplicates"] += doubled
            copies = (not lost) + doubled
        self.coverage["messages"] += 1
        spread = self.scenario.spread
        if self._calm:
            spread = min(spread, 0.5 * self.scenario.membership.heartbeat_every)
        for _ in range(copies):
            self._push(spread * float(self._rng.uniform(0.01, 1.0)), _Delivery(sender, to, message))

    # What befalls an agent.

    def _due_crash(self, agent: int) -> Crash | None:
        if self._calm:
            return None
        for crash in self._crashes:
            if crash.step > self.steps:
                return None
            if crash.agent == agent and crash.lock in (None, self.nodes[agent].lock):
                return crash
        return None

    def _isolate(self, agent: int) -> None:
        """Begin what is due for an agent in a trade, and end what lasted while it was in one."""
        lock = self.nodes[agent].lock
        while_in, cut = self._lonely.get(agent, (lock, None))
        if cut is not None and lock is not while_in:
            del self._lonely[agent]
            self._cuts[self._cuts.index(cut)] = replace(cut, until=min(cut.until, self._now))
            self._say(f"agent {agent} is cut off no more")
        for isolation in self._isolations:
            due = isolation.step <= self.steps and isolation.lock is lock
            if isolation.agent in (None, agent) and due and not self._calm:
                self._isolations.remove(isolation)
                others = frozenset(range(self.scenario.agents)) - {agent}
                until = min(self._now + isolation.lasts, self.scenario.calm_after)
                self._cuts.append(Cut(self._now, until, frozenset({agent}), others, isolation.both_ways))
                if isolation.while_locked:
                    self._lonely[agent] = lock, self._cuts[-1]
                self._say(f"agent {agent} is cut off until {until:.4f} s")
                return

    def _die(self, crash: Crash) -> None:
        self._crashes.remove(crash)
        node = self.nodes.pop(crash.agent)
        if node.escrow is not None:
            self._checker.broke(node.escrow.trade)
        self._checker.forget(crash.agent)
        self._wakes[crash.agent] = math.inf
        self.coverage["crashes"] += 1
        self._say(f"agent {crash.agent} crashes")
        if crash.back_after is not None:
            if self._rng.random() < 0.5:
                self._memories[crash.agent] = node.memory()
            self._push(crash.back_after, _Restart(crash.agent, crash.remembers))

    # What an operator does.

    def _change(self, change: Alteration) -> None:
        """Change the mission and tell everybody, over the same network."""
        news = self._operator.change(change)
        self._planner.learn(self._operator.known)
        self._checker.changed(self._operator.known)
        self.coverage["changes"] += 1
        self._say(f"the operator: {change.kind.value} {describe_catalogue(news)}")
        for other in list(self.nodes):
            self._post(OPERATOR, other, Change(Sender(OPERATOR, 1), news))
        if change.kind is Kind.JOIN:
            self._join(max(news.agents))

    def _join(self, agent: int) -> None:
        held = pose_at(int(self._rng.integers(self.scenario.poses)))
        self.nodes[agent] = self._without_memory(agent, held, 1, self._operator.known)
        self._memories[agent] = self.nodes[agent].memory()
        self.coverage["joins"] += 1
        self._act(agent, self.nodes[agent].start(self._clock(agent), self._rngs[agent]))

    def _depart(self, agent: int) -> None:
        node = self.nodes.pop(agent)
        if node.escrow is not None:
            self._checker.broke(node.escrow.trade)
        self._checker.forget(agent)
        self._wakes[agent] = math.inf
        self.coverage["leaves"] += 1

    def _thinker(self) -> TablePlanner:
        """Return the planner of one agent, which knows of no change yet."""
        return self._original.copy()

    def _without_memory(self, agent: int, held: Pose2, life: int, catalogue: Catalogue) -> Node:
        return self._kind(
            agent,
            range(self.scenario.agents),
            LandmarkRecords.unknown(self.scenario.landmarks),
            {agent: held},
            self._thinker(),
            incarnation=life,
            options=self.scenario.options,
            links=self._links,
            catalogue=catalogue,
        )

    def _restart(self, item: _Restart) -> None:
        agent, m, options = item.agent, self.scenario.agents, self.scenario.options
        self._lives[agent] += 1
        life = self._lives[agent]
        if item.remembers:
            memory = self._memories[agent]
        else:
            held = pose_at(int(self._rng.integers(self.scenario.poses)))
            own = self._operator.known.agents.get(agent)  # one that has joined is told at each start that it takes part
            catalogue = Catalogue(agents={agent: own}) if own is not None and own.present else EMPTY
            memory = self._without_memory(agent, held, life, catalogue).memory()
        self.nodes[agent] = self._kind.restart(
            agent, range(m), memory, self._thinker(), incarnation=life, options=options, links=self._links
        )
        self._operator.has_repeated = not self.scenario.changes  # nobody else may be there who knows
        self._checker.forget(agent)
        self.coverage["restarts" if item.remembers else "amnesic_restarts"] += 1
        self._say(f"agent {agent} starts again, {'with' if item.remembers else 'without'} memory, life {life}")
        self._act(agent, self.nodes[agent].start(self._clock(agent), self._rngs[agent]))

    # Time and chance.

    def _clock(self, agent: int) -> float:
        return self._offsets[agent] + self._rates[agent] * self._now

    def _push(self, delay: float, item: _Item) -> None:
        self._count += 1
        heapq.heappush(self._queue, (self._now + delay, self._count, item))

    def _say(self, line: str) -> None:
        if self._traced:
            self.trace.append(f"{self._now:8.4f} s  step {self.steps:4d}  {line}")
