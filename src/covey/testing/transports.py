"""What every transport must do, as checks that raise AssertionError."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence

import numpy as np

from covey.geometry import Pose2
from covey.protocol import Busy, Commit, Heartbeat, Offer, PoseRecord, RecordSlice, Request, Sender, TradeId
from covey.transports import RealTransport, Transport

Connect = Callable[[Sequence[int]], tuple[Sequence[Transport], Callable[[], None]]]
"""Opens one access for each agent; the second result waits until all that was sent has arrived."""

ConnectReal = Callable[[Sequence[int]], tuple[Sequence[RealTransport], Callable[[], None]]]
"""The same for transports between processes."""

PATIENCE = 30.0
"""How long to wait, seconds, for what must happen."""


def check_transport(connect: Connect) -> None:
    """Run every check of the suite on a transport without faults.

    Parameters
    ----------
    connect : callable
        ``connect(agents)`` opens a new network for these agents and returns their accesses, in order, and a function
        that waits until everything sent so far has arrived.

    Raises
    ------
    AssertionError
        If a check fails; the text says which and how.
    """
    for check in (
        check_addressing,
        check_nothing_is_changed,
        check_nothing_is_made_up,
        check_strangers,
        check_conversation,
        check_publishing,
        check_newest_wins,
        check_closing,
    ):
        check(connect)


def check_real_transport(connect: ConnectReal) -> None:
    """Run every check on a transport between processes, which may be used from any thread.

    Parameters
    ----------
    connect : callable
        As for `check_transport`; while the second result waits, time passes outside.

    Raises
    ------
    AssertionError
        If a check fails; the text says which and how.
    """
    check_transport(connect)
    check_threads(connect)
    check_waiting(connect)


def check_addressing(connect: Connect) -> None:
    """A message reaches the agent that it is for, and no other."""
    (a, b, c), settle = connect([0, 1, 2])
    _require([t.agent for t in (a, b, c)] == [0, 1, 2], "agent: each access must know whose it is")
    a.send(1, _busy(0, 1))
    c.send(0, _busy(2, 1))
    settle()
    _require(b.receive() == [_busy(0, 1)], "send: the receiver must get the message")
    _require(a.receive() == [_busy(2, 1)], "send: the receiver must get the message")
    _require(c.receive() == [], "send: nobody else may get the message")
    _require(b.receive() == [], "receive: a message is handed out once")


def check_nothing_is_changed(connect: Connect) -> None:
    """Arrays, poses and numbers arrive exactly as they were sent."""
    (a, b), settle = connect([3, 8])
    sender, trade = Sender(3, 2), TradeId(3, 2, 2**40)
    pose = PoseRecord(1, 7, Pose2(0.1, -1e300, 3.0))
    indices = np.array([0, 5, 2**33], dtype=np.int64)
    records = RecordSlice(indices, np.arange(12, dtype=np.int64).reshape(3, 4))
    empty = RecordSlice(np.empty(0, dtype=np.int64), np.empty((0, 4), dtype=np.int64))
    for sent in (
        Request(sender, trade, pose, records, (Pose2(1.0, 2.0, 0.5),)),
        Request(sender, trade, pose, empty),
        Offer(sender, trade, pose, records, indices, indices[:0], pose.pose, Pose2(0.0, 0.0, 0.0)),
        Commit(sender, trade, records, pose, pose),
    ):
        a.send(8, sent)
        settle()
        got = b.receive()
        _require(len(got) == 1 and type(got[0]) is type(sent), f"send: expected one {type(sent).__name__}, got {got}")
        for name in type(sent).__dataclass_fields__:
            _require(_same(getattr(sent, name), getattr(got[0], name)), f"{type(sent).__name__}.{name}: was changed")


def check_nothing_is_made_up(connect: Connect) -> None:
    """Of many messages in both directions each arrives once, in whatever order."""
    (a, b), settle = connect([0, 1])
    for number in range(100):
        a.send(1, _busy(0, number))
        b.send(0, _busy(1, number))
    settle()
    for receiver, sender in ((a, 1), (b, 0)):
        got = [message for message in receiver.receive() if isinstance(message, Busy)]
        _require(sorted(message.trade.number for message in got) == list(range(100)), "send: messages lost or doubled")
        _require({message.sender.agent for message in got} == {sender}, "send: a wrong sender")


def check_strangers(connect: Connect) -> None:
    """A message to an agent that does not exist is no error and harms nobody."""
    (a, b), settle = connect([0, 1])
    a.send(99, _busy(0, 1))
    a.send(1, _busy(0, 2))
    settle()
    _require(b.receive() == [_busy(0, 2)], "send: a message to nobody must vanish")


def check_conversation(connect: Connect) -> None:
    """Question and answer, again and again, in both directions and with copies."""
    (a, b), settle = connect([0, 1])
    for number in range(3):
        for asker, other in ((a, b), (b, a)):
            for _ in range(2):  # a copy of the question, as a client sends that heard nothing
                asker.send(other.agent, _busy(asker.agent, number))
            settle()
            _require(len(other.receive()) == 2, "send: a question and its copy must arrive")
            for _ in range(2):
                other.send(asker.agent, _busy(other.agent, number))
            settle()
            _require(len(asker.receive()) == 2, "send: an answer and its copy must arrive")


def check_publishing(connect: Connect) -> None:
    """The newest heartbeat reaches all others, and not its sender."""
    (a, b, c), settle = connect([0, 1, 2])
    for sequence in (1, 2, 3):
        a.publish(_heartbeat(0, sequence))
        settle()
    for listener in (b, c):
        beats = [message for message in listener.receive() if isinstance(message, Heartbeat)]
        newest = max((beat.sequence for beat in beats), default=0)
        _require(newest == 3, f"publish: expected the newest heartbeat, got number {newest}")
        newest_beat = next(beat for beat in beats if beat.sequence == 3)
        _require(dict(newest_beat.committed) == {1: 3} and newest_beat.quiescent, "publish: the heartbeat was changed")
    _require(a.receive() == [], "publish: the sender must not hear itself")


def check_newest_wins(connect: Connect) -> None:
    """Whatever becomes of many heartbeats in a row, the next one arrives, and each at most once."""
    (a, b), settle = connect([0, 1])
    for sequence in range(1, 51):
        a.publish(_heartbeat(0, sequence))
    settle()
    a.publish(_heartbeat(0, 51))
    settle()
    beats = [message.sequence for message in b.receive() if isinstance(message, Heartbeat)]
    _require(max(beats, default=0) == 51, f"publish: expected the newest heartbeat, got numbers {beats}")
    _require(len(set(beats)) == len(beats), f"publish: a heartbeat is handed out once, got numbers {beats}")


def check_threads(connect: Connect) -> None:
    """Several threads may send and receive at once, and still each message is handed out once."""
    (a, b), settle = connect([0, 1])
    got: list[int] = []
    done = threading.Event()

    def send(first: int) -> None:
        for number in range(first, 100, 4):
            a.send(1, _busy(0, number))

    def receive() -> None:
        while not done.wait(0.001):
            got.extend(message.trade.number for message in b.receive() if isinstance(message, Busy))

    senders = [threading.Thread(target=send, args=[first]) for first in range(4)]
    receivers = [threading.Thread(target=receive) for _ in range(2)]
    for thread in (*senders, *receivers):
        thread.start()
    for thread in senders:
        thread.join()
    settle()
    done.set()
    for thread in receivers:
        thread.join()
    got += [message.trade.number for message in b.receive() if isinstance(message, Busy)]
    _require(sorted(got) == list(range(100)), "threads: messages lost or doubled")


def check_waiting(connect: ConnectReal) -> None:
    """Waiting ends when something arrives, when the time is over, and when the access is closed."""
    (a, b), _ = connect([0, 1])
    _require(not b.wait(0.0), "wait: nothing has arrived yet")
    a.send(1, _busy(0, 1))
    _require(b.wait(PATIENCE), "wait: something has arrived")
    _require(b.wait(PATIENCE), "wait: it is still there")
    b.receive()
    _require(not b.wait(0.0), "wait: everything has been handed out")
    closing = threading.Timer(0.05, b.close)
    closing.start()
    _require(not b.wait(PATIENCE), "wait: nothing arrives after closing")
    closing.join()


def check_closing(connect: Connect) -> None:
    """Who has left gets nothing and says nothing, and the others go on."""
    (a, b, c), settle = connect([0, 1, 2])
    b.close()
    b.close()
    a.send(1, _busy(0, 1))
    b.send(0, _busy(1, 1))
    b.publish(_heartbeat(1, 1))
    a.send(2, _busy(0, 2))
    settle()
    _require(b.receive() == [], "close: nothing may arrive any more")
    _require(a.receive() == [], "close: what is sent afterwards must go nowhere")
    _require(c.receive() == [_busy(0, 2)], "close: the others must go on")


def _busy(agent: int, number: int) -> Busy:
    return Busy(Sender(agent, 1), TradeId(agent, 1, number))


def _heartbeat(agent: int, sequence: int) -> Heartbeat:
    pose = PoseRecord(1, sequence, Pose2(0.0, 0.0, 0.0))
    return Heartbeat(Sender(agent, 1), sequence, True, sequence, pose, {1: 3}, {})


def _same(a: object, b: object) -> bool:
    if isinstance(a, RecordSlice) and isinstance(b, RecordSlice):
        return _same(a.indices, b.indices) and _same(a.values, b.values)
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return a.dtype == b.dtype and np.array_equal(a, b)
    return bool(a == b)


def _require(holds: bool, text: str) -> None:
    if not holds:
        raise AssertionError(text)


__all__ = ["Connect", "ConnectReal", "check_real_transport", "check_transport"]
