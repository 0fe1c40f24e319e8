"""Gymnasium: a batch as a vector environment, with one agent per world or one per robot.

Importing this registers an id for each task: see `gymnasium_ids`.
"""

from typing import TYPE_CHECKING, Any, Literal

import jax
import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.errors import UsageError
from usarmjx.base.extras import extra
from usarmjx.train.adapters.agents import check_one_group, compiled_step, draw_seed, with_held
from usarmjx.train.adapters.gymnasium_ids import register_ids

with extra("rl"):
    from gymnasium import spaces
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space

if TYPE_CHECKING:
    from usarmjx.train.envs.env import Env, EnvState

register_ids()

Robots = Literal["joined", "each"]
Autoreset = Literal["same_step", "next_step"]
MODES = {"same_step": AutoresetMode.SAME_STEP, "next_step": AutoresetMode.NEXT_STEP}


class VectorWorlds(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """An environment as a `gymnasium.vector.VectorEnv`.

    Gymnasium has one agent per environment, robots come in teams: `joined` makes each world one environment,
    whose observation and action are those of all its robots, one after the other, group by group, and whose
    reward is their mean; `each` makes each robot of each world an environment of its own (world by world),
    and needs robots of one class. Where worlds have one robot both are the same.

    Where a world is reset in the step that ends its episode (`AutoresetMode.SAME_STEP`), observations are
    those of the next start, and `final_obs` and `final_info` of the infos have the end, as Gymnasium's own
    vector environments give them. With `AutoresetMode.NEXT_STEP` they are those of the end, and the step
    after gives those of the next start: it leaves the world as it is, whatever the action, and is worth 0.
    Infos have the task's metrics and `score`, and `bad`: whether physics failed, so that the transition is
    worth nothing.

    Args:
        env: The environment.
        robots: What an agent is.
        seed: Of a first `reset` without one.
        autoreset: When worlds are reset; Gymnasium's NormalizeObservation and others want `next_step`.

    Raises:
        UsageError: `each` with robots of several classes; something else than the modes that there are.
    """

    def __init__(
        self, env: "Env", robots: Robots = "joined", seed: int = 0, autoreset: Autoreset = "same_step"
    ) -> None:
        if robots not in ("joined", "each"):
            raise UsageError(f"robots is {robots!r}, allowed are 'joined' and 'each'")
        if autoreset not in MODES:
            raise UsageError(f"autoreset is {autoreset!r}, allowed are 'same_step' and 'next_step'")
        self.env = env
        self.metadata = {"render_modes": [], "autoreset_mode": MODES[autoreset]}
        self._next_step = autoreset == "next_step"
        self._over = np.zeros(env.worlds, bool)
        self._hold = jax.jit(with_held) if env.traceable else with_held
        self._each = robots == "each"
        if self._each:
            check_one_group(env, "a Gymnasium environment for each robot")
        counts = [len(group.agents) for group in env.groups]
        share = counts if self._each else [1]
        self.num_envs = env.worlds * share[0]
        widths = [1 if self._each else count for count in counts]
        pairs = list(zip(widths, env.groups, strict=True))
        obs, action = (sum(n * getattr(g, f"{what}_size") for n, g in pairs) for what in ("obs", "action"))
        self.single_observation_space = spaces.Box(-np.inf, np.inf, (obs,), np.float32)
        self.single_action_space = spaces.Box(-1.0, 1.0, (action,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._action_shape = (self.num_envs, action)
        self._step = compiled_step(env)
        self._seed = seed
        self._state: EnvState | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode in every world.

        Args:
            seed: Of all random numbers; None: one that follows from the seed before.
            options: None are known, and others are ignored.

        Raises:
            UsageError: A `reset_mask` among the options: worlds restart by themselves.
        """
        if options and "reset_mask" in options:
            raise UsageError("reset_mask is for AutoresetMode.DISABLED; these worlds restart by themselves")
        if seed is None and self._np_random is None:
            seed = self._seed
        super().reset(seed=seed)
        chosen = draw_seed(self.np_random) if seed is None else seed
        self._state = self.env.reset(chosen)
        self._over[:] = False
        return self._rows(jax.device_get(self._state.obs)), {}

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Let every agent act.

        Args:
            actions: Numbers from -1 to 1 (num_envs, size).

        Returns:
            Observations (num_envs, size), rewards (num_envs,), whether the task has ended the episode,
            whether time has, and infos.

        Raises:
            UsageError: Actions of another shape, or no `reset` yet.
        """
        if self._state is None:
            raise UsageError(f"{self.env.name}: call reset first")
        before, held = self._state, self._over
        self._state = self._step(before, self._groups(np.asarray(actions, np.float32)))
        if held.any():
            self._state = self._hold(before, self._state, held)
        s = jax.device_get(self._state.task_state.replace(memory=()))
        done, late = s.done & ~held, s.truncated & ~held
        reward = s.reward[0].reshape(-1) if self._each else np.concatenate(s.reward, -1).mean(-1)
        if self._next_step:
            self._over = np.array(done)
        return (
            self._obs(s, done),
            np.where(self._spread(held), 0.0, np.float64(reward)),
            self._spread(done & ~late),
            self._spread(late),
            self._infos(s, self._spread(done), self._spread(held)),
        )

    def _groups(self, actions: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return actions by group (worlds, robots, action_size)."""
        if actions.shape != self._action_shape:
            raise UsageError(f"actions: shape {actions.shape}, expected {self._action_shape}")
        sizes = [len(group.agents) * group.action_size for group in self.env.groups]
        parts = np.split(actions.reshape(self.env.worlds, -1), np.cumsum(sizes)[:-1], -1)
        shapes = [(self.env.worlds, len(group.agents), group.action_size) for group in self.env.groups]
        return tuple(part.reshape(shape) for part, shape in zip(parts, shapes, strict=True))

    def _obs(self, s: "EnvState", done: np.ndarray) -> np.ndarray:
        """Return what the agents see (num_envs, size): with `next_step` the end where worlds are done."""
        start = self._rows(s.obs)
        if not (self._next_step and done.any()):
            return start
        return np.where(self._spread(done)[:, None], self._rows(s.final_obs), start)

    def _rows(self, values: tuple[Array, ...]) -> np.ndarray:
        """Return values by group (worlds, robots, size) as new rows by agent (num_envs, size)."""
        flat = [np.reshape(value, (self.env.worlds, -1)) for value in values]
        return np.concatenate(flat, -1, dtype=np.float32).reshape(self.num_envs, -1)

    def _spread(self, values: Array) -> np.ndarray:
        """Return values by world (worlds,) as new ones by agent (num_envs,)."""
        return np.repeat(np.asarray(values), self.num_envs // self.env.worlds)

    def _infos(self, s: "EnvState", done: np.ndarray, held: np.ndarray) -> dict[str, Any]:
        """Return infos in Gymnasium's form: each key has a mask of whom it is about, under _key."""
        score, bad = self._spread(s.score), self._spread(s.bad) & ~held
        metrics = {name: self._spread(value) for name, value in s.metrics.items()}
        if self._next_step:
            score = np.where(done, self._spread(s.final_score), score)
            return _masked({"score": score, "bad": bad}, np.ones_like(done)) | _masked(metrics, ~held)
        infos = _masked({"score": score, "bad": bad}, np.ones_like(done))
        infos |= _masked(metrics, ~done)
        if done.any():
            ends = np.full(self.num_envs, None, object)
            final = self._rows(s.final_obs)
            for i in np.flatnonzero(done):
                ends[i] = final[i].copy()
            ends_info = {name: value.copy() for name, value in metrics.items()}
            ends_info["score"] = self._spread(s.final_score)
            infos |= _masked({"final_obs": ends, "final_info": _masked(ends_info, done)}, done)
        return infos


def _masked(values: dict[str, Any], mask: np.ndarray) -> dict[str, Any]:
    return {**values, **{f"_{name}": mask.copy() for name in values}}
