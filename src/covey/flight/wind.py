"""Wind: a steady part and gusts, partly the same for all vehicles."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from covey.errors import ArgumentError


@dataclass(frozen=True, slots=True)
class Wind:
    """What the air does.

    Parameters
    ----------
    mean_W : three floats
        Steady velocity, frame W, m/s.
    gust_std : float
        Standard deviation of the gusts' horizontal components, m/s.
    gust_std_vertical : float or None
        That of the vertical component, m/s; half of `gust_std` by default.
    time_constant : float
        Gusts forget themselves with ``exp(-t / time_constant)``, s.
    common : float
        Share of the gusts' variance that all vehicles meet alike, 0 to 1.

    Raises
    ------
    ArgumentError
        If a number is not finite or out of its range.
    """

    mean_W: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gust_std: float = 0.0
    gust_std_vertical: float | None = None
    time_constant: float = 2.0
    common: float = 0.5

    def __post_init__(self) -> None:
        if len(self.mean_W) != 3 or not all(map(math.isfinite, self.mean_W)):
            raise ArgumentError(f"mean_W: expected three finite numbers (m/s), got {self.mean_W!r}")
        for name, value in (("gust_std", self.gust_std), ("gust_std_vertical", self.gust_std_vertical or 0.0)):
            if not (math.isfinite(value) and value >= 0.0):
                raise ArgumentError(f"{name}: expected a finite number of 0 or more (m/s), got {value!r}")
        if not (math.isfinite(self.time_constant) and self.time_constant > 0.0):
            raise ArgumentError(f"time_constant: expected a finite number above 0 (s), got {self.time_constant!r}")
        if not 0.0 <= self.common <= 1.0:
            raise ArgumentError(f"common: expected a share from 0 to 1, got {self.common!r}")


class WindField:
    """The air around n vehicles as time goes on: an Ornstein-Uhlenbeck process, sampled exactly.

    Parameters
    ----------
    wind : Wind
    n : int
    rng : numpy.random.Generator
        The only source of randomness: the same generator and the same steps give the same gusts.

    Examples
    --------
    >>> field = WindField(Wind((3.0, 0.0, 0.0)), 2, np.random.default_rng(0))
    >>> field.advance(0.01)
    array([[3., 0., 0.],
           [3., 0., 0.]])
    """

    def __init__(self, wind: Wind, n: int, rng: np.random.Generator) -> None:
        self._wind, self._rng = wind, rng
        self._mean = np.array(wind.mean_W)
        vertical = 0.5 * wind.gust_std if wind.gust_std_vertical is None else wind.gust_std_vertical
        std = np.array([wind.gust_std, wind.gust_std, vertical])
        self._stds = np.concatenate(
            [math.sqrt(wind.common) * std[None, :], np.tile(math.sqrt(1.0 - wind.common) * std, (n, 1))]
        )
        # row 0 is the common part; gusts begin as they go on, so that there is no lull at the start
        self._gusts = self._stds * rng.standard_normal(self._stds.shape)
        self._calm = not self._stds.any()

    @property
    def velocity_W(self) -> NDArray[np.float64]:
        """Velocity of the air at each vehicle now, frame W, m/s, shape (n, 3)."""
        air: NDArray[np.float64] = self._mean + self._gusts[0] + self._gusts[1:]
        return air

    def advance(self, duration: float) -> NDArray[np.float64]:
        """Let time pass, in seconds, and return `velocity_W`."""
        if not self._calm:
            keep = math.exp(-duration / self._wind.time_constant)
            fresh = math.sqrt(1.0 - keep * keep) * self._rng.standard_normal(self._gusts.shape)
            self._gusts = keep * self._gusts + self._stds * fresh
        return self.velocity_W
