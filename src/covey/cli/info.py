"""``covey info``: what is in the record of a run."""

from __future__ import annotations

import json as json_text
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from covey.cli.arguments import named_path

if TYPE_CHECKING:
    from covey.runtime.records.mcap_reader import Record

LISTED = 16
"""How many agents are listed."""


def info(
    record: Annotated[
        Path, typer.Argument(parser=named_path, metavar="RECORD", help="record.mcap, or the directory it is in.")
    ],
    json: Annotated[bool, typer.Option("--json", help="Print it as JSON, nothing else.")] = False,
) -> None:
    """Say what is in the record of a run: mission, duration, score, trades, topics, and whether it is complete.

    The record of a run that was killed, or a file that was cut, is read up to where it ends.

    Exit code: 0, or 2 if there is nothing of a run to read.

    [bold]Examples[/bold]

      covey info covey-out/scene-7

      covey info covey-out/scene-7.partial.mcap --json
    """
    from covey.runtime.records.mcap_reader import Record

    with Record(record) as opened:
        found = summarize(opened)
    if json:
        typer.echo(json_text.dumps(found, indent=2, allow_nan=False))
        return
    _print(found)


def summarize(record: Record) -> dict[str, Any]:
    """Return what `covey info` prints, as plain data; the record is read to its end."""
    from covey.runtime.watching.feed import BoundFound, Ended, Scene, TeamChange, TeamState
    from covey.runtime.watching.view import TeamView

    view = TeamView()
    initial: float | None = None
    for item in record.items((Scene, TeamState, TeamChange, BoundFound, Ended)):
        view.apply(item)
        if initial is None and isinstance(item, TeamState):
            initial = float(item.scores.sum())
    scene, ended = record.scene, view.ended
    seconds = record.duration
    return {
        "file": str(record.path),
        "bytes": record.size,
        "complete": record.complete,
        "problems": list(record.problems),
        "run": scene.run.value,
        "mission": scene.mission,
        "seed": scene.seed,
        "sigma": scene.sigma,
        "trade": scene.trade,
        "started": record.metadata.get("started"),
        "duration_s": seconds,
        "landmarks": len(scene.positions_W),
        "score": {"start": initial, "end": view.score},
        "trades": view.trades,
        "bound": view.bound if view.bound == view.bound else None,
        "status": None if ended is None else ended.status,
        "certificate_holds": None if ended is None else ended.holds,
        "agents": [
            {
                "name": agent.name,
                "sensor": agent.sensor,
                "score": float(score),
                "landmarks": int((view.owner == i).sum()),
            }
            for i, (agent, score) in enumerate(zip(view.scene.agents if view.scene else (), view.scores, strict=True))
        ],
        "software": dict(scene.software),
        "topics": {
            name: {
                "type": topic.type,
                "messages": topic.messages,
                "rate_hz": topic.messages / seconds if seconds > 0.0 else None,
            }
            for name, topic in record.topics.items()
            if topic.messages
        },
    }


def _print(found: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from covey.cli.summary import printable
    from covey.runtime.watching.feed import NO_TRADE

    console = Console(highlight=False)
    whole = "CUT" if not found["complete"] else "DAMAGED" if found["problems"] else "complete"
    ended = {None: "it did not end", "settled": "settled", "interrupted": "interrupted"}.get(found["status"], "ended")
    proof = {None: "none", True: "the certificate holds", False: "the certificate is VIOLATED"}
    score = found["score"]
    start = "?" if score["start"] is None else f"{score['start']:.2f}"
    exercise = found["trade"] == NO_TRADE
    if exercise:
        what = ("Exercise", f"{found['mission']}, seed {found['seed']}")
    else:
        what = (
            "Mission",
            f"{found['mission']}, seed {found['seed']}, sigma {found['sigma']:g}, trade {found['trade']}",
        )
    lines = [
        ("Record", f"{found['file']}: {found['bytes'] / 1e6:.2f} MB, {whole}"),
        *(("", problem) for problem in found["problems"]),
        what,
        (
            "Run",
            f"{found['run']} of {found['duration_s']:.3g} s, begun {found['started'] or 'at an unknown time'}; {ended}",
        ),
    ]
    if not exercise:
        lines.append(("Score", f"{start} (start), {score['end']:.2f} (end), {found['trades']} trades"))
        lines.append(("Proof", proof[found["certificate_holds"]]))
    if found["bound"] is not None:
        lines.append(("Bound", f"no deployment of this team exceeds {found['bound']:.2f}"))
    lines.append(("Software", ", ".join(f"{name} {version}" for name, version in found["software"].items())))
    for label, text in lines:
        console.print(Text.assemble((f"{label:<10}", "bold"), printable(text)), soft_wrap=True)
    agents = Table(box=None, pad_edge=False)
    for head in ("agent", "sensor"):
        agents.add_column(head)
    for head in ("landmarks", "score"):
        agents.add_column(head, justify="right")
    for agent in found["agents"][:LISTED]:
        row = (printable(agent["name"]), agent["sensor"], str(agent["landmarks"]), f"{agent['score']:.2f}")
        agents.add_row(*(Text(cell) for cell in row))
    if not exercise:
        console.print(agents)
    if not exercise and len(found["agents"]) > LISTED:
        console.print(Text(f"and {len(found['agents']) - LISTED} more, see --json", style="dim"))
    topics = Table(box=None, pad_edge=False)
    topics.add_column("topic")
    topics.add_column("type")
    topics.add_column("messages", justify="right")
    topics.add_column("Hz", justify="right")
    for name, topic in found["topics"].items():
        rate = "" if topic["rate_hz"] is None else f"{topic['rate_hz']:.3g}"
        topics.add_row(Text(name), Text(topic["type"]), f"{topic['messages']:,}", rate)
    console.print(topics)
