"""Robots that join and leave a running world: nobody else notices, and what fails leaves nothing behind."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from tests.arenas import FLAT
from tests.handy import GRABBER, LIFT, TAGGER
from usarmjx.base.backend import numpy_backend
from usarmjx.base.clock import Clock
from usarmjx.base.errors import SpecError, UsageError
from usarmjx.engines.c.placement import SEARCH_RADIUS
from usarmjx.models.arenas import ARENAS
from usarmjx.models.compile import compose
from usarmjx.models.effecters import effecters_of
from usarmjx.models.robots import ROBOTS
from usarmjx.sim import single_world
from usarmjx.sim.control import CommandUpdate, update_command
from usarmjx.sim.ray_geometry import moved_geom_poses
from usarmjx.sim.scene import Scene, build_scene
from usarmjx.sim.single_world import SingleWorld

UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
P2AT, P2DX = ROBOTS.get("P2AT"), ROBOTS.get("P2DX")
CREW = (P2DX, TAGGER, P2DX, ROBOTS.get("AirRobot"))
"""Two of a class, one with effecters, one without wheels."""
SECOND = 50
"""Control steps."""
STATE = ("qpos", "qvel", "act", "ctrl", "qacc_warmstart", "xfrc_applied")
"""All of C MuJoCo's state that a step depends on, besides what doors and loose objects share with robots."""


def make_world(seats=6, arena=FLAT):
    return SingleWorld(build_scene(arena, ()), seed=3, seats=seats)


def join(world, robot, x=0.0, y=0.0, z=0.3):
    return world.add(robot, robot.name, [((x, y, z), UPRIGHT)])


def tell(world, slot, **drive):
    group, _ = world.scene.group_of(slot)
    with numpy_backend():
        plan, told = world.scene.groups[group].plan, CommandUpdate(drive=drive, light=True)
        world.edit(slot, command=update_command(plan, world.state_of(slot).command, told))


def run(world, steps):
    for step in range(steps):
        world.step()
        if step % 10 == 9:
            world.observe(world.roster)


def busy_world():
    """A world in which all have done something for a second: driven, sensed, and dropped a tag."""
    world = make_world()
    for place, robot in enumerate(CREW):
        join(world, robot, 0.0, 2.0 * place)
    tell(world, 0, Left=3.0, Right=1.0)
    tell(world, 3, AltitudeVelocity=0.5)
    gun = effecters_of(TAGGER)[0]
    assert world.operate(1, 0, gun.opcode("Release"), 0.0).done
    run(world, SECOND)
    return world


def own(world, slot):
    """All that is a robot's: what MuJoCo has of it, by name, and its part of its group's state."""
    group, member = world.scene.group_of(slot)
    index, data = world.scene.groups[group].indices[member], world.engine.data
    free, joints = np.arange(7) + index.root_qposadr, list(index.qposadr)
    of_dof = [*(np.arange(6) + index.root_dofadr), *index.dofadr]
    physics = {
        "qpos": data.qpos[[*free, *joints]],
        "qvel": data.qvel[of_dof],
        "warmstart": data.qacc_warmstart[of_dof],
        "act": data.act[list(index.actadr)],
        "ctrl": data.ctrl[[*index.actuator_ids, *index.hold_actuator_ids]],
        "home": world._homes[slot],
    }
    return jax.tree.map(np.array, (physics, world.state_of(slot)))


def all_of(world):
    """All that there is in a world, in the order of its model."""
    data, model = world.engine.data, world.engine.model
    names = [model.body(i).name for i in range(model.nbody)]
    arrays = {name: getattr(data, name).copy() for name in STATE}
    return names, world.roster, (arrays, float(data.time), jax.tree.map(np.array, world.world))


def assert_same_bits(one, other):
    for (path, mine), theirs in zip(jax.tree.leaves_with_path(one), jax.tree.leaves(other), strict=True):
        mine, theirs = np.asarray(mine), np.asarray(theirs)
        assert mine.dtype == theirs.dtype, jax.tree_util.keystr(path)
        assert mine.tobytes() == theirs.tobytes(), jax.tree_util.keystr(path)


def assert_unchanged(world, before):
    now = all_of(world)
    assert now[:2] == before[:2]
    assert_same_bits(now[2], before[2])


# Who joins and leaves


def test_who_joins_changes_no_bit_of_the_others():
    world = busy_world()
    before = {slot: own(world, slot) for slot in world.roster}
    shared = jax.tree.map(np.array, world.world.replace(groups=()))
    for robot, x in ((P2AT, 4.0), (P2DX, -4.0)):  # of a class of its own, and of one that is there
        join(world, robot, x, 4.0)
        for slot, was in before.items():
            assert_same_bits(own(world, slot), was)
        assert_same_bits(world.world.replace(groups=()), shared)
    assert world.roster.keys() == {0, 1, 2, 3, 4, 5}
    assert world.engine.data.qvel.any(), "they move"


@pytest.mark.parametrize("slot", range(4))
def test_who_leaves_changes_no_bit_of_the_others(slot):
    world = busy_world()
    before = {other: own(world, other) for other in world.roster if other != slot}
    shared = jax.tree.map(np.array, world.world.replace(groups=()))
    world.remove(slot)
    assert world.roster.keys() == before.keys()
    for other, was in before.items():
        assert_same_bits(own(world, other), was)
    assert_same_bits(world.world.replace(groups=()), shared)
    with pytest.raises(SpecError, match=f"slot {slot} is not in the roster"):
        world.state_of(slot)
    run(world, 11)


def test_after_all_have_left_the_world_is_as_new():
    world, empty = busy_world(), make_world()
    for slot in (2, 0, 3, 1):
        world.remove(slot)
    assert world.roster == {}
    assert all_of(world)[0] == all_of(empty)[0]
    for name in STATE:
        assert getattr(world.engine.data, name).shape == getattr(empty.engine.data, name).shape
    run(world, 11)
    assert join(world, P2AT) == 0


def test_a_seat_is_taken_again_by_a_robot_that_knows_nothing_of_the_one_before():
    world = busy_world()
    there = own(world, 0)
    world.remove(0)
    assert join(world, P2DX) == 0, "the first free seat"
    physics, state = own(world, 0)
    assert not physics["qvel"].any()
    assert not physics["warmstart"].any()
    assert not physics["ctrl"].any()
    assert not state.command.light
    assert not state.command.setpoint.any()
    assert there[1].command.setpoint.any()
    assert state.battery_start == world.steps
    np.testing.assert_allclose(physics["qpos"][:3], (0.0, 0.0, 0.3))


def test_seats_are_counted():
    world = make_world(seats=2)
    assert [join(world, P2DX, 0.0, 2.0 * k) for k in range(2)] == [0, 1]
    before = all_of(world)
    with pytest.raises(UsageError, match="no seat left for another robot: 2 are taken"):
        join(world, P2DX, 0.0, 4.0)
    assert_unchanged(world, before)
    world.remove(0)
    assert join(world, P2AT, 0.0, 4.0) == 0


def test_sixty_four_seats():
    """ComStations, which have the fewest parts, but for the first and the last."""
    world, field = make_world(seats=64, arena=ARENAS.get("field")), ROBOTS.get("ComStation")
    for seat in range(64):
        robot = P2AT if seat in (0, 63) else field
        assert join(world, robot, 2.0 * (seat % 8), 2.0 * (seat // 8)) == seat
    run(world, 10)
    assert world.world.faults.overflow == 0
    (first, _), (last, _) = own(world, 0), own(world, 63)
    np.testing.assert_allclose(
        (last["qpos"] - first["qpos"])[:2], (14.0, 14.0), atol=1e-3
    )  # while they settle
    assert len(world.observe(range(64))) == 64
    with pytest.raises(UsageError, match="64 are taken"):
        join(world, P2AT, -4.0, -4.0)


def test_a_robot_stands_at_the_first_free_pose_else_near_the_first():
    world = make_world()
    join(world, P2DX)
    place = own(world, 0)[0]["qpos"][:3]
    poses = [(tuple(place), UPRIGHT), ((0.0, 2.0, 0.3), UPRIGHT)]
    assert own(world, world.add(P2DX, "B", poses))[0]["qpos"][:3].tolist() == [0.0, 2.0, 0.3]
    third = own(world, world.add(P2DX, "C", poses))[0]["qpos"][:3]
    assert 0.1 < np.linalg.norm(third - place) <= SEARCH_RADIUS


# What fails


def fail_once(monkeypatch, where, name, after=0):
    """Let a function fail at one of its calls, and work otherwise."""
    real, calls = getattr(where, name), []

    def maybe(*args, **kwargs):
        calls.append(name)
        if len(calls) == after + 1:
            raise RuntimeError(f"{name} fails")
        return real(*args, **kwargs)

    monkeypatch.setattr(where, name, maybe)


STAGES = {
    "the first part": (compose, "_add_part", 0),
    "a part": (compose, "_add_part", 3),
    "the layout": (single_world, "robot_groups", 0),
    "a free pose": (single_world, "free_pose", 0),
    "the sensors' start": (single_world, "start_sensors", 0),
    "the new scene": (Scene, "with_robots", 1),
    "the new groups": (single_world, "robot_groups", 1),
}


@pytest.mark.every_run("the first part", "a free pose", "the new scene")
@pytest.mark.parametrize("stage", STAGES)
def test_whatever_fails_leaves_nothing_behind(monkeypatch, stage):
    world, twin = busy_world(), busy_world()
    before = all_of(world)
    with monkeypatch.context() as patch:
        fail_once(patch, *STAGES[stage])
        with pytest.raises(RuntimeError, match="fails"):
            join(world, P2AT, 4.0)
    assert_unchanged(world, before)
    for each in (world, twin):
        assert join(each, P2AT, 4.0) == 4, "the next one"
        run(each, 11)
    assert_unchanged(world, all_of(twin))


(SLIDE,) = LIFT.links
AIR = replace(SLIDE, shapes=(replace(SLIDE.shapes[0], mass=0.0),), motor=replace(SLIDE.motor, armature=0.0))
WEIGHTLESS = replace(GRABBER, name="Weightless", effecters=(), packages=(replace(LIFT, links=(AIR,)),))
"""A robot with a link of no mass, which MuJoCo does not compile."""


@pytest.mark.parametrize(
    ("robot", "why"),
    [
        (WEIGHTLESS, "a Weightless cannot be built: .*mass and inertia"),
        (ROBOTS.get("Hummer"), "no room for a Hummer within 1 m of 4.50,1.90"),
    ],
    ids=lambda value: getattr(value, "name", ""),
)
def test_a_robot_that_cannot_be_leaves_nothing_behind(robot, why):
    yellow = ARENAS.get("yellow")
    world = make_world(arena=yellow)
    join(world, P2AT, *yellow.starts[1].at[:2], yellow.floor + 0.3)
    run(world, 20)
    before = all_of(world)
    with pytest.raises(UsageError, match=why):
        join(world, robot, 4.5, 1.9, yellow.floor + 1.0)
    assert_unchanged(world, before)
    assert join(world, P2DX, *yellow.starts[3].at[:2], yellow.floor + 0.3) == 1


def test_scenes_of_some_robots_are_kept_up_to_a_bound():
    """Seven robots have 127 sets that may report together."""
    world = make_world(seats=7)
    slots = [join(world, P2DX, 0.0, 1.5 * place) for place in range(7)]
    sets = [{slot for slot in slots if mask >> slot & 1} for mask in range(1, 128)]
    for some in sets:
        assert world.observe(some).keys() == some
        assert len(world._subscenes) <= single_world.KEPT_SUBSCENES
    assert world.observe(sets[0]).keys() == sets[0]


def test_what_moves_by_itself_is_where_its_time_has_it():
    """To the bit, in every control step, and when a robot joins; worked out one moment at a time here."""
    world, places = make_world(arena="yellow"), []
    ids = [world.engine.model.geom(name).id for name in world.scene.moved_geoms.names]
    for step in range(2 * single_world.LOOKAHEAD_STEPS + 3):
        if step == single_world.LOOKAHEAD_STEPS // 2:
            join(world, P2DX, 4.5, 1.9, world.scene.arena.floor + 0.3)
        with numpy_backend():
            moved = moved_geom_poses(
                world.scene, None, Clock(step=np.int32(step), period=world.scene.physics.period)
            )
        world.step()
        places.append(world.engine.model.geom_pos[ids].copy())
        np.testing.assert_array_equal(places[-1], moved.pos)
        np.testing.assert_array_equal(world.engine.model.geom_quat[ids], moved.quat)
    assert (np.abs(np.diff(places, axis=0)).max((1, 2)) > 0).all(), "something moves"
