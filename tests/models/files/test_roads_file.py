"""Route networks as arenas."""

import math

import pytest

from tests.valid_files import ROADS
from usarmjx.base.errors import ArenaFileError
from usarmjx.models.files.load import find_arena, load_arena
from usarmjx.models.roads import read_rndf, road_shapes, to_local_xy
from usarmjx.models.types.arena import START_ELEVATION


def test_a_route_network_is_paint_kerbs_and_start_poses(tmp_path):
    path = tmp_path / "two.rndf"
    path.write_bytes(ROADS)
    arena = find_arena(str(path))
    network = read_rndf(path)
    assert arena.gps is not None
    assert arena.shapes == road_shapes(network, arena.gps)
    assert arena.has_floor
    start = arena.starts[0]
    first, second = (to_local_xy(arena.gps, at) for at in network.lane(1, 1).waypoints[:2])
    assert (start.tag, start.at) == ("1_1_1", (*first, START_ELEVATION))
    ahead = math.atan2(second[1] - first[1], second[0] - first[0])
    assert start.yaw == pytest.approx(ahead)
    (x0, x1), (y0, y1) = arena.extent
    assert all(x0 < x < x1 and y0 < y < y1 for x, y, _ in (s.at for s in arena.starts))


def test_a_text_file_is_a_route_network_or_refused_and_the_origin_is_said(tmp_path):
    (tmp_path / "two.txt").write_bytes(ROADS)
    assert load_arena(tmp_path / "two.txt").starts
    (tmp_path / "a.yaml").write_text("rndf: {file: two.txt, origin: [34.1, -117.1]}")
    arena = load_arena(tmp_path / "a.yaml")
    assert arena.gps == (34.1, -117.1)
    assert arena.starts[0].at[:2] == pytest.approx((0, 0))
    (tmp_path / "b.txt").write_text("hello")
    with pytest.raises(ArenaFileError, match="is no route network: its first word is not RNDF_name"):
        load_arena(tmp_path / "b.txt")
    (tmp_path / "c.rndf").write_bytes(ROADS.replace(b"num_lanes 1", b"num_lanes x"))
    with pytest.raises(ArenaFileError, match=r"c\.rndf:\d+: "):
        load_arena(tmp_path / "c.rndf")
