"""A site's outline and its holes from a GeoJSON file."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from covey.environment.files import read_text
from covey.environment.georeference import GeoReference
from covey.environment.json_text import KeyPath, describe, json_places, key_text, load_json, single
from covey.errors import ArgumentError, MissionError
from covey.geometry import Region

_MAX_BYTES = 20_000_000
_WGS84 = ("crs84", "epsg:4326", "epsg::4326")
_GEOMETRIES = ("Polygon", "MultiPolygon")
_OTHERS = ("Point", "MultiPoint", "LineString", "MultiLineString", "GeometryCollection")


class _Wrong(Exception):
    def __init__(self, path: KeyPath, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.path = path
        self.message = message
        self.hint = hint


@dataclass(frozen=True, eq=False)
class GeoPolygon:
    """A polygon on the earth.

    Parameters
    ----------
    rings : tuple of arrays, each of shape (k, 2)
        The outline, then its holes: longitude and latitude, WGS84, degrees, not closed.
    source : str
        The file it came from.
    """

    rings: tuple[NDArray[np.float64], ...]
    source: str = "<polygon>"

    def centroid(self) -> GeoReference:
        """Return the centre of its area, at height 0: the default origin of a mission's frame."""
        import shapely

        shape = shapely.Polygon(self.rings[0], self.rings[1:])
        point = shape.centroid if shape.is_valid and shape.area > 0.0 else shapely.MultiPoint(self.rings[0]).centroid
        return GeoReference(round(point.x, 9), round(point.y, 9))

    def to_region(self, origin: GeoReference) -> Region:
        """Project into the local frame of an origin.

        Raises
        ------
        MissionError
            If the polygon crosses itself, has no area or is far from the origin.
        """
        try:
            outline, *holes = (origin.to_enu(ring) for ring in self.rings)
            return Region(outline, tuple(holes))
        except ArgumentError as error:
            raise MissionError((single(str(error), self.source),)) from None


def read_geojson_polygon(path: Path, *, name: str | None = None) -> GeoPolygon:
    """Read the one polygon of a GeoJSON file (RFC 7946, WGS84 longitude and latitude).

    Parameters
    ----------
    path : Path
        A Polygon, a MultiPolygon of one part, a Feature or a FeatureCollection with one of those; other features, such
        as points, are left out, and so are heights.
    name : str, optional
        How mistakes call the file; the path by default.

    Raises
    ------
    InputError
        If the file cannot be read.
    MissionError
        If it is not GeoJSON in WGS84, or holds no polygon or several; with the line.
    """
    source = name or str(path)
    text = read_text(path, limit=_MAX_BYTES)
    data, _, mistakes = load_json(text, source)
    if mistakes:
        raise MissionError(tuple(mistakes))
    try:
        _check_crs(data)
        path_to, geometry = _one_polygon(data)
        return GeoPolygon(_rings(path_to, geometry), source)
    except _Wrong as wrong:
        place = json_places(text).nearest(wrong.path)
        raise MissionError((single(wrong.message, source, place, key_text(wrong.path), wrong.hint),)) from None


def _check_crs(data: Any) -> None:
    if not isinstance(data, dict):
        raise _Wrong((), "expected GeoJSON, a mapping with a type")
    if data.get("crs") is None:
        return
    crs = data["crs"]
    properties = crs.get("properties") if isinstance(crs, dict) else None
    name = properties.get("name") if isinstance(properties, dict) else None
    if not isinstance(name, str) or not name.lower().endswith(_WGS84):
        raise _Wrong(
            ("crs",), f"expected WGS84 longitude and latitude, got {describe(name)}", "convert it to EPSG:4326"
        )


def _one_polygon(data: dict[str, Any]) -> tuple[KeyPath, dict[str, Any]]:
    found: list[tuple[KeyPath, dict[str, Any]]] = []
    if data.get("type") == "FeatureCollection":
        features = data.get("features")
        if not isinstance(features, list):
            raise _Wrong(("features",), f"expected a list of features, got {describe(features)}")
        for i, feature in enumerate(features):
            found += _of_feature(("features", i), feature)
    elif data.get("type") == "Feature":
        found = _of_feature((), data)
    else:
        found = _of_geometry((), data)
    if len(found) != 1:
        where = found[1][0] if found else ()
        hint = "keep one; holes belong inside its coordinates" if found else ""
        raise _Wrong(where, f"expected one polygon, got {len(found) or 'none'}", hint)
    return found[0]


def _of_feature(path: KeyPath, feature: Any) -> list[tuple[KeyPath, dict[str, Any]]]:
    if not isinstance(feature, dict) or feature.get("type") != "Feature":
        raise _Wrong(path, f"expected a Feature, got {describe(feature)}")
    geometry = feature.get("geometry")
    return [] if geometry is None else _of_geometry((*path, "geometry"), geometry)


def _of_geometry(path: KeyPath, geometry: Any) -> list[tuple[KeyPath, dict[str, Any]]]:
    kind = geometry.get("type") if isinstance(geometry, dict) else geometry
    if not isinstance(geometry, dict) or kind not in (*_GEOMETRIES, *_OTHERS):
        raise _Wrong(path, f"expected a geometry such as Polygon, got {describe(kind)}")
    if kind == "MultiPolygon":
        parts = geometry.get("coordinates")
        if not isinstance(parts, list) or len(parts) != 1:
            count = f"{len(parts)} parts" if isinstance(parts, list) else describe(parts)
            raise _Wrong((*path, "coordinates"), f"expected a MultiPolygon of one part, got {count}", "keep one")
    return [(path, geometry)] if kind in _GEOMETRIES else []


def _rings(path: KeyPath, geometry: dict[str, Any]) -> tuple[NDArray[np.float64], ...]:
    rings = geometry.get("coordinates")
    path = (*path, "coordinates")
    if geometry["type"] == "MultiPolygon" and isinstance(rings, list):
        rings, path = rings[0], (*path, 0)
    if not isinstance(rings, list) or not rings:
        raise _Wrong(path, f"expected a list of rings, got {describe(rings)}")
    result = []
    for i, ring in enumerate(rings):
        if not isinstance(ring, list):
            raise _Wrong((*path, i), f"expected a ring, a list of [longitude, latitude], got {describe(ring)}")
        points = np.array([_position((*path, i, k), p) for k, p in enumerate(ring)], dtype=np.float64).reshape(-1, 2)
        if len(points) > 1 and (points[0] == points[-1]).all():
            points = points[:-1]
        if len(points) < 3:
            raise _Wrong((*path, i), f"expected a ring of at least 3 corners, got {len(points)}")
        if np.ptp(points[:, 0]) > 180.0:
            raise _Wrong((*path, i), "expected a ring that does not cross the antimeridian, longitudes span over 180°")
        result.append(points)
    return tuple(result)


def _position(path: KeyPath, position: Any) -> tuple[float, float]:
    numbers = isinstance(position, list) and all(type(value) in (int, float) for value in position[:2])
    if not numbers or len(position) < 2:
        raise _Wrong(path, f"expected a position [longitude, latitude], got {describe(position)}")
    try:
        lon, lat = float(position[0]), float(position[1])
    except OverflowError:
        lon = lat = math.inf
    if not (abs(lon) <= 180.0 and abs(lat) <= 90.0):
        hint = "GeoJSON has longitude first" if abs(lon) <= 90.0 and abs(lat) <= 180.0 else "degrees, not metres"
        raise _Wrong(path, f"expected longitude ±180 and latitude ±90, got [{lon:g}, {lat:g}]", hint)
    return lon, lat
