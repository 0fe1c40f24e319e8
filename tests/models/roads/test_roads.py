"""Markings of a small network of another kind than DM-ARDA's, against hand-counted lines."""

import numpy as np
import pytest

from usarmjx.models.roads.network import METRES_PER_FOOT, Lane, RoadSegment, RouteNetwork, to_lat_lon
from usarmjx.models.roads.shapes import (
    DASH_GAP,
    DASH_LENGTH,
    LINE_WIDTH,
    PAINT_THICKNESS,
    WHITE,
    YELLOW,
    lane_runs,
    offset_path,
    road_shapes,
)

ORIGIN = (40.0, 10.0)
HALF = 6 * METRES_PER_FOOT
LENGTH = 100.0
ATOL = 1e-4  # m: degrees to metres and back


def lane(left, right, *points, y=0.0, **marks):
    """A lane straight along x; y is left."""
    places = tuple(to_lat_lon(ORIGIN, (x, y)) for x in points or (0.0, LENGTH))
    return Lane(waypoints=places, left=left, right=right, **marks)


def painted(*lanes):
    return road_shapes(RouteNetwork(name="r", segments=(RoadSegment(lanes=lanes),)), ORIGIN)


def of(shapes, rgba=WHITE, surface="fixture"):
    return [shape for shape in shapes if shape.rgba == rgba and shape.surface == surface]


@pytest.mark.parametrize(
    ("kind", "rgba", "inwards"),
    [("solid_white", WHITE, 0.5), ("solid_yellow", YELLOW, 0.5), ("double_yellow", YELLOW, 1.0)],
)
def test_a_solid_line_lies_inside_the_lanes_edge(kind, rgba, inwards):
    """A lane without a width is 12 feet wide; a double line is one line of either lane and a gap."""
    (line,) = of(painted(lane(kind, "broken_white")), rgba) if rgba == YELLOW else of(painted(lane("", kind)))
    side = 1 if rgba == YELLOW else -1
    assert line.at == pytest.approx(
        (LENGTH / 2, side * (HALF - inwards * LINE_WIDTH), PAINT_THICKNESS / 2), abs=ATOL
    )
    assert line.size == pytest.approx((LENGTH / 2, LINE_WIDTH / 2, PAINT_THICKNESS / 2), abs=ATOL)
    if kind == "double_yellow":
        assert 2 * (HALF - abs(line.at[1])) - LINE_WIDTH == pytest.approx(LINE_WIDTH), (
            "the gap is as wide as a line"
        )


def test_broken_lines_are_dashes_of_ten_feet_and_gaps_of_thirty():
    """Of two lanes side by side each paints half of its width; the last dash ends with the lane."""
    right, left = lane("broken_white", "solid_white"), lane("solid_yellow", "broken_white", y=2 * HALF)
    dashes = [s for s in of(painted(right, left)) if s.size[1] == LINE_WIDTH / 4]
    assert len(dashes) == 2 * int(np.ceil(LENGTH / (DASH_LENGTH + DASH_GAP)))
    assert sorted({round(s.at[1] - HALF, 6) for s in dashes}) == pytest.approx(
        [-LINE_WIDTH / 4, LINE_WIDTH / 4], abs=ATOL
    )
    starts = sorted(s.at[0] - s.size[0] for s in dashes if s.at[1] < HALF)
    assert np.diff(starts) == pytest.approx(DASH_LENGTH + DASH_GAP, abs=ATOL)
    assert [s.size[0] for s in dashes[:-1] if s.at[0] < 95] == pytest.approx([DASH_LENGTH / 2] * 16, abs=ATOL)


def test_lines_end_where_a_lane_crosses_another_road():
    crossing = lane(
        "solid_yellow", "solid_white", 0.0, 40.0, 60.0, 100.0, exits=((2, (1, 1, 3)),), stops=(2,)
    )
    network = RouteNetwork(name="r", segments=(RoadSegment(lanes=(crossing,)),))
    runs = lane_runs(network, (1, 1), ORIGIN)
    np.testing.assert_allclose([run[:, 0] for run in runs], [(0, 40), (60, 100)], atol=ATOL)
    shapes = road_shapes(network, ORIGIN)
    assert [s.at[0] for s in of(shapes, YELLOW)] == pytest.approx([20.0, 80.0], abs=ATOL)
    stop = of(shapes)[-1]
    assert stop.at[:2] == pytest.approx((40.0, 0.0), abs=ATOL)
    assert abs(stop.rotation[2]) == pytest.approx(np.pi / 2), "it lies across the lane"
    assert stop.size[0] == pytest.approx(HALF - LINE_WIDTH)


def test_a_straight_lane_of_many_waypoints_has_one_line_and_kerb():
    shapes = painted(lane("solid_yellow", "", 0.0, 10.0, 30.0, 70.0, LENGTH))
    assert len(of(shapes, YELLOW)) == 1
    (kerb,) = (s for s in shapes if s.surface == "ground")
    assert kerb.at[1] + kerb.size[1] == pytest.approx(-HALF, abs=ATOL), "it begins where the lane ends"
    assert kerb.at[2] == kerb.size[2], "it stands on the ground"


def test_a_line_beside_a_bend_keeps_its_distance_to_both_pieces():
    path = np.array([(0.0, 0.0), (10.0, 0.0), (10.0, 10.0)])
    np.testing.assert_allclose(offset_path(path, 1.0), [(0, 1), (9, 1), (9, 10)], atol=1e-12)
    np.testing.assert_allclose(offset_path(path, -2.0), [(0, -2), (12, -2), (12, 10)], atol=1e-12)
