"""Every mutant of the protocol is caught, and what is found is made small."""

from __future__ import annotations

import pytest

from covey.faults import MUTANTS, draw, run, shrink

SEEDS = 200


def first_caught(name: str) -> int | None:
    return next((seed for seed in range(SEEDS) if run(draw(seed), MUTANTS[name]).violation is not None), None)


@pytest.mark.parametrize("name", MUTANTS)
def test_the_mutant_is_caught(name: str) -> None:
    assert first_caught(name) is not None, f"no seed below {SEEDS} shows it"


@pytest.mark.parametrize("name", ["no-escrow", "server-gives-up", "no-adoption"])
def test_the_first_violation_is_made_small(name: str) -> None:
    seed = first_caught(name)
    assert seed is not None
    finding = shrink(seed, MUTANTS[name])
    first = draw(seed)
    assert finding.scenario.agents <= first.agents
    assert finding.scenario.landmarks <= first.landmarks
    assert len(finding.scenario.faults) <= len(first.faults)
    again = run(finding.scenario, MUTANTS[name], traced=True)
    assert again.violation is not None
    assert (again.violation.invariant, again.trace) == (finding.invariant, finding.trace)
    assert again.violation.invariant in finding.trace[-1]
