"""Maps from scans, messages with maps, ways over maps: rooms drawn by hand, and scipy's shortest paths."""

import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from usarmjx.base.errors import UsageError
from usarmjx.models.compile.reachability import RobotFootprint
from usarmjx.models.types.arena import START_ELEVATION, ArenaSpec, StartPose
from usarmjx.models.types.shapes import Shape
from usarmjx.sensors.ranging import ScannerSettings
from usarmjx.train.mapping import maps
from usarmjx.train.mapping.maps import (
    FREE,
    MARK,
    MAX_EVIDENCE,
    UNKNOWN,
    WALL,
    MapGrid,
    classify_scan,
    egocentric_map,
    fuse_maps,
    grid_of,
    merge_packed,
    merge_received,
    pack,
    reachable_squares,
    unpack,
    update_evidence,
)
from usarmjx.train.mapping.wavefront import (
    NEIGHBOURS,
    UNREACHABLE,
    distances,
    frontier,
    passable,
    shortest_path,
    square_centre,
)

GRID = MapGrid(low=(0.0, 0.0), cell=0.3, shape=(13, 9))
"""A room of 3.6 x 2.4 m whose walls run through the middles of the outer squares."""
ALL_ROUND = ScannerSettings(scan_fov=2 * math.pi, resolution=math.pi / 60, max_range=6.0)
drawn = jax.jit(classify_scan, static_argnums=(0, 1))


def scan(pose, settings=ALL_ROUND, width=3.6, depth=2.4):
    """Ranges in a rectangular room, by the slab method, at most the scanner's range."""
    x, y, yaw = pose
    angle = yaw - settings.scan_fov / 2 + np.arange(settings.beams) * settings.resolution
    cos, sin = np.cos(angle), np.sin(angle)
    with np.errstate(divide="ignore"):
        along = np.where(cos > 0, (width - x) / cos, np.where(cos < 0, -x / cos, np.inf))
        across = np.where(sin > 0, (depth - y) / sin, np.where(sin < 0, -y / sin, np.inf))
    return np.minimum(np.minimum(along, across), settings.max_range).astype(np.float32)


@pytest.mark.parametrize("pose", [(1.8, 1.2, 0.0), (0.7, 0.9, 2.0), (3.0, 1.7, -1.1)])
def test_a_scan_of_an_empty_room_shows_its_walls_and_its_floor(pose):
    free, wall = drawn(GRID, ALL_ROUND, np.array(pose, np.float32), scan(pose))
    rim = np.ones(GRID.shape, bool)
    rim[1:-1, 1:-1] = False
    np.testing.assert_array_equal(free, ~rim)
    corner = np.zeros(GRID.shape, bool)
    corner[::12, ::8] = True  # beams on either side of a corner hide it
    np.testing.assert_array_equal(wall | corner, rim)


def test_what_is_behind_a_scanner_or_beyond_its_range_stays_unknown():
    ahead = ScannerSettings(scan_fov=math.pi, resolution=math.pi / 60, max_range=1.0)
    pose = (0.9, 1.2, 0.0)
    free, wall = drawn(GRID, ahead, np.array(pose, np.float32), scan(pose, ahead))
    gap = np.linalg.norm(GRID.centres - np.array(pose[:2]), axis=-1)
    behind, near = GRID.centres[..., 0] < pose[0] - 0.01, gap < 1.5 * GRID.cell
    assert not wall.any()  # the nearest wall ahead or beside is 1.2 m away
    assert not free[behind & ~near].any()
    assert not free[gap > 1.0].any()
    assert free[~behind & (gap < 1.0 - GRID.cell / 2)].all()


def test_looks_are_weighed_against_each_other():
    none, yes = np.zeros((1, 1), bool), np.ones((1, 1), bool)
    evidence = np.zeros((1, 1), np.int8)
    for _ in range(2 * MAX_EVIDENCE):
        evidence = update_evidence(evidence, none, yes)
    assert evidence[0, 0] == MAX_EVIDENCE
    for looks in range(MAX_EVIDENCE + 1):  # a robot that has gone is forgotten
        assert fuse_maps(evidence, none, np.zeros((1, 1), np.uint8))[0, 0] == (
            WALL if looks < MAX_EVIDENCE else UNKNOWN
        )
        evidence = update_evidence(evidence, yes, none)
    assert fuse_maps(evidence, none, np.full((1, 1), WALL, np.uint8))[0, 0] == FREE


def test_hearsay_keeps_marks_and_prefers_what_someone_has_seen_to_be_free():
    table = {
        (UNKNOWN, WALL): WALL,
        (UNKNOWN, FREE): FREE,
        (WALL, FREE): FREE,
        (FREE, WALL): FREE,
        (MARK, FREE): MARK,
        (FREE, MARK): MARK,
        (WALL, UNKNOWN): WALL,
    }
    told, news = np.array(list(table), np.uint8).T
    np.testing.assert_array_equal(merge_received(told, news), list(table.values()))


@pytest.mark.parametrize("shape", [(1, 1), (3, 4), (5, 7), (41, 33)])
def test_a_map_survives_a_message(shape):
    squares = np.random.default_rng(0).integers(0, 4, shape).astype(np.uint8)
    message = pack(squares)
    assert message.dtype == jnp.float32
    assert message.shape == (MapGrid((0.0, 0.0), 1.0, shape).packed_size,)
    np.testing.assert_array_equal(unpack(message, shape), squares)


@pytest.mark.parametrize("seed", range(3))
def test_maps_that_come_packed_make_what_they_make_one_after_another(seed):
    draw, shape = np.random.default_rng(seed), (11, 7)
    received, *news = draw.integers(0, 4, (5, *shape)).astype(np.uint8) * (draw.random((5, *shape)) < 0.6)
    there = np.array([True, False, True, True])
    packed = np.where(there[:, None], [pack(one) for one in news], np.nan)  # what is not there means nothing
    expected = received
    for one in np.array(news)[there]:
        expected = np.asarray(merge_received(expected, one))
    np.testing.assert_array_equal(merge_packed(received, packed, there), expected)


def test_the_map_around_a_robot_turns_with_it():
    squares = np.random.default_rng(1).integers(0, 3, (9, 9)).astype(np.uint8)
    grid = MapGrid(low=(0.0, 0.0), cell=1.0, shape=(9, 9))
    for quarter in range(4):
        pose = np.array([4.0, 4.0, quarter * math.pi / 2], np.float32)
        np.testing.assert_array_equal(
            egocentric_map(grid, squares, pose, 9, 1.0), np.rot90(squares, -quarter)
        )
    aside = egocentric_map(grid, squares, np.array([0.0, 4.0, 0.0], np.float32), 9, 1.0)
    np.testing.assert_array_equal(aside[4:], squares[:5])
    assert (np.asarray(aside[:4]) == WALL).all()


def test_squares_and_places_agree():
    assert GRID.square_count == 117
    index = np.stack(np.meshgrid(*map(np.arange, GRID.shape), indexing="ij"), -1)
    np.testing.assert_array_equal(GRID.index(GRID.centres), index)
    np.testing.assert_allclose(square_centre(GRID, index), GRID.centres, atol=1e-6)
    assert GRID.index(np.array([-5.0, 99.0])).tolist() == [0, 8]
    with pytest.raises(UsageError, match="above 0"):
        grid_of((), 0.0)


def test_only_what_a_robot_gets_to_is_reachable():
    wall = Shape(kind="box", size=(0.05, 1.5, 0.5), at=(2.0, 1.5, 0.5), surface="wall")
    start = StartPose(tag="One", at=(0.6, 0.6, START_ELEVATION), yaw=0.0)
    arena = ArenaSpec(
        name="DM-Two", about="Two rooms.", shapes=(wall,), starts=(start,), extent=((0.0, 3.9), (0.0, 3.0))
    )
    grid = grid_of((arena,))
    there = reachable_squares(arena, grid, RobotFootprint(radius=0.3, step=0.05, height=0.3))
    assert grid.shape == (14, 11)
    x = grid.centres[..., 0]
    assert there[(x > 0.35) & (x < 1.55)][1:].any()
    # The wall's near face is at 1.95 m, the robot keeps 0.3 m off, squares of the search are 0.05 m.
    assert not there[x > 1.95 - 0.3].any()


def shortest(start, open_, toll):
    """Distances by Dijkstra's algorithm over the same graph."""
    rows, columns = start.shape
    number = np.arange(start.size).reshape(start.shape)
    edges = []
    for i in range(rows):
        for j in range(columns):
            for di, dj in NEIGHBOURS:
                a, b = i + di, j + dj
                if 0 <= a < rows and 0 <= b < columns and open_[a, b]:
                    edges.append((number[i, j], number[a, b], math.hypot(di, dj) + toll[a, b]))
    source = start.size
    edges += [(source, number[i, j], start[i, j] + 1.0) for i, j in np.argwhere(start < UNREACHABLE)]
    one, two, cost = zip(*edges, strict=True)
    graph = coo_matrix((cost, (one, two)), shape=(source + 1, source + 1))
    far = dijkstra(graph, indices=source)[:source].reshape(start.shape) - 1.0
    return np.where(np.isfinite(far), far, UNREACHABLE)


def labyrinth(seed):
    draw = np.random.default_rng(seed)
    open_ = draw.random((17, 12)) > 0.35
    start = np.where(draw.random(open_.shape) < 0.03, draw.integers(0, 9, open_.shape), UNREACHABLE)
    start[3, 4] = 2.0
    toll = np.where(draw.random(open_.shape) < 0.3, 3.0, 0.0)
    return start.astype(np.float32), open_, toll.astype(np.float32)


@pytest.mark.parametrize("seed", range(4))
def test_distances_are_those_of_dijkstra(seed):
    start, open_, toll = labyrinth(seed)
    expected = shortest(start, open_, toll)
    np.testing.assert_allclose(distances(start, open_, toll), expected, rtol=1e-5)
    until = np.argwhere(open_)[-1]
    early = distances(start, open_, toll, until=until)
    np.testing.assert_allclose(early[tuple(until)], expected[tuple(until)], rtol=1e-5)


@pytest.mark.parametrize("seed", range(4))
def test_the_way_downhill_is_as_long_as_the_distance_says(seed):
    start, open_, toll = labyrinth(seed)
    far = np.asarray(distances(start, open_, toll))
    begin = tuple(np.argwhere((far < UNREACHABLE) & open_ & (start == UNREACHABLE))[-1])
    path = [begin, *map(tuple, np.asarray(shortest_path(far, np.array(begin), 120)))]
    path = path[: path.index(path[-1]) + 1]
    steps = [math.hypot(a[0] - b[0], a[1] - b[1]) for a, b in itertools.pairwise(path)]
    assert max(steps) < 1.5
    total = sum(steps) + sum(toll[at] for at in path[:-1]) + start[path[-1]]
    assert total == pytest.approx(far[begin], rel=1e-4)


def test_frontiers_lie_between_what_is_free_and_what_is_not_known():
    rows = ["#######", "#....??", "#....??", "#....??", "#######"]
    squares = np.array([["?.#".index(c) for c in row] for row in rows], np.uint8)
    expected = np.zeros(squares.shape, bool)
    expected[1:4, 4] = True
    np.testing.assert_array_equal(frontier(squares), expected)
    way = np.zeros(squares.shape, bool)
    way[2, 2:5] = True
    np.testing.assert_array_equal(passable(squares), way)


def test_how_far_squares_are_from_positions():
    """Squares are the last axes, positions lead: nothing walks over a handful of robots square by square."""
    positions = np.random.default_rng(5).uniform(-1.0, 5.0, (2, 3, 2)).astype(np.float32)
    expected = np.linalg.norm(GRID.centres - positions[:, :, None, None], axis=-1)
    gaps = GRID.gaps(positions)
    assert gaps.shape == (2, 3, *GRID.shape)
    np.testing.assert_allclose(gaps, expected, rtol=1e-6)  # a few roundings


def test_one_square_is_set_in_its_mask():
    mask = np.asarray(GRID.only(jnp.array([2, 1])))
    assert mask.shape == GRID.shape
    assert np.argwhere(mask).tolist() == [[2, 1]]


@pytest.mark.parametrize("backend", ["cpu", "gpu"])
@pytest.mark.parametrize("low", [(-3.0, 2.0), (-40.0, -40.0), (0.1, -20.0)])
def test_squares_out_of_reach_need_not_be_looked_at(low, backend, monkeypatch):
    """Bit for bit the same as all squares looked at, by either path; scanners anywhere, also off the map."""
    monkeypatch.setattr(jax, "default_backend", lambda: backend)
    scanner = ScannerSettings(max_range=4.0, scan_fov=math.pi, resolution=math.pi / 75)
    grid = MapGrid(low=low, cell=0.3, shape=(90, 70))
    random = np.random.default_rng(4)
    poses = random.uniform([-5, -5, -4], [32, 26, 4], (40, 3)) + np.array([*low, 0.0])
    ranges = random.choice([4.0, 0.5, 2.0], (40, scanner.beams)) * random.uniform(
        0.5, 1.0, (40, scanner.beams)
    )
    ranges = np.where(random.uniform(size=ranges.shape) < 0.3, 4.0, ranges)

    def drawn_with(share):
        monkeypatch.setattr(maps, "WINDOW_SHARE", share)
        cast = jax.jit(jax.vmap(lambda pose, one: classify_scan(grid, scanner, pose, one)))
        return cast(jnp.asarray(poses, jnp.float32), jnp.asarray(ranges, jnp.float32))

    for near, everywhere in zip(drawn_with(0.5), drawn_with(0.0), strict=True):
        assert np.asarray(everywhere).any()
        np.testing.assert_array_equal(near, everywhere)
