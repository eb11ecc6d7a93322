from __future__ import annotations

import csv
import re
from pathlib import Path

import pytest

from covey.errors import OutputError
from covey.runtime.reproduce.findings import STATEMENTS, Measure, Run, Statement
from covey.runtime.reproduce.flights import DRAWINGS, NAMES, Finding, findings_text, reproduce_flight
from covey.runtime.reproduce.page import Image, page
from covey.runtime.reproduce.scenes import SCENES
from covey.runtime.result import Progress


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three scenes, one figure each and short flights: what comes out is no concern here."""
    keys = ("regulation", "swap", "leader-follower")
    scenes = {name: re.sub(r"duration_s: \d+", "duration_s: 1", SCENES[name]) for name in keys}
    for name in set(SCENES) - set(keys):
        monkeypatch.delitem(SCENES, name)
    for name, text in scenes.items():
        monkeypatch.setitem(SCENES, name, text)

    def measured(run: Run) -> tuple[Measure, ...]:
        return (Measure("time <at> the end", float(run.log.time[-1]), "s", run.log.simulator != "reference"),)

    statements = tuple(
        Statement(s.key, s.title, s.where, s.scene, s.thesis, s.asked, measured) for s in STATEMENTS if s.key in keys
    )
    drawn = ("figure-2.2", "swap-separation", "leader-follower-error")
    drawings = tuple(drawing for drawing in DRAWINGS if drawing.name in drawn)
    monkeypatch.setattr("covey.runtime.reproduce.flights.STATEMENTS", statements)
    monkeypatch.setattr("covey.runtime.reproduce.flights.DRAWINGS", drawings)


@pytest.mark.usefixtures("short")
def test_page_figures_and_table(tmp_path: Path) -> None:
    told: list[Progress] = []
    findings = reproduce_flight(tmp_path / "r", simulators=["kinematic", "reference"], on_progress=told.append)
    folder = tmp_path / "r"
    fractions = [news.fraction or 0.0 for news in told]
    assert fractions == sorted(fractions)
    assert fractions[-1] < 1.0
    assert {path.name for path in folder.iterdir()} <= set(NAMES)
    text = (folder / "index.html").read_text(encoding="utf-8")
    for link in re.findall(r'href="([^"#]+)"', text):
        assert (folder / link).stat().st_size > 100
    sources = re.findall(r'src="([^"]+)"', text)
    assert len(sources) == len(list(folder.glob("*.png"))) == 5  # of the follower there is no flight by the model
    assert all(source.startswith("data:image/png;base64,") for source in sources)
    assert "prefers-color-scheme: dark" in text
    assert 'name="viewport"' in text
    assert "time &lt;at&gt; the end" in text
    assert "<at>" not in text
    with (folder / "measures.csv").open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [(row["statement"], row["run"]) for row in rows] == [
        (finding.statement.key, label) for finding in findings for label in finding.measures
    ]
    assert {row["as_the_thesis_says"] for row in rows if row["run"] == "reference"} == {"no"}
    assert list(findings[0].measures) == ["ideal", "kinematic", "reference"]
    assert [finding.agrees for finding in findings] == [False] * 3
    lines = findings_text(findings).splitlines()
    assert lines[0].split()[-3:] == ["ideal", "kinematic", "reference"]
    assert [line.split()[-3:] for line in lines[1:]] == [
        ["agrees", "agrees", "differs"],
        ["-", "agrees", "differs"],
        ["agrees", "agrees", "differs"],
    ]


@pytest.mark.usefixtures("short")
def test_an_earlier_reproduction_is_replaced_only_when_asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("covey.runtime.reproduce.flights.DRAWINGS", ())
    reproduce_flight(tmp_path, simulators=["kinematic"])
    with pytest.raises(OutputError, match="not empty"):
        reproduce_flight(tmp_path, simulators=["kinematic"])
    reproduce_flight(tmp_path, simulators=["kinematic"], overwrite=True)
    (tmp_path / "index.html").write_text("mine")
    with pytest.raises(OutputError, match="not written by covey"):
        reproduce_flight(tmp_path, simulators=["kinematic"], overwrite=True)


def test_ctrl_c_leaves_nothing_behind(tmp_path: Path) -> None:
    def stop(news: Progress) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        reproduce_flight(tmp_path / "r", on_progress=stop)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("short")
@pytest.mark.parametrize(
    ("last", "flown", "figures"), [("flying swap", 2, 2), ("drawing swap-separation", 3, 2)], ids=["flying", "drawing"]
)
def test_ctrl_c_keeps_what_is_finished(last: str, flown: int, figures: int, tmp_path: Path) -> None:
    heard = False

    def stop(news: Progress) -> None:
        nonlocal heard
        heard = heard or news.stage == last
        if heard:
            raise KeyboardInterrupt

    findings = reproduce_flight(tmp_path / "r", simulators=["kinematic"], on_progress=stop)
    assert len(findings) == flown
    page = (tmp_path / "r" / "index.html").read_text(encoding="utf-8")
    assert f"The run was interrupted: {flown} of {len(SCENES)} scenes were flown." in page
    assert (tmp_path / "r" / "measures.csv").exists()
    assert len(list((tmp_path / "r").glob("*-flown.png"))) == figures
    assert all((tmp_path / "r" / link).exists() for link in re.findall(r'href="([^"#]+)"', page))


def test_each_statement_says_where_and_has_a_figure() -> None:
    keys = [item.key for item in STATEMENTS]
    assert len(set(keys)) == len(keys)
    assert {drawing.statement for drawing in DRAWINGS} == set(keys)
    assert {item.scene for item in STATEMENTS} == set(SCENES)
    for item in STATEMENTS:
        assert re.fullmatch(r"section [23]\.\d(\.\d)?, (Figures? .*, )?page \d\d", item.where), item.where
        assert item.thesis.endswith(".")
    figures = {drawing.name for drawing in DRAWINGS}
    assert {f"figure-2.{k}" for k in range(2, 10)} | {f"figure-3.{k}" for k in range(1, 5)} <= figures


@pytest.mark.parametrize(
    ("value", "unit", "shown"),
    [
        (0.9612, "m", "0.961 m"),
        (0.00044, "m", "0.44 mm"),
        (2.1e-8, "m/s", "2.1 · 10<sup>−8</sup> m/s"),
        (3.0, "", "3"),
        (0.25, "", "0.25"),
        (179.96, "°", "180°"),
        (float("inf"), "s", "never"),
        (float("nan"), "m", "–"),
    ],
)
def test_numbers_are_easy_to_read(value: float, unit: str, shown: str, tmp_path: Path) -> None:
    finding = Finding(STATEMENTS[0], {"ideal": (Measure("q", value, unit, False),)})
    (tmp_path / "a.png").write_bytes(b"\x89PNG")
    text = page([finding], [Image("a", STATEMENTS[0].key, "A", "ideal")], tmp_path)
    cell = re.search(r"<tr><th>q</th><td>(.*?)</td></tr>", text)
    assert cell is not None
    assert re.sub(r"</?span[^>]*>", "", cell.group(1)) == shown
