"""`covey schema`: the JSON Schema of mission files, for editors and other tools."""

from __future__ import annotations

import json

import typer


def schema() -> None:
    """Print the JSON Schema of mission files."""
    from covey.mission import mission_schema

    typer.echo(json.dumps(mission_schema(), indent=2, ensure_ascii=False))
