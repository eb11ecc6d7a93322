"""`covey schema`: the JSON Schema of mission and exercise files, for editors and other tools."""

from __future__ import annotations

import json
from typing import Annotated

import typer


def schema(
    exercise: Annotated[bool, typer.Option("--exercise", help="That of exercise files instead.")] = False,
) -> None:
    """Print the JSON Schema of mission files, or of exercise files."""
    from covey.mission import mission_schema
    from covey.mission.exercise import exercise_schema

    chosen = exercise_schema() if exercise else mission_schema()
    typer.echo(json.dumps(chosen, indent=2, ensure_ascii=False))
