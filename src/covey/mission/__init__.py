"""Mission files: what is to be seen, by whom, from where."""

from covey.mission.digest import mission_digest
from covey.mission.load import load_mission, mission_schema, parse_mission
from covey.mission.model import (
    AgentSpec,
    Assignment,
    CommunicationSpec,
    CoverageSpec,
    Mission,
    OptimizerName,
    SensorSpec,
    Trade,
)

__all__ = [
    "AgentSpec",
    "Assignment",
    "CommunicationSpec",
    "CoverageSpec",
    "Mission",
    "OptimizerName",
    "SensorSpec",
    "Trade",
    "load_mission",
    "mission_digest",
    "mission_schema",
    "parse_mission",
]
