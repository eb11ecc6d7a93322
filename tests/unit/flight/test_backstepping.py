"""The control law: an independent version in numpy, the proof's derivative, and the limits of the practical form."""

from __future__ import annotations

import math

import numpy as np
import pytest
from tests.unit.flight.printed_law import Law

from covey.errors import ArgumentError
from covey.flight.backstepping import control, control_all
from covey.flight.layout import (
    COMMAND,
    GRAVITY,
    OBSERVATION,
    REF_YAW,
    REF_YAW_RATE,
    REFERENCE,
    SIG_DV3,
    SIG_EP,
    SIG_EV,
    SIG_V1,
    SIG_V3,
    SIGNALS,
)
from covey.flight.parameters import PARAMETERS, TILT_RESERVE, load_vehicle, vehicle_names
from covey.flight.trajectories import Circle, Hold
from covey.simulators.ideal import fly_ideal

E3 = np.array([0.0, 0.0, 1.0])


def situations(n: int, seed: int, *, near: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Observations and references at random; `near` keeps all bounds inactive."""
    rng = np.random.default_rng(seed)
    scale = 0.02 if near else 1.0
    observations, references = np.zeros((n, OBSERVATION)), np.zeros((n, REFERENCE))
    observations[:, :6] = scale * rng.normal(0.0, 2.0, (n, 6))
    references[:, :12] = scale * rng.normal(0.0, 1.0, (n, 12))
    references[:, REF_YAW] = rng.uniform(-0.5, 0.5, n)
    references[:, REF_YAW_RATE] = rng.uniform(-0.3, 0.3, n)
    tilt = scale * np.radians(60.0) * rng.random(n)
    around, yaw = rng.uniform(-np.pi, np.pi, n), rng.uniform(-1.0, 1.0, n)
    # tilted about a horizontal axis, after a turn about the vertical
    c, s = np.cos(0.5 * tilt), np.sin(0.5 * tilt)
    cy, sy = np.cos(0.5 * yaw), np.sin(0.5 * yaw)
    observations[:, 6], observations[:, 9] = c * cy, c * sy
    observations[:, 7] = s * (np.cos(around) * cy + np.sin(around) * sy)
    observations[:, 8] = s * (np.sin(around) * cy - np.cos(around) * sy)
    return observations, references


def commands_of(
    observations: np.ndarray, references: np.ndarray, name: str = "iris", *, pure: bool
) -> tuple[np.ndarray, np.ndarray]:
    n = len(observations)
    commands, signals = np.empty((n, COMMAND)), np.empty((n, SIGNALS))
    rows = np.array([load_vehicle(name).row()] * n)
    control_all(observations, references, rows, commands, signals, pure=pure)
    return commands, signals


@pytest.mark.parametrize("name", vehicle_names())
def test_pure_law_is_that_of_the_textbook_version(name: str) -> None:
    observations, references = situations(50, 1)
    commands, signals = commands_of(observations, references, name, pure=True)
    law = Law(load_vehicle(name).gains)
    for observation, reference, command, signal in zip(observations, references, commands, signals, strict=True):
        thrust, omega, v3 = law(observation, reference)
        np.testing.assert_allclose(command, [thrust, *omega], rtol=1e-9, atol=1e-9)
        assert signal[SIG_V3] == pytest.approx(v3, rel=1e-9)


def test_derivative_of_v3_is_the_proofs() -> None:
    # (2.24) with the gamma it omits: -W2 - gamma k_theta |n x n*|²
    observations, references = situations(200, 2)
    _, signals = commands_of(observations, references, pure=True)
    gains = load_vehicle("iris").gains
    law = Law(gains)
    for observation, reference, signal in zip(observations, references, signals, strict=True):
        n, wanted, _ = law.axes(observation, reference)
        e_p, e_v = observation[:3] - reference[:3], observation[3:6] - reference[3:6]
        e_1 = e_v + gains.k1 * e_p
        expected = -gains.alpha * gains.k1 * e_p @ e_p - gains.alpha * gains.k2 * e_1 @ e_1
        expected -= gains.gamma * gains.k_theta * np.sum(np.cross(n, wanted) ** 2)
        assert signal[SIG_DV3] == pytest.approx(expected, rel=1e-9, abs=1e-9)
        assert signal[SIG_V1] == pytest.approx(0.5 * gains.alpha * e_p @ e_p)
        assert signal[SIG_EP] == pytest.approx(np.linalg.norm(e_p))
        assert signal[SIG_EV] == pytest.approx(np.linalg.norm(e_v))


@pytest.mark.parametrize("pure", [True, False])
@pytest.mark.parametrize("trajectory", [Hold((1.0, 3.0, 2.0)), Circle(yaw_rate=0.3)])
def test_derivative_of_v3_is_what_v3_does(trajectory: Hold | Circle, pure: bool) -> None:
    # differences of fourth order; the step is small so that they are good, and it holds with bounds active too
    dt = 0.001
    flight = fly_ideal(
        trajectory, [0.0] * 6 + [1.0, 0.0, 0.0, 0.0], load_vehicle("iris"), duration=3.0, dt=dt, pure=pure
    )
    v = flight.signals[:, SIG_V3]
    numeric = (8.0 * (v[3:-1] - v[1:-3]) - (v[4:] - v[:-4])) / (12.0 * dt)
    analytic = flight.signals[2:-2, SIG_DV3]
    error = np.abs(numeric - analytic)
    assert np.median(error) < 1e-8 * np.abs(analytic).max()
    # where a bound begins or ends to act V3 has a kink, which differences blur over a few steps
    assert np.quantile(error, 1.0 if pure else 0.98) < 1e-4 * np.abs(analytic).max()


@pytest.mark.parametrize(
    ("offset", "velocity"),
    [
        ((4.0, 0.0, 0.0), (-1.0, 0.5, 0.0)),  # tilt
        ((0.3, 0.2, 0.0), (0.2, 0.5, -3.0)),  # climb
        ((0.3, 0.2, 0.0), (0.2, 0.5, 3.0)),  # descent
        ((4.0, 0.0, 0.0), (-1.0, 0.5, -1.1)),  # thrust
        ((1.2, 1.3, 0.0), (0.5, 0.7, 0.0)),  # position error
    ],
)
def test_derivative_with_a_bound_active(
    offset: tuple[float, float, float], velocity: tuple[float, float, float]
) -> None:
    dt = 1e-3
    start = [0.0, 0.0, 0.0, *velocity, 1.0, 0.0, 0.0, 0.0]
    flight = fly_ideal(Hold(offset), start, load_vehicle("iris"), duration=0.02, dt=dt, pure=False)
    v = flight.signals[:, SIG_V3]
    numeric = (8.0 * (v[3:-1] - v[1:-3]) - (v[4:] - v[:-4])) / (12.0 * dt)
    analytic = flight.signals[2:-2, SIG_DV3]
    np.testing.assert_allclose(analytic, numeric, atol=1e-6 * np.abs(numeric).max())


@pytest.mark.parametrize("name", vehicle_names())
def test_near_the_reference_both_forms_are_the_same(name: str) -> None:
    observations, references = situations(100, 3, near=True)
    pure, practical = (commands_of(observations, references, name, pure=form)[0] for form in (True, False))
    np.testing.assert_allclose(practical, pure, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("name", vehicle_names())
def test_practical_form_keeps_the_limits(name: str) -> None:
    limits = load_vehicle(name).limits
    observations, references = situations(2000, 4)
    rng = np.random.default_rng(5)
    observations[:, :6] *= rng.choice([1.0, 30.0, 1e6], (2000, 1))
    observations[1000:, 6:10] = rng.standard_normal((1000, 4))  # any attitude, upside down as well
    observations[:, 6:10] /= np.linalg.norm(observations[:, 6:10], axis=1, keepdims=True)
    commands, signals = commands_of(observations, references, name, pure=False)
    assert np.isfinite(commands).all()
    assert np.isfinite(signals).all()
    assert commands[:, 0].min() >= limits.min_thrust
    assert commands[:, 0].max() <= limits.max_thrust
    assert np.hypot(commands[:, 1], commands[:, 2]).max() <= limits.max_rate * (1.0 + 1e-12)
    assert np.abs(commands[:, 3]).max() <= limits.max_yaw_rate


def test_practical_form_where_the_pure_one_is_singular() -> None:
    # u = 0: gravity is what the feedback asks for (C8)
    gains = load_vehicle("iris").gains
    k_p = gains.alpha / gains.beta * (1.0 + gains.k1 * gains.k2)
    observation = np.zeros((1, OBSERVATION))
    observation[0, 2], observation[0, 6] = GRAVITY / k_p, 1.0
    reference = np.zeros((1, REFERENCE))
    commands, _ = commands_of(observation, reference, pure=False)
    assert commands[0, 0] == load_vehicle("iris").limits.min_thrust
    np.testing.assert_allclose(commands[0, 1:], 0.0, atol=1e-12)
    # body z horizontal: cos(roll) = 0, where (C6) is singular
    observation[0, 2], observation[0, 6:10] = 0.0, (math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0)
    commands, _ = commands_of(observation, reference, pure=False)
    assert np.isfinite(commands).all()


@pytest.mark.parametrize("offset", [(40.0, 0.0, 0.0), (-3.0, 5.0, -20.0), (0.0, 0.0, 30.0), (2.0, 2.0, 2.0)])
def test_practical_form_aims_within_the_tilt(offset: tuple[float, float, float]) -> None:
    # the thrust axis that it turns to is a rest of the ideal vehicle: follow it there
    vehicle = load_vehicle("iris")
    flight = fly_ideal(Hold(offset), [0.0] * 6 + [1.0, 0.0, 0.0, 0.0], vehicle, duration=20.0, pure=False)
    vertical = 1.0 - 2.0 * (flight.state[:, 7] ** 2 + flight.state[:, 8] ** 2)
    assert np.arccos(vertical.min()) < TILT_RESERVE * vehicle.limits.max_tilt + math.radians(5.0)
    # speed is bounded as well, as the position error is
    assert np.linalg.norm(flight.state[:, 3:6], axis=1).max() < 1.5 * vehicle.limits.max_speed
    rest = math.hypot(*offset) / vehicle.limits.max_speed
    if rest < 12.0:
        assert flight.signals[-1, SIG_EP] < 1e-3


@pytest.mark.parametrize("turn", [3.1, -3.1, 2.0, math.pi])
def test_yaw_turns_the_short_way(turn: float) -> None:
    flight = fly_ideal(
        Hold((0.0, 0.0, 1.0), turn), [0.0, 0.0, 1.0] + [0.0] * 3 + [1.0, 0.0, 0.0, 0.0], load_vehicle("iris"),
        duration=8.0, pure=False,
    )  # fmt: skip
    x = flight.state[:, 6:10]
    yaw = np.unwrap(2.0 * np.arctan2(x[:, 3], x[:, 0]))
    assert abs(yaw[-1] - turn) < 1e-3 or abs(abs(yaw[-1]) - math.pi) < 1e-3 == abs(turn - math.pi)
    assert np.abs(yaw).max() <= abs(turn) + 1e-6


def test_shapes_are_checked() -> None:
    good = [np.zeros((2, width)) for width in (OBSERVATION, REFERENCE, PARAMETERS, COMMAND, SIGNALS)]
    for k, name in enumerate(("observations", "references", "params", "commands", "signals")):
        arrays = list(good)
        arrays[k] = np.zeros((2, 3))
        with pytest.raises(ArgumentError, match=name):
            control_all(*arrays)


def test_one_and_all_agree() -> None:
    observations, references = situations(3, 7)
    commands, signals = commands_of(observations, references, pure=False)
    command, signal = np.empty(COMMAND), np.empty(SIGNALS)
    control(observations[1], references[1], load_vehicle("iris").row(), False, command, signal)
    np.testing.assert_array_equal(command, commands[1])
    np.testing.assert_array_equal(signal, signals[1])
