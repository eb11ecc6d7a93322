"""Every interleaving of a small team: real nodes, and a network that keeps all messages for ever.

The network delivers any message that was ever sent, at any time, as often as it likes, or never: so every loss, every
copy and every order is among the runs.  Time is left to choice as well: whatever an agent waits for may be due now.
Whom it asks next is left to choice too.  Maps are sent once somebody has died; before, they carry nothing that a trade
does not.

What is bounded: the team and its landmarks, one pose an agent, one crash without return, how many trades each agent
opens, and heartbeats, which are not sent: who is dead is told to each agent at any later time instead.  Resending is
not bounded.

Three things make it small enough, and hide no state that an agent can be in together with those of the others.  A move
that leaves its agent as it was and only sends is made at once: the network need not deliver.  For the same reason a
state is passed over if the same agents have been seen with at least the same messages.  And what is addressed to the
dead is forgotten.
"""

from __future__ import annotations

import enum
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from covey.errors import ArgumentError
from covey.faults.checks import Violation, require
from covey.faults.table import TablePlanner, pose_at
from covey.faults.trace import describe
from covey.protocol import (
    GoTo,
    LandmarkRecords,
    LandmarksAdopted,
    Lock,
    MembershipOptions,
    Message,
    Node,
    NodeOptions,
    Output,
    Send,
)
from covey.protocol.records import GENERATION

SIZES: tuple[tuple[int, tuple[int, ...]], ...] = ((2, (1, 1)), (2, (2, 2)), (3, (1, 0, 0)), (3, (1, 1, 0)))
"""Teams that are explored in less than a minute: how many agents, and how many trades each opens at most."""

MORE_SIZES: tuple[tuple[int, tuple[int, ...]], ...] = ((3, (1, 0, 1)), (3, (2, 0, 0)))
"""What else is explored when there is time."""

_Key: TypeAlias = tuple[object, ...]
_Team: TypeAlias = tuple[int | None, ...]
_State: TypeAlias = tuple[_Team, int, int]
"""The state of each agent (None: dead), the messages that were ever sent, and the adoptions so far, as bits."""
_Step: TypeAlias = tuple[_State, int, int | str]
"""From where, who, and what happened to it."""

# Agent 0 sees landmark 1 best and agent 1 landmark 0, who own them the wrong way round; agent 2 is best at neither.
_TABLE = np.array([[[0.2, 0.9]], [[0.8, 0.3]], [[0.5, 0.5]]])
_FOREVER = 1e6
_OPTIONS = NodeOptions(
    backoff=0.0,
    pause=0.0,
    resend_after=1.0,
    give_up_after=2.0,
    membership=MembershipOptions(heartbeat_every=_FOREVER, dead_after=3.0 * _FOREVER, map_every=_FOREVER),
)


@dataclass(frozen=True)
class Exploration:
    """What an exploration has covered.

    Parameters
    ----------
    states, transitions : int
        Of the whole team.
    complete : bool
        Whether there are no others within the budget.
    teams : frozenset
        Which states of the agents were met together, each as what tells it from any other.
    """

    states: int
    transitions: int
    complete: bool
    teams: frozenset[_Key]


def explore(
    agents: int,
    *,
    asks: Sequence[int] = (1, 1, 0),
    crash: bool = True,
    node: type[Node] = Node,
    limit: int = 5_000_000,
    reduced: bool = True,
) -> Exploration:
    """Visit every state of two or three agents with two landmarks, and check I2 and I5 in each.

    Parameters
    ----------
    agents : int
        2 or 3.
    asks : sequence of int, keyword-only
        How many trades each agent opens at most, agent by agent.
    crash : bool, keyword-only
        Whether one agent, any of them, may die at any time, to be declared dead by each other at any later time.
    node : type, keyword-only
        `Node`, or a mutant.
    limit : int, keyword-only
        States after which to stop.
    reduced : bool, keyword-only
        Whether to pass over states that add nothing; without it the same teams are met, in many times as many states.

    Raises
    ------
    ArgumentError
        For another number of agents.
    Violation
        If an invariant does not hold; the text ends with the steps that led there.

    Examples
    --------
    >>> explore(2, crash=False).complete
    True
    """
    if agents not in (2, 3):
        raise ArgumentError(f"agents: expected 2 or 3, got {agents}")
    return _Explorer(agents, tuple(asks), crash, node, reduced=reduced).run(limit)


class _Explorer:
    def __init__(self, agents: int, asks: tuple[int, ...], crash: bool, node: type[Node], *, reduced: bool) -> None:
        self.agents, self.asks, self.crash, self.reduced = agents, asks, crash, reduced
        self.nodes: list[Node] = []
        self.ids: dict[_Key, int] = {}
        self.keys: list[_Key] = []
        self.messages: list[Message] = []
        self.message_ids: dict[_Key, int] = {}
        self.addressed = [0] * agents  # the messages to each agent, as bits
        self.inert: list[int] = []  # the messages that do nothing in a state of an agent, as bits
        self.unasked: dict[tuple[int, tuple[int, ...]], tuple[str, ...]] = {}
        self.freely_sent: dict[tuple[int, tuple[int, ...]], int] = {}
        self.adoptions: list[tuple[int, int, int]] = []
        self.results: dict[tuple[int, int | str], tuple[int, int, int]] = {}
        planner = TablePlanner(_TABLE[:agents], np.ones(2), pairwise=False)
        records = LandmarkRecords.initial(2, {0: np.array([0]), 1: np.array([1]), 2: np.array([], dtype=np.int64)})
        poses = {agent: pose_at(0) for agent in range(agents)}
        start: list[int] = []
        for agent in range(agents):
            one = node(agent, range(agents), records, poses, planner, options=_OPTIONS)
            one.start(0.0, np.random.default_rng(0))
            start.append(self._intern(one))
        self.first: _State = (tuple(start), 0, 0)

    def run(self, limit: int) -> Exploration:
        first: _State = (self.first[0], self._saturated(*self.first[:2]), 0)
        came_from: dict[_State, _Step | None] = {first: None}
        seen: dict[tuple[_Team, int], list[int]] = {(first[0], first[2]): [first[1]]}
        stack, transitions = [first], 0
        while stack and len(came_from) < limit:
            state = stack.pop()
            if state[1] not in seen[state[0], state[2]]:
                continue  # the same with more messages has been met since
            for agent, move, (team, sent, adopted) in self._following(state):
                transitions += 1
                sents = seen.setdefault((team, adopted), [])
                if self._adds_nothing(sent, sents):
                    continue
                following = team, self._saturated(team, sent), adopted
                came_from[following] = (state, agent, move)
                if not sents:
                    self._check(following, came_from)
                elif self.reduced:
                    sents[:] = [other for other in sents if following[1] | other != following[1]]
                sents.append(following[1])
                stack.append(following)
        teams = frozenset(tuple(None if known is None else self.keys[known] for known in team) for team, _ in seen)
        return Exploration(len(came_from), transitions, not stack, teams)

    def _adds_nothing(self, sent: int, sents: Sequence[int]) -> bool:
        """Whether the same agents have been met with these messages."""
        return any(sent | other == other for other in sents) if self.reduced else sent in sents

    def _following(self, state: _State) -> Iterator[tuple[int, int | str, _State]]:
        team, sent, adopted = state
        dead = _dead(team)
        for agent, known in enumerate(team):
            if known is None:
                continue
            heard = _bits(sent & self.addressed[agent] & ~self.inert[known])
            moves: list[int | str] = [*heard, *self._unasked(known, dead)]
            for move in moves:
                after, said, taken = self._act(known, move)
                if after != known or said & ~sent:
                    changed = (*team[:agent], after, *team[agent + 1 :])
                    yield agent, move, (changed, self._heard(dead, sent | said), adopted | taken)
            if self.crash and not dead:
                yield agent, "dies", ((*team[:agent], None, *team[agent + 1 :]), self._heard((agent,), sent), adopted)

    def _heard(self, dead: tuple[int, ...], sent: int) -> int:
        """Forget what is addressed to the dead."""
        for agent in dead if self.reduced else ():
            sent &= ~self.addressed[agent]
        return sent

    def _unasked(self, known: int, dead: tuple[int, ...]) -> tuple[str, ...]:
        """Return what may happen to an agent without a message."""
        if (known, dead) not in self.unasked:
            others = [other for other in range(self.agents) if other != self.nodes[known].agent]
            moves = ["wait", *(f"ask {other}" for other in others), *(["map"] if dead else [])]
            moves += [f"bury {other}" for other in dead]
            results = [(move, self._act(known, move)) for move in moves]
            self.unasked[known, dead] = tuple(move for move, (after, said, _) in results if after != known or said)
            self.freely_sent[known, dead] = 0
            for _, (after, said, _) in results:
                self.freely_sent[known, dead] |= said if after == known else 0
        return self.unasked[known, dead]

    def _saturated(self, team: _Team, sent: int) -> int:
        """Add what the agents can send without a change of their own."""
        if not self.reduced:
            return sent
        dead = _dead(team)
        for known in team:
            if known is not None:
                self._unasked(known, dead)
                sent |= self.freely_sent[known, dead]
        before = -1
        while sent != before:
            before = sent
            for agent, known in enumerate(team):
                if known is not None:
                    for move in _bits(sent & self.addressed[agent] & ~self.inert[known]):
                        after, said, _ = self._act(known, move)
                        if after == known:
                            sent |= said
            sent = self._heard(dead, sent)
        return sent

    def _act(self, known: int, move: int | str) -> tuple[int, int, int]:
        """Return the state after a move of one agent, the messages that it sends, and what it adopts."""
        if (known, move) in self.results:
            return self.results[known, move]
        node, rng = _clone(self.nodes[known]), np.random.default_rng(0)
        outputs: list[Output] = []
        if isinstance(move, int):
            outputs = node.receive(0.0, self.messages[move], rng)
        elif move == "map":
            for other in range(self.agents):
                if other != node.agent:
                    node._send_map(other, outputs)
        elif move == "wait" and node.lock is not Lock.IDLE:
            node._resend_at = node._give_up_at = 0.0  # send again, or give up: whatever it waits for is due
            outputs = node.poll(0.0, rng)
        elif move.startswith("ask") and node.lock is Lock.IDLE and node._trades < self.asks[node.agent]:
            server = int(move.split()[1])
            if server in node._willing():
                node._partners.ask_at, node._partners._line = 0.0, [server]
                outputs = node.poll(0.0, rng)
        elif move.startswith("bury"):
            outputs = node.bury(0.0, int(move.split()[1]))
        outputs += [out for output in outputs if isinstance(output, GoTo) for out in node.waypoint_reached(0.0)]
        said = taken = 0
        for output in outputs:
            if isinstance(output, Send):
                said |= 1 << self._sent(output)
            elif isinstance(output, LandmarksAdopted):
                for k, record in zip(output.records.indices.tolist(), output.records.values.tolist(), strict=True):
                    taken |= 1 << self._adopted(node.agent, k, record[GENERATION])
        before = self.nodes[known].records
        require(not before.is_ahead(node.records.all()).any(), "I5", f"records shrank at agent {node.agent}")
        after = self._intern(node)
        if after == known and not said and isinstance(move, int):
            self.inert[known] |= 1 << move
        self.results[known, move] = after, said, taken
        return after, said, taken

    def _check(self, state: _State, came_from: dict[_State, _Step | None]) -> None:
        team, _, adopted = state
        living = [self.nodes[known] for known in team if known is not None]
        began = [self.adoptions[number][1:] for number in _bits(adopted)]
        for k in range(2):
            claims = [int(node.records.values[k, GENERATION]) for node in living if k in node.claims()]
            for generation in set(claims):
                if claims.count(generation) > 1 and began.count((k, generation)) < 2:
                    steps, at = [], came_from[state]
                    while at is not None:
                        before, agent, move = at
                        what = move if isinstance(move, str) else f"hears {describe(self.messages[move])}"
                        steps.append(f"agent {agent} {what}")
                        at = came_from[before]
                    story = "\n".join(reversed(steps))
                    raise Violation("I2", f"landmark {k} is claimed twice in generation {generation}:\n{story}")

    def _intern(self, node: Node) -> int:
        """Return the number of an agent's state; what its lock makes meaningless does not tell states apart."""
        answers = [(client, *node._answers[client]) for client in sorted(node._answers)]
        waits, in_trade = node.lock is Lock.CLIENT_WAIT, node.lock in (Lock.CLIENT_WAIT, Lock.CLIENT_DONE)
        key: _Key = (
            node.agent,
            node.lock,
            node._trades,
            node._open if in_trade else None,
            node.at_waypoint,
            node.records.values.tobytes(),
            tuple((a, node.poses[a]) for a in sorted(node.poses)),
            node.escrow.trade if node.escrow else None,
            node.escrow.landmarks.tobytes() if node.escrow else None,
            node.partners,
            tuple((client, trade, _key(answer) if answer else None) for client, trade, answer in answers),
            (node._pending.to, _key(node._pending.message)) if node._pending else None,
            tuple((server, _key(commit)) for server, commit in sorted(node._unsettled.items())),
            tuple(node._membership.living.items()) if node._membership else None,
            frozenset(node._maps_from),
            node._pose_is_due,
            waits and node.epoch == node._asked_in_epoch,
            node.avoid,
        )
        if key not in self.ids:
            self.ids[key] = len(self.nodes)
            self.keys.append(key)
            self.nodes.append(node)
            self.inert.append(0)
        return self.ids[key]

    def _sent(self, send: Send) -> int:
        key = (send.to, *_key(send.message))
        if key not in self.message_ids:
            self.addressed[send.to] |= 1 << len(self.messages)
            self.message_ids[key] = len(self.messages)
            self.messages.append(send.message)
        return self.message_ids[key]

    def _adopted(self, agent: int, k: int, generation: int) -> int:
        if (agent, k, generation) not in self.adoptions:
            self.adoptions.append((agent, k, generation))
        return self.adoptions.index((agent, k, generation))


def _clone(node: Node) -> Node:
    """Return a node that can go another way; what never changes is shared."""
    copied: Node = _copied(node)
    return copied


def _copied(thing: Any) -> Any:
    kind = type(thing)
    if kind is dict:
        return {key: _copied(value) for key, value in thing.items()}
    if kind in (list, set):
        return kind(thing)
    if kind is np.ndarray:
        return thing.copy() if thing.flags.writeable else thing
    named = hasattr(thing, "__dict__") and not isinstance(thing, type | tuple | enum.Enum | TablePlanner)
    if not named or callable(thing) or "__setattr__" in vars(kind):  # as frozen dataclasses have
        return thing
    result = object.__new__(kind)
    result.__dict__.update({name: _copied(value) for name, value in vars(thing).items()})
    return result


def _dead(team: _Team) -> tuple[int, ...]:
    return tuple(agent for agent, known in enumerate(team) if known is None)


def _key(message: Message) -> _Key:
    """Return what makes a message the same as another."""
    return (type(message).__name__, message.sender, describe(message))


def _bits(number: int) -> Iterator[int]:
    """Yield which bits are set."""
    while number:
        lowest = number & -number
        yield lowest.bit_length() - 1
        number ^= lowest
