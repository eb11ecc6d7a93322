"""Flights made up for tests of what is drawn of them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from covey.flight.layout import (
    COMMAND,
    GRAVITY,
    OBSERVATION,
    QUAT,
    REF_P,
    REF_V,
    REF_YAW,
    REFERENCE,
    SIG_EP,
    SIG_EV,
    SIG_V1,
    SIG_V2,
    SIG_V3,
    SIGNALS,
    P,
    V,
)
from covey.geometry import Pose2
from covey.runtime.result import Deployment
from covey.vehicles.flight_log import FlightEvent, FlightLog

Moment = tuple[float, NDArray[np.int64], tuple[Pose2, ...]]


def flight(
    n: int = 3,
    *,
    duration: float = 60.0,
    step: float = 0.1,
    scored: bool = True,
    objects: int = 0,
    ends: NDArray[np.float64] | None = None,
    names: tuple[str, ...] | None = None,
    seed: int = 3,
    half: float = 4.5,
    **changes: Any,
) -> FlightLog:
    """Take off, fly to three waypoints each, the last at `ends`, land; tracking errors die out after each new waypoint.

    Parameters
    ----------
    ends : array, shape (n, 3), optional
        Where each vehicle ends: x, y, yaw.
    """
    rng = np.random.default_rng(seed)
    names = names or tuple(f"agent {i + 1}" for i in range(n))
    time = np.arange(0.0, duration + step / 2, step)
    k = len(time)
    stops = rng.uniform(-half, half, (4, n, 3))
    stops[:, :, 2] = rng.uniform(-math.pi, math.pi, (4, n))
    if ends is not None:
        stops[3] = ends
    reference = np.zeros((k, n, REFERENCE))
    goal = np.full((k, n, 4), np.nan)
    errors = np.zeros((k, n, 3))
    events = [FlightEvent(0.0, "takeoff", names, "all take off")]
    for i in range(n):
        level = 2.0 + 0.8 * i
        up = np.clip(time / (0.1 * duration), 0.0, 1.0)
        down = np.clip((duration - time) / (0.1 * duration), 0.0, 1.0)
        reference[:, i, REF_P + 2] = level * _smooth(np.minimum(up, down))
        reference[:, i, REF_P : REF_P + 2] = stops[0, i, :2]
        reference[:, i, REF_YAW] = stops[0, i, 2]
        for leg in range(3):
            start = duration * (0.12 + 0.25 * leg + 0.04 * float(rng.uniform()))
            end = start + duration * 0.18
            part = _smooth(np.clip((time - start) / (end - start), 0.0, 1.0))[:, None]
            reference[:, i, REF_P : REF_P + 2] += part * (stops[leg + 1, i, :2] - stops[leg, i, :2])
            reference[:, i, REF_YAW] += part[:, 0] * (stops[leg + 1, i, 2] - stops[leg, i, 2])
            after = time >= start
            goal[after, i] = [*stops[leg + 1, i, :2], level, stops[leg + 1, i, 2]]
            kick = rng.uniform(-0.3, 0.3, 3)
            errors[after, i] += kick * np.exp(-0.9 * (time[after] - start))[:, None]
            events.append(FlightEvent(end, "reached", (names[i],), f"{names[i]} reached its waypoint"))
            if n > 1:
                other = names[(i + 1 + leg) % n] if names[(i + 1 + leg) % n] != names[i] else names[(i + 1) % n]
                events.append(FlightEvent(end + 0.5, "trade", (names[i], other), f"{names[i]} trades with {other}"))
    reference[:, :, REF_V : REF_V + 3] = np.gradient(reference[:, :, REF_P : REF_P + 3], step, axis=0)
    state = np.zeros((k, n, OBSERVATION))
    state[:, :, P : P + 3] = reference[:, :, REF_P : REF_P + 3] + errors
    state[:, :, V : V + 3] = np.gradient(state[:, :, P : P + 3], step, axis=0)
    acceleration = np.gradient(state[:, :, V : V + 3], step, axis=0)
    tilt = np.arctan(acceleration[:, :, 0] / GRAVITY)
    yaw = reference[:, :, REF_YAW]
    state[:, :, QUAT + 0], state[:, :, QUAT + 3] = (
        np.cos(yaw / 2) * np.cos(tilt / 2),
        np.sin(yaw / 2) * np.cos(tilt / 2),
    )
    state[:, :, QUAT + 1], state[:, :, QUAT + 2] = (
        -np.sin(yaw / 2) * np.sin(tilt / 2),
        np.cos(yaw / 2) * np.sin(tilt / 2),
    )
    signals = np.zeros((k, n, SIGNALS))
    signals[:, :, SIG_EP] = np.linalg.norm(errors, axis=2)
    velocity_error = state[:, :, V : V + 3] - reference[:, :, REF_V : REF_V + 3]
    signals[:, :, SIG_EV] = np.linalg.norm(velocity_error, axis=2)
    signals[:, :, SIG_V1] = 0.5 * signals[:, :, SIG_EP] ** 2
    signals[:, :, SIG_V2] = signals[:, :, SIG_V1] + 0.5 * signals[:, :, SIG_EV] ** 2
    signals[:, :, SIG_V3] = 1.2 * signals[:, :, SIG_V2]
    command = np.zeros((k, n, COMMAND))
    command[:, :, 0] = GRAVITY + acceleration[:, :, 2]
    separation = np.full(k, np.inf)
    if n > 1:
        offset = state[:, :, None, P : P + 3] - state[:, None, :, P : P + 3]
        distance = np.linalg.norm(offset / [1.0, 1.0, 2.0], axis=3) + np.where(np.eye(n) > 0, np.inf, 0.0)
        in_air = (time > 0.02 * duration) & (time < 0.98 * duration)
        separation = np.where(in_air, distance.min(axis=(1, 2)), np.inf)
    turn = 2 * math.pi * time[:, None] / duration + np.arange(objects) * 2.0
    places = np.stack([half * np.cos(turn), half * np.sin(turn), np.full_like(turn, 2.0)], axis=2)
    committed = np.floor(12 * _smooth(time / duration)) * 5.0 + 40.0 if scored else np.full(k, np.nan)
    fields: dict[str, Any] = {
        "names": names,
        "models": ("iris",) * n,
        "simulator": "reference",
        "time": time,
        "state": state,
        "reference": reference,
        "command": command,
        "signals": signals,
        "goal": goal,
        "separation": separation,
        "objects": places,
        "object_radii": np.full(objects, 0.5),
        "score_committed": committed,
        "score_flown": committed - 2.0 * signals[:, :, SIG_EP].sum(axis=1),
        "required_separation": 0.9,
        "vertical_ratio": 2.0,
        "events": tuple(sorted(events, key=lambda event: event.time)),
    }
    return FlightLog(**{**fields, **changes})


def flight_of(deployment: Deployment, **options: Any) -> FlightLog:
    """Make up a flight that ends at a deployment's poses."""
    ends = np.array([[pose.x, pose.y, pose.yaw] for pose in deployment.poses])
    names = tuple(agent.name for agent in deployment.agents)
    return flight(len(ends), ends=ends, names=names, **options)


def moments(deployment: Deployment, log: FlightLog, count: int = 30, seed: int = 5) -> list[Moment]:
    """Partitions that go from random to the deployment's, a few landmarks at a time."""
    rng = np.random.default_rng(seed)
    final = deployment.owner
    first = rng.integers(0, len(deployment.agents), len(final))
    when = rng.uniform(0.0, 1.0, len(final))
    times = np.linspace(log.time[0], log.time[-1], count)
    return [
        (float(t), np.where(when <= index / (count - 1), final, first), tuple(deployment.poses))
        for index, t in enumerate(times)
    ]


def _smooth(x: NDArray[np.float64]) -> NDArray[np.float64]:
    return x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
