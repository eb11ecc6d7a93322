"""Every interleaving of a small team: real nodes, and a network that keeps all messages for ever.

The network delivers any message that was ever sent, at any time, as often as it likes, or never: so every loss, every
copy and every order is among the runs.  Time is left to choice as well: whatever an agent waits for may be due now.
Maps are sent once somebody has died; before, they carry nothing that a trade does not.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

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

_Key: TypeAlias = tuple[object, ...]
_State: TypeAlias = tuple[tuple[int | None, ...], int, int]
"""The state of each agent (None: dead), the messages that were ever sent, and the adoptions so far, as bits."""

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
    """

    states: int
    transitions: int
    complete: bool


def explore(
    agents: int,
    *,
    asks: Sequence[int] = (1, 1, 0),
    crash: bool = True,
    node: type[Node] = Node,
    limit: int = 2_000_000,
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
    return _Explorer(agents, tuple(asks), crash, node).run(limit)


class _Explorer:
    def __init__(self, agents: int, asks: tuple[int, ...], crash: bool, node: type[Node]) -> None:
        self.agents, self.asks, self.crash = agents, asks, crash
        self.nodes: list[Node] = []
        self.ids: dict[_Key, int] = {}
        self.messages: list[tuple[int, Message]] = []
        self.message_ids: dict[_Key, int] = {}
        self.adoptions: list[tuple[int, int, int]] = []
        self.results: dict[tuple[int, int | str], tuple[int, int, int]] = {}
        planner = TablePlanner(_TABLE[:agents], np.ones(2), pairwise=False)
        records = LandmarkRecords.initial(2, {0: np.array([0]), 1: np.array([1]), 2: np.array([], dtype=np.int64)})
        poses = {agent: pose_at(0) for agent in range(agents)}
        start: list[int] = []
        for agent in range(agents):
            one = node(agent, range(agents), records, poses, planner, order=lambda a, p, c, r: c, options=_OPTIONS)
            one.start(0.0, np.random.default_rng(0))
            start.append(self._intern(one))
        self.first: _State = (tuple(start), 0, 0)

    def run(self, limit: int) -> Exploration:
        came_from: dict[_State, tuple[_State, str] | None] = {self.first: None}
        stack, transitions = [self.first], 0
        while stack and len(came_from) < limit:
            state = stack.pop()
            for step, following in self._following(state):
                transitions += 1
                if following not in came_from:
                    came_from[following] = (state, step)
                    self._check(following, came_from)
                    stack.append(following)
        return Exploration(len(came_from), transitions, not stack)

    def _following(self, state: _State) -> Iterator[tuple[str, _State]]:
        team, sent, adopted = state
        dead = [agent for agent in range(self.agents) if team[agent] is None]
        for agent, known in enumerate(team):
            if known is None:
                continue
            moves: list[int | str] = [m for m in _bits(sent) if self.messages[m][0] == agent]
            moves += ["wait", *(["map"] if dead else []), *(f"bury {other}" for other in dead)]
            for move in moves:
                after, said, taken = self._act(known, move)
                if after != known or said & ~sent:
                    changed = (*team[:agent], after, *team[agent + 1 :])
                    name = move if isinstance(move, str) else f"hears {describe(self.messages[move][1])}"
                    yield f"agent {agent} {name}", (changed, sent | said, adopted | taken)
            if self.crash and not dead:
                yield f"agent {agent} dies", ((*team[:agent], None, *team[agent + 1 :]), sent, adopted)

    def _act(self, known: int, move: int | str) -> tuple[int, int, int]:
        """Return the state after a move of one agent, the messages that it sends, and what it adopts."""
        if (known, move) in self.results:
            return self.results[known, move]
        original, rng = self.nodes[known], np.random.default_rng(0)
        shared = (original._planner, original._detector)  # neither bears on what is checked
        node = copy.deepcopy(original, {id(thing): thing for thing in shared})
        outputs: list[Output] = []
        if isinstance(move, int):
            outputs = node.receive(0.0, self.messages[move][1], rng)
        elif move == "map":
            for other in range(self.agents):
                if other != node.agent:
                    node._send_map(other, outputs)
        elif move == "wait" and (node.lock is not Lock.IDLE or node._trades < self.asks[node.agent]):
            # Ask, send again, or give up: whatever it waits for is due.
            node._partners.ask_at = node._resend_at = node._give_up_at = 0.0
            outputs = node.poll(0.0, rng)
        elif isinstance(move, str) and move.startswith("bury"):
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
        self.results[known, move] = self._intern(node), said, taken
        return self.results[known, move]

    def _check(self, state: _State, came_from: dict[_State, tuple[_State, str] | None]) -> None:
        team, _, adopted = state
        living = [self.nodes[known] for known in team if known is not None]
        began = [self.adoptions[number][1:] for number in _bits(adopted)]
        for k in range(2):
            claims = [int(node.records.values[k, GENERATION]) for node in living if k in node.claims()]
            for generation in set(claims):
                if claims.count(generation) > 1 and began.count((k, generation)) < 2:
                    steps, at = [], came_from[state]
                    while at is not None:
                        steps.append(at[1])
                        at = came_from[at[0]]
                    story = "\n".join(reversed(steps))
                    raise Violation("I2", f"landmark {k} is claimed twice in generation {generation}:\n{story}")

    def _intern(self, node: Node) -> int:
        holdings = node._holdings
        owned = [node._answers[client] for client in sorted(node._answers)]
        key: _Key = (
            node.agent,
            node.lock,
            node._trades,
            node._open,
            node.at_waypoint,
            node.records.values.tobytes(),
            tuple((a, node.poses[a]) for a in sorted(node.poses)),
            node.escrow.trade if node.escrow else None,
            node.escrow.landmarks.tobytes() if node.escrow else None,
            node.partners,
            tuple(node._partners._line),
            tuple((trade, _key(answer) if answer else None) for trade, answer in owned),
            (node._pending.to, _key(node._pending.message)) if node._pending else None,
            tuple((server, _key(commit)) for server, commit in sorted(node._unsettled.items())),
            tuple(node._membership.living.items()) if node._membership else None,
            frozenset(node._maps_from),
            node._pose_is_due,
            node.epoch == node._asked_in_epoch,
            holdings.avoid,
        )
        if key not in self.ids:
            self.ids[key] = len(self.nodes)
            self.nodes.append(node)
        return self.ids[key]

    def _sent(self, send: Send) -> int:
        key = (send.to, *_key(send.message))
        if key not in self.message_ids:
            self.message_ids[key] = len(self.messages)
            self.messages.append((send.to, send.message))
        return self.message_ids[key]

    def _adopted(self, agent: int, k: int, generation: int) -> int:
        if (agent, k, generation) not in self.adoptions:
            self.adoptions.append((agent, k, generation))
        return self.adoptions.index((agent, k, generation))


def _key(message: Message) -> _Key:
    """Return what makes a message the same as another."""
    return (type(message).__name__, message.sender, describe(message))


def _bits(number: int) -> Iterator[int]:
    """Yield which bits are set."""
    while number:
        lowest = number & -number
        yield lowest.bit_length() - 1
        number ^= lowest
