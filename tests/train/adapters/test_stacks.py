"""Stable-Baselines3's `VecEnv`, arrays shared with NumPy and PyTorch, and what docs/stacks.md shows."""

import re
import warnings
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dev
import usarmjx
from tests.train.toys import LineToy
from usarmjx.base.errors import UsageError
from usarmjx.train.tasks import TASKS

# ---- Stable-Baselines3


@pytest.fixture
def baselines():
    pytest.importorskip("stable_baselines3", reason="needs the extra sb3, which dev leaves out for its size")
    from usarmjx.train.adapters.stable_baselines3 import BaselinesWorlds

    return BaselinesWorlds


def test_baselines_worlds_tell_ends_as_that_library_does(baselines):
    worlds = baselines(LineToy(worlds=2, robots=1, mixed=False))
    worlds.seed(3)
    np.testing.assert_allclose(worlds.reset()[:, 0], LineToy(worlds=2, mixed=False).reset(3).obs[0][:, 0, 0])
    worlds.seed(0)
    first = worlds.reset()
    np.testing.assert_allclose(first[:, 0], [1 / 8, 2 / 8])
    fast = np.zeros((2, 2), np.float32)
    fast[1] = 5.0  # past the end after three steps
    over = []
    for step in range(6):
        obs, reward, done, infos = worlds.step(fast)
        assert (reward.dtype, done.shape) == (np.float32, (2,))
        over.append(done.tolist())
        if step == 2:
            np.testing.assert_allclose(infos[1]["terminal_observation"], [2 / 8 + 1.5, 3.0])
            assert infos[1]["TimeLimit.truncated"] is False
            assert infos[1]["score"] == pytest.approx(3 * 2 / 8 + 0.5 + 1.0 + 1.5)
            np.testing.assert_allclose(obs[1], [2 / 8 + 1 / 16, 0.0])  # the next start
            assert "terminal_observation" not in infos[0]
    assert over == [[False, False]] * 2 + [[False, True]] + [[False, False]] * 2 + [[True, True]]
    assert infos[0]["TimeLimit.truncated"] is True
    assert set(infos[0]) == {"way", "score", "bad", "TimeLimit.truncated", "terminal_observation"}
    assert worlds.get_attr("name", [0]) == ["toy"]
    assert worlds.env_is_wrapped(object) == [False, False]
    with pytest.raises(UsageError, match="robots of one class"):
        baselines(LineToy(), robots="each")


def test_baselines_learn_in_worlds_of_theirs(baselines):
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

    worlds = VecNormalize(VecMonitor(baselines(LineToy(worlds=4, mixed=False), robots="each")))
    model = PPO("MlpPolicy", worlds, n_steps=16, batch_size=64, seed=0, device="cpu")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model.learn(256)
    assert model.num_timesteps == 256
    assert all(row["l"] <= 6 for row in model.ep_info_buffer)
    assert len(model.ep_info_buffer) > 8


# ---- Arrays without copies


def pointer(array):
    return array.unsafe_buffer_pointer()


def test_numpy_and_jax_share_observations_and_actions():
    toy = LineToy(worlds=64)
    state = toy.reset(0)
    seen = np.from_dlpack(state.obs[0])
    assert seen.ctypes.data == pointer(state.obs[0])
    np.testing.assert_array_equal(seen, state.obs[0])
    room = np.ones(64 * 2 * 2 + 16, np.float32)
    start = -room.ctypes.data % 64 // 4  # where JAX takes arrays as they are
    mine = room[start : start + 256].reshape(64, 2, 2)
    shared = jnp.from_dlpack(mine)
    assert pointer(shared) == mine.ctypes.data
    moved = toy.step(state, (shared, jnp.zeros((64, 1, 1))))
    np.testing.assert_allclose(moved.final_obs[0][..., 0], state.obs[0][..., 0] + 0.1, atol=1e-5)


def test_pytorch_and_jax_share_them_on_the_cpu():
    torch = pytest.importorskip("torch", reason="needs PyTorch, which the extra sb3 brings")
    cpu = jax.devices("cpu")[0]
    seen = jax.device_put(LineToy(worlds=64).reset(0).obs[0], cpu)
    assert torch.from_dlpack(seen).data_ptr() == pointer(seen)
    actions = torch.ones(64, 2, 2)
    assert pointer(jnp.from_dlpack(actions)) == actions.data_ptr()


@pytest.mark.gpu
def test_pytorch_and_jax_share_them_on_a_gpu():
    torch = pytest.importorskip("torch", reason="needs PyTorch, which the extra sb3 brings")
    if not torch.cuda.is_available():
        pytest.skip("needs PyTorch with CUDA")
    toy = LineToy(worlds=64)
    state = toy.reset(0)
    seen = torch.from_dlpack(state.obs[0])
    assert (seen.device.type, seen.data_ptr()) == ("cuda", pointer(state.obs[0]))
    actions = torch.ones(64, 2, 2, device="cuda")
    shared = jnp.from_dlpack(actions)
    assert pointer(shared) == actions.data_ptr()
    moved = torch.from_dlpack(toy.step(state, (shared, jnp.zeros((64, 1, 1)))).final_obs[0])
    assert torch.allclose(moved[..., 0], seen[..., 0] + 0.1, atol=1e-5)


# ---- What the page shows

PROJECTS = {
    "PettingZoo": "pettingzoo",
    "JaxMARL": "jaxmarl",
    "Stable-Baselines3": "stable_baselines3",
    "TorchRL": "torchrl",
    "BenchMARL": "benchmarl",
    "RLlib": "ray.rllib",  # plain Ray is among the development tools
}


def shown(title):
    """The block of a section of docs/stacks.md that its own test of the documents does not run."""
    page = (dev.ROOT / "docs" / "stacks.md").read_text(encoding="utf-8")
    section = page.split(f"\n## {title}\n")[1].split("\n## ")[0]
    (block,) = re.findall(r"```text\n(.*?)```", section, re.DOTALL)
    return block


@pytest.mark.parametrize(
    ("package", "name"),
    [
        ("torch", "PyTorch"),
        ("torchrl", "Run with TorchRL"),
        ("benchmarl", "Run with BenchMARL"),
        ("ray", "Run with Ray"),
    ],
)
def test_the_workflow_installs_the_versions_that_the_page_tells(package, name):
    page = (dev.ROOT / "docs" / "stacks.md").read_text(encoding="utf-8")
    text = (dev.ROOT / ".github" / "workflows" / "ci.yml").read_text(encoding="utf-8")
    (version,) = re.findall(rf"\b{package}(?:\[rllib\])?==([\d.]+)", text)
    told = re.findall(rf"{name} ([\d.]+\d)", page)
    assert set(told) == {version}


@pytest.mark.parametrize("title", PROJECTS)
def test_what_the_page_shows_runs_as_printed_with_a_toy_for_the_task(title, monkeypatch, tmp_path, capsys):
    pytest.importorskip(PROJECTS[title], reason=f"needs {title}, which docs/stacks.md tells the version of")
    asked = []

    def make(name, worlds=1, engine="auto", **changes):
        asked.append((replace(TASKS.get(name), **changes), engine))
        return LineToy(worlds=worlds, mixed=False)

    monkeypatch.setattr(usarmjx, "make", make)
    if title == "BenchMARL":
        monkeypatch.setattr("usarmjx.train.adapters.benchmarl.make", make)
    monkeypatch.chdir(tmp_path)
    names = {"__name__": "page"}
    exec(compile(shown(title), "docs/stacks.md", "exec"), names)
    assert len(asked) == (
        2 if title == "BenchMARL" else 1
    )  # that library has worlds of its own to evaluate in
    if title == "PettingZoo":
        assert capsys.readouterr().out == "True True\n"
    if title == "JaxMARL":
        assert {name: row.shape for name, row in names["rewards"].items()} == {"A0": (64,), "A1": (64,)}
        assert float(jnp.abs(names["observations"]["A0"]).min()) > 0
