"""Agents over Zenoh on this machine: who is there, what strangers can do, other processes, and the event log."""

from __future__ import annotations

import json
import signal
from collections.abc import Iterator
from contextlib import ExitStack, closing
from functools import partial

import numpy as np
import pytest
import zenoh
from tests.contents import AGENTS, CODEC, LANDMARKS, beat, busy, telemetry
from tests.net import child, connect_team, free_endpoint, settle_team, wait_until
from zenoh.handlers import Callback

from covey.errors import ArgumentError, Drop, NetworkError
from covey.geometry import Pose2
from covey.protocol import (
    Abort,
    Busy,
    Cause,
    Map,
    PoseOptimized,
    Reason,
    RecordSlice,
    Sender,
    TradeId,
)
from covey.transports.codec import Codec
from covey.transports.network import AccessList, Credentials, Mode, NetworkOptions, Router
from covey.transports.telemetry import Telemetry
from covey.transports.zenoh import ZenohTransport
from covey.transports.zenoh_observer import ZenohObserver

PREFIX = f"covey/{CODEC.digest.hex()}"


class Net:
    """Two agents, and whoever else a test lets in at the same meeting point."""

    def __init__(self, stack: ExitStack) -> None:
        self.stack = stack
        self.meeting_point = free_endpoint()
        self.team = connect_team([0, 1], CODEC, self.meeting_point)
        for transport in self.team:
            stack.callback(transport.close)

    @property
    def options(self) -> NetworkOptions:
        return NetworkOptions(connect=(self.meeting_point,))

    def stranger(self) -> zenoh.Session:
        """A session of nobody."""
        config = zenoh.Config()
        for key, value in {
            "listen/endpoints": ["tcp/127.0.0.1:0"],
            "connect/endpoints": [self.meeting_point],
            "scouting/multicast/enabled": False,
        }.items():
            config.insert_json5(key, json.dumps(value))
        session = zenoh.open(config)
        self.stack.callback(session.close)
        wait_until(lambda: len(session.info.peers_zid()) >= 2, "the stranger meets both agents")
        return session


@pytest.fixture
def net() -> Iterator[Net]:
    with ExitStack() as stack:
        yield Net(stack)


def ask(session: zenoh.Session, key: str, payload: bytes) -> None:
    """Send a query as a stranger may."""
    session.get(key, zenoh.handlers.FifoChannel(8), payload=payload, timeout=1.0, target=zenoh.QueryTarget.ALL)


def test_a_question_and_its_answer_take_one_query(net: Net) -> None:
    a, b = net.team
    a.send(1, busy(0))
    assert b.wait(30.0)
    assert b.receive() == [busy(0)]
    b.send(0, busy(1))
    assert a.wait(30.0)
    assert a.receive() == [busy(1)]
    assert (a.unanswered, b.unanswered, a.unsent, b.unsent) == (0, 0, 0, 0)


def test_a_query_to_nobody_ends_without_an_answer_and_without_an_error(net: Net) -> None:
    a, _ = net.team
    a.send(3, busy(0))
    wait_until(lambda: a.unanswered == 1, "the query ends")
    assert a.receive() == []
    assert a.dropped == {}


def test_who_closes_becomes_a_suspect_and_a_new_life_clears_it(net: Net) -> None:
    a, b = net.team
    assert a.peers == {Sender(1, 1)}
    assert a.suspects == frozenset()
    b.close()
    wait_until(lambda: a.suspects == {Sender(1, 1)}, "the token of agent 1 is lost")
    assert a.peers == frozenset()
    with closing(ZenohTransport(Sender(1, 2), CODEC, net.options)) as again:
        wait_until(lambda: a.peers == {Sender(1, 2)}, "the new life of agent 1 is seen")
        assert a.suspects == frozenset()
        wait_until(lambda: again.peers == {Sender(0, 1)}, "agent 0 is seen")


def test_garbage_changes_nothing_and_is_counted(net: Net) -> None:
    a, b = net.team
    stranger = net.stranger()
    rng = np.random.default_rng(0)
    for size in (0, 1, 60, 5000):
        ask(stranger, f"{PREFIX}/trade/1/0", rng.bytes(size))
        stranger.put(f"{PREFIX}/state/0", rng.bytes(size))
    stranger.put(f"{PREFIX}/state/nobody", b"")
    ask(stranger, f"{PREFIX}/trade/1/*", b"x")
    token = stranger.liveliness().declare_token(f"{PREFIX}/alive/{AGENTS}/1")
    settle_team([a, b])
    assert b.receive() == []
    assert sum(b.dropped.values()) == b.dropped[Drop.MALFORMED]
    assert b.dropped[Drop.MALFORMED] >= 10
    assert b.peers == {Sender(0, 1)}
    token.undeclare()
    a.send(1, busy(0))
    wait_until(b.receive, "the agents go on")


def test_a_message_too_long_is_not_taken(net: Net) -> None:
    a, b = net.team
    small = Codec(CODEC.digest, agents=AGENTS, landmarks=LANDMARKS, max_bytes=1000)
    with closing(ZenohTransport(Sender(2, 1), small, net.options)) as listener:
        wait_until(lambda: Sender(2, 1) in a.peers and len(listener.peers) == 2, "agent 2 is seen")
        stranger = net.stranger()

        def counted() -> bool:
            stranger.put(f"{PREFIX}/state/0", bytes(2000))
            ask(stranger, f"{PREFIX}/trade/2/0", bytes(2000))
            return listener.dropped.get(Drop.TOO_LONG, 0) >= 10

        wait_until(counted, "it is counted")
        assert (listener.receive(), listener.arrived) == ([], 0)
    assert b.receive() == []


def test_replayed_messages_change_nothing_and_are_counted(net: Net) -> None:
    a, b = net.team
    stranger = net.stranger()
    overheard: list[tuple[str, bytes]] = []
    stranger.declare_subscriber(f"{PREFIX}/state/*", lambda s: overheard.append((str(s.key_expr), bytes(s.payload))))
    eavesdropper = stranger.declare_queryable(
        f"{PREFIX}/trade/1/*", lambda q: overheard.append((str(q.key_expr), bytes(q.payload or b"")))
    )

    def speak() -> bool:
        a.publish(beat(0, len(overheard) + 1))
        a.send(1, busy(0))
        return {key.split("/")[2] for key, _ in overheard} == {"state", "trade"}

    wait_until(speak, "the stranger overhears")
    eavesdropper.undeclare()
    settle_team([a, b])
    b.receive()
    before = b.dropped.get(Drop.REPLAYED, 0)
    copies = list(overheard)
    for key, data in copies:
        if "/state/" in key:
            stranger.put(key, data)
        else:
            ask(stranger, key, data)
    wait_until(lambda: b.receive() or b.dropped.get(Drop.REPLAYED, 0) >= before + len(copies), "copies are counted")
    assert b.receive() == []
    assert b.dropped[Drop.REPLAYED] == before + len(copies)


def test_another_missions_agents_are_not_heard(net: Net) -> None:
    a, b = net.team
    other = Codec(bytes(16), agents=AGENTS, landmarks=LANDMARKS)
    with closing(ZenohTransport(Sender(0, 1), other, net.options)) as stranger:
        wait_until(lambda: len(stranger._session.info.peers_zid()) >= 2, "the other mission's agent is connected")
        stranger.send(1, busy(0))
        stranger.publish(beat(0, 1))
        wait_until(lambda: stranger.unanswered == 1, "nobody answers it")
        assert stranger.peers == frozenset()
    impostor = net.stranger()
    impostor.put(f"{PREFIX}/state/0", other.encode(beat(0, 9), sender=Sender(0, 1), number=1))
    wait_until(lambda: b.receive() or b.dropped, "what comes by this mission's key is counted")
    assert b.dropped == {Drop.MISSION: 1}
    assert a.peers == {Sender(1, 1)}


def test_a_stranger_that_answers_in_anothers_place_is_not_believed(net: Net) -> None:
    a, _ = net.team
    stranger = net.stranger()
    lie = CODEC.encode(busy(1), sender=Sender(1, 1), to=0, number=1)

    def answer(query: zenoh.Query) -> None:
        with query:
            query.reply(query.key_expr, b"garbage")
            query.reply(query.key_expr, lie)

    stranger.declare_queryable(f"{PREFIX}/trade/3/*", answer)

    def counted() -> bool:
        a.send(3, busy(0))
        assert a.receive() == []
        return {Drop.MALFORMED, Drop.IMPOSTOR} <= set(a.dropped)

    wait_until(counted, "the lie is counted")


def test_an_observer_hears_states_and_every_event(net: Net) -> None:
    a, _ = net.team
    with closing(ZenohObserver(CODEC, net.options)) as observer:

        def heard_of() -> bool:
            a.publish(beat(0, 1 + a.arrived))
            return bool(observer.receive())

        wait_until(heard_of, "the observer hears")
        events = [PoseOptimized(0, Pose2(float(n), 0.0, 0.0), 0.0, 1.0, Cause.OPTIMIZER) for n in range(2000)]
        for event in events:
            a.log(event)
        got: list[object] = []

        def all_heard() -> bool:
            got.extend(item for item in observer.receive() if isinstance(item, PoseOptimized))
            return len(got) >= len(events)

        wait_until(all_heard, "every event arrives")
        assert got == events
        assert set(observer.dropped) <= {Drop.OUTDATED, Drop.REPLAYED}
        observer.close()
        assert observer.receive() == []
        assert not observer.wait(0.0)


def test_observers_hear_of_vehicles_and_agents_do_not(net: Net) -> None:
    a, b = net.team
    with closing(ZenohObserver(CODEC, net.options)) as observer:
        heard: list[object] = []

        def told() -> bool:
            a.report(telemetry(0, x=0.25))
            heard.extend(observer.receive())
            return bool(heard)

        wait_until(told, "the report arrives")
        assert all(isinstance(item, Telemetry) and item.state[0] == 0.25 for item in heard)
        a.send(1, busy(0))
        wait_until(lambda: b.arrived, "what is said to an agent arrives")
        assert b.receive() == [busy(0)]  # and nothing before it
        assert b.dropped == {}


def require_answer(transport: ZenohTransport, number: int) -> None:
    """Ask agent 1 and get its answer."""
    transport.send(1, busy(0, number))
    assert transport.wait(30.0)
    assert transport.receive() == [Busy(Sender(1, 1), TradeId(0, 1, number))]


def test_it_works_between_processes_and_a_killed_one_becomes_a_suspect() -> None:
    meeting_point = free_endpoint()
    with closing(ZenohTransport(Sender(0, 1), CODEC, NetworkOptions(listen=(meeting_point,)))) as a:
        with child(CODEC, meeting_point) as other:
            wait_until(lambda: a.peers == {Sender(1, 1)}, "the other process is there")
            for number in range(20):
                require_answer(a, number)
            other.kill()
        wait_until(lambda: a.suspects == {Sender(1, 1)}, "its token is lost")
        with child(CODEC, meeting_point) as other:
            wait_until(lambda: a.peers == {Sender(1, 1)}, "the other process is there again")
            a.send(1, Abort(Sender(0, 1), TradeId(0, 1, 30), Reason.STALE))
            assert other.wait(30.0) == 0


def test_a_silent_process_becomes_a_suspect_and_is_back_when_it_speaks() -> None:
    meeting_point = free_endpoint()
    options = NetworkOptions(listen=(meeting_point,), lease=1.0)
    with closing(ZenohTransport(Sender(0, 1), CODEC, options)) as a, child(CODEC, meeting_point, lease=1.0) as other:
        wait_until(lambda: a.peers == {Sender(1, 1)}, "the other process is there")
        other.send_signal(signal.SIGSTOP)
        wait_until(lambda: a.suspects == {Sender(1, 1)}, "its lease is over")
        other.send_signal(signal.SIGCONT)
        wait_until(lambda: a.peers == {Sender(1, 1)}, "it is back")
        require_answer(a, 1)
        assert a.suspects == frozenset()
        other.kill()


def test_what_is_sent_after_closing_goes_nowhere(net: Net) -> None:
    a, b = net.team
    a.close()
    a.send(1, busy(0))
    a.publish(beat(0, 1))
    a.log(PoseOptimized(0, Pose2(0.0, 0.0, 0.0), 0.0, 1.0, Cause.PROOF))
    assert not a.wait(0.0)
    wait_until(lambda: b.suspects == {Sender(0, 1)}, "agent 0 has left")
    assert b.receive() == []


def test_an_endpoint_in_use_is_reported() -> None:
    endpoint = free_endpoint()
    options = NetworkOptions(listen=(endpoint,))
    first = ZenohTransport(Sender(0, 1), CODEC, options)
    with closing(first), pytest.raises(NetworkError, match="cannot join the network"):
        ZenohTransport(Sender(1, 1), CODEC, options)


def test_servers_bind_to_this_machine_unless_told_otherwise() -> None:
    assert NetworkOptions().endpoints == ("tcp/127.0.0.1:0",)
    assert NetworkOptions(mode=Mode.CLIENT).endpoints == ()
    assert NetworkOptions(listen=("tcp/0.0.0.0:7447",)).endpoints == ("tcp/0.0.0.0:7447",)
    assert not NetworkOptions().multicast


def test_options_that_contradict_each_other_are_refused(tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("none")
    files = Credentials(folder / "ca.pem", folder / "me.pem", folder / "me.key")
    assert NetworkOptions(credentials=files).endpoints == ("tls/127.0.0.1:0",)
    with pytest.raises(ArgumentError, match="lease"):
        NetworkOptions(lease=0.0)
    with pytest.raises(ArgumentError, match="answer_timeout"):
        NetworkOptions(answer_timeout=-1.0)
    with pytest.raises(ArgumentError, match="tls/ or quic/"):
        NetworkOptions(credentials=files, connect=("tcp/127.0.0.1:7447",))
    with pytest.raises(ArgumentError, match="credentials"):
        NetworkOptions(access=AccessList({0: "zero"}))
    with pytest.raises(ArgumentError, match="mode"):
        Router(NetworkOptions(), CODEC.digest)
    with pytest.raises(NetworkError):
        ZenohTransport(Sender(0, 1), CODEC, NetworkOptions(credentials=files))


def test_an_observer_asks_for_maps_and_gets_one_from_each(net: Net) -> None:
    a, b = net.team
    with closing(ZenohObserver(CODEC, net.options)) as observer:
        heard: list[object] = []

        def ask_and_answer() -> bool:
            observer.ask_for_maps()
            for transport in (a, b):
                if transport.map_wanted:
                    known = RecordSlice(np.array([2, transport.agent + 3]), np.ones((2, 4), dtype=np.int64))
                    transport.show_map(Map(transport.sender, known, {}))
            heard.extend(observer.receive())
            return {m.sender.agent for m in heard if isinstance(m, Map)} == {0, 1}

        wait_until(ask_and_answer, "both tell what they know")
        first = next(message for message in heard if isinstance(message, Map) and message.sender.agent == 1)
        assert first.records.indices.tolist() == [2, 4]
        assert observer.dropped == {}
    assert not a.map_wanted or a.receive() == []


def test_a_question_for_a_map_wakes_the_agent(net: Net) -> None:
    a, _ = net.team
    with closing(ZenohObserver(CODEC, net.options)) as observer:

        def ask() -> bool:
            observer.ask_for_maps()
            return a.map_wanted

        wait_until(ask, "the question arrives")
        assert not a.wait(30.0)  # woken, though no message has come


def test_more_questions_than_anybody_needs_are_turned_away(net: Net) -> None:
    a, _ = net.team
    session = net.stranger()
    key = f"{PREFIX}/map/0"
    ended: list[int] = []
    replies: list[zenoh.Reply] = []
    for number in range(40):
        session.get(key, Callback(replies.append, partial(ended.append, number), indirect=False), timeout=30.0)
    wait_until(lambda: len(ended) >= 24, "those that are too many end at once")
    assert a.map_wanted
    a.show_map(Map(a.sender, RecordSlice(np.empty(0, dtype=np.int64), np.empty((0, 4), dtype=np.int64)), {}))
    wait_until(lambda: len(ended) == 40, "the others are answered")
    assert len(replies) == 16


def test_a_newer_life_supersedes_the_older_and_not_the_other_way_round(net: Net) -> None:
    a, b = net.team
    with closing(ZenohTransport(Sender(1, 2), CODEC, net.options)) as again:
        wait_until(lambda: b.superseded, "the older life sees the newer")
        assert not again.superseded
        assert not a.superseded


def test_other_missions_on_the_network_are_told_apart(net: Net) -> None:
    a, _ = net.team
    assert a.other_missions == frozenset()
    other = Codec(bytes(16), agents=CODEC.agents, landmarks=CODEC.landmarks)
    with closing(ZenohTransport(Sender(1, 9), other, net.options)):
        wait_until(lambda: a.other_missions == {bytes(16).hex()}, "the other mission is seen")
        assert a.peers == {Sender(1, 1)}
        assert not a.superseded
