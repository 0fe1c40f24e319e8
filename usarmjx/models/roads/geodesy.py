"""Where a place of an arena lies on earth, which is flat (manual 10.5.1).

Places are x (north) and y (west) in the arena's axes [m]; the wire's y, to the right, is east.
"""

METRES_PER_LATITUDE_DEGREE, METRES_PER_LONGITUDE_DEGREE = 111200.0, 71670.0
"""Metres of a degree (GPSSensor.uc), wherever on earth."""

LatLon = tuple[float, float]
"""Latitude and longitude [degrees], north and east positive."""


METRES_PER_DEGREE = (METRES_PER_LATITUDE_DEGREE, METRES_PER_LONGITUDE_DEGREE)


def to_lat_lon(
    origin: LatLon, at: tuple[float, float], scales: tuple[float, float] = METRES_PER_DEGREE
) -> LatLon:
    """Return latitude and longitude [degrees] of a place x, y [m] in an arena whose origin lies there.

    Args:
        origin: Where the arena's origin lies.
        at: The place.
        scales: Metres of a degree of latitude and of longitude; negative ones turn the axis round.
    """
    return origin[0] + at[0] / scales[0], origin[1] - at[1] / scales[1]


def to_local_xy(origin: LatLon, at: LatLon) -> tuple[float, float]:
    """Return x, y [m] of a latitude and longitude [degrees]; the inverse of `to_lat_lon`."""
    return (at[0] - origin[0]) * METRES_PER_LATITUDE_DEGREE, (origin[1] - at[1]) * METRES_PER_LONGITUDE_DEGREE
