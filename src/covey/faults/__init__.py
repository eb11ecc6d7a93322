"""Simulated misfortune for real nodes: networks that fail, agents that die, and what must hold all the same."""

from covey.faults.campaign import Finding, Report, campaign, protocol_named, shrink
from covey.faults.checks import Checker, Violation
from covey.faults.explore import MORE_SIZES, SIZES, Exploration, explore
from covey.faults.mutants import MUTANTS
from covey.faults.scenario import Alteration, Crash, Cut, Isolation, Kind, Mode, Scenario, draw, simpler
from covey.faults.simulator import Outcome, run
from covey.faults.trace import describe

__all__ = [
    "MORE_SIZES",
    "MUTANTS",
    "SIZES",
    "Alteration",
    "Checker",
    "Crash",
    "Cut",
    "Exploration",
    "Finding",
    "Isolation",
    "Kind",
    "Mode",
    "Outcome",
    "Report",
    "Scenario",
    "Violation",
    "campaign",
    "describe",
    "draw",
    "explore",
    "protocol_named",
    "run",
    "shrink",
    "simpler",
]
