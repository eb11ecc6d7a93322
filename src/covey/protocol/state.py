"""The one lock of an agent, as a table.

Everything that may happen to the lock is a row of `TRANSITIONS`; the node moves through it with `next_state`, and
`diagram` and `table` write the pictures in ``docs/protocol.md`` from it.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass

from covey.errors import CoveyError


class Lock(enum.Enum):
    """What an agent is doing in the trade it takes part in; one trade at a time."""

    IDLE = "IDLE"
    """No trade; the only state in which the agent itself may change its committed pose."""
    CLIENT_WAIT = "CLIENT_WAIT"
    """Asked a server and waits for its answer."""
    CLIENT_DONE = "CLIENT_DONE"
    """Committed the trade and waits until the server knows."""
    SERVER_PREPARED = "SERVER_PREPARED"
    """Offered a trade, keeps its pose and holds what it would give in escrow until the client decides."""


class Trigger(enum.Enum):
    """What moves the lock."""

    ASK = "ask"
    BUSY = "busy"
    NOTHING = "nothing"
    ACCEPT = "accept"
    DECLINE = "decline"
    GIVE_UP = "give up"
    ACK = "acknowledged"
    OFFER = "offer"
    COMMIT = "committed"
    ABORT = "aborted"
    PARTNER_DEAD = "partner dead"
    RESUME = "resume"


@dataclass(frozen=True)
class Transition:
    """One row of the table.

    Parameters
    ----------
    source, target : Lock
    trigger : Trigger
    receives, sends : str
        The message that comes in and the one that goes out; empty for none.
    meaning : str
        What happens, for the reader.
    """

    source: Lock
    trigger: Trigger
    target: Lock
    receives: str
    sends: str
    meaning: str


TRANSITIONS: tuple[Transition, ...] = (
    Transition(Lock.IDLE, Trigger.ASK, Lock.CLIENT_WAIT, "", "REQUEST", "at the waypoint, Q not empty, back-off over"),
    Transition(Lock.IDLE, Trigger.OFFER, Lock.SERVER_PREPARED, "REQUEST", "OFFER", "a trade is worth it: escrow"),
    Transition(Lock.CLIENT_WAIT, Trigger.BUSY, Lock.IDLE, "BUSY", "", "no failure: Q stays, back off"),
    Transition(Lock.CLIENT_WAIT, Trigger.NOTHING, Lock.IDLE, "NOTHING", "", "both drop each other from Q"),
    Transition(Lock.CLIENT_WAIT, Trigger.ACCEPT, Lock.CLIENT_DONE, "OFFER", "COMMIT", "the commit point"),
    Transition(Lock.CLIENT_WAIT, Trigger.DECLINE, Lock.IDLE, "OFFER", "ABORT", "stale, or no gain"),
    Transition(Lock.CLIENT_WAIT, Trigger.GIVE_UP, Lock.IDLE, "", "ABORT", "no answer: no failure, back off"),
    Transition(Lock.CLIENT_DONE, Trigger.ACK, Lock.IDLE, "ACK", "", "then Algorithm 3"),
    Transition(Lock.CLIENT_DONE, Trigger.PARTNER_DEAD, Lock.IDLE, "", "", "server dead: COMMIT is kept for its return"),
    Transition(Lock.IDLE, Trigger.RESUME, Lock.CLIENT_DONE, "", "COMMIT", "a server that was dead is asked again"),
    Transition(Lock.SERVER_PREPARED, Trigger.COMMIT, Lock.IDLE, "COMMIT", "ACK", "merge, then Algorithm 3"),
    Transition(Lock.SERVER_PREPARED, Trigger.ABORT, Lock.IDLE, "ABORT", "", "escrow released"),
    Transition(
        Lock.SERVER_PREPARED, Trigger.PARTNER_DEAD, Lock.IDLE, "", "", "client dead or reborn: escrow adopted by itself"
    ),
)
"""All that can happen to the lock.  A server never leaves SERVER_PREPARED by itself while its client lives."""

_NEXT = {(row.source, row.trigger): row.target for row in TRANSITIONS}


class ProtocolError(CoveyError):
    """The node tried a move that the table does not have: a mistake in covey."""

    exit_code = 3


def next_state(lock: Lock, trigger: Trigger) -> Lock:
    """Return where a trigger leads.

    Raises
    ------
    ProtocolError
        If the table has no such row.

    Examples
    --------
    >>> next_state(Lock.IDLE, Trigger.ASK)
    <Lock.CLIENT_WAIT: 'CLIENT_WAIT'>
    """
    try:
        return _NEXT[lock, trigger]
    except KeyError:
        raise ProtocolError(f"trigger: expected one that leaves {lock.value}, got {trigger.value!r}") from None


def diagram() -> str:
    """Return the table as a Mermaid state diagram."""
    lines = ["```mermaid", "stateDiagram-v2", f"    [*] --> {Lock.IDLE.value}"]
    for row in TRANSITIONS:
        label = " / ".join(part for part in (row.receives or row.trigger.value, row.sends) if part)
        if row.receives == "OFFER":
            label = f"{row.receives}, {row.trigger.value} / {row.sends}"
        lines.append(f"    {row.source.value} --> {row.target.value}: {label}")
    return "\n".join([*lines, "```"])


def table() -> str:
    """Return the table as Markdown."""
    lines = ["| in state | receives | because | sends | goes to |", "|---|---|---|---|---|"]
    for row in TRANSITIONS:
        cells = (row.source.value, row.receives or "-", row.meaning, row.sends or "-", row.target.value)
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)
