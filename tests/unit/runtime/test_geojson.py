from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

from covey.environment import GeoReference
from covey.errors import ArgumentError
from covey.geometry import Region
from covey.runtime.records.geojson import to_geojson
from covey.runtime.records.record import write_result
from covey.runtime.result import Deployment

MakeDeployment = Callable[..., Deployment]


def features(collection: dict[str, Any], kind: str) -> list[dict[str, Any]]:
    return [feature for feature in collection["features"] if feature["properties"]["kind"] == kind]


@pytest.fixture
def deployment(make_deployment: MakeDeployment) -> Deployment:
    region = Region.polygon([[-6, -6], [6, -6], [6, 6], [-6, 6]], [[[1, 1], [2, 1], [2, 2]]])
    return make_deployment(geographic=True, agents=7, region=region)


def test_every_geometry_is_valid_and_wound_as_rfc_7946_asks(deployment: Deployment) -> None:
    collection = to_geojson(deployment)
    assert collection["type"] == "FeatureCollection"
    for feature in collection["features"]:
        assert set(feature) == {"type", "geometry", "properties"}
        shape = shapely.from_geojson(json.dumps(feature["geometry"]))
        assert shape.is_valid
        if shape.geom_type in ("Polygon", "MultiPolygon"):
            for part in getattr(shape, "geoms", [shape]):
                assert part.exterior.is_ccw
                assert not any(hole.is_ccw for hole in part.interiors)


def test_agents_are_where_they_are_and_look_where_they_look(deployment: Deployment) -> None:
    reference = deployment.mission.georeference
    assert reference is not None
    found = features(to_geojson(deployment), "agent")
    assert [feature["properties"]["name"] for feature in found] == [agent.name for agent in deployment.agents]
    for feature, agent in zip(found, deployment.agents, strict=True):
        position = reference.to_enu(np.array([feature["geometry"]["coordinates"]]))[0]
        assert position == pytest.approx(agent.pose.position_W, abs=1e-3)
        heading = math.radians(feature["properties"]["heading_deg"])
        assert 0.0 <= feature["properties"]["heading_deg"] < 360.0
        assert (math.sin(heading), math.cos(heading)) == pytest.approx(
            (math.cos(agent.pose.yaw), math.sin(agent.pose.yaw))
        )


def test_owned_cells_cover_what_is_owned(deployment: Deployment) -> None:
    reference = deployment.mission.georeference
    assert reference is not None
    owned = features(to_geojson(deployment), "owns")
    assert sum(feature["properties"]["landmark_count"] for feature in owned) == 400
    by_name = {
        feature["properties"]["agent"]: shapely.from_geojson(json.dumps(feature["geometry"])) for feature in owned
    }
    lonlat = reference.to_lonlat(deployment.mission.landmarks.positions_W)
    for agent in deployment.agents:
        inside = shapely.contains_xy(by_name[agent.name], lonlat[:, 0], lonlat[:, 1])
        assert np.flatnonzero(inside).tolist() == agent.landmarks.tolist()


def test_landmarks_without_size_are_points(make_deployment: MakeDeployment) -> None:
    owned = features(to_geojson(make_deployment(geographic=True, spacing=None)), "owns")
    assert {feature["geometry"]["type"] for feature in owned} == {"MultiPoint"}


def test_nothing_crosses_the_antimeridian(make_deployment: MakeDeployment) -> None:
    deployment = make_deployment(geographic=True, agents=1)
    moved = replace(deployment, mission=replace(deployment.mission, georeference=GeoReference(180.0, -16.8, 0.0)))
    assert {feature["geometry"]["type"] for feature in features(to_geojson(moved), "owns")} == {"MultiPoint"}


def test_only_missions_on_the_map_have_one(make_deployment: MakeDeployment, tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match="georeference"):
        to_geojson(make_deployment())
    target = write_result(make_deployment(geographic=True), tmp_path / "r")
    assert json.loads((target / "deployment.geojson").read_text())["type"] == "FeatureCollection"
    assert (target / "agents.csv").read_text().splitlines()[0].endswith("lon_deg,lat_deg,heading_deg")
