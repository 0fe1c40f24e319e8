"""Gymnasium: a batch as a vector environment, with one agent per world or one per robot.

Importing this registers an id for each task: see `gymnasium_ids`.
"""

import re
from typing import TYPE_CHECKING, Any, Literal, cast

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.backend import Array
from usarmjx.base.errors import UsageError, extra
from usarmjx.train.adapters.agents import (
    BINS,
    RENDER_MODES,
    Actions,
    action_grids,
    check_no_options,
    check_one_group,
    check_render_mode,
    compiled_step,
    draw_seed,
    own_keywords,
    picture_of,
    with_held,
)
from usarmjx.train.envs.recipe import spec_of
from usarmjx.train.tasks import TASKS

if TYPE_CHECKING:
    from usarmjx.train.envs.env import Env, EnvState


with extra("rl"):
    import gymnasium


NAMESPACE = "usarmjx"
HERE = "usarmjx.train.adapters.gymnasium"
VERSION = re.compile(r"(.+)-v(\d+)")


def id_of(task: str) -> str:
    """Return the id of a registered task; of a bare name that of the newest version."""
    task = TASKS.full_name(task)
    if VERSION.fullmatch(task):
        return f"{NAMESPACE}/{task}"
    found = [(one, VERSION.fullmatch(name)) for name, one in TASKS]
    versions = {int(match[2]): one for one, match in found if match and match[1] == task}
    same = [number for number, one in versions.items() if one is TASKS.get(task)]
    # The id of the version that is the same task; one that differs from all of them gets the next number.
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


class TeamWorld(gymnasium.Env[np.ndarray, Any]):
    """One world as a `gymnasium.Env`, whose agent is the whole team, as `VectorWorlds` joins it.

    The world stays at the end of its episode, and pictures and `state` show that end, until `reset`: without
    a seed it goes on with the episode after, in the next arena; in the middle of an episode it starts anew
    from a seed that it draws.

    Args:
        env: An environment of one world.
        seed: Of a first `reset` without one.
        render_mode: None, or `rgb_array`: `render` returns a picture from above.
        actions: `continuous`, or `discrete`, as in `VectorWorlds`.
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
        from usarmjx.train.adapters.agents import check_one_world

        check_one_world(env, "a gymnasium.Env")
        self.metadata = {"render_modes": list(RENDER_MODES), "render_fps": max(1, round(1 / env.period))}
        self.render_mode = render_mode
        self.worlds: Any = _LastingWorlds(env, seed=seed, render_mode=render_mode, actions=actions, bins=bins)
        self.observation_space = self.worlds.single_observation_space
        self.action_space = self.worlds.single_action_space
        self._over = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode.

        Returns:
            Observation (size,), and infos.

        Raises:
            UsageError: Any options: none are known.
        """
        check_no_options(options)
        super().reset(seed=seed)
        over, self._over = self._over, False
        if seed is None and over:
            return self.worlds.go_on()[0], {}
        return self.worlds.reset(seed=seed)[0][0], {}

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:  # noqa: ANN401
        """Let the team act (size,); with discrete actions it is a number, or one of each robot (robots,).

        Returns:
            Observation (size,), reward, whether the task has ended the episode, whether it was cut off, and
            infos: the task's metrics, its `score`, and `bad`: whether the step is a fault, which cuts the
            episode off; then there is also `fault`.

        Raises:
            UsageError: The episode is over, the action has another shape, or no `reset` yet.
        """
        if self._over:
            raise UsageError(f"{self.worlds.env.name}: the episode is over; call reset")
        obs, reward, ended, late, infos = self.worlds.step(np.asarray(action)[None])
        self._over = bool(ended[0] or late[0])
        # The score of a finished episode stands in `final_info` only.
        told = {**infos, **infos["final_info"]} if self._over else infos
        # Masks, and what ends a vector's episodes, mean nothing for one world.
        info = {name: told[name][0] for name in told if not name.startswith(("_", "final_"))}
        return obs[0], float(reward[0]), bool(ended[0]), bool(late[0]), info

    def render(self) -> Any:  # noqa: ANN401 - an array, or None without a render mode
        """Return a picture of the world from above (height, width, 3)."""
        pictures = self.worlds.render()
        return None if pictures is None else pictures[0]

    def state(self) -> np.ndarray:
        """Return what only critics may know (privileged_size,)."""
        return self.worlds.state()[0]


def make_world(
    task: str,
    seed: int = 0,
    engine: str = "auto",
    render_mode: str | None = None,
    **fields: Any,  # noqa: ANN401 - of a task
) -> TeamWorld:
    """Return what `gymnasium.make` returns.

    Args:
        task: Its name.
        seed: Of a first `reset` without one.
        engine: `warp`, `jax`, `c`, or `auto`.
        render_mode: None or `rgb_array`.
        fields: `actions` and `bins` as in `VectorWorlds`; and fields of the task, set otherwise.
    """
    from usarmjx.train.make import make

    check_render_mode(render_mode)
    given = own_keywords(fields)
    return TeamWorld(make(task, engine=engine, **fields), seed, render_mode, **given)


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
        fields: `render_mode`, None or `rgb_array`; `max_episode_steps`, after which an episode is truncated;
            `actions` and `bins` as in `VectorWorlds`; and fields of the task, set otherwise.

    Raises:
        UsageError: Robots of no whole number of worlds, an unknown render mode, or two time limits.
    """
    from usarmjx.train.make import make, make_task

    # Out of the fields, which all go to the task.
    render_mode, max_episode_steps = (fields.pop(name, None) for name in ("render_mode", "max_episode_steps"))
    check_render_mode(render_mode)
    given = own_keywords(fields)
    if max_episode_steps is not None:
        if "episode_steps" in fields:
            raise UsageError("max_episode_steps and episode_steps are the same limit, expected one of them")
        # Gymnasium's limit truncates; the task's own may count as its end.
        fields |= {"episode_steps": max_episode_steps, "time_limit": "truncation"}
    chosen = make_task(task, **fields)
    # Scripted robots are no agents, so they are no environments either.
    idle = {name.lower() for name in chosen.scripted}
    share = sum(spec_of(robot).name.lower() not in idle for robot in chosen.robots) if robots == "each" else 1
    if num_envs % share:
        raise UsageError(
            f"num_envs is {num_envs}: {task} has {share} robots in a world, each an environment; ask for a "
            f"multiple of {share}"
        )
    env = make(task, num_envs // share, engine, **fields)
    return VectorWorlds(env, robots, seed, autoreset, render_mode, **given)


with extra("rl"):
    from gymnasium import spaces
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space


register_ids()

Robots = Literal["joined", "each"]
Autoreset = Literal["same_step", "next_step"]
MODES = {"same_step": AutoresetMode.SAME_STEP, "next_step": AutoresetMode.NEXT_STEP}


class VectorWorlds(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """An environment as a `gymnasium.vector.VectorEnv`.

    Gymnasium has one agent per environment, robots come in teams: `joined` makes each world one environment,
    whose observation and action are those of all its robots, one after the other, group by group, and whose
    reward is their mean; `each` makes each robot of each world an environment of its own (world by world),
    and needs robots of one class. If worlds have one robot, both are the same.

    If a world is reset in the step that ends its episode (`AutoresetMode.SAME_STEP`), observations are
    those of the next start, and `final_obs` and `final_info` of the infos have the end, as Gymnasium's own
    vector environments give them. With `AutoresetMode.NEXT_STEP` they are those of the end, and the step
    after gives those of the next start: it leaves the world as it is, whatever the action, and is worth 0.
    Infos have the task's metrics and `score`, and `bad`: whether physics failed or a number of the task was
    not finite, so that the transition is worth nothing. Such an episode is truncated, not terminated, and its
    infos have `fault`, too.

    Args:
        env: The environment.
        robots: Kind of agent.
        seed: Of a first `reset` without one.
        autoreset: When worlds are reset; Gymnasium's NormalizeObservation and others want `next_step`.
        render_mode: None, or `rgb_array`: `render` returns pictures from above.
        actions: `continuous`, or `discrete`: each robot chooses a number of a point of its `ActionGrid`. The
            space of an environment of one robot is `gymnasium.spaces.Discrete`, else
            `gymnasium.spaces.MultiDiscrete` with a number for each robot.
        bins: Values of each action, where they are discrete.

    Raises:
        UsageError: `each` with robots of several classes; something else than the modes that there are; too
            many discrete actions.
    """

    def __init__(
        self,
        env: "Env",
        robots: Robots = "joined",
        seed: int = 0,
        autoreset: Autoreset = "same_step",
        render_mode: str | None = None,
        *,
        actions: Actions = "continuous",
        bins: int = BINS,
    ) -> None:
        if robots not in ("joined", "each"):
            raise UsageError(f"robots is {robots!r}, allowed are 'joined' and 'each'")
        if autoreset not in MODES:
            raise UsageError(f"autoreset is {autoreset!r}, allowed are 'same_step' and 'next_step'")
        check_render_mode(render_mode)
        self.env, self.render_mode = env, render_mode
        self.metadata = {
            "render_modes": list(RENDER_MODES),
            "render_fps": max(1, round(1 / env.period)),
            "autoreset_mode": MODES[autoreset],
        }
        self.state_space = spaces.Box(-np.inf, np.inf, (env.privileged_size,), np.float32)
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
        obs = sum(n * group.obs_size for n, group in pairs)
        self.single_observation_space = spaces.Box(-np.inf, np.inf, (obs,), np.float32)
        self._grids = action_grids(env.groups, actions, bins)
        self.single_action_space: Any = self._action_space(widths)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._action_shape = (self.num_envs, *self.single_action_space.shape)
        self._step = compiled_step(env)
        self._seed = seed
        self._state: EnvState | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode in every world.

        Args:
            seed: Of all random numbers; None: one that follows from the seed before.
            options: None are known.

        Raises:
            UsageError: Any options; a `reset_mask` among them, as worlds restart by themselves.
        """
        if options and "reset_mask" in options:
            raise UsageError("reset_mask is for AutoresetMode.DISABLED; these worlds restart by themselves")
        check_no_options(options)
        # Gymnasium: reset without a seed goes on with the generator that an earlier seed made.
        if seed is None and self._np_random is None:
            seed = self._seed
        super().reset(seed=seed)
        chosen = draw_seed(self.np_random) if seed is None else seed
        self._state = self.env.reset(chosen)
        self._over[:] = False
        # One transfer for all but the task's memory, which nothing here reads.
        s = jax.device_get(self._state.task_state.replace(memory=()))
        return self._rows(s.obs), self._alive(s, np.zeros(self.num_envs, bool))

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Let every agent act.

        Args:
            actions: Numbers from -1 to 1 (num_envs, size); with discrete actions whole numbers of the
                action space.

        Returns:
            Observations (num_envs, size), rewards (num_envs,), whether the task has ended the episode,
            whether it was cut off, by time or a fault, and infos.

        Raises:
            UsageError: Actions of another shape, discrete ones that there are not, or no `reset` yet.
        """
        if self._state is None:
            raise UsageError(f"{self.env.name}: call reset first")
        before, held = self._state, self._over
        self._state = self._step(before, self._groups(np.asarray(actions)))
        # Worlds of NEXT_STEP that were over stepped with the rest; they are put back, and only then.
        if held.any():
            self._state = self._hold(before, self._state, held)
        s = jax.device_get(self._state.task_state.replace(memory=()))
        # A fault says nothing about the task, so it cuts off: learners then go on with the expected return.
        done, late = s.done & ~held, (s.truncated | s.bad) & ~held
        reward = s.reward[0].reshape(-1) if self._each else np.concatenate(s.reward, -1).mean(-1)
        if self._next_step:
            self._over = np.array(done)
        return (
            self._obs(s, done),
            # Gymnasium's own vector environments give rewards in double precision.
            np.where(self._spread(held), 0.0, np.float64(reward)),
            self._spread(done & ~late),
            self._spread(late),
            self._infos(s, self._spread(done), self._spread(held)),
        )

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Return a picture of each world from above (height, width, 3); None without a render mode.

        Raises:
            UsageError: No `reset` yet.
        """
        if self.render_mode is None:
            return None
        if self._state is None:
            raise UsageError(f"{self.env.name}: call reset first")
        return tuple(picture_of(self.env, self._state, world) for world in range(self.env.worlds))

    def state(self) -> np.ndarray:
        """Return what only critics may know, by world (worlds, privileged_size).

        Raises:
            UsageError: No `reset` yet.
        """
        if self._state is None:
            raise UsageError(f"{self.env.name}: call reset first")
        return np.array(self._state.privileged)

    def _action_space(self, widths: list[int]) -> "spaces.Space[Any]":
        """Return the action space of an environment; `widths` are its numbers of robots of each group."""
        if self._grids is None:
            size = sum(n * group.action_size for n, group in zip(widths, self.env.groups, strict=True))
            return spaces.Box(-1.0, 1.0, (size,), np.float32)
        choices = [grid.choices for n, grid in zip(widths, self._grids, strict=True) for _ in range(n)]
        return spaces.Discrete(choices[0]) if len(choices) == 1 else spaces.MultiDiscrete(choices)

    def _groups(self, actions: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return actions by group (worlds, robots, action_size)."""
        if actions.shape != self._action_shape:
            raise UsageError(f"actions: shape {actions.shape}, expected {self._action_shape}")
        rows = actions.reshape(self.env.worlds, -1)
        if self._grids is not None:
            counts = [len(group.agents) for group in self.env.groups]
            choices = np.split(rows, np.cumsum(counts)[:-1], -1)
            return tuple(grid.chosen(part) for grid, part in zip(self._grids, choices, strict=True))
        sizes = [len(group.agents) * group.action_size for group in self.env.groups]
        parts = np.split(np.asarray(rows, np.float32), np.cumsum(sizes)[:-1], -1)
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
            found = _masked({"score": score, "bad": bad}, np.ones_like(done)) | _faults(bad)
            found |= self._alive(s, done)
            return found | _masked(metrics, ~held)
        infos = _masked({"score": score, "bad": bad}, np.ones_like(done)) | _faults(bad)
        infos |= _masked(metrics, ~done) | self._alive(s, done)
        if done.any():
            # Gymnasium's form: an array of objects, None for those that go on.
            ends = np.full(self.num_envs, None, object)
            final = self._rows(s.final_obs)
            for i in np.flatnonzero(done):
                # A copy: a view of one row would keep the rows of all worlds in memory.
                ends[i] = final[i].copy()
            ends_info = {name: value.copy() for name, value in metrics.items()}
            ends_info["score"] = self._spread(s.final_score)
            infos |= _masked({"final_obs": ends, "final_info": _masked(ends_info, done)}, done)
        return infos

    def _alive(self, s: "EnvState", done: np.ndarray) -> dict[str, Any]:
        """Return infos of which agents of each environment are alive (num_envs, agents)."""
        if s.alive is None or s.final_alive is None:
            return {}
        # `_rows` makes numbers of masks.
        now, end = self._rows(s.alive) > 0, self._rows(s.final_alive) > 0
        shown = np.where(done[:, None], end, now) if self._next_step else now
        return _masked({"alive_agents": shown}, np.ones_like(done))


class _LastingWorlds(VectorWorlds):
    """Worlds that stay at the end of their episode until `go_on`, with `autoreset="same_step"`."""

    def __init__(self, env: "Env", **settings: Any) -> None:  # noqa: ANN401 - those of `VectorWorlds`
        super().__init__(env, **settings)
        # `advance` does not reset worlds, so the end of the episode stays to be seen.
        self._step = jax.jit(env.advance) if env.traceable else env.advance
        self._restart = jax.jit(env.restart) if env.traceable else env.restart

    def go_on(self) -> np.ndarray:
        """Begin the next episode of all worlds; return observations of its start (num_envs, size)."""
        assert self._state is not None  # as an episode has ended
        self._state = self._restart(self._state, jnp.ones(self.env.worlds, bool))
        return self._rows(jax.device_get(self._state.obs))


def _faults(bad: np.ndarray) -> dict[str, Any]:
    """Return infos of the environments whose step is a fault (num_envs,); empty if there is none."""
    return _masked({"fault": bad.copy()}, bad) if bad.any() else {}


def _masked(values: dict[str, Any], mask: np.ndarray) -> dict[str, Any]:
    return {**values, **{f"_{name}": mask.copy() for name in values}}
