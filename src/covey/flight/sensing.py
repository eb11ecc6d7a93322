"""What is measured of a fleet: states with noise, and late."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from covey.errors import ArgumentError
from covey.flight.layout import OBSERVATION, OMEGA, QUAT, P, V


@dataclass(frozen=True, slots=True)
class SensorNoise:
    """Errors of measurement: white, Gaussian, independent in each axis.

    Parameters
    ----------
    position_std : float
        m.
    velocity_std : float
        m/s.
    attitude_std : float
        Of the small rotation between true and measured attitude, rad.
    rate_std : float
        rad/s.
    latency : float
        Age of what is measured, s.

    Raises
    ------
    ArgumentError
        If one is negative or not finite.
    """

    position_std: float = 0.0
    velocity_std: float = 0.0
    attitude_std: float = 0.0
    rate_std: float = 0.0
    latency: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not (math.isfinite(value) and value >= 0.0):
                raise ArgumentError(f"{field.name}: expected a finite number of 0 or more, got {value!r}")


class Observer:
    """Turns states into observations.

    Parameters
    ----------
    noise : SensorNoise
    rng : numpy.random.Generator
        The only source of randomness.

    Notes
    -----
    States come in with `record`, once a control period; what is observed is the newest of them that is `latency` old
    or older (the oldest there is, at the beginning).  Observing twice at one moment gives the same twice.
    """

    def __init__(self, noise: SensorNoise, rng: np.random.Generator) -> None:
        self._noise, self._rng = noise, rng
        self._past: deque[tuple[float, NDArray[np.float64]]] = deque()
        self._seen: NDArray[np.float64] | None = None

    def record(self, time: float, state: NDArray[np.float64]) -> None:
        """Take in the states at a time, shape (n, OBSERVATION) or wider; times rise."""
        self._past.append((time, state[:, :OBSERVATION].copy()))
        while len(self._past) > 1 and self._past[1][0] <= time - self._noise.latency + 1e-9:
            self._past.popleft()
        self._seen = None

    def replace(self, vehicle: int, state: NDArray[np.float64]) -> None:
        """Let a vehicle have been in this state, shape (OBSERVATION,) or wider, all the time."""
        for _, past in self._past:
            past[vehicle] = state[:OBSERVATION]
        self._seen = None

    def observe(self) -> NDArray[np.float64]:
        """Measure now: shape (n, OBSERVATION).

        Raises
        ------
        ArgumentError
            If nothing has been recorded.
        """
        if not self._past:
            raise ArgumentError("observe: expected a recorded state, got none; call record first")
        if self._seen is None:
            self._seen = self._measure(self._past[0][1])
        return self._seen.copy()

    def _measure(self, state: NDArray[np.float64]) -> NDArray[np.float64]:
        noise, n = self._noise, len(state)
        seen = state.copy()
        stds = (noise.position_std, noise.velocity_std, noise.attitude_std, noise.rate_std)
        if not any(stds):
            return seen
        errors = self._rng.standard_normal((n, 4, 3)) * np.array(stds)[None, :, None]
        seen[:, P : P + 3] += errors[:, 0]
        seen[:, V : V + 3] += errors[:, 1]
        seen[:, OMEGA : OMEGA + 3] += errors[:, 3]
        if noise.attitude_std > 0.0:
            # q times the exponential of half the rotation vector, frame B
            half = 0.5 * errors[:, 2]
            angle = np.linalg.norm(half, axis=1, keepdims=True)
            scalar, vector = np.cos(angle), np.sinc(angle / np.pi) * half
            w, axis = state[:, QUAT : QUAT + 1], state[:, QUAT + 1 : OMEGA]
            seen[:, QUAT : QUAT + 1] = w * scalar - np.sum(axis * vector, axis=1, keepdims=True)
            seen[:, QUAT + 1 : OMEGA] = w * vector + scalar * axis + np.cross(axis, vector)
            seen[:, QUAT:OMEGA] /= np.linalg.norm(seen[:, QUAT:OMEGA], axis=1, keepdims=True)
        return seen
