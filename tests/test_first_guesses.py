"""First guesses of a user in Python: they work, or a line says what to write; objects say what they are."""

from types import SimpleNamespace
from typing import Any, cast

import pytest

import usarmjx
from usarmjx.base.errors import UsageError
from usarmjx.train.envs.env import Env


def test_a_roster_may_be_the_command_lines():
    scene = usarmjx.build_scene("yellow", "P2AT:2,P2DX")
    assert [entry.spec.name for entry in scene.roster] == ["P2AT", "P2AT", "P2DX"]
    with pytest.raises(UsageError, match="'P2AT:x' is not of the form CLASS:COUNT, as P2AT:4"):
        usarmjx.build_scene("yellow", "P2AT:x")


def test_a_batch_may_be_of_an_arena():
    batch = usarmjx.Batch("yellow", worlds=2, engine="c")
    assert repr(batch) == "Batch(Scene('DM-USAR_yellow', 1 robots), worlds=2, engine=CEngine)"
    page = batch._repr_html_()
    assert "<th style='text-align:left'>worlds</th><td style='text-align:left'>2</td>" in page
    assert "1 P2AT" in page
    assert "1 P2AT" in batch.scene._repr_html_()
    assert "<script" not in page


@pytest.mark.parametrize("name", ["num_envs", "n_envs", "num_worlds", "batch_size"])
def test_other_libraries_names_of_the_worlds_are_answered(name):
    with pytest.raises(UsageError, match=f"{name}: the argument is called worlds, as worlds=4"):
        usarmjx.make("explore-v1", **cast(Any, {name: 4}))


def test_environments_and_registries_say_what_they_are():
    group = SimpleNamespace(name="P2AT", agents=("P2AT0",), obs_size=20, action_size=2)
    env: Any = Env.__new__(Env)
    env.name, env.worlds, env.episode_steps, env.period = "drive-to-goal", 4, 100, 0.2
    env.groups, env.batch = (group,), SimpleNamespace(engine=0)
    assert repr(env) == (
        "Env(task=drive-to-goal, worlds=4, engine=int, agents=1 P2AT (20 numbers, 2 actions), "
        "episode=100 steps of 0.2 s)"
    )
    assert "<td style='text-align:left'>drive-to-goal</td>" in env._repr_html_()
    assert repr(usarmjx.TASKS).startswith("Registry of tasks: convoy, drive-to-goal, explore-v1,")
