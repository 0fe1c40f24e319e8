"""Only worlds that are done begin anew, a few at a time: as if all had been computed, bit for bit."""

import gc
import itertools
import weakref
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import usarmjx
from usarmjx.models.types.shapes import Shape
from usarmjx.sim.batch import select_worlds
from usarmjx.train.envs import env as module
from usarmjx.train.envs.env import restart_batch_size, start_episode
from usarmjx.train.envs.recipe import open_floor
from usarmjx.train.envs.state import Restart

WORLDS, TOGETHER = 5, 2


@pytest.fixture(scope="module", params=["c", pytest.param("jax", marks=pytest.mark.thorough)])
def env(request):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "restart_batch_size", lambda worlds, steps: TOGETHER)
        block = Shape(kind="box", size=(0.5, 0.5, 0.5), at=(9.0, 0.0, 0.5))
        floors = tuple(replace(open_floor(starts=8, seed=seed), shapes=(block,)) for seed in (1, 2))
        return usarmjx.make("drive-to-goal", worlds=WORLDS, engine=request.param, arena=floors, ranges=())


@pytest.fixture(scope="module")
def in_full(env):
    """All worlds are reset and begin an episode, and those that are masked keep it: the oracle."""
    start = jax.vmap(partial(start_episode, env.scene, env.task))
    begin = jax.jit(jax.default_matmul_precision("highest")(start))

    def restart(state, where):
        batch = env.batch.reset_where(state.batch, where)
        pick = partial(select_worlds, where)
        worlds, begun = begin(batch.worlds, env.batch.physics(batch))
        worlds = jax.tree.map(pick, worlds, batch.worlds)
        return state.with_start(batch.replace(worlds=worlds), jax.tree.map(pick, begun, state.episode_start))

    return restart


def bits(state):
    plain = jax.tree.map(
        lambda one: jax.random.key_data(one) if jnp.issubdtype(one.dtype, jax.dtypes.prng_key) else one,
        state.replace(batch=state.batch.replace(arenas=None)),
    )
    return jax.tree.map(np.asarray, plain)


def test_whichever_worlds_are_done_they_begin_as_all_together_would(env, in_full):
    ours = theirs = env.reset(3)
    for mask in itertools.product([False, True], repeat=WORLDS):
        where = np.array(mask)
        ours, theirs = env._restart(ours, where), in_full(theirs, where)
        jax.tree.map(np.testing.assert_array_equal, bits(ours), bits(theirs))
    np.testing.assert_array_equal(ours.batch.worlds.episode, np.full(WORLDS, 2 ** (WORLDS - 1)))


def test_what_sensors_read_is_traced_once_for_all_that_need_it(monkeypatch):
    """The shapes, the beginning of an episode and its steps: the largest part of what they are made of."""
    traced, usual = [], module.observe
    monkeypatch.setattr(module, "observe", lambda *args: traced.append(1) or usual(*args))
    env = usarmjx.make("drive-to-goal", engine="c", ranges=())
    blank = env._blank(jax.random.key(0), 1.0, None)
    worlds, physics = blank.batch.worlds, env.batch.engine.state(env.batch.engine.start())
    now = Restart(worlds=worlds, begun=blank.episode_start, qpos=physics.qpos, left=blank.done)
    env._restart_some.trace(now, None)
    env._evaluate.trace(blank.task_state, worlds, physics, worlds.faults)
    assert len(traced) == 1


def test_a_scene_goes_with_its_environment():
    """Programs that are traced once for a scene do not keep it."""
    env = usarmjx.make("drive-to-goal", engine="c", ranges=())
    env.reset()
    scene = weakref.ref(env.scene)
    del env
    gc.collect()
    assert scene() is None


def test_first_episodes_begin_as_those_of_the_batch(env):
    ours, plain = env.reset(4).batch, env.batch.reset(4)
    np.testing.assert_array_equal(env.batch.physics(ours).qpos, env.batch.physics(plain).qpos)
    np.testing.assert_array_equal(ours.worlds.episode, plain.worlds.episode)
    np.testing.assert_array_equal(ours.worlds.arena_state.starts, plain.worlds.arena_state.starts)
    np.testing.assert_array_equal(*(jax.random.key_data(one.worlds.key) for one in (ours, plain)))


def test_worlds_on_a_device_begin_anew_by_the_program_that_began_them(env):
    """As training has them: a seed that is on the device puts all on it that comes of it."""
    if env.traceable:
        pytest.skip("steps have that program in them")
    device = jax.local_devices()[0]
    env._restart_some.clear_cache()
    state = env.reset(jax.device_put(np.uint32(0), device))
    held = jax.device_put(state.replace(batch=state.batch.replace(physics=None)), device)
    state = held.replace(batch=held.batch.replace(physics=state.batch.physics), done=~held.done)
    env._restart(state, state.done)
    assert env._restart_some._cache_size() == 1


def test_few_are_computed_where_few_are_done(env, monkeypatch):
    if env.traceable:
        pytest.skip("the loop is compiled there")
    calls, usual, state = [], env._restart_some, env.reset()
    monkeypatch.setattr(env, "_restart_some", lambda *args: calls.append(1) or usual(*args))
    for done, expected in ((0, 0), (1, 1), (2, 1), (3, 2), (5, 3)):
        calls.clear()
        env._restart(state, np.arange(WORLDS) < done)
        assert len(calls) == expected


@pytest.mark.parametrize(("worlds", "steps"), [(1, 1), (1, 500), (64, 200), (1024, 300), (4096, 100)])
def test_more_worlds_end_with_a_step_than_fit_in_one_of_a_hundred_at_most(worlds, steps):
    """If all last until the time is up, or a third of them end at half of it."""
    size = restart_batch_size(worlds, steps)
    assert 1 <= size <= worlds
    for share in (1.0, 4 / 3):
        assert stats.binom.sf(size, worlds, min(1.0, share / steps)) <= 0.01
    assert size <= max(4, worlds / 16)


def test_a_step_is_an_advance_and_a_restart_of_the_worlds_that_are_done(env):
    ours = theirs = env.reset(6)
    actions = (jnp.full((WORLDS, 1, 2), 0.5),)
    for late in ([0, 3], [1, 3, 4]):
        length = jnp.where(jnp.isin(jnp.arange(WORLDS), jnp.array(late)), env.episode_steps - 1, ours.length)
        ours, theirs = ours.replace(length=length), theirs.replace(length=length)
        ours, end = env.step(ours, actions), env.advance(theirs, actions)
        assert np.flatnonzero(end.done).tolist() == late
        np.testing.assert_array_equal(end.obs[0], ours.final_obs[0])
        np.testing.assert_array_equal(end.obs[0], end.final_obs[0])
        assert np.array(end.length)[late].tolist() == [env.episode_steps] * len(late)
        theirs = env.restart(end, end.done)
        if env.traceable:  # whose step is compiled as a whole, so that sums may be taken in another order
            np.testing.assert_allclose(theirs.obs[0], ours.obs[0], atol=1e-4)
        else:
            jax.tree.map(np.testing.assert_array_equal, bits(ours), bits(theirs))


def test_any_worlds_restart_in_the_middle_of_an_episode(env, in_full):
    actions, where = (jnp.full((WORLDS, 1, 2), 0.5),), np.array([False, True, False, False, True])
    state = env.step(env.reset(7), actions)
    fresh = env.restart(state, where)
    jax.tree.map(np.testing.assert_array_equal, bits(fresh), bits(in_full(state, where)))
    assert fresh.batch.worlds.episode.tolist() == [0, 1, 0, 0, 1]
    assert fresh.length.tolist() == [1, 0, 1, 1, 0]
    np.testing.assert_array_equal(np.array(fresh.obs[0])[~where], np.array(state.obs[0])[~where])
    np.testing.assert_array_equal(fresh.reward[0], state.reward[0])
    same = env.restart(state, np.zeros(WORLDS, bool))
    jax.tree.map(np.testing.assert_array_equal, bits(same), bits(state))


@pytest.mark.parametrize(
    "where", [np.ones(WORLDS), np.ones(WORLDS + 1, bool), np.bool_(True), np.arange(WORLDS)]
)
def test_a_mask_of_another_kind_is_refused(env, where):
    with pytest.raises(usarmjx.UsageError, match=r"expected bool\[5\], a value per world"):
        env.restart(env.reset(0), where)


def test_a_world_that_is_advanced_beyond_its_end_stays_done(env):
    actions, state = (jnp.zeros((WORLDS, 1, 2)),), env.reset(8)
    state = state.replace(length=jnp.full(WORLDS, env.episode_steps - 1))
    for _ in range(2):
        state = env.advance(state, actions)
        assert state.done.all()
        assert not state.bad.any()
