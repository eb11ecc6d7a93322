"""The ``flight`` object of ``result.json``: how a mission was flown, as plain data and back."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from covey.runtime.records.checked import CheckedValue
from covey.runtime.result import FlightReport
from covey.vehicles.flight_log import FlightEvent


def flight_document(flight: FlightReport) -> dict[str, Any]:
    """Return a flight report as plain data; keys carry their unit, what is not finite is null."""
    return {
        "simulator": flight.simulator,
        "vehicle": flight.vehicle,
        "duration_s": _number(flight.duration),
        "wall_s": _number(flight.wall),
        "real_time_factor": _number(flight.real_time_factor),
        "min_separation_m": _number(flight.min_separation),
        "required_separation_m": _number(flight.required_separation),
        "separation_cost": _number(flight.separation_cost),
        "altitudes_m": [float(altitude) for altitude in flight.altitudes],
        "max_outside_region_m": _number(flight.max_outside_region),
        "collisions": int(flight.collisions),
        "tracking_rms_m": _number(flight.tracking_rms),
        "waypoints_reached": int(flight.waypoints_reached),
        "waypoints_missed": int(flight.waypoints_missed),
        "score_flown": _number(flight.score_flown),
        "lost": list(flight.lost),
        "events": events_document(flight.events),
    }


def events_document(events: Sequence[FlightEvent]) -> list[dict[str, Any]]:
    """Return the events of a flight as plain data; vehicles go by the names of their agents."""
    return [
        {"time_s": _number(event.time), "event": event.kind, "agents": list(event.vehicles), "text": event.text}
        for event in events
    ]


def read_flight(value: CheckedValue) -> FlightReport:
    """Read a flight report back.

    Raises
    ------
    ResultError
        If a key is missing or has the wrong type.
    """
    return FlightReport(
        simulator=value["simulator"].text(),
        vehicle=value["vehicle"].text(),
        duration=value["duration_s"].number(),
        wall=value["wall_s"].number(),
        min_separation=value["min_separation_m"].known(math.inf),
        required_separation=value["required_separation_m"].number(),
        separation_cost=value["separation_cost"].known(math.nan),
        altitudes=tuple(item.number() for item in value["altitudes_m"].items()),
        max_outside_region=value["max_outside_region_m"].number(),
        collisions=value["collisions"].integer(),
        tracking_rms=value["tracking_rms_m"].number(),
        waypoints_reached=value["waypoints_reached"].integer(),
        waypoints_missed=value["waypoints_missed"].integer(),
        score_flown=value["score_flown"].known(math.nan),
        lost=tuple(item.text() for item in value["lost"].items()),
        events=tuple(
            FlightEvent(
                event["time_s"].number(),
                event["event"].text(),
                tuple(item.text() for item in event["agents"].items()),
                event["text"].text(),
            )
            for event in value["events"].items()
        ),
    )


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
