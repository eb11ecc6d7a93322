"""Local metres and longitude, latitude."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyproj import Geod

from covey.environment import GeoReference
from covey.errors import ArgumentError

MILLIMETRE = 1e-3
WGS84 = Geod(ellps="WGS84")

origins = st.builds(GeoReference, st.floats(-180, 180), st.floats(-89.5, 89.5), st.floats(-400, 9000))


@given(origins, st.lists(st.tuples(st.floats(-1000, 1000), st.floats(-1000, 1000)), min_size=1, max_size=5))
def test_round_trip_over_a_kilometre(origin: GeoReference, points: list[tuple[float, float]]) -> None:
    xy = np.array(points)
    assert np.abs(origin.to_enu(origin.to_lonlat(xy)) - xy).max() < MILLIMETRE


def test_round_trip_over_fifty_kilometres() -> None:
    origin = GeoReference(18.07, 59.35, 30.0)
    xy = np.array([[50_000.0, -30_000.0], [0.0, 50_000.0]])
    assert np.abs(origin.to_enu(origin.to_lonlat(xy)) - xy).max() < MILLIMETRE


@given(origins, st.floats(0, 360), st.floats(1, 1000))
def test_distance_and_bearing_are_those_of_the_geodesic(origin: GeoReference, bearing: float, distance: float) -> None:
    """At height 0 the tangent plane and the ellipsoid part by less than 1e-8 of the distance within a kilometre."""
    origin = GeoReference(origin.lon_deg, origin.lat_deg)
    lon, lat, _ = WGS84.fwd(origin.lon_deg, origin.lat_deg, bearing, distance)
    (east, north), = origin.to_enu(np.array([[lon, lat]]))  # fmt: skip
    assert math.hypot(east, north) == pytest.approx(distance, rel=1e-7)
    angle = math.radians(bearing)
    assert east == pytest.approx(distance * math.sin(angle), abs=MILLIMETRE)
    assert north == pytest.approx(distance * math.cos(angle), abs=MILLIMETRE)


def test_degrees_have_their_known_lengths() -> None:
    """On the equator 1/1000° of longitude is 111.319 m; at 45° of latitude 1/1000° north is 111.132 m."""
    equator = GeoReference(0.0, 0.0).to_enu(np.array([[0.001, 0.0], [0.0, 0.001]]))
    np.testing.assert_allclose(equator, [[111.319, 0.0], [0.0, 110.574]], atol=1e-3)
    middle = GeoReference(10.0, 45.0).to_enu(np.array([[10.001, 45.0], [10.0, 45.001]]))
    np.testing.assert_allclose(middle, [[78.847, 0.0], [0.0, 111.132]], atol=1e-3)


def test_x_is_east_and_y_is_north() -> None:
    origin = GeoReference(-3.707398, 40.415364)
    (east, west), (_, north) = (
        origin.to_lonlat(np.array([[10.0, 0.0], [-10.0, 0.0]]))[:, 0],
        origin.to_lonlat(np.array([[0.0, 0.0], [0.0, 10.0]]))[:, 1],
    )
    assert west < origin.lon_deg < east
    assert north > origin.lat_deg


def test_empty() -> None:
    assert GeoReference(0, 0).to_enu(np.empty((0, 2))).shape == (0, 2)
    assert GeoReference(0, 0).to_lonlat(np.empty((0, 2))).shape == (0, 2)


@pytest.mark.parametrize(
    ("lon", "lat", "words"),
    [(181.0, 0.0, "lon_deg: expected"), (0.0, -91.0, "lat_deg: expected"), (math.nan, 0.0, "lon_deg: expected")],
)
def test_origin_is_on_earth(lon: float, lat: float, words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        GeoReference(lon, lat)


def test_far_and_shapeless_positions_are_refused() -> None:
    origin = GeoReference(11.0, 43.0)
    with pytest.raises(ArgumentError, match="within 100 km"):
        origin.to_enu(np.array([[14.0, 43.0]]))
    with pytest.raises(ArgumentError, match="within 100 km"):
        origin.to_lonlat(np.array([[2e5, 0.0]]))
    with pytest.raises(ArgumentError, match=r"lonlat: expected shape \(n, 2\), got \(2,\)"):
        origin.to_enu(np.array([1.0, 2.0]))
    with pytest.raises(ArgumentError, match="positions_W: expected finite"):
        origin.to_lonlat(np.array([[math.nan, 0.0]]))
