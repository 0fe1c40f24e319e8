"""Where a place of an arena lies on earth, which is flat (manual 10.5.1).

Places are x (north) and y (west) in the arena's axes [m]; the wire's y, to the right, is east.
"""

LATITUDE_SCALE, LONGITUDE_SCALE = 111200.0, 71670.0
"""Metres of a degree (GPSSensor.uc), wherever on earth."""

Place = tuple[float, float]
"""Latitude and longitude [degrees], north and east positive."""


SCALES = (LATITUDE_SCALE, LONGITUDE_SCALE)


def degrees_of(origin: Place, at: tuple[float, float], scales: tuple[float, float] = SCALES) -> Place:
    """Return latitude and longitude [degrees] of a place x, y [m] in an arena whose origin lies there.

    Args:
        origin: Where the arena's origin lies.
        at: The place.
        scales: Metres of a degree of latitude and of longitude; negative ones turn the axis round.
    """
    return origin[0] + at[0] / scales[0], origin[1] - at[1] / scales[1]


def metres_of(origin: Place, at: Place) -> tuple[float, float]:
    """Return x, y [m] of a latitude and longitude [degrees]; the inverse of `degrees_of`."""
    return (at[0] - origin[0]) * LATITUDE_SCALE, (origin[1] - at[1]) * LONGITUDE_SCALE
