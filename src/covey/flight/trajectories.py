"""References to track: each is called with the time, s, and returns a row of shape (REFERENCE,)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from covey.errors import ArgumentError
from covey.flight.layout import REF_A, REF_J, REF_P, REF_V, REF_YAW, REF_YAW_RATE, REFERENCE


class Trajectory(Protocol):
    """Something to track."""

    def __call__(self, time: float) -> NDArray[np.float64]:
        """Return the reference at a time in seconds, shape (REFERENCE,)."""
        ...


@dataclass(frozen=True, slots=True)
class Hold:
    """Stay at a point.

    Parameters
    ----------
    p_W : three floats
        Frame W, m.
    yaw : float
        rad.

    Examples
    --------
    >>> Hold((1.0, 3.0, 2.0))(0.5)[:3]
    array([1., 3., 2.])
    """

    p_W: Sequence[float]
    yaw: float = 0.0

    def __call__(self, time: float) -> NDArray[np.float64]:
        """Return the reference, the same at any time."""
        reference = np.zeros(REFERENCE)
        reference[REF_P : REF_P + 3] = self.p_W
        reference[REF_YAW] = self.yaw
        return reference


@dataclass(frozen=True, slots=True)
class Circle:
    """Go round a level circle, clockwise seen from above: ``center + radius (cos wt, -sin wt, 0)``.

    Parameters
    ----------
    center_W : three floats
        Frame W, m.
    radius : float
        m.
    rate : float
        w, rad/s.
    yaw, yaw_rate : float
        Yaw at time 0 and how fast it grows, rad and rad/s.

    Notes
    -----
    Source: Sposato (2016), section 2.3.1.  Deviation: C9.

    Examples
    --------
    >>> print(Circle((0.0, 0.0, 0.5))(0.0)[:6] + 0.0)
    [ 1.   0.   0.5  0.  -1.   0. ]
    """

    center_W: Sequence[float] = (0.0, 0.0, 0.5)
    radius: float = 1.0
    rate: float = 1.0
    yaw: float = 0.0
    yaw_rate: float = 0.0

    def __call__(self, time: float) -> NDArray[np.float64]:
        """Return the reference at a time in seconds."""
        cosine, sine = math.cos(self.rate * time), math.sin(self.rate * time)
        reference = np.zeros(REFERENCE)
        reference[REF_P : REF_P + 3] = self.center_W
        reference[REF_P] += self.radius * cosine
        reference[REF_P + 1] -= self.radius * sine
        speed = self.radius * self.rate
        reference[REF_V], reference[REF_V + 1] = -speed * sine, -speed * cosine
        reference[REF_A], reference[REF_A + 1] = -speed * self.rate * cosine, speed * self.rate * sine
        reference[REF_J], reference[REF_J + 1] = speed * self.rate**2 * sine, speed * self.rate**2 * cosine
        reference[REF_YAW] = self.yaw + self.yaw_rate * time
        reference[REF_YAW_RATE] = self.yaw_rate
        return reference


@dataclass(frozen=True, slots=True)
class Follow:
    """Follow a leader at an offset.

    Parameters
    ----------
    leader : callable
        Returns the leader now: p_W (m), and any of v_W, a_W, jerk_W after it, in one array of 3, 6, 9 or 12 numbers; a
        state of `covey.flight.layout` cut at 6, or a reference cut at 12, are such arrays.
    offset_W : three floats
        From the leader to the follower, frame W, m.
    yaw : float
        rad.
    derivatives : bool
        Whether velocity, acceleration and jerk are the leader's, as far as given; the thesis sets them to zero.

    Notes
    -----
    Source: Sposato (2016), sections 2.3.2 and 2.3.3.

    Examples
    --------
    >>> stick = np.array([0.0, 1.0, 1.5, 0.3, 0.0, 0.0])
    >>> Follow(lambda: stick, (-1.0, 0.0, 0.0))(2.0)[:6]
    array([-1. ,  1. ,  1.5,  0. ,  0. ,  0. ])
    """

    leader: Callable[[], NDArray[np.float64]]
    offset_W: Sequence[float]
    yaw: float = 0.0
    derivatives: bool = False

    def __call__(self, time: float) -> NDArray[np.float64]:
        """Return the reference now; the leader is asked, whatever the time."""
        leader = np.asarray(self.leader(), dtype=np.float64)
        if leader.ndim != 1 or leader.size not in (3, 6, 9, 12):
            raise ArgumentError(f"leader: expected an array of 3, 6, 9 or 12 numbers, got shape {leader.shape}")
        reference = np.zeros(REFERENCE)
        used = leader if self.derivatives else leader[:3]
        reference[: used.size] = used
        reference[REF_P : REF_P + 3] += self.offset_W
        reference[REF_YAW] = self.yaw
        return reference
