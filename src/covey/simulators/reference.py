"""The reference simulator: the equations of `covey.flight.dynamics`, for many vehicles at once.

Each physics step (5 ms) the rate loop turns the command into rotor speeds, and the vehicle is advanced by Runge-Kutta
of order 4.  The rate loop reads the true body rates.  Against steps of 0.3 ms, half a second of tumbling then is off by
less than 1e-6, and a move over 3 m by 2 mm, which is the rate loop's delay.

A vehicle's position is where it touches: on the ground z is 0.  A vehicle that comes down to the ground stops there,
upright unless it tilts by more than 60 degrees, and leaves it when its thrust exceeds its weight.  Vehicles are upright
cylinders.  Contacts with each other and with obstacles are told once each, when they begin, and do not change the
motion.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from covey.compiled import kernel
from covey.errors import ArgumentError
from covey.flight.backstepping import control_rows
from covey.flight.dynamics import WRENCH, advance, kept, spin
from covey.flight.layout import (
    COMMAND,
    GRAVITY,
    OBSERVATION,
    OMEGA,
    QUAT,
    REFERENCE,
    ROTORS,
    SIGNALS,
    STATE,
    P,
    V,
)
from covey.flight.obstacles import Obstacle, Sphere, box_distance, nearest, pack
from covey.flight.parameters import (
    BODY_DRAG,
    HEIGHT,
    MASS,
    RADIUS,
    ROTOR_DRAG,
    TAU_DOWN,
    TAU_UP,
    THRUST_COEFFICIENT,
    VehicleParameters,
)
from covey.flight.rate_loop import rotor_commands
from covey.flight.rotation import from_yaw_pitch_roll, yaw_of
from covey.flight.sensing import Observer, SensorNoise
from covey.flight.simulator import Collision
from covey.flight.wind import Wind, WindField

Array = NDArray[np.float64]

PHYSICS_STEP = 0.005
"""s."""
BLOCK = 16
"""Vehicles advanced in turns."""
UPRIGHT = 0.5
"""Vertical component of the thrust axis from which on a landing vehicle stands; below it lies."""


class ReferenceSimulator:
    """A `covey.flight.simulator.Simulator` of ordinary differential equations.

    Parameters
    ----------
    vehicles : sequence of VehicleParameters
    positions_W : array, shape (n, 3)
        Where they start, frame W, m: level and at rest, rotors off on the ground and at hover speed in the air.
    yaws : array, shape (n,)
        rad.
    obstacles : sequence of Obstacle
    aero : bool
        Whether there is drag, and so wind.
    wind : Wind or None
    noise : SensorNoise or None
        Of `observe`; exact without.
    rng : numpy.random.Generator or None
        Needed with gusts or noise.
    physics_step : float
        Longest step of the integrator, s.

    Raises
    ------
    ArgumentError
        If a shape is wrong, a number is not finite, or `rng` is missing.

    Examples
    --------
    >>> from covey.flight.parameters import load_vehicle
    >>> simulator = ReferenceSimulator([load_vehicle("iris")], [[0.0, 0.0, 1.0]], [0.0])
    >>> simulator.step(np.array([[9.81, 0.0, 0.0, 0.0]]), 0.5)
    >>> simulator.state[0, :3]
    array([0., 0., 1.])
    """

    def __init__(
        self,
        vehicles: Sequence[VehicleParameters],
        positions_W: Sequence[Sequence[float]] | Array,
        yaws: Sequence[float] | Array,
        *,
        obstacles: Sequence[Obstacle] = (),
        aero: bool = True,
        wind: Wind | None = None,
        noise: SensorNoise | None = None,
        rng: np.random.Generator | None = None,
        physics_step: float = PHYSICS_STEP,
    ) -> None:
        self._vehicles = tuple(vehicles)
        n = len(self._vehicles)
        positions, headings = _finite("positions_W", positions_W, (n, 3)), _finite("yaws", yaws, (n,))
        if not physics_step > 0.0:
            raise ArgumentError(f"physics_step: expected seconds above zero, got {physics_step!r}")
        if rng is None and (wind is not None or noise is not None):
            raise ArgumentError("rng: expected a numpy.random.Generator, as there is wind or noise; got None")
        self._rows = np.array([vehicle.row() for vehicle in self._vehicles]).reshape(n, -1)
        if not aero:
            self._rows[:, [ROTOR_DRAG, *range(BODY_DRAG, BODY_DRAG + 3)]] = 0.0
        self._physics_step, self._time = float(physics_step), 0.0
        self._state = np.zeros((n, STATE))
        self._grounded = np.zeros(n, dtype=np.bool_)
        self._working = np.ones((n, 4))
        self._obstacles = list(obstacles)
        self._packed = pack(self._obstacles)
        self._order = np.argsort(positions[:, 0], kind="stable")
        self._pairs = np.empty((64, 2), dtype=np.int64)
        self._touching: set[tuple[int, int]] = set()
        self._collisions: list[Collision] = []
        self._air = np.zeros((n, 3))
        self._wind = WindField(wind, n, rng) if wind is not None and rng is not None else None
        self._observer = Observer(noise, rng) if noise is not None and rng is not None else None
        quat = np.empty(4)
        for i in range(n):
            from_yaw_pitch_roll(float(headings[i]), 0.0, 0.0, quat)
            self.set_state(i, positions[i], quat_wxyz=quat, hovering=bool(positions[i, 2] > 0.0))
        if self._observer is not None:
            self._observer.record(self._time, self._state)

    @property
    def parameters(self) -> tuple[VehicleParameters, ...]:
        """The vehicles, one entry each."""
        return self._vehicles

    @property
    def time(self) -> float:
        """Seconds simulated so far."""
        return self._time

    @property
    def state(self) -> Array:
        """True state, shape (n, STATE), columns as in `covey.flight.layout`; a copy."""
        return self._state.copy()

    @property
    def grounded(self) -> NDArray[np.bool_]:
        """Which vehicles stand or lie on the ground, shape (n,); a copy."""
        return self._grounded.copy()

    @property
    def collisions(self) -> Sequence[Collision]:
        """Contacts between vehicles and with obstacles so far, in the order they began."""
        return tuple(self._collisions)

    def observe(self) -> Array:
        """Measure every vehicle: shape (n, OBSERVATION), with noise and latency where configured."""
        if self._observer is None:
            return self._state[:, :OBSERVATION].copy()
        return self._observer.observe()

    def step(self, commands: Array, duration: float) -> None:
        """Hold commands, shape (n, COMMAND), for a duration in seconds and advance the world.

        Raises
        ------
        ArgumentError
            If the commands have the wrong shape or are not finite, or the duration is not above zero.
        """
        commands = _finite("commands", commands, (len(self._vehicles), COMMAND))
        substeps = self._substeps(duration)
        self._blow(duration)
        self._step(commands, duration / substeps, substeps)
        self._arrive(duration)

    def fly(self, references: Array, period: float) -> tuple[Array, Array]:
        """Close the loop: observe exactly, control, step, once a reference.

        Parameters
        ----------
        references : array, shape (k, n, REFERENCE)
            One for each of k control periods.
        period : float
            s.

        Returns
        -------
        commands : array, shape (n, COMMAND)
            The last ones.
        signals : array, shape (n, SIGNALS)
            Those at the begin of the last period.

        Raises
        ------
        ArgumentError
            If there is noise: then a loop of `observe` and `step` is what is needed.
        """
        n = len(self._vehicles)
        references = np.asarray(references, dtype=np.float64)
        references = _finite("references", references, (len(references), n, REFERENCE))
        if self._observer is not None:
            raise ArgumentError("fly: expected a simulator without noise; loop over observe and step instead")
        substeps = self._substeps(period)
        commands, signals = np.zeros((n, COMMAND)), np.zeros((n, SIGNALS))
        for reference in references:
            self._blow(period)
            control_rows(self._state, reference, self._rows, False, commands, signals)
            self._step(commands, period / substeps, substeps)
            self._arrive(period)
        return commands, signals

    def set_state(
        self,
        vehicle: int,
        p_W: Sequence[float] | Array,
        v_W: Sequence[float] | Array = (0.0, 0.0, 0.0),
        quat_wxyz: Sequence[float] | Array = (1.0, 0.0, 0.0, 0.0),
        omega_B: Sequence[float] | Array = (0.0, 0.0, 0.0),
        *,
        hovering: bool = True,
    ) -> None:
        """Place a vehicle; its rotors turn at hover speed, or stand still."""
        self._check(vehicle)
        row = np.zeros(STATE)
        row[P:V] = _finite("p_W", p_W, (3,))
        row[V:QUAT] = _finite("v_W", v_W, (3,))
        row[QUAT:OMEGA] = _finite("quat_wxyz", quat_wxyz, (4,))
        length = float(np.linalg.norm(row[QUAT:OMEGA]))
        if not abs(length - 1.0) < 1e-3:
            raise ArgumentError(f"quat_wxyz: expected a quaternion of length 1, got {quat_wxyz!r}")
        row[QUAT:OMEGA] /= length
        row[OMEGA:ROTORS] = _finite("omega_B", omega_B, (3,))
        if hovering:
            row[ROTORS:] = self._vehicles[vehicle].hover_speed * self._working[vehicle]
        self._state[vehicle] = row
        self._grounded[vehicle] = bool(row[P + 2] <= 0.0 and row[V + 2] <= 0.0)
        if self._grounded[vehicle]:
            land(self._state[vehicle])
        if self._observer is not None:
            self._observer.replace(vehicle, self._state[vehicle])

    def fail_motor(self, vehicle: int, rotor: int) -> None:
        """Let a rotor give no thrust from now on."""
        self._check(vehicle)
        if not 0 <= rotor < 4:
            raise ArgumentError(f"rotor: expected 0 to 3, got {rotor!r}")
        self._working[vehicle, rotor] = 0.0
        self._state[vehicle, ROTORS + rotor] = 0.0

    def add_obstacle(self, obstacle: Obstacle) -> int:
        """Put an obstacle into the world; return its index."""
        self._obstacles.append(obstacle)
        self._packed = pack(self._obstacles)
        return len(self._obstacles) - 1

    def move_obstacle(self, index: int, position_W: Sequence[float] | Array) -> None:
        """Put the centre of a spherical obstacle elsewhere."""
        if not 0 <= index < len(self._obstacles):
            raise ArgumentError(f"index: expected 0 to {len(self._obstacles) - 1}, got {index!r}")
        obstacle = self._obstacles[index]
        if not isinstance(obstacle, Sphere):
            raise ArgumentError(f"index: expected a Sphere, as nothing else can move; got {obstacle!r}")
        x, y, z = (float(value) for value in position_W)
        self._obstacles[index] = Sphere((x, y, z), obstacle.radius)
        self._packed = pack(self._obstacles)

    def close(self) -> None:
        """Do nothing: no resources are held."""

    def _check(self, vehicle: int) -> None:
        if not 0 <= vehicle < len(self._vehicles):
            raise ArgumentError(f"vehicle: expected 0 to {len(self._vehicles) - 1}, got {vehicle!r}")

    def _substeps(self, duration: float) -> int:
        if not (math.isfinite(duration) and duration > 0.0):
            raise ArgumentError(f"duration: expected seconds above zero, got {duration!r}")
        return max(1, math.ceil(duration / self._physics_step - 1e-9))

    def _step(self, commands: Array, dt: float, substeps: int) -> None:
        step_rows(self._state, commands, self._rows, self._air, self._working, self._grounded, dt, substeps)

    def _blow(self, duration: float) -> None:
        if self._wind is not None:
            self._air = self._wind.advance(duration)

    def _arrive(self, duration: float) -> None:
        """Count the time and tell of contacts that have begun."""
        self._time += duration
        if self._observer is not None:
            self._observer.record(self._time, self._state)
        count = find_contacts(self._state, self._rows, self._order, *self._packed, self._pairs)
        if count > len(self._pairs):
            self._pairs = np.empty((2 * count, 2), dtype=np.int64)
            count = find_contacts(self._state, self._rows, self._order, *self._packed, self._pairs)
        if not count and not self._touching:
            return
        now = {(int(a), int(b)) for a, b in self._pairs[:count]}
        for a, b in sorted(now - self._touching):
            # obstacles count from -1 downwards
            self._collisions.append(Collision(self._time, a, b if b >= 0 else None))
        self._touching = now


@kernel
def step_rows(
    state: Array,
    commands: Array,
    params: Array,
    air_W: Array,
    working: Array,
    grounded: NDArray[np.bool_],
    dt: float,
    substeps: int,
) -> None:
    """Advance n vehicles by some physics steps under one command each; every array has n rows.

    Vehicles take turns within a block: the processor works on the next while it waits for results of the last.
    """
    n = state.shape[0]
    speeds, work, shares = np.empty(4), np.empty((3, WRENCH)), np.empty((BLOCK, 2))
    for begin in range(0, n, BLOCK):
        end = min(n, begin + BLOCK)
        for i in range(begin, end):
            shares[i - begin, 0] = kept(0.5 * dt, params[i, TAU_UP])
            shares[i - begin, 1] = kept(0.5 * dt, params[i, TAU_DOWN])
        for _ in range(substeps):
            for i in range(begin, end):
                half_up, half_down = shares[i - begin, 0], shares[i - begin, 1]
                rotor_commands(state[i], commands[i], params[i], speeds)
                if grounded[i]:
                    spin(state[i], speeds, working[i], half_up * half_up, half_down * half_down)
                    grounded[i] = not lifted(state[i], params[i])
                    continue
                advance(state[i], speeds, working[i], air_W[i], params[i], dt, half_up, half_down, work)
                if state[i, P + 2] <= 0.0 and state[i, V + 2] <= 0.0:
                    land(state[i])
                    grounded[i] = True


@kernel
def lifted(state: Array, params: Array) -> bool:
    """Tell whether the rotors carry more than the weight."""
    squares = 0.0
    for i in range(4):
        squares += state[ROTORS + i] * state[ROTORS + i]
    vertical = 1.0 - 2.0 * (state[QUAT + 1] * state[QUAT + 1] + state[QUAT + 2] * state[QUAT + 2])
    return bool(params[THRUST_COEFFICIENT] * squares * vertical > params[MASS] * GRAVITY)


@kernel
def land(state: Array) -> None:
    """Put a vehicle to rest on the ground: upright, or as it lies."""
    state[P + 2] = 0.0
    for i in range(3):
        state[V + i] = 0.0
        state[OMEGA + i] = 0.0
    if 1.0 - 2.0 * (state[QUAT + 1] * state[QUAT + 1] + state[QUAT + 2] * state[QUAT + 2]) > UPRIGHT:
        from_yaw_pitch_roll(yaw_of(state[QUAT:OMEGA]), 0.0, 0.0, state[QUAT:OMEGA])


@kernel
def find_contacts(
    state: Array,
    params: Array,
    order: NDArray[np.int64],
    obstacles: Array,
    edges: Array,
    pairs: NDArray[np.int64],
) -> int:
    """Find the vehicles in contact with each other or with obstacles.

    Parameters
    ----------
    state : array, shape (n, STATE)
    params : array, shape (n, PARAMETERS)
    order : array, shape (n,)
        The vehicles sorted by x as found last time; kept sorted.
    obstacles, edges : arrays
        As from `covey.flight.obstacles.pack`.
    pairs : array, shape (m, 2)
        Written, as far as it goes: two vehicles in rising order, or a vehicle and ``-1 - k`` for obstacle k.

    Returns
    -------
    count : int
        Number of contacts; those beyond m are not written.
    """
    n, count, widest = order.size, 0, 0.0
    for k in range(n):
        widest = max(widest, params[k, RADIUS])
        moved = order[k]
        at = k
        while at > 0 and state[order[at - 1], P] > state[moved, P]:
            order[at] = order[at - 1]
            at -= 1
        order[at] = moved
    for k in range(n):
        i = order[k]
        x, y, z, radius, half = (
            state[i, P],
            state[i, P + 1],
            state[i, P + 2],
            params[i, RADIUS],
            0.5 * params[i, HEIGHT],
        )
        for m in range(k + 1, n):
            j = order[m]
            dx = state[j, P] - x
            if dx >= radius + widest:
                break
            dy, reach = state[j, P + 1] - y, radius + params[j, RADIUS]
            if dx * dx + dy * dy < reach * reach and abs(state[j, P + 2] - z) < half + 0.5 * params[j, HEIGHT]:
                if count < pairs.shape[0]:
                    pairs[count, 0], pairs[count, 1] = min(i, j), max(i, j)
                count += 1
        for m in range(obstacles.shape[0]):
            if box_distance(obstacles, m, x, y, z) < max(radius, half):
                distance, nx, ny, nz = nearest(obstacles, edges, m, x, y, z)
                # how far the cylinder reaches towards the obstacle
                if distance < radius * math.sqrt(nx * nx + ny * ny) + half * abs(nz):
                    if count < pairs.shape[0]:
                        pairs[count, 0], pairs[count, 1] = i, -1 - m
                    count += 1
    return count


def _finite(name: str, values: Sequence[Sequence[float]] | Sequence[float] | Array, shape: tuple[int, ...]) -> Array:
    """Return an array of floats, or raise ArgumentError."""
    array = np.ascontiguousarray(values, dtype=np.float64)
    if array.shape != shape and not (array.size == 0 and 0 in shape):
        raise ArgumentError(f"{name}: expected shape {shape}, got {array.shape}")
    if not np.isfinite(array).all():
        raise ArgumentError(f"{name}: expected finite numbers, got {array.tolist() if array.size < 20 else 'others'}")
    return array.reshape(shape)
