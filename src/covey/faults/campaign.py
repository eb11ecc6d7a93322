"""Many seeds, the first violation made small, and what happened on the way."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import dataclass, field
from multiprocessing import get_context

from covey.errors import ArgumentError
from covey.faults.mutants import MUTANTS
from covey.faults.scenario import Scenario, draw, simpler
from covey.faults.simulator import Outcome, run
from covey.protocol import Node

CHUNK = 20
"""Seeds that a process takes at a time."""

SHRINKING_RUNS = 400
"""Runs after which a violation is small enough."""


@dataclass(frozen=True)
class Finding:
    """A violation, made small.

    Parameters
    ----------
    seed : int
        The scenario that `draw` gives for it violates the invariant.
    invariant, detail : str
        What was violated by the small scenario.
    scenario : Scenario
        The small one.
    trace : tuple of str
        What happened in it, one line each.
    """

    seed: int
    invariant: str
    detail: str
    scenario: Scenario
    trace: tuple[str, ...]


@dataclass
class Report:
    """What a campaign has found so far.

    Parameters
    ----------
    seeds : int
        How many have been run.
    violations : list of int
        The seeds of those that violate an invariant.
    first : Finding or None
    coverage : Counter
        How often what happened.
    """

    seeds: int = 0
    violations: list[int] = field(default_factory=list)
    first: Finding | None = None
    coverage: Counter[str] = field(default_factory=Counter)


def protocol_named(name: str | None) -> type[Node]:
    """Return the protocol of a mutant's name; None for the real one.

    Raises
    ------
    ArgumentError
        If there is no such mutant.
    """
    if name is None:
        return Node
    if name not in MUTANTS:
        raise ArgumentError(f"mutant: expected one of {', '.join(sorted(MUTANTS))}, got {name}")
    return MUTANTS[name]


def campaign(
    first: int,
    count: int,
    *,
    mutant: str | None = None,
    workers: int = 1,
    on_progress: Callable[[Report], None] = lambda report: None,
) -> Report:
    """Run seeds in order and shrink the first violation; the same whatever the number of workers.

    Parameters
    ----------
    first, count : int
        The seeds ``first`` to ``first + count - 1``.
    mutant : str, keyword-only
        A name in `MUTANTS`, instead of the real protocol; then it ends at the first violation.
    workers : int, keyword-only
        Processes.
    on_progress : callable, keyword-only
        Called with the report after each chunk of seeds.  If it raises KeyboardInterrupt, what is known is returned.

    Raises
    ------
    ArgumentError
        If there is no such mutant.
    """
    protocol = protocol_named(mutant)
    report = Report()
    chunks = [range(seed, min(seed + CHUNK, first + count)) for seed in range(first, first + count, CHUNK)]
    try:
        for results in _results(chunks, mutant, workers):
            for seed, violated, coverage in results:
                report.seeds += 1
                report.coverage.update(coverage)
                if violated:
                    report.violations.append(seed)
            on_progress(report)
            if mutant is not None and report.violations:
                break
        if report.violations:
            report.first = shrink(report.violations[0], protocol)
    except KeyboardInterrupt:
        if report.violations:
            report.first = found(draw(report.violations[0]), protocol)
    return report


def shrink(seed: int, protocol: type[Node] = Node) -> Finding:
    """Make the scenario of a seed simpler for as long as it violates the same invariant.

    Raises
    ------
    ArgumentError
        If the seed violates none.
    """
    scenario = draw(seed)
    outcome = run(scenario, protocol)
    if outcome.violation is None:
        raise ArgumentError(f"seed: expected one that violates an invariant, got {seed}")
    runs = 0
    progress = True
    while progress and runs < SHRINKING_RUNS:
        progress = False
        for candidate in simpler(scenario):
            runs += 1
            smaller = run(candidate, protocol)
            if smaller.violation is not None and smaller.violation.invariant == outcome.violation.invariant:
                scenario, progress = candidate, True
                break
            if runs == SHRINKING_RUNS:
                break
    return found(scenario, protocol)


def found(scenario: Scenario, protocol: type[Node]) -> Finding:
    """Return the finding of a scenario that violates an invariant."""
    outcome = run(scenario, protocol, traced=True)
    assert outcome.violation is not None
    return Finding(scenario.seed, outcome.violation.invariant, outcome.violation.detail, scenario, outcome.trace)


def _results(chunks: list[range], mutant: str | None, workers: int) -> Iterator[list[tuple[int, bool, Counter[str]]]]:
    if workers == 1:
        yield from (_run_chunk(seeds, mutant) for seeds in chunks)
        return
    executor: Executor = ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_ignore_interrupts)
    try:
        yield from executor.map(_run_chunk, chunks, [mutant] * len(chunks))
    finally:
        executor.shutdown(wait=False, cancel_futures=True)


def _run_chunk(seeds: range, mutant: str | None) -> list[tuple[int, bool, Counter[str]]]:
    protocol = protocol_named(mutant)
    outcomes: list[tuple[int, Outcome]] = [(seed, run(draw(seed), protocol)) for seed in seeds]
    return [(seed, outcome.violation is not None, outcome.coverage) for seed, outcome in outcomes]


def _ignore_interrupts() -> None:
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)
