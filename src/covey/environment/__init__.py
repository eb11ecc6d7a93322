"""What the team has to see: landmarks, where they come from, and where on earth they are."""

from covey.environment.geojson import GeoPolygon, read_geojson_polygon
from covey.environment.georeference import GeoReference
from covey.environment.landmarks import Landmarks
from covey.environment.sites import MAX_LANDMARKS, curve_landmarks, grid_landmarks, polygon_landmarks
from covey.environment.table import read_landmarks_csv

__all__ = [
    "MAX_LANDMARKS",
    "GeoPolygon",
    "GeoReference",
    "Landmarks",
    "curve_landmarks",
    "grid_landmarks",
    "polygon_landmarks",
    "read_geojson_polygon",
    "read_landmarks_csv",
]
