"""Actions that are chosen from a grid, through each adapter; oracle: the grid's closed form."""

from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.train.choice_toys import CHOICES, ChoiceToy, WhisperToy
from tests.train.toys import LineToy, group
from usarmjx.base.errors import UsageError
from usarmjx.train.adapters.agents import ActionGrid, action_grids, own_keywords

FLOAT = 1e-6  # sums of two numbers of size 1 in single precision


def test_choices_count_through_the_grid_with_the_last_action_fastest():
    grid = ActionGrid(bins=3, size=2)
    assert grid.choices == 9
    np.testing.assert_array_equal(grid.points, list(product([-1, 0, 1], [-1, 0, 1])))
    np.testing.assert_array_equal(grid.chosen([[0, 1], [4, 8]]), [[[-1, -1], [-1, 0]], [[0, 0], [1, 1]]])
    goals = ActionGrid(bins=3, size=19, chooses=True)
    assert goals.choices == 19
    np.testing.assert_array_equal(goals.chosen([18]), [[0.0] * 18 + [1.0]])
    np.testing.assert_array_equal(ActionGrid(bins=5, size=1).points[:, 0], [-1, -0.5, 0, 0.5, 1])
    np.testing.assert_array_equal(grid.chosen(jnp.array([-7, 99]), jnp), [[-1, -1], [1, 1]])


@pytest.mark.parametrize(
    ("choice", "said"), [(9, "from 9 to 9, allowed are 0 to 8"), (-1, "from -1"), (1.5, "float")]
)
def test_what_is_no_choice_is_refused(choice, said):
    with pytest.raises(UsageError, match=said):
        ActionGrid(bins=3, size=2).chosen(np.array(choice))


@pytest.mark.parametrize(
    ("actions", "bins", "said"),
    [
        ("digital", 3, "actions is 'digital', allowed are 'continuous' and 'discrete'"),
        ("discrete", 1, "bins is 1, expected at least 2"),
        ("discrete", 65, "bins is 65: A has 2 actions, 4225 choices, at most 4096 are allowed"),
    ],
)
def test_grids_that_cannot_be_are_refused(actions, bins, said):
    with pytest.raises(UsageError, match=said):
        action_grids((group("A", 2, 2, 2),), actions, bins)
    assert action_grids((group("A", 2, 2, 2),), "continuous", bins) is None


@pytest.mark.parametrize(
    ("given", "own", "left"),
    [
        ({"actions": "discrete", "count": 2}, {"actions": "discrete"}, {"count": 2}),
        ({"actions": "wheels", "bins": 5}, {"actions": "discrete", "bins": 5}, {"actions": "wheels"}),
        ({"actions": "continuous", "bins": 5}, {"actions": "continuous", "bins": 5}, {}),
        ({"actions": "goals"}, {}, {"actions": "goals"}),
    ],
)
def test_tasks_keep_a_field_of_the_same_name(given, own, left):
    assert own_keywords(given) == own
    assert given == left


@pytest.mark.filterwarnings("ignore:.*A Box observation space")  # no bounds: they are any numbers
def test_gymnasium_has_a_number_for_each_robot():
    gymnasium = pytest.importorskip("gymnasium", reason="needs the extra rl")
    from gymnasium.utils.env_checker import check_env

    from usarmjx.train.adapters.gymnasium import TeamWorld, VectorWorlds

    worlds = VectorWorlds(LineToy(worlds=2), actions="discrete")
    assert worlds.single_action_space == gymnasium.spaces.MultiDiscrete([9, 9, 3])
    worlds.reset(seed=0)
    obs, *_ = worlds.step(np.array([[8, 0, 1], [4, 4, 2]]))
    x = [[1 / 8 + 0.1, 1 + 1 / 8 - 0.1, 1 / 8], [2 / 8, 1 + 2 / 8, 2 / 8 + 0.1]]
    np.testing.assert_allclose(obs[:, ::2], x, atol=FLOAT)
    assert worlds.action_space.contains(worlds.action_space.sample())
    worlds.step(worlds.action_space.sample())
    with pytest.raises(UsageError, match="expected whole numbers"):
        worlds.step(np.zeros((2, 3), np.float32))
    each = VectorWorlds(LineToy(worlds=2, mixed=False), "each", actions="discrete", bins=2)
    assert each.single_action_space == gymnasium.spaces.Discrete(4)
    each.reset(seed=0)
    obs, *_ = each.step(np.array([0, 3, 3, 0]))
    np.testing.assert_allclose(obs[:, 0], [1 / 8 - 0.1, 9 / 8 + 0.1, 2 / 8 + 0.1, 10 / 8 - 0.1], atol=FLOAT)
    one = TeamWorld(LineToy(robots=1, mixed=False), actions="discrete")
    assert one.action_space == gymnasium.spaces.Discrete(9)
    with pytest.warns(UserWarning, match="infinity"):
        check_env(one, skip_render_check=True)
    first, _ = one.reset(seed=0)
    np.testing.assert_allclose(one.step(8)[0][0], first[0] + 0.1, atol=FLOAT)


def test_gymnasium_makes_them_by_keyword():
    gymnasium = pytest.importorskip("gymnasium", reason="needs the extra rl")
    import usarmjx.train.adapters.gymnasium  # noqa: F401 - registers ids

    light = {"engine": "c", "ranges": (), "pose": "GroundTruth", "arena": "field"}
    one = gymnasium.make("usarmjx/drive-to-goal-v1", actions="discrete", bins=5, **light)
    assert one.action_space == gymnasium.spaces.Discrete(25)
    worlds = gymnasium.make_vec("usarmjx/drive-to-goal-v1", num_envs=2, actions="discrete", **light)
    assert worlds.single_action_space == gymnasium.spaces.Discrete(9)


def test_pettingzoo_agents_choose():
    pytest.importorskip("pettingzoo", reason="needs the extra rl")
    from pettingzoo.test import parallel_api_test

    from usarmjx.train.adapters.pettingzoo import ParallelWorld

    world = ParallelWorld(LineToy(), actions="discrete")
    assert {name: space.n for name, space in world.action_spaces.items()} == {"A0": 9, "A1": 9, "B0": 3}
    parallel_api_test(world, num_cycles=20)
    world.reset(seed=7)
    obs, *_ = world.step({"A0": 8, "A1": np.int64(1), "B0": 0})
    x = [1 / 8 + 0.1, 1 + 1 / 8 - 0.1, 1 / 8 - 0.1]
    np.testing.assert_allclose([obs[name][0] for name in ("A0", "A1", "B0")], x, atol=FLOAT)
    with pytest.raises(UsageError, match="allowed are 0 to 2"):
        world.step({"A0": 8, "A1": 1, "B0": 3})


def test_jaxmarl_agents_choose():
    pytest.importorskip("jaxmarl", reason="needs the extra rl")
    from jaxmarl.environments.spaces import Discrete

    from usarmjx.train.adapters.jaxmarl import MultiAgentWorld

    world = MultiAgentWorld(LineToy(), actions="discrete")
    assert all(isinstance(world.action_space(name), Discrete) for name in world.agents)
    assert {name: world.action_space(name).n for name in world.agents} == {"A0": 9, "A1": 9, "B0": 3}
    keys = jax.random.split(jax.random.key(0), 4)
    obs, states = jax.vmap(world.reset)(keys)
    choices = {"A0": jnp.array([8, 4, 0, 2]), "A1": jnp.zeros(4, int), "B0": jnp.array([0, 1, 2, 2])}
    after, states, _, _, _ = jax.vmap(world.step)(keys, states, choices)
    np.testing.assert_allclose(after["A0"][:, 0] - obs["A0"][:, 0], [0.1, 0.0, -0.1, -0.1], atol=FLOAT)
    np.testing.assert_allclose(after["B0"][:, 0] - obs["B0"][:, 0], [-0.1, 0.0, 0.1, 0.1], atol=FLOAT)
    available = world.get_avail_actions(jax.tree.map(lambda one: one[0], states))
    assert {name: mask.shape for name, mask in available.items()} == {"A0": (9,), "A1": (9,), "B0": (3,)}


def test_jaxmarl_agents_choose_among_the_goals_that_are_there():
    pytest.importorskip("jaxmarl", reason="needs the extra rl")
    from jaxmarl.wrappers.baselines import CTRolloutManager

    from usarmjx.train.adapters.jaxmarl import MultiAgentWorld

    world = MultiAgentWorld(ChoiceToy(worlds=1), actions="discrete")
    assert {name: world.action_space(name).n for name in world.agents} == {"a0": CHOICES, "a1": CHOICES}
    obs, state = world.reset(jax.random.key(1))
    for name, mask in world.get_avail_actions(state).items():
        np.testing.assert_array_equal(mask, obs[name][-CHOICES:] > 0.5)
    best = {
        name: jnp.where(one[-CHOICES:] > 0.5, one[5:15:2], -jnp.inf).argmax() for name, one in obs.items()
    }
    _, _, rewards, _, _ = world.step(jax.random.key(0), state, best)
    assert {name: float(one) for name, one in rewards.items()} == {"a0": 1.0, "a1": 1.0}
    # The manager of all of JaxMARL's Q-learning programs.
    manager = CTRolloutManager(world, batch_size=3)
    _, states = manager.batch_reset(jax.random.key(2))
    drawn = {name: manager.batch_sample(jax.random.key(3), name) for name in manager.agents}
    after, _, rewards, _, _ = manager.batch_step(jax.random.key(4), states, drawn)
    assert after["a0"].shape == (3, ChoiceToy(worlds=1).groups[0].obs_size + 2)
    assert rewards["__all__"].shape == (3,)


def test_choices_with_a_vector_are_continuous_actions_only():
    """A number for each choice, then the vector's, which is always available."""
    pytest.importorskip("jaxmarl", reason="needs the extra rl")
    from jaxmarl.environments.spaces import Box

    from usarmjx.train.adapters.jaxmarl import MultiAgentWorld

    with pytest.raises(UsageError, match="of A are choices and a vector of 1 numbers, not discrete: take"):
        MultiAgentWorld(WhisperToy(worlds=1), actions="discrete")
    world = MultiAgentWorld(WhisperToy(worlds=1))
    assert isinstance(world.action_space("a0"), Box)
    obs, state = world.reset(jax.random.key(1))
    for name, mask in world.get_avail_actions(state).items():
        assert mask.tolist() == [*(obs[name][-world.env.groups[0].choices :] > 0.5), True]


def test_jaxmarl_makes_tasks_by_name(made):
    import jaxmarl

    from usarmjx.train.adapters import jaxmarl as ours

    ours.register_worlds()
    ours.register_worlds()
    assert jaxmarl.registered_envs.count("usarmjx/explore-v3") == 1
    world = jaxmarl.make("usarmjx/explore-v3", actions="discrete", count=2)
    assert made == [("explore-v3", {"engine": "planar", "count": 2})]
    assert world.action_space("A0").n == 9
    assert jaxmarl.make("MPE_simple_spread_v3").num_agents == 3


def test_baselines_learn_to_choose():
    pytest.importorskip("stable_baselines3", reason="needs the extra sb3, which dev leaves out for its size")
    from stable_baselines3 import DQN, PPO

    from usarmjx.train.adapters.stable_baselines3 import BaselinesWorlds

    single = BaselinesWorlds(LineToy(worlds=2, robots=1, mixed=False), actions="discrete")
    assert (
        DQN("MlpPolicy", single, learning_starts=16, buffer_size=256, device="cpu").learn(64).num_timesteps
        >= 64
    )
    team = BaselinesWorlds(LineToy(worlds=2), actions="discrete")
    assert PPO("MlpPolicy", team, n_steps=16, batch_size=16, device="cpu").learn(64).num_timesteps >= 64
