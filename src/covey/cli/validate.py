"""`covey validate`: is this mission or exercise file right, and what does it say?"""

from __future__ import annotations

import json as json_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from covey.cli.arguments import named_path

if TYPE_CHECKING:
    from covey.mission import ChangeSpec, Mission, SensorSpec
    from covey.mission.exercise import Exercise, Task


def validate(
    files: Annotated[
        list[Path],
        typer.Argument(parser=named_path, metavar="FILE...", help="Mission or exercise files: YAML, TOML or JSON."),
    ],
    json: Annotated[bool, typer.Option("--json", help="Print the findings as JSON.")] = False,
) -> None:
    """Report every mistake in mission or exercise files at once, or say what is in them."""
    from covey.errors import MissionError
    from covey.mission import load_mission
    from covey.mission.exercise import is_exercise, load_exercise

    findings: list[dict[str, Any]] = []
    for file in files:
        try:
            _check_regular(file)
            facts = exercise_summary(load_exercise(file)) if is_exercise(file) else summary(load_mission(file))
        except MissionError as error:
            mistakes = [vars(mistake) for mistake in error.mistakes]
            findings.append({"file": str(file), "valid": False, "mistakes": mistakes})
            if not json:
                typer.echo(str(error))
            continue
        findings.append({"file": str(file), "valid": True, "mistakes": [], "summary": facts})
        if not json:
            typer.echo(f"{file}: valid")
            for key, value in facts.items():
                typer.echo(f"  {key:<13}{value}")
    valid = all(finding["valid"] for finding in findings)
    if json:
        typer.echo(json_module.dumps({"valid": valid, "files": findings}, indent=2, ensure_ascii=False))
    if not valid:
        raise typer.Exit(2)


def _check_regular(file: Path) -> None:
    """Refuse a pipe or a device, which may never end; what is missing or a directory, reading reports."""
    from covey.errors import MissionError, Mistake

    try:
        endless = file.exists() and not file.is_file() and not file.is_dir()
    except OSError:  # reading says why
        return
    if endless:
        raise MissionError((Mistake(str(file), None, None, "", "expected a regular file, got a pipe or a device"),))


def summary(mission: Mission) -> dict[str, str]:
    """Say in a few lines what a mission holds.

    Parameters
    ----------
    mission : Mission

    Returns
    -------
    dict of str to str
        One line of text for each of mission, landmarks, region, agents, sensor, coverage and, where the mission has
        them, flight, layers and georeference.
    """
    landmarks = mission.landmarks
    size = f", cells of {landmarks.cell_size:g} m" if landmarks.cell_size else ""
    normals = ", with normals" if landmarks.normals_W is not None else ""
    holes = len(mission.region.holes)
    coverage = mission.coverage
    assignment = getattr(coverage.assignment, "value", "by the operator")
    drawn = sum(agent.drawn for agent in mission.agents)
    own_sensor = sum(agent.sensor != mission.sensor for agent in mission.agents)
    own_region = sum(agent.region is not mission.region for agent in mission.agents)
    notes = [(drawn, "a pose drawn from the seed"), (own_sensor, "another sensor"), (own_region, "another region")]
    shown = [agent.name for agent in mission.agents[:8]] + (["..."] if len(mission.agents) > 8 else [])
    facts = {
        "mission": f"{mission.name}, seed {mission.seed}",
        "landmarks": f"{len(landmarks):,}{size}{normals}, total weight {landmarks.weights.sum():g}{_strips(mission)}",
        "region": f"{mission.region.shape.area:,.6g} m²" + (f", {holes} hole{'s' * (holes > 1)}" if holes else ""),
        "agents": "; ".join(
            [f"{len(mission.agents)}: {', '.join(shown)}"] + [f"{n} with {what}" for n, what in notes if n]
        ),
        "sensor": _sensor(mission.sensor),
        "coverage": f"sigma {coverage.sigma:g}, trade {coverage.trade.value}, optimizer {coverage.optimizer.value}, "
        f"assignment {assignment}",
    }
    if mission.changes:
        facts["changes"] = ", ".join(map(_change, mission.changes))
    if "flight" in mission.source:
        facts["flight"] = _flight(mission)
    if mission.separation is not None:
        facts["layers"] = str(mission.separation)
    origin = mission.georeference
    if origin is not None:
        facts["georeference"] = f"lon {origin.lon_deg:.7g}°, lat {origin.lat_deg:.7g}°, alt {origin.alt_m:g} m"
    return facts


def _change(change: ChangeSpec) -> str:
    when = "" if change.after_trades is None else f" after {change.after_trades} trades"
    when = when if change.at is None else f" at {change.at:g} s"
    if change.join is not None:
        return f"{change.join['name']} joins{when}"
    if change.leave is not None:
        return f"{change.leave} leaves{when}"
    if change.add is not None:
        return f"{len(change.add)} added{when}"
    count = len(change.remove) or len(change.reweight)
    return f"{count} {'removed' if change.remove else 'reweighted'}{when}"


def exercise_summary(exercise: Exercise) -> dict[str, str]:
    """Say in a few lines what an exercise holds.

    Parameters
    ----------
    exercise : Exercise

    Returns
    -------
    dict of str to str
        One line of text for each of exercise, vehicles and, where it has them, obstacles, objects and weather.
    """
    vehicles = [f"{item.name} ({item.parameters.name}) {_task(item.task, exercise)}" for item in exercise.vehicles[:8]]
    rest = ["..."] if len(exercise.vehicles) > 8 else []
    facts = {
        "exercise": f"{exercise.name}, seed {exercise.seed}, {exercise.duration:g} s",
        "vehicles": f"{len(exercise.vehicles)}: {', '.join(vehicles + rest)}",
    }
    if exercise.obstacles:
        facts["obstacles"] = str(len(exercise.obstacles))
    if exercise.objects:
        facts["objects"] = ", ".join(
            f"{item.name}, radius {item.radius:g} m, {item.speed:g} m/s" for item in exercise.objects
        )
    weather = [name for name, there in (("wind", not exercise.wind.calm), ("noise", not exercise.noise.exact)) if there]
    if weather:
        facts["weather"] = ", ".join(weather)
    return facts


def _task(task: Task, exercise: Exercise) -> str:
    from covey.mission.exercise import Circle, Follow, Goal

    match task:
        case Goal():
            return "goes to ({:g}, {:g}, {:g}) m".format(*task.p_W)
        case Circle():
            return f"flies a circle of {task.radius:g} m"
        case Follow():
            return f"follows {exercise.vehicles[task.leader].name}"
        case None:
            return "stays"


def _sensor(sensor: SensorSpec) -> str:
    options = dict(sensor.options)
    distance = options.pop("optimal_distance", None)
    parts = [sensor.model] + ([f"optimal distance {distance:g} m"] if distance is not None else [])
    return ", ".join(parts + [f"{name} {value:g}" for name, value in options.items()])


def _flight(mission: Mission) -> str:
    spec = mission.flight
    altitudes = sorted(set(spec.altitudes(len(mission.agents))))
    heights = f"{altitudes[0]:.4g} m" if len(altitudes) == 1 else f"{altitudes[0]:.4g} to {altitudes[-1]:.4g} m"
    parts = [f"{Path(spec.vehicle).stem}, {len(altitudes)} layer{'s' * (len(altitudes) > 1)} at {heights}"]
    for number, what in ((len(spec.obstacles), "obstacle"), (len(spec.faults), "fault")):
        if number:
            parts.append(f"{number} {what}{'s' * (number > 1)}")
    parts += [name for name, there in (("wind", not spec.wind.calm), ("noise", not spec.noise.exact)) if there]
    return ", ".join(parts)


def _strips(mission: Mission) -> str:
    """Say how much of a grid's box is left over where its sides are no multiples of the spacing."""
    from covey.environment.sites import cells

    grid = mission.source["environment"]["landmarks"].get("grid")
    if grid is None:
        return ""
    parts = []
    for axis in ("x_m", "y_m"):
        low, high = grid[axis]
        rest = (high - low) - cells(low, high, grid["spacing_m"]) * grid["spacing_m"]
        if rest > 1e-9 * (high - low):
            parts.append(f"{rest:.3g} m in {axis[0]}")
    return f", {' and '.join(parts)} left over at the upper end" if parts else ""
