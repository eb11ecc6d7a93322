"""Every interleaving of small teams, and that the exploration sees what is wrong."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from covey.errors import ArgumentError
from covey.faults import MUTANTS, Violation, explore


@pytest.mark.parametrize(
    ("agents", "asks"), [(2, (1, 1)), (2, (2, 0)), (3, (1, 0, 0)), (3, (0, 0, 1))], ids=lambda value: str(value)
)
def test_no_interleaving_with_a_crash_breaks_it(
    agents: int, asks: tuple[int, ...], record_property: Callable[[str, object], None]
) -> None:
    explored = explore(agents, asks=asks)
    record_property("states", explored.states)
    print(f"{agents} agents, trades opened {asks}: {explored.states} states, {explored.transitions} transitions")
    assert explored.complete
    assert explored.states > 1000


def test_two_agents_that_each_ask_twice(soak: bool) -> None:
    explored = explore(2, asks=(2, 2), crash=soak)
    assert explored.complete


@pytest.mark.parametrize("name", ["no-escrow", "server-gives-up", "commit-in-two-steps"])
def test_it_finds_mutants(name: str) -> None:
    with pytest.raises(Violation, match=r"I2.*\n.*dies|I2.*\nagent"):
        explore(2, node=MUTANTS[name])


def test_a_limit_is_told() -> None:
    assert not explore(2, limit=100).complete


def test_other_teams_are_refused() -> None:
    with pytest.raises(ArgumentError, match="agents"):
        explore(4)
