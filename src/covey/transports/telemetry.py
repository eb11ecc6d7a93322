"""What an agent tells of its vehicle, for people to see; no agent listens to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from covey.protocol import Sender


@dataclass(frozen=True, eq=False, slots=True)
class Telemetry:
    """Where the vehicle of an agent is; the newest wins.

    Parameters
    ----------
    sender : Sender
    state : array, shape (13,)
        True position and velocity (frame W), attitude, and body rates (frame B): the columns of an observation in
        `covey.flight.layout`.
    battery : float
        Share that is left, from 0 to 1; NaN where unknown.
    """

    sender: Sender
    state: NDArray[np.float64]
    battery: float


__all__ = ["Telemetry"]
