"""Which vehicles are where they should be, and which have tipped over."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from covey.compiled import kernel
from covey.flight.layout import QUAT, P, V
from covey.flight.rotation import tilt_of, yaw_of

Array = NDArray[np.float64]

TUMBLING = math.radians(100.0)
"""Tilt beyond which a vehicle is not flying any more, rad."""


@kernel
def arrived(states: Array, goals: Array, position: float, yaw: float, speed: float, out: NDArray[np.bool_]) -> None:
    """Tell which vehicles are at their goals.

    Parameters
    ----------
    states : array, shape (n, OBSERVATION or more)
    goals : array, shape (n, 4)
        Position, metres, and yaw, rad, frame W; NaN for a vehicle without one, which is then nowhere.
    position, yaw, speed : float
        Largest distance, error of yaw and speed, metres, rad, m/s.
    out : array of bool, shape (n,)
        Written.
    """
    for i in range(states.shape[0]):
        x = states[i, P] - goals[i, 0]
        y = states[i, P + 1] - goals[i, 1]
        z = states[i, P + 2] - goals[i, 2]
        u, v, w = states[i, V], states[i, V + 1], states[i, V + 2]
        turn = yaw_of(states[i, QUAT:]) - goals[i, 3]
        turn = abs(math.atan2(math.sin(turn), math.cos(turn)))
        near = x * x + y * y + z * z <= position * position
        out[i] = near and turn <= yaw and u * u + v * v + w * w <= speed * speed


@kernel
def tumbling(states: Array, out: NDArray[np.bool_]) -> None:
    """Tell which vehicles, rows of states, are tilted by more than `TUMBLING`: written to `out`, shape (n,)."""
    for i in range(states.shape[0]):
        out[i] = tilt_of(states[i, QUAT:]) > TUMBLING
