"""JaxMARL: one world as a `MultiAgentEnv`, to be mapped over many keys."""

from functools import partial
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp

from usarmjx.base.errors import UsageError, extra
from usarmjx.train.adapters.agents import (
    BINS,
    MAX_SEED,
    Actions,
    action_grids,
    agents_of,
    by_agent,
    check_one_world,
    stack_actions,
)
from usarmjx.train.make import make as make_task_env
from usarmjx.train.tasks import TASKS

with extra("rl"):
    import jaxmarl
    from jaxmarl.environments.multi_agent_env import MultiAgentEnv
    from jaxmarl.environments.spaces import Box, Discrete

if TYPE_CHECKING:
    from usarmjx.train.envs.env import Env, EnvState

Values = dict[str, jax.Array]


class MultiAgentWorld(MultiAgentEnv):
    """An environment of one world as a JaxMARL environment; map it over keys for more.

    Its state is the `EnvState`. A key given to `reset` decides the world's numbers for good: it is reset
    by itself, in its next arena, and draws what it needs from its own key, so the key of `step` is not used.

    Infos have a row for each agent, as JaxMARL's wrappers and baselines expect: the task's metrics, its
    `score`, `truncated`, and `bad`: whether physics failed or a number of the task was not finite, which is
    truncated, too. What agents observed at an episode's end is `state.final_obs`. `world_state` is what
    MAPPO's critics may know.

    Args:
        env: The environment.
        actions: `continuous`, or `discrete`: the action of an agent is a number of a point of its
            `ActionGrid`; a number that is none counts as the nearest one.
        bins: Values of each action, where they are discrete.

    Raises:
        UsageError: It has several worlds, an engine that JAX cannot trace, unknown actions, or too many of
            them.
    """

    def __init__(self, env: "Env", *, actions: Actions = "continuous", bins: int = BINS) -> None:
        check_one_world(env, "JaxMARL's MultiAgentEnv")
        if not env.traceable:
            raise UsageError(
                f"JaxMARL compiles its environments: make {env.name} with engine 'planar', 'jax' or 'warp'"
            )
        roster = agents_of(env)
        super().__init__(num_agents=len(roster))
        self.env = env
        self._grids = action_grids(env.groups, actions, bins)
        self.agents = [agent.name for agent in roster]
        for agent in roster:
            group = env.groups[agent.group]
            self.observation_spaces[agent.name] = Box(-jnp.inf, jnp.inf, (group.obs_size,))
            self.action_spaces[agent.name] = (
                Box(-1.0, 1.0, (group.action_size,))
                if self._grids is None
                else Discrete(self._grids[agent.group].choices)
            )

    @property
    def name(self) -> str:
        """The task's name."""
        return self.env.name

    @property
    def agent_classes(self) -> dict[str, list[str]]:
        """The robots by class."""
        return {group.name: list(group.agents) for group in self.env.groups}

    @partial(jax.jit, static_argnums=0)
    def reset(self, key: jax.Array) -> "tuple[Values, EnvState]":
        """Return observations (obs_size,) by agent, and the state, of a new world."""
        # The environment is seeded by a number; a key is turned into one, as it may be traced here.
        state = self.env.reset(jax.random.randint(key, (), 0, MAX_SEED))  # type: ignore - a traced seed
        return self.get_obs(state), state

    def step_env(
        self, key: jax.Array, state: "EnvState", actions: Values
    ) -> "tuple[Values, EnvState, Values, Values, dict[str, Any]]":
        """Let all robots act; observations are those before a reset, the state is that after it."""
        del key
        state = self.env.step(state, stack_actions(self.env, actions, jnp, grids=self._grids))
        done = state.done[0]
        dones = {**dict.fromkeys(self.agents, done), "__all__": done}
        # Those before the reset: after it everybody is alive again.
        if state.final_alive is not None:
            dones |= {name: done | ~one for name, one in by_agent(self.env, state.final_alive).items()}
        score = jnp.where(state.done, state.final_score, state.score)
        infos = {**state.metrics, "score": score, "truncated": state.truncated | state.bad, "bad": state.bad}
        infos = {name: jnp.broadcast_to(value, (self.num_agents,)) for name, value in infos.items()}
        return by_agent(self.env, state.final_obs), state, by_agent(self.env, state.reward), dones, infos

    @partial(jax.jit, static_argnums=0)
    def step(
        self,
        key: jax.Array,
        state: "EnvState",
        actions: Values,
        reset_state: "EnvState | None" = None,
    ) -> "tuple[Values, EnvState, Values, Values, dict[str, Any]]":
        """Let all robots act; after an episode's end go on at the next one's start, or at `reset_state`."""
        # The base class would reset by `reset`, whose whole new world costs far more at every step.
        _, state, rewards, dones, infos = self.step_env(key, state, actions)
        if reset_state is not None:
            state = jax.tree.map(partial(jnp.where, dones["__all__"]), reset_state, state)
        return self.get_obs(state), state, rewards, dones, infos

    def get_obs(self, state: "EnvState") -> Values:
        """Return what each agent observes now (obs_size,)."""
        return by_agent(self.env, state.obs)

    def world_state(self, state: "EnvState") -> jax.Array:
        """Return what only critics may know (privileged_size,)."""
        return state.privileged[0]

    def world_state_size(self) -> int:
        """Return the size of `world_state`."""
        return self.env.privileged_size

    @partial(jax.jit, static_argnums=0)
    def get_avail_actions(self, state: "EnvState") -> Values:
        """Return which actions are available: those of agents that are alive, of goals those that are there.

        Values are (action_size,); with discrete actions they are (choices,).
        """
        alive = None if state.alive is None else by_agent(self.env, state.alive)
        sizes = [group.action_size for group in self.env.groups]
        if self._grids is not None:
            sizes = [grid.choices for grid in self._grids]
        masks, obs = Values(), self.get_obs(state)
        for agent in agents_of(self.env):
            size, name = sizes[agent.group], agent.name
            there = obs[name][-size:] > 0.5 if self.env.groups[agent.group].discrete else jnp.full(size, True)
            masks[name] = there if alive is None else there & alive[name]
        return masks


PREFIX = "usarmjx/"
"""Begin of the names by which `jaxmarl.make` knows tasks."""


def register_worlds() -> None:
    """Let `jaxmarl.make` know all tasks, as `usarmjx/explore-v3`: programs of JaxMARL run unchanged.

    Keywords are those of `MultiAgentWorld`, and `engine` and fields of the task for the environment.
    """
    library: Any = jaxmarl
    before = library.make
    if hasattr(before, "with_usarmjx"):
        return

    def make(env_id: str, **keywords: Any) -> Any:  # noqa: ANN401 - of any task, or JaxMARL's own
        if not env_id.startswith(PREFIX):
            return before(env_id, **keywords)
        own = {name: keywords.pop(name) for name in ("actions", "bins") if name in keywords}
        engine = keywords.pop("engine", "planar")
        return MultiAgentWorld(make_task_env(env_id.removeprefix(PREFIX), engine=engine, **keywords), **own)

    setattr(make, "with_usarmjx", True)  # noqa: B010 - a function has no such field for type checkers
    library.make = make
    library.registered_envs += [f"{PREFIX}{name}" for name in TASKS.names()]
