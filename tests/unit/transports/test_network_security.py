"""Mutual TLS and the access list: who has no certificate, or another's name, changes nothing."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from tests.certificates import Authority
from tests.contents import CODEC, beat, busy, telemetry
from tests.net import free_endpoint, wait_until

from covey.errors import Drop, NetworkError
from covey.protocol import (
    Catalogue,
    Change,
    LandmarkChange,
    Map,
    RecordSlice,
    Sender,
)
from covey.transports.network import AccessList, Credentials, Mode, NetworkOptions, Router
from covey.transports.telemetry import Telemetry
from covey.transports.zenoh import ZenohTransport
from covey.transports.zenoh_observer import ZenohObserver

LONG_ENOUGH = 1.0
"""Seconds in which a stranger that is let in is long there: members take a few hundredths."""


class Guarded:
    """Two agents that show certificates; `access` also ties what an agent may say to its name."""

    def __init__(self, stack: ExitStack, folder: Path, access: AccessList | None) -> None:
        self.stack = stack
        self.authority = Authority(folder)
        self.access = access
        self.meeting_point = free_endpoint("tls")
        self.a = self.join(0, self.authority.issue("zero"), listen=True)
        self.b = self.join(1, self.authority.issue("one"))
        wait_until(lambda: self.a.peers and self.b.peers, "the two see each other")

    def options(self, credentials: Credentials | None, *, listen: bool = False) -> NetworkOptions:
        here = (self.meeting_point,)
        return NetworkOptions(
            listen=here if listen else None,
            connect=() if listen else here,
            credentials=credentials,
            access=None if credentials is None else self.access,
        )

    def join(self, agent: int, credentials: Credentials | None, *, listen: bool = False) -> ZenohTransport:
        options = self.options(credentials, listen=listen)
        transport = ZenohTransport(Sender(agent, 1), CODEC, options)
        self.stack.callback(transport.close)
        return transport

    def require_unheard(self, stranger: ZenohTransport, agent: int) -> None:
        """Let a stranger speak as an agent; the two must notice nothing, and go on."""
        for number in range(5):
            for to in {0, 1} - {agent}:
                stranger.send(to, busy(agent, number))
            stranger.publish(beat(agent, number))
            time.sleep(LONG_ENOUGH / 5)
        for member in (self.a, self.b):
            assert member.receive() == []
            assert member.suspects == frozenset()
        self.require_going_on()
        assert stranger.receive() == []

    def require_going_on(self) -> None:
        self.a.send(1, busy(0, 77))
        wait_until(lambda: self.b.receive() == [busy(0, 77)], "the two go on")
        self.b.send(0, busy(1, 78))
        wait_until(lambda: self.a.receive() == [busy(1, 78)], "the two go on")


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


@pytest.fixture
def guarded(stack: ExitStack, tmp_path: Path) -> Guarded:
    return Guarded(stack, tmp_path, None)


@pytest.fixture
def listed(stack: ExitStack, tmp_path: Path) -> Guarded:
    return Guarded(
        stack, tmp_path, AccessList({0: "zero", 1: "one", 2: "two"}, observers=("eye",), operators=("chief",))
    )


def test_members_talk(guarded: Guarded) -> None:
    guarded.require_going_on()
    guarded.a.publish(beat(0, 1))
    wait_until(guarded.b.receive, "the heartbeat arrives")


def test_without_a_certificate_nobody_is_let_in(guarded: Guarded) -> None:
    plain = NetworkOptions(connect=(guarded.meeting_point.replace("tls/", "tcp/"),))
    stranger = ZenohTransport(Sender(2, 1), CODEC, plain)
    guarded.stack.callback(stranger.close)
    guarded.require_unheard(stranger, 2)
    assert stranger.peers == frozenset()


def test_a_certificate_of_another_authority_does_not_help(guarded: Guarded, tmp_path: Path) -> None:
    forger = Authority(tmp_path, "forger")
    stranger = guarded.join(2, forger.issue("two", trusted=guarded.authority.path))
    guarded.require_unheard(stranger, 2)
    assert stranger.peers == frozenset()


def test_an_expired_certificate_does_not_help(guarded: Guarded) -> None:
    stranger = guarded.join(2, guarded.authority.issue("two", expired=True))
    guarded.require_unheard(stranger, 2)
    assert stranger.peers == frozenset()


def test_members_on_the_list_talk(listed: Guarded) -> None:
    listed.require_going_on()
    two = listed.join(2, listed.authority.issue("two"))
    wait_until(lambda: len(two.peers) == 2 and len(listed.a.peers) == 2, "agent 2 is seen")
    two.send(0, busy(2))
    wait_until(lambda: listed.a.receive() == [busy(2)], "agent 2 is heard")
    two.publish(beat(2, 1))
    wait_until(listed.a.receive, "agent 2's heartbeat is heard")


def test_a_certificate_of_somebody_not_on_the_list_does_not_help(listed: Guarded) -> None:
    stranger = listed.join(2, listed.authority.issue("mallory"))
    listed.require_unheard(stranger, 2)
    assert Sender(2, 1) not in listed.a.peers | listed.b.peers


def test_a_member_cannot_speak_as_another(listed: Guarded) -> None:
    two = listed.join(1, listed.authority.issue("two"))  # its name is that of agent 2
    listed.require_unheard(two, 1)


def test_a_member_that_names_another_in_its_message_is_counted(listed: Guarded) -> None:
    two = listed.join(2, listed.authority.issue("two"))
    wait_until(lambda: len(two.peers) == 2 and len(listed.a.peers) == 2, "agent 2 is seen")
    two.send(0, busy(1))
    wait_until(lambda: listed.a.receive() or listed.a.dropped, "the lie is counted")
    assert listed.a.dropped == {Drop.IMPOSTOR: 1}


def sees(one: ZenohTransport, other: ZenohTransport) -> bool:
    return one.peers == {other.sender}


def test_who_joins_anew_has_the_same_rights(listed: Guarded) -> None:
    for member, other in ((listed.a, listed.b), (listed.b, listed.a)):
        member._renew()
        for one, another in ((member, other), (other, member)):
            wait_until(partial(sees, one, another), "they meet again")
        for one in (listed.a, listed.b):
            one.receive()
        listed.require_going_on()
        assert member.renewals == 1


def test_an_observer_on_the_list_hears(listed: Guarded) -> None:
    observer = ZenohObserver(CODEC, listed.options(listed.authority.issue("eye")))
    listed.stack.callback(observer.close)

    def heard() -> bool:
        listed.a.publish(beat(0, 1 + int(1000.0 * time.monotonic())))
        return bool(observer.receive())

    wait_until(heard, "the observer hears")


def test_an_observer_on_the_list_may_ask_for_maps_and_nobody_else_answers(listed: Guarded) -> None:
    observer = ZenohObserver(CODEC, listed.options(listed.authority.issue("eye")))
    listed.stack.callback(observer.close)
    known = Map(Sender(0, 1), RecordSlice(np.array([1]), np.ones((1, 4), dtype=np.int64)), {})
    heard: list[object] = []

    def asked() -> bool:
        observer.ask_for_maps()
        if listed.a.map_wanted:
            listed.a.show_map(known)
        heard.extend(observer.receive())
        return bool(heard)

    wait_until(asked, "the map arrives")
    assert all(isinstance(message, Map) and message.sender == known.sender for message in heard)
    assert observer.dropped == {}


def test_an_observer_hears_of_each_vehicle_from_its_agent_alone(listed: Guarded) -> None:
    observer = ZenohObserver(CODEC, listed.options(listed.authority.issue("eye")))
    listed.stack.callback(observer.close)
    two = listed.join(2, listed.authority.issue("two"))
    as_another = listed.join(0, listed.authority.issue("two"))  # its name is that of agent 2
    heard: list[object] = []

    def all_told() -> bool:
        for member in (listed.a, two):
            member.report(telemetry(member.agent, x=1.0))
        as_another.report(telemetry(0, x=66.0))  # by the key of agent 0, which is denied
        two.report(telemetry(0, x=66.0))  # by its own key, as agent 0
        heard.extend(observer.receive())
        told = {item.sender.agent for item in heard if isinstance(item, Telemetry)}
        return told == {0, 2} and observer.dropped.get(Drop.IMPOSTOR, 0) > 3

    wait_until(all_told, "both are heard, and the lie is counted")
    time.sleep(LONG_ENOUGH)
    as_another.report(telemetry(0, x=66.0))
    time.sleep(LONG_ENOUGH)
    heard.extend(observer.receive())
    assert all(isinstance(item, Telemetry) and item.state[0] == 1.0 for item in heard)
    assert set(observer.dropped) <= {Drop.IMPOSTOR, Drop.OUTDATED}


NEWS = Catalogue({1: LandmarkChange(1, True, 4.0, 0.5, 0.5)})


def test_an_operator_on_the_list_makes_changes_and_asks_for_maps(listed: Guarded) -> None:
    operator = ZenohObserver(CODEC, listed.options(listed.authority.issue("chief")))
    listed.stack.callback(operator.close)
    heard: list[object] = []

    def told() -> bool:
        operator.announce(NEWS)
        heard.extend(listed.a.receive())
        return bool(heard)

    wait_until(told, "the change arrives")
    assert all(isinstance(message, Change) and message.catalogue == NEWS for message in heard)
    operator.ask_for_maps()
    wait_until(lambda: listed.a.map_wanted, "the question arrives")


@pytest.mark.parametrize("name", ["eye", "two", "mallory"])
def test_nobody_else_on_the_list_makes_changes(listed: Guarded, name: str) -> None:
    stranger = ZenohObserver(CODEC, listed.options(listed.authority.issue(name)))
    listed.stack.callback(stranger.close)
    for _ in range(5):
        stranger.announce(NEWS)
        time.sleep(LONG_ENOUGH / 5)
    assert listed.a.receive() == listed.b.receive() == []
    listed.require_going_on()


def test_a_router_enforces_the_list_for_its_clients(stack: ExitStack, tmp_path: Path) -> None:
    authority = Authority(tmp_path)
    access = AccessList({0: "zero", 1: "one"}, routers=("router",))
    endpoint = free_endpoint("tls")

    def options(name: str, mode: Mode) -> NetworkOptions:
        listen, connect = ((endpoint,), ()) if mode is Mode.ROUTER else (None, (endpoint,))
        return NetworkOptions(
            mode=mode, listen=listen, connect=connect, credentials=authority.issue(name), access=access
        )

    router = Router(options("router", Mode.ROUTER), CODEC.digest)
    stack.callback(router.close)
    a, b = (
        ZenohTransport(Sender(agent, 1), CODEC, options(name, Mode.CLIENT))
        for agent, name in enumerate(("zero", "one"))
    )
    stack.callback(a.close)
    stack.callback(b.close)
    wait_until(lambda: a.peers and b.peers, "the two see each other")
    mallory = ZenohTransport(Sender(1, 2), CODEC, options("mallory", Mode.CLIENT))
    stack.callback(mallory.close)
    mallory.send(0, busy(1))
    time.sleep(LONG_ENOUGH)
    assert a.receive() == []
    assert a.peers == {Sender(1, 1)}
    a.send(1, busy(0))
    wait_until(lambda: b.receive() == [busy(0)], "the two go on")


def test_files_that_cannot_be_used_are_reported(tmp_path: Path) -> None:
    missing = Credentials(tmp_path / "ca.pem", tmp_path / "me.pem", tmp_path / "me.key")
    with pytest.raises(NetworkError, match="cannot join the network"):
        ZenohTransport(Sender(0, 1), CODEC, NetworkOptions(credentials=missing))


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    own = Authority(tmp_path).issue("zero")
    absent = replace(own, key=tmp_path / "absent.key")
    with pytest.raises(NetworkError, match=r"absent\.key: No such file or directory$"):
        ZenohTransport(Sender(0, 1), CODEC, NetworkOptions(credentials=absent))
