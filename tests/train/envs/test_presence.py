"""Agents that drop out, leave and join; teams that differ between worlds; who sees, does and learns what."""

from dataclasses import dataclass
from types import SimpleNamespace
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.figure import Figure
from numpy.testing import assert_allclose, assert_array_equal

from usarmjx.plots.play import _draw, positions_of
from usarmjx.sim.reset import start_qpos
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.presence import Presence, in_use
from usarmjx.train.envs.task import StepResult, Task

WORLDS = 1
DIES, JOINS, STEPS = 3, 2, 5
"""Actions after which robot 0 drops out, robot 1 joins and the time is up."""
FALL = 0.003
"""Fall of a robot in the control step after it was parked [m]: 9.81 x 0.02^2 / 2 and half as much more."""


@dataclass(frozen=True, kw_only=True)
class Shifts(Task):
    """Robot 0 drops out and stays, robot 1 comes later, robot 2 leaves with it, robot 3 is always there."""

    about: ClassVar[str] = "Robots come and go."
    sensors: tuple = ("GroundTruth",)
    episode_steps: int = STEPS
    repeat: int = 2
    shuffle: bool = False

    @property
    def robots(self):
        return ("P2DX",) * 4

    def team(self, scene, key):
        return jnp.array([True, False, True, True])

    def presence(self, view, memory):
        here = in_use(view.scene, view.world)
        alive = jnp.array([memory < DIES, True, True, True])
        present = here.at[1].set(memory >= JOINS).at[2].set(memory < JOINS)
        return Presence(alive=alive, present=present)

    def start(self, view, key):
        return jnp.zeros((), jnp.int32)

    def observe(self, view, memory):
        return (jnp.concatenate([view.robots(0).pos, jnp.ones((4, 1))], -1),)

    def evaluate(self, view, memory):
        no = jnp.zeros((), bool)
        return StepResult(memory + 1, (jnp.arange(1.0, 5.0),), no, jnp.zeros(()), {})


ALIVE = np.array(
    [[1, 0, 1, 1], [1, 0, 1, 1], [1, 0, 0, 1], [0, 1, 0, 1], [0, 1, 0, 1]],
    bool,
)
"""Which agents are alive before each action: one that joins is so an action later, when it has sensed."""


@pytest.fixture(scope="module", params=["planar", pytest.param("c", marks=pytest.mark.thorough)])
def played(request):
    """An environment, and its states from the start to beyond the end of the first episode."""
    env = Env(Shifts(), WORLDS, engine=request.param)
    states = [env.reset(0)]
    for _ in range(STEPS + 1):
        states.append(env.step(states[-1], (jnp.ones((WORLDS, 4, 2)),)))
    return env, states


def test_agents_are_alive_as_the_task_says_and_others_see_and_get_nothing(played):
    _, states = played
    for step in range(STEPS):
        before, after = states[step], states[step + 1]
        assert_array_equal(before.alive[0], np.tile(ALIVE[step], (WORLDS, 1)), err_msg=str(step))
        assert_array_equal(np.asarray(before.obs[0])[..., 3] == 1.0, before.alive[0])
        assert_array_equal(np.asarray(before.obs[0])[~np.asarray(before.alive[0])], 0.0)
        assert_array_equal(
            after.reward[0], np.where(ALIVE[step], np.arange(1.0, 5.0), 0.0)[None].repeat(WORLDS, 0)
        )
        assert_array_equal(np.asarray(before.privileged)[:, -4:], before.alive[0])
        assert_allclose(after.metrics["alive"], np.asarray(after.final_alive[0]).mean(-1))


def test_an_episode_ends_for_the_world_and_the_next_one_begins_with_its_team(played):
    _, states = played
    end = states[STEPS]
    assert np.asarray(end.done).all()
    assert np.asarray(end.truncated).all()
    assert_array_equal(end.alive[0], np.tile(ALIVE[0], (WORLDS, 1)))
    assert_array_equal(end.final_alive[0], np.tile([False, True, False, True], (WORLDS, 1)))
    assert not np.asarray(end.bad).any()
    assert_array_equal(states[STEPS + 1].alive[0], np.tile(ALIVE[1], (WORLDS, 1)))


def test_robots_that_join_start_at_their_pose_and_others_stay_or_leave(played):
    env, states = played
    group = env.scene.groups[0]

    def place(state, robot):
        return np.asarray(env.batch.physics(state.batch).qpos)[:, group.root_qposadr[robot, :3]]

    waiting = env.scene.model.qpos0[group.root_qposadr[:, :3]]
    home = np.asarray(start_qpos(env.scene, jax.tree.map(lambda x: x[0], states[0].batch.worlds), False))
    assert_allclose(place(states[0], 1), waiting[[1]], atol=1e-5)
    joined = place(states[JOINS], 1)
    assert_allclose(joined, np.tile(home[group.root_qposadr[1, :3]], (WORLDS, 1)), atol=1e-5)
    assert (place(states[JOINS + 2], 1)[:, 0] > joined[:, 0] + 1e-3).all(), "it drives"
    assert_allclose(place(states[JOINS + 1], 2), waiting[[2]], atol=FALL)


def test_pictures_leave_out_robots_that_are_not_in_the_world(played):
    env, states = played
    for step, absent in ((0, 1), (JOINS + 1, 2)):
        poses, _ = positions_of(env, states[step])
        assert_array_equal(np.isnan(poses).all(-1), np.arange(4) == absent)
    poses = np.stack([positions_of(env, state)[0] for state in states[:STEPS]])
    shown = SimpleNamespace(names="abcd", poses=poses, loose=np.zeros((STEPS, 0, 2)), goal=None)
    drawn = _draw(Figure().add_subplot(), shown, STEPS - 1)
    assert len(drawn) == 1 + 4 + 3, "what lies loose, ways of all robots, and those that are there"


def test_pettingzoo_lists_those_that_are_alive(played):
    """Its own checker holds the rules of a changing `agents`."""
    pettingzoo = pytest.importorskip("pettingzoo.test")
    from usarmjx.train.adapters import ParallelWorld

    env, _ = played
    if env.batch.engine.traceable:
        pytest.skip("one engine shows it")
    world = ParallelWorld(env)
    pettingzoo.parallel_api_test(world, num_cycles=2 * STEPS)
    names, _ = world.possible_agents, world.reset(seed=0)
    assert world.agents == [names[0], names[2], names[3]]
    seen = []
    for _ in range(STEPS):
        acting = list(world.agents)
        obs, rewards, ended, late, infos = world.step({name: np.ones(2, np.float32) for name in acting})
        assert {*obs} == {*rewards} == {*ended} == {*late} == {*infos} == {*acting, *world.agents}
        seen.append(([*map(ended.get, acting)], list(world.agents)))
    assert seen[1] == ([False, True, False], [names[0], names[3]]), "robot 2 has left: an end of its own"
    assert seen[2] == ([True, False], [names[1], names[3]]), "robot 0 drops out, robot 1 is there"
    assert seen[4] == ([False, False], []), "the time is up: no end"
    assert not world.agents


@pytest.mark.parametrize("autoreset", ["same_step", "next_step"])
def test_gymnasium_vectors_say_which_agents_are_alive(played, autoreset):
    pytest.importorskip("gymnasium")
    from usarmjx.train.adapters import VectorWorlds

    env, _ = played
    if env.batch.engine.traceable:
        pytest.skip("one engine shows it")
    vector = VectorWorlds(env, seed=0, autoreset=autoreset)
    actions = np.ones(vector.action_space.shape, np.float32)
    shown = [vector.reset(seed=0)[1]["alive_agents"]]
    shown += [vector.step(actions)[4]["alive_agents"] for _ in range(STEPS)]
    last = ALIVE[0] if autoreset == "same_step" else [False, True, False, True]
    assert_array_equal(np.concatenate(shown), [*ALIVE, last])


def test_brax_and_jaxmarl_say_which_agents_are_alive(played):
    pytest.importorskip("jaxmarl")
    from usarmjx.train.adapters import BatchedRobots, MultiAgentWorld

    env, states = played
    if not env.batch.engine.traceable:
        pytest.skip("one engine shows it")
    for step in range(STEPS):
        assert_array_equal(BatchedRobots(env)._state(states[step]).info["alive"], ALIVE[step])
    world = MultiAgentWorld(env)
    available = world.get_avail_actions(states[3])
    assert_array_equal([available[name] for name in world.agents], np.repeat(ALIVE[3][:, None], 2, 1))


def test_tasks_without_it_have_no_masks():
    assert Task.team(None, None, None) is None
    assert Task.presence(None, None, None) is None
