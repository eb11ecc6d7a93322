"""What happens around each of MuJoCo's steps: rate loop, rotors, drag and downwash of all vehicles; contacts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from covey.compiled import kernel
from covey.flight.dynamics import kept, lag
from covey.flight.layout import OMEGA, QUAT, ROTORS, V
from covey.flight.parameters import BODY_DRAG, ROTOR_DRAG, TAU_DOWN, TAU_UP, THRUST_COEFFICIENT
from covey.flight.rate_loop import rotor_commands
from covey.simulators.downwash import downwash

Array = NDArray[np.float64]

FASTEST = 1e4
"""What moves faster than this, m/s or rad/s, or is farther away than 1000 times as many metres, has diverged."""

STRONGEST = 1e9
"""Thrust beyond which MuJoCo would refuse to go on, N."""


@kernel
def read(qpos: Array, qvel: Array, state: Array) -> int:
    """Copy MuJoCo's positions and velocities into states.

    Parameters
    ----------
    qpos : array, shape (n, 7)
    qvel : array, shape (n, 6)
    state : array, shape (n, STATE)
        Written, but for the rotors.

    Returns
    -------
    vehicle : int
        The first that has diverged, or -1.
    """
    diverged = -1
    for i in range(state.shape[0]):
        sane = True
        for k in range(3):
            state[i, k] = qpos[i, k]
            state[i, V + k] = qvel[i, k]
            state[i, OMEGA + k] = qvel[i, 3 + k]
            # written so that NaN is not sane
            sane = sane and abs(qpos[i, k]) < 1e3 * FASTEST and abs(qvel[i, k]) < FASTEST
            sane = sane and abs(qvel[i, 3 + k]) < FASTEST
        for k in range(4):
            state[i, QUAT + k] = qpos[i, 3 + k]
            sane = sane and abs(qpos[i, 3 + k]) < 2.0
        if not sane and diverged < 0:
            diverged = i
    return diverged


@kernel
def drive(
    qpos: Array,
    qvel: Array,
    state: Array,
    commands: Array,
    params: Array,
    working: Array,
    wash: Array,
    air_W: Array,
    aero: bool,
    dt: float,
    ctrl: Array,
    force_W: Array,
    work: Array,
) -> int:
    """Prepare one physics step.

    Parameters
    ----------
    qpos, qvel, state : arrays
        As in `read`; the rotors of `state` are advanced by dt.
    commands : array, shape (n, COMMAND)
    params : array, shape (n, PARAMETERS)
    working : array, shape (n, 4)
        1 for a rotor that turns, 0 for one that has failed.
    wash : array, shape (n, 3)
        From `covey.simulators.downwash.wash_rows`.
    air_W : array, shape (n, 3)
        Velocity of the wind, m/s.
    aero : bool
        Whether there are drag and downwash.
    dt : float
        s.
    ctrl : array, shape (n, 4)
        Written: thrust of each rotor, N, the mean over the step.
    force_W : array, shape (n, 6)
        Written in columns 0:3, if aero: drag and downwash, frame W, N.
    work : array, shape (4, n) with n >= 4
        Overwritten.

    Returns
    -------
    vehicle : int
        As from `read`.
    """
    n = state.shape[0]
    diverged = read(qpos, qvel, state)
    if diverged >= 0:
        return diverged
    speeds, thrusts, turning, down = work[0], work[1], work[2], work[3]
    for i in range(n):
        rotor_commands(state[i], commands[i], params[i], speeds)
        keep_up, keep_down = kept(0.5 * dt, params[i, TAU_UP]), kept(0.5 * dt, params[i, TAU_DOWN])
        thrusts[i] = turning[i] = 0.0
        for k in range(4):
            begin, command = state[i, ROTORS + k] * working[i, k], speeds[k] * working[i, k]
            middle = lag(begin, command, keep_up, keep_down)
            end = lag(middle, command, keep_up, keep_down)
            # Simpson's rule, as in Runge-Kutta of order 4
            ctrl[i, k] = params[i, THRUST_COEFFICIENT] * (begin * begin + 4.0 * middle * middle + end * end) / 6.0
            state[i, ROTORS + k] = end
            thrusts[i] += ctrl[i, k]
            turning[i] += middle
        if not thrusts[i] < STRONGEST:
            return i
    if not aero:
        return -1
    downwash(state, thrusts, wash, down)
    for i in range(n):
        across = params[i, ROTOR_DRAG] * turning[i]
        qw, qx, qy, qz = state[i, QUAT], state[i, QUAT + 1], state[i, QUAT + 2], state[i, QUAT + 3]
        # l, m, n: the body's axes in W
        lx, ly, lz = 1.0 - 2.0 * (qy * qy + qz * qz), 2.0 * (qx * qy + qw * qz), 2.0 * (qx * qz - qw * qy)
        mx, my, mz = 2.0 * (qx * qy - qw * qz), 1.0 - 2.0 * (qx * qx + qz * qz), 2.0 * (qy * qz + qw * qx)
        nx, ny, nz = 2.0 * (qx * qz + qw * qy), 2.0 * (qy * qz - qw * qx), 1.0 - 2.0 * (qx * qx + qy * qy)
        rx, ry = state[i, V] - air_W[i, 0], state[i, V + 1] - air_W[i, 1]
        rz = state[i, V + 2] - air_W[i, 2] + down[i]
        along_l = (across + params[i, BODY_DRAG]) * (lx * rx + ly * ry + lz * rz)
        along_m = (across + params[i, BODY_DRAG + 1]) * (mx * rx + my * ry + mz * rz)
        along_n = params[i, BODY_DRAG + 2] * (nx * rx + ny * ry + nz * rz)
        # rotors blown at from above give less thrust
        along_n += thrusts[i] * min(1.0, max(0.0, down[i] * nz) / wash[i, 2])
        force_W[i, 0] = -(along_l * lx + along_m * mx + along_n * nx)
        force_W[i, 1] = -(along_l * ly + along_m * my + along_n * ny)
        force_W[i, 2] = -(along_l * lz + along_m * mz + along_n * nz)
    return -1


@kernel
def touch(
    pairs: NDArray[np.int32],
    owner: NDArray[np.int32],
    now: float,
    apart: float,
    last: Array,
    grounded: NDArray[np.bool_],
    began: NDArray[np.int64],
) -> int:
    """Tell which contacts have begun.

    Parameters
    ----------
    pairs : array, shape (k, 2)
        Geometry in contact.
    owner : array, shape (number of geoms,)
        -1 for the ground, vehicle i, or n + k for obstacle k.
    now : float
        s.
    apart : float
        Seconds after which a contact counts as a new one.
    last : array, shape (n, n + number of obstacles)
        When vehicle i last touched what, s; updated.
    grounded : array, shape (n,)
        Written.
    began : array, shape (m, 2)
        Written, as far as it goes: owners, the vehicle or the lower vehicle first.

    Returns
    -------
    count : int
        Number of rows written.
    """
    n = last.shape[0]
    count = 0
    for i in range(n):
        grounded[i] = False
    for row in range(pairs.shape[0]):
        a, b = owner[pairs[row, 0]], owner[pairs[row, 1]]
        low, high = min(a, b), max(a, b)
        if low < 0:
            grounded[high] = True
            continue
        if now - last[low, high] > apart and count < began.shape[0]:
            began[count, 0], began[count, 1] = low, high
            count += 1
        last[low, high] = now
    return count


__all__ = ["drive", "read", "touch"]
