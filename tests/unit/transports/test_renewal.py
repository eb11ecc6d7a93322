"""Sessions that are renewed, since a link no longer leads both ways."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing
from itertools import count

import pytest
import zenoh
from tests.contents import CODEC, beat, busy
from tests.net import child, free_endpoint, wait_until

from covey.errors import NetworkError
from covey.protocol import Heartbeat, Sender
from covey.transports.network import NetworkOptions
from covey.transports.zenoh import ZenohTransport
from covey.transports.zenoh_observer import ZenohObserver

TOKEN = f"covey/{CODEC.digest.hex()}/alive/1/1"
LEASE = 0.5


class Pair:
    """Agent 0, and agent 1 that speaks whenever it is asked to and can hide its token."""

    def __init__(self, stack: ExitStack) -> None:
        self.meeting_point = free_endpoint()
        self.a = self.join(stack, 0, NetworkOptions(listen=(self.meeting_point,), lease=LEASE, silence=LEASE))
        self.b = self.join(stack, 1, self.guest)
        self.sequence = count(1)
        wait_until(lambda: self.a.peers and self.b.peers, "the two see each other")

    @property
    def guest(self) -> NetworkOptions:
        return NetworkOptions(connect=(self.meeting_point,), lease=LEASE, silence=LEASE)

    @staticmethod
    def join(stack: ExitStack, agent: int, options: NetworkOptions) -> ZenohTransport:
        return stack.enter_context(closing(ZenohTransport(Sender(agent, 1), CODEC, options)))

    def speak(self) -> None:
        """Let agent 1 be heard, and agent 0 listen."""
        self.b.publish(beat(1, next(self.sequence)))
        self.a.receive()

    def hide(self) -> None:
        self.b._token.undeclare()

    def show(self) -> None:
        self.b._token = self.b._session.liveliness().declare_token(TOKEN)


@pytest.fixture
def pair() -> Iterator[Pair]:
    with ExitStack() as stack:
        yield Pair(stack)


def test_who_hears_somebody_without_a_token_joins_the_network_anew(pair: Pair) -> None:
    a, b = pair.a, pair.b
    for _ in range(5):
        pair.speak()
    assert a.renewals == 0
    before = a._session.info.zid()
    pair.hide()

    def renewed() -> bool:
        pair.speak()
        return a.renewals > 0

    wait_until(renewed, "agent 0 gives its session up")
    assert a._session.info.zid() != before
    pair.show()
    wait_until(lambda: a.peers == {Sender(1, 1)} and b.peers == {Sender(0, 1)}, "they meet again")
    b.receive()
    a.send(1, busy(0))
    wait_until(lambda: busy(0) in b.receive(), "the question arrives")
    b.send(0, busy(1))
    wait_until(lambda: busy(1) in a.receive(), "the answer comes back")


def test_an_observer_joins_anew_as_well(pair: Pair) -> None:
    with closing(ZenohObserver(CODEC, pair.guest)) as observer:
        wait_until(lambda: observer._links.peers == {Sender(0, 1), Sender(1, 1)}, "the observer sees both")
        before = observer._session.info.zid()
        pair.hide()

        def renewed() -> bool:
            pair.b.publish(beat(1, next(pair.sequence)))
            observer.receive()
            return bool(observer._session.info.zid() != before)

        wait_until(renewed, "the observer gives its session up")
        pair.show()

        def heard() -> bool:
            pair.b.publish(beat(1, next(pair.sequence)))
            return any(isinstance(item, Heartbeat) for item in observer.receive())

        wait_until(heard, "it hears again")


def test_a_session_that_cannot_be_renewed_is_tried_again(pair: Pair, monkeypatch: pytest.MonkeyPatch) -> None:
    a, tries = pair.a, []

    def deny(*arguments: object, **options: object) -> zenoh.Session:
        tries.append(arguments)
        raise NetworkError("the port is taken")

    a._links.try_again(time.monotonic())
    with monkeypatch.context() as patched:
        patched.setattr("covey.transports.zenoh.open_session", deny)
        wait_until(lambda: a.receive() or len(tries) == 2, "it has been tried twice")
        a.send(1, busy(0))
        a.publish(beat(0, 1))
        assert a.unsent == 2
        assert a.renewals == 0
    wait_until(lambda: a.receive() or a.peers == {Sender(1, 1)}, "agent 0 is back")
    assert a.renewals == 1


def test_a_peer_that_does_not_read_does_not_hold_a_renewal_up() -> None:
    meeting_point = free_endpoint()
    options = NetworkOptions(listen=(meeting_point,), lease=LEASE)
    with closing(ZenohTransport(Sender(0, 1), CODEC, options)) as a, child(CODEC, meeting_point, lease=LEASE) as other:
        wait_until(lambda: a.peers == {Sender(1, 1)}, "the other process is there")
        other.send_signal(signal.SIGSTOP)
        try:
            for number in range(20):  # more than fits into the socket of who does not read
                a._session.put(f"covey/{CODEC.digest.hex()}/trade/1/0", bytes(60_000))
                a._session.put(f"covey/{CODEC.digest.hex()}/state/{number}", bytes(60_000))
            a._links.try_again(time.monotonic() - 2.0 * LEASE)
            wait_until(lambda: a.receive() or a.renewals == 1, "it is renewed although the old one does not close")
        finally:
            other.kill()


def test_who_closes_in_the_middle_of_a_renewal_leaves(pair: Pair, monkeypatch: pytest.MonkeyPatch) -> None:
    a, join = pair.a, pair.a._join
    late: list[zenoh.Session] = []

    def closed_meanwhile() -> zenoh.Session:
        a.close()
        late.append(join())
        return late[0]

    monkeypatch.setattr(a, "_join", closed_meanwhile)
    a._renew()
    assert late[0].is_closed()
