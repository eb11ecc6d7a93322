"""What a vehicle is: mass, rotors, gains and limits, read from TOML files that name unit and source of each value."""

from __future__ import annotations

import difflib
import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from covey.errors import InputError
from covey.flight.layout import GRAVITY

FOLDER = Path(__file__).parent / "params"
TILT_RESERVE = 0.7
"""Share of the greatest tilt that the controller aims at; the rest is for overshoot."""

# Columns of a parameter row, as the kernels read it; see `VehicleParameters.row`.
MASS = 0
INERTIA = 1
ROTOR_XY = 4
SPINS = 12
THRUST_COEFFICIENT = 16
MOMENT_RATIO = 17
ROTOR_DRAG = 18
TAU_UP = 19
TAU_DOWN = 20
SPEED_MIN = 21
SPEED_MAX = 22
BODY_DRAG = 23
RADIUS = 26
HEIGHT = 27
RATE_GAINS = 28
ROTOR_LEAD = 31
ALPHA = 32
BETA = 33
GAMMA = 34
K1 = 35
K2 = 36
K_THETA = 37
K_YAW = 38
MAX_TILT = 39
MAX_RATE = 40
MAX_YAW_RATE = 41
MIN_THRUST = 42
MAX_THRUST = 43
MAX_SPEED = 44
MAX_ACCELERATION = 45
MAX_JERK = 46
MARGIN = 47
VERTICAL_RATIO = 48
ALLOCATION = 49
"""Rotor thrusts from force and torques: 4 x 4, row by row."""
TILT_SLOPE = 65
"""Tangent of the tilt that the controller aims at, at most."""
PARAMETERS = 66
"""Columns of a parameter row."""


@dataclass(frozen=True, slots=True)
class Gains:
    """Gains of the backstepping law (2.25) and of the yaw law (2.26); positive.

    Parameters
    ----------
    alpha : float
        Weight of the position error in V1, 1/m².
    beta : float
        Weight of the first backstepping error in V2, s²/m².
    gamma : float
        Weight of the attitude error in V3.
    k1 : float
        1/s.
    k2 : float
        s.
    k_theta, k_yaw : float
        1/s.
    """

    alpha: float
    beta: float
    gamma: float
    k1: float
    k2: float
    k_theta: float
    k_yaw: float


@dataclass(frozen=True, slots=True)
class Limits:
    """What a vehicle is asked for at most.

    Parameters
    ----------
    max_tilt : float
        Angle between body z and the vertical, rad.
    max_rate : float
        Roll and pitch rate together, rad/s.
    max_yaw_rate : float
        rad/s.
    min_thrust, max_thrust : float
        Normalised thrust, m/s².
    max_speed, max_acceleration, max_jerk : float
        Of references, m/s, m/s², m/s³.
    """

    max_tilt: float
    max_rate: float
    max_yaw_rate: float
    min_thrust: float
    max_thrust: float
    max_speed: float
    max_acceleration: float
    max_jerk: float


@dataclass(frozen=True, eq=False)
class VehicleParameters:
    """A quadrotor.

    Parameters
    ----------
    name : str
    mass : float
        kg.
    inertia : tuple of float
        Principal moments about the body axes, kg m².
    rotor_positions_B : array, shape (4, 2)
        x and y of the rotors in the body frame, m.
    rotor_spins : array, shape (4,)
        1 for a rotor that turns counter-clockwise seen from above (its drag torque on the body is negative about z),
        else -1.
    thrust_coefficient : float
        Thrust over squared rotor speed, N s².
    moment_ratio : float
        Drag torque over thrust, m.
    rotor_drag : float
        Force across the rotor's axis over rotor speed and airspeed, N s²/m.
    rotor_time_constant_up, rotor_time_constant_down : float
        First-order lag of a rotor that speeds up or slows down, s.
    rotor_speed_min, rotor_speed_max : float
        rad/s.
    body_drag : tuple of float
        Force over airspeed along the body axes, N s/m.
    body_radius, body_height : float
        Half the distance from tip to tip, and the height, m.
    rate_gains : tuple of float
        Of the inner loop, 1/s.
    rotor_lead : float
        How much harder than needed rotors are driven, to shorten their lag; 1 for not at all.
    gains : Gains
    limits : Limits
    margin : float
        Distance that two vehicles keep between their tips, m.
    vertical_ratio : float
        Vertical offsets count as much less than horizontal ones in separation.
    endurance : float
        How long a full battery lasts in hover, s; NaN where unknown.
    """

    name: str
    mass: float
    inertia: tuple[float, float, float]
    rotor_positions_B: NDArray[np.float64]
    rotor_spins: NDArray[np.float64]
    thrust_coefficient: float
    moment_ratio: float
    rotor_drag: float
    rotor_time_constant_up: float
    rotor_time_constant_down: float
    rotor_speed_min: float
    rotor_speed_max: float
    body_drag: tuple[float, float, float]
    body_radius: float
    body_height: float
    rate_gains: tuple[float, float, float]
    rotor_lead: float
    gains: Gains
    limits: Limits
    margin: float
    vertical_ratio: float
    endurance: float = math.nan

    @property
    def required_separation(self) -> float:
        """Least scaled distance between the centres of two such vehicles, m."""
        return 2.0 * self.body_radius + self.margin

    @property
    def keep_off(self) -> float:
        """Distance from its centre that it keeps from obstacles, m."""
        return self.body_radius + 0.5 * self.margin

    @property
    def hover_speed(self) -> float:
        """Rotor speed that carries the weight, rad/s.

        >>> print(f"{load_vehicle('iris').hover_speed:.1f}")
        643.2
        """
        return math.sqrt(self.mass * GRAVITY / (4.0 * self.thrust_coefficient))

    @property
    def mixer(self) -> NDArray[np.float64]:
        """Total thrust (N) and torques about the body axes (N m) from the rotors' thrusts (N), shape (4, 4)."""
        x, y = self.rotor_positions_B.T
        return np.array([np.ones(4), y, -x, -self.moment_ratio * self.rotor_spins])

    def row(self) -> NDArray[np.float64]:
        """Pack all of it, and the inverse of the mixer, into one row for the kernels, shape (PARAMETERS,)."""
        gains, limits = self.gains, self.limits
        return np.concatenate(
            [
                [self.mass, *self.inertia],
                self.rotor_positions_B.ravel(),
                self.rotor_spins,
                [self.thrust_coefficient, self.moment_ratio, self.rotor_drag],
                [self.rotor_time_constant_up, self.rotor_time_constant_down],
                [self.rotor_speed_min, self.rotor_speed_max, *self.body_drag, self.body_radius, self.body_height],
                [*self.rate_gains, self.rotor_lead],
                [gains.alpha, gains.beta, gains.gamma, gains.k1, gains.k2, gains.k_theta, gains.k_yaw],
                [limits.max_tilt, limits.max_rate, limits.max_yaw_rate, limits.min_thrust, limits.max_thrust],
                [limits.max_speed, limits.max_acceleration, limits.max_jerk, self.margin, self.vertical_ratio],
                np.linalg.inv(self.mixer).ravel(),
                [math.tan(TILT_RESERVE * limits.max_tilt)],
            ]
        )


@dataclass(frozen=True, slots=True)
class _Entry:
    """What the loader expects of a key: its unit, the shape of its value, the least value allowed, and whether it must
    be there, else it is NaN.
    """

    unit: str
    shape: tuple[int, ...] = ()
    positive: bool = True
    any_sign: bool = False
    required: bool = True


_SCHEMA: dict[str, _Entry] = {
    "body.mass": _Entry("kg"),
    "body.inertia": _Entry("kg m^2", (3,)),
    "body.radius": _Entry("m"),
    "body.height": _Entry("m"),
    "body.drag": _Entry("N s/m", (3,), positive=False),
    "rotors.positions": _Entry("m", (4, 2), any_sign=True),
    "rotors.spins": _Entry("1", (4,), any_sign=True),
    "rotors.thrust_coefficient": _Entry("N s^2"),
    "rotors.moment_ratio": _Entry("m"),
    "rotors.drag": _Entry("N s^2/m", positive=False),
    "rotors.time_constant_up": _Entry("s"),
    "rotors.time_constant_down": _Entry("s"),
    "rotors.speed_min": _Entry("rad/s", positive=False),
    "rotors.speed_max": _Entry("rad/s"),
    "rate_loop.gains": _Entry("1/s", (3,)),
    "rate_loop.rotor_lead": _Entry("1"),
    "gains.alpha": _Entry("1/m^2"),
    "gains.beta": _Entry("s^2/m^2"),
    "gains.gamma": _Entry("1"),
    "gains.k1": _Entry("1/s"),
    "gains.k2": _Entry("s"),
    "gains.k_theta": _Entry("1/s"),
    "gains.k_yaw": _Entry("1/s"),
    "limits.max_tilt": _Entry("deg"),
    "limits.max_rate": _Entry("deg/s"),
    "limits.max_yaw_rate": _Entry("deg/s"),
    "limits.min_thrust": _Entry("m/s^2"),
    "limits.max_thrust": _Entry("m/s^2"),
    "limits.max_speed": _Entry("m/s"),
    "limits.max_acceleration": _Entry("m/s^2"),
    "limits.max_jerk": _Entry("m/s^3"),
    "separation.margin": _Entry("m", positive=False),
    "separation.vertical_ratio": _Entry("1"),
    "battery.endurance": _Entry("s", required=False),
}
_TO_SI = {"deg": math.pi / 180.0, "deg/s": math.pi / 180.0}


def vehicle_names() -> tuple[str, ...]:
    """Names of the vehicles that come with covey.

    >>> vehicle_names()
    ('crazyflie', 'iris')
    """
    return tuple(sorted(path.stem for path in FOLDER.glob("*.toml")))


def load_vehicle(name_or_path: str | Path) -> VehicleParameters:
    """Read a vehicle: one that comes with covey, by its name, or any TOML file of the same form.

    Parameters
    ----------
    name_or_path : str or Path
        Each value of the file is a table ``{ value = ..., unit = "...", source = "..." }``; see ``params/iris.toml``.

    Raises
    ------
    InputError
        If there is no such vehicle or file, or it is wrong: all its mistakes, one a line, with file and key.

    Examples
    --------
    >>> load_vehicle("iris").mass
    1.442
    """
    names = vehicle_names()
    if str(name_or_path) in names:
        path = FOLDER / f"{name_or_path}.toml"
    else:
        path = Path(name_or_path)
        if path.suffix != ".toml":
            near = difflib.get_close_matches(str(name_or_path), names, n=1)
            hint = f" (did you mean {near[0]}?)" if near else ""
            known = ", ".join(names)
            raise InputError(f"vehicle: expected one of {known} or a .toml file, got {str(name_or_path)!r}{hint}")
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise InputError(f"{path}: expected a TOML file with a vehicle's parameters; there is no such file") from error
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise InputError(f"{path}: expected a TOML file with a vehicle's parameters, got: {reason}") from error
    return _build(document, str(path))


def _build(document: Mapping[str, Any], file: str) -> VehicleParameters:
    mistakes: list[str] = []
    values = {key: _value(document, key, entry, file, mistakes) for key, entry in _SCHEMA.items()}
    mistakes += _unknown(document, file)
    name = document.get("name")
    if not isinstance(name, str) or not name:
        mistakes.append(f"{file}: name: expected a text, got {name!r}")
    if not mistakes:
        mistakes = _contradictions(values, file)
    if mistakes:
        raise InputError("\n".join(mistakes))

    def number(key: str) -> float:
        return float(values[key])

    def three(key: str) -> tuple[float, float, float]:
        x, y, z = values[key]
        return float(x), float(y), float(z)

    def section(prefix: str) -> dict[str, float]:
        return {key.removeprefix(prefix): number(key) for key in _SCHEMA if key.startswith(prefix)}

    positions, spins = values["rotors.positions"], values["rotors.spins"]
    positions.flags.writeable = spins.flags.writeable = False
    return VehicleParameters(
        name=str(name),
        mass=number("body.mass"),
        inertia=three("body.inertia"),
        rotor_positions_B=positions,
        rotor_spins=spins,
        thrust_coefficient=number("rotors.thrust_coefficient"),
        moment_ratio=number("rotors.moment_ratio"),
        rotor_drag=number("rotors.drag"),
        rotor_time_constant_up=number("rotors.time_constant_up"),
        rotor_time_constant_down=number("rotors.time_constant_down"),
        rotor_speed_min=number("rotors.speed_min"),
        rotor_speed_max=number("rotors.speed_max"),
        body_drag=three("body.drag"),
        body_radius=number("body.radius"),
        body_height=number("body.height"),
        rate_gains=three("rate_loop.gains"),
        rotor_lead=number("rate_loop.rotor_lead"),
        gains=Gains(**section("gains.")),
        limits=Limits(**section("limits.")),
        margin=number("separation.margin"),
        vertical_ratio=number("separation.vertical_ratio"),
        endurance=number("battery.endurance"),
    )


def _value(document: Mapping[str, Any], key: str, entry: _Entry, file: str, mistakes: list[str]) -> NDArray[np.float64]:
    """Check one entry and return its value in SI units; what is wrong goes to `mistakes`."""

    def wrong(what: str) -> NDArray[np.float64]:
        mistakes.append(f"{file}: {key}: {what}")
        return np.full(entry.shape, np.nan)

    section, _, name = key.partition(".")
    table = document.get(section)
    given = table.get(name) if isinstance(table, Mapping) else None
    if given is None and not entry.required:
        return np.full(entry.shape, np.nan)
    if given is None:
        return wrong(f'missing; expected {{ value = ..., unit = "{entry.unit}", source = "..." }}')
    if not isinstance(given, Mapping) or set(given) != {"value", "unit", "source"}:
        return wrong(f"expected a table with value, unit and source, got {given!r}")
    if given["unit"] != entry.unit:
        return wrong(f'expected unit "{entry.unit}", got {given["unit"]!r}')
    if not isinstance(given["source"], str) or not given["source"].strip():
        return wrong(f"expected a source, where the value comes from, got {given['source']!r}")
    try:
        value = np.array(given["value"], dtype=np.float64)
    except (TypeError, ValueError):
        return wrong(f"expected numbers, got {given['value']!r}")
    if value.shape != entry.shape or isinstance(given["value"], str | bool):
        expected = f"numbers of shape {entry.shape}" if entry.shape else "a number"
        return wrong(f"expected {expected}, got {given['value']!r}")
    if not np.isfinite(value).all():
        return wrong(f"expected finite numbers, got {given['value']!r}")
    if not entry.any_sign and bool((value <= 0.0 if entry.positive else value < 0.0).any()):
        return wrong(f"expected {'more than 0' if entry.positive else '0 or more'}, got {given['value']!r}")
    return value * _TO_SI.get(entry.unit, 1.0)


def _unknown(document: Mapping[str, Any], file: str) -> list[str]:
    """Tell of keys that nothing reads."""
    present = {
        f"{section}.{name}" if isinstance(table, Mapping) else section
        for section, table in document.items()
        for name in (table if isinstance(table, Mapping) else ("",))
    }
    mistakes = []
    for key in sorted(present - set(_SCHEMA) - {"name"}):
        near = difflib.get_close_matches(key, _SCHEMA, n=1)
        mistakes.append(f"{file}: {key}: unknown key{f' (did you mean {near[0]}?)' if near else ''}")
    return mistakes


def _contradictions(values: Mapping[str, NDArray[np.float64]], file: str) -> list[str]:
    """Tell of values that cannot hold together."""
    mistakes = []
    positions, spins = values["rotors.positions"], values["rotors.spins"]
    if not np.isin(spins, (-1.0, 1.0)).all():
        mistakes.append(f"{file}: rotors.spins: expected 1 or -1 each, got {spins.tolist()}")
    else:
        mixer = np.array([np.ones(4), positions[:, 1], -positions[:, 0], -spins])
        if np.linalg.cond(mixer) > 1e6 or bool((np.linalg.inv(mixer)[:, 0] <= 0.0).any()):
            mistakes.append(
                f"{file}: rotors.positions: with these spins the rotors cannot hover and turn about all axes"
            )
    strongest = 4.0 * values["rotors.thrust_coefficient"] * values["rotors.speed_max"] ** 2 / values["body.mass"]
    if strongest <= GRAVITY:
        mistakes.append(
            f"{file}: rotors.speed_max: expected rotors that lift the vehicle, got {strongest:.2f} m/s^2 of {GRAVITY}"
        )
    pairs = (("rotors.speed_min", "rotors.speed_max"), ("limits.min_thrust", "limits.max_thrust"))
    for low, high in pairs:
        if values[low] >= values[high]:
            mistakes.append(f"{file}: {low}: expected less than {high} = {values[high]:g}, got {values[low]:g}")
    if not values["limits.min_thrust"] < GRAVITY < values["limits.max_thrust"]:
        mistakes.append(f"{file}: limits.max_thrust: expected gravity, {GRAVITY}, between min_thrust and max_thrust")
    if not values["limits.max_tilt"] < 0.5 * math.pi:
        mistakes.append(f"{file}: limits.max_tilt: expected less than 90 deg")
    if values["rate_loop.rotor_lead"] < 1.0:
        mistakes.append(f"{file}: rate_loop.rotor_lead: expected 1 or more, got {values['rate_loop.rotor_lead']:g}")
    if values["separation.vertical_ratio"] < 1.0:
        mistakes.append(f"{file}: separation.vertical_ratio: expected 1 or more")
    return mistakes
