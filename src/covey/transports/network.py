"""How an agent joins the network: whom it listens to and connects to, and whom it trusts."""

from __future__ import annotations

import contextlib
import enum
import json
import re
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import zenoh

from covey.errors import ArgumentError, NetworkError

QUEUE = 16
"""How many batches of up to 64 kB may wait to be sent on a link; the most that Zenoh allows."""

LONGEST_WAIT = 0.05
"""How long a message may wait for room in a full queue before it is dropped, seconds."""

FAREWELL = 0.5
"""How long to wait, seconds, until what was said has been sent."""

_ENDPOINT = re.compile(r"((tcp|tls|quic|udp|ws)/\S+:\d{1,5}|(unixsock-stream|unixpipe|vsock|serial)/\S+)([?#]\S*)?")

_SOURCE = re.compile(r" at \S+\.rs:\d+\.?")
"""Where in its source Zenoh found something wrong, which helps nobody."""

RETRY = {"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2}
"""When to try again to connect to who does not answer."""


class Mode(enum.Enum):
    """What part a process plays in the network."""

    PEER = "peer"
    """Talks to the others directly."""
    CLIENT = "client"
    """Talks to the others through a router."""
    ROUTER = "router"
    """Passes on what clients and peers say."""


@dataclass(frozen=True)
class Credentials:
    """Files for mutual TLS, PEM; the process shows the same certificate whether it listens or connects.

    Parameters
    ----------
    authority : Path
        The certificate of the authority that signs everybody's; nobody else is let in.
    certificate, key : Path
        This process's own.  The certificate must be valid for the address that others connect to.
    verify_name : bool
        Whether the other's certificate must be valid for the address that was connected to.
    """

    authority: Path
    certificate: Path
    key: Path
    verify_name: bool = True


@dataclass(frozen=True)
class AccessList:
    """Who may say what, by the common name in a certificate; everything else is denied.

    Parameters
    ----------
    agents : mapping of int to str
        The common name of each agent: it alone may speak as that agent.
    observers : tuple of str
        May listen to states, telemetry and the log and ask for maps, and say nothing.
    operators : tuple of str
        May do what observers may, and change landmarks and agents.
    routers : tuple of str
        May pass on anything.
    """

    agents: Mapping[int, str]
    observers: tuple[str, ...] = ()
    operators: tuple[str, ...] = ()
    routers: tuple[str, ...] = ()


@dataclass(frozen=True)
class NetworkOptions:
    """How to join the network.

    Parameters
    ----------
    mode : Mode
    listen : tuple of str
        Endpoints to listen on, ``"tcp/127.0.0.1:7447"``; port 0: any free one.  By default one that only this machine
        reaches.  A client does not listen.
    connect : tuple of str
        Endpoints to connect to; those that cannot be reached are tried again.  Peers of a peer are found through it.
    multicast : bool
        Whether to look for others on the local network.
    lease : float
        A peer that falls silent for this long, seconds, is taken for lost.
    silence : float
        Who takes part is heard more often than this, seconds; on a link that is as it should be.
    answer_timeout : float
        How long, seconds, an answer may take to come back by the way of its question; a later one goes by itself.
    credentials : Credentials, optional
        Then every endpoint must be ``tls/`` or ``quic/``, and only who shows a certificate is let in.
    access : AccessList, optional
        Needs credentials.

    Raises
    ------
    ArgumentError
        If a time is not above 0, an endpoint is none or is not encrypted although there are credentials, or an access
        list has none.
    """

    mode: Mode = Mode.PEER
    listen: tuple[str, ...] | None = None
    connect: tuple[str, ...] = ()
    multicast: bool = False
    lease: float = 10.0
    silence: float = 10.0
    answer_timeout: float = 10.0
    credentials: Credentials | None = None
    access: AccessList | None = field(default=None)

    def __post_init__(self) -> None:
        for name in ("lease", "silence", "answer_timeout"):
            if not getattr(self, name) > 0.0:
                raise ArgumentError(f"{name}: expected more than 0, got {getattr(self, name)}")
        for endpoint in (*(self.listen or ()), *self.connect):
            if not is_endpoint(endpoint):
                raise ArgumentError(f"endpoints: expected {ENDPOINT}, got {endpoint!r}")
        if self.access is not None and self.credentials is None:
            raise ArgumentError("access: expected credentials too, got none; names are told by certificates")
        if self.credentials is not None:
            for endpoint in (*(self.listen or ()), *self.connect):
                if not endpoint.startswith(("tls/", "quic/")):
                    raise ArgumentError(f"endpoints: expected tls/ or quic/ with credentials, got {endpoint!r}")

    @property
    def endpoints(self) -> tuple[str, ...]:
        """Where it listens."""
        if self.mode is Mode.CLIENT:
            return ()
        if self.listen is None:
            return ("tls/127.0.0.1:0" if self.credentials is not None else "tcp/127.0.0.1:0",)
        return self.listen


ENDPOINT = "one such as tcp/192.0.2.10:7447"
"""What an endpoint is, in words."""


def is_endpoint(text: str) -> bool:
    """Whether a text says where to listen or to connect to.

    Examples
    --------
    >>> is_endpoint("tcp/[::1]:7447"), is_endpoint("tcp/localhost"), is_endpoint("localhost:7447")
    (True, False, False)
    """
    return _ENDPOINT.fullmatch(text) is not None


def mission_prefix(digest: bytes) -> str:
    """Return what all keys of a mission begin with."""
    return f"covey/{digest.hex()}"


def build_config(options: NetworkOptions, digest: bytes, *, max_bytes: int) -> zenoh.Config:
    """Return the configuration of a Zenoh session.

    Parameters
    ----------
    options : NetworkOptions
    digest : bytes
        Of the mission.
    max_bytes : int, keyword-only
        Nothing longer is taken from the network.
    """
    settings: dict[str, Any] = {
        "mode": options.mode.value,
        "listen/endpoints": options.endpoints,
        "connect/endpoints": options.connect,
        "connect/retry": RETRY,
        "scouting/multicast/enabled": options.multicast,
        "open/return_conditions/connect_scouted": False,  # who is there is told by tokens
        "transport/link/tx/lease": round(1000.0 * options.lease),
        "transport/link/tx/queue/size/data": QUEUE,
        "transport/link/tx/queue/congestion_control/drop/wait_before_drop": round(1e6 * LONGEST_WAIT),
        "transport/link/rx/max_message_size": max_bytes + 2**16,
        "transport/shared_memory/enabled": False,
    }
    if options.credentials is not None:
        files = options.credentials
        settings["transport/link/protocols"] = ["tls", "quic"]
        settings["transport/link/tls"] = {
            "root_ca_certificate": str(files.authority),
            "listen_certificate": str(files.certificate),
            "listen_private_key": str(files.key),
            "connect_certificate": str(files.certificate),
            "connect_private_key": str(files.key),
            "enable_mtls": True,
            "verify_name_on_connect": files.verify_name,
            "close_link_on_expiration": True,
        }
    if options.access is not None:
        settings["access_control"] = access_rules(options.access, mission_prefix(digest))
    config = zenoh.Config()
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return config


_LISTEN = ["declare_subscriber", "liveliness_query", "declare_liveliness_subscriber"]
_ALL = [*_LISTEN, "put", "delete", "query", "reply", "declare_queryable", "liveliness_token"]


def access_rules(access: AccessList, prefix: str) -> dict[str, Any]:
    """Return Zenoh's access control for a mission: what may come in from whom, and what goes out to members."""
    rules = [
        _rule("members-out", "egress", _ALL, f"{prefix}/**"),
        _rule("members-listen", "ingress", _LISTEN, f"{prefix}/**"),
        _rule("observers-ask", "ingress", ["query"], f"{prefix}/map/*"),
        _rule("operators-change", "ingress", ["put"], f"{prefix}/change"),
        _rule("routers-in", "ingress", _ALL, f"{prefix}/**"),
    ]
    subjects = []
    policies = []
    for agent, name in access.agents.items():
        speaks = f"agent-{agent}"
        rules += [
            _rule(f"{speaks}-asks", "ingress", ["query"], f"{prefix}/trade/*/{agent}"),
            _rule(
                f"{speaks}-answers",
                "ingress",
                ["reply", "declare_queryable"],
                f"{prefix}/trade/{agent}/*",
                f"{prefix}/map/{agent}",
            ),
            _rule(
                f"{speaks}-tells",
                "ingress",
                ["put"],
                *(f"{prefix}/{topic}/{agent}" for topic in ("state", "log", "telemetry")),
            ),
            _rule(f"{speaks}-lives", "ingress", ["liveliness_token"], f"{prefix}/alive/{agent}/*"),
        ]
        subjects.append({"id": speaks, "cert_common_names": [name]})
        own = [f"{speaks}-{verb}" for verb in ("asks", "answers", "tells", "lives")]
        policies.append({"rules": ["members-out", "members-listen", *own], "subjects": [speaks]})
    for subject, names, own in (
        ("observers", access.observers, ["members-listen", "observers-ask"]),
        ("operators", access.operators, ["members-listen", "observers-ask", "operators-change"]),
        ("routers", access.routers, ["routers-in"]),
    ):
        if names:
            subjects.append({"id": subject, "cert_common_names": list(names)})
            policies.append({"rules": ["members-out", *own], "subjects": [subject]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _rule(name: str, flow: str, messages: list[str], *keys: str) -> dict[str, Any]:
    return {"id": name, "permission": "allow", "flows": [flow], "messages": messages, "key_exprs": list(keys)}


def open_session(options: NetworkOptions, digest: bytes, *, max_bytes: int) -> zenoh.Session:
    """Join the network.

    Raises
    ------
    NetworkError
        If an endpoint or a file cannot be used.
    """
    files = options.credentials
    for path in () if files is None else (files.authority, files.certificate, files.key):
        try:
            path.open("rb").close()
        except OSError as error:
            raise NetworkError(f"cannot join the network: {path}: {error.strerror}") from None
    try:
        return zenoh.open(build_config(options, digest, max_bytes=max_bytes))
    except zenoh.ZError as error:
        raise NetworkError(f"cannot join the network: {_SOURCE.sub('', str(error))}") from error


def leave_session(session: zenoh.Session) -> None:
    """Leave the network; wait for `FAREWELL` at most, for Zenoh waits 10 s for each peer that does not read."""

    def close() -> None:
        with contextlib.suppress(zenoh.ZError):
            session.close()

    leaving = threading.Thread(target=close, daemon=True, name="covey leaves")
    leaving.start()
    leaving.join(FAREWELL)


def report_refusals() -> None:
    """Have Zenoh say on standard output whom TLS does not let in, for the rest of the process.

    RUST_LOG, where it is set, decides instead.
    """
    zenoh.init_log_from_env_or("zenoh_link_tls=warn")


class Router:
    """Passes on what the agents of a mission say to each other, where they cannot reach each other directly.

    Parameters
    ----------
    options : NetworkOptions
        With mode ROUTER.
    digest : bytes
        Of the mission.
    max_bytes : int, keyword-only

    Raises
    ------
    ArgumentError
        If the mode is another.
    NetworkError
        If an endpoint or a file cannot be used.
    """

    def __init__(self, options: NetworkOptions, digest: bytes, *, max_bytes: int = 16 * 2**20) -> None:
        if options.mode is not Mode.ROUTER:
            raise ArgumentError(f"mode: expected {Mode.ROUTER}, got {options.mode}")
        self._session = open_session(options, digest, max_bytes=max_bytes)

    def close(self) -> None:
        """Leave the network."""
        leave_session(self._session)


__all__ = [
    "ENDPOINT",
    "AccessList",
    "Credentials",
    "Mode",
    "NetworkOptions",
    "Router",
    "is_endpoint",
    "leave_session",
    "open_session",
    "report_refusals",
]
