"""What has arrived from a real network: decoded, counted, and each message handed out once."""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from covey.errors import ArgumentError, CodecError, Drop
from covey.protocol import OPERATOR, Heartbeat, Sender
from covey.transports.codec import EVERYBODY, LATEST, LAYOUTS, Channel, Codec, Content, Envelope

_CHANNELS = {layout.type: layout.channel for layout in LAYOUTS.values()}

WINDOW = 1024
"""How far a message may be overtaken by others of its sender and is still taken."""

MOST_OPERATORS = 64
"""So many operators are told apart."""


class ReplayGuard:
    """Lets each number of one agent pass once.

    Of the newest life heard of, a number passes if it is new and among the newest `WINDOW`; earlier lives never pass.

    Examples
    --------
    >>> guard = ReplayGuard()
    >>> [guard.passes(1, number) for number in (5, 3, 5, 2000, 3)], guard.passes(0, 9), guard.passes(2, 0)
    ([True, True, False, True, False], False, True)
    """

    def __init__(self) -> None:
        self._incarnation = -1
        self._highest = -1
        self._seen = 0  # bit i: number `_highest - i` was here

    def passes(self, incarnation: int, number: int) -> bool:
        """Whether a message is new; asked once a message."""
        if incarnation > self._incarnation:
            self._incarnation, self._highest, self._seen = incarnation, number, 1
            return True
        if incarnation < self._incarnation:
            return False
        ahead = number - self._highest
        if ahead > 0:
            self._seen = (self._seen << ahead | 1) & ((1 << WINDOW) - 1) if ahead < WINDOW else 1
            self._highest = number
            return True
        bit = 1 << -ahead if ahead > -WINDOW else 0
        new = bit != 0 and not self._seen & bit
        self._seen |= bit
        return new


def ignore(accepted: bool) -> None:
    """Do nothing, whatever became of an arrival."""


@dataclass(frozen=True, slots=True)
class Arrival:
    """Bytes as they came.

    Parameters
    ----------
    data : bytes
    sender : int
        By whose key they came.
    channel : Channel
        By which channel.
    done : callable
        ``done(accepted)`` is called once, when it is known what became of them.
    """

    data: bytes
    sender: int
    channel: Channel
    done: Callable[[bool], None] = ignore


class Inbox:
    """Collects bytes from network threads and hands out what they say; every method may be called from any thread.

    Parameters
    ----------
    codec : Codec
    to : int
        Whose inbox it is; `EVERYBODY`: an observer's.
    capacity : int, keyword-only
        How much may wait: this many arrivals, and `codec.max_bytes` four times over.

    Raises
    ------
    ArgumentError
        If the capacity is below 1.

    Notes
    -----
    `put` only stores; `take` decodes.  Of several heartbeats of an agent only the newest is handed out, and likewise of
    its telemetry.
    """

    def __init__(self, codec: Codec, to: int, *, capacity: int = 10_000) -> None:
        if capacity < 1:
            raise ArgumentError(f"capacity: expected at least 1, got {capacity}")
        self._codec = codec
        self._to = to
        self._capacity = capacity
        self._arrivals: deque[Arrival] = deque()
        self._bytes = 0
        self._closed = False
        self._woken = False
        self._arrived = threading.Condition()
        self._taking = threading.Lock()
        self._guards: dict[int, ReplayGuard] = {}
        self._operators: dict[int, ReplayGuard] = {}  # by incarnation: no life replaces another
        self._newest: dict[tuple[int, Channel], tuple[int, int]] = {}
        self._dropped: Counter[Drop] = Counter()
        self._count = 0

    @property
    def arrived(self) -> int:
        """How much has been stored so far."""
        with self._arrived:
            return self._count

    @property
    def dropped(self) -> Mapping[Drop, int]:
        """How many arrivals were dropped so far, by cause."""
        with self._arrived:
            return dict(self._dropped)

    def count(self, cause: Drop) -> None:
        """Count one that was dropped elsewhere."""
        with self._arrived:
            self._dropped[cause] += 1

    def put(self, arrival: Arrival) -> None:
        """Store what has arrived, if there is room."""
        with self._arrived:
            room = len(self._arrivals) < self._capacity
            room = room and self._bytes + len(arrival.data) <= 4 * self._codec.max_bytes
            if room and not self._closed:
                self._arrivals.append(arrival)
                self._bytes += len(arrival.data)
                self._count += 1
                self._arrived.notify_all()
                return
            if not self._closed:
                self._dropped[Drop.FULL] += 1
        arrival.done(False)

    def wait(self, timeout: float) -> bool:
        """Wait until something is there, or `wake` is called, seconds at most; whether something is."""
        with self._arrived:
            self._arrived.wait_for(lambda: self._closed or self._woken or self._arrivals, timeout)
            self._woken = False
            return bool(self._arrivals)

    def wake(self) -> None:
        """End a wait, this or the next one, although nothing has arrived."""
        with self._arrived:
            self._woken = True
            self._arrived.notify_all()

    def close(self) -> None:
        """Throw away what is there and take nothing more."""
        with self._arrived:
            self._closed = True
            self._arrived.notify_all()
        for arrival in self._empty():
            arrival.done(False)

    def take(self) -> list[Content]:
        """Decode all that has arrived since the last call, in its order."""
        with self._taking:
            contents: dict[int, Content] = {}
            latest: dict[tuple[int, Channel], int] = {}  # where that of an agent is of which the newest counts
            for position, arrival in enumerate(self._empty()):
                try:
                    content = self._accept(arrival).content
                except CodecError as error:
                    self.count(error.cause)
                    arrival.done(False)
                    continue
                arrival.done(True)
                if arrival.channel in LATEST:
                    whose = arrival.sender, arrival.channel
                    if contents.pop(latest.get(whose, -1), None) is not None:
                        self.count(Drop.OUTDATED)
                    latest[whose] = position
                contents[position] = content
            return list(contents.values())

    def _empty(self) -> deque[Arrival]:
        with self._arrived:
            arrivals, self._arrivals, self._bytes = self._arrivals, deque(), 0
            return arrivals

    def _guard(self, sender: Sender) -> ReplayGuard:
        if sender.agent != OPERATOR:
            return self._guards.setdefault(sender.agent, ReplayGuard())
        if sender.incarnation not in self._operators and len(self._operators) >= MOST_OPERATORS:
            del self._operators[next(iter(self._operators))]
        return self._operators.setdefault(sender.incarnation, ReplayGuard())

    def _accept(self, arrival: Arrival) -> Envelope:
        envelope = self._codec.decode(arrival.data)
        sender, content = envelope.sender, envelope.content
        to = self._to if arrival.channel is Channel.TRADE else EVERYBODY
        if (sender.agent, envelope.to, _CHANNELS[type(content)]) != (arrival.sender, to, arrival.channel):
            raise CodecError(
                Drop.IMPOSTOR, f"{type(content).__name__} of {sender.agent} by the key of {arrival.sender}"
            )
        if not self._guard(sender).passes(sender.incarnation, envelope.number):
            raise CodecError(Drop.REPLAYED, f"number {envelope.number} of {sender}")
        if arrival.channel in LATEST:
            place = sender.incarnation, content.sequence if isinstance(content, Heartbeat) else envelope.number
            if place <= self._newest.get((sender.agent, arrival.channel), (-1, -1)):
                raise CodecError(Drop.OUTDATED, f"{type(content).__name__} {place}")
            self._newest[sender.agent, arrival.channel] = place
        return envelope


__all__ = ["Arrival", "Inbox", "ReplayGuard", "ignore"]
