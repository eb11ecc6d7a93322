"""Landmarks from a CSV table."""

from __future__ import annotations

import csv
import io
import math
from pathlib import Path

import numpy as np

from covey.environment.files import read_text
from covey.environment.landmarks import Landmarks
from covey.environment.sites import MAX_LANDMARKS
from covey.errors import MissionError, Mistake

MAX_METRES = 1e7
"""Coordinates beyond this are no local metres."""

COLUMNS = ("x_m", "y_m", "weight", "normal_x", "normal_y", "normal_deg")

_MAX_BYTES = 200_000_000
_MAX_MISTAKES = 20


def read_landmarks_csv(path: Path, *, name: str | None = None) -> Landmarks:
    """Read landmarks from a CSV file with a header line.

    Parameters
    ----------
    path : Path
        A table with the columns ``x_m`` and ``y_m``, metres; optional ``weight``, and either ``normal_x`` and
        ``normal_y`` or ``normal_deg``, the direction an oriented landmark faces, degrees counter-clockwise from x.
    name : str, optional
        How mistakes call the file; the path by default.

    Raises
    ------
    InputError
        If the file cannot be read.
    MissionError
        If its content is wrong; each mistake with its line.
    """
    source = name or str(path)
    text = read_text(path, limit=_MAX_BYTES)
    reader = csv.reader(io.StringIO(text, newline=""), strict=True, skipinitialspace=True)
    try:
        header = [cell.strip() for cell in next(reader)]
        mistakes = _header_mistakes(header, source)
        if mistakes:
            raise MissionError(tuple(mistakes))
        rows: list[list[float]] = []
        for cells in reader:
            if not "".join(cells).strip():
                continue
            row, wrong = _row(cells, header, source, reader.line_num)
            rows.append(row)
            mistakes += wrong
            if len(mistakes) >= _MAX_MISTAKES:
                break
            if len(rows) > MAX_LANDMARKS:
                raise MissionError((Mistake(source, None, None, "", f"expected at most {MAX_LANDMARKS:,} landmarks"),))
    except csv.Error as error:
        raise MissionError((Mistake(source, reader.line_num or 1, None, "", f"not valid CSV: {error}"),)) from None
    if mistakes:
        raise MissionError(tuple(mistakes))
    if not rows:
        raise MissionError((Mistake(source, 1, None, "", "expected at least one landmark below the header, got none"),))
    table = dict(zip(header, np.array(rows, dtype=np.float64).T, strict=True))
    normals = None
    if "normal_deg" in table:
        angle = np.deg2rad(table["normal_deg"])
        normals = np.column_stack([np.cos(angle), np.sin(angle)])
    elif "normal_x" in table:
        normals = np.column_stack([table["normal_x"], table["normal_y"]])
    weights = table.get("weight", np.empty(0))
    return Landmarks(np.column_stack([table["x_m"], table["y_m"]]), weights, normals)


def _header_mistakes(header: list[str], source: str) -> list[Mistake]:
    known = ", ".join(COLUMNS)
    mistakes = []
    for column in dict.fromkeys(header):
        if column not in COLUMNS:
            hint = f"known: {known}"
            if ";" in column or "\t" in column:
                hint = "separate columns with commas"
            mistakes.append(Mistake(source, 1, None, "", f"unknown column {column[:60]!r}", hint))
        elif header.count(column) > 1:
            mistakes.append(Mistake(source, 1, None, column, "expected the column once, got it again"))
    for column in ("x_m", "y_m"):
        if column not in header:
            mistakes.append(Mistake(source, 1, None, column, "expected this column, the header lacks it"))
    if ("normal_x" in header) != ("normal_y" in header):
        mistakes.append(Mistake(source, 1, None, "normal_x", "expected normal_x and normal_y together"))
    if "normal_x" in header and "normal_deg" in header:
        mistakes.append(
            Mistake(source, 1, None, "normal_deg", "expected normal_x and normal_y or normal_deg, got both")
        )
    return mistakes


def _row(cells: list[str], header: list[str], source: str, line: int) -> tuple[list[float], list[Mistake]]:
    if len(cells) != len(header):
        return [], [Mistake(source, line, None, "", f"expected {len(header)} columns, got {len(cells)}")]
    row: list[float] = []
    mistakes = []
    for column, cell in zip(header, cells, strict=True):
        try:
            value = float(cell)
        except ValueError:
            value = math.nan
        row.append(value)
        message = ""
        if not math.isfinite(value):
            message = f"expected a finite number, got {cell[:40]!r}"
        elif column in ("x_m", "y_m") and abs(value) > MAX_METRES:
            message = f"expected local metres of at most {MAX_METRES:,.0f}, got {value:g}"
        elif column == "weight" and not 0.0 <= value <= 1e9:
            message = f"expected a weight from 0 to 1e9, got {value:g}"
        elif column != "weight" and abs(value) > MAX_METRES:
            message = f"expected a moderate number, got {value:g}"
        if message:
            mistakes.append(Mistake(source, line, None, column, message))
    if not mistakes and "normal_x" in header:
        x, y = row[header.index("normal_x")], row[header.index("normal_y")]
        if math.hypot(x, y) < 1e-9:
            mistakes.append(Mistake(source, line, None, "normal_x", "expected a normal of some length, got zero"))
    return row, mistakes
