"""Who listens to a mission on Zenoh without being one of its agents."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Mapping
from functools import partial
from typing import cast

import zenoh
from zenoh.handlers import Callback

from covey.errors import Drop, NetworkError
from covey.protocol import OPERATOR, Catalogue, Change, Event, Heartbeat, Map, Sender
from covey.transports.codec import EVERYBODY, Channel, Codec
from covey.transports.inbox import Inbox
from covey.transports.links import Links
from covey.transports.network import NetworkOptions, leave_session, mission_prefix, open_session
from covey.transports.telemetry import Telemetry
from covey.transports.zenoh import agent_of, store, token_of


class ZenohObserver:
    """Hears states, events and telemetry of a mission and asks what agents know; an operator's says what has changed.

    Parameters
    ----------
    codec : Codec
        Of the mission.
    options : NetworkOptions

    Raises
    ------
    NetworkError
        If the network cannot be joined.
    """

    def __init__(self, codec: Codec, options: NetworkOptions) -> None:
        self._codec = codec
        self._options = options
        self._prefix = mission_prefix(codec.digest)
        self._inbox = Inbox(codec, EVERYBODY)
        self._links = Links(options.lease, options.silence)
        self._life = time.time_ns() // 1000  # as an operator; no two need to be in order
        self._number = 0
        self._session = self._join()

    def _join(self) -> zenoh.Session:
        session = open_session(self._options, self._codec.digest, max_bytes=self._codec.max_bytes)
        try:
            for channel in (Channel.STATE, Channel.LOG, Channel.TELEMETRY):
                session.declare_subscriber(
                    f"{self._prefix}/{channel.value}/*", Callback(partial(self._on_sample, channel), indirect=False)
                )
            session.liveliness().declare_subscriber(
                f"{self._prefix}/alive/*/*", Callback(self._on_token, indirect=False), history=True
            )
        except zenoh.ZError as error:
            leave_session(session)
            raise NetworkError(f"cannot join the network: {error}") from error
        return session

    @property
    def dropped(self) -> Mapping[Drop, int]:
        """How many arrivals were dropped so far, by cause."""
        return self._inbox.dropped

    def receive(self) -> list[Heartbeat | Event | Map | Telemetry]:
        """Take what has arrived, in the order of arrival; of an agent's heartbeats and telemetry only the newest."""
        # Trades travel by a channel of their own.
        news = cast("list[Heartbeat | Event | Map | Telemetry]", self._inbox.take())
        now = time.monotonic()
        for content in news:
            if isinstance(content, Heartbeat):
                self._links.hear(content.sender, now)
        if self._links.must_renew(now):
            self._renew()
        return news

    def ask_for_maps(self) -> None:
        """Ask every agent what it knows; the answers arrive like all else."""
        with contextlib.suppress(zenoh.ZError):  # the network could not be joined anew yet
            self._session.get(
                f"{self._prefix}/map/*",
                Callback(self._on_map, indirect=False),
                timeout=self._options.answer_timeout,
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
            )

    def wait(self, timeout: float) -> bool:
        """Wait until something has arrived, seconds at most; whether it has."""
        return self._inbox.wait(timeout)

    def close(self) -> None:
        """Leave: nothing arrives any more."""
        self._inbox.close()
        leave_session(self._session)

    def announce(self, news: Catalogue) -> None:
        """Tell all agents of changes.  They may not hear of it, or not listen to it, so repeat it until maps show it.

        Raises
        ------
        ArgumentError
            If it is longer than the codec allows.
        """
        self._number += 1
        change = Change(Sender(OPERATOR, self._life), news)
        data = self._codec.encode(change, sender=change.sender, to=EVERYBODY, number=self._number)
        with contextlib.suppress(zenoh.ZError):
            self._session.put(f"{self._prefix}/change", data, congestion_control=zenoh.CongestionControl.BLOCK)

    def _renew(self) -> None:
        """Join the network anew, as an agent does."""
        leave_session(self._session)
        try:
            self._session = self._join()
        except NetworkError:
            self._links.try_again(time.monotonic())

    def _on_token(self, sample: zenoh.Sample) -> None:
        whose, present = token_of(sample)
        if whose is not None and whose.agent < self._codec.agents:
            self._links.see(whose, present=present)

    def _on_map(self, reply: zenoh.Reply) -> None:
        sample = reply.ok
        if isinstance(sample, zenoh.Sample):
            store(self._inbox, self._codec, sample.payload, agent_of(str(sample.key_expr)), Channel.TRADE)

    def _on_sample(self, channel: Channel, sample: zenoh.Sample) -> None:
        store(self._inbox, self._codec, sample.payload, agent_of(str(sample.key_expr)), channel)
