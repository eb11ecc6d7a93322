"""Result directories: written whole or not at all, and read back."""

from __future__ import annotations

import csv
import io
import itertools
import math
import os
import re
from collections.abc import Callable
from pathlib import Path

from covey.errors import ResultError
from covey.runtime.records import document
from covey.runtime.records.output import check_target, staged
from covey.runtime.result import Deployment

RESULT = "result.json"
RECORD = "record.mcap"
FLIGHT_FILES = ("flight.npz", "flight.png", "flight.pdf", "flight.mp4", "flight.gif")
FILES = (
    "agents.csv",
    "deployment.png",
    "deployment.pdf",
    "deployment.geojson",
    *FLIGHT_FILES,
    "launch.json",
    RECORD,
    RESULT,
)
"""What a result directory may hold; `RESULT` last, since a directory that has it is complete."""

MAX_BYTES = 500_000_000
"""Size of a ``result.json``, bytes; one of a million landmarks has a tenth of it."""

DEFAULT_PARENT = Path("covey-out")


def write_result(
    deployment: Deployment,
    directory: str | Path,
    *,
    overwrite: bool = False,
    more: Callable[[Path], object] | None = None,
) -> Path:
    """Write a deployment into a directory.

    The files are made beside their place and then moved there, so that a full disk or Ctrl-C leaves either the complete
    result or none.

    Parameters
    ----------
    deployment : Deployment
    directory : str or Path
        It is made if need be.
    overwrite : bool
        Replace an earlier result of covey there.  Other files in the directory stay as they are.
    more : callable, optional
        Writes others of `FILES` into the directory that it is given.

    Returns
    -------
    Path
        The directory.

    Raises
    ------
    OutputError
        If something is there already, or it cannot be written.
    """
    target = Path(directory)
    check_result_target(target, overwrite=overwrite)
    with staged(target, FILES) as staging:
        if more is not None:
            more(staging)
        _write_files(deployment, staging, target)
    return target


def check_result_target(directory: str | Path, *, overwrite: bool = False) -> None:
    """Check that a result may be written into a directory, before any work is done.

    Raises
    ------
    OutputError
        If the directory holds something that would be overwritten, is a file, or cannot be made.
    """
    check_target(Path(directory), FILES, _is_result, overwrite=overwrite)


def default_directory(name: str, seed: int) -> Path:
    """Return a directory for a result that nobody named: ``covey-out/NAME-SEED``, numbered where that is taken.

    Examples
    --------
    >>> default_directory("a/b c", 7).name
    'a-b-c-7'
    """
    slug = re.sub(r"[^\w.-]+", "-", name).strip("-.")[:60] or "mission"
    for number in itertools.count(1):
        candidate = DEFAULT_PARENT / (f"{slug}-{seed}" if number == 1 else f"{slug}-{seed}-{number}")
        if not os.path.lexists(candidate):
            return candidate
    raise AssertionError("unreachable")


def read_result(directory: str | Path) -> Deployment:
    """Read a result directory back.

    Parameters
    ----------
    directory : str or Path
        The directory, or its ``result.json``.

    Returns
    -------
    Deployment
        As it was written, but without snapshots.

    Raises
    ------
    ResultError
        If it is missing, no regular file, too large or no JSON, lacks a key, or a value has the wrong type; the text
        names the file and the key.
    """
    path = Path(directory)
    try:
        if path.is_dir():
            path = path / RESULT
        if path.exists() and not path.is_file():  # a pipe or a device may never end
            raise ResultError(f"{path}: expected a regular file or a directory")
        if path.exists() and path.stat().st_size > MAX_BYTES:
            raise ResultError(f"{path}: expected at most {MAX_BYTES:,} bytes, got {path.stat().st_size:,}")
        text = path.read_bytes().decode("utf-8")
    except FileNotFoundError as error:
        expected = "expected a directory that `covey plan` or `covey fly` wrote"
        raise ResultError(f"{path}: no result here; {expected}") from error
    except UnicodeDecodeError as error:
        raise ResultError(f"{path}: expected JSON in UTF-8, got other bytes") from error
    except (OSError, ValueError) as error:
        raise ResultError(f"{str(path)!r}: cannot be read: {error}") from error
    try:
        return document.from_text(text, folder=path.parent)
    except ResultError as error:
        raise ResultError(f"{path}: {error}") from error


def result_text(deployment: Deployment, directory: str | Path) -> str:
    """Return the content of ``result.json`` as it is written into a directory."""
    return document.to_text(document.to_document(deployment, folder=Path(directory)))


def agents_csv(deployment: Deployment) -> str:
    """Return the agents as CSV, one a row; geographic missions add longitude, latitude and compass heading."""
    reference = deployment.mission.georeference
    header = ["name", "x_m", "y_m", "yaw_deg", "score", "landmark_count"]
    if reference is not None:
        header += ["lon_deg", "lat_deg", "heading_deg"]
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(header)
    for agent in deployment.agents:
        yaw_deg = math.degrees(agent.pose.yaw)
        row: list[object] = [agent.name, agent.pose.x, agent.pose.y, yaw_deg, agent.score, len(agent.landmarks)]
        if reference is not None:
            lon, lat = (float(value) for value in reference.to_lonlat(agent.pose.position_W[None, :])[0])
            row += [lon, lat, (90.0 - yaw_deg) % 360.0]
        writer.writerow(row)
    return buffer.getvalue()


def _write_files(deployment: Deployment, staging: Path, target: Path) -> None:
    from covey.runtime.drawing import figures
    from covey.runtime.records import geojson

    (staging / "agents.csv").write_text(agents_csv(deployment), encoding="utf-8")
    if deployment.mission.georeference is not None:
        text = document.to_text(geojson.to_geojson(deployment))
        (staging / "deployment.geojson").write_text(text, encoding="utf-8")
    figure = figures.deployment_figure(deployment)
    for kind in ("png", "pdf"):
        figures.save_figure(figure, staging / f"deployment.{kind}")
    (staging / RESULT).write_text(result_text(deployment, target), encoding="utf-8")


def _is_result(target: Path) -> bool:
    try:
        deployment = read_result(target)
    except ResultError:
        return False
    return "covey" in deployment.software
