"""Writers of the Urban Challenge's files, so that what is read can be compared with what was written."""

from usarmjx.base.errors import SpecError
from usarmjx.models.roads.network import (
    Lane,
    LatLon,
    Mission,
    RouteNetwork,
    mission_faults,
    network_faults,
    point_name,
)

Row = tuple[str | int | float | tuple[int, ...] | None, ...]
"""Values of a line to write; a line with None or an empty text is left out."""


def format_lines(rows: list[Row]) -> str:
    """Return the text of lines, with tabs between words.

    Raises:
        SpecError: A text that would not be read back unchanged: with line breaks, comment marks or white
            space
            other than single spaces.
    """
    shown = [row for row in rows if None not in row and "" not in row]
    return "".join("\t".join(map(_word, row)) + "\n" for row in shown)


def _word(value: str | int | float | tuple[int, ...] | None) -> str:
    if isinstance(value, tuple):
        return point_name(value)
    if isinstance(value, str):
        if " ".join(value.split()) != value or "/*" in value or "*/" in value:
            raise SpecError(f"the name {value!r}: a file holds words with single spaces, without /* or */")
        return value
    if isinstance(value, float):
        return str(int(value)) if value.is_integer() else repr(value)
    return str(value)


def write_mdf(mission: Mission) -> str:
    """Return the text of a mission's file; `read_mdf` returns the same mission for it.

    Raises:
        SpecError: The mission is not sound (`mission_faults`), or a file cannot hold one of its names.
    """
    for _, text in mission_faults(mission):
        raise SpecError(f"{mission.name}: {text}")
    rows: list[Row] = [
        ("MDF_name", mission.name),
        ("RNDF", mission.rndf),
        ("format_version", mission.format_version),
        ("creation_date", mission.creation_date),
        ("checkpoints",),
        ("num_checkpoints", len(mission.checkpoints)),
        *((number,) for number in mission.checkpoints),
        ("end_checkpoints",),
        ("speed_limits",),
        ("num_speed_limits", len(mission.speed_limits)),
        *((limit.id, limit.low, limit.high) for limit in mission.speed_limits),
        ("end_speed_limits",),
        ("end_file",),
    ]
    return format_lines(rows)


def write_rndf(network: RouteNetwork) -> str:
    """Return the text of a route network's file; `read_rndf` returns the same network for it.

    Raises:
        SpecError: The network is not sound (`network_faults`), or a file cannot hold one of its names.
    """
    for _, text in network_faults(network):
        raise SpecError(f"{network.name}: {text}")
    rows: list[Row] = [
        ("RNDF_name", network.name),
        ("num_segments", len(network.segments)),
        ("num_zones", len(network.zones)),
        ("format_version", network.format_version),
        ("creation_date", network.creation_date),
    ]
    for m, segment in enumerate(network.segments, 1):
        rows += [("segment", m), ("num_lanes", len(segment.lanes)), ("segment_name", segment.name)]
        for n, lane in enumerate(segment.lanes, 1):
            rows += _lane_rows((m, n), lane)
        rows.append(("end_segment",))
    for m, zone in enumerate(network.zones, 1 + len(network.segments)):
        rows += [("zone", m), ("num_spots", len(zone.spots)), ("zone_name", zone.name)]
        rows += [("perimeter", (m, 0)), ("num_perimeterpoints", len(zone.perimeter))]
        rows += [("exit", (m, 0, point), entry) for point, entry in zone.exits]
        rows += [*_point_rows((m, 0), zone.perimeter, zone.first), ("end_perimeter",)]
        for n, spot in enumerate(zone.spots, 1):
            rows += [("spot", (m, n)), ("spot_width", spot.width)]
            rows += [("checkpoint", (m, n, point), number) for point, number in spot.checkpoints]
            rows += [*_point_rows((m, n), spot.waypoints, spot.first), ("end_spot",)]
        rows.append(("end_zone",))
    return format_lines([*rows, ("end_file",)])


def _lane_rows(owner: tuple[int, int], lane: Lane) -> list[Row]:
    return [
        ("lane", owner),
        ("num_waypoints", len(lane.waypoints)),
        ("lane_width", lane.width),
        ("left_boundary", lane.left),
        ("right_boundary", lane.right),
        *(("checkpoint", (*owner, point), number) for point, number in lane.checkpoints),
        *(("stop", (*owner, point)) for point in lane.stops),
        *(("exit", (*owner, point), entry) for point, entry in lane.exits),
        *_point_rows(owner, lane.waypoints, lane.first),
        ("end_lane",),
    ]


def _point_rows(owner: tuple[int, int], points: tuple[LatLon, ...], first: int) -> list[Row]:
    return [((*owner, i), *at) for i, at in enumerate(points, first)]
