"""From the `flight` section of a mission file to a `FlightSpec`, or to every mistake in it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from covey.environment.json_text import KeyPath
from covey.errors import CoveyError
from covey.mission.flight import Fault, FlightSpec, NoiseSpec, WindSpec
from covey.mission.flight_schema import FlightSection, ObstacleSection, WindSection
from covey.mission.report import Report, nearest, one_of

if TYPE_CHECKING:
    from covey.flight.obstacles import Obstacle
    from covey.flight.parameters import VehicleParameters
    from covey.mission.model import Mission

ROOM_HINT = (
    "move their poses apart, raise ceiling_m or layers so that fewer share a layer, enlarge the region, "
    "or fly smaller vehicles"
)
START_HINT = "vehicles take off and land where their agents start: move the poses, or choose another flight.vehicle"
CLOSE = 1e-6
"""Distances are compared up to this, metres."""


def build_flight(
    section: FlightSection | None, names: Sequence[str], report: Report, *, folder: Path
) -> FlightSpec | None:
    """Build the flight of a mission with these agents, or note every mistake and return None."""
    if section is None:
        return FlightSpec()
    from covey.flight.parameters import load_vehicle

    vehicle = _vehicle(section.vehicle, report, folder)
    obstacles = [
        build_obstacle(obstacle, ("flight", "obstacles", i), report) for i, obstacle in enumerate(section.obstacles)
    ]
    faults = _faults(section, names, report)
    if vehicle is None:
        return None
    if section.max_speed_m_s is not None:
        _check_speed(section, vehicle, report)
    spec = FlightSpec(
        vehicle=vehicle,
        altitude=section.altitude_m,
        layers=section.layers,
        layer_spacing=section.layer_spacing_m,
        ceiling=math.inf if section.ceiling_m is None else section.ceiling_m,
        max_speed=section.max_speed_m_s,
        obstacles=tuple(obstacle for obstacle in obstacles if obstacle is not None),
        wind=_wind(section.wind),
        noise=NoiseSpec(
            section.noise.position_m,
            section.noise.velocity_m_s,
            math.radians(section.noise.attitude_deg),
            math.radians(section.noise.rate_deg_s),
            section.noise.latency_s,
        ),
        arrival_position=section.arrival.position_m,
        arrival_yaw=math.radians(section.arrival.yaw_deg),
        faults=tuple(sorted(faults, key=lambda fault: fault.at)),
        start_spacing=load_vehicle(vehicle).required_separation,
    )
    _check_altitude(spec, report)
    _check_layers(spec, len(names), report)
    separation = spec.separation(len(names)) if names else None
    return spec if separation is None else replace(spec, start_spacing=separation.clear)


def check_room(mission: Mission, report: Report) -> None:
    """Check that agents that share a layer start clear of each other; drawn poses tell where there is no room."""
    separation = mission.separation
    if separation is None:
        return
    close = separation.too_close([agent.pose for agent in mission.agents], separation.clear - CLOSE)
    if close:
        report.add(("flight",), crowded(mission, close), ROOM_HINT)


def check_starts(mission: Mission, report: Report) -> None:
    """Check that vehicles can take off where their agents start, if the mission says how it is flown, and rightly."""
    if "flight" not in mission.source or report.inside(("flight",)):
        return
    for agent, message in bad_starts(mission):
        drawn = mission.agents[agent].drawn
        path: KeyPath = ("agents",) if drawn else ("agents", agent, "pose")
        report.add(path, message, START_HINT)


def bad_starts(mission: Mission) -> list[tuple[int, str]]:
    """Return each agent whose vehicle cannot start where it is to, and why: another one or an obstacle is too close.

    Raises
    ------
    InputError
        If the vehicle's parameter file cannot be read.
    """
    from covey.flight.parameters import load_vehicle

    agents, spec = mission.agents, mission.flight
    vehicle = load_vehicle(spec.vehicle)
    needed = vehicle.required_separation
    poses = np.array([agent.pose.position_W for agent in agents])
    found = []
    for i, agent in enumerate(agents[1:], start=1):
        away = np.hypot(*(poses[:i] - poses[i]).T)
        found += [
            (
                i,
                f"{agents[j].name} and {agent.name} start {d:.2f} m apart, expected at least {needed:.2f} m",
            )
            for j, d in enumerate(away)
            if d < needed
        ]
    return found + _obstructed(mission, vehicle, poses)


def _obstructed(mission: Mission, vehicle: VehicleParameters, poses_W: NDArray[np.float64]) -> list[tuple[int, str]]:
    """Return each agent whose vehicle an obstacle keeps from rising to its altitude, and why."""
    spec = mission.flight
    if not spec.obstacles:
        return []
    from covey.flight.obstacles import pack
    from covey.flight.route import Router

    keep_off = vehicle.keep_off
    router = Router(pack(spec.obstacles))
    found = []
    for i, (agent, altitude) in enumerate(zip(mission.agents, spec.altitudes(len(mission.agents)), strict=True)):
        if not router.line_is_free(np.array([*poses_W[i], 0.0]), np.array([*poses_W[i], altitude]), keep_off):
            what = f"expected room to rise to {altitude:.3g} m at least {keep_off:.2f} m away from obstacles"
            found.append((i, f"{what}; one is in {agent.name}'s way"))
    return found


def crowded(mission: Mission, close: Sequence[tuple[int, int, float]]) -> str:
    """Say which agents of one layer start too close to each other."""
    assert mission.separation is not None
    names = [agent.name for agent in mission.agents]
    layers = len(set(mission.separation.layers))
    where = "one layer" if layers == 1 else f"{layers} layers"
    shown = "; ".join(f"{names[i]} and {names[j]} start {away:.2f} m apart" for i, j, away in close[:5])
    more = f"; and {len(close) - 5} more pairs" if len(close) > 5 else ""
    return (
        f"expected {len(names)} agents in {where} to start at least {mission.separation.clear:.3g} m apart "
        f"where they share one: {shown}{more}"
    )


def _check_speed(section: FlightSection, vehicle: str, report: Report) -> None:
    """Check that vehicles this fast can still keep apart (P4)."""
    from covey.flight.navigation_options import NavigationOptions, fastest
    from covey.flight.parameters import load_vehicle

    path: KeyPath = ("flight", "max_speed_m_s")
    parameters = load_vehicle(vehicle)
    most, asked = fastest(parameters), section.max_speed_m_s
    if asked is not None and asked > most:
        shown = math.floor(100.0 * most) / 100.0
        message = f"{parameters.name} vehicles could not keep apart at this speed: expected at most {shown:.2f} m/s"
        report.add(path, f"{message}, got {asked:g}")
        return
    try:
        NavigationOptions.for_vehicle(parameters, max_speed=asked)
    except CoveyError as error:
        report.add(path, f"vehicles could not keep apart at this speed: {error}")


def _vehicle(name: str, report: Report, folder: Path) -> str | None:
    from covey.flight.parameters import load_vehicle, vehicle_names

    path: KeyPath = ("flight", "vehicle")
    if not name.endswith(".toml"):
        if name in vehicle_names():
            return name
        near = nearest(name, vehicle_names())
        hint = f"did you mean {near!r}?" if near else ""
        report.add(path, f"expected {one_of(vehicle_names())}, or a file ending in .toml, got {name[:60]!r}", hint)
        return None
    file = str((folder / name).resolve())
    try:
        load_vehicle(file)
    except CoveyError as error:
        report.add(path, str(error))
        return None
    return file


def build_obstacle(section: ObstacleSection, path: KeyPath, report: Report) -> Obstacle | None:
    """Build an obstacle, or note the mistake and return None."""
    from covey.flight.obstacles import Box, Prism, Sphere

    given = [key for key in ("sphere", "box", "prism") if getattr(section, key) is not None]
    if len(given) != 1:
        report.add(path, f"expected exactly one of sphere, box, prism, got {', '.join(given) or 'none'}")
        return None
    shape = section.box or section.prism
    empty = [key for key in ("x_m", "y_m", "z_m") if (side := getattr(shape, key, None)) and side[0] >= side[1]]
    if empty:
        shown = ", ".join(f"{key} [{low:g}, {high:g}]" for key in empty for low, high in [getattr(shape, key)])
        report.add((*path, given[0]), f"expected min < max, got {shown}")
        return None
    try:
        if section.sphere is not None:
            x, y, z = section.sphere.center_m
            return Sphere((x, y, z), section.sphere.radius_m)
        if section.box is not None:
            (x0, x1), (y0, y1), (z0, z1) = section.box.x_m, section.box.y_m, section.box.z_m
            return Box((x0, y0, z0), (x1, y1, z1))
        assert section.prism is not None
        return Prism(tuple((x, y) for x, y in section.prism.corners), *section.prism.z_m)
    except CoveyError as error:
        report.add((*path, given[0]), str(error))
        return None


def _wind(section: WindSection) -> WindSpec:
    x, y, z = (*section.steady_m_s, 0.0)[:3]
    return WindSpec((x, y, z), section.gust_m_s, section.gust_time_s)


def _faults(section: FlightSection, names: Sequence[str], report: Report) -> list[Fault]:
    faults = []
    for i, fault in enumerate(section.faults):
        path: KeyPath = ("flight", "faults", i)
        if (fault.motor is None) == (fault.obstacle is None):
            report.add(path, "expected exactly one of motor, obstacle")
        elif fault.motor is not None:
            if fault.motor.agent in names:
                faults.append(Fault(fault.at_s, names.index(fault.motor.agent), fault.motor.rotor))
                continue
            near = nearest(fault.motor.agent, list(names))
            hint = f"did you mean {near!r}?" if near else ""
            message = f"expected the name of an agent, got {fault.motor.agent[:60]!r}"
            report.add((*path, "motor", "agent"), message, hint)
        elif fault.obstacle is not None:
            obstacle = build_obstacle(fault.obstacle, (*path, "obstacle"), report)
            if obstacle is not None:
                faults.append(Fault(fault.at_s, obstacle=obstacle))
    return faults


def _check_altitude(spec: FlightSpec, report: Report) -> None:
    """Check that vehicles fly higher than what counts as on the ground, and than they need room for."""
    from covey.flight.layout import ON_GROUND
    from covey.flight.parameters import load_vehicle

    vehicle = load_vehicle(spec.vehicle)
    least = max(ON_GROUND, vehicle.keep_off)
    if spec.altitude <= least:
        message = f"expected more than {least:.2f} m for {vehicle.name}, got {spec.altitude:g}"
        report.add(("flight", "altitude_m"), message, "lower vehicles count as on the ground")


def _check_layers(spec: FlightSpec, agents: int, report: Report) -> None:
    from covey.flight.parameters import load_vehicle

    vehicle = load_vehicle(spec.vehicle)
    if spec.altitude > spec.ceiling:
        report.add(("flight", "ceiling_m"), f"expected at least altitude_m, {spec.altitude:g} m, got {spec.ceiling:g}")
        return
    needed = vehicle.required_separation * vehicle.vertical_ratio
    if spec.layer_spacing is not None and spec.layer_spacing < needed:
        report.add(
            ("flight", "layer_spacing_m"),
            f"expected at least {needed:.3g} m between layers of {vehicle.name}, got {spec.layer_spacing:g}",
        )
        return
    highest = max(spec.altitudes(agents), default=spec.altitude)
    if highest > spec.ceiling:
        report.add(
            ("flight", "ceiling_m"),
            f"expected room for {len(set(spec.layer_of(agents)))} layers up to {highest:.4g} m, got {spec.ceiling:g}",
            "leave layers out, raise the ceiling, lower altitude_m or layer_spacing_m, or fly smaller vehicles",
        )
