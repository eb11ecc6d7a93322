"""What pushes a vehicle that its controller does not know: estimated, and leant against."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from covey.flight.layout import REF_A, REF_P, REF_V, P, V
from covey.flight.parameters import VehicleParameters

RATE = 1.5
"""How fast the estimate follows, 1/s²."""

NEAR = 0.3
"""Distance from its reference, metres, up to which a vehicle's errors are put down to a disturbance."""

LARGEST = 3.0
"""Largest acceleration that is believed of a disturbance in each direction, m/s²."""


class DisturbanceEstimate:
    """Estimates the unknown acceleration d of each vehicle, frame W, m/s²; shape (n, 3) in `values`.

    Parameters
    ----------
    vehicles : sequence of VehicleParameters

    Notes
    -----
    Backstepping with an unknown constant d in the second equation of (2.3) and the estimate put into u as ``-d_hat``:
    ``V2 + beta / (2 rate) ||d - d_hat||²`` falls along ``d_hat' = rate (e_v + k1 e_p)``, so that a steady wind leaves
    no error of position.  It learns little far from the reference, stops at `LARGEST`, and is forgotten on the ground.
    """

    def __init__(self, vehicles: list[VehicleParameters] | tuple[VehicleParameters, ...]) -> None:
        self.values: NDArray[np.float64] = np.zeros((len(vehicles), 3))
        self._k1 = np.array([[vehicle.gains.k1] for vehicle in vehicles])

    def update(
        self,
        observations: NDArray[np.float64],
        references: NDArray[np.float64],
        flying: NDArray[np.bool_],
        dt: float,
    ) -> None:
        """Take in what is observed, shape (n, OBSERVATION), of the vehicles that fly; forget the others'."""
        error = observations[:, P : P + 3] - references[:, REF_P : REF_P + 3]
        slip = observations[:, V : V + 3] - references[:, REF_V : REF_V + 3]
        # a vehicle far off is on its way back to its reference, which tells little about the wind
        trust = 1.0 / (1.0 + (np.linalg.norm(error, axis=1, keepdims=True) / NEAR) ** 4)
        self.values += RATE * dt * trust * (slip + self._k1 * error)
        np.clip(self.values, -LARGEST, LARGEST, out=self.values)
        self.values[~flying] = 0.0

    def compensate(self, references: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return references, shape (n, REFERENCE), whose acceleration leans against the estimate."""
        leaning = references.copy()
        leaning[:, REF_A : REF_A + 3] -= self.values
        return leaning
