"""The control law written down again with numpy and matrices, as corrected and, by choice, as printed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from covey.flight.layout import GRAVITY
from covey.flight.parameters import Gains

E3 = np.array([0.0, 0.0, 1.0])


def matrix(quat: np.ndarray) -> np.ndarray:
    """R, body to world."""
    w, v = quat[0], quat[1:4]
    cross = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    return np.asarray(np.eye(3) + 2.0 * w * cross + 2.0 * cross @ cross)


@dataclass(frozen=True)
class Law:
    """(2.25) and (2.26); each switch restores what the thesis prints.

    Parameters
    ----------
    gains : Gains
    printed_coupling : bool
        C1: ``+ (1/gamma) |u| S(n)(e_v + k1 e_p)``.
    printed_k_p : bool
        C2: ``kP = (alpha/beta)(k1 k2 - 1)``.
    no_feedforward : bool
        C7: omega* is never given; zero.
    printed_yaw : bool
        C6: the rate about n is the yaw rate.
    """

    gains: Gains
    printed_coupling: bool = False
    printed_k_p: bool = False
    no_feedforward: bool = False
    printed_yaw: bool = False

    def axes(self, x: np.ndarray, reference: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Return n, n* and |u|."""
        g = self.gains
        k_p = g.alpha / g.beta * (g.k1 * g.k2 + (-1.0 if self.printed_k_p else 1.0))
        k_d = g.k1 + g.alpha / g.beta * g.k2
        u = reference[6:9] + GRAVITY * E3 - k_p * (x[:3] - reference[:3]) - k_d * (x[3:6] - reference[3:6])
        length = float(np.linalg.norm(u))
        return matrix(x[6:10])[:, 2], u / length, length

    def __call__(self, x: np.ndarray, reference: np.ndarray) -> tuple[float, np.ndarray, float]:
        """Return thrust, omega_B and V3."""
        g = self.gains
        k_p = g.alpha / g.beta * (g.k1 * g.k2 + (-1.0 if self.printed_k_p else 1.0))
        k_d = g.k1 + g.alpha / g.beta * g.k2
        rotation = matrix(x[6:10])
        n, wanted, length = self.axes(x, reference)
        e_p, e_v = x[:3] - reference[:3], x[3:6] - reference[3:6]
        thrust = length * float(wanted @ n)
        change = reference[9:12] - k_p * e_v - k_d * (thrust * n - GRAVITY * E3 - reference[6:9])
        turn = (np.eye(3) - np.outer(wanted, wanted)) @ change / length
        omega = np.zeros(3) if self.no_feedforward else np.cross(wanted, turn)
        coupling = np.cross(n, e_v + g.k1 * e_p) * length / g.gamma
        omega = omega + (coupling if self.printed_coupling else -g.beta * coupling) + g.k_theta * np.cross(n, wanted)
        omega_B = rotation.T @ (omega - n * (n @ omega))
        yaw = np.arctan2(rotation[1, 0], rotation[0, 0])
        pitch, roll = -np.arcsin(np.clip(rotation[2, 0], -1.0, 1.0)), np.arctan2(rotation[2, 1], rotation[2, 2])
        rate = reference[13] - g.k_yaw * np.sin(yaw - reference[12])
        if not self.printed_yaw:
            rate = (rate * np.cos(pitch) - omega_B[1] * np.sin(roll)) / np.cos(roll)
        omega_B[2] = rate
        e_1 = e_v + g.k1 * e_p
        v3 = 0.5 * g.alpha * e_p @ e_p + 0.5 * g.beta * e_1 @ e_1 + g.gamma * (1.0 - n @ wanted)
        return thrust, omega_B, float(v3)

    def fly(
        self, trajectory: Callable[[float], np.ndarray], duration: float, dt: float = 0.02, *, on_it: bool = False
    ) -> tuple[np.ndarray, np.ndarray]:
        """Fly (2.2) from the origin, level and at rest, or `on_it`; return states, (k, 10), and V3, (k,)."""

        def slope(time: float, x: np.ndarray) -> np.ndarray:
            thrust, omega, _ = self(x, trajectory(time))
            w, v = x[6], x[7:10]
            spin = [-0.5 * v @ omega, *(0.5 * (w * omega + np.cross(v, omega)))]
            return np.concatenate([x[3:6], thrust * matrix(x[6:10])[:, 2] - GRAVITY * E3, spin])

        x = np.array([0.0] * 6 + [1.0, 0.0, 0.0, 0.0])
        if on_it:
            x[:6] = trajectory(0.0)[:6]
            u = trajectory(0.0)[6:9] + GRAVITY * E3
            x[6:10] = np.array([np.linalg.norm(u) + u[2], -u[1], u[0], 0.0])
            x[6:10] /= np.linalg.norm(x[6:10])
        states, values = [x], [self(x, trajectory(0.0))[2]]
        for k in range(round(duration / dt)):
            t = k * dt
            a = slope(t, x)
            b = slope(t + 0.5 * dt, x + 0.5 * dt * a)
            c = slope(t + 0.5 * dt, x + 0.5 * dt * b)
            d = slope(t + dt, x + dt * c)
            x = x + dt / 6.0 * (a + 2.0 * b + 2.0 * c + d)
            x[6:10] /= np.linalg.norm(x[6:10])
            states.append(x)
            values.append(self(x, trajectory(t + dt))[2])
        return np.array(states), np.array(values)
