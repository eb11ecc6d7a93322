"""Vehicles in MuJoCo: rigid bodies that touch each other, obstacles and the ground, with drag, wind and downwash.

MuJoCo integrates the rigid bodies and resolves contacts; rate loop, rotor lag, drag and downwash are worked out for all
vehicles by one kernel before each of its steps.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from covey.errors import ArgumentError, SolverError
from covey.flight.layout import COMMAND, OBSERVATION, OMEGA, QUAT, ROTORS, STATE, P, V
from covey.flight.obstacles import Obstacle, Sphere
from covey.flight.parameters import VehicleParameters
from covey.flight.rotation import from_yaw_pitch_roll
from covey.flight.sensing import Observer, SensorNoise
from covey.flight.simulator import Collision
from covey.flight.wind import Wind, WindField
from covey.simulators.downwash import wash_rows
from covey.simulators.mujoco_kernels import drive, read, touch
from covey.simulators.mujoco_model import build

Array = NDArray[np.float64]

PHYSICS_STEP = 0.0025
"""Seconds."""

APART = 0.2
"""Two things that bounce touch once: a contact is a new one after they have been apart for so many seconds."""


class MujocoSimulator:
    """A `covey.flight.simulator.Simulator` on MuJoCo.

    Parameters
    ----------
    vehicles : sequence of VehicleParameters
        n of them.
    positions_W : array, shape (n, 3)
        Where they start, frame W, metres: level and at rest, rotors off on the ground and at hover speed in the air.
    yaws : array, shape (n,)
        rad.
    obstacles : sequence of Obstacle
    aero : bool
        Whether there are drag, wind and downwash; without, the motion is that of (2.1).
    wind : Wind or None
    noise : SensorNoise or None
        Of `observe`; exact without.
    rng : numpy.random.Generator or None
        Needed with wind or noise.
    physics_step : float
        Longest step, seconds.

    Raises
    ------
    ArgumentError
        If a shape is wrong, a number is not finite, or `rng` is missing.

    Notes
    -----
    Source: Sposato (2016), eq. (2.1).  Deviation: C4, C5.

    Examples
    --------
    >>> from covey.flight.parameters import load_vehicle
    >>> simulator = MujocoSimulator([load_vehicle("iris")], [[0.0, 0.0, 1.0]], [0.0])
    >>> simulator.step(np.array([[9.81, 0.0, 0.0, 0.0]]), 0.5)
    >>> print(f"{simulator.state[0, 2]:.3f}")
    1.000
    """

    def __init__(
        self,
        vehicles: Sequence[VehicleParameters],
        positions_W: ArrayLike,
        yaws: ArrayLike,
        *,
        obstacles: Sequence[Obstacle] = (),
        aero: bool = True,
        wind: Wind | None = None,
        noise: SensorNoise | None = None,
        rng: np.random.Generator | None = None,
        physics_step: float = PHYSICS_STEP,
    ) -> None:
        self._vehicles = tuple(vehicles)
        n = self._n = len(self._vehicles)
        positions, headings = _finite("positions_W", positions_W, (n, 3)), _finite("yaws", yaws, (n,))
        if not (math.isfinite(physics_step) and physics_step > 0.0):
            raise ArgumentError(f"physics_step: expected seconds above zero, got {physics_step!r}")
        if rng is None and (wind is not None or noise is not None):
            raise ArgumentError("rng: expected a numpy.random.Generator, as there is wind or noise; got None")
        self._rows = np.array([vehicle.row() for vehicle in self._vehicles]).reshape(n, -1)
        self._wash = wash_rows(self._vehicles)
        self._aero, self._physics_step, self._time = bool(aero), float(physics_step), 0.0
        self._state = np.zeros((n, STATE))
        self._state[:, QUAT] = 1.0
        self._working = np.ones((n, 4))
        self._grounded = np.zeros(n, dtype=np.bool_)
        self._air = np.zeros((n, 3))
        self._work = np.empty((4, max(n, 4)))
        self._began = np.empty((64, 2), dtype=np.int64)
        self._collisions: list[Collision] = []
        self._obstacles = list(obstacles)
        self._last = np.full((n, n), -math.inf)
        self._wind = WindField(wind, n, rng) if wind is not None and rng is not None else None
        self._observer = Observer(noise, rng) if noise is not None and rng is not None else None
        for i in range(n):
            from_yaw_pitch_roll(float(headings[i]), 0.0, 0.0, self._state[i, QUAT:OMEGA])
            self._state[i, P : P + 3] = *positions[i, :2], max(positions[i, 2], 0.0)
            self._state[i, ROTORS:] = self._vehicles[i].hover_speed if positions[i, 2] > 0.0 else 0.0
        self._compile()
        self._feel(self._time)
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

    def step(self, commands: ArrayLike, duration: float) -> None:
        """Hold commands, shape (n, COMMAND), for a duration in seconds and advance the world.

        Raises
        ------
        ArgumentError
            If the commands have the wrong shape or are not finite, or the duration is not above zero.
        SolverError
            If the world diverges: something moves at more than 10 km/s or 10⁴ rad/s.
        """
        import mujoco

        held = _finite("commands", commands, (self._n, COMMAND))
        if not (math.isfinite(duration) and duration > 0.0):
            raise ArgumentError(f"duration: expected seconds above zero, got {duration!r}")
        count = max(1, math.ceil(duration / self._physics_step - 1e-9))
        dt = duration / count
        if self._wind is not None:
            self._air = self._wind.advance(duration)
        model, data, advance = self._world.model, self._data, mujoco.mj_step
        model.opt.timestep = dt
        qpos, qvel, ctrl, force = self._views
        state, rows, working, wash, work = self._state, self._rows, self._working, self._wash, self._work
        air, aero = self._air, self._aero
        for k in range(count):
            diverged = drive(qpos, qvel, state, held, rows, working, wash, air, aero, dt, ctrl, force, work)
            if diverged >= 0:
                self._give_up(diverged)
            advance(model, data)
            self._feel(self._time + (k + 1) * dt)
        self._time += duration
        diverged = read(qpos, qvel, state)
        if diverged >= 0 or data.warning.number.any():
            self._give_up(diverged)
        if self._observer is not None:
            self._observer.record(self._time, self._state)

    def set_state(
        self,
        vehicle: int,
        p_W: ArrayLike,
        v_W: ArrayLike = (0.0, 0.0, 0.0),
        quat_wxyz: ArrayLike = (1.0, 0.0, 0.0, 0.0),
        omega_B: ArrayLike = (0.0, 0.0, 0.0),
        *,
        hovering: bool = True,
    ) -> None:
        """Place a vehicle; its rotors turn at hover speed, or stand still.

        One placed lower than it can stand or lie on the ground is put onto the ground.

        Raises
        ------
        ArgumentError
            If there is no such vehicle, a shape is wrong, a number is not finite, or the quaternion is not of length 1.
        """
        import mujoco

        self._check(vehicle)
        position, velocity = _finite("p_W", p_W, (3,)), _finite("v_W", v_W, (3,))
        quat, omega = _finite("quat_wxyz", quat_wxyz, (4,)), _finite("omega_B", omega_B, (3,))
        length = float(np.linalg.norm(quat))
        if not abs(length - 1.0) < 1e-3:
            raise ArgumentError(f"quat_wxyz: expected a quaternion of length 1, got {quat_wxyz!r}")
        quat = quat / length
        qpos, qvel, _ctrl, _force = self._views
        qpos[vehicle] = *position[:2], max(position[2], self._lowest(vehicle, quat)), *quat
        qvel[vehicle] = *velocity, *omega
        hover = self._vehicles[vehicle].hover_speed if hovering else 0.0
        self._state[vehicle, ROTORS:] = hover * self._working[vehicle]
        read(qpos, qvel, self._state)
        mujoco.mj_fwdPosition(self._world.model, self._data)
        self._feel(self._time)
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
        self._compile()
        return len(self._obstacles) - 1

    def move_obstacle(self, index: int, position_W: ArrayLike) -> None:
        """Put the centre of a spherical obstacle elsewhere; what it hits does not feel how fast it moves.

        Raises
        ------
        ArgumentError
            If there is no such obstacle, it is no sphere, or the position is not three finite numbers.
        """
        if not 0 <= index < len(self._obstacles):
            raise ArgumentError(f"index: expected 0 to {len(self._obstacles) - 1}, got {index!r}")
        obstacle = self._obstacles[index]
        if not isinstance(obstacle, Sphere):
            raise ArgumentError(f"index: expected a Sphere, as nothing else can move; got {obstacle!r}")
        x, y, z = (float(value) for value in _finite("position_W", position_W, (3,)))
        self._obstacles[index] = dataclasses.replace(obstacle, center_W=(x, y, z))
        self._data.mocap_pos[self._world.mocap[index]] = x, y, z

    def close(self) -> None:
        """Do nothing: MuJoCo's memory is freed with this object."""

    def _compile(self) -> None:
        """Build the world anew, with the vehicles as they are."""
        import mujoco

        n = self._n
        self._world = build(self._vehicles, self._obstacles, self._physics_step)
        self._data = data = mujoco.MjData(self._world.model)
        qpos, qvel = data.qpos.reshape(n, 7), data.qvel.reshape(n, 6)
        self._views = qpos, qvel, data.ctrl.reshape(n, 4), data.xfrc_applied[1 : n + 1]
        qpos[:, :3], qpos[:, 3:] = self._state[:, P : P + 3], self._state[:, QUAT : QUAT + 4]
        qvel[:, :3], qvel[:, 3:] = self._state[:, V : V + 3], self._state[:, OMEGA : OMEGA + 3]
        last = np.full((n, n + len(self._obstacles)), -math.inf)
        last[:, : self._last.shape[1]] = self._last
        self._last = last
        mujoco.mj_fwdPosition(self._world.model, data)

    def _feel(self, now: float) -> None:
        """Take notice of contacts at a time in seconds."""
        if not self._data.ncon:
            self._grounded[:] = False
            return
        owner, last, began = self._world.owner, self._last, self._began
        for a, b in began[: touch(self._data.contact.geom, owner, now, APART, last, self._grounded, began)]:
            self._collisions.append(Collision(now, int(a), int(b) if b < self._n else None))

    def _lowest(self, vehicle: int, quat: Array) -> float:
        """Height at which a vehicle with this attitude touches the ground, metres."""
        vertical = float(1.0 - 2.0 * (quat[1] * quat[1] + quat[2] * quat[2]))
        body = self._vehicles[vehicle]
        reach = body.body_radius * math.sqrt(max(0.0, 1.0 - vertical * vertical))
        return reach + max(0.0, -vertical) * body.body_height

    def _check(self, vehicle: int) -> None:
        if not 0 <= vehicle < self._n:
            raise ArgumentError(f"vehicle: expected 0 to {self._n - 1}, got {vehicle!r}")

    def _give_up(self, vehicle: int) -> None:
        who = "the motion" if vehicle < 0 else f"the motion of vehicle {vehicle}"
        rows = self._state[:, :OBSERVATION] if vehicle < 0 else self._state[vehicle, :OBSERVATION]
        raise SolverError(
            f"MuJoCo: {who} diverges at {self._time:.2f} s, state {rows.tolist()}; "
            f"check the vehicle's parameters, or try a smaller physics_step than {self._physics_step:g} s"
        )


def _finite(name: str, values: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Return an array of floats, or raise ArgumentError."""
    try:
        array = np.ascontiguousarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ArgumentError(f"{name}: expected numbers of shape {shape}, got {values!r}") from error
    if array.shape != shape and not (array.size == 0 and 0 in shape):
        raise ArgumentError(f"{name}: expected shape {shape}, got {array.shape}")
    if not np.isfinite(array).all():
        raise ArgumentError(f"{name}: expected finite numbers, got {array.tolist() if array.size < 20 else 'others'}")
    return array.reshape(shape)


__all__ = ["MujocoSimulator"]
