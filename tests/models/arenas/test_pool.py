"""DM-Pool and DM-Field: starts, water, what water does to robots, what the submarine hears; ComStation."""

import itertools
import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from tests.rig import Rig
from usarmjx.models.arenas import ARENAS
from usarmjx.models.arenas.pool import DECK, DEPTH, KEEL, POOL
from usarmjx.models.compile.kinematic_tree import kinematic_tree_of
from usarmjx.models.compile.standing import START_GAP, standing_height
from usarmjx.models.compile.victims import rest_height
from usarmjx.models.drives import DRY_DEPTH
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import START_ELEVATION, StartPose, Water
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import build_scene, start_height
from usarmjx.sim.world import depth_in_water

WATER_LEVEL = POOL.floor + DEPTH
SONAR_NOISE = 0.05  # of the reading (manual 10.2.2)
ROOM = {"pool": ("Submarine", "P2AT"), "field": ("Passarola", "AirRobot", "P2AT")}


def starts(prefix):
    return [start for start in POOL.starts if start.tag.startswith(prefix)]


def test_levels_have_the_wires_names_and_few_solids():
    assert ARENAS.get("pool").name == "DM-Pool"
    assert ARENAS.get("field").name == "DM-Field"
    assert ARENAS.get("field").extent == ((-200, 200), (-200, 200))
    assert max(len(ARENAS.get(name).shapes) for name in ROOM) <= 8


def test_starts_have_their_own_tags_and_room_for_cars_and_flyers():
    for name, distance in (("pool", 4.0), ("field", 8.0)):
        poses = ARENAS.get(name).starts
        assert len({start.tag for start in poses}) == len(poses)
        assert min(math.dist(a.at[:2], b.at[:2]) for a, b in itertools.combinations(poses, 2)) >= distance


@pytest.mark.parametrize("name", ROOM)
def test_robots_touch_nothing_where_they_start(name):
    arena = ARENAS.get(name)
    for kind in ROOM[name]:
        poses = arena.starts if name == "field" else starts("Water" if kind == "Submarine" else "Quay")
        scene = build_scene(replace(arena, starts=tuple(poses)), [kind] * len(poses))
        data = mujoco.MjData(scene.model)
        for root, start in zip(scene.groups[0].root_qposadr, poses, strict=True):
            height = start_height(arena, start, ROBOTS.get(kind))
            turn = (math.cos(start.yaw / 2), 0, 0, math.sin(start.yaw / 2))
            data.qpos[root] = (*start.at[:2], height, *turn)
        mujoco.mj_kinematics(scene.model, data)
        mujoco.mj_comPos(scene.model, data)
        mujoco.mj_collision(scene.model, data)
        sinking = kinematic_tree_of(ROBOTS.get(kind)).clearance - standing_height(ROBOTS.get(kind))
        assert data.contact.dist.min(initial=0.0) >= -max(0.0, sinking) - 1e-6, "they stand, no deeper"
        data.qpos[scene.groups[0].root_qposadr[:, 2]] -= 0.01 + (KEEL if kind == "Submarine" else 0.0)
        mujoco.mj_kinematics(scene.model, data)
        mujoco.mj_collision(scene.model, data)
        assert data.ncon >= len(poses), "a centimetre lower all stand in the ground"


def test_submarines_start_submerged_and_others_on_the_quay():
    half = ROBOTS.get("Submarine").dimensions[2] / 2
    for start in starts("Water"):
        height = start_height(POOL, start, ROBOTS.get("Submarine"))
        assert height == pytest.approx(POOL.floor + KEEL + half + START_GAP)
        depth = depth_in_water(POOL, np.array([*start.at[:2], height]))
        assert depth == pytest.approx(WATER_LEVEL - height, abs=1e-5)
        assert depth > half
    for start in starts("Quay"):
        height = start_height(POOL, start, ROBOTS.get("P2AT"))
        assert height == pytest.approx(POOL.floor + DECK + standing_height(ROBOTS.get("P2AT")))
        assert depth_in_water(POOL, np.array([*start.at[:2], height])) == DRY_DEPTH


@pytest.mark.parametrize(
    ("place", "depth"),
    [
        ((0.0, 0.0, WATER_LEVEL - 2.0), 2.0),
        ((0.0, 0.0, WATER_LEVEL + 3.0), -3.0),  # over it
        ((29.9, -21.9, WATER_LEVEL - 1.0), 1.0),
        ((30.1, 0.0, WATER_LEVEL - 1.0), DRY_DEPTH),  # beside it
        ((0.0, -22.1, WATER_LEVEL - 1.0), DRY_DEPTH),
        ((0.0, 0.0, POOL.floor - 0.1), DRY_DEPTH),  # below its floor
    ],
)
def test_depth_in_water(place, depth):
    assert depth_in_water(POOL, np.array(place)) == pytest.approx(depth, abs=1e-5)


def test_a_dry_arena_has_no_water_and_of_two_waters_the_one_around_counts():
    assert depth_in_water(ARENAS.get("field"), np.zeros(3)) == DRY_DEPTH
    two = replace(
        POOL, waters=(Water(low=(0, 0, 0), high=(1, 1, 2)), Water(low=(5, 5, 0), high=(6, 6, 4))), floor=1.0
    )
    assert depth_in_water(two, np.array([0.5, 0.5, 1.5])) == pytest.approx(1.5)
    assert depth_in_water(two, np.array([5.5, 5.5, 1.5])) == pytest.approx(3.5)


def test_water_empties_the_battery_of_all_but_submarines():
    """A P2AT on the quay, one in the water, an AirRobot above it, and a Submarine, all told to go."""
    above = StartPose(tag="Air", at=(0.0, 10.0, DEPTH + 1.0 + START_ELEVATION))
    poses = (starts("Quay")[0], starts("Water")[1], above, starts("Water")[0])
    scene = build_scene(replace(POOL, starts=poses), ["P2AT", "P2AT", "AirRobot", "Submarine"])
    batch = Batch(scene, engine="c")
    state = batch.reset()
    orders = (("P2AT", {"Left": 3.0, "Right": 3.0}), ("AirRobot", {"LinearVelocity": 1.0}))
    orders += (("Submarine", {"Propeller": 6.28}),)
    for team, (_, values) in enumerate(orders):
        state = batch.drive(state, team, values)
    first = np.asarray(batch.physics(state).qpos)[0]
    for _ in range(150):
        state = batch.step(state)
    drowned = [np.asarray(team.drowned)[0].tolist() for team in state.worlds.groups]
    assert drowned == [[False, True], [False], [False]]
    gone = np.asarray(batch.physics(state).qpos)[0] - first
    on_quay, in_water, flyer, boat = (gone[root][:3] for team in scene.groups for root in team.root_qposadr)
    assert on_quay[0] > 0.9, "3 rad/s for 3 s on wheels of 0.13 m, less the start"
    assert np.hypot(*in_water[:2]) < 0.05
    assert in_water[2] == pytest.approx(-KEEL, abs=0.02), "it lies on the bottom"
    assert flyer[0] > 2.0
    assert abs(flyer[2]) < 0.01
    assert boat[0] > 0.01


@pytest.mark.thorough
def test_a_submarine_crosses_the_pool_at_its_depth():
    """From rest at its start: 0.9 of its propeller's 0.305 m/s are reached slowly; neither weight nor
    lift change its depth with the stern plane at zero."""
    start = starts("Water")[0]
    boat = ROBOTS.get("Submarine")
    height = start_height(POOL, start, boat)
    rig = Rig("Submarine", arena=POOL, places=((*start.at[:2], 0.0),), height=height)
    rig.tell(Propeller=boat.drive.full_scale["Propeller"])
    log = rig.run(150.0)
    assert log[-1, 0] - log[0, 0] > 30.0
    assert np.abs(log[:, 1] - start.at[1]).max() < 0.3
    assert np.abs(log[:, 2] - height).max() < 0.3
    assert np.diff(log[:, 0]).min() > -1e-6, "it meets nothing"
    assert rig.up[0] > 0.999


def test_who_sits_on_the_quay_is_not_in_the_water():
    for victim in POOL.victims:
        assert depth_in_water(POOL, np.add(victim.at, (0.0, 0.0, POOL.floor))) == DRY_DEPTH
        assert victim.at[2] - rest_height(victim.posture) == pytest.approx(DECK)
    for tag in POOL.tags:
        assert tag.at[2] > DECK


@pytest.mark.parametrize("name", ROOM)
def test_recommended_robots_exist(name):
    arena = ARENAS.get(name)
    assert [ROBOTS.get(robot).name for robot in arena.robots] == list(arena.robots)
    assert arena.about
    assert arena.gps is None


def test_the_submarine_hears_the_floor_below_it():
    batch = Batch(build_scene("pool", ["Submarine"]), engine="c")
    _, readings = batch.observe(batch.reset())
    sonar = batch.scene.groups[0].suite.index("Sonar")
    heard = float(np.asarray(readings[0][sonar].value)[0, 0, 0])
    assert heard == pytest.approx(KEEL + START_GAP, rel=SONAR_NOISE)


def test_the_base_station_stands_where_it_was_put():
    rig = Rig("ComStation")
    start = rig.data.qpos[:3].copy()
    assert start[2] == pytest.approx(rig.robot.origin_height, abs=0.005)
    rig.run(5.0)
    assert np.abs(rig.data.qpos[:3] - start).max() < 0.005
    assert rig.up[0] > 0.9999
    assert rig.robot.drive.full_scale == {}
