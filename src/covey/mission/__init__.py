"""Mission files: what is to be seen, by whom, from where."""

from covey.mission.changes import ChangeSpec, agent_text, read_agent
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
    "ChangeSpec",
    "CommunicationSpec",
    "CoverageSpec",
    "Mission",
    "OptimizerName",
    "SensorSpec",
    "Trade",
    "agent_text",
    "load_mission",
    "mission_digest",
    "mission_schema",
    "parse_mission",
    "read_agent",
]
