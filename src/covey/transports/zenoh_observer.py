"""Who listens to a mission on Zenoh without being one of its agents."""

from __future__ import annotations

import time
from collections.abc import Mapping
from functools import partial
from typing import cast

import zenoh
from zenoh.handlers import Callback

from covey.errors import Drop
from covey.protocol import OPERATOR, Catalogue, Change, Event, Heartbeat, Map, Sender
from covey.transports.codec import EVERYBODY, Channel, Codec
from covey.transports.inbox import Inbox
from covey.transports.network import NetworkOptions, mission_prefix, open_session
from covey.transports.telemetry import Telemetry
from covey.transports.zenoh import agent_of, store


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
        self._inbox = Inbox(codec, EVERYBODY)
        self._timeout = options.answer_timeout
        self._life = time.time_ns() // 1000  # as an operator; no two need to be in order
        self._number = 0
        self._session = open_session(options, codec.digest, max_bytes=codec.max_bytes)
        self._prefix = prefix = mission_prefix(codec.digest)
        for channel in (Channel.STATE, Channel.LOG, Channel.TELEMETRY):
            self._session.declare_subscriber(
                f"{prefix}/{channel.value}/*", Callback(partial(self._on_sample, channel), indirect=False)
            )

    @property
    def dropped(self) -> Mapping[Drop, int]:
        """How many arrivals were dropped so far, by cause."""
        return self._inbox.dropped

    def receive(self) -> list[Heartbeat | Event | Map | Telemetry]:
        """Take what has arrived, in the order of arrival; of an agent's heartbeats and telemetry only the newest."""
        return cast(
            "list[Heartbeat | Event | Map | Telemetry]", self._inbox.take()
        )  # trades travel by a channel of their own

    def ask_for_maps(self) -> None:
        """Ask every agent what it knows; the answers arrive like all else."""
        self._session.get(
            f"{self._prefix}/map/*",
            Callback(self._on_map, indirect=False),
            timeout=self._timeout,
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
        )

    def wait(self, timeout: float) -> bool:
        """Wait until something has arrived, seconds at most; whether it has."""
        return self._inbox.wait(timeout)

    def close(self) -> None:
        """Leave: nothing arrives any more."""
        self._inbox.close()
        self._session.close()

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
        self._session.put(f"{self._prefix}/change", data, congestion_control=zenoh.CongestionControl.BLOCK)

    def _on_map(self, reply: zenoh.Reply) -> None:
        sample = reply.ok
        if isinstance(sample, zenoh.Sample):
            store(self._inbox, self._codec, sample.payload, agent_of(str(sample.key_expr)), Channel.TRADE)

    def _on_sample(self, channel: Channel, sample: zenoh.Sample) -> None:
        store(self._inbox, self._codec, sample.payload, agent_of(str(sample.key_expr)), channel)
