"""What every simulator must do, as checks that raise AssertionError."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from covey.errors import ArgumentError
from covey.flight.layout import COMMAND, GRAVITY, OBSERVATION, OMEGA, QUAT, ROTORS, STATE, P, V
from covey.flight.obstacles import Box, Prism, Sphere
from covey.flight.parameters import VehicleParameters, load_vehicle
from covey.flight.sensing import SensorNoise
from covey.flight.simulator import Simulator
from covey.flight.wind import Wind

Array = NDArray[np.float64]
PERIOD = 0.01
HIGH = 50.0
"""Far enough from the ground for what follows, metres."""


class MakeSimulator(Protocol):
    """Makes a simulator; the options are those of every simulator's constructor."""

    def __call__(
        self, vehicles: Sequence[VehicleParameters], positions_W: Any, yaws: Any, /, **options: Any
    ) -> Simulator:
        """Return a new simulator."""
        ...


def check_simulator(make: MakeSimulator) -> None:
    """Run every check of the suite.

    Parameters
    ----------
    make : callable
        ``make(vehicles, positions_W, yaws, **options)``; a class of simulators is such a callable.

    Raises
    ------
    AssertionError
        If a check fails; the text says which and how.
    """
    for check in CHECKS:
        check(make)


def check_arrays(make: MakeSimulator) -> None:
    """Shapes are as documented, and what is handed out are copies."""
    simulator = _irises(make, [[0.0, 0.0, HIGH], [5.0, 0.0, HIGH], [9.0, 1.0, 0.0]])
    _require(len(simulator.parameters) == 3, "parameters: expected one entry a vehicle")
    _require(simulator.state.shape == (3, STATE), f"state: expected shape (3, {STATE}), got {simulator.state.shape}")
    seen = simulator.observe()
    _require(seen.shape == (3, OBSERVATION), f"observe: expected shape (3, {OBSERVATION}), got {seen.shape}")
    _require(simulator.grounded.tolist() == [False, False, True], f"grounded: got {simulator.grounded}")
    _require(len(simulator.collisions) == 0, "collisions: none may have begun")
    before = simulator.state
    simulator.state[:] = np.nan
    simulator.observe()[:] = np.nan
    simulator.grounded[:] = True
    _close(simulator.state, before, 0.0, "state: must be a copy")
    _close(simulator.observe(), before[:, :OBSERVATION], 0.0, "observe: must be a copy, and exact without noise")
    _require(not simulator.grounded[0], "grounded: must be a copy")
    commands = _hover(3)
    simulator.step(commands, PERIOD)
    _close(commands, _hover(3), 0.0, "step: must not change the commands")
    _close(np.linalg.norm(simulator.state[:, QUAT:OMEGA], axis=1), np.ones(3), 1e-9, "state: quaternions of length 1")
    simulator.close()


def check_time(make: MakeSimulator) -> None:
    """Time adds up, for durations that are no multiple of the physics step as well."""
    simulator = _irises(make, [[0.0, 0.0, HIGH]])
    simulator.set_state(0, [0.0, 0.0, HIGH], [1.0, 0.0, 0.0])
    for duration in (0.01, 0.0137, 0.0001, 0.1):
        simulator.step(_hover(1), duration)
    _close(simulator.time, 0.1238, 1e-9, "time: must be the sum of the durations")
    _close(simulator.state[0, P], 0.1238, 1e-4, "step: must advance by its duration")


def check_hover(make: MakeSimulator) -> None:
    """Thrust that carries the weight keeps a vehicle where it is."""
    simulator = _irises(make, [[1.0, -2.0, HIGH], [8.0, 0.0, HIGH]], [0.4, -2.0], aero=True)
    before = simulator.state
    _run(simulator, _hover(2), 2.0)
    _close(simulator.state, before, 1e-3, "step: a vehicle that hovers must stay")


def check_free_fall(make: MakeSimulator) -> None:
    """Without thrust and air a vehicle falls by g t²/2."""
    simulator = _irises(make, [[0.0, 0.0, HIGH]])
    for rotor in range(4):
        simulator.fail_motor(0, rotor)
    for _ in range(100):
        simulator.step(np.zeros((1, COMMAND)), PERIOD)
        fallen = 0.5 * GRAVITY * simulator.time**2
        _close(simulator.state[0, P + 2], HIGH - fallen, 2e-3, "step: free fall must be g t²/2")
    _close(simulator.state[0, V + 2], -GRAVITY, 1e-3, "step: velocity of free fall must be -g t")


def check_rates(make: MakeSimulator) -> None:
    """Commanded body rates are reached, with the right sign about each axis, and turn the vehicle that way."""
    for axis in range(3):
        for rate in (0.4, -0.4):
            simulator = _irises(make, [[0.0, 0.0, HIGH]])
            command = _hover(1)
            command[0, 1 + axis] = rate
            _run(simulator, command, 1.0)
            wanted = np.zeros(3)
            wanted[axis] = rate
            _close(simulator.state[0, OMEGA:ROTORS], wanted, 0.03, f"step: rate {rate} about axis {axis}")
            angle = 2.0 * math.atan2(float(simulator.state[0, QUAT + 1 + axis]), float(simulator.state[0, QUAT]))
            _require(0.5 * abs(rate) < math.copysign(1.0, rate) * angle < abs(rate), f"step: turned by {angle}")


def check_thrust(make: MakeSimulator) -> None:
    """Thrust acts along the body's z axis: yaw, then pitch, then roll, from x forward, y left, z up."""
    cases = {
        "level": ((1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
        "pitch 0.3": ((math.cos(0.15), 0.0, math.sin(0.15), 0.0), (math.sin(0.3), 0.0, math.cos(0.3))),
        "roll 0.3": ((math.cos(0.15), math.sin(0.15), 0.0, 0.0), (0.0, -math.sin(0.3), math.cos(0.3))),
        # yaw of 90 degrees, then pitch of 0.3: forward is W's y
        "yaw and pitch": (
            tuple(math.sqrt(0.5) * x for x in (math.cos(0.15), -math.sin(0.15), math.sin(0.15), math.cos(0.15))),
            (0.0, math.sin(0.3), math.cos(0.3)),
        ),
    }
    for name, (quat, axis) in cases.items():
        simulator = _irises(make, [[0.0, 0.0, HIGH]])
        simulator.set_state(0, [0.0, 0.0, HIGH], quat_wxyz=quat)
        simulator.step(np.array([[12.0, 0.0, 0.0, 0.0]]), 0.2)
        before = simulator.state[0, V:QUAT]
        simulator.step(np.array([[12.0, 0.0, 0.0, 0.0]]), 0.2)
        acceleration = (simulator.state[0, V:QUAT] - before) / 0.2
        wanted = 12.0 * np.array(axis) - [0.0, 0.0, GRAVITY]
        _close(acceleration, wanted, 0.02, f"step: acceleration with {name}")


def check_yaw(make: MakeSimulator) -> None:
    """A start with a yaw turns x towards y by it."""
    simulator = _irises(make, [[0.0, 0.0, HIGH], [5.0, 0.0, 0.0]], [0.7, -1.2])
    for i, yaw in enumerate((0.7, -1.2)):
        wanted = [math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)]
        _close(simulator.state[i, QUAT:OMEGA], wanted, 1e-9, "yaws: quaternion")


def check_ground(make: MakeSimulator) -> None:
    """A vehicle rests on the ground at z = 0, takes off, lands where it comes down, and none of it is a collision."""
    simulator = _irises(make, [[1.0, 2.0, 0.0]], [0.5])
    _run(simulator, np.zeros((1, COMMAND)), 0.5)
    rest = simulator.state[0]
    _require(bool(simulator.grounded[0]), "grounded: a vehicle at rest must be on the ground")
    _close(rest[P:V], [1.0, 2.0, 0.0], 5e-3, "step: a vehicle at rest must stay")
    _close(rest[V:QUAT], 0.0, 5e-3, "step: a vehicle at rest must not move")
    _run(simulator, [[GRAVITY + 2.0, 0.0, 0.0, 0.0]], 1.0)
    _require(0.5 < simulator.state[0, P + 2] < 1.1, f"step: take-off, got a height of {simulator.state[0, P + 2]}")
    _require(not simulator.grounded[0], "grounded: a vehicle in the air is not")
    _run(simulator, [[GRAVITY - 3.0, 0.0, 0.0, 0.0]], 2.5)
    _run(simulator, np.zeros((1, COMMAND)), 1.0)
    landed = simulator.state[0]
    _require(bool(simulator.grounded[0]), "grounded: a vehicle that has landed must be on the ground")
    _close(landed[P:V], [1.0, 2.0, 0.0], 0.02, "step: landing must end on the ground below")
    _close(landed[V:QUAT], 0.0, 0.01, "step: landing must end at rest")
    _close(landed[QUAT:OMEGA], rest[QUAT:OMEGA], 0.01, "step: landing must end upright")
    _require(len(simulator.collisions) == 0, f"collisions: the ground is none, got {simulator.collisions}")


def check_wind(make: MakeSimulator) -> None:
    """Wind carries a vehicle downwind, unless there is no air."""
    for wind in ((3.0, 0.0, 0.0), (0.0, -3.0, 0.0)):
        rng = np.random.default_rng(1)
        simulator = _irises(make, [[0.0, 0.0, HIGH]], aero=True, wind=Wind(wind), rng=rng)
        _run(simulator, _hover(1), 2.0)
        moved = simulator.state[0, P : P + 2]
        along, across = float(moved @ wind[:2]) / 3.0, float(moved[0] * wind[1] - moved[1] * wind[0]) / 3.0
        _require(along > 0.2 and abs(across) < 0.01, f"wind: {wind} must carry downwind, moved by {moved}")
        vacuum = _irises(make, [[0.0, 0.0, HIGH]], aero=False, wind=Wind(wind), rng=rng)
        _run(vacuum, _hover(1), 1.0)
        _close(vacuum.state[0, P : P + 2], 0.0, 1e-6, "aero: without air there is no wind")


def check_set_state(make: MakeSimulator) -> None:
    """A vehicle is put exactly where it shall be; the others stay."""
    simulator = _irises(make, [[0.0, 0.0, HIGH], [5.0, 0.0, HIGH]])
    quat = [0.8, 0.2, -0.4, 0.4]
    before = simulator.state[0]
    given = [3.0, -4.0, 20.0], [1.0, 2.0, -0.5], quat, [0.1, -0.2, 0.3]
    simulator.set_state(1, *given)
    _close(simulator.state[1, :ROTORS], np.concatenate(given), 1e-9, "set_state: state")
    _close(simulator.observe(), simulator.state[:, :OBSERVATION], 1e-9, "set_state: observation")
    hover = simulator.parameters[1].hover_speed
    _close(simulator.state[1, ROTORS:], hover, 1e-9, "set_state: rotors at hover speed")
    _close(simulator.state[0], before, 0.0, "set_state: another vehicle was changed")
    simulator.set_state(1, [3.0, -4.0, 0.0], hovering=False)
    _close(simulator.state[1, ROTORS:], 0.0, 0.0, "set_state: rotors must stand still")
    _require(simulator.grounded.tolist() == [False, True], "set_state: put on the ground")


def check_fail_motor(make: MakeSimulator) -> None:
    """A vehicle that loses a rotor comes down, and what is left of it can be simulated on."""
    simulator = _irises(make, [[0.0, 0.0, 4.0], [5.0, 0.0, 4.0]])
    simulator.fail_motor(0, 2)
    for _ in range(400):
        simulator.step(_hover(2), PERIOD)
        _require(bool(np.isfinite(simulator.state).all()), "fail_motor: the state must stay finite")
        _close(simulator.state[0, ROTORS + 2], 0.0, 0.0, "fail_motor: the rotor must stand still")
    _require(simulator.state[0, P + 2] < 1.0, f"fail_motor: must fall, is at {simulator.state[0, P + 2]} m")
    _close(simulator.state[1, P + 2], 4.0, 1e-3, "fail_motor: another vehicle must fly on")


def check_collisions(make: MakeSimulator) -> None:
    """A contact is told once, when it begins, with the lower vehicle first."""
    iris = load_vehicle("iris")
    gap, nobody = 1.0, np.array([0.0, 20.0, HIGH])
    simulator = _irises(make, [[gap + 2.0 * iris.body_radius, 0.0, HIGH], [0.0, 0.0, HIGH], nobody])
    simulator.set_state(0, [gap + 2.0 * iris.body_radius, 0.0, HIGH], [-1.0, 0.0, 0.0])
    simulator.set_state(1, [0.0, 0.0, HIGH], [1.0, 0.0, 0.0])
    for _ in range(70):
        simulator.step(_hover(3), PERIOD)
        _require(len(simulator.collisions) <= 1, f"collisions: expected one, got {simulator.collisions}")
    _require(len(simulator.collisions) == 1, "collisions: expected that of two vehicles")
    collision = simulator.collisions[0]
    _require((collision.vehicle, collision.other) == (0, 1), f"collisions: expected 0 and 1, got {collision}")
    _close(collision.time, 0.5 * gap, 0.02, "collisions: time")

    wall = Box((2.0, -5.0, HIGH - 5.0), (3.0, 5.0, HIGH + 5.0))
    simulator = _irises(make, [[0.0, 0.0, HIGH]], obstacles=[wall])
    simulator.set_state(0, [0.0, 0.0, HIGH], [2.0, 0.0, 0.0])
    _run(simulator, _hover(1), 0.9)
    _require([(c.vehicle, c.other) for c in simulator.collisions] == [(0, None)], "collisions: expected the wall's")
    _close(simulator.collisions[0].time, (2.0 - iris.body_radius) / 2.0, 0.02, "collisions: time of the wall's")


def check_obstacles(make: MakeSimulator) -> None:
    """Obstacles can be added while others fly, spheres can be moved, and a prism is only where its outline is."""
    notch = Prism(((-3, -3), (3, -3), (3, -2), (-2, -2), (-2, 3), (-3, 3)), HIGH - 2.0, HIGH + 2.0)
    simulator = _irises(make, [[0.0, 0.0, HIGH], [8.0, 0.0, HIGH]], obstacles=[notch])
    simulator.set_state(1, [8.0, 0.0, HIGH], [0.0, 1.0, 0.0])
    _run(simulator, _hover(2), 0.2)
    _require(len(simulator.collisions) == 0, "obstacles: the notch of a prism is free")
    before, time = simulator.state, simulator.time
    _require(simulator.add_obstacle(Sphere((0.0, 0.0, HIGH + 5.0), 0.5)) == 1, "add_obstacle: expected index 1")
    _require(simulator.add_obstacle(Box((20.0, 0.0, 0.0), (21.0, 1.0, 1.0))) == 2, "add_obstacle: expected index 2")
    _close(simulator.state, before, 0.0, "add_obstacle: must not move vehicles")
    _close(simulator.time, time, 0.0, "add_obstacle: must not change the time")
    _run(simulator, _hover(2), 0.2)
    _close(simulator.state[1, P : P + 2], [8.0, 0.4], 1e-3, "add_obstacle: vehicles must fly on")
    _require(len(simulator.collisions) == 0, "obstacles: nothing was touched yet")
    simulator.move_obstacle(1, [0.0, 0.0, HIGH + 0.4])
    _run(simulator, _hover(2), 0.05)
    _require([(c.vehicle, c.other) for c in simulator.collisions] == [(0, None)], "move_obstacle: onto a vehicle")
    simulator.move_obstacle(1, [0.0, 30.0, HIGH])
    simulator.set_state(0, [-2.5, 0.0, HIGH])
    _run(simulator, _hover(2), 0.05)
    _require(len(simulator.collisions) == 2, "collisions: expected one with the prism")


def check_sensing(make: MakeSimulator) -> None:
    """Noise and latency are in what is observed, and in nothing else."""
    starts = [[5.0 * i, 0.0, HIGH] for i in range(30)]
    exact = _irises(make, starts)
    rng = np.random.default_rng(3)
    noise = SensorNoise(position_std=0.05, velocity_std=0.02, attitude_std=0.01, rate_std=0.1)
    noisy = _irises(make, starts, noise=noise, rng=rng)
    errors = []
    for _ in range(10):
        exact.step(_hover(30), PERIOD)
        noisy.step(_hover(30), PERIOD)
        errors.append(noisy.observe() - noisy.state[:, :OBSERVATION])
        _close(noisy.observe(), noisy.observe(), 0.0, "observe: twice at one time must give the same")
    _close(noisy.state, exact.state, 0.0, "noise: must not be in the state")
    measured = np.concatenate(errors)
    wanted = {P: 0.05, V: 0.02, QUAT + 1: 0.005, OMEGA: 0.1}
    for column, std in wanted.items():
        got = float(measured[:, column : column + 3].std())
        _require(0.85 * std < got < 1.15 * std, f"noise: expected {std} from column {column}, got {got}")

    late = _irises(make, [[0.0, 0.0, HIGH]], noise=SensorNoise(latency=0.05), rng=np.random.default_rng(0))
    late.set_state(0, [0.0, 0.0, HIGH], [1.0, 0.0, 0.0])
    past = [late.state]
    for _ in range(20):
        late.step(np.array([[GRAVITY + 1.0, 0.1, 0.2, 0.0]]), PERIOD)
        past.append(late.state)
        _close(late.observe(), past[max(0, len(past) - 6)][:, :OBSERVATION], 1e-12, "latency: expected 0.05 s")


def check_determinism(make: MakeSimulator) -> None:
    """The same seed gives the same flight, to the last bit."""

    def fly(seed: int) -> Array:
        rng = np.random.default_rng(seed)
        wind = Wind((1.0, 0.0, 0.0), gust_std=1.0)
        options = {"aero": True, "wind": wind, "noise": SensorNoise(position_std=0.01), "rng": rng}
        simulator = _irises(make, [[0.0, 0.0, 3.0], [0.5, 0.0, 4.0]], **options)
        _run(simulator, _hover(2), 1.0)
        return np.concatenate([simulator.state[:, :OBSERVATION], simulator.observe()])

    first = fly(7)
    _close(fly(7), first, 0.0, "determinism: the same seed must give the same flight")
    _require(not np.array_equal(fly(8), first), "determinism: another seed must give another flight")


def check_arguments(make: MakeSimulator) -> None:
    """What makes no sense is refused with an ArgumentError, and changes nothing."""
    iris = load_vehicle("iris")
    simulator = _irises(make, [[0.0, 0.0, HIGH]], obstacles=[Box((5.0, 5.0, 0.0), (6.0, 6.0, 1.0))])
    bad = np.zeros((1, COMMAND))
    bad[0, 2] = np.nan
    calls: dict[str, Callable[[], object]] = {
        "commands of a wrong shape": lambda: simulator.step(np.zeros((2, COMMAND)), PERIOD),
        "commands that are not finite": lambda: simulator.step(bad, PERIOD),
        "a duration of 0": lambda: simulator.step(_hover(1), 0.0),
        "an infinite duration": lambda: simulator.step(_hover(1), math.inf),
        "set_state of vehicle 1 of 1": lambda: simulator.set_state(1, [0.0, 0.0, 1.0]),
        "set_state of vehicle -1": lambda: simulator.set_state(-1, [0.0, 0.0, 1.0]),
        "a position of two numbers": lambda: simulator.set_state(0, [0.0, 0.0]),
        "a velocity that is not finite": lambda: simulator.set_state(0, [0.0, 0.0, 1.0], [0.0, 0.0, np.inf]),
        "a quaternion of length 2": lambda: simulator.set_state(0, [0.0, 0.0, 1.0], quat_wxyz=[2.0, 0.0, 0.0, 0.0]),
        "rotor 4": lambda: simulator.fail_motor(0, 4),
        "a motor of vehicle 3": lambda: simulator.fail_motor(3, 0),
        "moving a box": lambda: simulator.move_obstacle(0, [0.0, 0.0, 1.0]),
        "moving obstacle 1 of 1": lambda: simulator.move_obstacle(1, [0.0, 0.0, 1.0]),
        "positions of a wrong shape": lambda: make([iris], [[0.0, 0.0]], [0.0]),
        "two yaws of one vehicle": lambda: make([iris], [[0.0, 0.0, 1.0]], [0.0, 1.0]),
        "a physics step of 0": lambda: make([iris], [[0.0, 0.0, 1.0]], [0.0], physics_step=0.0),
        "noise without a generator": lambda: make([iris], [[0.0, 0.0, 1.0]], [0.0], noise=SensorNoise(0.1)),
        "wind without a generator": lambda: make([iris], [[0.0, 0.0, 1.0]], [0.0], wind=Wind(gust_std=1.0)),
    }
    before, time = simulator.state, simulator.time
    for name, call in calls.items():
        try:
            call()
        except ArgumentError:
            continue
        raise AssertionError(f"{name}: expected an ArgumentError")
    _close(simulator.state, before, 0.0, "a refused call must change nothing")
    _close(simulator.time, time, 0.0, "a refused call must take no time")


def check_mixed_fleet(make: MakeSimulator) -> None:
    """Each vehicle of a fleet flies with parameters of its own."""
    vehicles = [load_vehicle("crazyflie"), load_vehicle("iris"), load_vehicle("crazyflie")]
    simulator = make(vehicles, [[0.0, 0.0, 2.0], [3.0, 0.0, 2.0], [6.0, 0.0, 0.0]], [0.0, 1.0, 2.0], aero=False)
    _require([v.name for v in simulator.parameters] == ["crazyflie", "iris", "crazyflie"], "parameters: order")
    before = simulator.state
    commands = _hover(3)
    commands[2] = 0.0
    _run(simulator, commands, 1.0)
    _close(simulator.state[:, :ROTORS], before[:, :ROTORS], 2e-3, "step: every vehicle must hover or rest")
    for i in (0, 1):
        _close(simulator.state[i, ROTORS:], vehicles[i].hover_speed, 1.0, "step: hover speed of each vehicle")


CHECKS: tuple[Callable[[MakeSimulator], None], ...] = (
    check_arrays,
    check_time,
    check_hover,
    check_free_fall,
    check_rates,
    check_thrust,
    check_yaw,
    check_ground,
    check_wind,
    check_set_state,
    check_fail_motor,
    check_collisions,
    check_obstacles,
    check_sensing,
    check_determinism,
    check_arguments,
    check_mixed_fleet,
)
"""The suite, check by check."""


def _irises(make: MakeSimulator, positions_W: Any, yaws: Any = None, **options: Any) -> Simulator:
    n = len(positions_W)
    return make(
        [load_vehicle("iris")] * n, positions_W, np.zeros(n) if yaws is None else yaws, **({"aero": False} | options)
    )


def _hover(n: int) -> Array:
    commands = np.zeros((n, COMMAND))
    commands[:, 0] = GRAVITY
    return commands


def _run(simulator: Simulator, commands: Any, seconds: float) -> None:
    for _ in range(round(seconds / PERIOD)):
        simulator.step(np.asarray(commands, dtype=np.float64), PERIOD)


def _close(got: Any, wanted: Any, tolerance: float, text: str) -> None:
    error = np.abs(np.asarray(got) - np.asarray(wanted)).max()
    if not error <= tolerance:
        raise AssertionError(f"{text}: expected {wanted}, got {got}, off by {error:.3g} with {tolerance:.3g} allowed")


def _require(holds: bool, text: str) -> None:
    if not holds:
        raise AssertionError(text)


__all__ = ["CHECKS", "MakeSimulator", "check_simulator"]
