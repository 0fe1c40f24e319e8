"""Batches for TorchRL: shared memory, its own checker, resets, faults, and the numbers of the environment."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import usarmjx
from tests.train.envs.test_presence import DIES, JOINS, STEPS, Shifts
from tests.train.toys import DriveToy, LineToy
from usarmjx.base.errors import MissingExtraError, UsageError
from usarmjx.train.envs.env import Env

torch = pytest.importorskip("torch", reason="needs the extra torchrl")
pytest.importorskip("torchrl", reason="needs the extra torchrl")
from torchrl.envs.utils import check_env_specs, step_mdp  # noqa: E402 - torchrl may be missing

from usarmjx.train.adapters.torchrl import TorchWorlds  # noqa: E402

WORLDS = 3


def moved(worlds, before, *actions):
    """The TensorDict after actions of each group, as they are given."""
    for group, action in zip(worlds.group_map, actions, strict=True):
        before[group, "action"] = torch.as_tensor(action)
    return worlds.step(before)["next"]


def still(toy):
    return [torch.zeros(toy.worlds, len(group.agents), group.action_size) for group in toy.groups]


def pointer(array):
    return array.unsafe_buffer_pointer()


@pytest.mark.parametrize("actions", ["continuous", "discrete"])
@pytest.mark.parametrize("kind", [LineToy, DriveToy])
@pytest.mark.filterwarnings("error")
def test_torchrl_own_checks_pass(kind, actions):
    check_env_specs(TorchWorlds(kind(worlds=WORLDS), actions=actions))


def test_tensors_are_the_arrays_of_the_environment_and_actions_are_shared_too(monkeypatch):
    toy = LineToy(worlds=64)
    worlds, given = TorchWorlds(toy), []
    advance = toy.advance
    monkeypatch.setattr(
        toy, "advance", lambda state, actions: given.append(actions) or advance(state, actions)
    )
    start = worlds.reset()
    assert start["A", "observation"].data_ptr() == pointer(worlds._state.obs[0])
    actions = still(toy)
    after = moved(worlds, start, *actions)
    now = worlds._state
    for g, group in enumerate("AB"):
        assert after[group, "observation"].data_ptr() == pointer(now.obs[g])
        assert after[group, "reward"].data_ptr() == pointer(now.reward[g])
        assert after[group, "reward"].shape == (*now.reward[g].shape, 1)
        assert pointer(given[0][g]) == actions[g].data_ptr()
    assert after["done"].data_ptr() == pointer(now.done)
    assert after["state"].data_ptr() == pointer(now.privileged)
    assert after["info", "way"].data_ptr() == pointer(now.metrics["way"])


def test_torchrl_writes_to_no_array_of_ours():
    worlds, seen = TorchWorlds(LineToy(worlds=WORLDS)), []

    def keep(env, _):
        s = worlds._state
        seen.append(
            ((s.obs, s.reward, s.done, s.metrics), jax.device_get((s.obs, s.reward, s.done, s.metrics)))
        )

    rolled = worlds.rollout(20, break_when_any_done=False, callback=keep)
    assert rolled["next", "done"].sum() >= 3 * WORLDS
    for arrays, copies in seen:
        jax.tree.map(np.testing.assert_array_equal, jax.device_get(arrays), copies)


def test_a_world_stays_at_its_end_until_torchrl_resets_it():
    """Closed form: a world starts at (number + 1) / 8 + episode / 16."""
    toy = LineToy(worlds=2, robots=1, mixed=False)
    worlds = TorchWorlds(toy)
    start = worlds.reset()
    np.testing.assert_allclose(start["A", "observation"][:, 0, 0], [1 / 8, 2 / 8])
    now, fast = start, np.float32([[[0, 0]], [[5, 0]]])
    for _ in range(3):
        after = moved(worlds, now, fast)
        now = step_mdp(after) if "next" in after else after
    assert after["done"].ravel().tolist() == [False, True]
    assert after["terminated"].ravel().tolist() == [False, True]
    assert not after["truncated"].any()
    np.testing.assert_allclose(after["A", "observation"][1, 0], [2 / 8 + 1.5, 3.0])
    np.testing.assert_allclose(after["info", "score"][1], 3 * 2 / 8 + 0.5 + 1.0 + 1.5)
    fresh = worlds.maybe_reset(after)
    np.testing.assert_allclose(fresh["A", "observation"][:, 0], [[1 / 8, 3.0], [2 / 8 + 1 / 16, 0.0]])
    assert not fresh["done"].any()
    after = moved(worlds, fresh, np.zeros((2, 1, 2), np.float32))
    np.testing.assert_allclose(after["A", "observation"][:, 0], [[1 / 8, 4.0], [2 / 8 + 1 / 16, 1.0]])


def test_any_world_is_reset_when_asked_for():
    worlds = TorchWorlds(LineToy(worlds=WORLDS, robots=1, mixed=False))
    now = moved(worlds, worlds.reset(), np.ones((WORLDS, 1, 2), np.float32))
    now["_reset"] = torch.tensor([[False], [True], [False]])
    fresh = worlds.reset(now)
    starts = np.float32([1 / 8 + 0.1, 2 / 8 + 1 / 16, 3 / 8 + 0.1])
    np.testing.assert_allclose(fresh["A", "observation"][:, 0, 0], starts, rtol=1e-6)
    np.testing.assert_allclose(fresh["A", "observation"][:, 0, 1], [1, 0, 1])
    fresh = worlds.reset()  # all: each its next episode
    np.testing.assert_allclose(
        fresh["A", "observation"][:, 0, 0], np.arange(2, 8, 2) / 16 + np.array([1, 2, 1]) / 16
    )


def test_a_seed_begins_anew_with_the_next_reset_of_all():
    worlds = TorchWorlds(LineToy(worlds=WORLDS), seed=3)
    first = worlds.reset()["A", "observation"].clone()
    np.testing.assert_array_equal(first, LineToy(worlds=WORLDS).reset(3).obs[0])
    assert not torch.equal(worlds.reset()["A", "observation"], first)
    worlds.set_seed(3)
    assert torch.equal(worlds.reset()["A", "observation"], first)


def test_a_fault_is_truncated_and_marked():
    toy = DriveToy(4, rotten=True)
    worlds, right = TorchWorlds(toy), [np.zeros((4, 2, 2), np.float32), np.zeros((4, 1, 2), np.float32)]
    right[0][..., 0] = 1
    now = worlds.reset()
    for _ in range(12):
        now = moved(worlds, now, *right)
        if now["fault"].any():
            break
    bad = now["fault"]
    assert bad.any()
    assert not now["terminated"][bad].any()
    assert now["truncated"][bad].all()
    assert now["done"][bad].all()
    fresh = worlds.maybe_reset(now)
    assert not fresh["fault"].any()
    assert torch.isfinite(fresh["A", "observation"]).all()


def test_discrete_actions_are_points_of_the_grid():
    toy = LineToy(worlds=1)
    worlds = TorchWorlds(toy, actions="discrete", bins=5)
    assert worlds.full_action_spec["A", "action"].n == 25
    assert worlds.full_action_spec["B", "action"].n == 5
    x = moved(worlds, worlds.reset(), np.array([[24, 5]]), np.array([[1]]))
    np.testing.assert_allclose(x["A", "observation"][0, :, 0], [1 / 8 + 0.1, 1 + 1 / 8 - 0.05])
    np.testing.assert_allclose(x["B", "observation"][0, :, 0], [1 / 8 - 0.05])
    with pytest.raises(UsageError, match="discrete actions of B: allowed are 0 to 4"):
        moved(worlds, x, np.array([[24, 5]]), np.array([[5]]))


def test_critics_may_see_all():
    toy = LineToy(worlds=WORLDS)
    seen = TorchWorlds(toy, joint_state=True).reset()
    parts = [seen[group, "observation"].reshape(WORLDS, -1) for group in "AB"]
    assert torch.equal(seen["state"], torch.cat([*parts, torch.from_dlpack(toy.reset(0).privileged)], -1))


def test_rollouts_of_a_task_have_its_own_numbers_bit_for_bit():
    env = usarmjx.make(
        "drive-to-goal", WORLDS, "c", ranges=(), pose="GroundTruth", arena="field", episode_steps=4
    )
    worlds, generator = TorchWorlds(env, seed=5), np.random.default_rng(0)
    now, state = worlds.reset(), env.reset(5)
    for _ in range(10):  # into the third episode
        actions = generator.uniform(-1, 1, (WORLDS, 1, 2)).astype(np.float32)
        np.testing.assert_array_equal(now["P2AT", "observation"], state.obs[0])
        np.testing.assert_array_equal(now["state"], state.privileged)
        state = env.step(state, (jnp.asarray(actions),))
        now["P2AT", "action"] = torch.from_numpy(actions)
        both, now = worlds.step_and_maybe_reset(now)
        after = both["next"]
        np.testing.assert_array_equal(after["P2AT", "observation"], state.final_obs[0])
        np.testing.assert_array_equal(after["P2AT", "reward"][..., 0], state.reward[0])
        np.testing.assert_array_equal(after["done"][:, 0], state.done)
    assert state.batch.worlds.episode.tolist() == [2] * WORLDS
    picture = worlds.render()
    assert picture.shape == (240, 320, 3)
    assert picture.std((0, 1)).min() > 1, "there is something to see"


def test_robots_that_are_not_alive_are_masked():
    env = Env(Shifts(), 1, engine="c")
    worlds, acts = TorchWorlds(env), np.zeros((1, 4, env.groups[0].action_size), np.float32)
    (group,) = worlds.group_map
    check_env_specs(worlds)
    now = worlds.reset()
    for step in range(1, STEPS + 1):
        assert now[group, "mask"].dtype == torch.bool
        now = moved(worlds, now, acts)
        expected = [step < DIES, step > JOINS, step < JOINS, True]
        assert now[group, "mask"][0].tolist() == expected, step
    assert now["truncated"].all() or now["terminated"].all()


def test_what_is_missing_is_named(monkeypatch):
    import importlib
    import sys

    monkeypatch.setitem(sys.modules, "torchrl.envs", None)
    monkeypatch.delitem(sys.modules, "usarmjx.train.adapters.torchrl")
    with pytest.raises(MissingExtraError, match=r"this needs torchrl: .*torchrl"):
        importlib.import_module("usarmjx.train.adapters.torchrl")
