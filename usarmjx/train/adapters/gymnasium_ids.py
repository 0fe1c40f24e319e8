"""Gymnasium's ids: `gymnasium.make("usarmjx/explore")` and `gymnasium.make_vec` of it, and what they return.

Importing `usarmjx.train.adapters.gymnasium` registers them; so does Gymnasium, told where they are:
`gymnasium.make("usarmjx.train.adapters.gymnasium:usarmjx/explore")`. An id ends with the version of its task;
a task without versions is version 1. For an id without one Gymnasium takes the last there is.
"""

import re
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.base.extras import extra
from usarmjx.train.envs.recipe import spec_of
from usarmjx.train.tasks import TASKS

with extra("rl"):
    import gymnasium

if TYPE_CHECKING:
    from usarmjx.train.adapters.gymnasium import VectorWorlds
    from usarmjx.train.envs.env import Env

NAMESPACE = "usarmjx"
HERE = "usarmjx.train.adapters.gymnasium_ids"
VERSION = re.compile(r"(.+)-v(\d+)")


def id_of(task: str) -> str:
    """Return the id of a registered task."""
    if VERSION.fullmatch(task):
        return f"{NAMESPACE}/{task}"
    found = [(one, VERSION.fullmatch(name)) for name, one in TASKS]
    versions = {int(match[2]): one for one, match in found if match and match[1] == task}
    same = [number for number, one in versions.items() if one is TASKS.get(task)]
    return f"{NAMESPACE}/{task}-v{same[0] if same else max(versions, default=0) + 1}"


def register_ids() -> None:
    """Register an id for each task that has none yet; call it after adding tasks of your own."""
    register = cast(Any, gymnasium).register  # whose types are half there
    for task in TASKS.names():
        if id_of(task) not in gymnasium.registry:
            register(
                id_of(task),
                entry_point=f"{HERE}:make_world",
                vector_entry_point=f"{HERE}:make_worlds",
                kwargs={"task": task},
                disable_env_checker=True,  # it warns of observations without bounds
            )


class TeamWorld(gymnasium.Env[np.ndarray, np.ndarray]):
    """One world as a `gymnasium.Env`, whose agent is the whole team, as `VectorWorlds` joins it.

    `reset` without a seed goes on with the episode after, in the next arena; in the middle of an episode it
    starts anew from a seed that it draws.

    Args:
        env: An environment of one world.
        seed: Of a first `reset` without one.

    Raises:
        UsageError: It has several worlds.
    """

    def __init__(self, env: "Env", seed: int = 0) -> None:
        from usarmjx.train.adapters.agents import check_one_world
        from usarmjx.train.adapters.gymnasium import VectorWorlds

        check_one_world(env, "a gymnasium.Env")
        self.metadata = {"render_modes": []}
        self.worlds: Any = VectorWorlds(env, seed=seed)
        self.observation_space = self.worlds.single_observation_space
        self.action_space = self.worlds.single_action_space
        self._next: np.ndarray | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode; no options are known, and any are ignored.

        Returns:
            Observation (size,), and infos.
        """
        super().reset(seed=seed)
        following, self._next = self._next, None
        if seed is None and following is not None:
            return following, {}
        return self.worlds.reset(seed=seed)[0][0], {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Let the team act (size,).

        Returns:
            Observation (size,), reward, whether the task has ended the episode, whether time has, and infos:
            the task's metrics, its `score`, and `bad`: whether physics failed.

        Raises:
            UsageError: The episode is over, the action has another shape, or no `reset` yet.
        """
        if self._next is not None:
            raise UsageError(f"{self.worlds.env.name}: the episode is over; call reset")
        obs, reward, ended, late, infos = self.worlds.step(np.asarray(action, np.float32)[None])
        done = bool(ended[0] or late[0])
        told = {**infos, **infos["final_info"]} if done else infos
        if done:
            self._next, obs = obs[0], infos["final_obs"]
        info = {name: told[name][0] for name in told if not name.startswith(("_", "final_"))}
        return obs[0], float(reward[0]), bool(ended[0]), bool(late[0]), info


def make_world(task: str, seed: int = 0, engine: str = "auto", **fields: Any) -> TeamWorld:  # noqa: ANN401
    """Return what `gymnasium.make` returns.

    Args:
        task: Its name.
        seed: Of a first `reset` without one.
        engine: `warp`, `jax`, `c`, or `auto`.
        fields: Of the task, set otherwise.
    """
    from usarmjx.train.make import make

    fields.pop("render_mode", None)  # which Gymnasium hands over; there are none
    return TeamWorld(make(task, engine=engine, **fields), seed)


def make_worlds(
    task: str,
    num_envs: int = 1,
    robots: Any = "joined",  # noqa: ANN401 - checked where it is used, as the next one
    autoreset: Any = "next_step",  # noqa: ANN401
    seed: int = 0,
    engine: str = "auto",
    **fields: Any,  # noqa: ANN401 - of a task
) -> "VectorWorlds":
    """Return what `gymnasium.make_vec` returns.

    Args:
        task: Its name.
        num_envs: Environments: worlds, or with `each` all their robots.
        robots: See `VectorWorlds`.
        autoreset: See `VectorWorlds`; as Gymnasium's own by default.
        seed: Of a first `reset` without one.
        engine: `warp`, `jax`, `c`, or `auto`.
        fields: Of the task, set otherwise.

    Raises:
        UsageError: Robots of no whole number of worlds.
    """
    from usarmjx.train.adapters.gymnasium import VectorWorlds
    from usarmjx.train.make import make, make_task

    chosen = make_task(task, **fields)
    idle = {name.lower() for name in chosen.scripted}
    share = sum(spec_of(robot).name.lower() not in idle for robot in chosen.robots) if robots == "each" else 1
    if num_envs % share:
        raise UsageError(
            f"num_envs is {num_envs}: {task} has {share} robots in a world, each an environment; ask for a "
            f"multiple of {share}"
        )
    return VectorWorlds(make(task, num_envs // share, engine, **fields), robots, seed, autoreset)
