"""Agents in different processes and on different machines, joined by Zenoh.

::

    covey/<mission>/trade/<to>/<from>             a query; the other's next message to the asker is the answer
    covey/<mission>/state/<agent>                 heartbeats; under congestion they are dropped, the next is newer
    covey/<mission>/log/<agent>                   events; under congestion the writer waits
    covey/<mission>/telemetry/<agent>             where the vehicle is, for observers; under congestion it is dropped
    covey/<mission>/map/<agent>                   a query of an observer; the answer is all that the agent knows
    covey/<mission>/change                        changes of landmarks and agents, from an operator
    covey/<mission>/alive/<agent>/<incarnation>   liveliness token
"""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping, Sequence
from functools import partial
from typing import cast

import zenoh
from zenoh.handlers import Callback

from covey.errors import Drop, NetworkError
from covey.protocol import OPERATOR, Event, Heartbeat, Map, Message, Sender
from covey.transports.codec import EVERYBODY, Channel, Codec, Content
from covey.transports.inbox import Arrival, Inbox
from covey.transports.links import Links
from covey.transports.network import NetworkOptions, leave_session, mission_prefix, open_session
from covey.transports.telemetry import Telemetry

MOST_ASKED = 16
"""How many may wait for a map at once."""

MOST_MISSIONS = 100
"""How many other missions are told apart."""

# Callbacks run on Zenoh's own threads and only store what came; nothing here calls Zenoh while it holds a lock.


class ZenohTransport:
    """One agent's access to the others; a `covey.transports.Transport`.

    Parameters
    ----------
    sender : Sender
        The agent and which life of it this is; the incarnation must rise at each start.
    codec : Codec
        Of the mission.
    options : NetworkOptions

    Raises
    ------
    NetworkError
        If the network cannot be joined.

    Notes
    -----
    A message goes as a query.  The answer to it, if it is ready within the half of `answer_timeout`, comes back by the
    same way; any other message is a query of its own.  A query that ends without an answer says nothing: the other may
    be dead, slow, or have nothing to say.  Every method may be called from any thread.  Do not fork a process that has
    one open.
    """

    def __init__(self, sender: Sender, codec: Codec, options: NetworkOptions) -> None:
        self.sender = sender
        self._codec = codec
        self._timeout = options.answer_timeout
        self._prefix = mission_prefix(codec.digest)
        self._inbox = Inbox(codec, sender.agent)
        self._lock = threading.Lock()
        self._number = 0
        self._held: dict[int, tuple[zenoh.Query, float]] = {}  # by asker: what to answer by, and until when
        self._maps: list[zenoh.Query] = []  # of those who asked for what this agent knows
        self._missions: set[str] = set()
        self._superseded = False
        self._counts = {"unanswered": 0, "unsent": 0, "renewals": 0}
        self._closed = False
        self._options = options
        self._links = Links(options.lease, options.silence)
        self._session = self._join()

    def _join(self) -> zenoh.Session:
        session = open_session(self._options, self._codec.digest, max_bytes=self._codec.max_bytes)
        try:
            self._declare(session)
        except zenoh.ZError as error:
            leave_session(session)
            raise NetworkError(f"cannot join the network: {error}") from error
        return session

    def _declare(self, session: zenoh.Session) -> None:
        agent = self.agent
        session.declare_queryable(f"{self._prefix}/trade/{agent}/*", Callback(self._on_query, indirect=False))
        session.declare_queryable(f"{self._prefix}/map/{agent}", Callback(self._on_map_query, indirect=False))
        session.declare_subscriber(f"{self._prefix}/state/*", Callback(self._on_state, indirect=False))
        session.declare_subscriber(f"{self._prefix}/change", Callback(self._on_change, indirect=False))
        liveliness = session.liveliness()
        liveliness.declare_subscriber(
            f"{self._prefix}/alive/*/*", Callback(self._on_token, indirect=False), history=True
        )
        if self._options.access is None:  # an access list hides other missions anyway
            liveliness.declare_subscriber(
                "covey/*/alive/*/*", Callback(self._on_any_token, indirect=False), history=True
            )
        self._token = liveliness.declare_token(f"{self._prefix}/alive/{agent}/{self.sender.incarnation}")

    @property
    def agent(self) -> int:
        """Whose access it is."""
        return self.sender.agent

    @property
    def arrived(self) -> int:
        """How many messages have arrived so far, those that are dropped later among them."""
        return self._inbox.arrived

    @property
    def dropped(self) -> Mapping[Drop, int]:
        """How many arrivals were dropped so far, by cause."""
        return self._inbox.dropped

    @property
    def unanswered(self) -> int:
        """How many queries ended without an answer so far."""
        with self._lock:
            return self._counts["unanswered"]

    @property
    def unsent(self) -> int:
        """How many messages the network did not take so far."""
        with self._lock:
            return self._counts["unsent"]

    @property
    def renewals(self) -> int:
        """How often the network was joined anew because a link no longer led both ways so far."""
        with self._lock:
            return self._counts["renewals"]

    @property
    def peers(self) -> frozenset[Sender]:
        """The other agents whose tokens are there, each in its newest life."""
        return self._links.peers

    @property
    def suspects(self) -> frozenset[Sender]:
        """The other agents whose tokens were there and are lost: by death, or because the way to them broke."""
        return self._links.suspects

    @property
    def superseded(self) -> bool:
        """Whether a newer life of this agent is on the network: then this one is over."""
        with self._lock:
            return self._superseded

    @property
    def other_missions(self) -> frozenset[str]:
        """Digests, in hexadecimal, of other missions whose agents are on the same network; not with an access list."""
        with self._lock:
            return frozenset(self._missions)

    @property
    def map_wanted(self) -> bool:
        """Whether an observer waits for `show_map`."""
        with self._lock:
            return bool(self._maps)

    def show_map(self, known: Map) -> None:
        """Tell the observers that asked what this agent knows."""
        with self._lock:
            queries = [(query, self._next_number()) for query in self._maps]
            self._maps = []
        for query, number in queries:
            data = self._codec.encode(known, sender=known.sender, to=EVERYBODY, number=number)
            with query:
                try:
                    query.reply(f"{self._prefix}/map/{self.agent}", data)
                except zenoh.ZError:
                    self._count("unsent")

    def send(self, to: int, message: Message) -> None:
        """Send a message to one agent.

        Raises
        ------
        ArgumentError
            If the message is longer than the codec allows.
        """
        with self._lock:
            if self._closed:
                return
            number = self._next_number()
            held = self._held.pop(to, None)
        data = self._codec.encode(message, sender=message.sender, to=to, number=number)
        try:
            if held is None or not _answer(*held, data):
                self._ask(to, data)
        except zenoh.ZError:
            self._count("unsent")

    def publish(self, heartbeat: Heartbeat) -> None:
        """Publish the newest state to all others that listen; under congestion it may be lost, so repeat it."""
        self._put(f"{self._prefix}/state/{self.agent}", heartbeat.sender, heartbeat, zenoh.CongestionControl.DROP, None)

    def log(self, event: Event) -> None:
        """Publish an event to observers; waits while one of them is slow, and Zenoh gives it up after 5 s."""
        self._put(
            f"{self._prefix}/log/{self.agent}",
            self.sender,
            event,
            zenoh.CongestionControl.BLOCK,
            zenoh.Priority.DATA_LOW,
        )

    def report(self, telemetry: Telemetry) -> None:
        """Tell observers where the vehicle is; like the log behind all that agents say, and lost under congestion."""
        self._put(
            f"{self._prefix}/telemetry/{self.agent}",
            telemetry.sender,
            telemetry,
            zenoh.CongestionControl.DROP,
            zenoh.Priority.DATA_LOW,
        )

    def receive(self) -> list[Message]:
        """Take what has arrived, in the order of arrival; of an agent's heartbeats only the newest."""
        messages = cast("list[Message]", self._inbox.take())  # no events: they travel by a channel of their own
        self._look_at_links(messages)
        return messages

    def wait(self, timeout: float) -> bool:
        """Wait until something has arrived, seconds at most; whether it has."""
        return self._inbox.wait(timeout)

    def close(self) -> None:
        """Leave: nothing arrives any more, and what is sent goes nowhere."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
        self._inbox.close()
        self._leave()

    def _look_at_links(self, messages: Sequence[Message]) -> None:
        now = time.monotonic()
        for message in messages:
            if isinstance(message, Heartbeat):
                self._links.hear(message.sender, now)
        if self._links.must_renew(now):
            self._renew()

    def _renew(self) -> None:
        """Join the network anew; what is sent meanwhile is lost."""
        self._leave()
        try:
            session = self._join()
        except NetworkError:
            self._links.try_again(time.monotonic())
            return
        self._count("renewals")
        with self._lock:
            self._session, closed = session, self._closed
        if closed:
            leave_session(session)

    def _leave(self) -> None:
        with self._lock:
            queries = [query for query, _ in self._held.values()] + self._maps
            self._held, self._maps = {}, []
        for query in queries:
            query.drop()
        leave_session(self._session)

    # What goes out.

    def _next_number(self) -> int:
        self._number += 1
        return self._number

    def _put(
        self,
        key: str,
        sender: Sender,
        content: Content,
        congestion: zenoh.CongestionControl,
        priority: zenoh.Priority | None,
    ) -> None:
        with self._lock:
            if self._closed:
                return
            number = self._next_number()
        data = self._codec.encode(content, sender=sender, to=EVERYBODY, number=number)
        try:
            # The key in full, not a declared publisher's: the number that stands for that on the wire has been seen to
            # mean another key after a process was stopped for longer than the lease and its link was made anew.
            self._session.put(
                key,
                data,
                congestion_control=congestion,
                priority=priority,
                allowed_destination=zenoh.Locality.REMOTE,
            )
        except zenoh.ZError:
            self._count("unsent")

    def _ask(self, to: int, data: bytes) -> None:
        answers: list[zenoh.Reply] = []
        self._session.get(
            f"{self._prefix}/trade/{to}/{self.agent}",
            Callback(partial(self._on_reply, to, answers), partial(self._on_end, answers), indirect=False),
            payload=data,
            timeout=self._timeout,
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            congestion_control=zenoh.CongestionControl.DROP,
        )

    def _count(self, what: str) -> None:
        with self._lock:
            self._counts[what] += 1

    # What comes in, on Zenoh's threads.

    def _on_query(self, query: zenoh.Query) -> None:
        sender = agent_of(str(query.key_expr))
        payload = query.payload
        if sender is None or payload is None or len(payload) > self._codec.max_bytes:
            self._inbox.count(Drop.MALFORMED if sender is None or payload is None else Drop.TOO_LONG)
            query.drop()
            return
        self._inbox.put(Arrival(payload.to_bytes(), sender, Channel.TRADE, partial(self._hold, sender, query)))

    def _on_map_query(self, query: zenoh.Query) -> None:
        with self._lock:
            welcome = len(self._maps) < MOST_ASKED and not self._closed
            if welcome:
                self._maps.append(query)
        if welcome:
            self._inbox.wake()
        else:
            query.drop()

    def _on_reply(self, to: int, answers: list[zenoh.Reply], reply: zenoh.Reply) -> None:
        answers.append(reply)
        sample = reply.ok
        if isinstance(sample, zenoh.Sample):
            self._store(sample.payload, to, Channel.TRADE)
        else:
            self._inbox.count(Drop.MALFORMED)

    def _on_end(self, answers: list[zenoh.Reply]) -> None:
        if not answers:
            self._count("unanswered")

    def _on_state(self, sample: zenoh.Sample) -> None:
        self._store(sample.payload, agent_of(str(sample.key_expr)), Channel.STATE)

    def _on_change(self, sample: zenoh.Sample) -> None:
        self._store(sample.payload, OPERATOR, Channel.CHANGE)

    def _on_token(self, sample: zenoh.Sample) -> None:
        whose, present = token_of(sample)
        if whose is None or whose.agent >= self._codec.agents:
            self._inbox.count(Drop.MALFORMED)
        elif whose.agent != self.agent:
            self._links.see(whose, present=present)
        elif present and whose.incarnation > self.sender.incarnation:
            with self._lock:
                self._superseded = True

    def _on_any_token(self, sample: zenoh.Sample) -> None:
        prefix = str(sample.key_expr).partition("/alive/")[0]
        with self._lock:
            if prefix != self._prefix and len(self._missions) < MOST_MISSIONS:
                self._missions.add(prefix.partition("/")[2])

    def _store(self, payload: zenoh.ZBytes, sender: int | None, channel: Channel) -> None:
        store(self._inbox, self._codec, payload, sender, channel)

    # On the thread of whoever calls.

    def _hold(self, sender: int, query: zenoh.Query, accepted: bool) -> None:
        """Keep a query so that the next message to the asker goes back by it."""
        if not accepted:
            query.drop()
            return
        with self._lock:
            old = self._held.get(sender)
            self._held[sender] = query, time.monotonic() + 0.5 * self._timeout
        if old is not None:
            old[0].drop()


def _answer(query: zenoh.Query, until: float, data: bytes) -> bool:
    """Send a message by the way of a query, if that still leads anywhere; whether it does."""
    with query:
        in_time = time.monotonic() < until
        if in_time:
            query.reply(query.key_expr, data)
        return in_time


def store(inbox: Inbox, codec: Codec, payload: zenoh.ZBytes, sender: int | None, channel: Channel) -> None:
    """Put what came from an agent by a channel into the inbox; what cannot be from anybody is counted."""
    if sender is None:
        inbox.count(Drop.MALFORMED)
    elif len(payload) > codec.max_bytes:
        inbox.count(Drop.TOO_LONG)
    else:
        inbox.put(Arrival(payload.to_bytes(), sender, channel))


def agent_of(key: str) -> int | None:
    """Return the agent that a key ends with."""
    return _number(key.rpartition("/")[2])


def token_of(sample: zenoh.Sample) -> tuple[Sender | None, bool]:
    """Return whose liveliness token has come or gone, None for nobody's, and whether it has come."""
    *_, agent_name, incarnation_name = str(sample.key_expr).split("/")
    agent, incarnation = _number(agent_name), _number(incarnation_name)
    whose = None if agent is None or incarnation is None else Sender(agent, incarnation)
    return whose, sample.kind == zenoh.SampleKind.PUT


def _number(text: str) -> int | None:
    return int(text) if text.isascii() and text.isdigit() and len(text) < 20 else None


__all__ = ["ZenohTransport", "agent_of", "store", "token_of"]
