"""Scores, the transfer of landmarks, and the checks of Definition 3, on tables worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from covey.coverage import agent_scores, team_visibility, transfer
from covey.coverage.certificate import partition_violations, pose_violations, trade_violations
from covey.environment import Landmarks
from covey.errors import ArgumentError
from covey.geometry import Pose2
from covey.sensing import Anisotropic, Isotropic

NAMES = ("blue", "red")
SEEN = np.array([[0.5, 0.2, 0.9, 0.0], [0.4, 0.21, 0.1, 0.0]])


def indices(*values: int) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    return np.array(values, dtype=np.int64)


def test_team_visibility_is_one_row_an_agent() -> None:
    landmarks = Landmarks(np.array([[1.0, 0.0], [0.0, 2.0]]))
    seen = team_visibility([Anisotropic(), Isotropic()], [Pose2(0, 0, 0), Pose2(0, 0, 0)], landmarks)
    np.testing.assert_allclose(seen, [[1.0, 0.0], [1.0, 0.5]], atol=1e-15)
    assert team_visibility([], [], landmarks).shape == (0, 2)


def test_agent_scores_sum_what_each_owns() -> None:
    weights = np.array([1.0, 2.0, 3.0, 4.0])
    np.testing.assert_allclose(agent_scores(SEEN, indices(0, 1, 0, 1), weights), [3.2, 0.42])
    np.testing.assert_allclose(agent_scores(SEEN, indices(1, 1, 1, 1), weights), [0.0, 1.12])


@pytest.mark.parametrize("owner", [[0, 1, 2, 0], [-1, 0, 0, 0]])
def test_an_owner_that_does_not_exist_is_refused(owner: list[int]) -> None:
    with pytest.raises(ArgumentError, match="owner: expected indices from 0 to 1"):
        agent_scores(SEEN, indices(*owner), np.ones(4))


@given(st.integers(0, 2**32 - 1), st.floats(1e-3, 1e3))
def test_scores_are_linear_in_the_weights(seed: int, factor: float) -> None:
    rng = np.random.default_rng(seed)
    seen, owner = rng.random((3, 20)), rng.integers(0, 3, 20)
    one, two = rng.random((2, 20))
    scores = agent_scores(seen, owner, one)
    np.testing.assert_allclose(agent_scores(seen, owner, factor * one), factor * scores, rtol=1e-12)
    np.testing.assert_allclose(
        agent_scores(seen, owner, one + two), scores + agent_scores(seen, owner, two), rtol=1e-12
    )
    assert scores.sum() <= seen.max(axis=0) @ one + 1e-12


@given(st.integers(0, 2**32 - 1), st.floats(0.0, 0.5))
def test_transfer_gains_and_loses_no_landmark(seed: int, sigma: float) -> None:
    """Each landmark that moves gains more than sigma, each that stays could gain sigma at most; nothing is lost."""
    rng = np.random.default_rng(seed)
    server_seen, client_seen = rng.random((2, 30))
    server = np.flatnonzero(rng.random(30) < 0.5)
    client = np.setdiff1d(np.arange(25), server)
    mine, yours = transfer(server_seen, client_seen, server, client, sigma)
    np.testing.assert_array_equal(np.sort(np.concatenate([mine, yours])), np.sort(np.concatenate([server, client])))
    assert (np.diff(mine) > 0).all()
    assert (np.diff(yours) > 0).all()
    advantage = client_seen - server_seen
    given_away = np.setdiff1d(server, mine)
    taken = np.setdiff1d(client, yours)
    assert (advantage[given_away] > sigma).all()
    assert (advantage[taken] < -sigma).all()
    assert (advantage[mine] <= sigma).all()
    assert (advantage[yours] >= -sigma).all()
    again = transfer(server_seen, client_seen, mine, yours, sigma)
    np.testing.assert_array_equal(again[0], mine)
    np.testing.assert_array_equal(again[1], yours)


def test_an_advantage_of_exactly_sigma_is_none() -> None:
    mine, yours = transfer(np.array([0.5, 0.25]), np.array([0.75, 0.5]), indices(0, 1), indices(), 0.25)
    assert mine.tolist() == [0, 1]
    assert yours.tolist() == []


def test_partition_violations_name_landmark_and_owners() -> None:
    assert partition_violations(NAMES, [indices(0, 2), indices(1, 3)], 4) == []
    found = partition_violations(NAMES, [indices(0, 2), indices(2)], 4)
    assert [(v.kind, v.agents, v.landmark, v.amount) for v in found] == [
        ("incomplete", (), 1, 1.0),
        ("incomplete", (), 3, 1.0),
        ("overlap", NAMES, 2, 1.0),
    ]
    (twice,) = partition_violations(NAMES, [indices(0, 0, 0), indices(1)], 2)
    assert (twice.agents, twice.landmark, twice.amount) == (("blue",), 0, 2.0)
    assert [v.landmark for v in partition_violations((), [], 2)] == [0, 1]


def test_trade_violations_name_who_sees_it_better() -> None:
    worst, found = trade_violations(NAMES, SEEN, [indices(0, 1), indices(2, 3)], 0.05)
    assert worst == pytest.approx(0.8)
    assert [(v.kind, v.agents, v.landmark) for v in found] == [("trade", ("red", "blue"), 2)]
    assert found[0].amount == pytest.approx(0.8)
    worst, found = trade_violations(NAMES, SEEN, [indices(0, 1, 2, 3), indices()], 0.02)
    assert worst == pytest.approx(0.01)
    assert found == []
    _, found = trade_violations(NAMES, SEEN, [indices(0, 1, 2, 3), indices()], 0.005)
    assert [v.landmark for v in found] == [1]


@pytest.mark.parametrize(
    ("best", "upper", "kind"),
    [
        (10.0, 10.0, None),
        (10.01, 10.01, None),
        (10.005, 10.0099, None),
        (10.0101, 10.0101, "pose"),
        (10.0, 10.0101, "unproved"),
        (11.0, math.inf, "pose"),
        (10.0, math.inf, "unproved"),
    ],
)
def test_pose_violations_tell_a_better_pose_from_a_missing_proof(best: float, upper: float, kind: str | None) -> None:
    gap, found = pose_violations("blue", 10.0, best, upper, 0.01)
    assert gap == upper - 10.0
    assert [v.kind for v in found] == ([] if kind is None else [kind])
    assert all(v.agents == ("blue",) for v in found)
