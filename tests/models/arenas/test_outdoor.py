"""DM-Outdoor: the terrain's shape and slopes, clear starts, robots that cross its hills, sky and voids."""

import math

import mujoco
import numpy as np
import pytest

from tests.rig import Rig
from tests.starts import deepest
from tests.tours import ArenaRoute
from usarmjx.models.arenas.outdoor import BASE, FLOOR, HALF, HILLS, OUTDOOR, TREES, ground
from usarmjx.models.compile.reachability import footprint_of, reach_map, victims_reached
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import START_ELEVATION
from usarmjx.models.types.shapes import SKY
from usarmjx.sim.scene import build_scene

DEEP = 0.002  # m
GRID = 1e-5  # m: heights are kept in single precision
BETWEEN = 0.05  # m: flat triangles of 1 m for hills that bend by 0.4 per metre at most
OVER_HILLS = {
    "east": ((0.8, -10.0), (9.0, -10.0), (16.2, -10.0)),
    "west": ((-2.2, 9.0), (-10.0, 9.0), (-16.6, 9.0)),
}


@pytest.fixture(scope="module")
def built():
    model = build_scene(OUTDOOR, ["ComStation"]).model
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def below(built, x, y, start=FLOOR + 2.0):
    """Height above the arena's floor of what a ray meets that goes straight down from `start`."""
    model, data = built
    geom = np.zeros(1, np.int32)
    down = mujoco.mj_ray(model, data, np.array([x, y, start]), np.array([0, 0, -1.0]), None, 1, -1, geom)
    return start - down - FLOOR, model.geom_type[geom[0]]


def test_the_terrain_is_the_formula_at_its_corners_and_close_to_it_between(built):
    spots = [(-10, 9), (-7, 7), (9, -10), (5, -8), (0, -6), (-9, -10), (-18, 0), (19, 3), (1, -13), (-2, 13)]
    for x, y in spots:
        height, kind = below(built, x, y, FLOOR + 8.0)
        assert kind == mujoco.mjtGeom.mjGEOM_HFIELD
        assert height == pytest.approx(ground(x, y), abs=GRID), (x, y)
        height, _ = below(built, x + 0.31, y - 0.43, FLOOR + 8.0)
        assert abs(x) > 17 or height == pytest.approx(ground(x + 0.31, y - 0.43), abs=BETWEEN), (x, y)


def test_heights_are_whole_millimetres_and_the_lowest_is_above_the_floor():
    heights = OUTDOOR.shapes[0].heights.heights
    assert heights.shape == (41, 41)
    np.testing.assert_array_equal(heights, np.round(heights, 3))
    assert 0.1 < heights.min() < BASE


def test_hills_are_gentle_and_the_rim_is_not():
    """A hill is at most 8 / (3 sqrt 3) height / radius steep: what `about` says."""
    steepest = max(8 / (3 * math.sqrt(3)) * abs(rise) / radius for _, _, radius, rise in HILLS)
    assert math.degrees(math.atan(steepest)) == pytest.approx(17, abs=0.5)
    heights = OUTDOOR.shapes[0].heights.heights
    slope = np.abs(np.diff(heights, axis=1))  # per metre
    assert slope[:, 4:36].max() <= steepest
    edge = math.degrees(math.atan(slope[20, 0]))
    assert edge > 50, "steeper than rubber tracks climb (friction 1.2)"


@pytest.mark.parametrize("name", OUTDOOR.robots)
def test_starts_are_clear(name):
    assert max(deepest(OUTDOOR, name).values()) <= DEEP


def test_starts_lie_on_the_flat_ground(built):
    for start in OUTDOOR.starts:
        x, y, z = start.at
        assert z == pytest.approx(BASE + START_ELEVATION)
        for dx, dy in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)):
            assert below(built, x + dx, y + dy)[0] == pytest.approx(BASE, abs=GRID), start.tag


@pytest.mark.every_run("west-Talon")
@pytest.mark.parametrize("name", ["P2AT", "Talon"])
@pytest.mark.parametrize("way", OVER_HILLS)
def test_robots_cross_more_than_14_m_of_hills_and_stay_on_them(name, way):
    (x, y), *rest = OVER_HILLS[way]
    yaw = 0.0 if rest[0][0] > x else math.pi
    rig = Rig(name, arena=OUTDOOR, places=((x, y, yaw, ground(x, y)),))
    terrain = np.flatnonzero(rig.model.geom_type == mujoco.mjtGeom.mjGEOM_HFIELD)
    tour = ArenaRoute(rig).ignore(terrain)
    assert tour.to(rest, speed=0.6, limit=40.0)
    path = tour.path
    assert abs(path[-1, 0] - path[0, 0]) > 14.0
    above = path[:, 2] - FLOOR - np.array([ground(*place) for place in path[:, :2]])
    # On the triangles, with the body's middle between its wheels: within 6 cm of its height on flat ground.
    np.testing.assert_allclose(above, rig.plan.clearance, atol=0.06)
    assert path[:, 2].max() - path[0, 2] > 1.2, "over the top"
    assert path[:, 3].min() > math.cos(math.radians(20))
    assert tour.touched == 0.0


def test_no_robot_drives_out_over_the_rim():
    """A Talon at full speed against it: it gets stuck on the slope, upright or not."""
    rig = Rig("Talon", arena=OUTDOOR, places=((-14.0, 0.0, math.pi, ground(-14.0, 0.0)),))
    rig.tell(Left=9.0, Right=9.0)
    rows = rig.run(12.0)
    root = rig.indices[0].root_qposadr
    x, _, z = rig.data.qpos[root : root + 3]
    assert -HALF < x < -17.5
    assert z > FLOOR + BASE
    assert np.isfinite(rows).all()


def test_the_sky_is_all_around_and_touches_nothing(built):
    model, _ = built
    sky = [i for i, shape in enumerate(OUTDOOR.shapes) if shape.material == SKY]
    assert len(sky) == 5
    for i in sky:
        geom = model.geom(f"arena/{i}")
        assert (geom.contype[0], geom.conaffinity[0]) == (0, 0)
    sizes = [OUTDOOR.shapes[i].size for i in sky]
    assert all(max(size) > HALF for size in sizes)


def test_trees_stand_in_the_ground():
    trunks = [shape for shape in OUTDOOR.shapes if shape.size == (0.125, 0.125, shape.size[-1])]
    assert len(trunks) == len(TREES)
    for trunk in trunks:
        assert trunk.at[2] - trunk.size[2] < ground(*trunk.at[:2]) - 0.3
        assert trunk.at[2] + trunk.size[2] > ground(*trunk.at[:2]) + 1.5


def test_victims_lie_in_voids_with_something_above_them(built):
    """The buried ones have concrete over the chest, within 2 m, and air between."""
    model, data = built
    for name, covered in (("Leaning", True), ("Pancake", True), ("Wall", False)):
        victim = next(victim for victim in OUTDOOR.victims if victim.name == name)
        x, y, z = victim.at
        geom = np.zeros(1, np.int32)
        start = np.array([x, y, FLOOR + z + 0.2])
        up = mujoco.mj_ray(model, data, start, np.array([0, 0, 1.0]), None, 1, -1, geom)
        found = model.geom(geom[0]).name
        shape = OUTDOOR.shapes[int(found.removeprefix("arena/"))] if found.startswith("arena/") else None
        over = shape is not None and shape.material != SKY
        assert over == covered, (name, found)
        if covered:
            assert 0.02 < up < 2.0, name


def test_p2ats_reach_every_start_and_every_victim_over_the_hills():
    size = footprint_of(ROBOTS.get("P2AT"))
    reach = reach_map(OUTDOOR, size.radius, size.step)
    assert all(reach.reachable(*start.at[:2]) for start in OUTDOOR.starts)
    assert victims_reached(OUTDOOR, reach) == [True] * len(OUTDOOR.victims)


def test_loose_things_stay_where_they_lie():
    rig = Rig("P2AT", arena=OUTDOOR, places=((-14.0, 0.0, 0.0, BASE),))
    before = {loose.name: rig.data.joint(f"loose/{loose.name}").qpos.copy() for loose in OUTDOOR.loose}
    rig.run(3.0)
    for name, pose in before.items():
        now = rig.data.joint(f"loose/{name}").qpos
        assert np.linalg.norm(now[:3] - pose[:3]) < 0.005, name
