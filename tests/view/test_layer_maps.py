"""The map layer: maps of tasks, and those drawn of scans, which are compared with the boxes of the arena."""

from dataclasses import replace

import numpy as np
import pytest
import viser

from tests.view.scenery import P2AT, ROOT, distance_to_boxes, drawn, nodes, run, seers
from usarmjx.train.mapping import maps as mapping
from usarmjx.view.drawing import MAP_GRID, MAP_PREFIX
from usarmjx.view.layers import maps as layer_maps
from usarmjx.view.layers.maps import FREE, MAP_RGBA, MARK, UNKNOWN, WALL, MapLayer, merged


def picture(scene):
    """The map that is shown, one pixel a square (i, j), and its node."""
    (node,) = nodes(scene, viser.ImageHandle).values()
    pixels = np.asarray(node.image)[:: layer_maps.ENLARGED, :: layer_maps.ENLARGED]
    kinds = (pixels[..., None, :] == MAP_RGBA).all(-1)
    assert (kinds.sum(-1) == 1).all()
    return kinds.argmax(-1).T, node


def centres(squares, node):
    """The middles of squares in the world (i, j, 2), from where and how large the picture is."""
    size = np.array([node.render_width, node.render_height])
    steps = (np.stack(np.meshgrid(*map(np.arange, squares.shape), indexing="ij"), -1) + 0.5) / squares.shape
    return node.position[:2] + (steps - 0.5) * size


def test_squares_mean_what_they_mean_to_tasks():
    assert (UNKNOWN, FREE, WALL, MARK) == (mapping.UNKNOWN, mapping.FREE, mapping.WALL, mapping.MARK)


def test_maps_of_a_team_are_merged_as_robots_merge_what_they_receive():
    one, two = np.meshgrid(range(4), range(4), indexing="ij")
    assert np.array_equal(merged([one, two]), np.asarray(mapping.merge_received(one, two)))


@pytest.fixture(scope="module")
def driver():
    """A robot with a laser scanner."""
    world, source = seers((0.0, -0.5, 0.0), robot=P2AT)
    return world, source


def test_a_map_of_scans_has_walls_where_walls_are(scene, driver):
    world, source = driver
    layer, *_ = drawn(MapLayer, source, scene)
    for _ in range(8):
        run(world, 25)
        layer.update(source.drawing(0), source.frame(0))
    squares, node = picture(scene)
    middle = centres(squares, node)
    height = np.full((*squares.shape, 1), 0.3)
    apart = distance_to_boxes(np.concatenate([middle, height], -1).reshape(-1, 3)).reshape(squares.shape)
    floor = 0.3  # the nearest surface in the open is the floor
    assert (squares == WALL).sum() > 40
    assert apart[squares == WALL].max() < 0.15
    assert (squares == FREE).sum() > 300
    assert np.isclose(apart[squares == FREE], floor).mean() > 0.8
    assert (squares == UNKNOWN).sum() > 100  # behind the walls, and behind the robot
    ahead = middle[(squares == FREE)][:, 0]
    assert ahead.max() > 2.5


def test_a_tasks_maps_are_shown_where_their_squares_are(scene, driver):
    _, source = driver
    drawing, frame = source.drawing(0), source.frame(0)
    one, two = np.zeros((5, 3), np.uint8), np.zeros((5, 3), np.uint8)
    one[4, 0], two[0, 2], two[4, 1] = WALL, FREE, MARK
    extra = {MAP_GRID: np.array([1.0, 2.0, 0.5]), f"{MAP_PREFIX}a": one, f"{MAP_PREFIX}b": two}
    layer = MapLayer()
    layer.begin(scene, drawing, ROOT)
    layer.show(True)
    layer.update(drawing, replace(frame, extra=extra))
    squares, node = picture(scene)
    where = centres(squares, node)
    for kind, place in ((WALL, (3.0, 2.0)), (FREE, (1.0, 3.0)), (MARK, (3.0, 2.5))):
        (at,) = where[squares == kind]
        assert np.allclose(at, place)
    assert node.position[2] > drawing.floor


def test_a_map_is_sent_anew_only_when_it_has_changed(scene, driver):
    _, source = driver
    drawing, frame = source.drawing(0), source.frame(0)
    squares = np.zeros((5, 3), np.uint8)
    extra = {MAP_GRID: np.array([1.0, 2.0, 0.5]), f"{MAP_PREFIX}a": squares}
    layer = MapLayer()
    layer.begin(scene, drawing, ROOT)
    layer.update(drawing, replace(frame, extra=extra))
    first = picture(scene)[1].image
    layer.update(drawing, replace(frame, time=frame.time + 1.0, extra=extra))
    assert picture(scene)[1].image is first
    changed = {**extra, f"{MAP_PREFIX}a": squares + FREE}
    layer.update(drawing, replace(frame, time=frame.time + 1.1, extra=changed))
    assert picture(scene)[1].image is first  # too early after the last one
    layer.update(drawing, replace(frame, time=frame.time + 1.6, extra=changed))
    assert (picture(scene)[0] == FREE).all()
    layer.update(drawing, replace(frame, time=0.0, extra=extra))  # the world began anew
    assert (picture(scene)[0] == UNKNOWN).all()
