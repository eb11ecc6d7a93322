"""Plans a mission: trade until nobody gains, prove it, go on where the proof finds better."""

from __future__ import annotations

import functools
import math
import platform
import time
from collections.abc import Callable
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from importlib import metadata
from typing import TYPE_CHECKING, Any

from covey.coverage import Certificate
from covey.errors import InputError
from covey.geometry import Region
from covey.mission import Mission, OptimizerName, SensorSpec, Trade
from covey.optimize import PoseResult
from covey.optimize.team_bound import require_built_in
from covey.runtime.agent import LEAST_GAIN, build_planner
from covey.runtime.baseline import greedy_lloyd
from covey.runtime.certify import bound_team, build_certificate, prove_poses
from covey.runtime.changing import ChangingTeam
from covey.runtime.result import Deployment, PlanStatus, Progress
from covey.runtime.streams import Stream, generator
from covey.runtime.team import Standing, Team, Travel, standing_results
from covey.runtime.watching.feed import Run, Watcher
from covey.runtime.watching.steering import Steering
from covey.runtime.watching.telling import TeamTeller, describe
from covey.sensing.registry import build_model

if TYPE_CHECKING:
    from collections.abc import Iterator

REPORT_EVERY = 0.1
"""Seconds between two calls of `on_progress`."""


def plan(
    mission: Mission,
    *,
    seed: int | None = None,
    trade: Trade | str | None = None,
    optimizer: OptimizerName | str | None = None,
    bound: bool = False,
    baseline: bool = False,
    on_progress: Callable[[Progress], None] | None = None,
    watch: Watcher | None = None,
    steering: Steering | None = None,
) -> Deployment:
    """Plan a mission: the agents trade landmarks and choose poses until no trade and no move helps, proved.

    Parameters
    ----------
    mission : Mission
    seed : int, optional
        Instead of the mission's; poses that the mission leaves open are drawn anew.
    trade : Trade or str, optional
        Instead of the mission's: ``thesis`` or ``pairwise``.
    optimizer : OptimizerName or str, optional
        Instead of the mission's: ``search``, ``exact`` or ``differential-evolution``.
    bound : bool
        Also bound what any deployment of this team could score.
    baseline : bool
        Also deploy greedily and by Lloyd's iteration, to compare.
    on_progress : callable, optional
        Called with a `Progress` ten times a second at most.
    watch : Watcher, optional
        Called with all there is to see, when it happens: `covey.runtime.watching.feed`.
    steering : Steering, optional
        Lets others pause it and set its speed.

    Returns
    -------
    Deployment
        After Ctrl-C (KeyboardInterrupt) what is known by then: with status INTERRUPTED and no certificate if planning
        went on; SETTLED, with its certificate, if only the bound or the baseline is missing.

    Raises
    ------
    InputError
        If a sensor model cannot be built, or the mission has changes and agents that share an altitude.
    SolverError
        If a bound is asked for and a sensor is not a built-in model.

    Notes
    -----
    Source: Sposato (2016), Algorithms 2 to 6, section 5.1.  Deviation: V3 to V7, V10, V11.
    """
    if seed is not None:
        mission = mission.with_seed(seed)
    coverage = replace(
        mission.coverage,
        trade=mission.coverage.trade if trade is None else Trade(trade),
        optimizer=mission.coverage.optimizer if optimizer is None else OptimizerName(optimizer),
    )
    run = PlanRun(replace(mission, coverage=coverage), on_progress)
    if bound:
        require_built_in(run.models)
    if mission.changes and mission.separation is not None:
        raise InputError("changes: expected a mission in which no agents share an altitude")
    if steering is not None:
        run.steering, watch = steering, steering.counting(watch)
    if watch is not None:
        scene = describe(run.mission, run.models, run=Run.PLAN, software=software_versions())
        run.teller = TeamTeller(watch, run.team, scene)
    result = run.deployment(bound=bound, baseline=baseline)
    run.tell_end(result)
    return result


class PlanRun:
    """One planning run.

    Parameters
    ----------
    mission : Mission
    on_progress : callable or None
        Called with a `Progress` ten times a second at most.
    travel : Travel, optional
        How agents get to their waypoints; at once by default.
    """

    def __init__(
        self,
        mission: Mission,
        on_progress: Callable[[Progress], None] | None,
        *,
        travel: Travel | None = None,
    ) -> None:
        self.seed = mission.seed
        self.planner = build_planner(mission)
        self.models = tuple(self.planner.models)
        kind = ChangingTeam if mission.changes else Team
        self.team = kind(mission, self.planner, seed=self.seed, travel=travel)
        self.teller: TeamTeller | None = None
        self.steering: Steering | None = None
        self.timing: dict[str, float] = {}
        self._on_progress = on_progress
        self._reported = 0.0

    @property
    def mission(self) -> Mission:
        """The mission as it is now."""
        return self.team.mission

    def deployment(self, *, bound: bool = False, baseline: bool = False) -> Deployment:
        """Plan to the end, prove it, and return what came out."""
        certificate = None
        status = PlanStatus.INTERRUPTED
        try:
            certificate = self._settle()
            status = PlanStatus.SETTLED
        except KeyboardInterrupt:
            pass
        result = self._result(status, certificate)
        with suppress(KeyboardInterrupt):  # it takes nothing away from what has settled
            if bound and status is PlanStatus.SETTLED:
                with self._timed("bound"):
                    found = bound_team(result, on_progress=self._on_progress)
                    result = replace(result, bound=found)
                    if self.teller is not None:
                        self.teller.bound(found.team_upper_bound)
            if baseline and status is PlanStatus.SETTLED:
                with self._timed("baseline"):
                    self.report("baseline", force=True)
                    rng = generator(self.seed, Stream.BASELINE)
                    standing = self.team.standing()
                    found_without = greedy_lloyd(standing.mission, standing.models, rng=rng)
                    result = replace(result, baseline=found_without)
        self.timing["total"] = sum(self.timing.values())
        return replace(result, timing_s=self.timing)

    def tell_end(self, result: Deployment) -> None:
        """Tell whoever watches that the run is over."""
        if self.teller is not None:
            certificate = result.certificate
            self.teller.end(result.status.value, None if certificate is None else certificate.holds)

    def interrupted(self) -> Deployment:
        """Return what is known by now."""
        return self._result(PlanStatus.INTERRUPTED, None)

    def _result(self, status: PlanStatus, certificate: Certificate | None) -> Deployment:
        team = self.team
        if status is PlanStatus.INTERRUPTED:
            team.rescore()  # the interrupt may have come in the middle of an event
        standing = team.standing()
        return Deployment(
            mission=standing.mission,
            seed=self.seed,
            sigma=self.mission.coverage.sigma,
            trade=self.mission.coverage.trade,
            optimizer=self.mission.coverage.optimizer,
            status=status,
            score=team.summary(),
            history=tuple(team.history),
            trades=team.trades,
            pose_optimizations=self.planner.optimizations,
            agents=standing_results(standing),
            certificate=certificate,
            software=dict(software_versions()),
            snapshots=team.finish(),
        )

    def restrict(self, agent: int, region: Region) -> None:
        """From now on keep an agent's poses in a region: the rest of its own cannot be reached."""
        self.planner.restrict(agent, region)
        self._respecify(agent, region=region)

    def blind(self, agent: int) -> None:
        """Take an agent's camera away: its partners may take its landmarks over."""
        specification = SensorSpec("blind", {})
        model = build_model(specification.model)
        self.models = (*self.models[:agent], model, *self.models[agent + 1 :])
        self.planner.replace_model(agent, model)
        self._respecify(agent, sensor=specification)
        if self.mission.separation is not None:  # it does not fly: nobody has to keep clear of its pose
            self.team.mission = replace(self.mission, separation=self.mission.separation.without(agent))
        self.team.note("lost", agent)

    def _respecify(self, agent: int, **changes: Any) -> None:
        agents = list(self.mission.agents)
        agents[agent] = replace(agents[agent], **changes)
        self.team.mission = replace(self.mission, agents=tuple(agents))

    def _settle(self) -> Certificate:
        """Trade to the end and prove every pose; go on as long as a proof finds a better one."""
        team = self.team
        with self._timed("first_optimization"):
            for done, _ in enumerate(team.start(), start=1):
                self.report("optimizing", fraction=done / len(self.mission.agents))
        proofs: dict[int, PoseResult] = {}
        proved: dict[int, tuple[object, ...]] = {}
        landmarks = self.mission.landmarks
        while True:
            with self._timed("trading"):
                while team.advance():
                    self.report("trading")
            with self._timed("proof"):
                standing = team.standing()
                mission, poses, sets = standing.mission, standing.poses, standing.sets
                if mission.landmarks is not landmarks:  # they are numbered anew
                    landmarks = mission.landmarks
                    proofs, proved = {}, {}
                states = {i: self._state(standing, i) for i in range(len(sets))}
                open_agents = [i for i in states if proved.get(i) != states[i]]
                proofs |= prove_poses(
                    mission,
                    standing.models,
                    poses,
                    sets,
                    open_agents,
                    seed=self.seed,
                    on_done=partial(self._report_proofs, of=len(open_agents)),
                )
                proved |= {i: states[i] for i in open_agents}
                least = LEAST_GAIN * self.mission.coverage.sigma
                better = [i for i in open_agents if len(sets[i]) and proofs[i].score > standing.scores[i] + least]
                adopted = [i for i in better if team.adopt(standing.agents[i], proofs[i].pose)]
                if not adopted:
                    return build_certificate(mission, standing.models, poses, sets, proofs)

    def _state(self, standing: Standing, agent: int) -> tuple[object, ...]:
        """Return all that the proof of an agent's pose rests on."""
        separation, poses = standing.mission.separation, standing.poses
        others = () if separation is None else tuple(poses[other] for other in separation.sharing(agent))
        return (standing.mission.agents[agent], poses[agent], standing.sets[agent].tobytes(), others)

    def _report_proofs(self, done: int, *, of: int) -> None:
        self.report("proving", fraction=done / of)

    def report(self, stage: str, *, fraction: float | None = None, force: bool = False) -> None:
        """Tell how far the run is, when it is time to, and wait while others hold it."""
        self._report(stage, fraction, force=force)
        if self.steering is not None:
            self.steering.hold(lambda: self._report(stage, fraction, force=False))

    def _report(self, stage: str, fraction: float | None, *, force: bool) -> None:
        now = time.monotonic()
        if self._on_progress is not None and (force or now - self._reported >= REPORT_EVERY):
            self._reported = now
            self._on_progress(Progress(stage, self.team.score, self.team.trades, self.team.bus.messages, fraction))

    @contextmanager
    def _timed(self, stage: str) -> Iterator[None]:
        begun = time.perf_counter()
        try:
            yield
        finally:
            self.timing[stage] = self.timing.get(stage, 0.0) + time.perf_counter() - begun


@functools.cache
def software_versions() -> dict[str, str]:
    """Return the versions that a result depends on."""
    import covey

    versions = {name: metadata.version(name) for name in ("numpy", "numba", "scipy", "shapely")}
    return {"covey": covey.__version__, "python": platform.python_version(), **versions, "platform": platform.machine()}


def separation_cost(mission: Mission, final: float | None) -> float:
    """Return what keeping apart costs in score: that of the plan if nobody had to, less that of the plan as it is.

    Parameters
    ----------
    mission : Mission
    final : float or None
        The score of the plan as it is; None to plan it.

    Returns
    -------
    float
        0 where nobody shares a layer, NaN after Ctrl-C.
    """
    if mission.separation is None:
        return 0.0
    free = plan(replace(mission, separation=None))
    if final is None:  # what was flown is not what was planned
        apart = plan(mission)
        final = apart.score.final if apart.status is PlanStatus.SETTLED else math.nan
    return free.score.final - final if free.status is PlanStatus.SETTLED else math.nan
