"""Longitude and latitude to local metres and back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from covey.errors import ArgumentError

if TYPE_CHECKING:
    import pyproj

FARTHEST = 100_000.0
"""How far from its origin a local frame is used, metres: beyond it a plane is no map of the ground."""


@dataclass(frozen=True)
class GeoReference:
    """The origin of a mission's frame W on the earth; x points east, y north, in its tangent plane (ENU).

    Parameters
    ----------
    lon_deg, lat_deg : float
        Longitude and latitude of the origin, WGS84, degrees.
    alt_m : float
        Height of the plane above the ellipsoid, metres.

    Raises
    ------
    ArgumentError
        If a coordinate is out of range or not finite.

    Notes
    -----
    Positions lie on the ellipsoidal height `alt_m`, so the two methods are exact inverses of each other.

    Examples
    --------
    >>> origin = GeoReference(-3.707398, 40.415364)
    >>> origin.to_lonlat(np.array([[0.0, 0.0]])).round(6)
    array([[-3.707398, 40.415364]])
    """

    lon_deg: float
    lat_deg: float
    alt_m: float = 0.0

    def __post_init__(self) -> None:
        for name, limit in (("lon_deg", 180.0), ("lat_deg", 90.0), ("alt_m", 20_000.0)):
            value = float(getattr(self, name))
            if not abs(value) <= limit:
                raise ArgumentError(f"{name}: expected a number from {-limit:g} to {limit:g}, got {value}")
            object.__setattr__(self, name, value)

    def to_enu(self, lonlat: NDArray[np.float64]) -> NDArray[np.float64]:
        """Project positions into the local frame.

        Parameters
        ----------
        lonlat : array, shape (n, 2)
            Longitude and latitude, WGS84, degrees.

        Returns
        -------
        array, shape (n, 2)
            East and north of the origin, metres.

        Raises
        ------
        ArgumentError
            If the shape does not fit, or a position is not finite or more than 100 km away.
        """
        lonlat = _pairs("lonlat", lonlat)
        east, north, up = self._transformer().transform(lonlat[:, 0], lonlat[:, 1], np.full(len(lonlat), self.alt_m))
        far = np.sqrt(np.square(east) + np.square(north) + np.square(up))
        if not (far <= FARTHEST).all():
            raise ArgumentError(
                f"lonlat: expected positions within {FARTHEST / 1000:g} km of the origin "
                f"({self.lon_deg:g}, {self.lat_deg:g}), got one {far.max() / 1000:,.0f} km away"
            )
        return np.column_stack([east, north])

    def to_lonlat(self, positions_W: NDArray[np.float64]) -> NDArray[np.float64]:
        """Turn local positions back into longitude and latitude.

        Parameters
        ----------
        positions_W : array, shape (n, 2)
            East and north of the origin, metres.

        Returns
        -------
        array, shape (n, 2)
            Longitude and latitude, WGS84, degrees.

        Raises
        ------
        ArgumentError
            If the shape does not fit, or a position is not finite or more than 100 km away.
        """
        positions = _pairs("positions_W", positions_W)
        if not (np.abs(positions) <= FARTHEST).all():
            raise ArgumentError(f"positions_W: expected positions within {FARTHEST / 1000:g} km of the origin")
        transformer = self._transformer()
        # A point of the ground is below the tangent plane by an amount that its height tells: three steps reach 1e-9 m.
        up = np.zeros(len(positions))
        lon, lat = up, up
        for _ in range(4):
            lon, lat, height = transformer.transform(positions[:, 0], positions[:, 1], up, direction="INVERSE")
            up = up - (height - self.alt_m)
        return np.column_stack([lon, lat])

    def _transformer(self) -> pyproj.Transformer:
        import pyproj

        return pyproj.Transformer.from_pipeline(
            "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart +ellps=WGS84 "
            f"+step +proj=topocentric +ellps=WGS84 +lon_0={self.lon_deg!r} +lat_0={self.lat_deg!r} +h_0={self.alt_m!r}"
        )


def _pairs(name: str, array: NDArray[np.float64]) -> NDArray[np.float64]:
    array = np.asarray(array, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 2:
        raise ArgumentError(f"{name}: expected shape (n, 2), got {array.shape}")
    if not np.isfinite(array).all():
        raise ArgumentError(f"{name}: expected finite numbers, got NaN or infinity")
    return array
