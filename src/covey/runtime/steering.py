"""What somebody who watches a run may ask of it, and the mailbox through which the run hears of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias


@dataclass(frozen=True, slots=True)
class Pause:
    """Let nothing more happen until `Resume`."""


@dataclass(frozen=True, slots=True)
class Resume:
    """Go on."""


@dataclass(frozen=True, slots=True)
class Step:
    """Let the next thing happen that can be seen, then pause: of a plan the next change or offer, of a flight 0.1 s."""


@dataclass(frozen=True, slots=True)
class SetSpeed:
    """Go as fast as this.

    Parameters
    ----------
    speed : float
        Of a plan: changes and offers a second; of a flight: simulated seconds a second.  0: as fast as possible.
    """

    speed: float


@dataclass(frozen=True, slots=True)
class Kill:
    """Let an agent fail: its process ends, or its motors stop."""

    agent: int


@dataclass(frozen=True, slots=True)
class Revive:
    """Let a killed agent come back."""

    agent: int


@dataclass(frozen=True, slots=True)
class SetWeight:
    """Let a landmark be worth something else."""

    landmark: int
    weight: float


@dataclass(frozen=True, slots=True)
class AddObstacle:
    """Put a cylinder on the ground in the way.

    Parameters
    ----------
    x, y : float
        Its centre in frame W, metres.
    radius, height : float
        Metres.
    """

    x: float
    y: float
    radius: float
    height: float


@dataclass(frozen=True, slots=True)
class SetLoss:
    """Lose this share of the messages, from 0 to 1."""

    loss: float


Command: TypeAlias = Pause | Resume | Step | SetSpeed | Kill | Revive | SetWeight | AddObstacle | SetLoss
"""Anything that may be asked of a run."""

COMMANDS: Mapping[str, type[Command]] = {
    "pause": Pause,
    "resume": Resume,
    "step": Step,
    "speed": SetSpeed,
    "kill": Kill,
    "revive": Revive,
    "weight": SetWeight,
    "obstacle": AddObstacle,
    "loss": SetLoss,
}
"""The commands by their names."""
