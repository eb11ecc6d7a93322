"""Starts the agents of a mission on this machine, watches them, and writes down what came out."""

from __future__ import annotations

import contextlib
import math
import signal
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import replace
from pathlib import Path
from typing import Any

from covey.errors import NetworkError
from covey.mission import ChangeSpec, Mission
from covey.runtime.certify import build_certificate, prove_poses
from covey.runtime.network.child import Child, Exit
from covey.runtime.network.launch_options import Blow, LaunchOptions, LaunchReport
from covey.runtime.network.network_file import OBSERVER, NetworkPlan
from covey.runtime.network.observer import Observer
from covey.runtime.network.operator import Operator
from covey.runtime.network.remote_agent import mission_codec
from covey.runtime.network.warm_up import warm_up
from covey.runtime.plan import software_versions
from covey.runtime.result import Deployment, PlanStatus, Progress
from covey.runtime.team import standing_results
from covey.runtime.watching.steering import Kill, Request, Revive, SetWeight, Steering
from covey.transports.ports import free_endpoints
from covey.transports.zenoh_observer import ZenohObserver

TICK = 0.05
"""How long to listen at a time, seconds."""

FAREWELL = 5.0
"""How long an agent may take to leave when it is told to, seconds."""

RESTART_AFTER = 0.5
"""Seconds before a process that died is started again."""

DEAF = 10.0
"""How long all agents may take to hear of a change, seconds, before it is plain that they do not listen."""

HOPELESS = 5
"""A process that has died so often in a row without having been heard is not started again."""


def watch(
    mission: Mission,
    network: NetworkPlan,
    *,
    timeout: float = float("inf"),
    on_progress: Callable[[Progress], None] = lambda progress: None,
    on_observer: Callable[[Observer], object] = lambda observer: None,
) -> tuple[Deployment, LaunchReport]:
    """Watch a team that others have started, until its mission is over.

    Parameters
    ----------
    mission, network : as for the agents
    timeout : float, keyword-only
        Seconds after which to give up.
    on_progress : callable, keyword-only
        Called with a `Progress` some times a second.
    on_observer : callable, keyword-only
        Called once with the observer, to subscribe to it.

    Raises
    ------
    NetworkError
        If the network cannot be joined.
    """
    options = replace(LaunchOptions(), network=network, timeout=timeout)
    return _Launch(mission, None, options, network.options.connect, on_progress, on_observer).run()


def launch(
    mission: Mission,
    path: Path,
    options: LaunchOptions,
    *,
    on_progress: Callable[[Progress], None] = lambda progress: None,
    on_observer: Callable[[Observer], object] = lambda observer: None,
    on_endpoints: Callable[[Sequence[str]], object] = lambda endpoints: None,
    steering: Steering | None = None,
) -> tuple[Deployment, LaunchReport]:
    """Start every agent of a mission as a process on this machine, and wait until the mission is over.

    Parameters
    ----------
    mission : Mission
    path : Path
        Its file, which every agent reads.
    options : LaunchOptions
    on_progress, on_observer : callable, keyword-only
        As for `watch`.
    on_endpoints : callable, keyword-only
        Called once with the endpoints on which the agents will listen, and last the observer.
    steering : Steering, keyword-only
        Through it others kill agents, let them come back, and weigh landmarks anew.

    Returns
    -------
    Deployment, LaunchReport
        After Ctrl-C (KeyboardInterrupt), the time-out or the death of all agents what is known by then, with status
        INTERRUPTED.

    Raises
    ------
    NetworkError
        If the network cannot be joined, or an agent ends before it was heard and is not to be started again.
    """
    return _Launch(mission, path, options, (), on_progress, on_observer, on_endpoints, steering).run()


class _Launch:
    def __init__(
        self,
        mission: Mission,
        path: Path | None,
        options: LaunchOptions,
        connect: Sequence[str],
        on_progress: Callable[[Progress], None],
        on_observer: Callable[[Observer], object],
        on_endpoints: Callable[[Sequence[str]], object] = lambda endpoints: None,
        steering: Steering | None = None,
    ) -> None:
        self.mission = mission
        self._path = path
        self._options = options
        self._connect = tuple(connect)
        self._on_progress = on_progress
        self._on_observer = on_observer
        self._on_endpoints = on_endpoints
        self._steering = steering
        self._held: set[int] = set()  # killed by a visitor, and not to come back until one wants it
        if steering is not None:
            steering.offer(Kill, Revive, SetWeight)
        self._first = len(mission.agents)
        self._changes: list[ChangeSpec] = [] if path is None else list(mission.changes)
        self._changed_at = 0.0
        self._children: dict[int, Child] = {}
        self._failures: Counter[int] = Counter()
        self._restarts: dict[int, float] = {}  # when to start whom again
        self._exits: list[Exit] = []
        self._refused: Counter[str] = Counter()
        self._reports: list[dict[str, Any]] = []
        self._began = time.monotonic()
        self._all_there: float | None = None
        self._calm_at = 0.0  # before, the effect of a signal may not show yet
        self._blows = sorted(options.blows, key=lambda blow: blow.after)

    @property
    def _time(self) -> float:
        return time.monotonic() - self._began

    def run(self) -> tuple[Deployment, LaunchReport]:
        with ExitStack() as stack:
            if self._path is not None:
                self._on_progress(Progress("warming up", float("nan")))
                warm_up(self.mission, 0, self._options.vehicles)  # once, and not by all agents at the same time
                self._began = time.monotonic()
            endpoints = self._endpoints()
            self._on_endpoints(endpoints)
            state = self._options.state
            if state is None and self._path is not None:
                state = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="covey-launch-")))
            observer, operator = self._observer(stack, endpoints)
            stack.enter_context(self._team(observer, endpoints, state))
            settled = False
            with contextlib.suppress(KeyboardInterrupt):
                settled = self._watch(observer, operator, endpoints, state)
            over_at = self._time
            longest_unowned = max(observer.longest_unowned, observer.unowned())
            if settled:
                self._release()
            else:
                self._interrupt()
        start = self._all_there
        deployment = self._deployment(observer, settled=settled, start=start, end=over_at)
        report = LaunchReport(
            settled=settled,
            exits=tuple(self._exits),
            agents=tuple(self._reports),
            dropped={cause.value: count for cause, count in observer.dropped.items()},
            refused=dict(self._refused),
            longest_unowned=longest_unowned,
            start_s=None if start is None else round(start, 3),
            settle_s=None if start is None else round(over_at - start, 3),
        )
        return deployment, report

    # The team.

    def _endpoints(self) -> list[str]:
        """Return where each agent listens, who joins later too, and last the observer, to which all connect so that it
        misses nothing.
        """
        if self._path is None:
            return list(self._connect)
        protocol = "tcp" if self._options.network.options.credentials is None else "tls"
        most = self._first + sum(change.join is not None for change in self._changes)
        return free_endpoints(most + 1, protocol)

    def _observer(self, stack: ExitStack, endpoints: Sequence[str]) -> tuple[Observer, Operator]:
        network = self._options.network.for_name(OBSERVER)
        if self._path is None:
            joined = replace(network.options, connect=tuple(endpoints))
        else:
            joined = replace(network.options, listen=(endpoints[-1],), connect=())
        access = ZenohObserver(mission_codec(self.mission), joined)
        stack.enter_context(closing(access))
        observer = Observer(self.mission, access, times=network.times, late=self._path is None)
        self._on_observer(observer)
        return observer, Operator(observer, access, joining=self._options.network.joining)

    @contextlib.contextmanager
    def _team(self, observer: Observer, endpoints: Sequence[str], state: Path | None) -> Iterator[None]:
        try:
            if self._path is not None:
                for agent in range(self._first):
                    self._start(agent, observer, endpoints, state)
            yield
        finally:
            for agent, child in list(self._children.items()):
                child.close()
                self._note_exit(agent, wanted=True)

    def _start(self, agent: int, observer: Observer, endpoints: Sequence[str], state: Path | None) -> None:
        options, name = self._options, observer.team.names[agent]
        others = [*endpoints[:agent], endpoints[-1]]  # of each two one dials, see `covey.transports.links`
        arguments = ["agent", "--name", name, "--mission", str(self._path), "--attached", "--json"]
        arguments += ["--quiet", "--seed", str(self.mission.seed), "--listen", endpoints[agent]]
        arguments += [word for endpoint in others for word in ("--connect", endpoint)]
        arguments += ["--vehicles", options.vehicles, "--wait", str(options.patience)]
        if state is not None:
            arguments += ["--state", str(state)]
        if options.network_file is not None:
            arguments += ["--network", str(options.network_file)]
        self._children[agent] = Child(name, arguments)

    def _watch(self, observer: Observer, operator: Operator, endpoints: Sequence[str], state: Path | None) -> bool:
        """Wait until the mission is over; whether it is."""
        while self._time < self._options.timeout:
            observer.step(TICK)
            operator.step()
            self._look_after(observer, endpoints, state)
            for request in () if self._steering is None else self._steering.take():
                self._grant(request, observer, operator, endpoints, state)
            if self._all_there is None and len(observer.living) == self._first:
                self._all_there = self._time
            if self._change(observer, operator):
                self._start_joined(observer, endpoints, state)
            view = observer.team
            stage = "starting" if self._all_there is None else "trading"
            stage += self._silent(observer)
            self._on_progress(Progress(stage, view.score, view.trades))
            calm = self._time >= self._calm_at and not self._changes and operator.told
            # Between the two questions somebody may fall silent: then it is not over after all.
            if calm and self._is_complete(observer) and observer.over and observer.settle():
                return True
            if self._path is not None and not self._children and not self._restarts:
                return False  # nobody is left who could end it
        return False

    def _silent(self, observer: Observer) -> str:
        """Say who is not heard: to be told why the mission does not end."""
        living, names = observer.living, observer.team.names
        if self._path is None:  # they may have gone, or never come
            expected = len(names) - len(observer.team.gone)
            return f", {len(living)} of {expected} agents heard" if len(living) < expected else ""
        silent = [names[agent] for agent in sorted(self._children) if agent not in living]
        return f", {', '.join(silent)} not heard" if silent and self._all_there is not None else ""

    def _change(self, observer: Observer, operator: Operator) -> bool:
        """Make the next change of the mission if its moment has come; whether one is made."""
        if not self._changes or self._all_there is None:
            return False
        if not operator.told:
            if self._time > self._changed_at + DEAF:
                raise NetworkError(
                    "the agents do not hear of a change; with an access list, name the certificate of the observer "
                    "among access.operators"
                )
            return False
        change = self._changes[0]
        due = change.after_trades is not None and observer.team.trades >= change.after_trades
        due |= change.at is not None and self._time >= self._all_there + change.at
        due |= self._is_complete(observer) and observer.over
        if due:
            operator.change(self._changes.pop(0))
            self._changed_at = self._time
        return due

    def _grant(
        self, request: Request, observer: Observer, operator: Operator, endpoints: Sequence[str], state: Path | None
    ) -> None:
        """Do what a visitor asks for, or say why not."""
        team = observer.team
        match request.command:
            case Kill(agent):
                if agent not in self._children:
                    request.refuse("agent: expected one that lives")
                elif len(self._children) == 1:
                    request.refuse("agent: it is the last one")
                else:
                    self._held.add(agent)
                    self._children[agent].send(signal.SIGKILL)
                    self._calm_at = self._time + self._options.network.times.dead_after
            case Revive(agent):
                if agent not in self._held or agent in self._children:
                    request.refuse("agent: expected one that was killed")
                else:
                    self._held.discard(agent)
                    self._restarts[agent] = self._time
            case SetWeight(landmark, weight):
                if not 0 <= landmark < len(team.owner) or not team.planner.alive[landmark]:
                    request.refuse(f"landmark: expected one that is to be seen, got {landmark}")
                elif not (math.isfinite(weight) and weight >= 0.0):
                    request.refuse(f"weight: expected a finite number from 0 on, got {weight:g}")
                elif not operator.told:
                    request.refuse("weight: the team has not heard of the last change yet")
                else:
                    operator.change(ChangeSpec(reweight={landmark: weight}))
                    self._changed_at = self._time

    def _start_joined(self, observer: Observer, endpoints: Sequence[str], state: Path | None) -> None:
        """Start a process for who has joined."""
        for agent in range(self._first, len(observer.team.names)):
            if agent not in self._children and agent not in self._failures and agent not in observer.team.gone:
                self._failures[agent] = 0
                self._start(agent, observer, endpoints, state)

    def _is_complete(self, observer: Observer) -> bool:
        """Whether those that are heard are those that run, and nothing else is to happen to them."""
        if self._blows or self._restarts:
            return False
        return self._path is None or observer.living.keys() == self._children.keys()

    def _look_after(self, observer: Observer, endpoints: Sequence[str], state: Path | None) -> None:
        """Send the signals that are due, see who has died, and start again who is to be started again."""
        now = self._time
        while self._blows and self._all_there is not None and now >= self._all_there + self._blows[0].after:
            blow = self._blows.pop(0)
            if blow.agent in self._children:
                self._children[blow.agent].send(blow.number)
            self._calm_at = now + self._options.network.times.dead_after
        for agent in list(self._children):
            if self._children[agent].code is not None:
                self._bury(agent, observer)
        for agent, at in list(self._restarts.items()):
            if now >= at:
                del self._restarts[agent]
                self._start(agent, observer, endpoints, state)

    def _bury(self, agent: int, observer: Observer) -> None:
        child = self._children[agent]
        has_left = agent in observer.team.gone
        last = self._note_exit(agent, wanted=child.killed or has_left)
        if has_left:
            return
        heard = agent in observer.living
        self._failures[agent] = 0 if heard else self._failures[agent] + 1
        if agent in self._held:
            return
        if self._options.restart and self._failures[agent] < HOPELESS and last.code != 2:
            self._restarts[agent] = self._time + RESTART_AFTER
        elif not heard and self._all_there is None:
            words = [line for line in last.stderr if line.strip()]
            raise NetworkError(f"{last.name} did not start ({last.cause}): {words[-1] if words else 'it said nothing'}")

    def _note_exit(self, agent: int, *, wanted: bool) -> Exit:
        child = self._children.pop(agent)
        report = child.report()
        child.close()
        if report is not None:
            self._reports.append(report)
        self._refused += child.refused
        code = child.code
        assert code is not None
        self._exits.append(Exit(child.name, round(self._time, 3), code, wanted, child.stderr))
        return self._exits[-1]

    def _release(self) -> None:
        """Let the agents go: they leave when their standard input closes."""
        for child in self._children.values():
            child.release()
        self._await_end()

    def _interrupt(self) -> None:
        """Pass Ctrl-C on, to those that are stopped as well."""
        for child in self._children.values():
            child.send(signal.SIGCONT)
            child.send(signal.SIGINT)
        self._await_end()

    def _await_end(self) -> None:
        end = time.monotonic() + FAREWELL
        with contextlib.suppress(KeyboardInterrupt):
            for child in self._children.values():
                child.wait(max(0.0, end - time.monotonic()))

    # What came out.

    def _deployment(self, observer: Observer, *, settled: bool, start: float | None, end: float) -> Deployment:
        view, standing = observer.team, observer.team.standing()
        mission, poses, sets = standing.mission, standing.poses, standing.sets
        certificate = None
        proved = time.monotonic()
        if settled:
            self._on_progress(Progress("proving", view.score, view.trades))
            proofs = prove_poses(mission, standing.models, poses, sets, range(len(sets)), seed=mission.seed)
            certificate = build_certificate(mission, standing.models, poses, sets, proofs)
        timing = {} if start is None else {"start": start, "trading": end - start}
        timing["proof"] = time.monotonic() - proved
        optimizations = sum(report["optimizations"] for report in self._reports)
        return Deployment(
            mission=mission,
            seed=mission.seed,
            sigma=mission.coverage.sigma,
            trade=mission.coverage.trade,
            optimizer=mission.coverage.optimizer,
            status=PlanStatus.SETTLED if settled else PlanStatus.INTERRUPTED,
            score=view.summary(),
            history=tuple(view.history),
            trades=view.trades,
            pose_optimizations=max(optimizations, view.optimizations),
            agents=standing_results(standing),
            certificate=certificate,
            software=dict(software_versions()),
            snapshots=view.finish(),
            timing_s=timing | {"total": sum(timing.values())},
        )


__all__ = ["Blow", "LaunchOptions", "LaunchReport", "launch", "watch"]
