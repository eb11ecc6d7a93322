"""Ports of this machine for agents that are started together."""

from __future__ import annotations

import secrets
import socket
from contextlib import ExitStack
from pathlib import Path

from covey.errors import NetworkError

PORTS = range(10_000, 65_536)
"""Ports that agents may be given: above those of well-known services."""

LEAST = 1_000
"""So many ports at least must be left to choose from."""

_RANGE = Path("/proc/sys/net/ipv4/ip_local_port_range")
_COMMON_RANGE = (49_152, 65_535)


def free_endpoints(count: int, protocol: str = "tcp") -> list[str]:
    """Return endpoints of the loopback interface on which nobody listens.

    Parameters
    ----------
    count : int
    protocol : str
        ``tcp`` or ``tls``.

    Raises
    ------
    NetworkError
        If there are not so many.

    Notes
    -----
    A socket that dials is given a port as well, from a range of its own.  A port of that range that is free now may be
    taken when its agent begins to listen, or, when the agent has died and the others dial it, may be given to one of
    these, which then is connected to itself and keeps the port.  So none of that range is returned, unless hardly any
    other is left.  Which ones is left to chance, for several teams may start at once.

    Examples
    --------
    >>> len(set(free_endpoints(3)))
    3
    """
    low, high = _dialling_ports()
    ports = [port for port in PORTS if not low <= port <= high]
    if len(ports) < LEAST:
        ports = list(PORTS)
    found: list[str] = []
    with ExitStack() as stack:
        while ports and len(found) < count:
            port = ports.pop(secrets.randbelow(len(ports)))
            probe = stack.enter_context(socket.socket())
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
            found.append(f"{protocol}/127.0.0.1:{port}")
    if len(found) < count:
        raise NetworkError(f"of {count} ports for agents only {len(found)} are free")
    return found


def _dialling_ports() -> tuple[int, int]:
    """Return the least and the greatest port that the system gives to sockets that dial."""
    try:
        low, high = _RANGE.read_text(encoding="ascii").split()
        return int(low), int(high)
    except (OSError, ValueError):
        return _COMMON_RANGE
