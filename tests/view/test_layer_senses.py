"""Layers that draw what range sensors tell: it ends on surfaces of the arena, worked out from its boxes."""

from dataclasses import replace

import numpy as np
import pytest
import viser
from scipy.spatial.transform import Rotation

from tests.view.scenery import HEAD, ROOT, WALLS, distance_to_boxes, drawn, nodes, run, seers
from usarmjx.sensors.ranging import RangeScanner, Sonar
from usarmjx.sim.control import CommandUpdate
from usarmjx.view.layers.base import ROBOT_COLORS
from usarmjx.view.layers.bodies import ReadingPoses, sensors_of
from usarmjx.view.layers.echoes import LONGEST_BEAM, InfraredLayer, LaserLayer, SonarLayer

ON_SURFACE = 2e-5
"""How far from a surface a beam may end [m]: single precision at 5 m."""


@pytest.fixture(scope="module")
def seer():
    return seers((0.0, 0.2, 0.4))


def scans_of(scene):
    """Corners of the fans, one after the other, and the points; copied, as viser writes into its arrays."""
    shown = nodes(scene)
    fans = [node.vertices for name, node in shown.items() if name.endswith("/fan")]
    points = [node.points for name, node in shown.items() if name.endswith("/points")]
    return np.concatenate(fans), np.concatenate(points)


def test_beams_of_all_scanners_end_on_surfaces(scene, seer):
    _, source = seer
    _, drawing, frame = drawn(LaserLayer, source, scene)
    corners, points = scans_of(scene)
    flat, deep = frame.robots[0].readings[:2], frame.robots[0].readings[2]
    assert [mount.kind for mount in drawing.robots[0].sensors[:3]] == [
        "RangeScanner",
        "IRScanner",
        "RangeScanner3D",
    ]
    hits = [reading < limit for reading, limit in zip((*flat, deep), (3.0, 6.0, 9.0), strict=True)]
    assert len(points) == sum(hit.sum() for hit in hits)
    assert all(hit.sum() > 0.3 * hit.size for hit in hits)
    assert distance_to_boxes(points).max() < ON_SURFACE
    assert len(corners) == sum(len(reading) + 1 for reading in flat)
    first = len(flat[0])
    lengths = np.linalg.norm(corners[1 : first + 1] - corners[0], axis=-1)
    assert np.allclose(lengths, flat[0], atol=1e-5)
    assert not hits[0].all()  # what met nothing is drawn as far as the scanner sees, without a point
    assert np.allclose(lengths[~hits[0]], 3.0)


def test_a_fan_is_one_triangle_between_two_beams_in_its_robots_colour(scene, seer):
    _, source = seer
    drawn(LaserLayer, source, scene)
    fans = [node for name, node in nodes(scene).items() if name.endswith("/fan")]
    for mesh, reading in zip(fans, source.frame(0).robots[0].readings, strict=False):
        beams = len(reading)
        assert mesh.faces.tolist() == [[0, n, n + 1] for n in range(1, beams)]
        assert len(mesh.vertices) == beams + 1
        assert mesh.color == tuple(ROBOT_COLORS[0])
    assert len(fans) == 2


def test_a_fan_leans_with_the_head_that_its_scanner_sits_on(scene):
    world, source = seers((0.0, 0.2, 0.4))
    run(world, 100)
    layer, drawing, frame = drawn(LaserLayer, source, scene)
    first, _ = scans_of(scene)
    beams = len(frame.robots[0].readings[0])
    joint = next(n for n, name in enumerate(drawing.robots[0].joints) if name.startswith(HEAD))
    before = frame.robots[0].joint_pos[joint]
    world.update_command(
        world.robots[0], CommandUpdate(joints={drawing.robots[0].joints[joint]: before - 0.35})
    )
    run(world, 100)
    frame = source.frame(0)
    layer.update(drawing, frame)
    leaning, points = scans_of(scene)
    normals = [
        np.cross(corners[1] - corners[0], corners[beams // 2] - corners[0]) for corners in (first, leaning)
    ]
    one, two = (normal / np.linalg.norm(normal) for normal in normals)
    turned = before - frame.robots[0].joint_pos[joint]
    assert turned > 0.1
    assert np.arccos(one @ two) == pytest.approx(turned, abs=0.01)
    assert distance_to_boxes(points).max() < ON_SURFACE


def test_scans_stay_where_they_were_taken_until_the_next(scene, seer):
    """Else their ends would leave the walls as the robot drives on."""
    _, source = seer
    layer, drawing, frame = drawn(LaserLayer, source, scene)
    before, points = scans_of(scene)
    moved = replace(frame, pos=frame.pos + np.array([0.3, 0.1, 0.0], np.float32))
    layer.update(drawing, moved)
    assert np.array_equal(scans_of(scene)[0], before)
    robot = frame.robots[0]
    anew = tuple(reading + np.float32(1e-3) * (reading < 3.0) for reading in robot.readings)
    layer.update(drawing, replace(moved, robots={0: replace(robot, readings=anew)}))
    after, _ = scans_of(scene)
    assert np.allclose(after[0] - before[0], (0.3, 0.1, 0.0), atol=1e-5)
    assert len(points)


def test_readings_that_met_nothing_go_along(seer):
    _, source = seer
    drawing, frame = source.drawing(0), source.frame(0)
    held = ReadingPoses(sensors_of(drawing, RangeScanner)[:1])
    far = (np.full_like(frame.robots[0].readings[0], 3.0), *frame.robots[0].readings[1:])
    frame = replace(frame, robots={0: replace(frame.robots[0], readings=far)})
    assert held.update(frame) == [0]
    start = held.pos.copy()
    assert held.update(replace(frame, pos=frame.pos + np.float32(1.0))) == [0]
    assert np.allclose(held.pos - start, 1.0, atol=1e-5)


def test_beams_into_the_open_are_cut_off(scene, seer):
    """A scanner that sees a kilometre far would draw a fan across the country."""
    _, source = seer
    drawing, frame = source.drawing(0), source.frame(0)
    robot = drawing.robots[0]
    settings = ({**robot.sensors[0].settings[0], "max_range": 1000.0},)
    sensors = (replace(robot.sensors[0], settings=settings), *robot.sensors[1:])
    drawing = replace(drawing, robots={0: replace(robot, sensors=sensors)})
    far = (np.full_like(frame.robots[0].readings[0], 1000.0), *frame.robots[0].readings[1:])
    layer = LaserLayer()
    layer.begin(scene, drawing, ROOT)
    layer.update(drawing, replace(frame, robots={0: replace(frame.robots[0], readings=far)}))
    corners, _ = scans_of(scene)
    assert np.linalg.norm(corners[1] - corners[0]) == pytest.approx(LONGEST_BEAM, abs=1e-4)


def test_scans_of_robots_that_left_are_gone(scene, seer):
    _, source = seer
    layer, drawing, frame = drawn(LaserLayer, source, scene)
    layer.update(drawing, replace(frame, robots={}))
    assert nodes(scene, viser.MeshHandle) == nodes(scene, viser.PointCloudHandle) == {}
    layer.update(drawing, frame)
    assert len(nodes(scene, viser.MeshHandle)) == 2


def test_sonar_cones_touch_what_they_heard(scene, seer):
    """Nothing is heard in front of a cone's end, and something lies within the cone at its end."""
    _, source = seer
    _, _, frame = drawn(SonarLayer, source, scene)
    (cone,) = nodes(scene, viser.BatchedMeshHandle).values()
    ranges = frame.robots[0].readings[3]
    assert np.allclose(cone.batched_scales, ranges)
    turn = Rotation.from_quat(cone.batched_wxyzs, scalar_first=True)
    spread = np.linspace(-0.3491 / 2, 0.3491 / 2, 41)
    up, aside = (angle.ravel() for angle in np.meshgrid(spread, spread, indexing="ij"))
    ways = np.stack([np.cos(up) * np.cos(aside), np.cos(up) * np.sin(aside), np.sin(up)], -1)
    ways = ways[ways[:, 0] > np.cos(0.3491 / 2)]
    gaps = [
        distance_to_boxes(pos + scale * turn[n].apply(ways), WALLS).min()
        for n, (pos, scale) in enumerate(zip(cone.batched_positions, ranges, strict=True))
        if scale < 5.0
    ]
    assert len(gaps) > 8
    # Nine lines stand for the cone, so the nearest surface may be a little nearer than what they met.
    assert max(gaps) < 0.02
    assert (cone.batched_colors == ROBOT_COLORS[0]).all()


def test_all_ends_of_a_cone_are_as_far_away_as_sound_travels(scene, seer):
    _, source = seer
    drawn(SonarLayer, source, scene)
    (cone,) = nodes(scene, viser.BatchedMeshHandle).values()
    length = np.linalg.norm(cone.vertices, axis=-1)
    assert length[0] == 0
    assert np.allclose(length[1:], 1.0, atol=1e-6)
    assert np.arccos(cone.vertices[1:, 0].min()) == pytest.approx(0.3491 / 2, abs=1e-6)
    edges = np.sort(np.concatenate([cone.faces[:, [0, 1]], cone.faces[:, [1, 2]], cone.faces[:, [2, 0]]]), 1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()  # it is closed


def test_sonars_with_other_angles_have_other_cones(scene, seer):
    _, source = seer
    drawing, frame = source.drawing(0), source.frame(0)
    robot, place = drawing.robots[0], sensors_of(drawing, Sonar)[0].index
    mount = robot.sensors[place]
    settings = tuple({**one, "beam_angle": 0.1 if n % 2 else 0.5} for n, one in enumerate(mount.settings))
    sensors = list(robot.sensors)
    sensors[place] = replace(mount, settings=settings)
    layer = SonarLayer()
    drawing = replace(drawing, robots={0: replace(robot, sensors=tuple(sensors))})
    layer.begin(scene, drawing, ROOT)
    layer.update(drawing, frame)
    cones = nodes(scene, viser.BatchedMeshHandle).values()
    assert sorted(len(cone.batched_positions) for cone in cones) == [8, 8]


def test_infrared_lines_end_on_surfaces(scene, seer):
    _, source = seer
    _, _, frame = drawn(InfraredLayer, source, scene)
    shown = nodes(scene)
    ends = shown["infrared_lines/lines"].points
    assert np.allclose(
        np.linalg.norm(ends[:, 1] - ends[:, 0], axis=-1), frame.robots[0].readings[4], atol=1e-5
    )
    points = shown["infrared_lines/points"].points
    assert len(points) == 2
    assert distance_to_boxes(points).max() < ON_SURFACE
