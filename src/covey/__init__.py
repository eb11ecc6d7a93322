"""covey: where each camera of a team should be and which landmarks it should watch, with a proof of how good that is.

Examples
--------
>>> import covey
>>> mission = covey.parse_mission('''
... schema_version: 1
... name: two cameras
... environment:
...   landmarks: {grid: {x_m: [-2, 2], y_m: [-2, 2], spacing_m: 1}}
...   region: {box: {x_m: [-2, 2], y_m: [-2, 2]}}
... agents:
...   - {name: left, pose: {x_m: -1, y_m: 0, yaw_deg: 0}}
...   - {name: right, pose: {x_m: 1, y_m: 0, yaw_deg: 0}}
... ''')
>>> len(mission.landmarks)
16
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from covey.coverage.certificate import Certificate, TeamBound, Violation
    from covey.environment import GeoReference, Landmarks
    from covey.errors import (
        ArgumentError,
        CoveyError,
        InputError,
        MissionError,
        Mistake,
        OutputError,
        RecordError,
        ResultError,
        SolverError,
    )
    from covey.geometry import Pose2, Region
    from covey.mission import Mission, load_mission, mission_schema, parse_mission
    from covey.optimize.base import PoseProblem, PoseResult
    from covey.runtime.certify import certify
    from covey.runtime.flight import Flight
    from covey.runtime.fly import fly
    from covey.runtime.plan import plan
    from covey.runtime.records.record import read_result
    from covey.runtime.result import Deployment, Progress
    from covey.sensing.base import VisibilityModel
    from covey.vehicles.flight_log import FlightLog

__version__ = "0.1.0"

_HOMES = {
    "ArgumentError": "covey.errors",
    "Certificate": "covey.coverage.certificate",
    "CoveyError": "covey.errors",
    "Deployment": "covey.runtime.result",
    "Flight": "covey.runtime.flight",
    "FlightLog": "covey.vehicles.flight_log",
    "GeoReference": "covey.environment",
    "InputError": "covey.errors",
    "Landmarks": "covey.environment",
    "Mission": "covey.mission",
    "MissionError": "covey.errors",
    "Mistake": "covey.errors",
    "OutputError": "covey.errors",
    "Pose2": "covey.geometry",
    "PoseProblem": "covey.optimize.base",
    "PoseResult": "covey.optimize.base",
    "Progress": "covey.runtime.result",
    "RecordError": "covey.errors",
    "Region": "covey.geometry",
    "ResultError": "covey.errors",
    "SolverError": "covey.errors",
    "TeamBound": "covey.coverage.certificate",
    "Violation": "covey.coverage.certificate",
    "VisibilityModel": "covey.sensing.base",
    "certify": "covey.runtime.certify",
    "fly": "covey.runtime.fly",
    "load_mission": "covey.mission",
    "mission_schema": "covey.mission",
    "parse_mission": "covey.mission",
    "plan": "covey.runtime.plan",
    "read_result": "covey.runtime.records.record",
}
"""Where each public name lives; it is imported when it is first used."""

__all__ = [
    "ArgumentError",
    "Certificate",
    "CoveyError",
    "Deployment",
    "Flight",
    "FlightLog",
    "GeoReference",
    "InputError",
    "Landmarks",
    "Mission",
    "MissionError",
    "Mistake",
    "OutputError",
    "Pose2",
    "PoseProblem",
    "PoseResult",
    "Progress",
    "RecordError",
    "Region",
    "ResultError",
    "SolverError",
    "TeamBound",
    "Violation",
    "VisibilityModel",
    "certify",
    "fly",
    "load_mission",
    "mission_schema",
    "parse_mission",
    "plan",
    "read_result",
]


def __getattr__(name: str) -> Any:
    home = _HOMES.get(name)
    if home is None:
        raise AttributeError(f"module 'covey' has no attribute {name!r}")
    value = getattr(importlib.import_module(home), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
