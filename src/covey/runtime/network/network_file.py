"""A file that says how the agents of a mission find and trust each other."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError

from covey.environment.files import read_text
from covey.environment.json_text import as_mistake
from covey.errors import ArgumentError, InputError, MissionError, Mistake
from covey.mission import Mission
from covey.mission.document import FORMATS, parse
from covey.mission.report import Report
from covey.mission.schema_base import FileName, Section
from covey.protocol import Adopt, MembershipOptions
from covey.runtime.network.remote_agent import LEASE, NETWORK_TIMES
from covey.transports.network import ENDPOINT, AccessList, Credentials, Mode, NetworkOptions, is_endpoint

MAX_BYTES = 1_000_000
OBSERVER = "observer"
"""What stands for ``{name}`` in the files of an observer."""

Seconds = Annotated[float, Field(gt=0.0, le=1e6)]


class _Credentials(Section):
    authority: FileName
    certificate: FileName
    key: FileName
    verify_name: bool = True


class _Access(Section):
    agents: dict[str, FileName]
    joining: dict[str, FileName] = Field(default_factory=dict)
    observers: list[FileName] = Field(default_factory=list)
    operators: list[FileName] = Field(default_factory=list)
    routers: list[FileName] = Field(default_factory=list)


class _File(Section):
    listen: list[str] | None = None
    connect: list[str] = Field(default_factory=list)
    router: str | None = None
    multicast: bool = False
    lease_s: Seconds = LEASE
    answer_timeout_s: Seconds = 10.0
    heartbeat_s: Seconds = NETWORK_TIMES.heartbeat_every
    dead_after_s: Seconds = NETWORK_TIMES.dead_after
    map_s: Seconds = NETWORK_TIMES.map_every
    adopt: Literal["all", "majority"] = "all"
    credentials: _Credentials | None = None
    access: _Access | None = None


@dataclass(frozen=True)
class NetworkPlan:
    """How a team talks.

    Parameters
    ----------
    options : NetworkOptions
        The credentials' files may have ``{name}`` in their names: see `for_name`.
    times : MembershipOptions
    joining : tuple of str or None
        With an access list: the names of those that may join, in the order in which they may.
    """

    options: NetworkOptions = field(
        default_factory=lambda: NetworkOptions(lease=LEASE, silence=NETWORK_TIMES.dead_after)
    )
    times: MembershipOptions = NETWORK_TIMES
    joining: tuple[str, ...] | None = None

    def for_name(self, name: str) -> NetworkPlan:
        """Return the same with the name of an agent, or `OBSERVER`, in the names of the credentials' files."""
        files = self.options.credentials
        if files is None:
            return self
        own = replace(files, certificate=_with_name(files.certificate, name), key=_with_name(files.key, name))
        return replace(self, options=replace(self.options, credentials=own))

    def joined(
        self, *, listen: tuple[str, ...] | None = None, connect: tuple[str, ...] = (), router: str | None = None
    ) -> NetworkPlan:
        """Return the same with endpoints that were given elsewhere instead of the file's, where there are any.

        Raises
        ------
        ArgumentError
            If an endpoint is none, or does not go with the credentials, or there is a router and something to listen
            on.
        """
        options = self.options
        if router is not None:
            if listen:
                raise ArgumentError("--router: expected no --listen with it; a client of a router does not listen")
            options = replace(options, mode=Mode.CLIENT, connect=(router,), listen=None)
        if listen is not None:
            options = replace(options, listen=listen)
        if connect:
            options = replace(options, connect=connect)
        return replace(self, options=options)


def load_network(path: Path, mission: Mission) -> NetworkPlan:
    """Read a network file: TOML, YAML or JSON.

    Parameters
    ----------
    path : Path
    mission : Mission
        Knows the agents that the access list names.

    Raises
    ------
    MissionError
        With every mistake in the file, each with its line and key.
    """
    source = str(path)
    try:
        text = read_text(path, limit=MAX_BYTES)
    except InputError as error:
        raise MissionError((as_mistake(error, source),)) from None
    syntax = FORMATS.get(path.suffix.lower())
    if syntax is None:
        message = f"expected a file name ending in .toml, .yaml, .yml or .json, got {path.suffix!r}"
        raise MissionError((Mistake(source, None, None, "", message),))
    document = parse(text, syntax, source)
    report = Report(source, document, _File)
    plan = None if document.mistakes else _read(document.data, report, path.parent, mission)
    if plan is None or report.mistakes:
        raise MissionError(tuple(report.in_order()))
    return plan


def _read(data: object, report: Report, folder: Path, mission: Mission) -> NetworkPlan | None:
    try:
        file = _File.model_validate({} if data is None else data)
    except ValidationError as error:
        report.add_pydantic(error.errors())
        return None
    credentials = None
    if file.credentials is not None:
        given = file.credentials
        credentials = Credentials(
            folder / given.authority, folder / given.certificate, folder / given.key, given.verify_name
        )
    access = _access(file.access, report, mission)
    if access is not None and credentials is None:
        report.add(("access",), "expected a section credentials too: names are told by certificates")
    for key, endpoints in (("listen", file.listen or []), ("connect", file.connect), ("router", _one(file.router))):
        for endpoint in endpoints:
            if not is_endpoint(endpoint):
                report.add((key,), f"expected {ENDPOINT}, got {endpoint[:100]!r}")
            elif credentials is not None and not endpoint.startswith(("tls/", "quic/")):
                report.add((key,), f"expected tls/ or quic/ endpoints with credentials, got {endpoint!r}")
    if file.router is not None and file.listen:
        report.add(("listen",), "expected nothing with a router; a client of a router does not listen")
    if file.dead_after_s < 3.0 * file.heartbeat_s:
        report.add(("dead_after_s",), f"expected at least three heartbeats, {3.0 * file.heartbeat_s:g}")
    if file.dead_after_s < file.lease_s:
        report.add(("dead_after_s",), f"expected at least lease_s = {file.lease_s:g}")
    if report.mistakes:
        return None
    options = NetworkOptions(
        mode=Mode.PEER if file.router is None else Mode.CLIENT,
        listen=None if file.listen is None else tuple(file.listen),
        connect=tuple(file.connect if file.router is None else [file.router]),
        multicast=file.multicast,
        lease=file.lease_s,
        silence=file.dead_after_s,
        answer_timeout=file.answer_timeout_s,
        credentials=credentials,
        access=access,
    )
    times = MembershipOptions(file.heartbeat_s, file.dead_after_s, file.map_s, Adopt(file.adopt))
    return NetworkPlan(options, times, None if file.access is None else tuple(file.access.joining))


def _access(given: _Access | None, report: Report, mission: Mission) -> AccessList | None:
    if given is None:
        return None
    numbers = {agent.name: number for number, agent in enumerate(mission.agents)}
    for name in given.agents.keys() - numbers.keys():
        report.add(("access", "agents", name), f"expected an agent of the mission: {', '.join(sorted(numbers))}")
    for name in given.joining.keys() & numbers.keys():
        report.add(("access", "joining", name), "expected an agent that is not in the mission from its beginning")
    agents = {numbers[name]: common for name, common in given.agents.items() if name in numbers}
    agents |= {len(numbers) + i: common for i, common in enumerate(given.joining.values())}
    return AccessList(agents, tuple(given.observers), tuple(given.operators), tuple(given.routers))


def _one(endpoint: str | None) -> list[str]:
    return [] if endpoint is None else [endpoint]


def _with_name(path: Path, name: str) -> Path:
    return path.with_name(path.name.replace("{name}", name))
