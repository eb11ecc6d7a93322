"""The flights of chapters 2 and 3 of the thesis, made anew: figures, what the thesis says, and what we measured."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from covey.flight.layout import OBSERVATION, P, V
from covey.flight.potential_field import FieldGains, fly_field
from covey.flight.separation import min_separation
from covey.flight.trajectories import Circle as CircleTrajectory
from covey.flight.trajectories import Hold, Trajectory
from covey.mission.exercise import Circle, Exercise, Goal
from covey.runtime.drawing import flight_figures as figures
from covey.runtime.drawing.figures import save_figure
from covey.runtime.exercise import LOG_EVERY, fly_exercise
from covey.runtime.records.output import check_target, staged
from covey.runtime.reproduce.findings import LEAST_DISTANCE, STATEMENTS, Measure, Run, Statement, agrees
from covey.runtime.reproduce.page import MARK, Image, page
from covey.runtime.reproduce.scenes import SCENES, scene
from covey.runtime.result import Progress
from covey.simulators.ideal import fly_ideal
from covey.vehicles.fleet import Kind
from covey.vehicles.flight_log import FlightLog, FlightRecorder

PAGE = "index.html"
TABLE = "measures.csv"

FIELD_STEP = 0.005
"""Step of the integration of the potential field alone, seconds."""


@dataclass(frozen=True)
class Drawing:
    """One figure of the report.

    Parameters
    ----------
    name : str
        Of its files.
    statement : str
        Key of the `Statement` it belongs to.
    caption : str
    draw : callable
        From a log.
    """

    name: str
    statement: str
    caption: str
    draw: Callable[[FlightLog], Figure]


def _position(log: FlightLog) -> Figure:
    return figures.position_figure(log, 0)


def _position_error(log: FlightLog) -> Figure:
    return figures.error_figure(log, 0, "position")


def _velocity_error(log: FlightLog) -> Figure:
    return figures.error_figure(log, 0, "velocity")


def _lyapunov(log: FlightLog) -> Figure:
    return figures.lyapunov_figure(log, 0)


DRAWINGS = (
    Drawing("figure-2.2", "regulation", "Figure 2.2. Position", _position),
    Drawing("figure-2.3", "regulation", "Figure 2.3. Position error", _position_error),
    Drawing("figure-2.4", "regulation", "Figure 2.4. Velocity error", _velocity_error),
    Drawing("figure-2.5", "regulation-v", "Figure 2.5. Lyapunov function", _lyapunov),
    Drawing("figure-2.6", "circle", "Figure 2.6. Position", _position),
    Drawing("figure-2.7", "circle", "Figure 2.7. Position error", _position_error),
    Drawing("figure-2.8", "circle", "Figure 2.8. Velocity error", _velocity_error),
    Drawing("figure-2.9", "circle-v", "Figure 2.9. Lyapunov function", _lyapunov),
    Drawing("leader-follower-paths", "leader-follower", "Leader and follower", figures.paths_figure),
    Drawing("leader-follower-error", "leader-follower", "Errors in position", figures.error_figure),
    Drawing("figure-3.1", "attraction", "Figure 3.1. Position", _position),
    Drawing("figure-3.2", "attraction", "Figure 3.2. Velocity", lambda log: figures.speed_figure(log, 0)),
    Drawing("figure-3.3", "go-to-two", "Figure 3.3. Paths of two vehicles", figures.paths_figure),
    Drawing("figure-3.3-separation", "go-to-two", "Their separation", figures.separation_figure),
    Drawing("figure-3.4", "go-to-three", "Figure 3.4. Paths of three vehicles", figures.paths_figure),
    Drawing("figure-3.4-separation", "go-to-three", "Their separation", figures.separation_figure),
    Drawing("swap-paths", "swap", "Paths of the swap", figures.paths_figure),
    Drawing("swap-separation", "swap", "Separation during the swap", figures.separation_figure),
    Drawing("hover-paths", "hover", "Path of the vehicle and of the object", figures.paths_figure),
    Drawing("hover-position", "hover", "Position of the vehicle", _position),
)

NAMES = (
    *(f"{drawing.name}-{run}.{kind}" for drawing in DRAWINGS for run in ("ideal", "flown") for kind in ("png", "pdf")),
    TABLE,
    PAGE,
)


@dataclass(frozen=True, eq=False)
class Finding:
    """A statement of the thesis with what we measured.

    Parameters
    ----------
    statement : Statement
    measures : dict of str to tuple of Measure
        By run: ``ideal``, then the simulators.
    """

    statement: Statement
    measures: dict[str, tuple[Measure, ...]]

    @property
    def agrees(self) -> bool:
        """Whether all that is asked for holds in every run."""
        return all(agrees(measures) for measures in self.measures.values())


def reproduce_flight(
    directory: str | Path,
    *,
    simulators: Sequence[Kind | str] = (Kind.REFERENCE, Kind.MUJOCO),
    overwrite: bool = False,
    on_progress: Callable[[Progress], None] | None = None,
) -> tuple[Finding, ...]:
    """Fly the scenes of chapters 2 and 3 and write Figures 2.2 to 2.9 and 3.1 to 3.4, a table and a page.

    Parameters
    ----------
    directory : str or Path
        Where to; it is made if need be.
    simulators : sequence of Kind or str
        In which each scene is flown; the figures show the last, beside the thesis's model.
    overwrite : bool
        Replace an earlier reproduction there.
    on_progress : callable, optional
        Told before each flight and each figure.

    Returns
    -------
    tuple of Finding
        One a statement of the thesis; after Ctrl-C (KeyboardInterrupt) those whose scenes were flown by then, with what
        follows from them written.  If there is none it goes on, and nothing is written.

    Raises
    ------
    OutputError
        If something is there already, or it cannot be written.
    """
    target = Path(directory)
    check_target(target, NAMES, _is_reproduction, overwrite=overwrite)
    kinds = [Kind(kind) for kind in simulators]
    told = _Teller(on_progress, len(SCENES) * (1 + len(kinds)) + len(DRAWINGS))
    runs: dict[str, dict[str, Run]] = {}
    try:
        for name in SCENES:
            runs[name] = _fly(scene(name), name, kinds, told)
    except KeyboardInterrupt:
        if not runs:
            raise
        told = _Teller(None, 1)  # Ctrl-C was heeded; it would be again at every word
    findings = tuple(
        Finding(item, {label: item.measure(run) for label, run in runs[item.scene].items()})
        for item in STATEMENTS
        if item.scene in runs
    )
    with staged(target, NAMES) as staging:
        images, complete = _draw(runs, staging, told)
        _write_measures(findings, staging / TABLE)
        note = "" if complete else f"The run was interrupted: {len(runs)} of {len(SCENES)} scenes were flown."
        (staging / PAGE).write_text(page(findings, images, staging, note=note), encoding="utf-8")
    return findings


def _fly(exercise: Exercise, name: str, kinds: Sequence[Kind], told: _Teller) -> dict[str, Run]:
    """Fly a scene by the thesis's model, if it has one, and in each simulator."""
    told(f"flying {name}")
    model = ideal_run(exercise)
    runs = {} if model is None else {"ideal": model}
    for kind in kinds:
        told(f"flying {name} in {kind.value}")
        result = fly_exercise(exercise, simulator=kind)
        if result.interrupted:
            raise KeyboardInterrupt
        runs[kind.value] = Run(exercise, result.log, result.summary["collisions"])
    return runs


def findings_text(findings: Sequence[Finding]) -> str:
    """Return a table of what agrees, as text."""
    labels = list(dict.fromkeys(label for finding in findings for label in finding.measures))
    width = max(len(finding.statement.title) for finding in findings)
    lines = [f"{'what the thesis says':<{width}}" + "".join(f"  {label:>9}" for label in labels)]
    for finding in findings:
        cells = []
        for label in labels:
            measures = finding.measures.get(label)
            cells.append("-" if measures is None else "agrees" if agrees(measures) else "differs")
        lines.append(f"{finding.statement.title:<{width}}" + "".join(f"  {cell:>9}" for cell in cells))
    return "\n".join(lines)


def ideal_run(exercise: Exercise) -> Run | None:
    """Fly an exercise by the thesis's model alone: (2.2) with the pure law, or points that obey (3.1).

    Vehicles neither have a body nor limits there.  None for a follower: the thesis has it in a simulator only.
    """
    tasks = [vehicle.task for vehicle in exercise.vehicles]
    first = exercise.vehicles[0]
    trajectory: Trajectory | None = None
    if isinstance(tasks[0], Circle):
        trajectory = CircleTrajectory(tasks[0].center_W, tasks[0].radius, -tasks[0].rate)
    elif isinstance(tasks[0], Goal) and tasks[0].direct:
        trajectory = Hold(tasks[0].p_W, tasks[0].yaw)
    if trajectory is None:
        return Run(exercise, _field_log(exercise))
    if len(tasks) > 1:
        return None
    recorder = _recorder(exercise)
    start = [*first.start_W, 0.0, 0.0, 0.0, math.cos(first.yaw / 2.0), 0.0, 0.0, math.sin(first.yaw / 2.0)]
    flight = fly_ideal(trajectory, start, first.parameters, duration=exercise.duration)
    every = max(1, round(LOG_EVERY / float(flight.time[1])))
    for k in range(0, len(flight.time), every):
        row, goal = slice(k, k + 1), np.full((1, 4), np.nan)
        state, reference, command = flight.state[row], flight.reference[row], flight.command[row]
        recorder.add(float(flight.time[k]), state, reference, command, flight.signals[row], goal, math.inf)
    return Run(exercise, recorder.log())


def _recorder(exercise: Exercise) -> FlightRecorder:
    names = [vehicle.name for vehicle in exercise.vehicles]
    return FlightRecorder(
        names,
        [vehicle.parameters.name for vehicle in exercise.vehicles],
        "ideal",
        required_separation=LEAST_DISTANCE,
        vertical_ratio=1.0,
        object_radii=[item.radius for item in exercise.objects],
    )


def _field_log(exercise: Exercise) -> FlightLog:
    """Return the log of points that obey the potential field."""
    n, given = len(exercise.vehicles), exercise.navigation
    starts = np.array([vehicle.start_W for vehicle in exercise.vehicles])
    tasks = [vehicle.task for vehicle in exercise.vehicles]
    goals = np.array([t.p_W if isinstance(t, Goal) else p for t, p in zip(tasks, starts, strict=True)])
    steps = round(exercise.duration / FIELD_STEP) + 1
    times = FIELD_STEP * np.arange(steps)
    objects = np.array([[item.position(t) for item in exercise.objects] for t in times]).reshape(steps, -1, 3)
    gains = FieldGains(given["k_wp"], given["k_v"], given.get("k_rep", 0.0), given.get("threshold", 1.0))
    positions, velocities = fly_field(
        starts, goals, gains, duration=exercise.duration, dt=FIELD_STEP, objects_W=objects if objects.size else None
    )
    recorder = _recorder(exercise)
    goal = np.hstack([goals, np.zeros((n, 1))])
    state = np.zeros((n, OBSERVATION))
    state[:, 6] = 1.0
    for k in range(0, steps, round(LOG_EVERY / FIELD_STEP)):
        state[:, P : P + 3], state[:, V : V + 3] = positions[k], velocities[k]
        reference = np.hstack([positions[k], velocities[k], np.zeros((n, 8))])
        apart = min_separation(positions[k])
        rows = np.zeros((n, 4)), np.zeros((n, 6))
        recorder.add(float(times[k]), state, reference, *rows, goal, apart, objects=objects[k])
    return recorder.log()


class _Teller:
    """Tells how far the work has come."""

    def __init__(self, on_progress: Callable[[Progress], None] | None, total: int) -> None:
        self._on_progress, self._total, self._count = on_progress, total, 0

    def __call__(self, stage: str) -> None:
        if self._on_progress is not None:
            self._on_progress(Progress(stage, math.nan, fraction=self._count / self._total))
        self._count += 1


def _draw(runs: dict[str, dict[str, Run]], staging: Path, told: _Teller) -> tuple[list[Image], bool]:
    """Draw the figures of what was flown; return them, and whether all there may be are there."""
    scenes = {statement.key: statement.scene for statement in STATEMENTS}
    images: list[Image] = []
    for drawing in DRAWINGS:
        if scenes[drawing.statement] not in runs:
            continue
        try:
            told(f"drawing {drawing.name}")
        except KeyboardInterrupt:
            return images, False
        logs = {label: run.log for label, run in runs[scenes[drawing.statement]].items()}
        last = next(reversed(logs))
        for label in dict.fromkeys(["ideal", last] if "ideal" in logs else [last]):
            suffix = "ideal" if label == "ideal" else "flown"
            figure = drawing.draw(logs[label])
            for kind in ("png", "pdf"):
                save_figure(figure, staging / f"{drawing.name}-{suffix}.{kind}")
            images.append(Image(f"{drawing.name}-{suffix}", drawing.statement, drawing.caption, label))
    return images, len(runs) == len(SCENES)


def _write_measures(findings: Sequence[Finding], file: Path) -> None:
    with file.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(["statement", "where", "run", "quantity", "value", "unit", "as_the_thesis_says"])
        for finding in findings:
            for label, measures in finding.measures.items():
                for item in measures:
                    holds = "" if item.holds is None else "yes" if item.holds else "no"
                    where = finding.statement.where
                    writer.writerow(
                        [finding.statement.key, where, label, item.quantity, repr(item.value), item.unit, holds]
                    )


def _is_reproduction(directory: Path) -> bool:
    try:
        return MARK in (directory / PAGE).read_text(encoding="utf-8")
    except (OSError, ValueError):
        return False
