"""The controller: normalised thrust and body rates that make a vehicle follow a reference.

With the errors ``e_p = p - p*`` and ``e_v = v - v*``, the thrust axis n and ``eps_1 = e_v + k1 e_p``::

    u     = a* + g e3 - kP e_p - kD e_v,   kP = (alpha/beta)(1 + k1 k2),  kD = k1 + (alpha/beta) k2
    n*    = u / |u|
    T     = u . n
    omega = n* x dn*/dt - (beta/gamma) |u| n x eps_1 + k_theta n x n*      without its component along n
    V1    = alpha/2 |e_p|²,   V2 = V1 + beta/2 |eps_1|²,   V3 = V2 + gamma (1 - n . n*)

and then ``dV3/dt = -alpha k1 |e_p|² - alpha k2 |eps_1|² - gamma k_theta |n x n*|²`` wherever thrust and rates are
followed at once.  About n the body turns so that yaw follows its reference.

Two forms share this: the *pure* law is what stands above.  The *practical* one also keeps to a vehicle's limits: the
position error that enters u is bounded, u is brought into a cone about the vertical and between the least and greatest
thrust (so that it is never near zero), rates are bounded, and what eps_1 adds cannot tilt the vehicle by more than 5
degrees beyond n*.  Near the reference both are the same.

Notes
-----
Source: Sposato (2016), eq. (2.12), (2.18), (2.24) to (2.26).  Deviation: C1, C2, C3, C5, C6, C7, C8.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from covey.compiled import kernel
from covey.errors import ArgumentError
from covey.flight.layout import (
    COMMAND,
    GRAVITY,
    OBSERVATION,
    QUAT,
    REF_A,
    REF_J,
    REF_P,
    REF_V,
    REF_YAW,
    REF_YAW_RATE,
    REFERENCE,
    SIG_DV3,
    SIG_EP,
    SIG_EV,
    SIG_V1,
    SIG_V2,
    SIG_V3,
    SIGNALS,
    P,
    V,
)
from covey.flight.parameters import (
    ALPHA,
    BETA,
    GAMMA,
    K1,
    K2,
    K_THETA,
    K_YAW,
    MAX_RATE,
    MAX_SPEED,
    MAX_THRUST,
    MAX_YAW_RATE,
    MIN_THRUST,
    PARAMETERS,
    TILT_SLOPE,
)

Array = NDArray[np.float64]

CLIMB_SHARE = 0.95
"""Share of the greatest thrust that may point up, so that some is left to go sideways."""
COUPLING_SINE = 0.087
"""Sine of the tilt beyond n* up to which eps_1 may drive the vehicle."""
LEAST_VERTICAL = 0.2
"""Guard of the yaw law where body z is nearly horizontal."""
TINY = 1e-12


@kernel
def control(observation: Array, reference: Array, params: Array, pure: bool, command: Array, signals: Array) -> None:
    """Compute the command of one vehicle.

    Parameters
    ----------
    observation : array, shape (OBSERVATION,)
        Frame W position, velocity and attitude are used; rates are left to the inner loop.
    reference : array, shape (REFERENCE,)
    params : array, shape (PARAMETERS,)
    pure : bool
        The law itself, which knows no limits.
    command : array, shape (COMMAND,)
        Written: normalised thrust, m/s², and body rates, frame B, rad/s.
    signals : array, shape (SIGNALS,)
        Written: V1, V2, V3, dV3/dt as the command drives (2.2), error norms in m and m/s.

    Notes
    -----
    Source: Sposato (2016), eq. (2.25), (2.26).  Deviation: C1, C2, C5, C6, C7, C8.
    """
    alpha, beta, gamma = params[ALPHA], params[BETA], params[GAMMA]
    k1, k2, k_theta = params[K1], params[K2], params[K_THETA]
    k_p, k_d = alpha / beta * (1.0 + k1 * k2), k1 + alpha / beta * k2
    most = params[MAX_THRUST]

    # rotation matrix, body to world; its third column is n
    w, x, y, z = observation[QUAT], observation[QUAT + 1], observation[QUAT + 2], observation[QUAT + 3]
    r11, r12, nx = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)
    r21, r22, ny = 2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)
    r31, r32, nz = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)

    px = observation[P] - reference[REF_P]
    py = observation[P + 1] - reference[REF_P + 1]
    pz = observation[P + 2] - reference[REF_P + 2]
    vx = observation[V] - reference[REF_V]
    vy = observation[V + 1] - reference[REF_V + 1]
    vz = observation[V + 2] - reference[REF_V + 2]

    # the position error as it enters u, and its derivative
    sx, sy, sz, dx, dy, dz = px, py, pz, vx, vy, vz
    if not pure:
        size, bound = math.sqrt(px * px + py * py + pz * pz), k_d / k_p * params[MAX_SPEED]
        if size > bound:
            shrink = bound / size
            along = (px * vx + py * vy + pz * vz) / (size * size)
            sx, sy, sz = shrink * px, shrink * py, shrink * pz
            dx, dy, dz = shrink * (vx - along * px), shrink * (vy - along * py), shrink * (vz - along * pz)

    ux = reference[REF_A] - k_p * sx - k_d * vx
    uy = reference[REF_A + 1] - k_p * sy - k_d * vy
    uz = reference[REF_A + 2] - k_p * sz - k_d * vz + GRAVITY
    climb_bound = horizontal_bound = False
    horizontal = reach = slope = 0.0
    if not pure:
        inside = min(CLIMB_SHARE * most, max(params[MIN_THRUST], uz))
        climb_bound = inside != uz
        uz = inside
        horizontal = math.sqrt(ux * ux + uy * uy)
        reach, slope = params[TILT_SLOPE] * uz, params[TILT_SLOPE]
        if reach * reach + uz * uz > most * most:
            reach = math.sqrt(most * most - uz * uz)
            slope = -uz / reach
        horizontal_bound = horizontal > reach
    hx, hy = ux, uy
    if horizontal_bound:
        ux, uy = reach / horizontal * hx, reach / horizontal * hy

    thrust = ux * nx + uy * ny + uz * nz
    if not pure:
        thrust = min(most, max(params[MIN_THRUST], thrust))

    # du/dt, for which (2.2) gives the acceleration
    gx = reference[REF_J] - k_p * dx - k_d * (thrust * nx - reference[REF_A])
    gy = reference[REF_J + 1] - k_p * dy - k_d * (thrust * ny - reference[REF_A + 1])
    gz = reference[REF_J + 2] - k_p * dz - k_d * (thrust * nz - GRAVITY - reference[REF_A + 2])
    if climb_bound:
        gz = 0.0
    if horizontal_bound:
        hx, hy = hx / horizontal, hy / horizontal
        along = hx * gx + hy * gy
        scale = reach / horizontal
        gx = scale * (gx - along * hx) + slope * gz * hx
        gy = scale * (gy - along * hy) + slope * gz * hy

    length = max(TINY, math.sqrt(ux * ux + uy * uy + uz * uz))
    mx, my, mz = ux / length, uy / length, uz / length  # n*
    along = mx * gx + my * gy + mz * gz
    tx, ty, tz = (gx - along * mx) / length, (gy - along * my) / length, (gz - along * mz) / length  # dn*/dt

    # eps_1 as it enters omega
    ex, ey, ez = vx + k1 * sx, vy + k1 * sy, vz + k1 * sz
    couple = beta / gamma * length
    if not pure:
        size = couple * math.sqrt(ex * ex + ey * ey + ez * ez)
        if size > COUPLING_SINE * k_theta:
            couple *= COUPLING_SINE * k_theta / size
    cx, cy, cz = k_theta * mx - couple * ex, k_theta * my - couple * ey, k_theta * mz - couple * ez
    ox = my * tz - mz * ty + ny * cz - nz * cy
    oy = mz * tx - mx * tz + nz * cx - nx * cz
    oz = mx * ty - my * tx + nx * cy - ny * cx

    # to the body frame, where the component along n is the third
    roll_rate = r11 * ox + r21 * oy + r31 * oz
    pitch_rate = r12 * ox + r22 * oy + r32 * oz
    if not pure:
        size = math.sqrt(roll_rate * roll_rate + pitch_rate * pitch_rate)
        if size > params[MAX_RATE]:
            roll_rate *= params[MAX_RATE] / size
            pitch_rate *= params[MAX_RATE] / size

    # yaw: sin and cos of pitch and roll are in R
    cosine, sine = math.cos(reference[REF_YAW]), math.sin(reference[REF_YAW])
    level = max(TINY, math.sqrt(r11 * r11 + r21 * r21))  # cos(pitch)
    error = (r21 * cosine - r11 * sine) / level
    if not pure and r11 * cosine + r21 * sine < 0.0:
        error = math.copysign(1.0, error)  # more than 90 degrees off: do not slow down towards the far equilibrium
    yaw_rate = reference[REF_YAW_RATE] - params[K_YAW] * error
    vertical = nz
    if not pure:
        vertical = max(LEAST_VERTICAL, nz)
    turn_rate = (yaw_rate * level * level - pitch_rate * r32) / vertical
    if not pure:
        turn_rate = min(params[MAX_YAW_RATE], max(-params[MAX_YAW_RATE], turn_rate))

    command[0], command[1], command[2], command[3] = thrust, roll_rate, pitch_rate, turn_rate

    ex, ey, ez = vx + k1 * px, vy + k1 * py, vz + k1 * pz
    p2, e2 = px * px + py * py + pz * pz, ex * ex + ey * ey + ez * ez
    # |n - n*|² is 2 (1 - n . n*) without its cancellation
    apart = (nx - mx) * (nx - mx) + (ny - my) * (ny - my) + (nz - mz) * (nz - mz)
    signals[SIG_V1] = 0.5 * alpha * p2
    signals[SIG_V2] = signals[SIG_V1] + 0.5 * beta * e2
    signals[SIG_V3] = signals[SIG_V2] + 0.5 * gamma * apart
    # dV3/dt from its definition, for the command as it is
    ax = thrust * nx - reference[REF_A] + k1 * vx
    ay = thrust * ny - reference[REF_A + 1] + k1 * vy
    az = thrust * nz - GRAVITY - reference[REF_A + 2] + k1 * vz
    # dn/dt = R (omega_B x e3)
    fx, fy, fz = (
        pitch_rate * r11 - roll_rate * r12,
        pitch_rate * r21 - roll_rate * r22,
        pitch_rate * r31 - roll_rate * r32,
    )
    turning = fx * mx + fy * my + fz * mz + nx * tx + ny * ty + nz * tz
    signals[SIG_DV3] = alpha * (px * vx + py * vy + pz * vz) + beta * (ex * ax + ey * ay + ez * az) - gamma * turning
    signals[SIG_EP] = math.sqrt(p2)
    signals[SIG_EV] = math.sqrt(vx * vx + vy * vy + vz * vz)


@kernel
def control_rows(
    observations: Array, references: Array, params: Array, pure: bool, commands: Array, signals: Array
) -> None:
    """Compute the commands of n vehicles; every array has n rows, else as in `control`."""
    for i in range(observations.shape[0]):
        control(observations[i], references[i], params[i], pure, commands[i], signals[i])


def control_all(
    observations: Array, references: Array, params: Array, commands: Array, signals: Array, *, pure: bool = False
) -> None:
    """Compute the commands of a fleet.

    Parameters
    ----------
    observations : array, shape (n, OBSERVATION)
    references : array, shape (n, REFERENCE)
    params : array, shape (n, PARAMETERS)
    commands : array, shape (n, COMMAND)
        Written.
    signals : array, shape (n, SIGNALS)
        Written.
    pure : bool
        The law itself, which knows no limits.

    Raises
    ------
    ArgumentError
        If a shape is wrong.
    """
    n = len(observations)
    arrays = {"observations": observations, "references": references, "params": params}
    arrays |= {"commands": commands, "signals": signals}
    columns = (OBSERVATION, REFERENCE, PARAMETERS, COMMAND, SIGNALS)
    for (name, array), width in zip(arrays.items(), columns, strict=True):
        if array.shape != (n, width):
            raise ArgumentError(f"{name}: expected shape ({n}, {width}), got {array.shape}")
    control_rows(observations, references, params, pure, commands, signals)
