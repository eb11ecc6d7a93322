"""``covey chaos``: the protocol against lost messages, crashes and partitions, seed by seed."""

from __future__ import annotations

import json as json_text
import os
import sys
import time
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from covey.cli.interrupt import INTERRUPTED, Interruption

if TYPE_CHECKING:
    from covey.faults import Report

VIOLATED = 1
"""Exit code for a protocol that violates an invariant, or a mutant that no seed shows."""

INTERVAL = 2.0
"""Seconds between lines of progress."""


def chaos(
    seeds: Annotated[int, typer.Option(min=1, help="How many seeds to run.")] = 1000,
    seed_start: Annotated[int, typer.Option(min=0, help="The first seed.")] = 0,
    mutant: Annotated[
        str | None, typer.Option(metavar="NAME", help="A protocol that is wrong in one place, to see it caught.")
    ] = None,
    jobs: Annotated[
        int | None, typer.Option("--jobs", "-j", min=1, help="Processes; by default one a processor.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the report as JSON, nothing else.")] = False,
    explore: Annotated[
        Literal["quick", "full"] | None,
        typer.Option(help="Instead of seeds, every interleaving of two and three agents; full explores more of them."),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress.")] = False,
) -> None:
    """Run simulated teams through lost messages, crashes and partitions, and check what must hold.

    Each seed is another team on another network. The first violation is made small and printed with its seed and all
    that led to it; the same seed always shows the same. A mutant's run ends at its first violation. Ctrl-C ends the
    run early and reports what is known by then.

    Exit code: 0 nothing was violated, or the mutant was caught; 1 something was violated, or no seed shows the mutant;
    2 bad usage; 130 Ctrl-C.

    [bold]Examples[/bold]

      covey chaos --seeds 10000

      covey chaos --seeds 1 --seed-start 4711

      covey chaos --seeds 200 --mutant no-escrow

      covey chaos --explore quick
    """
    if explore is not None:
        explore_all(explore, mutant, json=json)
        return
    from covey.faults import campaign

    begun = time.monotonic()
    shown = begun

    with Interruption() as interruption:

        def report_progress(report: Report) -> None:
            nonlocal shown
            interruption.check()
            now = time.monotonic()
            if not quiet and now - shown >= INTERVAL:
                shown = now
                typer.echo(
                    f"covey: {report.seeds} of {seeds} seeds, {report.seeds / (now - begun):.0f} a second, "
                    f"violations: {len(report.violations)}",
                    err=True,
                )

        # One process starts faster than two, and its own start is most of a short run.
        workers = 1 if seeds <= 100 else jobs or os.cpu_count() or 1
        report = campaign(seed_start, seeds, mutant=mutant, workers=workers, on_progress=report_progress)
    if json:
        typer.echo(json_text.dumps(as_json(report), indent=2))
    else:
        print_report(report, time.monotonic() - begun)
    sys.stdout.flush()
    if interruption.noted:
        raise typer.Exit(INTERRUPTED)
    if (mutant is None) == bool(report.violations):
        raise typer.Exit(VIOLATED)


def explore_all(size: Literal["quick", "full"], mutant: str | None, *, json: bool) -> None:
    """Explore team after team, print how many states each has, and leave at a violation."""
    from covey.faults import MORE_SIZES, SIZES, Violation, protocol_named
    from covey.faults import explore as explore_team

    sizes = (*SIZES, *MORE_SIZES) if size == "full" else SIZES
    results: list[dict[str, object]] = []
    violation: Violation | None = None
    for agents, asks in sizes:
        try:
            explored = explore_team(agents, asks=asks, node=protocol_named(mutant))
        except Violation as found:
            violation = found
            break
        counts = {"states": explored.states, "transitions": explored.transitions, "complete": explored.complete}
        results.append({"agents": agents, "asks": asks, **counts})
        if not json:
            how = "complete" if explored.complete else "not complete"
            opened = " + ".join(map(str, asks))
            typer.echo(f"{agents} agents that open {opened} trades: {explored.states} states, {how}")
    if json:
        typer.echo(json_text.dumps({"explored": results, "violation": violation and str(violation)}, indent=2))
    elif violation is not None:
        typer.echo(f"violates {violation}")
    complete = all(result["complete"] for result in results)
    if (mutant is None and not complete) or (mutant is None) == (violation is not None):
        raise typer.Exit(VIOLATED)


def as_json(report: Report) -> dict[str, object]:
    """Return what ``--json`` prints."""
    first = report.first
    return {
        "seeds": report.seeds,
        "violations": len(report.violations),
        "first": None
        if first is None
        else {
            "seed": first.seed,
            "invariant": first.invariant,
            "detail": first.detail,
            "scenario": repr(first.scenario),
            "trace": list(first.trace),
        },
        "coverage": dict(sorted(report.coverage.items())),
    }


def print_report(report: Report, seconds: float) -> None:
    """Print what a campaign has found."""
    rate = report.seeds / seconds if seconds > 0.0 else 0.0
    typer.echo(f"{report.seeds} seeds, {rate:.0f} a second, violations: {len(report.violations)}")
    typer.echo(", ".join(f"{name.replace('_', ' ')} {count}" for name, count in sorted(report.coverage.items())))
    if report.first is not None:
        first = report.first
        typer.echo(f"\nseed {first.seed} violates {first.invariant}: {first.detail}")
        typer.echo(f"made small: {first.scenario}")
        for line in first.trace:
            typer.echo(line)
