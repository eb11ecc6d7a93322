"""Arguments that several commands take."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def named_path(text: str) -> Path:
    """Make a path of an argument; an empty one, mostly an unset variable of a script, would mean this directory."""
    if not text:
        raise typer.BadParameter("expected a path, got empty text")
    return Path(text)


def seed_number(text: str) -> int:
    """Make a seed of an argument."""
    if not (text.isascii() and text.isdigit() and len(text) < 20):
        raise typer.BadParameter(f"expected a whole number from 0 to 2^63 - 1, got {text[:40]!r}")
    return int(text)


Seed = Annotated[
    int | None, typer.Option(parser=seed_number, metavar="N", help="Seed of all randomness, instead of the mission's.")
]
