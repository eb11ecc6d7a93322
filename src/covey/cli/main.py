"""The command ``covey``: its subcommands, and how errors and broken pipes end it."""

from __future__ import annotations

import os
import signal
import sys
from typing import Annotated

import typer

from covey import __version__
from covey.cli.agent import agent
from covey.cli.certify import certify
from covey.cli.change import change
from covey.cli.chaos import chaos
from covey.cli.figures import figures
from covey.cli.fly import fly
from covey.cli.heatmap import heatmap
from covey.cli.info import info
from covey.cli.interrupt import leave_at_once
from covey.cli.launch import launch
from covey.cli.plan import plan
from covey.cli.playground import playground
from covey.cli.replay import replay
from covey.cli.reproduce import reproduce
from covey.cli.schema import schema
from covey.cli.validate import validate
from covey.errors import CoveyError, MissionError

UNHEARD = 141
"""Exit code when the output is a pipe that was closed, as `head` does: what shells say of SIGPIPE."""

app = typer.Typer(
    name="covey",
    help="Place a team of cameras so that a set of landmarks is seen as well as possible, and prove how well.",
    epilog="Start with: covey plan MISSION.yaml",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)
for command in (
    plan,
    fly,
    playground,
    replay,
    launch,
    agent,
    change,
    info,
    figures,
    certify,
    validate,
    schema,
    reproduce,
    heatmap,
    chaos,
):
    app.command()(command)


def _print_version(asked: bool) -> None:
    if asked:
        typer.echo(f"covey {__version__}")
        raise typer.Exit


@app.callback()
def _covey(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    pass


def main(arguments: list[str] | None = None) -> None:
    """Run the command and leave the process.

    Parameters
    ----------
    arguments : list of str, optional
        By default those of the process.

    Raises
    ------
    SystemExit
        Always: 0 for success, 1 for a deployment that violates its certificate or a protocol that violates an
        invariant, 2 for bad input or usage, 3 for an optimiser that failed, 4 for a flight that failed or an agent that
        was started again elsewhere, 130 for Ctrl-C, 141 if nobody reads the output any more.
    """
    before = signal.signal(signal.SIGINT, leave_at_once)
    try:
        app(args=arguments, prog_name="covey")
    except CoveyError as error:
        print_error(error)
        _leave(error.exit_code)
    except OSError as error:
        what = "" if error.filename is not None else "the output cannot be written: "
        typer.echo(f"covey: {what}{error.strerror if what else error}", err=True)
        _leave(CoveyError.exit_code)
    except SystemExit as leaving:
        if isinstance(leaving.__context__, BrokenPipeError):  # typer leaves with 1, which means something else here
            _leave(UNHEARD)
        _leave(leaving.code if isinstance(leaving.code, int) else 0)
    finally:
        signal.signal(signal.SIGINT, before)


def print_error(error: CoveyError) -> None:
    """Print an error on stderr: the mistakes of a mission one a line, as compilers do; anything else as one message."""
    text = str(error) if isinstance(error, MissionError) else f"covey: {error}"
    shown = "".join(character if character.isprintable() or character == "\n" else "?" for character in text)
    typer.echo(shown, err=True)


def _leave(code: int) -> None:
    """Exit, with output that nobody reads any more thrown away and output that cannot be stored reported."""
    try:
        sys.stdout.flush()
    except OSError as error:
        # Python flushes once more when it ends; that must not fail again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if not isinstance(error, BrokenPipeError):
            typer.echo(f"covey: the output cannot be written: {error.strerror}", err=True)
            code = 2
    sys.exit(code)
