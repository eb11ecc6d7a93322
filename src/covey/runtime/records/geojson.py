"""A deployment on the map: GeoJSON in WGS84 longitude and latitude (RFC 7946)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from covey.environment.georeference import GeoReference
from covey.environment.lattice import find_lattice
from covey.errors import ArgumentError
from covey.runtime.drawing.palette import colours
from covey.runtime.result import Deployment

DIGITS = 9
"""Decimals of a degree that are kept: a tenth of a millimetre."""


def to_geojson(deployment: Deployment) -> dict[str, Any]:
    """Return a deployment as a GeoJSON FeatureCollection.

    Its features are told apart by the property ``kind``: the ``region``; what each agent ``owns``, as a MultiPolygon of
    its cells or, where some landmarks are no cells, a MultiPoint; and each ``agent``, as a Point with ``heading_deg``,
    clockwise from north at the mission's origin.

    Raises
    ------
    ArgumentError
        If the mission is not geographic.

    Notes
    -----
    Format: RFC 7946; exterior rings run counter-clockwise.  The property ``marker-color`` is that of the figures.
    """
    mission = deployment.mission
    reference = mission.georeference
    if reference is None:
        raise ArgumentError(f"mission {mission.name!r}: expected a georeference, got none")
    rings = [mission.region.exterior, *mission.region.holes]
    features = [
        _feature("Polygon", [_ring(ring, reference) for ring in rings], {"kind": "region", "name": mission.name})
    ]
    palette = colours([agent.name for agent in deployment.agents])
    lattice = find_lattice(mission.landmarks)
    cell_size = None if lattice is not None and len(lattice.loose) else mission.landmarks.cell_size
    for agent, colour in zip(deployment.agents, palette, strict=True):
        if not len(agent.landmarks):
            continue
        properties = {"kind": "owns", "agent": agent.name, "landmark_count": len(agent.landmarks), "fill": colour}
        kind, coordinates = _owned(mission.landmarks.positions_W[agent.landmarks], cell_size, reference)
        features.append(_feature(kind, coordinates, properties))
    for agent, colour in zip(deployment.agents, palette, strict=True):
        pose = agent.pose
        properties = {
            "kind": "agent",
            "name": agent.name,
            "heading_deg": (90.0 - math.degrees(pose.yaw)) % 360.0,
            "x_m": pose.x,
            "y_m": pose.y,
            "yaw_deg": math.degrees(pose.yaw),
            "score": agent.score,
            "landmark_count": len(agent.landmarks),
            "marker-color": colour,
        }
        features.append(_feature("Point", _lonlat(pose.position_W[None, :], reference)[0], properties))
    return {"type": "FeatureCollection", "features": features}


def _owned(positions_W: NDArray[np.float64], cell_size: float | None, reference: GeoReference) -> tuple[str, list[Any]]:
    if cell_size is not None:
        import shapely

        half = cell_size / 2.0
        x, y = positions_W.T
        # Neighbours must share their corners to the last bit, or their union keeps slivers.
        cells = shapely.set_precision(shapely.box(x - half, y - half, x + half, y + half), cell_size * 1e-6)
        union = shapely.union_all(cells, grid_size=cell_size * 1e-6)
        parts = list(union.geoms) if isinstance(union, shapely.MultiPolygon) else [union]
        oriented = [shapely.geometry.polygon.orient(part) for part in parts]
        coordinates = [
            [_ring(np.asarray(ring.coords)[:-1], reference) for ring in (part.exterior, *part.interiors)]
            for part in oriented
        ]
        longitudes = [lon for polygon in coordinates for lon, _ in polygon[0]]
        # RFC 7946, 3.1.9: no polygon may cross the antimeridian; points have no such trouble.
        if max(longitudes) - min(longitudes) < 180.0:
            return "MultiPolygon", coordinates
    return "MultiPoint", _lonlat(positions_W, reference)


def _ring(ring_W: NDArray[np.float64], reference: GeoReference) -> list[list[float]]:
    corners = _lonlat(ring_W, reference)
    return [*corners, corners[0]]


def _lonlat(positions_W: NDArray[np.float64], reference: GeoReference) -> list[list[float]]:
    lonlat = np.round(reference.to_lonlat(positions_W), DIGITS)
    return [[float(lon), float(lat)] for lon, lat in lonlat]


def _feature(kind: str, coordinates: list[Any], properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "Feature", "geometry": {"type": kind, "coordinates": coordinates}, "properties": properties}
