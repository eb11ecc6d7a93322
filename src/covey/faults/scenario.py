"""What a simulated team is like and what happens to it: everything that a seed decides."""

from __future__ import annotations

import enum
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from covey.protocol import Adopt, Lock, MembershipOptions, NodeOptions

_IN_TRADE = (Lock.CLIENT_WAIT, Lock.CLIENT_DONE, Lock.SERVER_PREPARED)

MAX_AGENTS, MAX_POSES, MAX_LANDMARKS = 5, 5, 12


class Mode(enum.Enum):
    """What is asked of a run."""

    SAFETY = "safety"
    """Faults go on to the last step; what must hold at every instant is checked."""
    LIVENESS = "liveness"
    """Faults stop, and then the mission has to end as it should."""


@dataclass(frozen=True)
class Crash:
    """An agent dies in the middle of what it does at a step, with only some of its messages sent.

    Parameters
    ----------
    step : int
        It dies when it next does something at or after this step.
    agent : int
    back_after : float or None
        Seconds until it starts again; None for never.
    remembers : bool
        Whether it then has a memory, of any age, or none.
    lock : Lock or None
        It dies only in this state; None for any.
    """

    step: int
    agent: int
    back_after: float | None
    remembers: bool
    lock: Lock | None


@dataclass(frozen=True)
class Cut:
    """Messages from some agents to some others are lost for a while.

    Parameters
    ----------
    at, until : float
        Seconds.
    sources, targets : frozenset of int
    both_ways : bool
        A partition; otherwise the targets still reach the sources.
    """

    at: float
    until: float
    sources: frozenset[int]
    targets: frozenset[int]
    both_ways: bool

    def loses(self, now: float, sender: int, to: int) -> bool:
        """Whether a message between these two is lost now."""
        there = sender in self.sources and to in self.targets
        back = self.both_ways and sender in self.targets and to in self.sources
        return self.at <= now < self.until and (there or back)


@dataclass(frozen=True)
class Isolation:
    """An agent is cut off from all others in the middle of a trade.

    Parameters
    ----------
    step : int
        It begins when the agent is next in the state at or after this step.
    agent : int or None
        None for whoever is in the state first.
    lock : Lock
    lasts : float
        Seconds, at most.
    both_ways : bool
        Otherwise it still hears.
    while_locked : bool
        It ends as soon as the agent has left that state, so perhaps when it alone has declared its partner dead.
    """

    step: int
    agent: int | None
    lock: Lock
    lasts: float
    both_ways: bool
    while_locked: bool = False


Fault: TypeAlias = Crash | Cut | Isolation


class Kind(enum.Enum):
    """What an operator changes."""

    ADD = "add"
    REMOVE = "remove"
    REWEIGHT = "reweight"
    JOIN = "join"
    LEAVE = "leave"


@dataclass(frozen=True)
class Alteration:
    """An operator changes landmarks or agents, and tells everybody once; when the faults have stopped, one more time.

    Parameters
    ----------
    step : int
        When.
    kind : Kind
    number : int
        Which landmark is removed or re-weighted, or which agent leaves; who is added or joins gets the next number.
    weight : float
        What the landmark is worth.
    """

    step: int
    kind: Kind
    number: int
    weight: float


@dataclass(frozen=True)
class Scenario:
    """A team, its network, and its misfortunes.

    Parameters
    ----------
    seed : int
        Of all randomness in the run.
    mode : Mode
    agents, poses, landmarks : int
    pairwise, eager : bool
        See `covey.faults.table.TablePlanner`.
    loss, duplicates : float
        Probabilities, for each message.
    spread : float
        Longest delay, seconds; the shortest is a hundredth of it, so messages overtake each other.
    flying, unreachable : float
        Probability that a waypoint takes time to reach, and that it cannot be reached.
    proofs : float
        Probability, at each step, that somebody is handed the best pose for its landmarks.
    reach : float or None
        Agents whose poses are further apart than this do not trade; None for no limit.
    skew : float
        Clocks run up to this much faster or slower, and start anywhere.
    options : NodeOptions
        Every time-out drawn against the delays.
    faults : tuple of Crash, Cut and Isolation
    changes : tuple of Alteration
        In order.
    calm_after : float
        When the faults stop, seconds.
    steps : int
        Where a run in safety mode ends.
    """

    seed: int
    mode: Mode
    agents: int
    poses: int
    landmarks: int
    pairwise: bool
    eager: bool
    loss: float
    duplicates: float
    spread: float
    flying: float
    unreachable: float
    proofs: float
    reach: float | None
    skew: float
    options: NodeOptions
    faults: tuple[Fault, ...]
    changes: tuple[Alteration, ...]
    calm_after: float
    steps: int

    def count(self, kind: Kind) -> int:
        """Return how many changes are of a kind."""
        return sum(change.kind is kind for change in self.changes)

    @property
    def membership(self) -> MembershipOptions:
        """The options for failures, which every simulated team has."""
        assert self.options.membership is not None
        return self.options.membership


def draw(seed: int) -> Scenario:
    """Draw a scenario; the same seed gives the same one.

    Examples
    --------
    >>> draw(7) == draw(7)
    True
    """
    rng = np.random.default_rng([seed, 0])
    agents = int(rng.integers(2, MAX_AGENTS + 1))
    spread = 0.02
    healthy = rng.random() < 0.3  # the network alone is bad: what must hold without deaths is then always checked
    membership = _draw_membership(rng, spread)
    if healthy:
        membership = replace(membership, dead_after=100.0 * spread)
    calm_after = float(rng.uniform(0.1, 1.5))
    flying = float(rng.choice([0.0, 0.0, 0.5, 1.0]))
    scenario = Scenario(
        seed=seed,
        mode=Mode.LIVENESS if seed % 2 else Mode.SAFETY,
        agents=agents,
        poses=int(rng.integers(2, MAX_POSES + 1)),
        landmarks=int(rng.integers(1, MAX_LANDMARKS + 1)),
        pairwise=bool(rng.random() < 0.5),
        eager=bool(rng.random() < 0.5),
        loss=float(rng.choice([0.0, 0.0, 0.05, 0.3])),
        duplicates=float(rng.choice([0.0, 0.05, 0.3])),
        spread=spread,
        flying=flying,
        unreachable=float(rng.choice([0.0, 0.3])) if flying else 0.0,
        proofs=float(rng.choice([0.0, 0.1, 0.3])),
        reach=float(rng.choice([0.0, 1.0, 2.0])) if rng.random() < 0.2 else None,
        skew=float(rng.choice([0.0, 0.1])),
        options=_draw_options(rng, spread, membership),
        faults=() if healthy else _draw_faults(rng, agents, calm_after, membership),
        changes=(),
        calm_after=calm_after,
        steps=int(rng.integers(100, 1200)),
    )
    if not healthy:
        scenario = _with_lost_commits(np.random.default_rng([seed, 4]), scenario)
    return replace(scenario, changes=_draw_changes(np.random.default_rng([seed, 2]), scenario))


def _draw_options(rng: np.random.Generator, spread: float, membership: MembershipOptions) -> NodeOptions:
    return NodeOptions(
        backoff=0.01,
        pause=float(rng.choice([0.0, 0.02])),
        resend_after=spread * float(rng.uniform(0.3, 5.0)),
        give_up_after=spread * float(rng.uniform(0.3, 20.0)),
        membership=membership,
    )


def _draw_membership(rng: np.random.Generator, spread: float) -> MembershipOptions:
    heartbeat_every = spread * float(rng.uniform(0.5, 6.0))
    return MembershipOptions(
        heartbeat_every=heartbeat_every,
        dead_after=heartbeat_every * float(rng.uniform(3.0, 6.0)),
        map_every=heartbeat_every * float(rng.uniform(0.3, 2.0)),
        adopt=Adopt.MAJORITY if rng.random() < 0.2 else Adopt.ALL,
    )


def _draw_faults(
    rng: np.random.Generator, agents: int, calm_after: float, options: MembershipOptions
) -> tuple[Fault, ...]:
    faults: list[Fault] = []
    mortal = (agents - 1) // 2 if options.adopt is Adopt.MAJORITY else agents - 1
    mortals = set(rng.permutation(agents)[: int(rng.integers(mortal + 1))].tolist())
    for _ in range(int(rng.choice([0, 1, 1, 2, 3, 4]))):
        agent = int(rng.integers(agents))
        for_good = agent in mortals
        back_after = None if for_good else float(rng.uniform(0.0, 2.0)) * options.dead_after
        lock = _IN_TRADE[int(rng.integers(len(_IN_TRADE)))] if rng.random() < 0.6 else None
        faults.append(Crash(_draw_step(rng), agent, back_after, bool(rng.random() < 0.5), lock))
    for _ in range(int(rng.choice([0, 0, 1, 2, 3]))):
        at = calm_after * float(rng.random()) ** 2
        until = min(calm_after, at + float(rng.uniform(0.0, 4.0)) * options.dead_after)
        side = rng.random(agents) < 0.5
        sources = frozenset(np.flatnonzero(side).tolist())
        faults.append(Cut(at, until, sources, frozenset(range(agents)) - sources, bool(rng.random() < 0.5)))
    for _ in range(int(rng.choice([0, 1, 2, 3]))):
        lock = _IN_TRADE[int(rng.integers(len(_IN_TRADE)))]
        lasts = float(rng.uniform(0.7, 1.5)) * options.dead_after
        faults.append(Isolation(_draw_step(rng), int(rng.integers(agents)), lock, lasts, bool(rng.random() < 0.5)))
    return tuple(faults)


def _with_lost_commits(rng: np.random.Generator, scenario: Scenario) -> Scenario:
    """Add clients that are cut off when they commit, until about when one of the two declares the other dead.

    Their clocks run apart, or both would do so at once.
    """
    options, faults = scenario.membership, list(scenario.faults)
    for _ in range(int(rng.choice([0, 1, 1, 3]))):
        lasts = options.dead_after + float(rng.uniform(0.0, 1.5)) * options.heartbeat_every
        step, while_locked = int(rng.integers(60)), bool(rng.random() < 0.8)
        faults.append(Isolation(step, None, Lock.CLIENT_DONE, lasts, True, while_locked))
    skew = scenario.skew if len(faults) == len(scenario.faults) else 0.2
    return replace(scenario, faults=tuple(faults), skew=skew)


def _draw_changes(rng: np.random.Generator, scenario: Scenario) -> tuple[Alteration, ...]:
    if rng.random() < 0.6:
        return ()
    kinds = list(Kind)
    gone = {fault.agent for fault in scenario.faults if isinstance(fault, Crash) and fault.back_after is None}
    leavers = [] if scenario.membership.adopt is Adopt.MAJORITY else sorted(set(range(scenario.agents)) - gone)[1:]
    changes = []
    for _ in range(int(rng.integers(1, 5))):
        kind = kinds[int(rng.integers(len(kinds)))]
        number = int(rng.integers(scenario.landmarks))
        if kind is Kind.LEAVE:
            if not leavers:
                continue
            number = leavers.pop(int(rng.integers(len(leavers))))
        changes.append(Alteration(_draw_step(rng), kind, number, float(rng.choice([0.5, 1.0, 3.0]))))
    return tuple(sorted(changes, key=lambda change: change.step))


def _draw_step(rng: np.random.Generator) -> int:
    return int(400.0 * rng.random() ** 3)  # trades are most frequent at the beginning


def simpler(scenario: Scenario) -> Iterator[Scenario]:
    """Yield scenarios that are simpler in one way, the largest simplifications first."""
    for i in range(len(scenario.faults)):
        yield replace(scenario, faults=scenario.faults[:i] + scenario.faults[i + 1 :])
    for i in range(len(scenario.changes)):
        yield replace(scenario, changes=scenario.changes[:i] + scenario.changes[i + 1 :])
    if scenario.agents > 2:
        yield _without_last_agent(scenario)
    for name, least in (("landmarks", 1), ("poses", 1)):
        value = getattr(scenario, name)
        for smaller in sorted({least, value // 2, value - 1}):
            if least <= smaller < value:
                yield _with(scenario, name, smaller)
    for name, plain in _PLAIN.items():
        if getattr(scenario, name) != plain:
            yield _with(scenario, name, plain)
    if scenario.options.membership is not None and scenario.membership.adopt is not Adopt.ALL:
        membership = replace(scenario.membership, adopt=Adopt.ALL)
        yield replace(scenario, options=replace(scenario.options, membership=membership))


_PLAIN = {
    "loss": 0.0,
    "duplicates": 0.0,
    "flying": 0.0,
    "unreachable": 0.0,
    "proofs": 0.0,
    "skew": 0.0,
    "reach": None,
    "pairwise": False,
    "eager": True,
}


def _with(scenario: Scenario, name: str, value: object) -> Scenario:
    changes: dict[str, Any] = {name: value}
    return replace(scenario, **changes)


def _without_last_agent(scenario: Scenario) -> Scenario:
    last = scenario.agents - 1
    faults = tuple(
        replace(fault, sources=fault.sources - {last}, targets=fault.targets - {last})
        if isinstance(fault, Cut)
        else fault
        for fault in scenario.faults
        if isinstance(fault, Cut) or fault.agent != last
    )
    changes = tuple(c for c in scenario.changes if c.kind is not Kind.LEAVE or c.number != last)
    return replace(scenario, agents=last, faults=faults, changes=changes)
