"""The inner loop: from normalised thrust and body rates to rotor speeds.

Torque is ``J K (omega_cmd - omega) + omega x J omega``.  The rotors' thrusts follow from the inverse of the mixer;
where they do not suffice, torque about roll and pitch goes first, then thrust, then yaw; but roll and pitch leave
enough for the weight, so that a vehicle on the ground can take off however much it is told to turn.

Notes
-----
The thesis leaves this to the autopilot (section 2.1, after (2.2)).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from covey.compiled import kernel
from covey.flight.layout import GRAVITY, OMEGA, ROTORS
from covey.flight.parameters import (
    ALLOCATION,
    INERTIA,
    MASS,
    RATE_GAINS,
    ROTOR_LEAD,
    SPEED_MAX,
    SPEED_MIN,
    THRUST_COEFFICIENT,
)

Array = NDArray[np.float64]

TURN_SHARE = 0.8
"""Share of the thrust that a rotor has beyond hover which roll and pitch may use."""


@kernel
def rotor_commands(state: Array, command: Array, params: Array, out: Array) -> None:
    """Turn a command into rotor speeds.

    Parameters
    ----------
    state : array, shape (STATE,)
        Body rates and rotor speeds are read.
    command : array, shape (COMMAND,)
        Normalised thrust, m/s², and body rates, rad/s.
    params : array, shape (PARAMETERS,)
    out : array, shape (4,)
        rad/s, between the rotors' least and greatest speeds.
    """
    p, q, r = state[OMEGA], state[OMEGA + 1], state[OMEGA + 2]
    jx, jy, jz = params[INERTIA], params[INERTIA + 1], params[INERTIA + 2]
    torque_x = jx * params[RATE_GAINS] * (command[1] - p) + (jz - jy) * q * r
    torque_y = jy * params[RATE_GAINS + 1] * (command[2] - q) + (jx - jz) * r * p
    torque_z = jz * params[RATE_GAINS + 2] * (command[3] - r) + (jy - jx) * p * q
    allocate(params[MASS] * command[0], torque_x, torque_y, torque_z, params, out)
    low, high, lead = params[SPEED_MIN], params[SPEED_MAX], params[ROTOR_LEAD]
    per_thrust = 1.0 / params[THRUST_COEFFICIENT]
    for i in range(4):
        speed = math.sqrt(max(0.0, out[i]) * per_thrust)
        # drive the rotor beyond the speed it shall have, so that it gets there sooner
        speed = state[ROTORS + i] + lead * (speed - state[ROTORS + i])
        out[i] = min(high, max(low, speed))


@kernel
def allocate(force: float, torque_x: float, torque_y: float, torque_z: float, params: Array, thrusts: Array) -> None:
    """Share force and torques among the rotors, within what they can do.

    Parameters
    ----------
    force : float
        N.
    torque_x, torque_y, torque_z : float
        N m, body axes.
    params : array, shape (PARAMETERS,)
    thrusts : array, shape (4,)
        Written: N.
    """
    least = params[THRUST_COEFFICIENT] * params[SPEED_MIN] * params[SPEED_MIN]
    most = params[THRUST_COEFFICIENT] * params[SPEED_MAX] * params[SPEED_MAX]
    room = min(most - least, 2.0 * TURN_SHARE * (most - 0.25 * params[MASS] * GRAVITY))
    low = high = 0.0
    suffices = True
    for i in range(4):
        row = ALLOCATION + 4 * i
        turn = params[row + 1] * torque_x + params[row + 2] * torque_y
        low, high = min(low, turn), max(high, turn)
        thrusts[i] = params[row] * force + turn + params[row + 3] * torque_z
        suffices = suffices and least <= thrusts[i] <= most
    if not suffices or high - low > room:
        share_out(force, torque_x, torque_y, torque_z, params, least, most, min(1.0, room / (high - low)), thrusts)


@kernel
def share_out(
    force: float,
    torque_x: float,
    torque_y: float,
    torque_z: float,
    params: Array,
    least: float,
    most: float,
    scale: float,
    thrusts: Array,
) -> None:
    """Scale roll and pitch by `scale`, then fit force, then yaw, between the least and greatest thrusts."""
    force_low, force_high = -math.inf, math.inf
    for i in range(4):
        row = ALLOCATION + 4 * i
        thrusts[i] = scale * (params[row + 1] * torque_x + params[row + 2] * torque_y)
        force_low = max(force_low, (least - thrusts[i]) / params[row])
        force_high = min(force_high, (most - thrusts[i]) / params[row])
    force = min(force_high, max(force_low, force))
    yaw = 1.0
    for i in range(4):
        row = ALLOCATION + 4 * i
        thrusts[i] += params[row] * force
        turn = params[row + 3] * torque_z
        if turn > 0.0:
            yaw = min(yaw, (most - thrusts[i]) / turn)
        elif turn < 0.0:
            yaw = min(yaw, (least - thrusts[i]) / turn)
    yaw = max(0.0, yaw)
    for i in range(4):
        thrusts[i] += yaw * params[ALLOCATION + 4 * i + 3] * torque_z
