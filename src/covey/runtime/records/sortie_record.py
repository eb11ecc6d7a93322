"""The files of a flight, beside those of its deployment if it was a mission."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from covey.flight.parameters import VehicleParameters, load_vehicle
from covey.runtime.records.output import check_target, staged
from covey.runtime.records.record import FLIGHT_FILES, RECORD, RESULT, write_result
from covey.runtime.result import Progress
from covey.vehicles.flight_log import FlightLog

if TYPE_CHECKING:
    from covey.runtime.exercise import ExerciseResult
    from covey.runtime.flight import Flight

SCHEMA_VERSION = 1


def write_flight(
    flight: Flight,
    directory: str | Path,
    *,
    overwrite: bool = False,
) -> Path:
    """Write a flight into a directory, whole or not at all.

    Parameters
    ----------
    flight : Flight
    directory : str or Path
        It is made if need be.
    overwrite : bool
        Replace an earlier result of covey there.

    Returns
    -------
    Path
        The directory.

    Raises
    ------
    OutputError
        If something is there already, or it cannot be written.
    """

    def write(staging: Path) -> None:
        _write_log(flight.log, staging, flight=flight)

    return write_result(flight.deployment, directory, overwrite=overwrite, more=write)


def film_flight(
    flight: Flight, directory: str | Path, *, on_progress: Callable[[Progress], None] | None = None
) -> Path | None:
    """Add a film to the directory of a flight.

    It takes longer than the flight, so it is made when all else is written: whatever ends it leaves that as it is.

    Parameters
    ----------
    flight : Flight
    directory : str or Path
        Where `write_flight` wrote it.
    on_progress : callable, optional
        Told before the film and after each picture; what it raises ends the film.

    Returns
    -------
    Path or None
        The film; None for a flight that ended before there was anything to film.

    Raises
    ------
    OutputError
        If there is a film already, it cannot be written, or ffmpeg fails.
    """
    mission = flight.deployment.mission
    vehicles = [load_vehicle(mission.flight.vehicle)] * len(mission.agents)
    return _film(flight.log, vehicles, Path(directory), flight=flight, on_progress=on_progress)


def write_exercise(
    result: ExerciseResult,
    directory: str | Path,
    *,
    overwrite: bool = False,
) -> Path:
    """Write an exercise into a directory, whole or not at all: its summary, log and figures.

    Raises
    ------
    OutputError
        If something is there already, or it cannot be written.
    """
    target = Path(directory)
    check_exercise_target(target, overwrite=overwrite)
    with staged(target, (*FLIGHT_FILES, RECORD, RESULT)) as staging:
        _write_log(result.log, staging)
        (staging / RESULT).write_text(exercise_text(result), encoding="utf-8")
    return target


def film_exercise(
    result: ExerciseResult, directory: str | Path, *, on_progress: Callable[[Progress], None] | None = None
) -> Path | None:
    """Add a film to the directory of an exercise: see `film_flight`.

    Raises
    ------
    OutputError
        If there is a film already, it cannot be written, or ffmpeg fails.
    """
    vehicles = [vehicle.parameters for vehicle in result.exercise.vehicles]
    return _film(result.log, vehicles, Path(directory), on_progress=on_progress)


def check_exercise_target(directory: str | Path, *, overwrite: bool = False) -> None:
    """Check that an exercise may be written into a directory, before it is flown.

    Raises
    ------
    OutputError
        If the directory holds something that would be overwritten, is a file, or cannot be made.
    """
    check_target(Path(directory), (*FLIGHT_FILES, RECORD, RESULT), _is_exercise_result, overwrite=overwrite)


def exercise_text(result: ExerciseResult) -> str:
    """Return the content of an exercise's ``result.json``."""
    document: dict[str, Any] = {
        "schema_version": SCHEMA_VERSION,
        "exercise": result.exercise.name,
        "seed": result.exercise.seed,
        "status": "interrupted" if result.interrupted else "flown",
        "flight": dict(result.summary),
    }
    return json.dumps(document, indent=2, allow_nan=False) + "\n"


def _is_exercise_result(target: Path) -> bool:
    try:
        document = json.loads((target / RESULT).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(document, dict) and {"exercise", "flight", "schema_version"} <= set(document)


def _write_log(log: FlightLog, staging: Path, *, flight: Flight | None = None) -> None:
    from covey.runtime.drawing import figures, flight_figures

    log.save(staging / "flight.npz")
    if len(log.time) < 2:
        return
    deployment = None if flight is None else flight.deployment
    obstacles = () if flight is None else flight.obstacles
    drawn = flight_figures.flight_figures(log, deployment, obstacles=obstacles)
    figures.save_figure(drawn["overview"], staging / "flight.png")
    figures.save_pages(list(drawn.values()), staging / "flight.pdf")


def _film(
    log: FlightLog,
    vehicles: Sequence[VehicleParameters],
    target: Path,
    *,
    flight: Flight | None = None,
    on_progress: Callable[[Progress], None] | None,
) -> Path | None:
    if len(log.time) < 2:
        return None
    from covey.runtime.drawing.film import write_film
    from covey.runtime.drawing.film_scene import film_scene

    score = math.nan if flight is None else flight.deployment.score.final
    mission = None if flight is None else flight.deployment.mission
    moments = () if flight is None else flight.moments
    obstacles = () if flight is None else flight.obstacles
    appeared = () if flight is None else flight.appeared

    def report(fraction: float) -> None:
        if on_progress is not None:
            on_progress(Progress("filming", score, fraction=fraction))

    report(0.0)
    with film_scene(log, vehicles, mission=mission, snapshots=moments, obstacles=obstacles, appeared=appeared) as scene:
        return write_film(
            log,
            target / "flight",
            mission=mission,
            snapshots=moments,
            scene=scene,
            obstacles=obstacles,
            appeared=appeared,
            on_progress=report,
        )
