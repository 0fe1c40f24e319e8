"""JaxMARL: one world as a `MultiAgentEnv`, to be mapped over many keys."""

import runpy
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import jax
import jax.numpy as jnp

from usarmjx.base.errors import UsageError, extra
from usarmjx.base.settings.text import parse_assignments
from usarmjx.train.adapters.agents import (
    BINS,
    MAX_SEED,
    Actions,
    action_grids,
    agents_of,
    by_agent,
    check_one_world,
    own_keywords,
    stack_actions,
)
from usarmjx.train.make import make as make_task_env
from usarmjx.train.make import make_task, task_values
from usarmjx.train.tasks import TASKS

with extra("rl"):
    import jaxmarl
    from jaxmarl.environments.multi_agent_env import MultiAgentEnv
    from jaxmarl.environments.spaces import Box, Discrete

if TYPE_CHECKING:
    from usarmjx.train.envs.env import Env, EnvState

Values = dict[str, jax.Array]
Convention = Literal["plain", "smax"]


class MultiAgentWorld(MultiAgentEnv):
    """An environment of one world as a JaxMARL environment; map it over keys for more.

    Its state is the `EnvState` without the arenas that worlds go through: all worlds share one copy of them.
    A key given to `reset` decides the world's numbers for good: it begins its later episodes in its next
    arenas and draws what it needs from its own key, so the key of `step` is not used.

    Infos have a row for each agent, as JaxMARL's wrappers and baselines expect: the task's metrics, its
    `score`, `truncated`, and `bad`: whether physics failed or a number of the task was not finite, which is
    truncated, too. The last observations of an episode are `state.final_obs`. `world_state` is what MAPPO's
    critics may know.

    Args:
        env: The environment.
        actions: `continuous`, or `discrete`: the action of an agent is a number of a point of its
            `ActionGrid`, () or (1,); a number that is none counts as the nearest one. None: discrete where
            agents choose one of several things.
        bins: Values of each action, where they are discrete.
        convention: `smax`: as in JaxMARL's SMAX observations have `world_state`, each agent's reward is the
            sum of all, and the name ends with `-smax`, by which JaxMARL's Q-learning programs know that they
            are to ask for masks and that state.

    Raises:
        UsageError: It has several worlds, an engine that JAX cannot trace, unknown actions, or too many of
            them; or an unknown convention.
    """

    def __init__(
        self,
        env: "Env",
        *,
        actions: Actions | None = None,
        bins: int = BINS,
        convention: Convention = "plain",
    ) -> None:
        check_one_world(env, "JaxMARL's MultiAgentEnv")
        if not env.traceable:
            raise UsageError(
                f"JaxMARL compiles its environments: make {env.name} with engine 'planar', 'jax' or 'warp'"
            )
        if convention not in get_args(Convention):
            raise UsageError(f"convention is {convention!r}, allowed are 'plain' and 'smax'")
        roster = agents_of(env)
        # The base class makes the dictionaries of spaces, which are filled below.
        super().__init__(num_agents=len(roster))
        self.env, self._smax = env, convention == "smax"
        # Closed over, not carried: in the state, which is mapped, each world would have a copy.
        self._arenas = env.arenas_at(1.0)
        choosing = all(group.discrete and not group.vector.size for group in env.groups)
        self._grids = action_grids(env.groups, actions or ("discrete" if choosing else "continuous"), bins)
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
        return f"{self.env.name}-smax" if self._smax else self.env.name

    @property
    def max_steps(self) -> int:
        """Steps of an episode at most."""
        return self.env.episode_steps

    @property
    def agent_classes(self) -> dict[str, list[str]]:
        """The robots by class."""
        return {group.name: list(group.agents) for group in self.env.groups}

    def _with(self, state: "EnvState", arenas: Any) -> "EnvState":  # noqa: ANN401 - a tree of arrays
        """Return a state whose worlds go through those arenas."""
        return state if self._arenas is None else state.replace(batch=state.batch.replace(arenas=arenas))

    @partial(jax.jit, static_argnums=0)
    def reset(self, key: jax.Array) -> "tuple[Values, EnvState]":
        """Return observations (obs_size,) by agent, and the state, of a new world."""
        # The environment is seeded by a number; a key is turned into one, as it may be traced here.
        state = self.env.reset(jax.random.randint(key, (), 0, MAX_SEED))  # type: ignore - a traced seed
        state = self._with(state, None)
        return self.get_obs(state), state

    def step_env(
        self, key: jax.Array, state: "EnvState", actions: Values
    ) -> "tuple[Values, EnvState, Values, Values, dict[str, Any]]":
        """Let all robots act; a world that is done stays at its end."""
        del key
        state = self._with(state, self._arenas)
        state = self._with(self.env.advance(state, self._stacked(actions)), None)
        done = state.done[0]
        dones = {**dict.fromkeys(self.agents, done), "__all__": done}
        if state.alive is not None:
            # An agent that has dropped out is done, though its world goes on.
            dones |= {name: done | ~one for name, one in by_agent(self.env, state.alive).items()}
        rewards = by_agent(self.env, state.reward)
        if self._smax:
            rewards = dict.fromkeys(rewards, jnp.stack([*rewards.values()]).sum())
        infos = {
            **state.metrics,
            "score": state.score,
            # A fault says nothing about the task, so it cuts the episode off.
            "truncated": state.truncated | state.bad,
            "bad": state.bad,
        }
        infos = {name: jnp.broadcast_to(value, (self.num_agents,)) for name, value in infos.items()}
        return self.get_obs(state), state, rewards, dones, infos

    @partial(jax.jit, static_argnums=0)
    def step(
        self,
        key: jax.Array,
        state: "EnvState",
        actions: Values,
        reset_state: "EnvState | None" = None,
    ) -> "tuple[Values, EnvState, Values, Values, dict[str, Any]]":
        """Let all robots act; after an episode's end go on at the next one's start, or at `reset_state`."""
        _, state, rewards, dones, infos = self.step_env(key, state, actions)
        # The base class would reset by `reset`, whose whole new world costs far more at every step.
        if reset_state is None:
            state = self._with(self.env.restart(self._with(state, self._arenas), state.done), None)
        else:
            state = jax.tree.map(partial(jnp.where, dones["__all__"]), reset_state, state)
        return self.get_obs(state), state, rewards, dones, infos

    def _stacked(self, actions: Values) -> tuple[Any, ...]:
        """Return actions by group (1, robots, action_size)."""
        if self._grids is not None:
            # JaxMARL's IPPO and MAPPO give a choice as an array of one.
            actions = {name: jnp.squeeze(jnp.asarray(choice)) for name, choice in actions.items()}
        return stack_actions(self.env, actions, jnp, grids=self._grids)

    def get_obs(self, state: "EnvState") -> Values:
        """Return what each agent observes now (obs_size,)."""
        seen = by_agent(self.env, state.obs)
        return {**seen, "world_state": self.world_state(state)} if self._smax else seen

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
        masks, obs = Values(), by_agent(self.env, state.obs)
        for agent in agents_of(self.env):
            size, name = sizes[agent.group], agent.name
            group, there = self.env.groups[agent.group], jnp.full(size, True)
            if group.discrete:
                there = there.at[: group.choices].set(obs[name][-group.choices :] > 0.5)
            masks[name] = there if alive is None else there & alive[name]
        return masks

    def get_legal_moves(self, state: "EnvState") -> Values:
        """Return `get_avail_actions`, by the name that JaxMARL's programs for Hanabi use."""
        return self.get_avail_actions(state)


PREFIXES = ("usarmjx/", "usarmjx_")
"""Begins of the names by which `jaxmarl.make` knows tasks; programs that put names into file names need the
second."""


def register_worlds() -> None:
    """Let `jaxmarl.make` know all tasks, as `usarmjx/explore-v3`: programs of JaxMARL run unchanged.

    Keywords are those of `MultiAgentWorld`, and `engine` and fields of the task for the environment; where a
    program passes no keywords on, the name has them, as `usarmjx_explore-v3?count=2&bins=3`. A field of the
    task that is also called `actions` takes all values but those of `MultiAgentWorld`, and `bins` alone asks
    for discrete actions.
    """
    library: Any = jaxmarl
    before = library.make
    # A second call would wrap our own `make`, and list the tasks twice.
    if hasattr(before, "with_usarmjx"):
        return

    def make(env_id: str, **keywords: Any) -> Any:  # noqa: ANN401 - of any task, or JaxMARL's own
        if not env_id.startswith(PREFIXES):
            return before(env_id, **keywords)
        # Both prefixes have the same length.
        task, _, settings = env_id[len(PREFIXES[0]) :].partition("?")
        return make_world(task, settings.split("&") if settings else (), **keywords)

    setattr(make, "with_usarmjx", True)  # noqa: B010 - a function has no such field for type checkers
    library.make = make
    library.registered_envs += [f"{prefix}{name}" for name in TASKS.names() for prefix in PREFIXES]


def make_world(task: str, settings: Sequence[str] = (), **keywords: Any) -> MultiAgentWorld:  # noqa: ANN401
    """Return what `jaxmarl.make` returns.

    Args:
        task: Its name.
        settings: Keywords as texts, `name=value` each.
        keywords: See `register_worlds`.

    Raises:
        UsageError: A setting twice, or of a value that is not allowed.
    """
    texts: dict[str, Any] = {**parse_assignments(settings, task)}
    if twice := sorted(texts.keys() & keywords.keys()):
        raise UsageError(f"{task}: {twice[0]} is in the name and in the keywords")
    own = own_keywords(texts) | own_keywords(keywords)
    for name in ("engine", "convention"):
        if name in (given := texts if name in texts else keywords):
            own[name] = given.pop(name)
    if isinstance(bins := own.get("bins"), str):
        if not bins.isdigit():
            raise UsageError(f"{task}: bins is {bins!r}, expected a whole number")
        own["bins"] = int(bins)
    # `auto` would take engine c on a CPU, which JAX cannot trace.
    engine = own.pop("engine", "planar")
    fields = task_values(make_task(task), texts, task) | keywords
    return MultiAgentWorld(make_task_env(task, engine=engine, **fields), **own)


def main() -> None:
    """Run a program of JaxMARL, in which `jaxmarl.make` knows our tasks; arguments: its file, and its own.

    As `python -m usarmjx.train.adapters.jaxmarl ippo_rnn_mpe.py ENV_NAME=usarmjx_explore-v3`.
    """
    sys.argv = sys.argv[1:]
    if not sys.argv:
        sys.exit("expected the file of a program of JaxMARL, and its arguments")
    if not Path(sys.argv[0]).is_file():
        sys.exit(f"{sys.argv[0]} is no file: expected a program, as in baselines of JaxMARL's repository")
    register_worlds()
    # As Python does for a program that it starts; runpy leaves the path of modules as it is.
    sys.path.insert(0, str(Path(sys.argv[0]).parent))
    runpy.run_path(sys.argv[0], run_name="__main__")


if __name__ == "__main__":
    main()
