"""The wash of a vehicle's rotors on those below it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from covey.compiled import kernel
from covey.flight.layout import GRAVITY
from covey.flight.parameters import VehicleParameters

AIR_DENSITY = 1.225
"""kg/m³ at sea level, 15 °C."""

SPREAD = 0.113
"""Growth of the width of a round turbulent jet with distance; its half-width grows by 0.094 (Pope 2000, table 5.1)."""

STALL = 4.0
"""A rotor blown at from above along its axis by this many times its induced velocity in hover gives no thrust."""


def wash_rows(vehicles: Sequence[VehicleParameters]) -> NDArray[np.float64]:
    """Pack what `downwash` needs to know of each vehicle.

    Returns
    -------
    array, shape (n, 3)
        Width of the wake at the rotors (m), square of the wake's speed per newton of thrust (m²/s²/N), axial airspeed
        at which the rotors give nothing (m/s).
    """
    rows = np.empty((len(vehicles), 3))
    for row, vehicle in zip(rows, vehicles, strict=True):
        arm = float(np.max(np.hypot(*vehicle.rotor_positions_B.T)))
        disc_area = 4.0 * math.pi * (vehicle.body_radius - arm) ** 2
        induced_in_hover = math.sqrt(vehicle.mass * GRAVITY / (2.0 * AIR_DENSITY * disc_area))
        row[:] = math.sqrt(disc_area / math.pi), 2.0 / (AIR_DENSITY * disc_area), STALL * induced_in_hover
    return rows


@kernel
def downwash(
    p_W: NDArray[np.float64], thrusts: NDArray[np.float64], wash: NDArray[np.float64], speeds: NDArray[np.float64]
) -> None:
    """Speed of the air that the vehicles above blow down on each vehicle.

    A vehicle with thrust T over the disc area A of its rotors blows air down at ``2 v`` where ``v = sqrt(T / (2 ρ A))``
    is its induced velocity. Further below, the wake is a round turbulent jet that keeps its momentum: at depth z below
    the rotors and distance r from their axis

    .. code-block:: none

        w(r, z) = 2 v (b0 / b) exp(-r² / b²),   b = b0 + 0.113 z,   b0 = sqrt(A / π)

    whose momentum flux ``ρ ∫ w² dA`` is T at every depth. Wakes go straight down and add up. They set in over the
    first b0 of depth, so that the force is continuous when vehicles pass each other.

    Parameters
    ----------
    p_W : array, shape (n, 3 or more)
        Positions in the first columns, frame W, metres.
    thrusts : array, shape (n,)
        N.
    wash : array, shape (n, 3)
        From `wash_rows`.
    speeds : array, shape (n,)
        Written: m/s, positive downwards.

    Notes
    -----
    Source: momentum theory of the hovering rotor (Leishman 2006, section 2.2); round turbulent jets (Pope 2000,
    section 5.1), as Bauersfeld et al. (2024), Robotics meets fluid dynamics, measured them below quadrotors.
    """
    n = p_W.shape[0]
    for i in range(n):
        total = 0.0
        for j in range(n):
            depth = p_W[j, 2] - p_W[i, 2]
            if j == i or depth <= 0.0 or thrusts[j] <= 0.0:
                continue
            b0 = wash[j, 0]
            b = b0 + SPREAD * depth
            x = p_W[j, 0] - p_W[i, 0]
            y = p_W[j, 1] - p_W[i, 1]
            off_axis = (x * x + y * y) / (b * b)
            if off_axis < 30.0:
                onset = min(1.0, depth / b0)
                total += onset * math.sqrt(wash[j, 1] * thrusts[j]) * b0 / b * math.exp(-off_axis)
        speeds[i] = total


__all__ = ["AIR_DENSITY", "SPREAD", "STALL", "downwash", "wash_rows"]
