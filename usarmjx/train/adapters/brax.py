"""Brax: a batch as a `brax.envs.Env` whose batch axis is worlds times robots, for Brax's own tools."""

from typing import TYPE_CHECKING, Any, cast

import jax
import jax.numpy as jnp

from usarmjx.base.errors import extra
from usarmjx.train.adapters.agents import MAX_SEED, check_one_group

with extra("train"):
    from brax.envs.base import Env as BraxEnv
    from brax.envs.base import State

if TYPE_CHECKING:
    from usarmjx.train.envs.env import Env, EnvState


class BatchedRobots(BraxEnv):
    """An environment whose robots, of all worlds, are the batch of a Brax environment.

    It is batched and resets its worlds by itself, so none of Brax's `VmapWrapper`, `EpisodeWrapper` and
    `AutoResetWrapper` goes around it. Infos have `truncation`, by which Brax's learners tell time-outs and
    faults from ends, `steps` of the running episode, `final_obs` before a reset, `bad`: whether physics
    failed or a number of the task was not finite, and `alive` where agents may drop out. If its
    engine is not traceable, neither is `step`.

    Args:
        env: The environment.
        privileged: Whether observations are a dictionary of `state` and, for Brax's `value_obs_key`,
            `privileged_state`: what only critics may know.

    Raises:
        UsageError: Its robots are of several classes.
    """

    def __init__(self, env: "Env", privileged: bool = False) -> None:
        check_one_group(env, "Brax")
        self.env, self._privileged = env, privileged
        self._robots = len(env.groups[0].agents)

    @property
    def observation_size(self) -> Any:  # noqa: ANN401 - a number, or shapes by name as Brax takes them
        """Numbers that a robot observes; with `privileged` the shapes by name."""
        size = self.env.groups[0].obs_size
        if not self._privileged:
            return size
        return {"state": (size,), "privileged_state": (self.env.privileged_size,)}

    @property
    def action_size(self) -> int:
        """Numbers from -1 to 1 that a robot decides."""
        return self.env.groups[0].action_size

    @property
    def backend(self) -> str:
        """Its driver."""
        return "mujoco"

    def reset(self, rng: jax.Array) -> State:
        """Return all worlds at their start.

        Args:
            rng: One key for all; of several (n,) the first counts.
        """
        key: jax.Array = rng
        # Brax hands out keys of JAX's earlier kind, which are plain numbers.
        if not jnp.issubdtype(rng.dtype, jax.dtypes.prng_key):
            key = cast(Any, jax.random).wrap_key_data(rng)  # whose result jax leaves without a type
        # Brax's learners pass a key for each row of the batch; all worlds here follow from one.
        seed = jax.random.randint(jnp.ravel(key)[0], (), 0, MAX_SEED)
        return self._state(self.env.reset(seed if self.env.traceable else int(seed)))  # type: ignore - traced

    def step(self, state: State, action: jax.Array) -> State:
        """Let all robots act (worlds * robots, action_size)."""
        before: Any = state.pipeline_state
        size = (self.env.worlds, self._robots, self.action_size)
        return self._state(self.env.step(before, (jnp.asarray(action).reshape(size),)))

    def _spread(self, values: jax.Array) -> jax.Array:
        """Return values by world (worlds,) by robot (worlds * robots,), as Brax's floats."""
        return jnp.repeat(jnp.asarray(values, jnp.float32), self._robots)

    def _observed(self, now: "EnvState") -> Any:  # noqa: ANN401 - an array, or arrays by name
        state = self._rows(now.obs[0])
        if not self._privileged:
            return state
        return {"state": state, "privileged_state": jnp.repeat(now.privileged, self._robots, 0)}

    def _rows(self, values: jax.Array) -> jax.Array:
        return values.reshape(-1, values.shape[-1])

    def _state(self, now: "EnvState") -> State:
        whole: Any = now
        return State(
            pipeline_state=whole,
            obs=self._observed(now),
            reward=now.reward[0].reshape(-1),
            done=self._spread(now.done),
            metrics={name: self._spread(value) for name, value in now.metrics.items()},
            info={
                **({} if now.alive is None else {"alive": now.alive[0].reshape(-1).astype(jnp.float32)}),
                # A fault cuts off: learners go on with the expected return.
                "truncation": self._spread(now.truncated | now.bad),
                "steps": self._spread(now.length),
                "final_obs": self._rows(now.final_obs[0]),
                "bad": self._spread(now.bad),
                "score": self._spread(now.score),
            },
        )
