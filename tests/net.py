"""Helpers for tests over a real network: on this machine alone, and never waiting longer than they must."""

from __future__ import annotations

import subprocess
import sys
import textwrap
import time
from collections.abc import Callable, Sequence

from covey.protocol import Sender
from covey.transports.codec import Codec
from covey.transports.network import Mode, NetworkOptions
from covey.transports.ports import free_endpoints
from covey.transports.zenoh import ZenohTransport

PATIENCE = 30.0
"""How long to wait, seconds, for what must happen: much longer than it takes."""

QUIET = 0.1
"""After how long without anything new, seconds, nothing more is taken to be on its way."""


def free_endpoint(protocol: str = "tcp") -> str:
    """An endpoint on this machine that nobody listens on."""
    return free_endpoints(1, protocol)[0]


def wait_until(holds: Callable[[], object], what: str) -> None:
    """Wait for something that must happen."""
    end = time.monotonic() + PATIENCE
    while not holds():
        assert time.monotonic() < end, f"waited in vain: {what}"
        time.sleep(0.002)


def connect_team(
    agents: Sequence[int], codec: Codec, meeting_point: str, mode: Mode = Mode.PEER
) -> list[ZenohTransport]:
    """Open a transport for each agent and wait until each sees all others.

    The first peer listens at the meeting point; everybody else connects to it.
    """
    team: list[ZenohTransport] = []
    for agent in agents:
        listen = (meeting_point,) if mode is Mode.PEER and not team else None
        connect = () if listen else (meeting_point,)
        team.append(ZenohTransport(Sender(agent, 1), codec, NetworkOptions(mode=mode, listen=listen, connect=connect)))

    def all_met() -> bool:
        return all(len(transport.peers) == len(team) - 1 for transport in team)

    wait_until(all_met, "everybody sees everybody")
    return team


def settle_team(team: Sequence[ZenohTransport]) -> None:
    """Wait until nothing new arrives anywhere."""
    last, since = -1, time.monotonic()
    while time.monotonic() < since + QUIET:
        arrived = sum(transport.arrived for transport in team)
        if arrived != last:
            last, since = arrived, time.monotonic()
        time.sleep(0.005)


CHILD = """
    import sys
    from covey.protocol import Abort, Busy, Reason, Sender, TradeId
    from covey.transports.codec import Codec
    from covey.transports.network import NetworkOptions
    from covey.transports.zenoh import ZenohTransport

    codec = Codec(bytes.fromhex(sys.argv[1]), agents=int(sys.argv[2]), landmarks=int(sys.argv[3]))
    options = NetworkOptions(connect=(sys.argv[4],), lease=float(sys.argv[5]))
    transport = ZenohTransport(Sender(1, 1), codec, options)
    while True:
        transport.wait(60.0)
        for message in transport.receive():
            if isinstance(message, Abort):
                sys.exit()
            transport.send(0, Busy(Sender(1, 1), message.trade))
"""


def child(codec: Codec, meeting_point: str, *, lease: float = 10.0) -> subprocess.Popen[bytes]:
    """Agent 1 in a process of its own; it says BUSY to everything, and leaves when it hears ABORT."""
    arguments = [codec.digest.hex(), str(codec.agents), str(codec.landmarks), meeting_point, str(lease)]
    return subprocess.Popen([sys.executable, "-W", "error", "-c", textwrap.dedent(CHILD), *arguments])
