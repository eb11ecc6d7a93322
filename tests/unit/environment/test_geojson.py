"""Outlines from GeoJSON; what is wrong with a file is tested with the broken missions."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from covey.environment import read_geojson_polygon

OUTLINE = [[11.0, 43.0], [11.002, 43.0], [11.002, 43.001], [11.0, 43.001], [11.0, 43.0]]
HOLE = [[11.001, 43.0004, 5.0], [11.001, 43.0006, 5.0], [11.0012, 43.0005, 5.0]]
POLYGON = {"type": "Polygon", "coordinates": [OUTLINE, HOLE]}
FEATURE = {"type": "Feature", "properties": {}, "geometry": POLYGON}
LABEL = {"type": "Feature", "properties": {}, "geometry": {"type": "Point", "coordinates": [0, 0]}}
NOTHING: dict[str, Any] = {"type": "Feature", "properties": {}, "geometry": None}


def _write(folder: Path, data: Any) -> Path:
    path = folder / "site.geojson"
    path.write_text(json.dumps(data), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    "data",
    [
        POLYGON,
        FEATURE,
        {"type": "MultiPolygon", "coordinates": [POLYGON["coordinates"]]},
        {"type": "FeatureCollection", "features": [LABEL, FEATURE, NOTHING]},
        {"type": "Polygon", "coordinates": [OUTLINE[::-1], HOLE[::-1]]},
        {**POLYGON, "crs": {"type": "name", "properties": {"name": "urn:ogc:def:crs:OGC:1.3:CRS84"}}},
        {**POLYGON, "crs": {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::4326"}}},
    ],
)
def test_every_way_to_write_one_polygon(data: Any, tmp_path: Path) -> None:
    polygon = read_geojson_polygon(_write(tmp_path, data))
    origin = polygon.centroid()
    region = polygon.to_region(origin)
    assert region.shape.exterior.is_ccw
    # 0.002° of longitude at 43° by 0.001° of latitude: 163.1 m by 111.1 m, less a hole of 16.3 m by 22.2 m halved.
    assert region.shape.area == pytest.approx(163.1 * 111.1 - 16.3 * 22.2 / 2, rel=2e-3)
    x0, x1, y0, y1 = region.bounds
    assert x1 - x0 == pytest.approx(163.1, abs=0.1)
    assert y1 - y0 == pytest.approx(111.1, abs=0.1)
    assert not region.contains(*origin.to_enu(np.array([[11.0011, 43.0005]]))[0])
    assert region.contains(*origin.to_enu(np.array([[11.0015, 43.0005]]))[0])
    centroid = region.shape.centroid
    assert abs(centroid.x) < 0.01
    assert abs(centroid.y) < 0.01


def test_corners_come_back(tmp_path: Path) -> None:
    polygon = read_geojson_polygon(_write(tmp_path, FEATURE))
    origin = polygon.centroid()
    back = origin.to_lonlat(polygon.to_region(origin).exterior)
    for corner in OUTLINE[:-1]:
        assert np.abs(back - corner).max(axis=1).min() < 1e-11
