"""How a quadrotor moves: rigid body, rotors that follow their commands with a lag, drag, gravity.

Rotor i at (x_i, y_i) with speed w_i pushes with ``c w_i^2`` along the body's z axis and resists with
``moment_ratio`` times that.  Across its axis it drags with ``rotor_drag w_i`` times the airspeed, the body with
``body_drag`` along each of its axes.

Notes
-----
Source: Sposato (2016), eq. (2.1), (2.2).  Deviation: C4, C5.  The thesis has neither torques nor rotors nor drag.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from covey.compiled import kernel
from covey.flight.layout import GRAVITY, OMEGA, QUAT, ROTORS, P, V
from covey.flight.parameters import (
    BODY_DRAG,
    INERTIA,
    MASS,
    MOMENT_RATIO,
    ROTOR_DRAG,
    ROTOR_XY,
    SPINS,
    THRUST_COEFFICIENT,
)
from covey.flight.rotation import normalise

Array = NDArray[np.float64]

WRENCH = 5
"""Columns of a wrench: thrust (N), torques about the body axes (N m), rotor drag over airspeed (N s/m)."""


@kernel
def wrench(rotors: Array, params: Array, out: Array) -> None:
    """Compute what four rotors do to the body.

    Parameters
    ----------
    rotors : array, shape (4,)
        Speeds, rad/s.
    params : array, shape (PARAMETERS,)
    out : array, shape (WRENCH,)
        Thrust (N), torques about the body axes (N m), drag force over airspeed (N s/m).
    """
    force = torque_x = torque_y = torque_z = speeds = 0.0
    for i in range(4):
        thrust = params[THRUST_COEFFICIENT] * rotors[i] * rotors[i]
        force += thrust
        torque_x += params[ROTOR_XY + 2 * i + 1] * thrust
        torque_y -= params[ROTOR_XY + 2 * i] * thrust
        torque_z -= params[SPINS + i] * thrust
        speeds += rotors[i]
    out[0] = force
    out[1] = torque_x
    out[2] = torque_y
    out[3] = params[MOMENT_RATIO] * torque_z
    out[4] = params[ROTOR_DRAG] * speeds


@kernel
def acceleration(
    velocity: tuple[float, float, float],
    quat: tuple[float, float, float, float],
    thrust: float,
    rotor_drag: float,
    wind_W: Array,
    params: Array,
) -> tuple[float, float, float]:
    """Compute the acceleration in frame W, m/s².

    Parameters
    ----------
    velocity : tuple of float
        Frame W, m/s.
    quat : tuple of float
        w, x, y, z.
    thrust : float
        Of all rotors, N.
    rotor_drag : float
        Their drag across their axes over airspeed, N s/m.
    wind_W : array, shape (3,)
        Velocity of the air, m/s.
    params : array, shape (PARAMETERS,)
    """
    qw, qx, qy, qz = quat
    per_mass = 1.0 / params[MASS]
    force = thrust * per_mass
    xz, yz, xx, yy, wx, wy = qx * qz, qy * qz, qx * qx, qy * qy, qw * qx, qw * qy
    nx, ny, nz = 2.0 * (xz + wy), 2.0 * (yz - wx), 1.0 - 2.0 * (xx + yy)
    ax, ay, az = force * nx, force * ny, force * nz - GRAVITY
    # the columns of R are l, m, n
    xy, wz, zz = qx * qy, qw * qz, qz * qz
    lx, ly, lz = 1.0 - 2.0 * (yy + zz), 2.0 * (xy + wz), 2.0 * (xz - wy)
    mx, my, mz = 2.0 * (xy - wz), 1.0 - 2.0 * (xx + zz), 2.0 * (yz + wx)
    rx, ry, rz = velocity[0] - wind_W[0], velocity[1] - wind_W[1], velocity[2] - wind_W[2]
    dl = per_mass * (rotor_drag + params[BODY_DRAG]) * (lx * rx + ly * ry + lz * rz)
    dm = per_mass * (rotor_drag + params[BODY_DRAG + 1]) * (mx * rx + my * ry + mz * rz)
    dn = per_mass * params[BODY_DRAG + 2] * (nx * rx + ny * ry + nz * rz)
    ax -= dl * lx + dm * mx + dn * nx
    ay -= dl * ly + dm * my + dn * ny
    az -= dl * lz + dm * mz + dn * nz
    return ax, ay, az


@kernel
def turning(
    quat: tuple[float, float, float, float], omega_B: tuple[float, float, float]
) -> tuple[float, float, float, float]:
    """Differentiate the attitude with respect to time: half the product of quaternion and body rates (rad/s)."""
    qw, qx, qy, qz = quat
    p, q, r = omega_B
    return (
        -0.5 * (qx * p + qy * q + qz * r),
        0.5 * (qw * p + qy * r - qz * q),
        0.5 * (qw * q + qz * p - qx * r),
        0.5 * (qw * r + qx * q - qy * p),
    )


@kernel
def angular_acceleration(
    omega_B: tuple[float, float, float], torque_x: float, torque_y: float, torque_z: float, params: Array
) -> tuple[float, float, float]:
    """Solve Euler's equations of the rigid body: rad/s² from rates (rad/s) and torques (N m) in the body frame."""
    p, q, r = omega_B
    jx, jy, jz = params[INERTIA], params[INERTIA + 1], params[INERTIA + 2]
    return (
        (torque_x - (jz - jy) * q * r) * (1.0 / jx),
        (torque_y - (jx - jz) * r * p) * (1.0 / jy),
        (torque_z - (jy - jx) * p * q) * (1.0 / jz),
    )


@kernel
def kept(duration: float, time_constant: float) -> float:
    """Return the share of its distance to the command that a rotor keeps after a duration, both in s."""
    return math.exp(-duration / time_constant)


@kernel
def lag(speed: float, command: float, keep_up: float, keep_down: float) -> float:
    """Return a rotor's speed after a time in which it keeps that share of its distance to the command."""
    return command + (speed - command) * (keep_up if command > speed else keep_down)


@kernel
def spin(state: Array, rotor_commands: Array, working: Array, keep_up: float, keep_down: float) -> None:
    """Let the rotors of a state follow their commands, rad/s; one that has failed (`working` 0) stands still."""
    for i in range(4):
        command = rotor_commands[i] * working[i]
        state[ROTORS + i] = working[i] * lag(state[ROTORS + i], command, keep_up, keep_down)


@kernel
def advance(
    state: Array,
    rotor_commands: Array,
    working: Array,
    wind_W: Array,
    params: Array,
    dt: float,
    half_up: float,
    half_down: float,
    work: Array,
) -> None:
    """Advance one vehicle by one step, in place: classical Runge-Kutta of order 4.

    The rotors' lag is solved exactly, as their commands do not change within a step.

    Parameters
    ----------
    state : array, shape (STATE,)
    rotor_commands : array, shape (4,)
        rad/s.
    working : array, shape (4,)
        1 for a rotor that turns, 0 for one that has failed.
    wind_W : array, shape (3,)
        m/s.
    params : array, shape (PARAMETERS,)
    dt : float
        s.
    half_up, half_down : float
        What `kept` gives for half a step and the rotors' time constants.
    work : array, shape (3, WRENCH)
        Overwritten.
    """
    wrench(state[ROTORS:], params, work[0])
    for moment in range(1, 3):
        spin(state, rotor_commands, working, half_up, half_down)
        wrench(state[ROTORS:], params, work[moment])

    # the point at which a stage looks, and the sum of what the stages find; positions have no influence
    vx, vy, vz = state[V], state[V + 1], state[V + 2]
    qw, qx, qy, qz = state[QUAT], state[QUAT + 1], state[QUAT + 2], state[QUAT + 3]
    p, q, r = state[OMEGA], state[OMEGA + 1], state[OMEGA + 2]
    px_sum = py_sum = pz_sum = vx_sum = vy_sum = vz_sum = 0.0
    qw_sum = qx_sum = qy_sum = qz_sum = p_sum = q_sum = r_sum = 0.0
    for stage in range(4):
        moment = (stage + 1) // 2
        weight = 1.0 if stage == 0 or stage == 3 else 2.0
        ahead = 0.5 * dt if stage < 2 else dt
        quat, omega = (qw, qx, qy, qz), (p, q, r)
        ax, ay, az = acceleration((vx, vy, vz), quat, work[moment, 0], work[moment, 4], wind_W, params)
        tw, tx, ty, tz = turning(quat, omega)
        bx, by, bz = angular_acceleration(omega, work[moment, 1], work[moment, 2], work[moment, 3], params)
        px_sum, py_sum, pz_sum = px_sum + weight * vx, py_sum + weight * vy, pz_sum + weight * vz
        vx_sum, vy_sum, vz_sum = vx_sum + weight * ax, vy_sum + weight * ay, vz_sum + weight * az
        qw_sum, qx_sum = qw_sum + weight * tw, qx_sum + weight * tx
        qy_sum, qz_sum = qy_sum + weight * ty, qz_sum + weight * tz
        p_sum, q_sum, r_sum = p_sum + weight * bx, q_sum + weight * by, r_sum + weight * bz
        vx, vy, vz = state[V] + ahead * ax, state[V + 1] + ahead * ay, state[V + 2] + ahead * az
        qw, qx = state[QUAT] + ahead * tw, state[QUAT + 1] + ahead * tx
        qy, qz = state[QUAT + 2] + ahead * ty, state[QUAT + 3] + ahead * tz
        p, q, r = state[OMEGA] + ahead * bx, state[OMEGA + 1] + ahead * by, state[OMEGA + 2] + ahead * bz
    share = dt / 6.0
    state[P] += share * px_sum
    state[P + 1] += share * py_sum
    state[P + 2] += share * pz_sum
    state[V] += share * vx_sum
    state[V + 1] += share * vy_sum
    state[V + 2] += share * vz_sum
    state[QUAT] += share * qw_sum
    state[QUAT + 1] += share * qx_sum
    state[QUAT + 2] += share * qy_sum
    state[QUAT + 3] += share * qz_sum
    state[OMEGA] += share * p_sum
    state[OMEGA + 1] += share * q_sum
    state[OMEGA + 2] += share * r_sum
    normalise(state[QUAT:OMEGA])


@kernel
def kinematic_derivative(x: Array, thrust: float, omega_B: Array, out: Array) -> None:
    """Differentiate (2.2), the vehicle that turns and thrusts exactly as it is told.

    Parameters
    ----------
    x : array, shape (10,) or more
        Position, velocity, quaternion.
    thrust : float
        Normalised, m/s².
    omega_B : array, shape (3,)
        rad/s.
    out : array, shape (10,) or more
    """
    qw, qx, qy, qz = x[QUAT], x[QUAT + 1], x[QUAT + 2], x[QUAT + 3]
    out[P], out[P + 1], out[P + 2] = x[V], x[V + 1], x[V + 2]
    out[V] = thrust * 2.0 * (qx * qz + qw * qy)
    out[V + 1] = thrust * 2.0 * (qy * qz - qw * qx)
    out[V + 2] = thrust * (qw * qw - qx * qx - qy * qy + qz * qz) - GRAVITY
    p, q, r = omega_B[0], omega_B[1], omega_B[2]
    out[QUAT] = -0.5 * (qx * p + qy * q + qz * r)
    out[QUAT + 1] = 0.5 * (qw * p + qy * r - qz * q)
    out[QUAT + 2] = 0.5 * (qw * q + qz * p - qx * r)
    out[QUAT + 3] = 0.5 * (qw * r + qx * q - qy * p)
