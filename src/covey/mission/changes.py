"""What an operator changes while a mission runs: the specification, and how its agents travel as text."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from covey.environment import Landmarks
from covey.errors import InputError

if TYPE_CHECKING:
    from covey.mission.model import AgentSpec, Mission

MAX_TEXT = 65_536
"""Longest description of an agent that travels, characters."""


@dataclass(frozen=True)
class ChangeSpec:
    """One change of a running mission; landmarks that are added, and agents that join, get the next free numbers.

    Parameters
    ----------
    add : Landmarks or None
        Landmarks to be seen from then on.
    remove : tuple of int
        Landmarks to be seen no more.
    reweight : mapping of int to float
        Landmarks and what they are worth from then on.
    join : mapping or None
        An agent that takes part from then on, as a mission file describes one.
    leave : str or None
        The agent that takes part no more.
    after_trades : int or None
        When so many trades have been made.
    at : float or None
        When the team has been at work for so many seconds.

    Notes
    -----
    Changes are made in order; one that says neither when comes when the team has settled, and so does one whose moment
    has not come by then.
    """

    add: Landmarks | None = None
    remove: tuple[int, ...] = ()
    reweight: Mapping[int, float] = field(default_factory=dict)
    join: Mapping[str, Any] | None = None
    leave: str | None = None
    after_trades: int | None = None
    at: float | None = None


def agent_text(agent: Mapping[str, Any]) -> str:
    """Return an agent of a mission file as the text that travels."""
    return json.dumps(dict(agent), sort_keys=True)


def read_agent(mission: Mission, index: int, text: str) -> AgentSpec:
    """Build the agent with this number from the text that came; what it leaves out is the mission's.

    Raises
    ------
    InputError
        If the text describes no agent of this mission.
    """
    from pydantic import ValidationError

    from covey.mission.build import build_agent
    from covey.mission.document import parse
    from covey.mission.report import Report
    from covey.mission.schema import AgentSection

    source = f"agent {index}"
    if len(text) > MAX_TEXT:
        raise InputError(f"{source}: expected at most {MAX_TEXT} characters, got {len(text)}")
    report = Report(source, parse(text, "json", source))
    try:
        section = AgentSection.model_validate_json(text)
    except ValidationError as error:
        report.add_pydantic(error.errors(include_url=False))
        raise InputError("; ".join(map(str, report.mistakes))) from error
    agent = build_agent(mission, index, section, report)
    if agent is None:
        raise InputError("; ".join(map(str, report.mistakes)))
    return agent
