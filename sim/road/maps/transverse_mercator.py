"""Latitude and longitude as metres in a UTM zone.

References:
    Krueger (1912), Konforme Abbildung des Erdellipsoids in der Ebene, series to the third order in
    the third flattening (exact to less than a millimetre within a zone); as in Karney (2011),
    Transverse Mercator with an accuracy of a few nanometers, J. Geodesy 85.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from sim.frames import FloatArray

EQUATOR_M: Final = 6378137.0
FLATTENING: Final = 1 / 298.257223563
"""The WGS 84 ellipsoid."""

SCALE: Final = 0.9996
FALSE_EASTING_M: Final = 500_000.0
"""UTM's scale on the central meridian, and easting there, m."""

_N: Final = FLATTENING / (2 - FLATTENING)
_RADIUS_M: Final = EQUATOR_M / (1 + _N) * (1 + _N**2 / 4 + _N**4 / 64)
_ALPHA: Final = (
    _N / 2 - 2 * _N**2 / 3 + 5 * _N**3 / 16,
    13 * _N**2 / 48 - 3 * _N**3 / 5,
    61 * _N**3 / 240,
)


def zone_of(longitude_deg: float) -> int:
    """The UTM zone of a longitude, 1 to 60.

    Examples:
        >>> zone_of(8.44), zone_of(0.0)
        (32, 31)
    """
    return int((longitude_deg + 180.0) // 6.0) % 60 + 1


def to_metres(latitude_deg: FloatArray, longitude_deg: FloatArray, zone: int) -> FloatArray:
    """(n, 2) easting and northing in a UTM zone, m; northing is negative south of the equator.

    Args:
        latitude_deg: (n,) degrees north.
        longitude_deg: (n,) degrees east.
        zone: UTM zone.

    Examples:
        >>> to_metres(np.array([49.0]), np.array([9.0]), 32).round(1).tolist()
        [[500000.0, 5427455.8]]
    """
    latitude = np.radians(latitude_deg)
    away = np.radians(longitude_deg - (6.0 * zone - 183.0))
    eccentricity = 2 * np.sqrt(_N) / (1 + _N)
    sine = np.sin(latitude)
    conformal = np.sinh(np.arctanh(sine) - eccentricity * np.arctanh(eccentricity * sine))
    north = np.arctan2(conformal, np.cos(away))
    east = np.arctanh(np.sin(away) / np.hypot(1.0, conformal))
    x, y = east.copy(), north.copy()
    for j, alpha in enumerate(_ALPHA, 1):
        x += alpha * np.cos(2 * j * north) * np.sinh(2 * j * east)
        y += alpha * np.sin(2 * j * north) * np.cosh(2 * j * east)
    return np.stack([FALSE_EASTING_M + SCALE * _RADIUS_M * x, SCALE * _RADIUS_M * y], axis=1)
