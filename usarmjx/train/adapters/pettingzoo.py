"""PettingZoo: one world, whose robots are agents that act at the same time."""

from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from usarmjx.base.errors import UsageError, extra
from usarmjx.train.adapters.agents import (
    BINS,
    RENDER_MODES,
    Actions,
    action_grids,
    agents_of,
    alive_names,
    by_agent,
    check_one_world,
    check_render_mode,
    compiled_step,
    draw_seed,
    picture_of,
    stack_actions,
)

with extra("rl"):
    from gymnasium import spaces
    from pettingzoo import ParallelEnv

if TYPE_CHECKING:
    from usarmjx.train.envs.env import Env, EnvState

Values = dict[str, Any]


class ParallelWorld(ParallelEnv[str, np.ndarray, np.ndarray]):
    """An environment of one world as a `pettingzoo.ParallelEnv`.

    `agents` are those that are alive (`Task.presence`): it shrinks when robots drop out, whose end is then
    `terminated`, and grows when others join. Observations at the end of an episode are of that end, not the
    next start.
    `reset` without a seed goes on with the episode after, in the next arena; in the middle of an episode it
    starts anew from a seed that it draws.

    Args:
        env: The environment.
        seed: Of the first episode, and of the seeds that are drawn.
        render_mode: None, or `rgb_array`: `render` returns a picture from above.
        actions: `continuous`, or `discrete`: the action of an agent is a number of a point of its
            `ActionGrid`.
        bins: Values of each action, where they are discrete.

    Raises:
        UsageError: It has several worlds, an unknown render mode, unknown actions, or too many of them.
    """

    def __init__(
        self,
        env: "Env",
        seed: int = 0,
        render_mode: str | None = None,
        *,
        actions: Actions = "continuous",
        bins: int = BINS,
    ) -> None:
        check_one_world(env, "PettingZoo's ParallelEnv")
        self._grids = action_grids(env.groups, actions, bins)
        self.env = env
        check_render_mode(render_mode)
        self.metadata = {
            "name": env.name,
            "render_modes": list(RENDER_MODES),
            "render_fps": max(1, round(1 / env.period)),
            "is_parallelizable": True,
        }
        self.render_mode = render_mode
        self.state_space = spaces.Box(-np.inf, np.inf, (env.privileged_size,), np.float32)
        self.possible_agents = [agent.name for agent in agents_of(env)]
        self.agents: list[str] = []
        self.observation_spaces: dict[str, spaces.Space[np.ndarray]] = {}
        self.action_spaces: dict[str, spaces.Space[Any]] = {}
        for agent in agents_of(env):
            group = env.groups[agent.group]
            self.observation_spaces[agent.name] = spaces.Box(-np.inf, np.inf, (group.obs_size,), np.float32)
            self.action_spaces[agent.name] = (
                spaces.Box(-1.0, 1.0, (group.action_size,), np.float32)
                if self._grids is None
                else spaces.Discrete(self._grids[agent.group].choices)
            )
        self._step = compiled_step(env)
        self._seed = seed
        self._generator = np.random.default_rng(seed)
        self._state: EnvState | None = None

    def observation_space(self, agent: str) -> spaces.Space[np.ndarray]:
        """Return what an agent observes: any numbers (obs_size,)."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """Return what an agent may do: numbers from -1 to 1 (action_size,), or discrete choices."""
        return self.action_spaces[agent]

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Values, Values]:
        """Start an episode; no options are known, and any are ignored, as PettingZoo's own checker wants it.

        Returns:
            Observations (obs_size,) and infos, by agent.
        """
        del options
        if seed is not None:
            self._generator = np.random.default_rng(seed)
        elif self._state is None:
            seed = self._seed
        # In the middle of an episode; after its end the step has begun the next one already.
        elif self.agents:
            seed = draw_seed(self._generator)
        if seed is not None:
            self._state = self.env.reset(seed)
        # One transfer for both.
        now = jax.device_get((self._running.obs, self._running.alive))
        self.agents = alive_names(self.env, now[1])
        obs = _copies(by_agent(self.env, now[0]), self.agents)
        return obs, {agent: {} for agent in self.agents}

    @property
    def _running(self) -> "EnvState":
        if self._state is None:
            raise UsageError(f"{self.env.name}: call reset first")
        return self._state

    def step(self, actions: Values) -> tuple[Values, Values, Values, Values, Values]:
        """Let all agents that are alive act.

        Returns:
            Observations, rewards, whether the task has ended the episode, whether it was cut off, by time or
            a fault, and infos, by agent. Infos have the task's metrics, its `score`, and `bad`: whether the
            step is a fault; then there is also `fault`.

        Raises:
            UsageError: The episode is over, or not each robot has an action of its size.
        """
        before = self._running
        if not self.agents:
            raise UsageError(f"{self.env.name}: the episode is over; call reset")
        self._state = self._step(
            before, stack_actions(self.env, actions, acting=self.agents, grids=self._grids)
        )
        s = jax.device_get(self._state.task_state.replace(memory=()))
        done, bad = bool(s.done[0]), bool(s.bad[0])
        # A fault says nothing about the task, so it cuts off: learners go on with the expected return.
        truncated = bool(s.truncated[0]) or bad
        info = {name: float(value[0]) for name, value in s.metrics.items()}
        info |= {"score": float((s.final_score if done else s.score)[0]), "bad": bad}
        info |= {"fault": True} if bad else {}
        left = alive_names(self.env, s.final_alive)
        # PettingZoo wants the last step of those who leave, and a first one of those who join.
        agents = [*self.agents, *(name for name in left if name not in self.agents)]
        rewards = by_agent(self.env, s.reward)
        # For PettingZoo an episode is over once there are no agents.
        self.agents = [] if done else left
        return (
            _copies(by_agent(self.env, s.final_obs), agents),
            {name: float(rewards[name]) for name in agents},
            {name: name not in left or (done and not truncated) for name in agents},
            {name: truncated and name in left for name in agents},
            {agent: dict(info) for agent in agents},
        )

    def state(self) -> np.ndarray:
        """Return what only critics may know (privileged_size,)."""
        # After the end the state is that of the next start; `final_privileged` is the end's.
        done = not self.agents
        now = self._running
        return np.array((now.final_privileged if done else now.privileged)[0])

    def render(self) -> np.ndarray | None:
        """Return a picture from above (height, width, 3); None without a render mode."""
        return None if self.render_mode is None else picture_of(self.env, self._running)

    def close(self) -> None:
        """Do nothing: there is nothing to close."""


def _copies(values: Values, agents: list[str]) -> Values:
    # Arrays that come from a device cannot be written to, and are views of one that all agents share.
    return {name: np.array(values[name], np.float32) for name in agents}
