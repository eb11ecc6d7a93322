"""Every interleaving of small teams, and that the exploration sees what is wrong."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from covey.errors import ArgumentError
from covey.faults import MORE_SIZES, MUTANTS, SIZES, Exploration, Violation, explore


@pytest.mark.parametrize(("agents", "asks"), SIZES, ids=str)
def test_no_interleaving_with_a_crash_breaks_it(
    agents: int, asks: tuple[int, ...], record_property: Callable[[str, object], None]
) -> None:
    explored = explore(agents, asks=asks)
    record_property("states", explored.states)
    print(f"{agents} agents, trades opened {asks}: {explored.states} states, {explored.transitions} transitions")
    assert explored.complete
    assert explored.states > 1000


@pytest.mark.parametrize(
    ("agents", "asks", "crash"), [(2, (1, 1), True), (3, (1, 0, 0), True), (3, (1, 1, 0), False)], ids=str
)
def test_what_is_passed_over_adds_nothing(agents: int, asks: tuple[int, ...], crash: bool) -> None:
    def explored(*, reduced: bool) -> Exploration:
        return explore(agents, asks=asks, crash=crash, reduced=reduced)

    small, whole = explored(reduced=True), explored(reduced=False)
    assert small.complete
    assert whole.complete
    assert small.states < whole.states
    assert small.teams == whole.teams


def test_more_teams(soak: bool) -> None:
    for agents, asks in MORE_SIZES:
        assert explore(agents, asks=asks, crash=soak).complete


@pytest.mark.parametrize("name", ["no-escrow", "server-gives-up", "commit-in-two-steps"])
def test_it_finds_mutants(name: str) -> None:
    with pytest.raises(Violation, match=r"I2.*\n.*dies|I2.*\nagent"):
        explore(2, node=MUTANTS[name])


def test_a_limit_is_told() -> None:
    assert not explore(2, limit=100).complete


def test_other_teams_are_refused() -> None:
    with pytest.raises(ArgumentError, match="agents"):
        explore(4)
