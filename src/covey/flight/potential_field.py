"""Attraction to a goal and repulsion from what is in the way, as accelerations.

Distances between vehicles are scaled: vertical offsets count 1 / `vertical_ratio`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from covey.compiled import kernel
from covey.errors import ArgumentError

GUARD = 0.02
"""Distances below this part of the threshold repel no more strongly than it: the field stays finite at d = 0."""

STEEP = 0.3
"""Where the horizontal part of a unit vector is below this, the lateral term sets in."""


@dataclass(frozen=True)
class FieldGains:
    """Gains of the potential field.

    Parameters
    ----------
    k_wp : float
        Attraction, 1/s².
    k_v : float
        Damping, 1/s.
    k_rep : float
        Repulsion, m²/s²; 0 for none.
    threshold : float
        Scaled distance below which others repel, metres (the thesis's ς).
    vertical_ratio : float
        Vertical offsets are divided by it.

    Raises
    ------
    ArgumentError
        If a gain is negative or not finite, or threshold or vertical_ratio is not above zero.
    """

    k_wp: float
    k_v: float
    k_rep: float = 0.0
    threshold: float = 1.0
    vertical_ratio: float = 1.0

    def __post_init__(self) -> None:
        for name in ("k_wp", "k_v", "k_rep", "threshold", "vertical_ratio"):
            value = getattr(self, name)
            positive = name in ("threshold", "vertical_ratio")
            if not math.isfinite(value) or value < 0.0 or (positive and value == 0.0):
                raise ArgumentError(f"{name}: expected a number {'above' if positive else 'from'} zero, got {value!r}")


@kernel
def repulsion(d: float, k_rep: float, threshold: float) -> float:
    """Strength of the radial term at distance d, m/s²: ½ k_rep (1/d − 1/ς) below ς, else 0."""
    if d >= threshold:
        return 0.0
    return 0.5 * k_rep * (1.0 / max(d, GUARD * threshold) - 1.0 / threshold)


@kernel
def add_repulsion(
    dx: float,
    dy: float,
    dz: float,
    order: float,
    ratio: float,
    k_rep: float,
    threshold: float,
    weight: float,
    out: NDArray[np.float64],
) -> None:
    """Add what another body does to one's acceleration: radial, tangential and lateral term.

    Parameters
    ----------
    dx, dy, dz : float
        From oneself to the other, frame W, metres.
    order : float
        +1 to the one and -1 to the other of a pair; only looked at where both are at the same height.
    ratio, k_rep, threshold : float
        As in `FieldGains`.
    weight : float
        Factor on all three terms.
    out : array, shape (3,)
        Acceleration, frame W, m/s²; is added to.

    Notes
    -----
    Source: Sposato (2016), eq. (3.2).  Deviation: P1, P3.

    The radial term is the gradient of a potential of the scaled distance, so the energy bound of
    `covey.flight.separation.closest_approach` holds along every direction.  The tangential term is the radial one
    turned by +90° about z, for all the same way round.  Where one is (almost) above the other it vanishes; there the
    lateral term sends the upper one towards +x and the lower one towards -x.
    """
    dzs = dz / ratio
    d = math.sqrt(dx * dx + dy * dy + dzs * dzs)
    strength = weight * repulsion(d, k_rep, threshold)
    if strength == 0.0:
        return
    upper = order if dz == 0.0 else (1.0 if dz < 0.0 else -1.0)
    if d < 1e-9:
        out[0] += strength * upper
        return
    gx = -strength * dx / d
    gy = -strength * dy / d
    gz = -strength * dzs / (d * ratio)
    level = math.sqrt(dx * dx + dy * dy) / d
    lateral = strength * upper * max(0.0, 1.0 - level / STEEP)
    out[0] += gx - gy + lateral
    out[1] += gy + gx
    out[2] += gz


@kernel
def _fly(
    positions: NDArray[np.float64],
    velocities: NDArray[np.float64],
    goals: NDArray[np.float64],
    objects: NDArray[np.float64],
    k_wp: float,
    k_v: float,
    k_rep: float,
    threshold: float,
    ratio: float,
    dt: float,
) -> None:
    """Fill positions and velocities, shape (k, n, 3), from their first row on; objects has shape (k, m, 3)."""
    a = np.empty(3)
    n = positions.shape[1]
    for t in range(positions.shape[0] - 1):
        for i in range(n):
            x, y, z = positions[t, i, 0], positions[t, i, 1], positions[t, i, 2]
            for c in range(3):
                a[c] = k_wp * (goals[i, c] - positions[t, i, c]) - k_v * velocities[t, i, c]
            for j in range(n):
                if j != i:
                    order = 1.0 if i < j else -1.0
                    dx, dy, dz = positions[t, j, 0] - x, positions[t, j, 1] - y, positions[t, j, 2] - z
                    add_repulsion(dx, dy, dz, order, ratio, k_rep, threshold, 1.0, a)
            for j in range(objects.shape[1]):
                dx, dy, dz = objects[t, j, 0] - x, objects[t, j, 1] - y, objects[t, j, 2] - z
                add_repulsion(dx, dy, dz, 1.0, ratio, k_rep, threshold, 1.0, a)
            for c in range(3):
                velocities[t + 1, i, c] = velocities[t, i, c] + a[c] * dt
                positions[t + 1, i, c] = positions[t, i, c] + velocities[t + 1, i, c] * dt


def fly_field(
    starts_W: NDArray[np.float64],
    goals_W: NDArray[np.float64],
    gains: FieldGains,
    *,
    duration: float,
    dt: float = 0.005,
    objects_W: NDArray[np.float64] | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Fly a team as double integrators by the potential field alone: the plain law, with no limits.

    Parameters
    ----------
    starts_W, goals_W : arrays, shape (n, 3)
        Frame W, metres.
    gains : FieldGains
    duration, dt : float
        Seconds.
    objects_W : array, shape (m, 3) or (k, m, 3), optional
        What else repels, at rest or at each of the k = round(duration / dt) + 1 instants.

    Returns
    -------
    positions, velocities : arrays, shape (k, n, 3)
        Frame W, metres and m/s.

    Raises
    ------
    ArgumentError
        If shapes do not fit or duration or dt is not above zero.

    Notes
    -----
    Source: Sposato (2016), eq. (3.1), (3.2), section 3.4.  Deviation: P1, P2, P3.

    Examples
    --------
    >>> import numpy as np
    >>> gains = FieldGains(k_wp=1, k_v=5, k_rep=2, threshold=1.5)
    >>> p, _ = fly_field(np.array([[0.0, 0, 0], [2, 0, 0]]), np.array([[2.0, 2, 1], [0, 2, 1]]), gains, duration=30)
    >>> bool(np.linalg.norm(p[:, 0] - p[:, 1], axis=1).min() > 0.5)
    True
    """
    starts, goals = np.asarray(starts_W, dtype=np.float64), np.asarray(goals_W, dtype=np.float64)
    if starts.ndim != 2 or starts.shape[1] != 3 or goals.shape != starts.shape:
        raise ArgumentError(f"starts_W, goals_W: expected shape (n, 3) for both, got {starts.shape}, {goals.shape}")
    if not (duration > 0.0 and dt > 0.0):
        raise ArgumentError(f"duration, dt: expected seconds above zero, got {duration}, {dt}")
    steps = round(duration / dt) + 1
    objects = np.empty((1, 0, 3)) if objects_W is None else np.asarray(objects_W, dtype=np.float64)
    if objects.ndim == 2:
        objects = objects[np.newaxis]
    if objects.ndim != 3 or objects.shape[2] != 3 or objects.shape[0] not in (1, steps):
        raise ArgumentError(f"objects_W: expected shape (m, 3) or ({steps}, m, 3), got {objects.shape}")
    objects = np.ascontiguousarray(np.broadcast_to(objects, (steps, *objects.shape[1:])))
    positions, velocities = np.zeros((steps, *starts.shape)), np.zeros((steps, *starts.shape))
    positions[0] = starts
    g = gains
    _fly(
        positions,
        velocities,
        np.ascontiguousarray(goals),
        objects,
        float(g.k_wp),
        float(g.k_v),
        float(g.k_rep),
        float(g.threshold),
        float(g.vertical_ratio),
        float(dt),
    )
    return positions, velocities
