"""What every transport offers to one agent."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from covey.protocol import Heartbeat, Map, Message, Sender


@runtime_checkable
class Transport(Protocol):
    """One agent's access to the others.

    Nothing is promised about a message: it may be lost, doubled, late or overtaken, and who sends it is never told.
    The trading is built for that.  What does arrive has not been changed.  An implementation is checked with
    `covey.testing.check_transport`.

    Attributes
    ----------
    agent : int
        Whose access it is.
    """

    @property
    def agent(self) -> int:
        """Whose access it is."""
        ...

    def send(self, to: int, message: Message) -> None:
        """Send a message to one agent; never blocks, and an agent that does not exist is no error."""
        ...

    def publish(self, heartbeat: Heartbeat) -> None:
        """Publish the newest state to all others that listen."""
        ...

    def receive(self) -> list[Message]:
        """Take what has arrived, in the order of arrival; never blocks."""
        ...

    def close(self) -> None:
        """Leave: nothing arrives any more, and what is sent goes nowhere."""
        ...


class RealTransport(Transport, Protocol):
    """A transport between processes, where time passes outside; every method may be called from any thread.

    It is checked with `covey.testing.check_real_transport`.
    """

    def wait(self, timeout: float) -> bool:
        """Wait until something has arrived, seconds at most; whether it has."""
        ...

    @property
    def peers(self) -> frozenset[Sender]:
        """The other agents that are connected, each in its newest life."""
        ...

    @property
    def suspects(self) -> frozenset[Sender]:
        """The other agents that were connected and are lost: by death, or because the way to them broke."""
        ...

    @property
    def superseded(self) -> bool:
        """Whether a newer life of this agent is on the network: then this one is over."""
        ...

    @property
    def map_wanted(self) -> bool:
        """Whether somebody waits for `show_map`."""
        ...

    def show_map(self, known: Map) -> None:
        """Tell who asked what this agent knows."""
        ...
