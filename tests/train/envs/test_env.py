"""Environments: what a step is made of, on both engines that a CPU has."""

from dataclasses import dataclass, field
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import usarmjx
from tests.arenas import FLAT
from tests.listening import COMPILED, compilations
from tests.lone import LoneWorld
from usarmjx.base.errors import UnknownNameError, UsageError
from usarmjx.comms.attenuation import RadioSettings
from usarmjx.comms.mail import MessageSettings, OutgoingMessages
from usarmjx.models.compile.physics import Physics
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.robot import Mount
from usarmjx.sim.actions import Actions, JointAction
from usarmjx.sim.scene import build_scene
from usarmjx.train.envs.env import Env, apply_policy_actions
from usarmjx.train.envs.recipe import GeneratedArenas, open_floor, with_sensors
from usarmjx.train.envs.task import StepResult, Task
from usarmjx.train.make import make_task

LIGHT = {"ranges": (), "physics": Physics(timestep=0.01, substeps=5), "repeat": 2}
"""A P2AT on an empty floor needs no finer steps to be tested with."""
LIMIT = 4
"""Steps of an episode."""


def test_teams_of_any_size_find_start_poses():
    """The issue of speed asks for teams of 128; arenas that are given have what they have."""
    few = GeneratedArenas(count=1, levels=(0.0,), size=(8, 6))
    assert make_task("explore-v1", count=40, arena=few).arenas.starts == 40
    assert make_task("explore-v1", count=4, arena=few).arenas.starts == 24
    floor = make_task("explore-v1", count=128, arena="floor").arenas
    spots = np.array([start.at[:2] for start in floor.starts])
    apart = np.linalg.norm(spots[:, None] - spots, axis=-1) + 9.0 * np.eye(128)
    assert len(spots) == 128
    assert apart.min() >= 1.0
    assert make_task("drive-to-goal", arena="floor").arenas == open_floor()


def goal_env(worlds, engine="c", **overrides):
    settings = {**LIGHT, "episode_steps": LIMIT, "radius": 1e-6, **overrides}
    return usarmjx.make("drive-to-goal", worlds=worlds, engine=engine, **settings)


def actions(env, *values):
    """One action per world for the only group; the last one for all others."""
    (group,) = env.groups
    rows = [values[min(w, len(values) - 1)] for w in range(env.worlds)]
    return (jnp.array(rows, jnp.float32).reshape(env.worlds, len(group.agents), group.action_size),)


@pytest.fixture(scope="module", params=["c", pytest.param("jax", marks=pytest.mark.thorough)])
def env(request):
    return goal_env(3, request.param)


class Halved(Env):
    """An environment whose robots do half of what they are asked."""

    def step(self, state, actions):
        return super().step(state, tuple(group / 2 for group in actions))


def test_a_subclass_steps_its_own_way(env):
    assert Env.step.__doc__
    assert "step" not in vars(env)
    own = Halved(env.task, env.worlds, engine=env.batch.engine.name)
    own._step_program = lambda state, actions: (state, actions)  # what it would compile
    state, (halved,) = own.step("state", actions(env, (1.0, 0.5)))
    assert state == "state"
    assert halved[0, 0].tolist() == [0.5, 0.25]


@pytest.fixture(scope="module")
def begun(env):
    """An environment, its state after a step, and an action."""
    told = actions(env, (1.0, 0.5), (0.3, 0.9), (-1.0, 1.0))
    return env, env.step(env.reset(), told), told


def test_seeds_that_share_their_low_word_begin_other_episodes(env):
    starts = [np.array(env.reset(seed).obs[0]) for seed in (0, 2**32, 1, 2**32 + 1)]
    assert len({start.tobytes() for start in starts}) == 4


def run(env, state, told, steps):
    for _ in range(steps):
        state = env.step(state, told)
    return state


def same(one, other, worlds):
    """Whether two states have the same bits in some worlds; leaves without an axis over worlds apart."""
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        if jnp.issubdtype(a.dtype, jax.dtypes.prng_key):
            a, b = jax.random.key_data(a), jax.random.key_data(b)
        np.testing.assert_array_equal(np.asarray(a)[worlds], np.asarray(b)[worlds])


def worldly(state):
    """Everything of a state that belongs to single worlds."""
    return state.replace(level=None, batch=state.batch.replace(arenas=None))


def spoil(env, state, world):
    """Return the state with a velocity that is not a number."""
    physics = state.batch.physics
    if env.traceable:
        physics = physics.replace(qvel=physics.qvel.at[world, 0].set(jnp.nan))
    else:
        integration = physics.integration.copy()
        integration[world, 1 + env.scene.model.nq] = np.nan
        physics = physics._replace(integration=integration)
    return state.replace(batch=state.batch.replace(physics=physics))


def test_sizes_are_those_that_the_groups_say(begun):
    env, state, _ = begun
    (group,) = env.groups
    assert (group.name, group.agents, group.obs_size, group.action_size) == ("P2AT", ("P2AT0",), 4, 2)
    assert state.obs[0].shape == (3, 1, 4)
    assert state.obs[0].dtype == jnp.float32
    assert state.reward[0].shape == (3, 1)
    assert state.privileged.shape == (3, env.privileged_size)
    assert env.period == pytest.approx(0.1)
    assert env.traceable == (env.batch.engine.name == "jax")
    np.testing.assert_array_equal(state.length, 1)


def test_actions_are_made_finite_and_clamped(env):
    wild = env.step(env.reset(), actions(env, (7.0, np.nan), (np.inf, -9.0), (0.5, -0.5)))
    tame = env.step(env.reset(), actions(env, (1.0, 0.0), (0.0, -1.0), (0.5, -0.5)))
    same(worldly(wild), worldly(tame), slice(None))


def test_tasks_get_no_other_actions():
    """DRIVE clips its numbers itself, messages and joints do not."""
    lone, seen = LoneWorld(build_scene(FLAT, ["P2AT"])), []

    def act(view, memory, actions):
        seen.extend(actions)
        return Actions()

    wild = jnp.array([[7.0, -9.0, np.nan, np.inf, -np.inf, 0.5]])
    apply_policy_actions(
        lone.scene, SimpleNamespace(act=act, decides=False), lone.world, lone.physics, (), (wild,)
    )
    np.testing.assert_array_equal(seen[0], [[1.0, -1.0, 0.0, 0.0, 0.0, 0.5]])


def test_actions_of_another_shape_are_refused(env):
    with pytest.raises(UsageError, match=r"expected \[\(3, 1, 2\)\]"):
        env.step(env.reset(), (jnp.zeros((3, 2)),))


def test_time_out_truncates_keeps_the_last_observation_and_restarts(begun):
    env, state, told = begun
    before = run(env, state, told, LIMIT - 2)
    assert not before.done.any()
    last = env.step(before, told)
    assert last.done.all()
    assert last.truncated.all()
    assert not last.bad.any()
    # One step more towards the same goal than before: less than 0.7 m/s for 0.1 s.
    near = jnp.abs(last.final_obs[0] - before.obs[0]).max()
    assert 0.0 < float(near) < 1.0
    np.testing.assert_array_equal(last.length, 0)
    np.testing.assert_array_equal(last.batch.worlds.episode, np.asarray(state.batch.worlds.episode) + 1)
    assert (jnp.abs(last.obs[0] - last.final_obs[0]).max(-1) > 1e-3).all(), "other goals, other starts"
    np.testing.assert_array_equal(last.final_score, 0.0)
    following = env.step(last, told)
    assert not following.done.any()
    np.testing.assert_array_equal(following.final_obs[0], following.obs[0])


def test_what_is_seen_last_does_not_depend_on_the_restart(begun):
    """The same step with time left is the oracle."""
    env, state, told = begun
    going = env.step(state, told)
    ended = env.step(state.replace(length=jnp.full_like(state.length, LIMIT - 1)), told)
    assert ended.done.all()
    assert not going.done.any()
    np.testing.assert_array_equal(ended.final_obs[0], going.obs[0])
    np.testing.assert_array_equal(ended.final_privileged, going.privileged)
    np.testing.assert_array_equal(ended.reward[0], going.reward[0])


def test_a_restart_leaves_the_other_worlds_bit_exact(begun):
    env, state, told = begun
    usual = env.step(state, told)
    late = env.step(state.replace(length=state.length.at[1].set(LIMIT - 1)), told)
    np.testing.assert_array_equal(late.done, [False, True, False])
    same(worldly(late), worldly(usual), np.array([0, 2]))


def test_a_world_whose_physics_breaks_is_bad_and_restarts_as_one(begun):
    env, state, told = begun
    usual, hurt = env.step(state, told), env.step(spoil(env, state, 1), told)
    for flag, expected in ((hurt.bad, True), (hurt.done, True), (hurt.truncated, False)):
        np.testing.assert_array_equal(flag, [False, expected, False])
    assert float(hurt.reward[0][1, 0]) == 0.0
    assert int(hurt.length[1]) == 0
    assert int(hurt.batch.worlds.step[1]) == 0
    before, after = state.batch.worlds.episode, hurt.batch.worlds.episode
    np.testing.assert_array_equal(after - before, [0, 1, 0], err_msg="episodes that began")
    assert all(bool(jnp.isfinite(seen).all()) for seen in (*hurt.obs, *hurt.final_obs, hurt.privileged))
    # Its memory is that of the new episode: the distance from the new goal.
    robot = env.batch.physics(hurt.batch).qpos[1, env.scene.groups[0].root_qposadr[0, :2]]
    expected = jnp.linalg.norm(hurt.memory.goal[1] - robot)
    np.testing.assert_allclose(hurt.memory.distance[1], expected, rtol=1e-6)
    same(worldly(hurt), worldly(usual), np.array([0, 2]))


def test_full_contact_buffers_are_bad_too(begun):
    """Judged by the count that the batch keeps: the parts that `step` is made of are called as it does."""
    env, state, _ = begun
    worlds, before = state.batch.worlds, state.batch.worlds.faults
    full = worlds.replace(faults=before.replace(overflow=before.overflow.at[2].add(1)))
    _, after, _ = env._evaluate(state.task_state, full, env.batch.physics(state.batch), before)
    np.testing.assert_array_equal(after.bad, [False, False, True])
    np.testing.assert_array_equal(after.done, [False, False, True])


def test_a_tasks_own_nan_is_its_fault_is_counted_and_reaches_no_learner(begun):
    env, state, _ = begun
    worlds, task = state.batch.worlds, state.task_state
    rotten = task.replace(memory=task.memory.replace(goal=task.memory.goal.at[1].set(jnp.nan)))
    after_worlds, after, _ = env._evaluate(rotten, worlds, env.batch.physics(state.batch), worlds.faults)
    np.testing.assert_array_equal(after.bad, [False, True, False])
    np.testing.assert_array_equal(after.done, [False, True, False])
    np.testing.assert_array_equal(after_worlds.faults.task - worlds.faults.task, [0, 1, 0])
    np.testing.assert_array_equal(after_worlds.faults.not_finite, worlds.faults.not_finite)
    seen = (*after.obs, after.privileged, *after.reward, after.score)
    assert all(bool(jnp.isfinite(one).all()) for one in seen)


@pytest.mark.thorough
def test_a_world_is_the_same_alone_as_in_a_batch(begun):
    together, _, told = begun
    if together.traceable:
        pytest.skip("there poses differ by rounding between batch sizes")
    alone = goal_env(1, first=2)
    many, one = together.reset(), alone.reset()
    for _ in range(LIMIT + 2):  # beyond a restart
        many, one = together.step(many, told), alone.step(one, (told[0][2:],))
        np.testing.assert_array_equal(many.obs[0][2], one.obs[0][0])
        np.testing.assert_array_equal(many.reward[0][2], one.reward[0][0])
    assert int(one.batch.worlds.episode[0]) == 1


def test_worlds_that_are_told_their_keys_begin_as_those_of_their_numbers(env):
    key = jax.random.key(env.seed)
    keys = jax.vmap(lambda number: jax.random.fold_in(key, number))(jnp.array([2, 0, 2]))
    usual, told = env.reset(), env.reset_each(keys)
    for a, b in zip(jax.tree.leaves(worldly(told).memory), jax.tree.leaves(usual.memory), strict=True):
        np.testing.assert_array_equal(a, np.asarray(b)[[2, 0, 2]])
    np.testing.assert_array_equal(told.obs[0], np.asarray(usual.obs[0])[[2, 0, 2]])


def test_seeds_give_other_episodes_and_the_same_seed_the_same(env):
    one, again, other = env.reset(4), env.reset(4), env.reset(5)
    same(worldly(one), worldly(again), slice(None))
    assert (one.memory.goal != other.memory.goal).any()


def test_groups_of_worlds_begin_as_those_of_their_seeds_alone(env):
    """Each of three seeds has a world, which is the first one of an environment of that seed."""
    seeds = (4, 5, 4)
    together = env.reset(jnp.stack([jax.random.key(seed) for seed in seeds]))
    for place, seed in enumerate(seeds):
        group, alone = (
            jax.tree.map(lambda leaf, row=row: leaf[row : row + 1], worldly(state).task_state)
            for state, row in ((together, place), (env.reset(seed), 0))
        )
        same(group, alone, slice(None))
        assert together.batch.worlds.number[place] == 0
    with pytest.raises(UsageError, match=r"^3 worlds cannot be divided among 2 seeds$"):
        env.reset(jnp.stack([jax.random.key(seed) for seed in (4, 5)]))


def test_nothing_is_compiled_after_the_first_restart(env):
    told = actions(env, (1.0, 0.5))
    state = run(env, env.reset(), told, LIMIT + 1)
    with compilations(COMPILED) as compiled:
        run(env, state, told, LIMIT + 1)
        assert compiled == []
        jax.jit(lambda x: x + len(compiled))(jnp.ones(7))
    assert compiled, "the listener hears of what is compiled"


def test_a_step_can_be_scanned_where_the_engine_is_traced(begun):
    env, state, told = begun
    if not env.traceable:
        pytest.skip("stepped from Python")
    scanned, _ = jax.eval_shape(
        lambda s: jax.lax.scan(lambda s, _: (env.step(s, told), None), s, None, 2), state
    )
    assert jax.tree.map(jnp.shape, scanned) == jax.tree.map(jnp.shape, state)


def test_levels_choose_among_generated_arenas():
    arena = GeneratedArenas(kind="maze", count=2, levels=(0.0, 1.0), size=(3, 3))
    env = goal_env(4, arena=arena, pose="GroundTruth")
    solids, easy = env.scene.arenas.states.pos, [0, 1, 0, 1]
    state = env.reset(level=0.0)
    np.testing.assert_array_equal(state.batch.worlds.arena_state.pos, solids[easy])
    for level, places in ((0.9, easy), (1.0, range(4)), (0.0, easy)):
        state = env.at_level(state, level)
        np.testing.assert_array_equal(state.batch.arenas.pos, solids[np.array(places)])
        assert float(state.level) == pytest.approx(level)
    assert env._library._cache_size() == 1, "nothing is compiled again"


def test_overrides_and_names_that_do_not_exist_are_refused():
    with pytest.raises(UnknownNameError, match=r"no field lidar, robots; it has: arena, bonus, .*, shuffle"):
        usarmjx.make("drive-to-goal", robots=3, lidar=True)
    with pytest.raises(UnknownNameError, match=r"unknown task 'drive'; known: .*drive-to-goal"):
        usarmjx.make("drive")
    with pytest.raises(UsageError, match="repeat is 0"):
        usarmjx.make("drive-to-goal", repeat=0)
    with pytest.raises(AttributeError, match="no attribute 'mak'"):
        usarmjx.mak  # noqa: B018


@pytest.mark.parametrize(("task", "steps"), [("explore-v1", 4), ("convoy", 2)])
def test_an_action_lasts_as_long_under_longer_control_steps(task, steps):
    usual, coarse = make_task(task), make_task(task, physics="coarse")
    assert coarse.repeat == steps
    lasts = [one.repeat * one.physics_settings.period for one in (usual, coarse)]
    assert lasts[0] == pytest.approx(lasts[1])
    assert make_task(task, physics="coarse", repeat=7).repeat == 7, "unless told otherwise"


def test_control_steps_that_an_action_is_no_multiple_of_are_refused():
    wanted = r"drive-to-goal lasts 0\.2 s, .* control steps of 0\.03 s: set repeat, .*, beside physics"
    with pytest.raises(UsageError, match=wanted):
        make_task("drive-to-goal", physics=Physics(timestep=0.03, substeps=1))


def test_robots_have_only_the_sensors_that_are_asked_for():
    env = usarmjx.make("drive-to-goal", engine="c")
    assert [s.kind for s in env.scene.groups[0].suite.sensors] == ["Sonar", "INS"]
    ring = Mount(kind="Sonar", name="Up", direction=(0.0, 1.57, 0.0))
    (given,) = with_sensors(["P2AT"], ("ins", ring))
    assert [mount.name for mount in given.sensors] == ["INS", "Up"]
    assert with_sensors(["P2AT"], None) == [ROBOTS.get("P2AT")]
    with pytest.raises(
        UnknownNameError, match=r"none of the robots has a sensor gps; they have: GroundTruth"
    ):
        with_sensors(["P2AT"], ("GPS",))


@dataclass(frozen=True, kw_only=True)
class Whisper(Task):
    """Two robots tell each other what they are told, and pan their cameras."""

    sensors: tuple = ("GroundTruth",)
    repeat: int = 1
    shuffle: bool = False
    radio: RadioSettings = field(default_factory=RadioSettings)
    mail: MessageSettings = field(default_factory=lambda: MessageSettings(numbers=1))

    @property
    def robots(self):
        return ("P2AT", "P2AT", "ComStation")

    def action_sizes(self, scene):
        return (1,)

    def start(self, view, key):
        return jnp.zeros(())

    def act(self, view, memory, actions):
        everyone = jnp.ones((3, 3), bool)
        payload = jnp.concatenate([actions[0], jnp.zeros((1, 1))])
        messages = OutgoingMessages(receivers=everyone, payload=payload, size_bytes=jnp.full(3, 4))
        pan = JointAction(group=0, targets={"CameraPanTilt_Link1": 0.1 * actions[0][:, 0]})
        return Actions(joint_actions=(pan,), messages=messages)

    def observe(self, view, memory):
        box = view.mail
        said = jnp.where(box.valid, box.payload[..., 0], 0.0).sum(-1)
        return (jnp.stack([said, box.count, view.links.in_range.sum(-1)], -1)[:2],)

    def evaluate(self, view, memory):
        pan = view.scene.groups[0].plan.joint_index("CameraPanTilt_Link1")
        target = view.world.groups[0].command.target[:, pan]
        return StepResult(memory, (target,), memory > 1, target.sum(), {})


def test_a_task_of_ones_own_sends_messages_and_moves_joints():
    tall = open_floor(starts=3)
    env = Env(Whisper(arena=tall), 2, engine="c")
    assert [group.name for group in env.groups] == ["P2AT"]
    assert env.name == "Whisper"
    told = (jnp.array([[[0.25], [0.5]], [[-1.0], [1.0]]]),)
    state = env.step(env.reset(), told)
    # From the other robot what that was told, from the station nothing; links to both others hold.
    np.testing.assert_allclose(state.obs[0], [[[0.5, 2, 2], [0.25, 2, 2]], [[1.0, 2, 2], [-1.0, 2, 2]]])
    np.testing.assert_allclose(state.reward[0], 0.1 * told[0][..., 0], rtol=1e-6)
    state = env.step(state, (jnp.zeros((2, 2, 1)),))
    np.testing.assert_allclose(state.obs[0][..., :2], [[[0, 2], [0, 2]], [[0, 2], [0, 2]]])
