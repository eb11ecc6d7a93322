"""The page that shows chapters 2 and 3 of the thesis beside our flights."""

from __future__ import annotations

import base64
import html
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from covey.runtime.reproduce.findings import Measure, Statement, agrees

if TYPE_CHECKING:
    from covey.runtime.reproduce.flights import Finding

MARK = '<meta name="generator" content="covey reproduce flight">'

RUNS = {
    "ideal": "the thesis's model",
    "reference": "reference simulator",
    "mujoco": "MuJoCo",
    "kinematic": "kinematic",
}
"""How the page calls each run."""

CHAPTERS = (
    ("2", "Chapter 2: control"),
    ("3", "Chapter 3: path planning"),
)

STYLE = """
:root { color-scheme: light dark; --text: #1a1a1a; --faint: #5c5c5c; --line: #ddd; --paper: #fff; --good: #00614a;
  --bad: #a33c00; }
@media (prefers-color-scheme: dark) {
  :root { --text: #e6e6e6; --faint: #a6a6a6; --line: #3c3c3c; --paper: #181a1c; --good: #4cc9a0; --bad: #ff9a5c; }
}
* { box-sizing: border-box; }
body { font: 16px/1.5 system-ui, sans-serif; color: var(--text); background: var(--paper); max-width: 76rem;
  margin: 2rem auto; padding: 0 1rem; overflow-wrap: break-word; }
h1 { font-size: 1.6rem; line-height: 1.25; }
h2 { font-size: 1.3rem; margin-top: 3rem; border-bottom: 2px solid var(--line); }
h3 { font-size: 1.1rem; margin: 2.5rem 0 0; }
p, li { max-width: 46rem; }
a { color: inherit; }
.where, figcaption { color: var(--faint); font-size: 0.9rem; }
.where { margin: 0; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; margin: 0.8rem 0; }
th, td { padding: 0.3rem 0.8rem; border-bottom: 1px solid var(--line); text-align: right; font-weight: normal;
  vertical-align: top; }
thead th { border-bottom: 2px solid var(--faint); color: var(--faint); }
th:first-child { text-align: left; padding-left: 0; }
td { white-space: nowrap; }
.yes { color: var(--good); }
.no { color: var(--bad); font-weight: 600; }
.figures { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 24rem), 1fr)); gap: 1.5rem; }
figure { margin: 0; }
img { width: 100%; height: auto; background: #fff; border-radius: 4px; display: block; }
@media (max-width: 40rem) {
  body { margin: 1rem auto; }
  th, td { padding: 0.3rem 0.4rem; font-size: 0.9rem; }
  .measured, .measured thead, .measured tbody { display: block; }
  .measured tr { display: grid; grid-template-columns: repeat(var(--runs), 1fr); }
  .measured th:first-child { grid-column: 1 / -1; border: 0; padding: 0.5rem 0 0; }
  .measured td, .measured thead th + th { text-align: left; padding-left: 0; }
}
"""


@dataclass(frozen=True)
class Image:
    """A figure in the page's folder.

    Parameters
    ----------
    name : str
        Its files without their endings.
    statement : str
        Key of the statement it belongs to.
    caption : str
    run : str
    """

    name: str
    statement: str
    caption: str
    run: str


def page(findings: Sequence[Finding], images: Sequence[Image], folder: Path, *, note: str = "") -> str:
    """Return the page, which holds the figures of the folder itself, with a note on the run if there is one."""
    parts = []
    for number, title in CHAPTERS:
        parts.append(f"<h2>{html.escape(title)}</h2>")
        for finding in findings:
            if finding.statement.where.startswith(f"section {number}."):
                shown = [image for image in images if image.statement == finding.statement.key]
                parts.append(_section(finding, shown, folder))
    labels = list(dict.fromkeys(label for finding in findings for label in finding.measures))
    counts = sum(finding.agrees for finding in findings)
    body = "\n".join(parts)
    remark = f"\n<p><b>{html.escape(note)}</b></p>" if note else ""
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
{MARK}
<title>Chapters 2 and 3 of the thesis, flown again</title>
<style>{STYLE}</style>
</head>
<body>
<h1>Chapters 2 and 3 of the thesis, flown again</h1>
<p>What M. Sposato's thesis (KTH, 2016) shows of its controller and its collision avoidance, in one sentence each, and
what we measured: by the thesis's own model, which has neither rotors nor limits nor a body, and in simulators of an
Iris+ with drag, rotors that lag, and navigation that keeps vehicles apart. {counts} of {len(findings)} statements
hold in every run. Numbers that are not as the thesis says are marked.</p>{remark}
{_overview(findings, labels)}
{body}
<p>Every number is in <a href="measures.csv">measures.csv</a>; each figure is a link to its PDF.</p>
</body>
</html>
"""


def _overview(findings: Sequence[Finding], labels: Sequence[str]) -> str:
    head = "".join(f"<th>{html.escape(_run(label))}</th>" for label in labels)
    rows = []
    for finding in findings:
        cells = "".join(f"<td>{_verdict(finding.measures.get(label))}</td>" for label in labels)
        link = f'<a href="#{finding.statement.key}">{html.escape(finding.statement.title)}</a>'
        rows.append(f"<tr><th>{link}</th>{cells}</tr>")
    body = "\n".join(rows)
    return (
        f'<div class="scroll"><table>\n<thead><tr><th>what the thesis shows</th>{head}</tr></thead>\n'
        f"<tbody>\n{body}\n</tbody></table></div>"
    )


def _section(finding: Finding, images: Sequence[Image], folder: Path) -> str:
    statement: Statement = finding.statement
    labels = list(finding.measures)
    head = "".join(f"<th>{html.escape(_run(label))}</th>" for label in labels)
    quantities = list(dict.fromkeys(m.quantity for measures in finding.measures.values() for m in measures))
    rows = []
    for quantity in quantities:
        cells = []
        for label in labels:
            found = next((m for m in finding.measures[label] if m.quantity == quantity), None)
            cells.append(f"<td>{_value(found)}</td>")
        rows.append(f"<tr><th>{html.escape(quantity)}</th>{''.join(cells)}</tr>")
    verdicts = "".join(f"<td>{_verdict(finding.measures[label])}</td>" for label in labels)
    figures = "\n".join(_figure(image, folder) for image in images)
    body = "\n".join(rows)
    asked = html.escape(statement.asked[0].upper() + statement.asked[1:])
    where = html.escape(statement.where[0].upper() + statement.where[1:])
    return f"""<h3 id="{statement.key}">{html.escape(statement.title)}</h3>
<p class="where">{where}</p>
<p><b>The thesis:</b> {html.escape(statement.thesis)}<br><b>Asked of ours:</b> {asked}.</p>
<div class="scroll"><table class="measured" style="--runs: {len(labels)}">
<thead><tr><th>measured</th>{head}</tr></thead>
<tbody>
{body}
<tr><th>as the thesis says</th>{verdicts}</tr>
</tbody></table></div>
<div class="figures">
{figures}
</div>"""


def _figure(image: Image, folder: Path) -> str:
    data = base64.b64encode((folder / f"{image.name}.png").read_bytes()).decode("ascii")
    caption = html.escape(f"{image.caption}, {_run(image.run)}.")
    return (
        f'<figure><a href="{image.name}.pdf"><img src="data:image/png;base64,{data}" alt="{caption}"></a>'
        f"<figcaption>{caption}</figcaption></figure>"
    )


def _run(label: str) -> str:
    return RUNS.get(label, label)


def _verdict(measures: tuple[Measure, ...] | None) -> str:
    if measures is None:
        return "–"
    return '<span class="yes">agrees</span>' if agrees(measures) else '<span class="no">differs</span>'


def _value(measure: Measure | None) -> str:
    if measure is None or math.isnan(measure.value):
        return "–"
    value, unit = measure.value, measure.unit
    if unit in ("m", "m/s") and 1e-6 <= abs(value) < 0.01:
        value, unit = 1e3 * value, f"m{unit}"
    if math.isinf(value):
        text, unit = "never", ""
    elif unit == "" and value == int(value):
        text = str(int(value))
    else:
        text = f"{value:.3g}"
        if "e" in text:
            mantissa, _, exponent = text.partition("e")
            text = f"{mantissa} · 10<sup>{str(int(exponent)).replace('-', '−')}</sup>"
    unit = f" {html.escape(unit)}" if unit and unit != "°" else unit
    css = ' class="no"' if measure.holds is False else ""
    return f"<span{css}>{text}{unit}</span>"
