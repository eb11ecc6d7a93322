"""Gains and limits of a vehicle's reference, derived from its body and limits, checked when made."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from covey.errors import ArgumentError
from covey.flight.parameters import VehicleParameters
from covey.flight.separation import check_separation, safe_speed, turning_acceleration


@dataclass(frozen=True)
class NavigationOptions:
    """Gains and limits of one vehicle's reference; `for_vehicle` has sensible ones.

    Parameters
    ----------
    separation : float
        Required scaled separation from a vehicle of the same kind, metres; of two kinds, the mean counts.
    vertical_ratio : float
        Vertical offsets between vehicles are divided by it; of two kinds, the larger counts.
    max_speed, max_acceleration : float
        Limits of the reference, m/s and m/s².
    brake_acceleration : float
        What speed caps count on, m/s².
    k_wp, k_v, k_rep, threshold : float
        As in `covey.flight.potential_field.FieldGains`.
    filter_time : float
        Of the low-pass that gives the reference a jerk: at most 2 max_acceleration / filter_time, s.
    lag : float
        What a vehicle lags behind its virtual one, s: the filter's time and what tracking takes.
    reaction_time : float
        Delay that speed caps allow for, s; also how fast a gap closes exponentially at the end of an approach.
    tracking_reset : float
        Distance between reference and measured position beyond which the reference is pulled along, metres.
    allowance : float
        What is kept beyond the required separation on the way, for tracking errors; fades near one's own goal, metres.
    keep_off : float
        Distance to keep from obstacles, metres.
    floor, ceiling : float
        Altitudes that are not left unless a goal lies beyond, metres.
    max_yaw_rate, yaw_acceleration : float
        rad/s and rad/s².
    arrival : float
        Path left below which a reference has arrived, metres.
    corner : float
        Distance at which a corner of a route counts as passed, metres.
    stall_time : float
        Seconds without progress until a vehicle tries another way.
    escapes : int
        Other ways tried, without coming half a metre closer, until a vehicle is blocked.

    Raises
    ------
    ArgumentError
        If a number is out of range, or two vehicles would not stay apart: see `check_separation`.
    """

    separation: float
    vertical_ratio: float
    max_speed: float
    max_acceleration: float
    brake_acceleration: float
    k_rep: float
    threshold: float
    keep_off: float
    k_wp: float = 4.0
    k_v: float = 4.0
    filter_time: float = 0.4
    lag: float = 0.5
    reaction_time: float = 0.3
    tracking_reset: float = 0.5
    allowance: float = 0.05
    floor: float = 0.5
    ceiling: float = math.inf
    max_yaw_rate: float = 1.0
    yaw_acceleration: float = 1.0
    arrival: float = 0.02
    corner: float = 0.3
    stall_time: float = 4.0
    escapes: int = 8

    def __post_init__(self) -> None:
        from_zero = {"allowance", "k_rep", "floor", "escapes"}
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            good = value >= 0.0 if field.name in from_zero else value > 0.0
            if not good or (math.isinf(value) and field.name != "ceiling"):
                least = "from zero" if field.name in from_zero else "above zero"
                raise ArgumentError(f"{field.name}: expected a finite number {least}, got {value!r}")
        if self.vertical_ratio < 1.0:
            raise ArgumentError(f"vertical_ratio: expected at least 1, got {self.vertical_ratio}")
        if self.ceiling <= self.floor:
            raise ArgumentError(f"ceiling: expected more than floor = {self.floor} m, got {self.ceiling}")
        check_separation(
            required=self.separation,
            k_rep=self.k_rep,
            threshold=self.threshold,
            max_speed=self.max_speed,
            max_acceleration=self.max_acceleration,
            brake_acceleration=self.brake_acceleration,
        )

    @classmethod
    def for_vehicle(cls, parameters: VehicleParameters, **overrides: Any) -> NavigationOptions:
        """Derive options from a vehicle's body and limits.

        Half of its acceleration is for braking and a quarter for turning, which may lower the speed limit.  The field
        reaches as far as it takes to brake, and is just strong enough to keep two vehicles apart on its own (P4).

        Examples
        --------
        >>> from covey.flight.parameters import load_vehicle
        >>> options = NavigationOptions.for_vehicle(load_vehicle("iris"))
        >>> round(options.max_speed, 2), round(options.threshold, 2), round(options.k_rep, 1)
        (1.39, 3.71, 6.3)
        """
        limits, separation = parameters.limits, parameters.required_separation
        given: dict[str, Any] = {
            "separation": separation,
            "vertical_ratio": parameters.vertical_ratio,
            "max_acceleration": limits.max_acceleration,
            "keep_off": parameters.keep_off,
            "max_yaw_rate": min(1.0, 0.5 * limits.max_yaw_rate),
        }
        given.update(overrides)
        acceleration = given["max_acceleration"]
        given.setdefault("filter_time", max(0.1, 2.0 * acceleration / limits.max_jerk))
        given.setdefault("lag", given["filter_time"] + 0.1)
        given.setdefault("reaction_time", 0.6 * given["lag"])
        given.setdefault("allowance", min(0.05, 0.1 * given["separation"]))
        given.setdefault("corner", min(0.3, given["keep_off"]))
        given.setdefault("brake_acceleration", 0.5 * acceleration)
        brake = given["brake_acceleration"]
        turn = min(0.25 * acceleration, acceleration - brake)
        slow = _turning_speed(turn, given["separation"])
        given.setdefault("max_speed", min(limits.max_speed, slow))
        speed = given["max_speed"]
        stopping = 2.0 * speed * given["reaction_time"] + speed * speed / brake
        given.setdefault("threshold", given["separation"] + max(stopping, 0.5 * given["separation"]))
        unit = safe_speed(1.0, given["threshold"], given["separation"])
        given.setdefault("k_rep", 1.001 * (2.0 * speed / unit) ** 2)
        return cls(**given)

    def row(self) -> NDArray[np.float64]:
        """Pack for the kernels, shape (OPTIONS,)."""
        return np.array(
            [
                *(self.k_wp, self.k_v, self.k_rep, self.threshold, self.max_speed, self.max_acceleration),
                *(self.brake_acceleration, self.filter_time, self.reaction_time, self.tracking_reset),
                *(self.separation, self.vertical_ratio, self.allowance, self.keep_off, self.floor, self.ceiling),
                *(self.max_yaw_rate, self.yaw_acceleration, self.arrival, self.corner, self.lag),
            ],
            dtype=np.float64,
        )


def fastest(parameters: VehicleParameters) -> float:
    """Return the largest speed limit with which vehicles can keep apart, m/s: half their acceleration is for turning.

    Examples
    --------
    >>> from covey.flight.parameters import load_vehicle
    >>> iris = load_vehicle("iris")
    >>> round(fastest(iris), 2), NavigationOptions.for_vehicle(iris, max_speed=0.999 * fastest(iris)).max_speed > 1.9
    (1.96, True)
    """
    return _turning_speed(0.5 * parameters.limits.max_acceleration, parameters.required_separation)


def _turning_speed(acceleration: float, separation: float) -> float:
    """Speed at which being overtaken costs this acceleration, m/s."""
    return math.sqrt(acceleration / turning_acceleration(separation, 1.0)) if acceleration > 0.0 else 0.0
