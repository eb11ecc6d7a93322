"""``covey certify``: check a result from its files alone."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from covey.cli.arguments import named_path
from covey.cli.plan import VIOLATED


def certify(
    directory: Annotated[
        Path,
        typer.Argument(parser=named_path, metavar="DIR", help="What `covey plan` or `covey fly` wrote."),
    ],
    bound: Annotated[bool, typer.Option("--bound", help="Prove what no deployment of this team can exceed.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print the certificate as JSON, nothing else.")] = False,
) -> None:
    """Check a deployment from its result alone, independently of how it was found.

    It holds when every landmark has exactly one owner, every pose is within sigma of the best one for its landmarks,
    and no landmark is better seen by another agent by more than sigma; where a mission limits who can trade, only
    agents that are linked at their poses are compared, and the text says so. Exit code: 0 it holds, 1 it is violated,
    2 there is no result to check, 3 a bound is asked for and an optimiser failed, for example since a sensor is not
    built in. A deployment that leaves out landmarks, owns some twice or leaves its region has no bound to compare with.

    [bold]Examples[/bold]

      covey certify covey-out/scene-7

      covey certify covey-out/scene-7 --bound --json
    """
    from covey.cli.progress import ProgressLine
    from covey.cli.summary import bound_line, certificate_line, link_lines, printable
    from covey.errors import ResultError, SolverError
    from covey.runtime.records.document import bound_document, certificate_document, to_text
    from covey.runtime.records.record import read_result

    deployment = read_result(directory)

    from covey.runtime.certify import bound_team
    from covey.runtime.certify import certify as check

    with ProgressLine() as progress:
        certificate = check(deployment, on_progress=progress)
        team_bound, failure = None, None
        try:
            team_bound = bound_team(deployment, on_progress=progress) if bound else None
        except (ResultError, SolverError) as error:  # the certificate must not be lost with it
            failure = error
    if json:
        document = {
            "certificate": certificate_document(certificate),
            "bound": None if team_bound is None else bound_document(team_bound),
        }
        typer.echo(to_text(document), nl=False)
    else:
        typer.echo(f"{'Proof':<10}{certificate_line(certificate)}")
        for line in link_lines(certificate):
            typer.echo(f"  {line}")
        for violation in certificate.violations:
            typer.echo(f"  {violation.kind}: {printable(violation.message)}")
        if team_bound is not None:
            typer.echo(f"{'Bound':<10}{bound_line(team_bound)}")
    if isinstance(failure, SolverError):
        raise failure
    if failure is not None:
        typer.echo(f"{'Bound':<10}left out: {printable(str(failure))}", err=json)
    if not certificate.holds:
        raise typer.Exit(VIOLATED)
