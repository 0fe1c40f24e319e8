"""The calls of JaxMARL's own programs, in their order and shapes: on toys, and a real task's state.

Oracles: the closed forms of the toys, and the environment itself, stepped without the adapter.
"""

import sys
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import usarmjx
from tests.train.choice_toys import CHOICES, ChoiceToy
from tests.train.rooms import room
from tests.train.toys import LineToy
from usarmjx.base.errors import UsageError
from usarmjx.train.tasks import TASKS

pytest.importorskip("jaxmarl", reason="needs the extra rl")
from jaxmarl.wrappers.baselines import CTRolloutManager, LogWrapper, MPELogWrapper

from usarmjx.train.adapters import jaxmarl as ours
from usarmjx.train.adapters.jaxmarl import MultiAgentWorld

FLOAT = 1e-5  # sums of a few numbers of size 1 in single precision, in another order
WORLDS = 3


def rows(values, agents):
    """Values of agents as rows (agents x worlds, n), as the on-policy programs stack them."""
    return jnp.stack([values[name] for name in agents]).reshape(len(agents) * WORLDS, -1)


def by_name(row, agents):
    """The reverse: an action of each agent (worlds, 1), with the last axis that the programs leave."""
    return {name: row.reshape(len(agents), WORLDS, -1)[k] for k, name in enumerate(agents)}


@pytest.mark.parametrize("wrapper", [LogWrapper, MPELogWrapper])
def test_a_rollout_of_the_on_policy_programs(wrapper):
    """Choices come as (worlds, 1); returns are sums of rewards, which the wrapper of MPE multiplies."""
    env = wrapper(MultiAgentWorld(LineToy(mixed=False), actions="discrete"))
    actors = env.num_agents * WORLDS
    obs, state = jax.vmap(env.reset)(jax.random.split(jax.random.PRNGKey(0), WORLDS))
    start = rows(obs, env.agents)[:, 0]
    ahead = jnp.full((actors,), 8)  # the last point of 3 x 3: full ahead

    def step(carry, key):
        obs, state = carry
        given = by_name(ahead, env.agents)
        assert given["A0"].shape == (WORLDS, 1)
        obs, state, reward, done, info = jax.vmap(env.step)(jax.random.split(key, WORLDS), state, given)
        told = jax.tree.map(lambda one: one.reshape(actors), info)
        ends = rows(done, env.agents).squeeze()
        return (obs, state), (rows(reward, env.agents).squeeze(), ends, told, jnp.tile(done["__all__"], 2))

    keys = jax.random.split(jax.random.PRNGKey(1), 6)
    _, (reward, ends, told, together) = jax.lax.scan(step, (obs, state), keys)
    moved = start + 0.1 * jnp.arange(1, 7)[:, None]
    np.testing.assert_allclose(reward, moved, atol=FLOAT)
    np.testing.assert_array_equal(ends, np.tile(np.arange(1, 7)[:, None] == 6, actors))
    np.testing.assert_array_equal(ends, together)
    factor = 2.0 if wrapper is MPELogWrapper else 1.0
    returns = told["returned_episode_returns"][-1].reshape(WORLDS, 2).T.ravel()
    np.testing.assert_allclose(returns, factor * moved.sum(0), rtol=FLOAT)
    np.testing.assert_array_equal(told["returned_episode_lengths"][-1], 6)


def test_a_rollout_of_the_q_learning_programs_is_masked_and_sees_the_true_state():
    """By the convention of SMAX: masks of goals, the critics' state, and the sum of rewards."""
    world = MultiAgentWorld(ChoiceToy(worlds=1), convention="smax")
    assert world.name == "choice-toy-smax"
    env = LogWrapper(world)
    manager = CTRolloutManager(env, batch_size=WORLDS)
    assert (manager.max_action_space, manager.obs_size) == (CHOICES, world.env.groups[0].obs_size + 2)
    obs, state = manager.batch_reset(jax.random.PRNGKey(0))
    assert obs["__all__"].shape == (WORLDS, world.world_state_size())
    returned = jnp.zeros(WORLDS)
    for step in range(4):
        masks = manager.get_valid_actions(state.env_state)
        truth = jax.vmap(world.get_legal_moves)(state.env_state)
        there = {name: obs[name][:, -CHOICES - 2 : -2] > 0.5 for name in world.agents}
        assert not jnp.stack([*there.values()]).all()
        for name in world.agents:
            np.testing.assert_array_equal(masks[name], there[name])
            np.testing.assert_array_equal(truth[name], there[name])
        # The greedy choice of the programs, with the number of each choice as its value.
        values = {name: obs[name][:, 5:15:2] - 1e10 * (1 - masks[name]) for name in world.agents}
        best = {name: one.argmax(-1) for name, one in values.items()}
        obs, state, rewards, dones, infos = manager.batch_step(jax.random.PRNGKey(step), state, best)
        np.testing.assert_array_equal(rewards["__all__"], 2.0)  # both are right
        np.testing.assert_array_equal(rewards["a1"], 2.0)
        returned += rewards["__all__"]
        assert bool(dones["__all__"].all()) == (step == 3)
        assert np.isfinite(jax.tree.leaves(obs)[0]).all()
    np.testing.assert_allclose(infos["returned_episode_returns"][:, 0], returned)
    _, plain = MultiAgentWorld(ChoiceToy(worlds=1)).reset(jax.random.PRNGKey(0))
    np.testing.assert_array_equal(obs["__all__"], jnp.ones((WORLDS, 1)) * plain.privileged)
    with pytest.raises(UsageError, match="allowed are 'plain' and 'smax'"):
        MultiAgentWorld(ChoiceToy(worlds=1), convention="hanabi")


def test_agents_that_choose_are_discrete_unless_asked_otherwise():
    assert MultiAgentWorld(ChoiceToy(worlds=1)).action_space("a0").n == CHOICES
    box = MultiAgentWorld(ChoiceToy(worlds=1), actions="continuous")
    assert box.action_space("a0").shape == (CHOICES,)
    assert MultiAgentWorld(LineToy()).action_space("A0").shape == (2,)
    assert MultiAgentWorld(LineToy()).max_steps == 6


def test_a_step_without_reset_leaves_a_world_at_its_end():
    world = MultiAgentWorld(LineToy())
    _, state = world.reset(jax.random.PRNGKey(0))
    still = {name: jnp.zeros(world.action_space(name).shape) for name in world.agents}
    start = state.obs[0]
    for _ in range(6):
        obs, state, _, dones, infos = world.step_env(jax.random.PRNGKey(1), state, still)
    assert dones["__all__"]
    assert infos["truncated"].all()
    np.testing.assert_allclose(obs["A0"], [start[0, 0, 0], 6.0])


# ---- Names


def test_names_have_settings_for_programs_that_pass_no_keywords_on(made):
    import jaxmarl

    ours.register_worlds()
    world = jaxmarl.make("usarmjx_explore-v3?actions=wheels&bins=5&count=2&engine=jax", episode_steps=9)
    assert made == [("explore-v3", {"engine": "jax", "actions": "wheels", "count": 2, "episode_steps": 9})]
    assert world.action_space("A0").n == 25
    assert jaxmarl.make("usarmjx/explore-v3", actions="wheels", convention="smax").name == "toy-smax"
    assert made[-1] == ("explore-v3", {"engine": "planar", "actions": "wheels"})
    with pytest.raises(UsageError, match="count is in the name and in the keywords"):
        jaxmarl.make("usarmjx_explore-v3?count=2", count=3)
    for wrong in ("count=many", "bins=many"):
        with pytest.raises(UsageError, match=r"explore-v3.*many"):
            jaxmarl.make(f"usarmjx_explore-v3?{wrong}")


def test_a_program_runs_as_it_is(made, tmp_path, monkeypatch, capsys):
    program = tmp_path / "program.py"
    program.write_text(
        "import sys\nfrom jaxmarl import make\nimport helper\n"
        "if __name__ == '__main__':\n    print(make(sys.argv[1]).num_agents, helper.NAME)\n"
    )
    (tmp_path / "helper.py").write_text("NAME = 'beside it'\n")
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.setattr(sys, "argv", ["-m", str(program), "usarmjx_wander"])
    ours.main()
    assert capsys.readouterr().out.endswith("3 beside it\n")
    assert made[0][0] == "wander"
    monkeypatch.setattr(sys, "argv", ["-m"])
    with pytest.raises(SystemExit, match="expected the file of a program"):
        ours.main()


# ---- Memory


def size(tree):
    """Bytes of all arrays of a tree; a random key has 8."""
    return sum(
        one.size * (8 if jnp.issubdtype(one.dtype, jax.dtypes.prng_key) else one.dtype.itemsize)
        for one in jax.tree.leaves(tree)
    )


def test_all_worlds_share_one_library_of_arenas():
    """In `explore-v3` copies of it would be seven times the rest of a world's state; a quarter is here."""
    arena = replace(TASKS.get("explore-v3").arena, count=4)
    env = usarmjx.make("explore-v3", engine="planar", count=2, arena=arena)
    _, state = jax.eval_shape(MultiAgentWorld(env).reset, jax.random.key(0))
    library = size(env.arenas_at(1.0))
    assert state.batch.arenas is None
    assert library > 400_000
    assert size(state) < 300_000


def test_worlds_with_a_shared_library_are_as_the_environment_has_them():
    """Through the ends of three episodes, each in another room; oracle: the environment's own state."""
    rooms = [room([(1.0 + k, 1.5)], width=6.0 + k) for k in range(3)]
    light = {"ranges": (), "pose": "GroundTruth", "radius": 1e-6, "episode_steps": 2}
    env = usarmjx.make("drive-to-goal", engine="planar", arena=rooms, **light)
    world = MultiAgentWorld(env)
    (name,) = world.agents
    keys = jax.random.split(jax.random.key(0), WORLDS)
    obs, states = jax.vmap(world.reset)(keys)
    seeds = [int(jax.random.randint(key, (), 0, ours.MAX_SEED)) for key in keys]
    own, serials = [env.reset(seed) for seed in seeds], set()
    advance, step = jax.jit(jax.vmap(world.step)), jax.jit(env.step)
    for _ in range(5):
        np.testing.assert_allclose(obs[name], [one.obs[0][0, 0] for one in own], atol=FLOAT)
        serials |= set(states.batch.worlds.arena_state.serial.ravel().tolist())
        obs, states, reward, _, _ = advance(keys, states, {name: jnp.ones((WORLDS, 2))})
        own = [step(one, (jnp.ones((1, 1, 2)),)) for one in own]
        np.testing.assert_allclose(reward[name], [one.reward[0][0, 0] for one in own], atol=FLOAT)
    assert serials == {0, 1, 2}
    assert states.batch.arenas is None
