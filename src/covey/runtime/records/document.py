"""The format of ``result.json``: a deployment as plain data, and back.

The document holds all that a certificate needs (landmarks, sensors, regions, poses, who owns what), so that it can be
checked without the mission file.  Keys carry their unit; numbers keep all their digits; what is not known is null.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from covey.coverage.certificate import Certificate, LinkedPairs, TeamBound, Violation
from covey.environment import Landmarks
from covey.environment.georeference import GeoReference
from covey.errors import ArgumentError, ResultError
from covey.geometry import Pose2, Region
from covey.mission import (
    AgentSpec,
    Assignment,
    CommunicationSpec,
    CoverageSpec,
    Mission,
    OptimizerName,
    SensorSpec,
    Trade,
)
from covey.mission.flight import Separation
from covey.runtime.records.checked import CheckedValue, parse_json
from covey.runtime.records.flight_document import flight_document, read_flight
from covey.runtime.result import AgentResult, Baseline, Deployment, HistoryEntry, PlanStatus, Scores

SCHEMA_VERSION = 1


def to_document(deployment: Deployment, *, folder: Path | None = None) -> dict[str, Any]:
    """Return a deployment as plain data, ready for JSON.

    Parameters
    ----------
    deployment : Deployment
    folder : Path, optional
        Where the document will lie: the mission's file is named relative to it.
    """
    mission = deployment.mission
    landmarks = mission.landmarks
    certificate, bound, baseline = deployment.certificate, deployment.bound, deployment.baseline
    agents = [
        {
            "name": agent.name,
            "pose": _pose(agent.pose),
            "score": _number(agent.score),
            "landmarks": [int(index) for index in agent.landmarks],
            "start": _pose(spec.pose),
            "drawn": bool(spec.drawn),
            "sensor": _sensor(spec.sensor, folder),
            "region": None if spec.region is mission.region else _region(spec.region),
        }
        for agent, spec in zip(deployment.agents, mission.agents, strict=True)
    ]
    return {
        "schema_version": SCHEMA_VERSION,
        "mission": _mission(mission, folder),
        "seed": int(deployment.seed),
        "sigma": float(deployment.sigma),
        "trade": deployment.trade.value,
        "optimizer": deployment.optimizer.value,
        "status": deployment.status.value,
        "score": {
            name: _number(getattr(deployment.score, name))
            for name in ("initial", "after_first_optimization", "after_first_trade", "final")
        },
        "score_history": [_number(entry.score) for entry in deployment.history],
        "score_events": [
            {"event": entry.event, "agents": list(entry.agents)} | ({"detail": entry.detail} if entry.detail else {})
            for entry in deployment.history
        ],
        "trades": int(deployment.trades),
        "pose_optimizations": int(deployment.pose_optimizations),
        "agents": agents,
        "landmarks": {
            "positions_m": landmarks.positions_W.tolist(),
            "weights": landmarks.weights.tolist(),
            "normals": None if landmarks.normals_W is None else landmarks.normals_W.tolist(),
            "cell_size_m": landmarks.cell_size,
        },
        "certificate": None if certificate is None else certificate_document(certificate),
        "bound": None if bound is None else bound_document(bound),
        "baseline": None
        if baseline is None
        else {"greedy": _number(baseline.greedy), "greedy_lloyd": _number(baseline.greedy_lloyd)},
        "flight": None if deployment.flight is None else flight_document(deployment.flight),
        "timing_s": {str(key): _number(value) for key, value in deployment.timing_s.items()},
        "software": {str(key): str(value) for key, value in deployment.software.items()},
    }


def to_text(document: Mapping[str, Any]) -> str:
    """Write a document as JSON, one key a line, and lists of objects one object a line."""
    lines = []
    for key, value in document.items():
        if isinstance(value, list) and value and isinstance(value[0], dict):
            items = ",\n    ".join(json.dumps(item, allow_nan=False) for item in value)
            text = f"[\n    {items}\n  ]"
        else:
            text = json.dumps(value, allow_nan=False)
        lines.append(f"  {json.dumps(key)}: {text}")
    return "{\n" + ",\n".join(lines) + "\n}\n"


def certificate_document(certificate: Certificate) -> dict[str, Any]:
    """Return a certificate as plain data."""
    return {
        "holds": bool(certificate.holds),
        "sigma": float(certificate.sigma),
        "worst_pose_gap": _number(certificate.worst_pose_gap),
        "worst_trade_gain": _number(certificate.worst_trade_gain),
        "violations": [
            {
                "kind": violation.kind,
                "agents": list(violation.agents),
                "landmark": None if violation.landmark is None else int(violation.landmark),
                "amount": _number(violation.amount),
                "message": violation.message,
            }
            for violation in certificate.violations
        ],
        "links": None
        if certificate.links is None
        else {
            "linked": certificate.links.linked,
            "pairs": certificate.links.pairs,
            "groups": [list(group) for group in certificate.links.groups],
        },
    }


def bound_document(bound: TeamBound) -> dict[str, Any]:
    """Return a team bound as plain data."""
    return {"team_upper_bound": _number(bound.team_upper_bound), "gap": _number(bound.gap)}


def from_text(text: str, *, folder: Path | None = None) -> Deployment:
    """Read a document back.

    Parameters
    ----------
    text : str
        The content of ``result.json``.
    folder : Path, optional
        Where it lies; the mission's file is named relative to it.

    Raises
    ------
    ResultError
        If it is not JSON, or a key is missing or has the wrong type; the text names the key.
    """
    root = parse_json(text)
    content = root.mapping()
    if "exercise" in content and "mission" not in content:
        raise ResultError("expected the result of a mission, got that of an exercise, which deploys nobody")
    version = root["schema_version"]
    if version.integer() != SCHEMA_VERSION:
        version.fail(f"{SCHEMA_VERSION}, the only version that this covey reads")
    try:
        return _deployment(root, folder)
    except ArgumentError as error:
        raise ResultError(str(error)) from error


def _deployment(root: CheckedValue, folder: Path | None) -> Deployment:
    landmarks = _read_landmarks(root["landmarks"])
    n = len(landmarks)
    mission_value = root["mission"]
    region = _read_region(mission_value["region"])
    specs, results = [], []
    names: set[str] = set()
    for value in root["agents"].items():
        name = value["name"].text()
        if name in names:
            value["name"].fail("a name that no other agent has")
        names.add(name)
        own = value.get("region")
        specs.append(
            AgentSpec(
                name=name,
                pose=_read_pose(value["start"]),
                sensor=_read_sensor(value["sensor"], folder),
                region=region if own is None else _read_region(own),
                drawn=value["drawn"].truth(),
            )
        )
        results.append(
            AgentResult(name, _read_pose(value["pose"]), value["score"].number(), value["landmarks"].indices(n))
        )
    if not specs:
        root["agents"].fail("at least one agent")
    sigma = root["sigma"].number()
    if sigma <= 0.0:
        root["sigma"].fail("a number above 0")
    scores = root["score"]
    mission = _read_mission(mission_value, landmarks, region, tuple(specs), folder)
    if sigma != mission.coverage.sigma:
        root["sigma"].fail(f"{mission.coverage.sigma!r}, as in mission.coverage.sigma")
    if root["seed"].integer() != mission.seed:
        root["seed"].fail(f"{mission.seed}, as in mission.seed")
    return Deployment(
        mission=mission,
        seed=root["seed"].integer(),
        sigma=sigma,
        trade=root["trade"].member(Trade),
        optimizer=root["optimizer"].member(OptimizerName),
        status=root["status"].member(PlanStatus),
        score=Scores(
            *(
                scores[name].known(math.nan)
                for name in ("initial", "after_first_optimization", "after_first_trade", "final")
            )
        ),
        history=_read_history(root),
        trades=root["trades"].integer(),
        pose_optimizations=root["pose_optimizations"].integer(),
        agents=tuple(results),
        certificate=_read_certificate(root.get("certificate")),
        bound=_read_bound(root.get("bound")),
        baseline=_read_baseline(root.get("baseline")),
        flight=None if root.mapping().get("flight") is None else read_flight(root["flight"]),
        timing_s={key: value.known(math.nan) for key, value in root["timing_s"].members()},
        software={key: value.text() for key, value in root["software"].members()},
    )


# ---------------------------------------------------------------------------------------------------- writing the parts


def _number(value: float) -> float | None:
    number = float(value)
    return number if math.isfinite(number) else None


def _pose(pose: Pose2) -> dict[str, float]:
    return {"x_m": pose.x, "y_m": pose.y, "yaw_deg": math.degrees(pose.yaw)}


def _sensor(sensor: SensorSpec, folder: Path | None) -> dict[str, Any]:
    file, colon, name = sensor.model.rpartition(":")
    model = f"{_file_name(Path(file), folder)}:{name}" if colon and file.endswith(".py") else sensor.model
    return {"model": model, "options": _plain(sensor.options)}


def _region(region: Region) -> dict[str, Any]:
    return {"exterior_m": region.exterior.tolist(), "holes_m": [hole.tolist() for hole in region.holes]}


def _mission(mission: Mission, folder: Path | None) -> dict[str, Any]:
    coverage, reference = mission.coverage, mission.georeference
    assignment = coverage.assignment
    return {
        "schema_version": int(mission.schema_version),
        "name": mission.name,
        "file": _file_name(mission.path, folder),
        "seed": int(mission.seed),
        "region": _region(mission.region),
        "sensor": _sensor(mission.sensor, folder),
        "coverage": {
            "sigma": float(coverage.sigma),
            "trade": coverage.trade.value,
            "optimizer": coverage.optimizer.value,
            "assignment": assignment.value
            if isinstance(assignment, Assignment)
            else {name: [int(index) for index in indices] for name, indices in assignment.items()},
        },
        "communication": None
        if mission.communication is None
        else {"range_m": mission.communication.range, "links": _plain(mission.communication.links)},
        "georeference": None
        if reference is None
        else {"lon_deg": reference.lon_deg, "lat_deg": reference.lat_deg, "alt_m": reference.alt_m},
        "separation": None
        if mission.separation is None
        else {"spacing_m": mission.separation.spacing, "layers": list(mission.separation.layers)},
        "document": _plain(mission.source),
    }


def _file_name(path: Path | None, folder: Path | None) -> str | None:
    if path is None:
        return None
    if folder is not None:
        try:
            return Path(os.path.relpath(path, folder)).as_posix()
        except ValueError:  # on another drive of a Windows machine
            return path.name
    return path.name


def _plain(value: object) -> Any:
    """Make JSON of what a YAML or TOML file may hold: dates become text, NaN and infinity null."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, bool) or value is None:
        return value
    if isinstance(value, int):
        return int(value)
    if isinstance(value, float):
        return _number(value)
    return str(value)


# ---------------------------------------------------------------------------------------------------- reading the parts


def _read_landmarks(value: CheckedValue) -> Landmarks:
    positions = value["positions_m"].array(2)
    if not len(positions):
        value["positions_m"].fail("at least one landmark")
    weights = value["weights"].array(None)
    if len(weights) != len(positions):
        value["weights"].fail(f"{len(positions)} numbers, one a landmark")
    normals, size = value.get("normals"), value.get("cell_size_m")
    if size is not None and size.number() <= 0.0:
        size.fail("a number above 0")
    return Landmarks(
        positions,
        weights,
        None if normals is None else normals.array(2),
        None if size is None else size.number(),
    )


def _read_region(value: CheckedValue) -> Region:
    return Region(value["exterior_m"].array(2), tuple(hole.array(2) for hole in value["holes_m"].items()))


def _read_pose(value: CheckedValue) -> Pose2:
    return Pose2(value["x_m"].number(), value["y_m"].number(), math.radians(value["yaw_deg"].number()))


def _read_sensor(value: CheckedValue, folder: Path | None) -> SensorSpec:
    model = value["model"].text()
    file, colon, name = model.rpartition(":")
    if colon and file.endswith(".py") and folder is not None:
        model = f"{(folder / file).resolve()}:{name}"
    return SensorSpec(model, {key: item.number() for key, item in value["options"].members()})


def _read_mission(
    value: CheckedValue, landmarks: Landmarks, region: Region, agents: tuple[AgentSpec, ...], folder: Path | None
) -> Mission:
    coverage = value["coverage"]
    assignment = coverage["assignment"]
    reference, file = value.get("georeference"), value.get("file")
    path = None if file is None else Path(file.text())
    return Mission(
        schema_version=value["schema_version"].integer(),
        name=value["name"].text(),
        seed=value["seed"].integer(),
        landmarks=landmarks,
        region=region,
        sensor=_read_sensor(value["sensor"], folder),
        agents=agents,
        coverage=CoverageSpec(
            sigma=coverage["sigma"].number(),
            trade=coverage["trade"].member(Trade),
            optimizer=coverage["optimizer"].member(OptimizerName),
            assignment=assignment.member(Assignment)
            if isinstance(assignment.value, str)
            else {
                name: tuple(int(index) for index in item.indices(len(landmarks))) for name, item in assignment.members()
            },
        ),
        communication=_read_communication(value["communication"] if value.mapping().get("communication") else None),
        georeference=None
        if reference is None
        else GeoReference(
            lon_deg=reference["lon_deg"].number(),
            lat_deg=reference["lat_deg"].number(),
            alt_m=reference["alt_m"].number(),
        ),
        separation=_read_separation(value, len(agents)),
        source=dict(value["document"].mapping()),
        path=path if path is None or folder is None else folder / path,
    )


def _read_communication(value: CheckedValue | None) -> CommunicationSpec | None:
    if value is None:
        return None
    reach, links = value.get("range_m"), value.get("links")
    if (reach is None) == (links is None):
        value.fail("exactly one of range_m and links")
    if reach is not None:
        return CommunicationSpec(range=reach.number())
    pairs = [[name.text() for name in pair.items()] for pair in (links.items() if links is not None else ())]
    if any(len(pair) != 2 for pair in pairs):
        value["links"].fail("pairs of names")
    return CommunicationSpec(links=tuple((pair[0], pair[1]) for pair in pairs))


def _read_separation(mission: CheckedValue, agents: int) -> Separation | None:
    value = mission.get("separation") if "separation" in mission.mapping() else None
    if value is None:
        return None
    layers = value["layers"].items()
    if len(layers) != agents:
        value["layers"].fail(f"{agents} layers, one an agent")
    spacing = value["spacing_m"].number()
    if spacing <= 0.0:
        value["spacing_m"].fail("a number above 0")
    return Separation(spacing, tuple(None if layer.value is None else layer.integer() for layer in layers))


def _read_history(root: CheckedValue) -> tuple[HistoryEntry, ...]:
    scores, events = root["score_history"].items(), root["score_events"].items()
    if len(scores) != len(events):
        root["score_events"].fail(f"one entry a score, {len(scores)} of them")
    return tuple(
        HistoryEntry(
            event["event"].text(),
            tuple(name.text() for name in event["agents"].items()),
            score.known(math.nan),
            event["detail"].text() if "detail" in event.mapping() else "",
        )
        for score, event in zip(scores, events, strict=True)
    )


def _read_certificate(value: CheckedValue | None) -> Certificate | None:
    if value is None:
        return None
    violations = []
    for item in value["violations"].items():
        landmark = item.get("landmark")
        violations.append(
            Violation(
                kind=item["kind"].text(),
                agents=tuple(name.text() for name in item["agents"].items()),
                landmark=None if landmark is None else landmark.integer(),
                amount=item["amount"].known(math.inf),
                message=item["message"].text(),
            )
        )
    links = value["links"] if value.mapping().get("links") is not None else None
    return Certificate(
        holds=value["holds"].truth(),
        sigma=value["sigma"].number(),
        worst_pose_gap=value["worst_pose_gap"].known(math.inf),
        worst_trade_gain=value["worst_trade_gain"].known(math.inf),
        violations=tuple(violations),
        links=None
        if links is None
        else LinkedPairs(
            links["linked"].integer(),
            links["pairs"].integer(),
            tuple(tuple(name.text() for name in group.items()) for group in links["groups"].items()),
        ),
    )


def _read_bound(value: CheckedValue | None) -> TeamBound | None:
    if value is None:
        return None
    return TeamBound(team_upper_bound=value["team_upper_bound"].known(math.inf), gap=value["gap"].known(math.inf))


def _read_baseline(value: CheckedValue | None) -> Baseline | None:
    if value is None:
        return None
    return Baseline(value["greedy"].known(math.nan), value["greedy_lloyd"].known(math.nan))
