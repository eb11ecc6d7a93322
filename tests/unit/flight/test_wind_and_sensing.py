"""Statistics of gusts and of measurement errors, latency, and that a seed gives the same again."""

from __future__ import annotations

import math

import numpy as np
import pytest

from covey.errors import ArgumentError
from covey.flight.layout import OBSERVATION, OMEGA, QUAT, P, V
from covey.flight.rotation import matrix
from covey.flight.sensing import Observer, SensorNoise
from covey.flight.wind import Wind, WindField


def samples(wind: Wind, n: int, steps: int, dt: float, seed: int = 0) -> np.ndarray:
    field = WindField(wind, n, np.random.default_rng(seed))
    return np.array([field.advance(dt) for _ in range(steps)])


def test_gusts_have_their_mean_spread_and_memory() -> None:
    wind = Wind((1.0, -2.0, 0.5), gust_std=2.0, gust_std_vertical=0.7, time_constant=0.5, common=0.25)
    air = samples(wind, 400, 2000, 0.1)
    np.testing.assert_allclose(air.mean(axis=(0, 1)), wind.mean_W, atol=0.15)
    np.testing.assert_allclose(air.std(axis=(0, 1)), (2.0, 2.0, 0.7), rtol=0.04)
    gusts = air - wind.mean_W
    lag = 3
    memory = (gusts[lag:] * gusts[:-lag]).mean(axis=(0, 1)) / (gusts**2).mean(axis=(0, 1))
    np.testing.assert_allclose(memory, math.exp(-0.3 / 0.5), atol=0.03)
    # any two vehicles share a quarter of the variance
    shared = (gusts[:, :200] * gusts[:, 200:]).mean(axis=(0, 1)) / (gusts**2).mean(axis=(0, 1))
    np.testing.assert_allclose(shared, 0.25, atol=0.04)


def test_gusts_do_not_depend_on_the_step() -> None:
    wind = Wind(gust_std=1.5, time_constant=1.0, common=0.0)
    for dt in (0.01, 1.0, 100.0):
        assert samples(wind, 2000, 3, dt)[-1].std(axis=0)[0] == pytest.approx(1.5, rel=0.1)


def test_gusts_are_reproducible() -> None:
    wind = Wind(gust_std=1.0)
    np.testing.assert_array_equal(samples(wind, 3, 10, 0.01, 7), samples(wind, 3, 10, 0.01, 7))
    assert not np.array_equal(samples(wind, 3, 10, 0.01, 7), samples(wind, 3, 10, 0.01, 8))


def test_extremes_of_common() -> None:
    alike = samples(Wind(gust_std=1.0, common=1.0), 5, 20, 0.1)
    np.testing.assert_array_equal(alike[:, 0], alike[:, 4])
    apart = samples(Wind(gust_std=1.0, common=0.0), 2, 4000, 1.0)
    assert abs(np.corrcoef(apart[:, 0, 0], apart[:, 1, 0])[0, 1]) < 0.1


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"mean_W": (0.0, 1.0)}, "mean_W"),
        ({"mean_W": (0.0, 1.0, math.nan)}, "mean_W"),
        ({"gust_std": -1.0}, "gust_std"),
        ({"gust_std_vertical": math.inf}, "gust_std_vertical"),
        ({"time_constant": 0.0}, "time_constant"),
        ({"common": 1.5}, "common"),
    ],
)
def test_bad_winds(options: dict[str, object], name: str) -> None:
    with pytest.raises(ArgumentError, match=name):
        Wind(**options)  # type: ignore[arg-type]


def level(n: int) -> np.ndarray:
    state = np.zeros((n, OBSERVATION))
    state[:, QUAT] = 1.0
    return state


def test_errors_have_their_spread() -> None:
    noise = SensorNoise(position_std=0.01, velocity_std=0.05, attitude_std=0.02, rate_std=0.1)
    n = 4000
    state = level(n)
    state[:, QUAT : QUAT + 4] = np.array([0.5, -0.5, 0.5, 0.5])
    state[:, :3] = (1.0, 2.0, 3.0)
    observer = Observer(noise, np.random.default_rng(3))
    observer.record(0.0, state)
    seen = observer.observe()
    error = seen - state
    for column, std in ((P, 0.01), (V, 0.05), (OMEGA, 0.1)):
        np.testing.assert_allclose(error[:, column : column + 3].std(axis=0), std, rtol=0.05)
        np.testing.assert_allclose(error[:, column : column + 3].mean(axis=0), 0.0, atol=5.0 * std / math.sqrt(n))
    np.testing.assert_allclose(np.linalg.norm(seen[:, QUAT:OMEGA], axis=1), 1.0, atol=1e-12)
    true, measured, angles = np.empty((3, 3)), np.empty((3, 3)), []
    matrix(state[0, QUAT:OMEGA], true)
    for row in seen:
        matrix(row[QUAT:OMEGA], measured)
        small = true.T @ measured
        angles.append([small[2, 1] - small[1, 2], small[0, 2] - small[2, 0], small[1, 0] - small[0, 1]])
    np.testing.assert_allclose(0.5 * np.array(angles).std(axis=0), 0.02, rtol=0.05)


@pytest.mark.parametrize(("latency", "steps"), [(0.0, 0), (0.01, 1), (0.015, 2), (0.03, 3)])
def test_latency_counts_in_whole_periods(latency: float, steps: int) -> None:
    observer = Observer(SensorNoise(latency=latency), np.random.default_rng(0))
    for k in range(10):
        state = level(1)
        state[0, 0] = k
        observer.record(0.01 * k, state)
        assert observer.observe()[0, 0] == max(0, k - steps)


def test_twice_at_one_moment_is_the_same_and_then_not() -> None:
    observer = Observer(SensorNoise(position_std=1.0), np.random.default_rng(0))
    with pytest.raises(ArgumentError, match="record"):
        observer.observe()
    observer.record(0.0, level(2))
    first = observer.observe()
    np.testing.assert_array_equal(observer.observe(), first)
    observer.record(0.01, level(2))
    assert not np.array_equal(observer.observe(), first)


def test_replaced_vehicles_have_no_past() -> None:
    observer = Observer(SensorNoise(latency=0.1), np.random.default_rng(0))
    for k in range(5):
        observer.record(0.01 * k, level(2))
    moved = level(1)[0]
    moved[0] = 9.0
    observer.replace(1, moved)
    np.testing.assert_array_equal(observer.observe()[:, 0], (0.0, 9.0))


@pytest.mark.parametrize("name", ["position_std", "velocity_std", "attitude_std", "rate_std", "latency"])
def test_bad_noise(name: str) -> None:
    for value in (-0.1, math.nan):
        with pytest.raises(ArgumentError, match=name):
            SensorNoise(**{name: value})
