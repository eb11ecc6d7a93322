"""The parts of a flight that a vehicle is on."""

from __future__ import annotations

import enum

BELOW_GROUND = 0.3
"""To land, a vehicle is led to so far below the ground, metres: it touches down at about as many m/s."""

AT_REST = 0.5
"""After the last motors have stopped, vehicles are given so many seconds to come to rest."""


class Leg(enum.Enum):
    """What a vehicle is on its way to: kinds of the events when it gets there or does not, and both in words."""

    TAKE_OFF = ("airborne", "grounded", "is at its altitude", "cannot rise to its altitude")
    WAYPOINT = ("reached", "missed", "reached its waypoint", "cannot reach its waypoint and holds where it is")
    HOME = ("home", "astray", "is back above its start", "cannot get back above its start and lands where it is")
    LANDING = ("landed", "aloft", "landed", "cannot land")

    def __init__(self, reached: str, missed: str, arrival: str, failure: str) -> None:
        self.reached, self.missed, self.arrival, self.failure = reached, missed, arrival, failure
