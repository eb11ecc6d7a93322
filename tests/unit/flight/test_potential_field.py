"""The terms of the potential field: signs, symmetry, smoothness, and what happens in degenerate places."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from covey.errors import ArgumentError
from covey.flight.potential_field import FieldGains, add_repulsion, fly_field, repulsion

Array = NDArray[np.float64]


def term(offset: Array, *, order: float = 1.0, ratio: float = 1.0, weight: float = 1.0) -> Array:
    out = np.zeros(3)
    dx, dy, dz = (float(x) for x in offset)
    add_repulsion(dx, dy, dz, order, ratio, 2.0, 1.5, weight, out)
    return out


def test_the_radial_term_pushes_away_and_the_tangential_one_turns_all_the_same_way() -> None:
    for angle in np.linspace(0.0, 6.0, 13):
        offset = np.array([math.cos(angle), math.sin(angle), 0.0])
        g = term(offset)
        strength = 0.5 * 2.0 * (1.0 - 1.0 / 1.5)
        assert g @ offset == pytest.approx(-strength)
        assert g @ [-offset[1], offset[0], 0.0] == pytest.approx(-strength)
        np.testing.assert_allclose(term(-offset), -g, atol=1e-12)


def test_beyond_the_threshold_there_is_none_and_it_sets_in_continuously() -> None:
    assert repulsion(1.5, 2.0, 1.5) == 0.0
    assert repulsion(1.4999, 2.0, 1.5) == pytest.approx(0.0, abs=1e-4)
    np.testing.assert_array_equal(term(np.array([1.6, 0.0, 0.0])), 0.0)
    strengths = [repulsion(d, 2.0, 1.5) for d in np.linspace(0.05, 1.5, 100)]
    assert np.diff(strengths).max() < 0.0


@pytest.mark.parametrize("ratio", [1.0, 2.5])
def test_without_turning_it_is_the_gradient_of_a_potential_of_the_scaled_distance(ratio: float) -> None:
    """So that the energy bound holds along every direction (deviation P4)."""

    def potential(p: Array) -> float:
        d = float(np.linalg.norm(p / [1.0, 1.0, ratio]))
        return 0.5 * 2.0 * (math.log(1.5 / d) - 1.0 + d / 1.5)

    rng = np.random.default_rng(0)
    for _ in range(50):
        offset = rng.uniform(-0.6, 0.6, 3)
        offset[0] += math.copysign(0.3, offset[0])
        g, mirrored = term(offset, ratio=ratio), term(offset * [1, -1, 1], ratio=ratio)
        radial = 0.5 * (g + mirrored * [1, -1, 1])  # the tangential term changes sign in a mirror
        for c in range(3):
            e = np.eye(3)[c] * 1e-6
            slope = (potential(offset + e) - potential(offset - e)) / 2e-6
            assert radial[c] == pytest.approx(slope, rel=1e-4, abs=1e-6)


def test_straight_above_and_at_the_same_place_the_two_are_sent_apart() -> None:
    for offset in (np.array([0.0, 0.0, 0.5]), np.array([1e-12, 0.0, 0.5])):
        lower, upper = term(offset), term(-offset)
        assert lower[0] < 0.0 < upper[0]
        assert lower[2] < 0.0 < upper[2]
    same = [term(np.zeros(3), order=order) for order in (1.0, -1.0)]
    assert np.isfinite(same).all()
    np.testing.assert_allclose(same[0], -same[1])
    assert np.linalg.norm(same[0]) > 1.0
    assert np.linalg.norm(term(np.array([1e-7, 0.0, 0.0]))) < 1e3


def test_the_weight_scales_all_of_it() -> None:
    offset = np.array([0.1, 0.2, 0.6])
    np.testing.assert_allclose(term(offset, weight=0.3), 0.3 * term(offset))
    np.testing.assert_array_equal(term(offset, weight=0.0), 0.0)


def test_a_rotated_team_flies_a_rotated_way() -> None:
    rng = np.random.default_rng(1)
    starts, goals = rng.uniform(-1, 1, (4, 3)), rng.uniform(-1, 1, (4, 3))
    gains = FieldGains(1.0, 5.0, 2.0, 1.5)
    c, s = math.cos(1.1), math.sin(1.1)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    starts[:, 2] *= 0.1  # the lateral term, for those above each other, has a direction of its own
    goals[:, 2] *= 0.1
    plain, _ = fly_field(starts, goals, gains, duration=3.0)
    turned, _ = fly_field(starts @ turn.T, goals @ turn.T, gains, duration=3.0)
    np.testing.assert_allclose(plain @ turn.T, turned, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "value"),
    [("k_wp", -1.0), ("k_v", math.nan), ("k_rep", math.inf), ("threshold", 0.0), ("vertical_ratio", 0.0)],
)
def test_gains_out_of_range_are_refused(name: str, value: float) -> None:
    with pytest.raises(ArgumentError, match=name):
        FieldGains(**{"k_wp": 1.0, "k_v": 1.0, name: value})


def test_shapes_that_do_not_fit_are_refused() -> None:
    gains, two = FieldGains(1.0, 5.0), np.zeros((2, 3))
    for starts, goals, objects in (
        (np.zeros((2, 2)), two, None),
        (two, np.zeros((3, 3)), None),
        (two, two, np.zeros((5, 1, 3))),
    ):
        with pytest.raises(ArgumentError, match="shape"):
            fly_field(starts, goals, gains, duration=1.0, dt=0.01, objects_W=objects)
    with pytest.raises(ArgumentError, match="dt"):
        fly_field(two, two, gains, duration=1.0, dt=0.0)
