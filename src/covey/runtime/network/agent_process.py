"""The life of an agent's process: from its files and the network to its report."""

from __future__ import annotations

import dataclasses
import enum
import json
import math
import os
import signal
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import FrameType

from covey.errors import Drop, InputError
from covey.mission import Mission
from covey.protocol import EMPTY, Catalogue, Event, Sender, TradeCommitted
from covey.runtime.agent import build_planner
from covey.runtime.network.agent_state import AgentDirectory, await_life, first_life
from covey.runtime.network.network_file import NetworkPlan
from covey.runtime.network.observer import Observer
from covey.runtime.network.remote_agent import LINGER, RemoteAgent, join_mission, mission_codec
from covey.runtime.network.remote_vehicle import build_vehicle
from covey.runtime.network.warm_up import warm_up
from covey.transports.network import report_refusals
from covey.transports.zenoh import ZenohTransport
from covey.transports.zenoh_observer import ZenohObserver

ASK_TICK = 0.1
"""How long who asks for itself listens at a time, seconds."""

KEEP_EVERY = 1.0
"""Seconds between two times that an agent writes down what it knows, while that changes."""


class Ending(enum.Enum):
    """Why an agent left."""

    OVER = "over"
    TIMEOUT = "timeout"
    RELEASED = "released"
    """Its standard input was closed."""
    INTERRUPTED = "interrupted"
    SUPERSEDED = "superseded"
    """A newer life of it is on the network."""
    LEFT = "left"
    """An operator let it go."""


@dataclass(frozen=True)
class AgentSettings:
    """How an agent runs.

    Parameters
    ----------
    name : str
        Of an agent of the mission, or of one that an operator lets join it.
    network : NetworkPlan
    state : Path or None
        Where it keeps what a restart begins with.
    vehicles : str
        ``none``, or a `covey.vehicles.fleet.Kind`.
    patience : float
        How long it waits for the others at the start, seconds.
    timeout : float
        Seconds after which it leaves.
    attached : bool
        Stay when the mission is over, and leave when standard input closes.
    """

    name: str
    network: NetworkPlan
    state: Path | None = None
    vehicles: str = "none"
    patience: float = 60.0
    timeout: float = math.inf
    attached: bool = False


@dataclass(frozen=True)
class AgentReport:
    """What an agent's process has to say at its end.

    Parameters
    ----------
    name : str
    incarnation : int
    ending : Ending
    over : bool
        Whether the mission was over.
    remembered : bool
        Whether it began with the memory of an earlier life.
    trades, optimizations : int
        Trades that it committed as client, and how often it looked for a better pose.
    dropped : dict of str to int
        Arrivals that were dropped, by cause.
    unanswered, unsent, renewals : int
        As `ZenohTransport` counts them.
    other_missions : list of str
        Digests of other missions on the same network.
    longest_silence : float
        The longest time that it was too busy to speak, seconds.
    start_s : dict of str to float
        What its start took, seconds.
    """

    name: str
    incarnation: int
    ending: Ending
    over: bool
    remembered: bool
    trades: int
    optimizations: int
    dropped: dict[str, int]
    unanswered: int
    unsent: int
    renewals: int
    other_missions: list[str]
    longest_silence: float
    start_s: dict[str, float] = field(default_factory=dict)

    def to_json(self) -> str:
        """Return it as one line of JSON."""
        return json.dumps({**dataclasses.asdict(self), "ending": self.ending.value})


class _Wish:
    """Whether somebody wants the process to leave."""

    def __init__(self) -> None:
        self.ending: Ending | None = None

    def note(self, number: int, frame: FrameType | None) -> None:
        """Handle a signal: the first is a wish, the second an end."""
        self.ending = Ending.INTERRUPTED
        signal.signal(number, signal.SIG_DFL)

    def follow(self, stream: int) -> None:
        """Wait for the end of a stream."""
        while os.read(stream, 4096):
            pass
        self.ending = self.ending or Ending.RELEASED

    def __call__(self) -> bool:
        return self.ending is not None


@contextmanager
def _signals(wish: _Wish) -> Iterator[None]:
    before = {number: signal.signal(number, wish.note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def _stdout_on_stderr() -> Iterator[None]:
    """Have whatever is written to standard output, where Zenoh logs, go to stderr meanwhile."""
    kept = os.dup(1)
    os.dup2(2, 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)


def run_agent(
    mission: Mission, settings: AgentSettings, *, say: Callable[[str], object], talkative: bool = True
) -> AgentReport:
    """Run an agent until the mission is over or it is told to leave.

    Parameters
    ----------
    mission : Mission
    settings : AgentSettings
    say : callable, keyword-only
        Called with what is wrong, and with news.
    talkative : bool, keyword-only
        Whether with news as well.

    Raises
    ------
    InputError
        If a sensor or a vehicle cannot be built.
    NetworkError
        If the network cannot be joined, or nobody there knows the agent.
    OutputError
        If the state cannot be written.
    SolverError
        If an optimiser fails.
    """
    wish = _Wish()
    if settings.attached:
        threading.Thread(target=wish.follow, args=[sys.stdin.fileno()], daemon=True).start()
    with ExitStack() as stack:
        stack.enter_context(_signals(wish))
        if settings.network.options.credentials is not None:
            stack.enter_context(_stdout_on_stderr())
            report_refusals()
        return _Life(mission, settings, wish, say, say if talkative else lambda text: None).run()


class _Life:
    """One life of an agent."""

    def __init__(
        self,
        mission: Mission,
        settings: AgentSettings,
        wish: _Wish,
        warn: Callable[[str], object],
        tell: Callable[[str], object],
    ) -> None:
        self._mission = mission
        self._settings = settings
        self._wish = wish
        self._warn, self._tell = warn, tell
        self._began = time.monotonic()
        self._start_s: dict[str, float] = {}
        self._troubles: set[str] = set()
        self._trades = 0
        self._kept: object = None
        self._keep_at = 0.0

    def run(self) -> AgentReport:
        """Live."""
        mission, settings = self._mission, self._settings
        codec, planner = mission_codec(mission), build_planner(mission)
        number, catalogue = self._who_am_i()
        planner.learn(catalogue)
        grown = replace(mission, agents=tuple(planner.agents))
        directory = None if settings.state is None else AgentDirectory(settings.state, number, codec, self._warn)
        life = first_life() if directory is None else directory.next_life()
        remembered = None if directory is None else directory.recall()
        start = grown.agents[number].pose if remembered is None else remembered.pose
        warm_up(grown, number, settings.vehicles)
        vehicle = build_vehicle(grown, number, settings.vehicles, start, time.monotonic())
        self._took("warm_up")
        await_life(life)
        with ExitStack() as stack:
            transport = ZenohTransport(Sender(number, life), codec, settings.network.options)
            stack.enter_context(closing(transport))
            agent = join_mission(
                mission,
                transport,
                incarnation=life,
                planner=planner,
                memory=None if remembered is None else remembered.memory,
                times=settings.network.times,
                catalogue=catalogue,
                vehicle=vehicle,
                on_event=lambda event: self._on_event(transport, event),
                on_telemetry=transport.report,
                on_trouble=self._on_trouble,
            )
            stack.enter_context(closing(agent))
            self._took("join")
            self._assemble(agent, transport, patient=remembered is None and not catalogue)
            self._took("assemble")
            stack.callback(self._keep, agent, directory, at_once=True)
            over = agent.run(
                timeout=settings.timeout,
                linger=math.inf if settings.attached else LINGER,
                stop=self._wish,
                on_step=lambda: self._keep(agent, directory),
            )
            ending = self._ending(agent, over=over)
            self._tell_end(agent, ending)
            dropped = Counter({cause.value: count for cause, count in transport.dropped.items()})
            if agent.unreadable:
                dropped[Drop.MALFORMED.value] += agent.unreadable
            return AgentReport(
                name=settings.name,
                incarnation=life,
                ending=ending,
                over=over,
                remembered=remembered is not None,
                trades=self._trades,
                optimizations=planner.optimizations,
                dropped=dict(dropped),
                unanswered=transport.unanswered,
                unsent=transport.unsent,
                renewals=transport.renewals,
                other_missions=sorted(transport.other_missions),
                longest_silence=agent.longest_silence,
                start_s=self._start_s,
            )

    def _who_am_i(self) -> tuple[int, Catalogue]:
        """Return the agent's number, and what it must know first; who is not in the mission file asks the others."""
        mission, settings = self._mission, self._settings
        names = [specification.name for specification in mission.agents]
        if settings.name in names:
            return names.index(settings.name), EMPTY
        self._tell("is not in the mission file; asks the others")
        with closing(ZenohObserver(mission_codec(mission), settings.network.options)) as access:
            observer = Observer(mission, access, times=settings.network.times)
            end = time.monotonic() + settings.patience
            while time.monotonic() < end and not self._wish():
                observer.step(ASK_TICK)
                observer.ask_soon()
                team = observer.team
                if settings.name in team.names[len(names) :] and team.names.index(settings.name) not in team.gone:
                    return team.names.index(settings.name), team.planner.catalogue
        raise InputError(
            f"--name: expected an agent of the mission: {', '.join(names)}; or one that joins it, got "
            f"{settings.name!r}, of whom nobody on the network knows; let it join with `covey change --join`"
        )

    def _on_trouble(self, text: str) -> None:
        if text not in self._troubles:
            self._troubles.add(text)
            self._warn(f"cannot take in a change of the mission: {text}")

    def _assemble(self, agent: RemoteAgent, transport: ZenohTransport, *, patient: bool) -> None:
        names = [specification.name for specification in self._mission.agents]
        others = len(names) - 1
        if not patient:
            agent.assemble(math.inf, self._settings.network.times.dead_after, self._wish)
            self._tell("begins again where it was" if self._settings.name in names else "joins")
            return
        patience = self._settings.patience
        if others:
            self._tell(f"waits for {others} others")
        if not agent.assemble(others, patience, self._wish) and not self._wish():
            here = {peer.agent for peer in transport.peers} | {transport.agent}
            absent = ", ".join(name for number, name in enumerate(names) if number not in here)
            self._warn(f"begins without {absent}, not heard of in {patience:g} s")
            missions = len(transport.other_missions)
            if missions:
                self._warn(
                    f"hears agents of {missions} other mission{'s' * (missions != 1)}: "
                    "compare the mission files and seeds"
                )
        self._tell("begins")

    def _on_event(self, transport: ZenohTransport, event: Event) -> None:
        self._trades += isinstance(event, TradeCommitted)
        transport.log(event)

    def _keep(self, agent: RemoteAgent, directory: AgentDirectory | None, *, at_once: bool = False) -> None:
        """Write down what a later life can begin with, if it has changed."""
        if directory is None or (time.monotonic() < self._keep_at and not at_once):
            return
        node = agent.node
        known = (node.records.changes, node.poses.changes, node.catalogue.digest, agent.vehicle.pose, node.avoid)
        if known != self._kept:
            directory.keep(node.sender, node.memory(), agent.vehicle.pose)
            self._kept = known
            self._keep_at = time.monotonic() + KEEP_EVERY

    def _ending(self, agent: RemoteAgent, *, over: bool) -> Ending:
        if agent.superseded:
            return Ending.SUPERSEDED
        if self._wish.ending is not None:
            return self._wish.ending
        if agent.node.left:
            return Ending.LEFT
        return Ending.OVER if over else Ending.TIMEOUT

    def _tell_end(self, agent: RemoteAgent, ending: Ending) -> None:
        silence, limit = agent.longest_silence, self._settings.network.times.dead_after
        if silence > 0.5 * limit:
            self._warn(
                f"was too busy to speak for {silence:.1f} s; raise dead_after_s, now {limit:g}, in the network file"
            )
        if ending is Ending.SUPERSEDED:
            self._warn("has been started again elsewhere; this process ends")
        elif ending is Ending.TIMEOUT:
            self._warn("leaves before the mission is over: its time is up")
        else:
            self._tell(f"leaves: {ending.value}")

    def _took(self, what: str) -> None:
        now = time.monotonic()
        self._start_s[what] = round(now - self._began, 3)
        self._began = now
