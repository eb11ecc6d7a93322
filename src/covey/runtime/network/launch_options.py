"""How a team is launched, and what there is to say about it afterwards."""

from __future__ import annotations

import dataclasses
import json
import signal
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from covey.runtime.network.child import Exit
from covey.runtime.network.network_file import NetworkPlan


@dataclass(frozen=True)
class Blow:
    """A signal that an agent's process gets.

    Parameters
    ----------
    agent : int
    after : float
        Seconds after every agent was there.
    number : int
        Which signal; by default it is killed.
    """

    agent: int
    after: float
    number: int = signal.SIGKILL


@dataclass(frozen=True)
class LaunchOptions:
    """How a team is launched.

    Parameters
    ----------
    network : NetworkPlan
        Its credentials and times go to every agent; it has no endpoints of its own.
    network_file : Path or None
        Where `network` comes from.
    state : Path or None
        Where the agents keep what a restart begins with; a temporary directory by default.
    vehicles : str
        As for `covey agent`.
    restart : bool
        Whether a process that died is started again.
    blows : tuple of Blow
    patience : float
        How long agents wait for each other at the start, seconds.
    timeout : float
        Seconds after which the launch ends, over or not.
    """

    network: NetworkPlan = dataclasses.field(default_factory=NetworkPlan)
    network_file: Path | None = None
    state: Path | None = None
    vehicles: str = "none"
    restart: bool = False
    blows: tuple[Blow, ...] = ()
    patience: float = 60.0
    timeout: float = float("inf")


@dataclass(frozen=True)
class LaunchReport:
    """What happened beside the mission.

    Parameters
    ----------
    settled : bool
        Whether the mission was over.
    exits : tuple of Exit
        Every process that ended, in order.
    agents : tuple of dict
        The reports of those that left by themselves: `covey.runtime.network.agent_process.AgentReport`.
    dropped : dict of str to int
        Arrivals that the observer dropped, by cause.
    refused : dict of str to int
        Connections that the agents did not let in, by what was wrong with the certificate.
    longest_unowned : float
        No landmark was without a living owner for longer, seconds.
    start_s, settle_s : float or None
        Seconds from the launch until all agents were heard, and from then until the mission was over; None if they
        never were.
    """

    settled: bool
    exits: tuple[Exit, ...]
    agents: tuple[dict[str, Any], ...]
    dropped: dict[str, int]
    refused: dict[str, int]
    longest_unowned: float
    start_s: float | None
    settle_s: float | None

    @property
    def died(self) -> tuple[Exit, ...]:
        """The processes that ended otherwise than at the launch's own wish."""
        return tuple(one for one in self.exits if not one.wanted)

    @property
    def strangers(self) -> dict[str, int]:
        """What all of the team dropped together, by cause, but what was merely overtaken by news."""
        total: dict[str, int] = dict(self.dropped)
        for agent in self.agents:
            for cause, count in agent["dropped"].items():
                total[cause] = total.get(cause, 0) + count
        return {cause: count for cause, count in sorted(total.items()) if cause != "outdated"}

    def to_json(self) -> str:
        """Return it as JSON."""
        content = dataclasses.asdict(self) | {"strangers": self.strangers}
        return json.dumps(content, indent=2) + "\n"
