"""Stable-Baselines3: a batch as a VecEnv, with one agent per world or one per robot."""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from usarmjx.base.errors import extra
from usarmjx.train.adapters.agents import BINS, Actions
from usarmjx.train.adapters.gymnasium import Robots, VectorWorlds

with extra("sb3"):
    from stable_baselines3.common.vec_env import VecEnv  # pyright: ignore[reportMissingModuleSource]

if TYPE_CHECKING:
    from usarmjx.train.envs.env import Env

Indices = int | Iterable[int] | None


class BaselinesWorlds(VecEnv):
    """An environment as a VecEnv of Stable-Baselines3; agents are as in `VectorWorlds`.

    Infos are a dictionary for each agent: the task's metrics, `score`, and `bad`, whether physics failed or a
    number of the task was not finite. At an episode's end they have `terminal_observation`, and
    `TimeLimit.truncated` where its time was up or the step was a fault, then also `fault`.

    Args:
        env: The environment.
        robots: Kind of agent.
        seed: Of a first `reset` without one.
        render_mode: None, or `rgb_array`: pictures from above for VecVideoRecorder.
        actions: `continuous`, or `discrete`, as in `VectorWorlds`.
        bins: Values of each action, where they are discrete.

    Raises:
        UsageError: `each` with robots of several classes, an unknown render mode, unknown actions, or too
            many of them.
    """

    def __init__(
        self,
        env: "Env",
        robots: Robots = "joined",
        seed: int = 0,
        render_mode: str | None = None,
        *,
        actions: Actions = "continuous",
        bins: int = BINS,
    ) -> None:
        # Before the base class, whose start calls `get_attr`.
        self.worlds: Any = VectorWorlds(
            env, robots, seed, render_mode=render_mode, actions=actions, bins=bins
        )
        self.render_mode = render_mode
        self._actions = np.zeros(self.worlds.action_space.shape, self.worlds.action_space.dtype)
        spaces = self.worlds.single_observation_space, self.worlds.single_action_space
        super().__init__(self.worlds.num_envs, *spaces)

    def reset(self) -> np.ndarray:
        """Start an episode in every world, of the seed that `seed` was given.

        Returns:
            Observations (num_envs, size).
        """
        # `VecEnv.seed` gives each agent a seed of its own, the first of which is as it was given; the worlds
        # have one.
        seed = self._seeds[0]
        obs, _ = self.worlds.reset(seed=seed)
        self.reset_infos = [{} for _ in range(self.num_envs)]
        # Seeds and options count for one reset, as in the library's own classes.
        self._reset_seeds()
        self._reset_options()
        return obs

    def step_async(self, actions: np.ndarray) -> None:
        """Take the actions (num_envs, size)."""
        self._actions = np.asarray(actions)

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Let every agent act.

        Returns:
            Observations (num_envs, size), rewards (num_envs,), whether episodes have ended, and infos.
        """
        obs, reward, ended, late, infos = self.worlds.step(self._actions)
        told = [self._info(infos, late, i) for i in range(self.num_envs)]
        # Its buffers have rewards in single precision.
        return obs, reward.astype(np.float32), ended | late, told

    @staticmethod
    def _info(infos: dict[str, Any], late: np.ndarray, i: int) -> dict[str, Any]:
        """Return what is told of one agent."""
        over = "final_obs" in infos and infos["final_obs"][i] is not None
        found = {**infos, **infos["final_info"]} if over else infos
        info = {name: found[name][i] for name in found if not name.startswith(("_", "final_"))}
        if not info.get("fault", True):
            del info["fault"]  # of another one
        info["TimeLimit.truncated"] = bool(late[i])
        return info | ({"terminal_observation": infos["final_obs"][i]} if over else {})

    def get_images(self) -> Sequence[np.ndarray | None]:
        """Return a picture of each agent's world from above (height, width, 3)."""
        pictures = self.worlds.render() or (None,) * self.worlds.env.worlds
        # With `each`, the robots of a world share its picture.
        share = self.num_envs // len(pictures)
        return [picture for picture in pictures for _ in range(share)]

    def close(self) -> None:
        """Do nothing: there is nothing to close."""

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """Return an attribute of the environment once for each agent: they share it."""
        # The base class and recorders of videos ask for `render_mode`, which the environment does not have.
        value = getattr(self if attr_name == "render_mode" else self.worlds.env, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:  # noqa: ANN401
        """Set an attribute of the environment, which all agents share."""
        del indices
        setattr(self.worlds.env, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Indices = None, **kwargs: Any) -> list[Any]:  # noqa: ANN401
        """Call a method of the environment once, and return what it does once for each agent."""
        value = getattr(self.worlds.env, method_name)(*args, **kwargs)
        return [value for _ in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type[Any], indices: Indices = None) -> Sequence[bool]:
        """Return that no agent's environment is wrapped by itself."""
        del wrapper_class
        return [False for _ in self._get_indices(indices)]
