"""Layers of the page: all of them can be switched, and what they draw is where things are."""

from dataclasses import replace

import numpy as np
import pytest
import viser

from tests.view.scenery import LIT_ROOM, ROOT, drawn, nodes, seers
from usarmjx.comms.attenuation import RadioSettings
from usarmjx.sensors.sketch import OverlayLines
from usarmjx.server.viewing.served_source import ServedSource
from usarmjx.sim.control import CommandUpdate
from usarmjx.view.layers import LAYERS
from usarmjx.view.layers.base import ROBOT_COLORS, scale_colors
from usarmjx.view.layers.bodies import CameraLayer, SensorBodyLayer, mount_poses
from usarmjx.view.layers.light import HeadlightLayer, LampLayer, SkyLayer
from usarmjx.view.layers.marks import (
    CELL,
    GridLayer,
    NameLayer,
    RfidLayer,
    RingLayer,
    TagLayer,
    TrailLayer,
    VictimHitLayer,
)
from usarmjx.view.layers.radio import RadioLayer, dashes

PLACES = ((0.0, 0.2, 0.4), (-1.6, -1.4, 2.0))


@pytest.fixture(scope="module")
def pair():
    return seers(*PLACES)


@pytest.mark.parametrize("name", LAYERS.names())
def test_layers_can_be_switched_and_taken_away(scene, pair, name):
    _, source = pair
    layer, drawing, frame = drawn(LAYERS.get(name), source, scene)
    assert layer.name == name
    assert layer.about
    (top, *_) = nodes(scene)
    assert "/" not in top
    layer.show(False)
    assert top not in nodes(scene)
    layer.show(True)
    assert top in nodes(scene)
    layer.update(drawing, frame)
    layer.begin(scene, drawing, ROOT)
    layer.update(drawing, frame)
    layer.end()
    assert nodes(scene) == {}
    layer.end()


@pytest.mark.parametrize("name", LAYERS.names())
def test_what_stands_still_is_not_sent_again(scene, pair, name, monkeypatch):
    _, source = pair
    layer, drawing, _ = drawn(LAYERS.get(name), source, scene)
    sent = []
    monkeypatch.setattr(scene, "_queue_scene_message", sent.append)
    layer.update(drawing, source.frame(0))
    assert sent == []


@pytest.mark.parametrize("name", LAYERS.names())
def test_layers_know_worlds_without_robots(scene, name):
    _, source = seers()
    drawn(LAYERS.get(name), source, scene)


def test_a_layer_that_is_off_stays_off_with_another_drawing(scene, pair):
    _, source = pair
    layer, drawing, _ = drawn(RingLayer, source, scene)
    layer.show(False)
    layer.begin(scene, drawing, ROOT)
    assert "rings" not in nodes(scene)


# Who is who


def seen_colors():
    """Robots' colours as people with normal sight and the three kinds of dichromats see them, in CIELAB.

    Machado, Oliveira and Fernandes 2009, severity 1.
    """
    blind = [
        np.eye(3),
        [(0.152286, 1.052583, -0.204868), (0.114503, 0.786281, 0.099216), (-0.003882, -0.048116, 1.051998)],
        [(0.367322, 0.860646, -0.227968), (0.280085, 0.672501, 0.047413), (-0.011820, 0.042940, 0.968881)],
        [(1.255528, -0.076749, -0.178779), (-0.078411, 0.930809, 0.147602), (0.004733, 0.691367, 0.303900)],
    ]
    rgb = ROBOT_COLORS / 255
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    to_xyz = np.array([(0.4124, 0.3576, 0.1805), (0.2126, 0.7152, 0.0722), (0.0193, 0.1192, 0.9505)])
    for matrix in blind:
        xyz = np.clip(linear @ np.array(matrix).T, 0, 1) @ to_xyz.T / (0.9505, 1.0, 1.089)
        f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
        yield np.stack([116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])], -1)


def test_sixteen_robots_have_colours_that_everybody_can_tell_apart():
    assert len(ROBOT_COLORS) >= 16
    for lab in seen_colors():
        apart = np.linalg.norm(lab[:, None] - lab, axis=-1) + 1e3 * np.eye(len(lab))
        assert apart.min() > 20  # 2.3 is a just noticeable difference


def test_the_scale_goes_from_bad_to_good():
    assert scale_colors(np.array([-1.0, 0.0, 0.5, 1.0, 2.0])).tolist() == [
        *[[213, 94, 0]] * 2,
        [240, 228, 66],
        *[[0, 158, 115]] * 2,
    ]


def test_names_stand_over_their_robots(scene, pair):
    world, source = pair
    layer, drawing, frame = drawn(NameLayer, source, scene)
    labels = nodes(scene, viser.LabelHandle)
    assert [label.text for label in labels.values()] == ["robot0", "robot1"]
    for slot, label in enumerate(labels.values()):
        robot = world.robots[slot]
        above = label.position - world.state(robot).pos
        assert np.allclose(above[:2], 0.0, atol=1e-5)
        assert above[2] > robot.spec.dimensions[2] / 2
    layer.update(drawing, replace(frame, robots={1: frame.robots[1]}))
    assert [label.text for label in nodes(scene, viser.LabelHandle).values()] == ["robot1"]


def test_rings_lie_around_robots_in_their_colours(scene, pair):
    world, source = pair
    drawn(RingLayer, source, scene)
    ring = nodes(scene)["rings/rings"]
    for slot, robot in world.robots.items():
        state = world.state(robot)
        assert np.allclose(ring.batched_positions[slot], state.pos)
        assert np.allclose(ring.batched_wxyzs[slot], state.quat)
        assert (ring.batched_scales[slot][:2] > np.array(robot.spec.dimensions[:2]) / 2).all()
        assert ring.batched_colors[slot].tolist() == ROBOT_COLORS[slot].tolist()
    tip = ring.vertices[np.argmax(ring.vertices[:, 0])]
    assert tip[0] > 1.2  # it points ahead
    assert tip[1] == 0


# What lies on the floor


def test_grid_lines_run_where_elements_of_arenas_meet(scene, pair):
    _, source = pair
    _, drawing, _ = drawn(GridLayer, source, scene)
    grid = nodes(scene)["grid/lines"]
    assert grid.cell_size == CELL == 1.2
    low = drawing.extent[:, 0]
    # Lines lie at whole cells from the middle.
    assert np.allclose((grid.position[:2] - low) / CELL, np.rint((grid.position[:2] - low) / CELL), atol=1e-6)
    assert drawing.floor < grid.position[2] < drawing.floor + 0.02
    reach = np.array([grid.width, grid.height]) / 2
    assert (grid.position[:2] - reach <= low).all()
    assert (grid.position[:2] + reach >= drawing.extent[:, 1]).all()
    wide = replace(drawing, extent=drawing.extent * 20)
    layer = GridLayer()
    layer.begin(scene, wide, ROOT)
    assert nodes(scene)["grid/lines"].cell_size == 5 * CELL


def test_tags_have_their_numbers_and_dropped_ones_too(scene, pair):
    world, source = pair
    layer, drawing, frame = drawn(TagLayer, source, scene)
    ids = np.asarray(world.scene.tags.id)
    assert [label.text for label in nodes(scene, viser.LabelHandle).values()] == [str(n) for n in ids]
    assert ids[0] == 1007
    assert ids[1] > 0  # it has no number of its own
    discs = nodes(scene)["tags/discs"]
    fixed = np.add(world.scene.tags.pos, (0.0, 0.0, world.arena.floor))
    assert np.allclose(discs.batched_positions, fixed)
    layer.update(drawing, replace(frame, dropped_tags=np.array([[1.0, 2.0, 0.1]])))
    discs = nodes(scene)["tags/discs"]
    assert np.allclose(discs.batched_positions, [*fixed, (1.0, 2.0, 0.1)])
    assert discs.batched_colors[-1].tolist() != discs.batched_colors[0].tolist()


# What sensors draw


def test_rfid_lines_and_victim_hits_are_the_overlays(scene, pair):
    _, source = pair
    _, _, frame = drawn(RfidLayer, source, scene)
    drawn(VictimHitLayer, source, scene)
    lines, hits = nodes(scene)["rfid_lines/lines"], nodes(scene)["victim_hits/points"]
    start, end, rgb = (
        np.concatenate([getattr(one, name)[one.shown] for one in frame.overlays])
        for name in ("start", "end", "rgb")
    )
    is_line = (start != end).any(-1)
    assert is_line.any()
    assert (~is_line).any()
    assert np.allclose(lines.points, np.stack([start, end], 1)[is_line])
    assert np.allclose(lines.colors[:, 0], 255 * rgb[is_line], atol=1)
    assert np.allclose(hits.points, end[~is_line])
    assert np.allclose(hits.colors, 255 * rgb[~is_line], atol=1)


def test_trails_are_in_the_colours_of_trace(scene, pair):
    _, source = pair
    layer, drawing, frame = drawn(TrailLayer, source, scene)
    assert set(nodes(scene)) == {"trails"}
    where = np.array([(0.0, 0.0, 0.1), (0.5, 0.0, 0.1), (1.0, 0.0, 0.1)])
    rgb = np.array([(1.0, 0.0, 0.0), (0.0, 1.0, 1.0), (0.5, 0.0, 0.5)])
    trace = OverlayLines(start=where, end=where, rgb=rgb, shown=np.array([True, True, True]))
    layer.update(drawing, replace(frame, trace=trace))
    points = nodes(scene)["trails/points"]
    assert np.allclose(points.points, where)
    assert points.colors.tolist() == [[255, 0, 0], [0, 255, 255], [127, 0, 127]]


# The radio


def test_links_run_between_antennas_with_a_gap_for_each_wall(scene):
    world, _ = seers((0.0, 0.0, 0.0), (2.4, 1.7, 0.0))
    source = ServedSource([world], RadioSettings())
    _, drawing, frame = drawn(RadioLayer, source, scene)
    walls, power = int(frame.links.walls[0, 1]), float(frame.links.power[0, 1])
    assert walls == 1  # the pillar between them
    lines = nodes(scene)["radio_links/lines"]
    tops = [
        np.add(world.state(robot).pos, (0, 0, robot.spec.dimensions[2] / 2))
        for robot in world.robots.values()
    ]
    assert len(lines.points) == walls + 1
    assert np.allclose([lines.points[0, 0], lines.points[-1, 1]], tops, atol=0.02)
    (label,) = nodes(scene, viser.LabelHandle).values()
    assert label.text == f"{power:.0f} dBm, 1 wall"
    assert drawing.cutoff == RadioSettings().cutoff


def test_links_that_do_not_hold_are_not_drawn(scene):
    world, _ = seers((0.0, 0.0, 0.0), (2.4, 1.7, 0.0))
    source = ServedSource([world], RadioSettings(cutoff=-40.0))
    drawn(RadioLayer, source, scene)
    assert set(nodes(scene)) == {"radio_links"}


def test_dashes_fill_a_link_but_for_gaps_of_one_size():
    link, share = dashes(np.array([0, 3]))
    assert link.tolist() == [0, 1, 1, 1, 1]
    assert share[0].tolist() == [0.0, 1.0]
    own = share[1:]
    assert own[0, 0] == 0.0
    assert own[-1, 1] == 1.0
    gaps = own[1:, 0] - own[:-1, 1]
    assert np.allclose(gaps, gaps[0])
    assert gaps[0] > 0
    assert np.allclose(own.ravel() + own.ravel()[::-1], 1.0)  # in the middle


# Cameras and sensors


def test_views_of_cameras_start_at_them_and_follow_their_zoom(scene, pair):
    world, source = pair
    layer, drawing, frame = drawn(CameraLayer, source, scene)
    lines = nodes(scene)["camera_views/lines"]
    pos, mat = mount_poses(frame, drawing.robots[0].cameras[0])
    edges = lines.points[:8]
    assert np.allclose(edges[:4, 0], pos[0], atol=1e-6)
    aside = np.abs((edges[:4, 1] - pos[0]) @ mat[0])
    assert np.allclose(np.arctan2(aside[:, 1], aside[:, 0]), frame.robots[0].fovs[0] / 2, atol=1e-5)
    world.zoom(world.robots[0], 0, 0.5)
    layer.update(drawing, source.frame(0))
    nearer = np.abs((nodes(scene)["camera_views/lines"].points[0, 1] - pos[0]) @ mat[0])
    assert np.arctan2(nearer[1], nearer[0]) == pytest.approx(0.25, abs=1e-3)


def test_sensor_bodies_are_the_boxes_of_hidden_sensors_as_housings_has_them(scene):
    """The same box that HiddenSensor=false puts into the model: compared with that of another robot."""
    _, source = seers((0.0, 0.0, 0.3))
    _, drawing, _ = drawn(SensorBodyLayer, source, scene)
    boxes = nodes(scene)["sensor_bodies/boxes"]
    count = sum(len(mount.names) for mount in drawing.robots[0].sensors)
    assert len(boxes.batched_positions) == count - 1  # INS is shown by its robot already
    robot = replace(source._worlds[0].robots[0].spec, name="Open")
    shown = tuple(
        replace(mount, options=(*mount.options, ("HiddenSensor", True))) for mount in robot.sensors[:-1]
    )
    first = replace(shown[0], options=(*robot.sensors[0].options, ("HiddenSensor", False)))
    world, _ = seers((0.0, 0.0, 0.3), robot=replace(robot, sensors=(first, *shown[1:])))
    model, data = world._single.engine.model, world._single.engine.data
    head = [i for i in range(model.ngeom) if np.allclose(model.geom_size[i], (0.02, 0.012, 0.008))]
    assert len(head) == 1
    assert np.allclose(boxes.batched_positions[0], data.geom_xpos[head[0]], atol=5e-3)


# Light


def test_lamps_shine_where_the_arena_has_them(scene):
    _, source = seers(arena=LIT_ROOM)
    layer, drawing, _ = drawn(LampLayer, source, scene)
    lights = nodes(scene, viser.PointLightHandle).values()
    assert np.allclose(sorted(light.position.tolist() for light in lights), sorted(drawing.lamps.tolist()))
    assert all(light.intensity == pytest.approx(np.pi * drawing.lamp_rgb.max(), rel=0.01) for light in lights)
    assert len(nodes(scene)["lamps/bulbs"].points) == len(drawing.lamps) == 2
    layer.alone = False
    layer.begin(scene, drawing, ROOT)
    assert nodes(scene, viser.PointLightHandle) == {}  # the worlds beside it would be darker
    assert len(nodes(scene)["lamps/bulbs"].points) == 2


def test_headlights_shine_while_they_are_on(scene):
    world, source = seers((0.0, 0.0, 0.5))
    layer, drawing, _ = drawn(HeadlightLayer, source, scene)
    assert nodes(scene, viser.SpotLightHandle) == {}
    world.update_command(world.robots[0], CommandUpdate(light=True))
    frame = source.frame(0)
    layer.update(drawing, frame)
    (light,) = nodes(scene, viser.SpotLightHandle).values()
    state = world.state(world.robots[0])
    ahead = light.position - state.pos
    assert np.linalg.norm(ahead) == pytest.approx(world.robots[0].spec.dimensions[0] / 2, abs=1e-3)
    assert np.allclose(ahead / np.linalg.norm(ahead), light.direction, atol=1e-5)
    assert np.arctan2(light.direction[1], light.direction[0]) == pytest.approx(0.5, abs=0.02)
    world.update_command(world.robots[0], CommandUpdate(light=False))
    layer.update(drawing, source.frame(0))
    assert nodes(scene, viser.SpotLightHandle) == {}


def test_the_sun_throws_shadows_and_goes_with_its_switch(scene, pair):
    _, source = pair
    layer, *_ = drawn(SkyLayer, source, scene)
    (sun,) = nodes(scene, viser.SpotLightHandle).values()
    assert sun.cast_shadow
    layer.show(False)
    assert nodes(scene, viser.SpotLightHandle) == {}
    layer.show(True)
    (again,) = nodes(scene, viser.SpotLightHandle).values()
    assert again.intensity == sun.intensity
    _, lit = seers(arena=LIT_ROOM)
    layer.begin(scene, lit.drawing(0), ROOT)
    (inside,) = nodes(scene, viser.SpotLightHandle).values()
    assert inside.intensity < sun.intensity
    layer.alone = False
    layer.begin(scene, lit.drawing(0), ROOT)
    (over_all,) = nodes(scene, viser.DirectionalLightHandle).values()
    assert over_all.intensity == sun.intensity


def test_the_light_stays_when_robots_come_and_go(scene, pair, monkeypatch):
    _, source = pair
    layer, drawing, _ = drawn(SkyLayer, source, scene)
    monkeypatch.setattr(scene, "_queue_scene_message", None)
    monkeypatch.setattr(scene, "configure_environment_map", None)
    layer.begin(scene, replace(drawing, robots={}), ROOT)
    monkeypatch.undo()
    layer.end()
    assert nodes(scene) == {}
    layer.begin(scene, drawing, ROOT)
    assert len(nodes(scene, viser.SpotLightHandle)) == 1


def test_a_small_arena_lies_in_the_suns_light_as_a_whole(scene, pair):
    _, source = pair
    layer, drawing, _ = drawn(SkyLayer, source, scene)
    (sun,) = nodes(scene, viser.SpotLightHandle).values()
    corners = np.array([(x, y, drawing.floor) for x in drawing.extent[0] for y in drawing.extent[1]])
    way = corners - sun.position
    off_axis = np.arccos((way @ sun.direction) / np.linalg.norm(way, axis=-1))
    assert (off_axis < sun.angle).all()
    layer.begin(scene, replace(drawing, extent=drawing.extent * 20), ROOT)
    assert nodes(scene, viser.SpotLightHandle) == {}
    assert len(nodes(scene, viser.DirectionalLightHandle)) == 1
    layer.alone = False
    layer.begin(scene, drawing, ROOT)
    assert nodes(scene, viser.SpotLightHandle) == {}  # it would leave the worlds beside it in the dark
    (far,) = nodes(scene, viser.DirectionalLightHandle).values()
    assert np.allclose(far.position / np.linalg.norm(far.position), -np.array(sun.direction))


def test_a_sensor_of_an_unknown_kind_is_passed_over(scene, pair):
    """A recording may have a sensor that is not registered here."""
    _, source = pair
    drawing = source.drawing(0)
    robot = drawing.robots[0]
    sensors = tuple(replace(mount, kind="Unheard") for mount in robot.sensors)
    drawing = replace(drawing, robots={0: replace(robot, sensors=sensors)})
    for name in ("Laser fans", "Sonar cones", "Infrared lines", "Map"):
        layer = LAYERS.get(name)()
        layer.begin(scene, drawing, ROOT)
        layer.update(drawing, source.frame(0))
