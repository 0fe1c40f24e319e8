"""Environments under other libraries' interfaces: their own checkers, and the same numbers as without."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.train.toys import LineToy
from usarmjx.base.errors import UsageError

FLOAT = 1e-5  # sums of a few numbers of size 1 in single precision, in another order


# ---- PettingZoo


@pytest.fixture
def parallel():
    pytest.importorskip("pettingzoo", reason="needs the extra rl")
    from usarmjx.train.adapters.pettingzoo import ParallelWorld

    return ParallelWorld


def test_pettingzoo_own_checks_pass_without_a_warning(parallel):
    from pettingzoo.test import parallel_api_test, parallel_seed_test

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        parallel_api_test(parallel(LineToy()), num_cycles=50)
        parallel_seed_test(lambda: parallel(LineToy()), num_cycles=50)


@pytest.mark.parametrize("traceable", [True, False])
def test_a_pettingzoo_episode_ends_with_its_end_and_goes_on_with_the_next(parallel, traceable):
    world = parallel(LineToy(traceable=traceable))
    obs, _ = world.reset(seed=7)
    np.testing.assert_allclose([obs["A0"][0], obs["A1"][0]], [1 / 8, 1 + 1 / 8])
    still = {"A0": np.zeros(2), "A1": np.zeros(2), "B0": np.zeros(1)}
    for _ in range(6):
        obs, reward, terminated, truncated, info = world.step(still)
    assert all(truncated.values())
    assert not any(terminated.values())
    assert world.agents == []
    np.testing.assert_allclose(obs["A0"], [1 / 8, 6.0])  # the end, not the next start
    np.testing.assert_allclose(world.state(), [1 / 8])
    assert reward["A1"] == pytest.approx(1 + 1 / 8)
    assert info["A0"] == {"way": pytest.approx(1 / 8), "score": pytest.approx(6 / 8), "bad": False}
    with pytest.raises(UsageError, match="over; call reset"):
        world.step(still)
    obs, _ = world.reset()
    np.testing.assert_allclose(obs["A0"], [1 / 8 + 1 / 16, 0.0])  # the second episode's start
    assert world.agents == ["A0", "A1", "B0"]


def test_pettingzoo_says_which_action_is_wrong(parallel):
    world = parallel(LineToy())
    with pytest.raises(UsageError, match="call reset first"):
        world.step({})
    world.reset()
    with pytest.raises(UsageError, match="missing or unknown: A1, C"):
        world.step({"A0": np.zeros(2), "B0": np.zeros(1), "C": np.zeros(1)})
    with pytest.raises(UsageError, match=r"action of A1: shape \(3,\), expected \(2,\)"):
        world.step({"A0": np.zeros(2), "A1": np.zeros(3), "B0": np.zeros(1)})
    with pytest.raises(UsageError, match="worlds=1, not 2"):
        parallel(LineToy(worlds=2))


# ---- Gymnasium


@pytest.fixture
def vector():
    pytest.importorskip("gymnasium", reason="needs the extra rl")
    from usarmjx.train.adapters.gymnasium import VectorWorlds

    return VectorWorlds


def single(vector, number=0):
    """The first agent of a vector environment as a Gymnasium environment: what is checked of one."""
    import gymnasium

    class First(gymnasium.Env):
        def __init__(self):
            self.vector = vector(LineToy(worlds=number + 1, robots=1, mixed=False))
            self.observation_space = self.vector.single_observation_space
            self.action_space = self.vector.single_action_space

        def reset(self, *, seed=None, options=None):
            super().reset(seed=seed)
            obs, _ = self.vector.reset(seed=seed, options=options)
            return obs[number], {}

        def step(self, action):
            actions = np.zeros((number + 1, *self.action_space.shape), np.float32)
            actions[number] = action
            obs, reward, ended, late, info = self.vector.step(actions)
            if ended[number] or late[number]:
                return info["final_obs"][number], reward[number], bool(ended[number]), bool(late[number]), {}
            return obs[number], reward[number], False, False, {}

    return First()


@pytest.mark.filterwarnings("ignore:.*A Box observation space")  # no bounds: they are any numbers
def test_gymnasium_own_checks_pass(vector):
    from gymnasium.utils import env_checker, passive_env_checker

    many = vector(LineToy(worlds=3), seed=5)
    for check in (
        env_checker.check_seed_deprecation,
        env_checker.check_reset_return_type,
        env_checker.check_reset_seed_determinism,
        env_checker.check_reset_options,
        passive_env_checker.env_reset_passive_checker,
    ):
        check(many)
    for space in (many.single_observation_space, many.observation_space):
        passive_env_checker.check_space(
            space, "observation", passive_env_checker._check_box_observation_space
        )
    for space in (many.single_action_space, many.action_space):
        passive_env_checker.check_space(space, "action", passive_env_checker._check_box_action_space)
    env_checker.check_env(single(vector), skip_render_check=True)


def test_gymnasium_hands_out_new_arrays(vector):
    from gymnasium.utils.passive_env_checker import data_shares_objects

    worlds = vector(LineToy(worlds=2, mixed=False))
    seen = [worlds.reset(seed=0)]
    for _ in range(7):  # past the end of an episode
        obs, reward, _, _, info = worlds.step(np.zeros((2, 4), np.float32))
        obs += 0.0  # writable
        reward += 0.0
        seen.append((obs, info))
    for i, (obs, info) in enumerate(seen):
        for other, told in seen[:i]:
            assert not data_shares_objects(obs, other)
            assert not data_shares_objects(info, told)


def test_gymnasium_vector_is_as_gymnasium_makes_one_of_single_environments(vector):
    """Oracle: SyncVectorEnv in the declared autoreset mode over an environment of its own."""
    from gymnasium.vector import AutoresetMode, SyncVectorEnv

    from tests.train.adapters.line import Line

    ours = vector(LineToy(worlds=3, robots=1, mixed=False))
    theirs = SyncVectorEnv([lambda n=n: Line(n) for n in range(3)], autoreset_mode=AutoresetMode.SAME_STEP)
    assert ours.metadata["autoreset_mode"] == theirs.metadata["autoreset_mode"]
    np.testing.assert_allclose(ours.reset(seed=0)[0], theirs.reset(seed=0)[0])
    generator, ends = np.random.default_rng(1), 0
    for _ in range(40):
        actions = generator.uniform(-0.5, 1.0, (3, 2)).astype(np.float32)
        mine, other = ours.step(actions), theirs.step(actions)
        for a, b in zip(mine[:4], other[:4], strict=True):
            np.testing.assert_allclose(a, b, atol=FLOAT)
            assert a.dtype == b.dtype
        assert ("final_obs" in mine[4]) == ("final_obs" in other[4])
        if "final_obs" in mine[4]:
            ends += 1
            assert mine[4]["_final_obs"].tolist() == mine[4]["_final_info"].tolist()
            for key in ("_final_obs", "_final_info"):
                np.testing.assert_array_equal(mine[4][key], other[4][key])
            for i in np.flatnonzero(other[4]["_final_obs"]):
                np.testing.assert_allclose(mine[4]["final_obs"][i], other[4]["final_obs"][i], atol=FLOAT)
                for key in ("way", "score"):
                    told, asked = (info["final_info"][key][i] for info in (mine[4], other[4]))
                    assert told == pytest.approx(asked, abs=FLOAT)
            assert [row is None for row in mine[4]["final_obs"]] == [
                row is None for row in other[4]["final_obs"]
            ]
    assert ends > 5


def test_gymnasium_wrappers_count_episodes(vector):
    from gymnasium.wrappers.vector import RecordEpisodeStatistics

    worlds = RecordEpisodeStatistics(vector(LineToy(worlds=2, robots=1, mixed=False)))
    worlds.reset(seed=0)
    for _ in range(6):
        *_, info = worlds.step(np.zeros((2, 2), np.float32))
    np.testing.assert_array_equal(info["_episode"], [True, True])
    np.testing.assert_array_equal(info["episode"]["l"], [6, 6])
    np.testing.assert_allclose(info["episode"]["r"], [6 / 8, 12 / 8], atol=FLOAT)


def test_gymnasium_agents_are_worlds_or_robots(vector):
    joined, each = vector(LineToy(worlds=2)), vector(LineToy(worlds=2, mixed=False), robots="each")
    assert (joined.num_envs, joined.observation_space.shape, joined.action_space.shape) == (2, (2, 6), (2, 5))
    assert (each.num_envs, each.observation_space.shape, each.action_space.shape) == (4, (4, 2), (4, 2))
    actions = np.array([[1.0, 0, 2, 0, 3], [4, 0, 5, 0, 6]], np.float32)  # A0, A1, B0 of both worlds
    joined.reset(seed=0)
    obs, reward, *_ = joined.step(actions)
    start = np.array([[0, 1, 0], [1 / 8, 1 + 1 / 8, 1 / 8]]) + 1 / 8
    x = start + 0.1 * np.array([[1, 2, 3], [4, 5, 6]])
    np.testing.assert_allclose(obs[:, ::2], x, atol=FLOAT)
    np.testing.assert_allclose(reward, x.mean(1), atol=FLOAT)
    each.reset(seed=0)
    obs, reward, *_ = each.step(actions[:, :4].reshape(4, 2))
    np.testing.assert_allclose(obs[:, 0], x[:, :2].ravel(), atol=FLOAT)
    np.testing.assert_allclose(reward, x[:, :2].ravel(), atol=FLOAT)


def test_gymnasium_says_what_is_wrong(vector):
    worlds = vector(LineToy(worlds=2))
    with pytest.raises(UsageError, match="call reset first"):
        worlds.step(np.zeros((2, 5)))
    with pytest.raises(UsageError, match="reset_mask"):
        worlds.reset(options={"reset_mask": np.ones(2, bool)})
    worlds.reset()
    with pytest.raises(UsageError, match=r"shape \(5,\), expected \(2, 5\)"):
        worlds.step(np.zeros(5))
    with pytest.raises(UsageError, match="robots of one class, but toy has A, B"):
        vector(LineToy(), robots="each")
    with pytest.raises(UsageError, match="'joined' and 'each'"):
        vector(LineToy(), robots="all")


# ---- JaxMARL


@pytest.fixture
def marl():
    pytest.importorskip("jaxmarl", reason="needs the extra rl")
    from usarmjx.train.adapters.jaxmarl import MultiAgentWorld

    return MultiAgentWorld


def acts(env, key):
    keys = jax.random.split(key, env.num_agents)
    return {a: env.action_space(a).sample(k) for a, k in zip(env.agents, keys, strict=True)}


def test_jaxmarl_base_interface_is_implemented(marl):
    """What JaxMARL's own tests ask of each of its environments."""
    from jaxmarl.environments import MultiAgentEnv
    from jaxmarl.environments.spaces import Space

    env = marl(LineToy())
    assert isinstance(env, MultiAgentEnv)
    assert env.name == "toy"
    assert env.agent_classes == {"A": ["A0", "A1"], "B": ["B0"]}
    for agent in env.agents:
        assert env.observation_spaces[agent] is env.observation_space(agent)
        assert env.action_spaces[agent] is env.action_space(agent)
        assert isinstance(env.observation_space(agent), Space)
        assert isinstance(env.action_space(agent), Space)
    obs, state = env.reset(jax.random.PRNGKey(0))
    after, _, reward, done, info = env.step(jax.random.PRNGKey(1), state, acts(env, jax.random.PRNGKey(2)))
    for seen in (obs, after):
        assert all(bool(env.observation_space(a).contains(seen[a])) for a in env.agents)
    assert set(reward) == set(env.agents)
    assert set(done) == {*env.agents, "__all__"}
    assert all(value.shape == (3,) for value in info.values())
    assert all(bool(mask.all()) for mask in env.get_avail_actions(state).values())


def test_jaxmarl_restarts_at_the_next_episode_or_at_a_given_state(marl):
    env = marl(LineToy())
    key = jax.random.PRNGKey(0)
    first, state = env.reset(key)
    _, other = env.reset(jax.random.PRNGKey(3))
    still = jax.tree.map(jnp.zeros_like, acts(env, key))
    for _ in range(5):
        _, state, _, done, _ = env.step(key, state, still, other)
        assert not done["__all__"]
    obs, following, _, done, info = env.step(key, state, still)
    assert done["__all__"]
    assert info["truncated"].all()
    assert float(obs["A0"][0]) == pytest.approx(float(first["A0"][0]) + 1 / 16)  # the next episode
    assert float(following.final_obs[0][0, 0, 0]) == pytest.approx(float(first["A0"][0]))
    obs, given, *_ = env.step(key, state, still, other)
    for a, b in zip(jax.tree.leaves(given), jax.tree.leaves(other), strict=True):
        assert bool((a == b).all())
    assert obs["A0"].tolist() == env.get_obs(other)["A0"].tolist()


def test_jaxmarl_is_mapped_scanned_and_logged(marl):
    from jaxmarl.wrappers.baselines import LogWrapper

    env = LogWrapper(marl(LineToy()))
    obs, state = jax.vmap(env.reset)(jax.random.split(jax.random.PRNGKey(0), 4))
    start = obs["A0"][:, 0]

    def one(state, key):
        still = {a: jnp.zeros((4, *env.action_space(a).shape)) for a in env.agents}
        _, state, _, done, info = jax.vmap(env.step)(jax.random.split(key, 4), state, still)
        return state, (done["__all__"], info["returned_episode_returns"])

    _, (done, returns) = jax.lax.scan(one, state, jax.random.split(jax.random.PRNGKey(1), 6))
    assert done[:-1].any() == np.False_
    assert done[-1].all()
    np.testing.assert_allclose(returns[-1, :, 0], 6 * start, rtol=FLOAT)


def test_jaxmarl_refuses_what_it_cannot_compile(marl):
    with pytest.raises(UsageError, match="engine 'planar', 'jax' or 'warp'"):
        marl(LineToy(traceable=False))
    with pytest.raises(UsageError, match="worlds=1, not 2"):
        marl(LineToy(worlds=2))


# ---- Brax


@pytest.fixture
def robots():
    pytest.importorskip("brax", reason="needs the extra train")
    from usarmjx.train.adapters.brax import BatchedRobots

    return BatchedRobots


def test_brax_collects_transitions_of_all_robots(robots):
    """Brax's own unroll, as its learners use it."""
    from brax.training.acting import generate_unroll

    env = robots(LineToy(worlds=2, mixed=False))
    assert (env.observation_size, env.action_size) == (2, 2)
    state = jax.jit(env.reset)(jax.random.PRNGKey(0))
    start = np.array(state.obs[:, 0])

    def still(obs, key):
        return jnp.zeros((4, 2)), {}

    _, data = generate_unroll(env, state, still, jax.random.PRNGKey(1), 7, extra_fields=("truncation",))
    np.testing.assert_allclose(data.observation[:6, :, 0], np.tile(start, (6, 1)), atol=FLOAT)
    np.testing.assert_allclose(data.observation[6, :, 0], start + 1 / 16, atol=FLOAT)
    np.testing.assert_array_equal(data.discount[:, 0], [1, 1, 1, 1, 1, 0, 1])
    np.testing.assert_array_equal(data.extras["state_extras"]["truncation"][:, 0], [0, 0, 0, 0, 0, 1, 0])
    with pytest.raises(UsageError, match="one class"):
        robots(LineToy())


def test_brax_steps_an_engine_that_cannot_be_traced(robots):
    env = robots(LineToy(worlds=1, mixed=False, traceable=False))
    state = env.reset(jax.random.split(jax.random.key(0), 3))
    after = env.step(state, jnp.ones((2, 2)))
    np.testing.assert_allclose(after.obs[:, 0], state.obs[:, 0] + 0.1, atol=FLOAT)
