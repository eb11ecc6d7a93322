"""The real protocol through lost messages, crashes and partitions."""

from __future__ import annotations

import secrets
from collections.abc import Callable
from dataclasses import replace

import pytest

from covey.errors import ArgumentError
from covey.faults import Crash, Mode, Report, campaign, draw, run, simpler


def test_no_seed_violates_an_invariant(seeds: Callable[[int, int], range]) -> None:
    count = len(seeds(250, 10_000))
    report = campaign(0, count)
    assert report.first is None, "\n".join(report.first.trace)
    assert report.seeds == count
    happened = {name for name, times in report.coverage.items() if times}
    assert happened >= {
        "trades",
        "crashes",
        "restarts",
        "amnesic_restarts",
        "adoptions",
        "burials",
        "returns",
        "partitions",
        "one_way_cuts",
        "heals",
        "drops",
        "duplicates",
        "scores_compared",
        "missions_ended",
        "changes",
        "joins",
        "leaves",
    }


def test_no_fresh_seed_violates_an_invariant(seeds: Callable[[int, int], range]) -> None:
    count, first = len(seeds(250, 10_000)), secrets.randbelow(2**31)
    print(f"replay with: covey chaos --seeds {count} --seed-start {first}")
    report = campaign(first, count)
    assert report.first is None, f"seed {report.first.seed}\n" + "\n".join(report.first.trace)


@pytest.mark.parametrize("remembers", [True, False], ids=["memory", "amnesic"])
def test_a_crash_at_every_step(remembers: bool, soak: bool) -> None:
    calm = replace(draw(11), mode=Mode.LIVENESS, agents=3, landmarks=6, loss=0.1, duplicates=0.1, faults=(), reach=None)
    for step in range(0, 200, 1 if soak else 5):
        for back_after in (None, 0.05):
            crash = Crash(step, step % 3, back_after, remembers, None)
            outcome = run(replace(calm, seed=step, faults=(crash,)))
            assert outcome.violation is None, f"step {step}: {outcome.violation}"


def test_the_same_seed_gives_the_same_run_with_any_number_of_processes() -> None:
    assert run(draw(5), traced=True) == run(draw(5), traced=True)
    one, two = campaign(0, 40), campaign(0, 40, workers=2)
    assert (one.seeds, one.violations, one.coverage) == (two.seeds, two.violations, two.coverage)


def test_simpler_scenarios_run() -> None:
    for seed in range(4):
        for scenario in simpler(draw(seed)):
            assert run(scenario).violation is None


def test_an_interrupted_campaign_keeps_what_is_known() -> None:
    def stop(report: Report) -> None:
        raise KeyboardInterrupt

    assert campaign(0, 1000, mutant="no-escrow", on_progress=stop).first is not None


def test_an_unknown_mutant_is_refused() -> None:
    with pytest.raises(ArgumentError, match=r"mutant.*no-escrow"):
        campaign(0, 1, mutant="perfect")
