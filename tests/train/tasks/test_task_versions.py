"""Versions of team tasks: the first stay as they were, the second measure search; advice; ends."""

import hashlib
from dataclasses import fields, replace
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import struct

from tests.train.rooms import begin, room, view_of
from usarmjx.base.errors import UsageError
from usarmjx.sim.world import FaultCounts
from usarmjx.train.baselines.planners import frontier_policy
from usarmjx.train.envs import env
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.state import TaskState
from usarmjx.train.envs.task import StepResult
from usarmjx.train.learning.config import GOAL_TASKS
from usarmjx.train.learning.ppo import advantages
from usarmjx.train.mapping import planning
from usarmjx.train.mapping.maps import WALL
from usarmjx.train.tasks import TASKS
from usarmjx.train.tasks.buildings import NEAR_START, Buildings, thin_victims
from usarmjx.train.tasks.explore import Explore
from usarmjx.train.tasks.victim_search import FENCE_GAIN, FENCE_MARGIN, VictimSearch, fence_of, way_left

LIBRARIES = {"explore-v1": "05befc8fdd74e531", "victim-search-v1": "4c75cb61092e929a"}
"""Digests of one building of each level, before there was a version 2."""


@pytest.mark.parametrize("name", LIBRARIES)
def test_the_buildings_of_version_1_are_what_they_were(name):
    task = TASKS.get(name)
    assert (task.haste, task.advice, getattr(task, "fence", False)) == (1.0, True, False)
    arenas = replace(task.arena, count=1).arenas()
    told = repr([(a.name, a.shapes, a.starts, a.victims, a.extent) for a in arenas])
    told = told.replace(", pitch=0.0, roll=0.0", "")  # of start poses, which had no such angles then
    told = told.replace(", conveyor=None", "")  # nor had solids belts
    assert hashlib.sha256(told.encode()).hexdigest()[:16] == LIBRARIES[name]


@pytest.fixture(scope="module")
def searched():
    """Buildings of the second version of the search."""
    return replace(TASKS.get("victim-search-v2").arena, count=12).arenas()


def test_victims_lie_in_every_part_but_seldom_near_the_start(searched):
    assert len({arena.extent for arena in searched}) == 3
    parts = np.zeros((3, 3), int)
    for arena in searched:
        at = np.array([victim.at[:2] for victim in arena.victims])
        assert len(at) == 6
        assert (np.hypot(*(at - arena.starts[0].at[:2]).T) < NEAR_START).sum() <= 1
        size = np.array([high - low for low, high in arena.extent])
        np.add.at(parts, tuple((3 * at / size).astype(int).T), 1)
    assert parts.sum() == 6 * len(searched)
    assert parts.min() >= 6, parts  # of 216; the ninth with the start has the fewest
    assert parts.max() <= 48, parts


def test_the_whole_team_starts_beside_its_base(searched):
    team = len(TASKS.get("victim-search-v2").robots)
    for arena in searched:
        at = np.array([start.at[:2] for start in arena.starts])
        away = np.hypot(*(at - at[0]).T)
        assert (np.diff(away) >= 0).all()
        assert away[team - 1] < NEAR_START
        assert len(at) == Buildings.starts


def test_of_victims_near_the_start_only_some_stay():
    near, far = [(1.0 + k / 4, 1.0) for k in range(6)], [(5.8, 0.5), (5.8, 1.5), (5.8, 2.5)]
    arena = room([(0.6, 0.9)], [*near, *far])
    for seed in range(8):
        kept = [victim.at[0] for victim in thin_victims(arena, 4, 1, seed).victims]
        assert sorted(kept)[1:] == [5.8] * 3
    drawn = {tuple(v.name for v in thin_victims(arena, 4, 1, seed).victims) for seed in range(8)}
    assert len(drawn) > 2
    assert len(thin_victims(arena, 9, 0, 0).victims) == 3


def test_version_2_asks_for_longer_search_and_has_the_same_team():
    for name in LIBRARIES:
        one, two = TASKS.get(name), TASKS.get(name.replace("-v1", "-v2"))
        assert two.robots == one.robots
        assert two.episode_steps > one.episode_steps
        # And leaves less time for a cell: with more than this the last quarter had 6 to 8 % of the finds.
        cells = np.mean([columns * rows for columns, rows in two.arena.sizes])
        assert two.episode_steps / cells < 0.6 * one.episode_steps / np.prod(one.arena.size)
        other = {"arena", "episode_steps", "haste", "fence", "return_speed", "seek_home"}
        same = {field.name for field in fields(one)} - other
        assert all(getattr(one, name) == getattr(two, name) for name in same)


# The fence of robots that fly


@pytest.fixture(scope="module")
def fenced():
    """Two buildings of different sizes, one robot that flies, and what it sees in the smaller one."""
    library = Buildings(count=2, levels=(0.5,), sizes=((3, 3), (5, 4)), victims=1)
    task = VictimSearch(arena=library, wheeled=(), tracked=(), flying=("AirRobot",), fence=True)
    scene, world, physics = begin(task)
    small = jax.tree.map(lambda rows: jnp.asarray(rows[0]), scene.arenas.states)
    world = world.replace(arena_state=small)

    def view(*pose):
        return view_of(scene, world, physics, [(0.6, 0.6, 0.0), pose])

    return task, view


def test_each_world_knows_the_outline_of_its_own_building(fenced):
    task, view = fenced
    seen = view(1.8, 1.8, 0.0)
    np.testing.assert_allclose(task.note(seen, "extent"), [[0.0, 3.6]] * 2, atol=1e-6)
    large = jax.tree.map(lambda rows: jnp.asarray(rows[1]), seen.scene.arenas.states)
    seen = seen.replace(world=seen.world.replace(arena_state=large))
    np.testing.assert_allclose(task.note(seen, "extent"), [[0.0, 6.0], [0.0, 4.8]], atol=1e-6)


def test_beyond_its_fence_all_is_wall_for_a_robot_that_flies(fenced):
    task, view = fenced
    grid = task.arena_grid(view(1.8, 1.8, 0.0).scene)
    belief = task.first_belief(view(1.8, 1.8, 0.0))
    beyond = ((grid.centres < FENCE_MARGIN) | (grid.centres > 3.6 - FENCE_MARGIN)).any(-1)
    np.testing.assert_array_equal(np.asarray(belief.squares[1]) == WALL, beyond)
    assert not np.asarray(belief.squares[0]).any()  # the base has no fence
    free = replace(task, fence=False).first_belief(view(1.8, 1.8, 0.0))
    assert not np.asarray(free.squares).any()


@pytest.mark.parametrize(
    ("pose", "fence", "speed"),
    [
        ((1.8, 1.8, 0.0), True, 1.2),
        ((3.0, 1.8, 0.0), True, 0.35 * FENCE_GAIN),  # 0.35 m to go
        ((3.0, 1.8, np.pi), True, 1.2),
        ((3.5, 1.8, 0.0), True, 0.0),  # beyond it, and outward
        ((3.5, 1.8, np.pi), True, 1.2),  # and back again
        ((3.5, 1.8, 0.0), False, 1.2),
    ],
)
def test_a_robot_that_flies_brakes_before_its_fence(fenced, pose, fence, speed):
    task, view = fenced
    task, seen = replace(task, fence=fence), view(*pose)
    (number,) = task.agent_groups(seen.scene)
    members = seen.scene.groups[number]
    high = tuple(
        reading.replace(value=reading.value.at[:, 2].set(2.0)) if sensor.kind == "GroundTruth" else reading
        for sensor, reading in zip(members.suite.sensors, seen.readings[number], strict=True)
    )
    seen = seen.replace(readings=tuple(high if g == number else r for g, r in enumerate(seen.readings)))
    told = task.drive_values(seen, None, members, jnp.array([[1.0, 0.0]]))
    np.testing.assert_allclose(told["LinearVelocity"], [speed], atol=1e-5)


def test_the_way_to_a_fence_is_along_the_heading():
    fence = fence_of(jnp.array([[0.0, 10.0], [0.0, 4.0]]))
    at = jnp.array([[2.0, 2.0]] * 4)
    ahead = jnp.array([[1.0, 0.0], [0.0, -1.0], [0.6, 0.8], [-0.8, 0.6]])
    np.testing.assert_allclose(way_left(at, ahead, fence), [7.75, 1.75, 1.75 / 0.8, 1.75 / 0.8], rtol=1e-6)


# Robots that go home

STARTS = ((0.6, 0.9), (0.6, 2.1), (1.8, 0.9))


def test_robots_turn_home_when_the_time_left_is_what_the_way_takes_at_their_speed():
    """From 1.2 m, and with 5 s to spare: 9 s before the end at 0.3 m/s, 7 s before it at 0.6 m/s."""
    task = VictimSearch(arena=room(STARTS), wheeled=("P2AT",) * 2, tracked=(), flying=())
    scene, world, physics = begin(task)
    view = view_of(scene, world, physics, [(*STARTS[number], 0.0) for number in range(3)])
    seen = task.arena_grid(scene).centres[..., 0] < 3.0  # what is beyond is worth a visit
    belief = task.first_belief(view)
    belief = belief.replace(
        evidence=jnp.broadcast_to(jnp.where(seen, -1, 0).astype(jnp.int8), belief.evidence.shape),
        base_contact_time=jnp.full(3, -100.0),
        mark_time=jnp.full(3, -200.0),  # and it has no news
    )
    period = task.repeat * scene.physics.period

    def away(left, speed):
        late = replace(task, episode_steps=round((float(view.time) + left) / period), return_speed=speed)
        goal = late.plan(view, belief).goal
        return np.linalg.norm(goal[2] - belief.pose[0, :2])

    assert away(8.0, 0.3) < planning.HOME_RADIUS < away(8.0, 0.6)
    assert away(6.0, 0.6) < planning.HOME_RADIUS


def test_a_robot_with_news_that_knows_no_way_home_looks_for_one_if_it_is_told_to():
    """Robots 1 and 2 know where they are, and robot 1 what lies a step beyond; the base is apart."""
    task = VictimSearch(arena=room(STARTS), wheeled=("P2AT",) * 2, tracked=(), flying=())
    scene, world, physics = begin(task)
    view = view_of(scene, world, physics, [(0.6, 0.9, 0.0), (4.2, 1.5, 0.0), (1.8, 0.9, 0.0)])
    x = task.arena_grid(scene).centres[..., 0]
    island = (x > 3.0) & (x < 5.2)
    belief = task.first_belief(view)
    belief = belief.replace(
        evidence=jnp.broadcast_to(jnp.where(island, -1, 0).astype(jnp.int8), belief.evidence.shape),
        base_contact_time=jnp.full(3, -100.0),
    )
    lost, seeking = (replace(task, seek_home=on).plan(view, belief) for on in (False, True))
    np.testing.assert_allclose(lost.waypoint[1], belief.pose[1, :2])
    assert seeking.goal[1, 0] < 3.7  # at the edge toward the base, not at the other one, which is as near
    assert seeking.path_length[1] > 1000
    known = belief.replace(evidence=jnp.full_like(belief.evidence, -1))
    np.testing.assert_array_equal(
        *(replace(task, seek_home=on).plan(view, known).goal for on in (False, True))
    )


# What a find pays


def test_a_late_find_pays_less_by_haste_alone():
    task = Explore(episode_steps=4, haste=0.25)
    share = np.array([0.2, 0.2, 0.2, 1.0])
    np.testing.assert_allclose(task.paid(share), [0.2, 0.2, 0.2, 0.2 + 0.8 * (0.75 + 0.25 / 4)])
    np.testing.assert_allclose(replace(task, haste=0.0).paid(share)[-1], 1.0)
    np.testing.assert_allclose(replace(task, haste=1.0).paid(share)[-1], share.mean())
    columns = task.paid(np.stack([share, share], -1))
    np.testing.assert_allclose(columns[:, 0], columns[:, 1])


# The planner's advice


def test_the_baseline_refuses_to_drive_without_advice():
    env = SimpleNamespace(task=Explore(advice=False), name="explore-v1", episode_steps=3)
    with pytest.raises(
        UsageError, match="explore-v1 with advice=false: its baseline drives the way that this"
    ):
        frontier_policy(env)


# Ends and truncations


class Endless(struct.PyTreeNode):
    """Worlds of which nothing is known but that nothing went wrong."""

    faults: FaultCounts


def played(time_limit, steps, monkeypatch):
    """Ends of a task that pays 1 in every step, (steps, 1) each: done, truncated, bad."""
    monkeypatch.setattr(env, "make_view", lambda scene, world, physics: (world, physics))
    no, zero = jnp.zeros((), bool), jnp.zeros(())
    task = SimpleNamespace(
        time_limit=time_limit,
        episode_steps=steps,
        evaluate=lambda view, memory: StepResult(memory, (jnp.ones(1),), no, zero, {}),
        observe=lambda view, memory: (jnp.ones((1, 1)),),
        privileged=lambda view, memory: jnp.zeros(0),
    )
    none, world = jnp.zeros((1, 0)), jnp.zeros(1)
    state = TaskState(
        memory=world,
        obs=(none,),
        privileged=none,
        reward=(world[:, None],),
        done=world > 0,
        truncated=world > 0,
        final_obs=(none,),
        final_privileged=none,
        score=world,
        final_score=world,
        length=jnp.zeros(1, jnp.int32),
        bad=world > 0,
        metrics={},
    )
    faults = FaultCounts(**{one.name: jnp.zeros(1, jnp.int32) for one in fields(FaultCounts)})
    rows = []
    for _ in range(steps):
        _, state, _ = env.evaluate_step(None, task, state, Endless(faults), world, faults)
        rows.append((state.done, state.truncated, state.bad))
    return tuple(jnp.stack(column) for column in zip(*rows, strict=True))


@pytest.mark.parametrize(("time_limit", "after"), [("end", 0.0), ("truncation", 1.0)])
def test_a_value_stands_in_for_what_follows_only_where_something_does(time_limit, after, monkeypatch):
    """n steps of 1 are worth (1 - g^n) / (1 - g), and g^n V more if the episode was only cut off."""
    steps, discount, value = 5, 0.9, 7.0
    ends = played(time_limit, steps, monkeypatch)
    assert ends[0][:, 0].tolist() == [False] * (steps - 1) + [True]
    none = jnp.zeros((steps, 1))
    found = advantages(none + 1, none, none + value, jnp.array([99.0]), ends, discount, 1.0)
    closed = (1 - discount**steps) / (1 - discount) + after * discount**steps * value
    np.testing.assert_allclose(found[0, 0], closed, rtol=1e-6)


def test_tasks_over_a_number_of_steps_say_so():
    ends = {name for name, task in TASKS if task.time_limit == "end"}
    versions = {name.replace("-v1", version) for name in LIBRARIES for version in ("-v1", "-v2")}
    assert ends == {*versions, *GOAL_TASKS, "relay-chain-v1", "soccer-v1", "soccer-v2"}
    with pytest.raises(UsageError, match="time_limit is 'never', expected one of end, truncation"):
        Env(replace(TASKS.get("wander"), time_limit="never"), 1)
