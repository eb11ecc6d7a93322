"""Paths on the command line."""

from __future__ import annotations

from pathlib import Path

import typer


def named_path(text: str) -> Path:
    """Make a path of an argument; an empty one, mostly an unset variable of a script, would mean this directory."""
    if not text:
        raise typer.BadParameter("expected a path, got empty text")
    return Path(text)
