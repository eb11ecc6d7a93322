"""The theory's world: the ideal vehicle of (2.2), which thrusts and turns exactly as told, controlled without pause."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from covey.compiled import kernel
from covey.errors import ArgumentError
from covey.flight.backstepping import control
from covey.flight.dynamics import kinematic_derivative
from covey.flight.layout import COMMAND, OBSERVATION, QUAT, SIGNALS
from covey.flight.parameters import VehicleParameters
from covey.flight.rotation import normalise
from covey.flight.trajectories import Trajectory

Array = NDArray[np.float64]

MOVING = 10
"""Columns of an observation that (2.2) moves: position, velocity, quaternion."""


@dataclass(frozen=True, eq=False)
class IdealFlight:
    """What became of it, at k moments.

    Parameters
    ----------
    time : array, shape (k,)
        s.
    state : array, shape (k, OBSERVATION)
        Columns as in `covey.flight.layout`; the body rates are those commanded.
    reference : array, shape (k, REFERENCE)
    command : array, shape (k, COMMAND)
    signals : array, shape (k, SIGNALS)
    """

    time: Array
    state: Array
    reference: Array
    command: Array
    signals: Array


def fly_ideal(
    trajectory: Trajectory,
    state: Sequence[float] | Array,
    vehicle: VehicleParameters,
    *,
    duration: float,
    dt: float = 0.005,
    pure: bool = True,
) -> IdealFlight:
    """Let the ideal vehicle track a trajectory.

    Parameters
    ----------
    trajectory : Trajectory
    state : array, shape (MOVING,)
        Position (m) and velocity (m/s) in frame W and attitude, `quat_wxyz`, at time 0.
    vehicle : VehicleParameters
        Its gains are used, and its limits unless `pure`.
    duration, dt : float
        How long, and the step of the integrator (Runge-Kutta of order 4, the controller evaluated at each stage), s.
    pure : bool
        The law itself, or the practical form: see `covey.flight.backstepping`.

    Returns
    -------
    IdealFlight
        With ``duration / dt + 1`` moments.

    Raises
    ------
    ArgumentError
        If the state has the wrong shape or is not finite, or the times are not above zero.

    Notes
    -----
    Source: Sposato (2016), eq. (2.2), section 2.3.1.

    Examples
    --------
    >>> from covey.flight.parameters import load_vehicle
    >>> from covey.flight.trajectories import Hold
    >>> start = [0.0] * 6 + [1.0, 0.0, 0.0, 0.0]
    >>> flight = fly_ideal(Hold((1.0, 3.0, 2.0)), start, load_vehicle("iris"), duration=15.0)
    >>> print(flight.state[-1, :3].round(6))
    [1. 3. 2.]
    """
    begin = np.array(state, dtype=np.float64)
    if begin.shape != (MOVING,) or not np.isfinite(begin).all():
        raise ArgumentError(f"state: expected {MOVING} finite numbers, got {state!r}")
    if not (dt > 0.0 and duration >= dt):
        raise ArgumentError(f"duration, dt: expected duration >= dt > 0, got {duration!r} and {dt!r}")
    steps = round(duration / dt)
    references = np.array([trajectory(0.5 * dt * k) for k in range(2 * steps + 1)])
    states = np.zeros((steps + 1, OBSERVATION))
    states[0, :MOVING] = begin
    normalise(states[0, QUAT : QUAT + 4])
    commands, signals = np.empty((steps + 1, COMMAND)), np.empty((steps + 1, SIGNALS))
    integrate(states, references, vehicle.row(), pure, dt, commands, signals)
    states[:, MOVING:] = commands[:, 1:]
    time: Array = dt * np.arange(steps + 1, dtype=np.float64)
    return IdealFlight(time, states, references[::2], commands, signals)


@kernel
def integrate(
    states: Array, references: Array, params: Array, pure: bool, dt: float, commands: Array, signals: Array
) -> None:
    """Fill states, commands and signals; references come twice a step."""
    x, command, ignored = np.empty(OBSERVATION), np.empty(COMMAND), np.empty(SIGNALS)
    slopes = np.empty((4, MOVING))
    last = states.shape[0] - 1
    for k in range(last):
        state = states[k]
        control(state, references[2 * k], params, pure, commands[k], signals[k])
        kinematic_derivative(state, commands[k, 0], commands[k, 1:], slopes[0])
        for stage in range(1, 4):
            ahead = dt if stage == 3 else 0.5 * dt
            for i in range(MOVING):
                x[i] = state[i] + ahead * slopes[stage - 1, i]
            normalise(x[QUAT:MOVING])
            control(x, references[2 * k + (2 if stage == 3 else 1)], params, pure, command, ignored)
            kinematic_derivative(x, command[0], command[1:], slopes[stage])
        for i in range(MOVING):
            change = slopes[0, i] + 2.0 * (slopes[1, i] + slopes[2, i]) + slopes[3, i]
            states[k + 1, i] = state[i] + dt / 6.0 * change
        normalise(states[k + 1, QUAT:MOVING])
    control(states[last], references[2 * last], params, pure, commands[last], signals[last])
