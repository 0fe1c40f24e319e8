"""Free poses: robots are put where nothing is, near to where they were asked for, and nobody notices."""

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from tests.arenas import FLAT
from tests.crowd import Crowd
from usarmjx.base.transforms import quat_from_angles
from usarmjx.engines.c.batch import INTEGRATION_STATE
from usarmjx.engines.c.placement import HALVINGS, MAX_PENETRATION, RAISE_STEP, SEARCH_RADIUS, SEARCH_RINGS
from usarmjx.models.arenas import ARENAS
from usarmjx.models.compile.kinematic_tree import kinematic_tree_of
from usarmjx.models.compile.standing import START_GAP, standing_height
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import Door, LooseObject
from usarmjx.models.types.shapes import Shape
from usarmjx.sim.scene import start_height

SETTLED = 0.03
"""How far a robot moves in the second after it was put somewhere [m]: it falls by the gap at most, sinks into
its springs, and rocks."""
SPACING = SEARCH_RADIUS / SEARCH_RINGS
LOWERED = RAISE_STEP / 2**HALVINGS
"""How exactly a raise is found [m]."""


def box(size, at, surface="wall", **options):
    return Shape(kind="box", size=size, at=at, surface=surface, **options)


def state_of(model, data):
    state = np.empty(mujoco.mj_stateSize(model, INTEGRATION_STATE))
    mujoco.mj_getState(model, data, state, INTEGRATION_STATE)
    return state


def test_a_pose_that_is_free_is_returned_bit_for_bit():
    crowd = Crowd(FLAT, "P2AT")
    asked = crowd.on_floor(0, 0.1, 0.2)
    pos, quat = crowd.ask(0, asked, yaw=0.3)
    np.testing.assert_array_equal(pos, asked)
    np.testing.assert_array_equal(quat, quat_from_angles(0.0, 0.0, 0.3))
    crowd.put(0, pos, quat)
    crowd.run(1.0)
    assert np.linalg.norm(crowd.qpos(0)[:3] - asked) < SETTLED


def test_nothing_changes_while_a_pose_is_looked_for():
    crowd = Crowd(ARENAS.get("yellow"), "P2AT", "Hummer")
    crowd.put(0, crowd.on_floor(0, 4.5, 1.9))
    crowd.run(0.1)
    model, data = crowd.model, crowd.data
    before, contacts = state_of(model, data), data.contact.dist.copy()
    bits = model.geom_contype.copy(), model.geom_conaffinity.copy(), model.geom_margin.copy()
    crowd.ask(1, crowd.on_floor(1, 4.5, 1.9))
    np.testing.assert_array_equal(state_of(model, data), before)
    np.testing.assert_array_equal(data.contact.dist, contacts)
    np.testing.assert_array_equal((model.geom_contype, model.geom_conaffinity, model.geom_margin), bits)


@pytest.mark.parametrize("name", ["P2AT", "P2DX", "Zerg"])
@pytest.mark.parametrize("above", [0.0, 0.15, 0.6])
def test_the_second_of_two_at_one_pose_stands_beside_and_not_on_top(name, above):
    """Or above it, from where it would fall onto the first."""
    crowd = Crowd(FLAT, name, name)
    crowd.put(0, crowd.on_floor(0))
    crowd.run(0.5)
    asked, first = crowd.on_floor(1, above=above), crowd.qpos(0)
    pos, quat = crowd.ask(1, asked)
    assert 0 < np.linalg.norm(pos - asked) <= SEARCH_RADIUS
    assert pos[2] == asked[2]
    crowd.put(1, pos, quat)
    assert crowd.depth(1) == 0.0
    np.testing.assert_array_equal(crowd.qpos(0), first)
    crowd.run(1.0)
    assert np.linalg.norm((crowd.qpos(0) - first)[:3]) < SETTLED
    fallen = crowd.qpos(1)[:3] - pos + (0.0, 0.0, above)
    assert np.linalg.norm(fallen) < SETTLED


def test_many_at_one_pose_stand_side_by_side_until_there_is_no_room():
    crowd = Crowd(ARENAS.get("field"), *["P2DX"] * 24)
    poses = []
    for robot in range(24):
        found = crowd.ask(robot, crowd.on_floor(robot))
        if found is None:
            break
        crowd.put(robot, *found)
        assert crowd.depth(robot) == 0.0
        poses.append(found[0])
    # A P2DX is 0.4 m wide: of a disc of that radius at most this many fit with their centres within reach.
    assert 6 <= len(poses) <= (SEARCH_RADIUS + 0.2) ** 2 / 0.2**2
    again = Crowd(ARENAS.get("field"), *["P2DX"] * 24)
    for robot, pos in enumerate(poses):
        found = again.ask(robot, again.on_floor(robot))
        np.testing.assert_array_equal(found[0], pos)
        again.put(robot, *found)


@pytest.mark.parametrize("name", ["Sedan", "Hummer"])
def test_a_car_that_does_not_fit_between_the_walls_is_refused(name):
    crowd = Crowd(ARENAS.get("yellow"), name)
    assert crowd.ask(0, crowd.on_floor(0, 4.5, 1.9)) is None


@pytest.mark.parametrize("arena", ARENAS.names())
def test_the_starts_of_every_arena_are_free(arena):
    spec = ARENAS.get(arena)
    crowd, robot = Crowd(spec, "P2AT"), ROBOTS.get("P2AT")
    sinking = kinematic_tree_of(robot).clearance - standing_height(robot)
    for start in spec.starts:
        asked = np.array([*start.at[:2], start_height(spec, start, ROBOTS.get("P2AT"))])
        pos, _ = crowd.ask(0, asked, start.yaw, sinking)
        np.testing.assert_array_equal(pos, asked, err_msg=start.tag)


@pytest.mark.parametrize("arena", ARENAS.names())
def test_all_may_start_at_once(arena):
    """Nobody at a start is in the way of the next one."""
    spec = ARENAS.get(arena)
    starts = spec.starts[:8]
    crowd, p2at = Crowd(spec, *["P2AT"] * len(starts)), ROBOTS.get("P2AT")
    sinking = kinematic_tree_of(p2at).clearance - standing_height(p2at)
    for robot, start in enumerate(starts):
        asked = np.array([*start.at[:2], start_height(spec, start, p2at)])
        pos, quat = crowd.ask(robot, asked, start.yaw, sinking)
        np.testing.assert_array_equal(pos, asked, err_msg=start.tag)
        crowd.put(robot, pos, quat)


@pytest.mark.parametrize(
    ("arena", "name"), [("flat", "AirRobot"), ("flat", "Passarola"), ("pool", "Submarine")]
)
def test_what_flies_or_floats_keeps_its_height(arena, name):
    spec = FLAT if arena == "flat" else ARENAS.get(arena)
    crowd = Crowd(spec, name)
    start = spec.starts[0]
    asked = np.array([*start.at[:2], spec.floor + start.at[2] + 2.0])
    pos, _ = crowd.ask(0, asked)
    np.testing.assert_array_equal(pos, asked)


def test_below_the_floor_is_on_the_floor():
    crowd = Crowd(FLAT, "P2AT")
    clearance = crowd.heights[0] - START_GAP
    pos, _ = crowd.ask(0, (0.4, 0.3, -7.0))
    np.testing.assert_allclose(pos, (0.4, 0.3, clearance), atol=1e-6)  # single precision of the clearance
    crowd.put(0, pos)
    assert crowd.depth(0) < 1e-9  # double precision of its height


@pytest.mark.parametrize("high", [0.02, 0.12, 0.28])
def test_onto_a_platform_a_robot_is_raised_and_no_further(high):
    platform = box((3.0, 3.0, high / 2), (0.0, 0.0, high / 2), "ground")
    crowd = Crowd(replace(FLAT, shapes=(platform,)), "P2AT")
    asked = crowd.on_floor(0)
    pos, _ = crowd.ask(0, asked)
    raised = pos - asked
    np.testing.assert_array_equal(raised[:2], 0.0)
    least = high - START_GAP - MAX_PENETRATION
    assert least <= raised[2] <= least + LOWERED + 1e-9


def test_higher_than_a_step_nobody_is_raised():
    """0.4 m high and 3 m to its edge: neither up nor beside is free."""
    platform = box((3.0, 3.0, 0.2), (0.0, 0.0, 0.2), "ground")
    crowd = Crowd(replace(FLAT, shapes=(platform,)), "P2AT")
    assert crowd.ask(0, crowd.on_floor(0)) is None


@pytest.mark.parametrize("name", ["P2AT", "Zerg"])
def test_within_a_solid_there_is_no_free_pose(name):
    """Nothing of the robot is near the block's faces."""
    crowd = Crowd(replace(FLAT, shapes=(box((4.0, 4.0, 4.0), (0.0, 0.0, 4.0)),)), name)
    assert crowd.ask(0, crowd.on_floor(0, above=3.0)) is None


def test_the_nearest_free_pose_is_taken():
    """The hull's front is 6 cm inside a wall: one ring back is free, on the side that looks away from it."""
    crowd = Crowd(replace(FLAT, shapes=(box((0.1, 4.0, 1.0), (0.1, 0.0, 1.0)),)), "P2AT")
    crowd.put(0, crowd.on_floor(0))
    mujoco.mj_kinematics(crowd.model, crowd.data)
    own = np.flatnonzero(np.isin(crowd.model.geom_bodyid, crowd.indices[0].body_ids))
    front = max(
        crowd.data.geom_xpos[g, 0] + np.abs(crowd.data.geom_xmat[g].reshape(3, 3)[0]) @ half
        for g in own
        if crowd.model.geom_contype[g] and (half := crowd.model.geom_aabb[g, 3:]) is not None
    )
    asked = crowd.on_floor(0, 0.06 - front)
    moved = crowd.ask(0, asked)[0] - asked
    assert math.isclose(np.linalg.norm(moved), SPACING)
    assert moved[0] <= -0.06 + MAX_PENETRATION


def test_whoever_would_touch_is_in_the_way_whichever_of_the_two_says_so():
    """MuJoCo lets two geoms touch if either one's type is among the other's affinities."""
    crowd = Crowd(replace(FLAT, shapes=(box((0.5, 0.5, 0.5), (0.0, 0.0, 0.5)),)), "P2AT")
    own = np.isin(crowd.model.geom_bodyid, crowd.indices[0].body_ids)
    wall = np.arange(crowd.model.ngeom) == crowd.model.geom("arena/0").id
    found = {}
    for of_robot, of_wall in (((8, 0), (0, 8)), ((0, 8), (8, 0)), ((8, 0), (8, 0)), ((0, 8), (0, 8))):
        for geoms, (contype, conaffinity) in ((own, of_robot), (wall, of_wall)):
            crowd.model.geom_contype[geoms], crowd.model.geom_conaffinity[geoms] = contype, conaffinity
        found[of_robot, of_wall] = crowd.ask(0, crowd.on_floor(0), reach=0.0) is not None
    assert [*found.values()] == [False, False, True, True]


BRICK = LooseObject(
    name="brick", at=(0.0, 0.0, 0.1), shapes=(box((0.1, 0.1, 0.1), (0.0, 0.0, 0.0), "loose", mass=2.0),)
)
DOOR = Door(name="door", at=(0.0, -0.45, 0.0), yaw=math.pi / 2)


@pytest.mark.parametrize("contents", [{"loose": (BRICK,)}, {"doors": (DOOR,)}], ids=["loose", "door"])
def test_what_moves_is_in_the_way_where_it_is_now(contents):
    crowd = Crowd(replace(FLAT, **contents), "P2AT")
    pos, quat = crowd.ask(0, crowd.on_floor(0))
    assert np.hypot(*pos[:2]) >= SPACING * 0.999
    crowd.put(0, pos, quat)
    assert crowd.depth(0) == 0.0
    crowd.data.qpos[0] += 3.0 if "loose" in contents else 1.5  # away, and open; the hinge is at y = -0.45
    asked = crowd.on_floor(0, 0.0, 0.2)
    np.testing.assert_array_equal(crowd.ask(0, asked)[0], asked)


@pytest.mark.parametrize("arena", ["yellow", "red", "outdoor"])
def test_free_is_what_mujoco_says(arena):
    """Against contacts of the whole world, for poses drawn at random: reach 0 leaves the asked one alone."""
    crowd = Crowd(ARENAS.get(arena), "Talon", "P2AT")
    rng, spec = np.random.default_rng(4), ARENAS.get(arena)
    crowd.put(1, crowd.on_floor(1, *spec.starts[0].at[:2]))
    (x0, x1), (y0, y1) = spec.extent
    height = crowd.heights[0] + (2.0 if arena == "outdoor" else 0.0)
    seen = set()
    for _ in range(60):
        asked = np.array([rng.uniform(x0, x1), rng.uniform(y0, y1), height])
        yaw = rng.uniform(-math.pi, math.pi)
        found = crowd.ask(0, asked, yaw, reach=0.0)
        crowd.put(0, asked, quat_from_angles(0.0, 0.0, yaw))
        mujoco.mj_forward(crowd.model, crowd.data)
        contact = crowd.data.contact
        own = np.isin(crowd.model.geom_bodyid, crowd.indices[0].body_ids)
        moving = ((crowd.model.body_treeid[crowd.model.geom_bodyid] >= 0) & ~own)[contact.geom].any(-1)
        mine = own[contact.geom].any(-1)
        blocked = (mine & (-contact.dist > np.where(moving, 0.0, MAX_PENETRATION))).any()
        assert (found is None) == blocked
        seen.add(bool(blocked))
    assert seen == {True, False}
