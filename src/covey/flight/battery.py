"""What is left of batteries, by what the rotors have done so far."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from covey.compiled import kernel
from covey.flight.layout import ROTORS, STATE
from covey.flight.parameters import VehicleParameters

Array = NDArray[np.float64]


class Batteries:
    """The batteries of n vehicles, full at first; nothing happens when one is empty.

    Parameters
    ----------
    vehicles : sequence of VehicleParameters

    Attributes
    ----------
    shares : array, shape (n,)
        What is left of each, from 0 to 1; NaN for a vehicle whose endurance is unknown.

    Notes
    -----
    By momentum theory the power that a rotor in hover puts into the air rises with its thrust to the 1.5, so with the
    cube of its speed.  All other power (drag of the blades, electronics, what a climb or the wind changes) is taken for
    proportional to that.  So a vehicle with the same thrust on all rotors loses (T / m g)^1.5 dt / endurance.

    Examples
    --------
    >>> from covey.flight.parameters import load_vehicle
    >>> iris = load_vehicle("iris")
    >>> batteries = Batteries([iris])
    >>> hovering = np.full((1, STATE), iris.hover_speed)
    >>> batteries.drain(hovering, 0.25 * iris.endurance)
    >>> print(f"{batteries.shares[0]:.4f}")
    0.7500
    """

    def __init__(self, vehicles: Sequence[VehicleParameters]) -> None:
        self._hover_speeds = np.array([vehicle.hover_speed for vehicle in vehicles])
        self._endurances = np.array([vehicle.endurance for vehicle in vehicles])
        self.shares: Array = np.where(np.isnan(self._endurances), np.nan, 1.0)

    def drain(self, states: Array, duration: float) -> None:
        """Take away what rotors at the speeds of `states`, shape (n, STATE), use in so many seconds."""
        _drain(states, self._hover_speeds, duration / self._endurances, self.shares)


@kernel
def _drain(states: Array, hover_speeds: Array, spent: Array, shares: Array) -> None:
    """Take `spent`, what hovering takes, times each vehicle's power over that in hover, from the shares."""
    for i in range(states.shape[0]):
        power = 0.0
        for k in range(ROTORS, STATE):
            ratio = states[i, k] / hover_speeds[i]
            power += 0.25 * ratio * ratio * ratio
        left = shares[i] - spent[i] * power
        shares[i] = 0.0 if left < 0.0 else left  # NaN stays
