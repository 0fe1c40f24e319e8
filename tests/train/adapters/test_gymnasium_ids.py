"""Gymnasium's next-step resets against its own, its wrappers, and ids for `make` and `make_vec`."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.train.toys import LineToy
from usarmjx.base.errors import UsageError
from usarmjx.base.registry import Registry
from usarmjx.train.envs.task import TASKS

gymnasium = pytest.importorskip("gymnasium", reason="needs the extra rl")
from tests.train.adapters.line import Line  # noqa: E402 - gymnasium may be missing

FLOAT = 1e-5  # sums of a few numbers of size 1 in single precision, in another order


@pytest.fixture
def vector():
    from usarmjx.train.adapters.gymnasium import VectorWorlds

    return VectorWorlds


@pytest.mark.parametrize("traceable", [True, False])
def test_next_step_resets_are_as_gymnasium_makes_them(vector, traceable):
    """Oracle: SyncVectorEnv in that mode, whose reset ignores an action and is worth nothing."""
    from gymnasium.vector import AutoresetMode, SyncVectorEnv

    toy = LineToy(worlds=3, robots=1, mixed=False, traceable=traceable)
    ours = vector(toy, autoreset="next_step")
    theirs = SyncVectorEnv([lambda n=n: Line(n) for n in range(3)], autoreset_mode=AutoresetMode.NEXT_STEP)
    assert ours.metadata["autoreset_mode"] == theirs.metadata["autoreset_mode"]
    np.testing.assert_allclose(ours.reset(seed=0)[0], theirs.reset(seed=0)[0])
    generator, ends, alone = np.random.default_rng(1), 0, 0
    for _ in range(40):
        actions = generator.uniform(-0.5, 4.0, (3, 2)).astype(np.float32)
        mine, other = ours.step(actions), theirs.step(actions)
        for a, b in zip(mine[:4], other[:4], strict=True):
            np.testing.assert_allclose(a, b, atol=FLOAT)
            assert a.dtype == b.dtype
        for key in ("way", "score"):
            told = other[4].get(f"_{key}", np.zeros(3, bool))
            np.testing.assert_allclose(mine[4][key][told], other[4].get(key, np.zeros(3))[told], atol=FLOAT)
        if "_way" in other[4]:
            np.testing.assert_array_equal(mine[4]["_way"], other[4]["_way"])
        assert not {"final_obs", "final_info"} & set(mine[4])
        done = mine[2] | mine[3]
        ends, alone = ends + done.sum(), alone + (0 < done.sum() < 3)
    assert ends > 5
    assert alone > 2, "some worlds wait while others go on"
    ours.reset(seed=0)
    np.testing.assert_allclose(ours.step(np.zeros((3, 2)))[0][:, 1], 1.0)  # nobody waits after a reset


def test_gymnasium_wrappers_that_ask_for_next_step_take_it(vector):
    from gymnasium.vector import SyncVectorEnv
    from gymnasium.wrappers.vector import FlattenObservation, NormalizeObservation, NormalizeReward

    toy = LineToy(worlds=3, robots=1, mixed=False)
    both = [
        NormalizeReward(NormalizeObservation(FlattenObservation(worlds)))
        for worlds in (
            vector(toy, autoreset="next_step"),
            SyncVectorEnv([lambda n=n: Line(n) for n in range(3)]),
        )
    ]
    for wrapped in both:
        wrapped.reset(seed=0)
    for _ in range(15):
        ours, theirs = (wrapped.step(np.full((3, 2), 0.5, np.float32)) for wrapped in both)
        np.testing.assert_allclose(ours[0], theirs[0], atol=1e-4)  # divided by small deviations
        np.testing.assert_allclose(ours[1], theirs[1], atol=1e-4)
    with pytest.raises(UsageError, match=r"autoreset is 'never', allowed are 'same_step' and 'next_step'"):
        vector(LineToy(), autoreset="never")


# ---- Ids


def test_every_task_has_an_id_with_its_version(vector, monkeypatch):
    from usarmjx.train.adapters import gymnasium as adapter

    ids = {adapter.id_of(task): TASKS.get(task) for task in TASKS.names()}
    assert {id(task) for task in ids.values()} == {id(task) for _, task in TASKS}, "each once"
    assert set(ids) == {name for name in gymnasium.registry if name.startswith("usarmjx/")}
    assert {"usarmjx/drive-to-goal-v1", "usarmjx/explore-v1"} <= set(ids)
    for name, task in ids.items():
        assert TASKS.get(gymnasium.spec(name).kwargs["task"]) is task
    digs = Registry("dig")
    for number, name in enumerate(["dig", "dig-v1", "dig-v3", "dig-deep"]):
        digs.add(name, number)
    digs.add("fill-v2", digs.add("fill", "either"))
    monkeypatch.setattr(adapter, "TASKS", digs)
    found = [adapter.id_of(name).removeprefix("usarmjx/") for name in digs.names()]
    assert found == ["dig-v4", "dig-deep-v1", "dig-v1", "dig-v3", "fill-v2", "fill-v2"]


def test_the_ids_that_documents_name_are_there(vector):
    text = (Path(__file__).parents[3] / "docs" / "stacks.md").read_text(encoding="utf-8")
    named = re.findall(r"gymnasium:(usarmjx/[\w-]+)", text)
    assert len(named) >= 2
    assert set(named) <= set(gymnasium.registry)


def test_gymnasium_finds_the_ids_by_their_module():
    """In a fresh Python, which has imported nothing of ours."""
    make = "gymnasium.make('usarmjx.train.adapters.gymnasium:usarmjx/wander-v1', speed_of_light=1)"
    code = f"import gymnasium; {make}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "task wander has no field speed_of_light; it has: arena," in done.stderr


@pytest.mark.filterwarnings("error")
def test_gymnasium_makes_worlds_by_their_id(vector):
    light = {"engine": "c", "ranges": (), "episode_steps": 3}
    worlds = gymnasium.make_vec("usarmjx/drive-to-goal-v1", num_envs=2, **light)
    assert isinstance(worlds, vector)
    assert (worlds.num_envs, worlds.env.episode_steps) == (2, 3)
    assert worlds.metadata["autoreset_mode"] is gymnasium.vector.AutoresetMode.NEXT_STEP
    assert worlds.spec.id == "usarmjx/drive-to-goal-v1"
    one = gymnasium.make("usarmjx/drive-to-goal-v1", **light)
    assert one.observation_space.shape == worlds.single_observation_space.shape
    with pytest.raises(UsageError, match=r"num_envs is 5: soccer-v2 has 4 robots in a world.* multiple of 4"):
        gymnasium.make_vec("usarmjx/soccer-v2", num_envs=5, robots="each", engine="c")


def test_one_world_passes_gymnasium_checks_and_goes_on_with_the_next_episode(vector):
    from gymnasium.utils.env_checker import check_env

    from usarmjx.train.adapters.gymnasium import TeamWorld

    with pytest.warns(UserWarning, match="infinity"):  # no bounds: observations are any numbers
        check_env(TeamWorld(LineToy()), skip_render_check=True)
    world, still = TeamWorld(LineToy()), np.zeros(5, np.float32)
    first, _ = world.reset(seed=7)
    for step in range(6):
        obs, reward, ended, late, info = world.step(still)
        assert (ended, late) == (False, step == 5)
    np.testing.assert_allclose(obs[:2], [1 / 8, 6.0])  # the end
    assert info == {"way": pytest.approx(1 / 8), "score": pytest.approx(6 / 8), "bad": False}
    assert reward == pytest.approx((1 / 8 + 1 + 1 / 8 + 1 / 8) / 3)
    with pytest.raises(UsageError, match="the episode is over; call reset"):
        world.step(still)
    np.testing.assert_allclose(world.reset()[0][0], first[0] + 1 / 16)  # the second episode's start
    np.testing.assert_allclose(world.reset(seed=7)[0], first)
