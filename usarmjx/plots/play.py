"""Pictures of a policy at work: one world from above, as a strip of moments (PNG) or moving (GIF)."""

# Matplotlib leaves the types of keywords open.
# pyright: reportUnknownMemberType=false

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from usarmjx.base import random
from usarmjx.base.backend import numpy_backend
from usarmjx.base.errors import UsageError
from usarmjx.base.files import atomic_write
from usarmjx.base.rotations import mat_from_quat
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.plots.floor_plan import draw_plan
from usarmjx.plots.picture import ARROW
from usarmjx.plots.style import PALETTE
from usarmjx.sim.world import robot_states
from usarmjx.train.envs.env import Env, EnvState
from usarmjx.train.envs.presence import carry_of_alive
from usarmjx.train.envs.task import Policy

WORLD = 0
"""The world that is looked at."""
PANELS = 6
"""Moments in a strip."""
COLUMNS = 3
PANEL_WIDTH = 3.6
"""Width of a moment's picture [inches]."""
DPI = 90
MAX_FRAMES = 150
"""Most frames of a film; of longer ones, moments are left out."""
GIF_SPEEDUP = 2.0
"""Speed of a GIF relative to simulated time."""
GOAL, LOOSE = "#c4122f", "#f2730a"


@dataclass(frozen=True, kw_only=True)
class EpisodeRecording:
    """One episode of one world, or the beginning of it.

    Attributes:
        task: Its name.
        arena: Its arena.
        names: Of the robots.
        times: When [s] (frames,).
        scores: The score by then (frames,).
        poses: True poses of the robots: x, y [m] and yaw [rad] (frames, robots, 3).
        loose: True positions of loose objects: x, y [m] (frames, objects, 2).
        goal: Goal [m] (2,), in tasks that have a goal.
        end: Known end of the episode, "" if it went on.
    """

    task: str
    arena: ArenaSpec
    names: tuple[str, ...]
    times: np.ndarray
    scores: np.ndarray
    poses: np.ndarray
    loose: np.ndarray
    goal: np.ndarray | None
    end: str


def record_episode(
    env: Env,
    policy: Policy,
    seconds: float = math.inf,
    seed: int = 0,
    watch: Callable[[EnvState], None] | None = None,
) -> EpisodeRecording:
    """Return the first episode of world 0, up to its end or a time.

    The last moment is the one before the step that ended the episode, with the score after it: by then the
    world has begun anew.

    Args:
        env: The worlds.
        policy: Driver of the robots.
        seconds: For how long at most [s of simulated time].
        seed: Of the environment and of the policy's random numbers.
        watch: Gets to see each state of the episode, the first one included.

    Raises:
        UsageError: A time that is not above 0.
    """
    if not seconds > 0:
        raise UsageError(f"{seconds} seconds, expected more than 0")
    act, carry, key = jax.jit(policy.act), policy.initial_carry(env.worlds), random.key(seed)
    state, step, end = env.reset(seed), 0, ""
    arena, goal = env.batch.arena_of(state.batch, WORLD), getattr(state.memory, "goal", None)
    moments = [(0.0, float(np.asarray(state.score)[WORLD]), *positions_of(env, state))]
    if watch is not None:
        watch(state)
    while not end and (step + 1) * env.period <= seconds + 1e-9:
        carry, actions = act(carry, state.obs, jax.random.fold_in(key, step))
        before, state, step = state, env.step(state, actions), step + 1
        carry = carry_of_alive(carry, before.alive, state.alive)
        done, cut, bad = (bool(np.asarray(flag)[WORLD]) for flag in (state.done, state.truncated, state.bad))
        late = cut or (env.task.time_limit == "end" and step >= env.episode_steps)
        if done:
            end = "physics failed" if bad else "time is up" if late else "done"
            moments.append((step * env.period, float(np.asarray(state.final_score)[WORLD]), *moments[-1][2:]))
        else:
            if watch is not None:
                watch(state)
            moments.append(
                (step * env.period, float(np.asarray(state.score)[WORLD]), *positions_of(env, state))
            )
    times, scores, poses, loose = (np.array(column) for column in zip(*moments, strict=True))
    in_plane = goal is not None and np.ndim(goal) == 2 and np.shape(goal)[1] == 2
    names = tuple(one.name or f"{one.spec.name}{slot}" for slot, one in enumerate(env.scene.roster))
    return EpisodeRecording(
        task=env.name,
        arena=arena,
        names=names,
        times=times,
        scores=scores,
        poses=poses,
        loose=loose,
        goal=np.asarray(goal)[WORLD] if in_plane else None,
        end=end,
    )


def positions_of(env: Env, state: EnvState, world: int = WORLD) -> tuple[np.ndarray, np.ndarray]:
    """Return the true positions of the robots of a world, by slot, and of its loose objects.

    Returns:
        x, y [m] and yaw [rad] (robots, 3), NaN for robots that are not there, and x, y [m] (objects, 2).
    """
    physics = jax.tree.map(lambda rows: np.asarray(rows)[world], env.batch.physics(state.batch))
    found = np.zeros((env.scene.num_robots, 3))
    with numpy_backend():  # JAX would compile each of these operations
        for group, members in zip(env.scene.groups, state.batch.worlds.groups, strict=True):
            states = robot_states(group, physics)
            mat = mat_from_quat(states.quat)
            yaw = np.arctan2(mat[:, 1, 0], mat[:, 0, 0])
            poses = np.column_stack([states.pos[:, :2], yaw])
            found[np.asarray(group.slots)] = np.where(
                np.asarray(members.active)[world, :, None], poses, np.nan
            )
    return found, physics.qpos[env.scene.loose_geoms.root_qposadr[:, :2]]


def _caption(shown: EpisodeRecording, frame: int) -> str:
    end = f" ({shown.end})" if shown.end and frame == len(shown.times) - 1 else ""
    return f"{shown.times[frame]:.1f} s   score {shown.scores[frame]:.2f}{end}"


def _draw(axes: Axes, shown: EpisodeRecording, frame: int) -> list[Any]:
    """Draw the robots, their ways so far, what lies loose and the goal; return what was drawn."""
    # What an arena of several does not have waits far outside of the picture.
    inside: dict[str, Any] = {"scalex": False, "scaley": False, "zorder": 7}
    drawn: list[Any] = axes.plot(*shown.loose[frame].T, "o", color=LOOSE, ms=6, mec="white", **inside)
    if shown.goal is not None:
        drawn += axes.plot(*shown.goal, "x", color=GOAL, ms=9, mew=2.5, zorder=7)
    for robot in range(len(shown.names)):
        colour, way = PALETTE[robot % len(PALETTE)], shown.poses[: frame + 1, robot]
        drawn += axes.plot(way[:, 0], way[:, 1], color=colour, lw=1.4, zorder=8)
        if not np.isfinite(way[-1]).all():
            continue
        cos, sin = np.cos(way[-1, 2]), np.sin(way[-1, 2])
        marker = ARROW @ np.array([[cos, sin], [-sin, cos]])
        drawn += axes.plot(*way[-1, :2], marker=marker, color=colour, ms=11, mec="white", mew=0.5, zorder=9)
    return drawn


def _figure(columns: int, rows: int, arena: ArenaSpec) -> Figure:
    (x0, x1), (y0, y1) = arena.extent
    tall = PANEL_WIDTH * min(2.0, max(0.4, (y1 - y0) / (x1 - x0)))
    size = (columns * PANEL_WIDTH, rows * (tall + 0.35))
    figure = Figure(figsize=size, dpi=DPI, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def save_png(shown: EpisodeRecording, path: Path) -> None:
    """Write moments of a film, the first and the last among them, beside each other as a PNG file."""
    frames = np.unique(np.linspace(0, len(shown.times) - 1, PANELS).round().astype(int))
    columns = min(COLUMNS, len(frames))
    rows = -(-len(frames) // columns)
    figure = _figure(columns, rows, shown.arena)
    for index, frame in enumerate(frames):
        axes = figure.add_subplot(rows, columns, index + 1)
        draw_plan(axes, shown.arena, words=False, starts=False)
        _draw(axes, shown, int(frame))
        axes.set_title(_caption(shown, int(frame)), loc="left", fontsize=9)
    figure.suptitle(f"{shown.task} in {shown.arena.name}", x=0.01, ha="left", fontsize=10)
    figure.savefig(path, format="png")


def film_frames(shown: EpisodeRecording, frames: np.ndarray) -> Iterator[np.ndarray]:
    """Yield moments of a film, by index, as pictures (height, width, 3)."""
    figure = _figure(1, 1, shown.arena)
    axes = figure.add_subplot()
    draw_plan(axes, shown.arena, words=False, starts=False)
    for frame in frames.tolist():
        drawn = _draw(axes, shown, frame)
        axes.set_title(f"{shown.task}: {_caption(shown, frame)}", loc="left", fontsize=9)
        figure.canvas.draw()
        yield np.array(figure.canvas.buffer_rgba())[..., :3]  # pyright: ignore[reportAttributeAccessIssue, reportUnknownArgumentType]
        for one in drawn:
            one.remove()


def save_gif(shown: EpisodeRecording, path: Path, speedup: float = GIF_SPEEDUP) -> None:
    """Write a film as a GIF file, `speedup` times as fast as it was; the last moment stays for 2 s."""
    count = min(MAX_FRAMES, len(shown.times))
    frames = np.unique(np.linspace(0, len(shown.times) - 1, count).round().astype(int))
    pictures = [Image.fromarray(pixels).quantize(64) for pixels in film_frames(shown, frames)]
    lasts = np.diff(shown.times[frames], append=shown.times[-1]) / speedup
    durations = [*(max(20, round(1000 * one)) for one in lasts[:-1]), 2000]
    pictures[0].save(
        path, format="GIF", save_all=True, append_images=pictures[1:], duration=durations, loop=0
    )


WRITERS = {".png": save_png, ".gif": save_gif}


def save_recording(shown: EpisodeRecording, path: Path) -> None:
    """Write a film as what the file's name ends in; makes the folder if need be.

    Raises:
        UsageError: Another ending.
    """
    check_suffix(path)
    with atomic_write(path) as fresh:
        WRITERS[path.suffix.lower()](shown, fresh)


def check_suffix(path: Path) -> None:
    """Refuse names of files that nothing can be written to.

    Raises:
        UsageError: Lists the endings that there are.
    """
    if path.suffix.lower() not in WRITERS:
        raise UsageError(f"{path}: pictures end in {', '.join(WRITERS)}")
