"""The landmarks and regions of a mission file, and the origin of its metres."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from covey.environment import (
    GeoPolygon,
    GeoReference,
    Landmarks,
    curve_landmarks,
    grid_landmarks,
    polygon_landmarks,
    read_geojson_polygon,
    read_landmarks_csv,
)
from covey.environment.json_text import KeyPath
from covey.errors import ArgumentError, InputError, MissionError
from covey.geometry import Region
from covey.mission.report import Report, one_of
from covey.mission.schema import (
    AREAS,
    SHAPES,
    GeoreferenceSection,
    GridSection,
    LandmarksSection,
    PolygonSection,
    RegionSection,
)

_KEYS = {"spacing": "spacing_m", "x": "x_m", "y": "y_m"}
"""Keys of the file for the arguments that the functions of `covey.environment` complain about."""

T = TypeVar("T")

Numbers = float | list[float]


class SiteBuilder:
    """Builds landmarks and regions; `report` tells what is wrong with those that are None.

    Parameters
    ----------
    report : Report
    folder : Path
        Where the files are that the mission names.
    origin : GeoReference, keyword-only, optional
        Of a mission that is built already.
    """

    def __init__(self, report: Report, folder: Path, *, origin: GeoReference | None = None) -> None:
        self._report = report
        self._folder = folder
        self._polygons: dict[str, GeoPolygon | None] = {}
        self._origin = origin

    def georeference(
        self,
        section: GeoreferenceSection | None,
        landmarks: LandmarksSection | None,
        regions: Sequence[tuple[KeyPath, RegionSection | None]],
        *,
        stated: bool,
    ) -> GeoReference | None:
        """Read every GeoJSON file and settle the origin: the one stated, else the centroid of the first polygon."""
        named = [(("environment", "landmarks"), landmarks), *regions]
        polygons = [self._geojson(area.geojson, (*path, "geojson")) for path, area in named if area and area.geojson]
        if section is not None:
            self._origin = GeoReference(section.lon_deg, section.lat_deg, section.alt_m)
        elif not stated:  # a wrong georeference is reported already: no other origin may stand in for it
            self._origin = next((polygon.centroid() for polygon in polygons if polygon is not None), None)
        return self._origin

    def region(self, section: RegionSection | None, path: KeyPath) -> Region | None:
        """Build a region."""
        if section is None:
            return None
        chosen = self._exactly_one(path, AREAS, [key for key in AREAS if getattr(section, key) is not None])
        if chosen is None:
            return None
        if section.box is not None:
            (x_min, x_max), (y_min, y_max) = section.box.x_m, section.box.y_m
            return self._try((*path, "box"), lambda: Region.box(x_min, x_max, y_min, y_max))
        if section.geojson is not None:
            return self._projected(section.geojson, (*path, "geojson"))
        return self._polygon(section.polygon, (*path, "polygon"))

    def landmarks(self, section: LandmarksSection | None, path: KeyPath) -> Landmarks | None:
        """Build the landmarks."""
        if section is None:
            return None
        shape = self._exactly_one(path, SHAPES, [key for key in SHAPES if getattr(section, key) is not None])
        if shape is None or not self._options_fit(section, shape, path):
            return None
        landmarks = self._shape(section, path)
        return None if landmarks is None else self._weights_and_normals(section, landmarks, path)

    def _exactly_one(self, path: KeyPath, keys: Sequence[str], given: list[str]) -> str | None:
        if len(given) == 1:
            return given[0]
        if given:
            self._report.add((*path, given[1]), f"expected one of {one_of(keys)}, got {one_of(given, 'and')}")
        elif not self._report.inside(path):
            self._report.add(path, f"expected one of {one_of(keys)}, got none of them")
        return None

    def _options_fit(self, section: LandmarksSection, shape: str, path: KeyPath) -> bool:
        right = True
        if shape in ("curve", "polygon", "geojson"):
            if section.spacing_m is None:
                right = False
                if not self._report.inside((*path, "spacing_m")):
                    self._report.add(path, f"expected spacing_m beside {shape}, it is missing")
        elif section.spacing_m is not None:
            hint = "a grid has it inside: grid: {..., spacing_m: ...}" if shape == "grid" else ""
            self._report.add((*path, "spacing_m"), f"expected no spacing_m beside {shape}", hint)
        for key in ("closed", "faces"):
            if shape != "curve" and getattr(section, key) is not None:
                self._report.add((*path, key), f"expected {key} only beside curve, got it beside {shape}")
        if section.normals is not None and section.normals_deg is not None:
            self._report.add((*path, "normals_deg"), "expected normals or normals_deg, got both")
        return right

    def _shape(self, section: LandmarksSection, path: KeyPath) -> Landmarks | None:
        spacing = section.spacing_m or 0.0
        if section.grid is not None:
            grid: GridSection = section.grid
            return self._try((*path, "grid"), lambda: _grid(grid))
        if section.points is not None:
            return Landmarks(np.array(section.points, dtype=np.float64))
        if section.csv is not None:
            return self._csv(section.csv, (*path, "csv"))
        if section.curve is not None:
            corners = np.array(section.curve, dtype=np.float64)
            closed = bool(section.closed)
            faces = section.faces or ("outside" if closed else "left")
            return self._try(path, lambda: curve_landmarks(corners, spacing, closed=closed, faces=faces))
        if section.geojson is not None:
            region = self._projected(section.geojson, (*path, "geojson"))
        else:
            region = self._polygon(section.polygon, (*path, "polygon"))
        return None if region is None else self._try(path, lambda: polygon_landmarks(region, spacing))

    def _try(self, path: KeyPath, make: Callable[[], T]) -> T | None:
        """Run a function of a lower layer; its error names an argument, which becomes the key."""
        try:
            return make()
        except ArgumentError as error:
            argument, _, message = str(error).partition(": ")
            if argument not in (path[-1], "polygon"):
                path = (*path, _KEYS.get(argument, argument))
            self._report.add(path, message)
            return None

    def _polygon(self, section: PolygonSection | list[list[float]] | None, path: KeyPath) -> Region | None:
        if section is None:
            return None
        if isinstance(section, PolygonSection):
            exterior, holes = section.exterior, section.holes
        else:
            exterior, holes = section, []
        return self._try(path, lambda: Region.polygon(exterior, holes))

    def _projected(self, name: str, path: KeyPath) -> Region | None:
        polygon = self._geojson(name, path)
        if polygon is None or self._origin is None:
            return None
        try:
            return polygon.to_region(self._origin)
        except MissionError as error:
            self._report.add_foreign(error.mistakes)
            return None

    def _geojson(self, name: str, path: KeyPath) -> GeoPolygon | None:
        if name not in self._polygons:
            self._polygons[name] = self._read(name, path, read_geojson_polygon)
        return self._polygons[name]

    def _csv(self, name: str, path: KeyPath) -> Landmarks | None:
        return self._read(name, path, read_landmarks_csv)

    def _read(self, name: str, path: KeyPath, reader: Callable[[Path], T]) -> T | None:
        try:
            return reader(self._folder / name)
        except MissionError as error:
            self._report.add_foreign(error.mistakes)
        except InputError as error:
            self._report.add(path, str(error))
        return None

    def _weights_and_normals(self, section: LandmarksSection, landmarks: Landmarks, path: KeyPath) -> Landmarks | None:
        n = len(landmarks)
        weights = landmarks.weights
        if section.weights is not None:
            given = self._one_each(section.weights, n, (*path, "weights"))
            if given is None:
                return None
            weights = given
        if not (weights > 0.0).any():
            where = (*path, "weights") if section.weights is not None else path
            self._report.add(where, "expected at least one weight above 0")
            return None
        normals = landmarks.normals_W
        key = "normals" if section.normals is not None else "normals_deg"
        if (section.normals is not None or section.normals_deg is not None) and normals is not None:
            self._report.add((*path, key), "expected no normals here, the landmarks have theirs already")
            return None
        if section.normals is not None:
            normals = self._vectors(section.normals, n, (*path, "normals"))
        elif section.normals_deg is not None:
            degrees = self._one_each(section.normals_deg, n, (*path, "normals_deg"))
            normals = None
            if degrees is not None:
                angle = np.deg2rad(degrees)
                normals = np.column_stack([np.cos(angle), np.sin(angle)])
        if normals is None and (section.normals is not None or section.normals_deg is not None):
            return None
        return replace(landmarks, weights=weights, normals_W=normals)

    def _one_each(self, given: Numbers, n: int, path: KeyPath) -> NDArray[np.float64] | None:
        if not isinstance(given, list):
            return np.full(n, given, dtype=np.float64)
        if len(given) != n:
            self._report.add(path, f"expected {n:,} entries, one a landmark, got {len(given):,}")
            return None
        return np.array(given, dtype=np.float64)

    def _vectors(self, given: list[list[float]], n: int, path: KeyPath) -> NDArray[np.float64] | None:
        if len(given) != n:
            self._report.add(path, f"expected {n:,} entries, one a landmark, got {len(given):,}")
            return None
        vectors = np.array(given, dtype=np.float64)
        zero = np.flatnonzero(np.hypot(vectors[:, 0], vectors[:, 1]) < 1e-9)
        for k in zero:
            self._report.add((*path, int(k)), "expected a vector of some length, got zero")
        return None if len(zero) else vectors


def _grid(grid: GridSection) -> Landmarks:
    (x_min, x_max), (y_min, y_max) = grid.x_m, grid.y_m
    return grid_landmarks(x_min, x_max, y_min, y_max, grid.spacing_m)
