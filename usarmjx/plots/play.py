"""Pictures of a policy at work from above: moments, films, clips of a training, ways and finds of teams."""

# Matplotlib leaves the types of keywords open.
# pyright: reportUnknownMemberType=false

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from matplotlib.artist import Artist
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
from usarmjx.plots.style import PAGE, PALETTE, PANEL_HEIGHT, figure_style, save_figure
from usarmjx.sim.scene import Scene
from usarmjx.sim.world import robot_states
from usarmjx.train.envs.env import Env, EnvState
from usarmjx.train.envs.presence import carry_of_alive
from usarmjx.train.envs.task import Policy
from usarmjx.train.evaluation.yardsticks import QUARTERS, TeamResult
from usarmjx.train.learning.trajectory import RolloutInputs, play_again
from usarmjx.train.tasks import messages
from usarmjx.train.tasks.goal_team import GoalTeam
from usarmjx.train.tasks.team import TeamMemory

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
RANKS = ("best", "median", "worst")
Sink = Callable[[str, Path, int], None]
"""Receives a clip: `best`, `median` or `worst`, its GIF file, and the number of the iteration."""
PLAN_WIDTH = PAGE / COLUMNS
"""Width of a plan [inches]."""


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
    arena, goal = env.batch.arena_of(state.batch, WORLD), _goal_on_floor(state, WORLD)
    moments = [(0.0, float(np.asarray(state.score)[WORLD]), *positions_of(env, state))]
    if watch is not None:
        watch(state)
    while not end and (step + 1) * env.period <= seconds + 1e-9:
        carry, actions = act(carry, state.obs, jax.random.fold_in(key, step))
        before, state, step = state, env.step(state, actions), step + 1
        # A robot that comes back must not go on with the memory of the one before.
        carry = carry_of_alive(carry, before.alive, state.alive)
        done, cut, bad = (bool(np.asarray(flag)[WORLD]) for flag in (state.done, state.truncated, state.bad))
        # A task may count its time limit as an end, and then nothing is cut off.
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
    names = tuple(one.name or f"{one.spec.name}{slot}" for slot, one in enumerate(env.scene.roster))
    return EpisodeRecording(
        task=env.name,
        arena=arena,
        names=names,
        times=times,
        scores=scores,
        poses=poses,
        loose=loose,
        goal=goal,
        end=end,
    )


def _goal_on_floor(state: EnvState, world: int) -> np.ndarray | None:
    """Return the goal of a world [m] (2,); None in a task without one."""
    goal = getattr(state.memory, "goal", None)
    # Tasks keep goals of several forms; only points on the floor can be drawn.
    in_plane = goal is not None and np.ndim(goal) == 2 and np.shape(goal)[1] == 2
    return np.asarray(goal)[world] if in_plane else None


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
            # NaN breaks the drawn line, and Matplotlib leaves such a marker out.
            found[np.asarray(group.slots)] = np.where(
                np.asarray(members.active)[world, :, None], poses, np.nan
            )
    return found, physics.qpos[env.scene.loose_geoms.root_qposadr[:, :2]]


def _caption(shown: EpisodeRecording, frame: int) -> str:
    end = f" ({shown.end})" if shown.end and frame == len(shown.times) - 1 else ""
    return f"{shown.times[frame]:.1f} s   score {shown.scores[frame]:.2f}{end}"


def _draw(axes: Axes, shown: EpisodeRecording, frame: int) -> list[Any]:
    """Draw the robots, their ways so far, what lies loose and the goal; return what was drawn."""
    # Objects that an arena of several lacks wait far outside of the picture.
    inside: dict[str, Any] = {"scalex": False, "scaley": False, "zorder": 7}
    drawn: list[Any] = axes.plot(*shown.loose[frame].T, "o", color=LOOSE, ms=6, mec="white", **inside)
    if shown.goal is not None:
        drawn += axes.plot(*shown.goal, "x", color=GOAL, ms=9, mew=2.5, zorder=7)
    for robot in range(len(shown.names)):
        colour, way = PALETTE[robot % len(PALETTE)], shown.poses[: frame + 1, robot]
        drawn += axes.plot(way[:, 0], way[:, 1], color=colour, lw=1.4, zorder=8)
        # A robot that is not in use has NaN, and no marker.
        if not np.isfinite(way[-1]).all():
            continue
        cos, sin = np.cos(way[-1, 2]), np.sin(way[-1, 2])
        # Markers do not turn with the data, so their corners are turned.
        marker = ARROW @ np.array([[cos, sin], [-sin, cos]])
        drawn += axes.plot(*way[-1, :2], marker=marker, color=colour, ms=11, mec="white", mew=0.5, zorder=9)
    return drawn


def plan_height(arena: ArenaSpec, width: float) -> float:
    """Return the height of an arena's plan of some width [inch]; very long or tall arenas leave a margin."""
    (x0, x1), (y0, y1) = arena.extent
    return width * min(2.0, max(0.4, (y1 - y0) / (x1 - x0)))


def _figure(columns: int, rows: int, arena: ArenaSpec) -> Figure:
    size = (columns * PANEL_WIDTH, rows * (plan_height(arena, PANEL_WIDTH) + 0.35))
    figure = Figure(figsize=size, dpi=DPI, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def save_png(shown: EpisodeRecording, path: Path) -> None:
    """Write moments of a film, the first and the last among them, beside each other as a PNG file."""
    # Short films have fewer moments than there are panels.
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
        yield picture_of(figure)
        # The plan stays: it takes far longer to draw than what moves.
        for one in drawn:
            one.remove()


def picture_of(figure: Figure) -> np.ndarray:
    """Return what a figure shows now (height, width, 3); its canvas is that of Agg."""
    figure.canvas.draw()
    # A copy: the canvas draws the next picture into the same buffer.
    pixels: np.ndarray = np.array(figure.canvas.buffer_rgba())  # pyright: ignore[reportAttributeAccessIssue, reportUnknownArgumentType]
    return pixels[..., :3]


def save_gif(shown: EpisodeRecording, path: Path, speedup: float = GIF_SPEEDUP) -> None:
    """Write a film as a GIF file, `speedup` times as fast as it was; the last moment stays for 2 s."""
    frames = frames_of(len(shown.times))
    write_gif(film_frames(shown, frames), shown.times[frames] / speedup, path)


def frames_of(count: int) -> np.ndarray:
    """Return the moments that a film shows of some, by index, the first and the last among them."""
    return np.unique(np.linspace(0, count - 1, min(MAX_FRAMES, count)).round().astype(int))


def write_gif(frames: Iterable[np.ndarray], times: np.ndarray, path: Path) -> None:
    """Write pictures (height, width, 3) as a GIF file, each from its time on [s]; the last stays for 2 s."""
    pictures = [Image.fromarray(pixels).quantize(64) for pixels in frames]
    # From the times, as moments are left out of long films.
    lasts = np.diff(times, append=times[-1])
    # Browsers take less than 20 ms for a mistake, and show such pictures slowly.
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


def ranked_worlds(reward: np.ndarray, bad: np.ndarray) -> dict[str, int]:
    """Return the worlds with the highest, the median and the lowest sum of rewards, by rank.

    Args:
        reward: Rewards of each step (steps, worlds).
        bad: Steps in which a world went bad (steps, worlds); such a world counts only if all are bad.
    """
    # A world whose physics failed has rewards of no meaning.
    sound = np.flatnonzero(~bad.any(0))
    worlds = np.asarray(sound if len(sound) else np.arange(bad.shape[1]), int)
    # Stable, so that equal sums always give the same worlds.
    order = worlds[np.argsort(reward[:, worlds].sum(0), kind="stable")]
    return dict(zip(RANKS, map(int, (order[-1], order[len(order) // 2], order[0])), strict=True))


class Clips:
    """Clips of every n-th iteration of a training, made by playing its rollout again.

    A clip goes on to the end of the rollout, or of the episode if that is sooner. Engines that compile a
    whole iteration compile a single action once more for this.

    Args:
        env: The worlds of the training.
        folder: For the GIF files.
        every: Iterations from one to the next.
        sinks: Receivers of each clip.
    """

    def __init__(self, env: Env, folder: Path, every: int, sinks: tuple[Sink, ...] = ()) -> None:
        self._env, self._folder, self._every, self._sinks = env, folder, every, sinks

    def inspect(self, inputs: RolloutInputs) -> None:
        """Make clips of a rollout, if its iteration is one of those."""
        if inputs.iteration % self._every:
            return
        worlds = ranked_worlds(np.asarray(inputs.reward), np.asarray(inputs.bad))
        for rank, shown in self._shown(inputs, worlds).items():
            path = self._folder / f"iteration-{inputs.iteration:06d}-{rank}.gif"
            save_recording(shown, path)
            for sink in self._sinks:
                sink(rank, path, inputs.iteration)

    def _shown(self, inputs: RolloutInputs, worlds: dict[str, int]) -> dict[str, EpisodeRecording]:
        env = self._env
        # Ended once is ended for good: what follows is another episode.
        ended = np.asarray(inputs.done).cumsum(0) > 0
        moments = {rank: [self._moment(inputs.env_state, world)] for rank, world in worlds.items()}
        for step, _, after in play_again(env, inputs, inputs.steps):
            for rank, world in worlds.items():
                if not ended[step, world]:
                    moments[rank].append(self._moment(after, world))
        names = tuple(one.name or f"{one.spec.name}{slot}" for slot, one in enumerate(env.scene.roster))
        found: dict[str, EpisodeRecording] = {}
        for rank, world in worlds.items():
            scores, poses, loose = (np.array(column) for column in zip(*moments[rank], strict=True))
            found[rank] = EpisodeRecording(
                task=f"{env.name}, iteration {inputs.iteration}, {rank}",
                arena=env.batch.arena_of(inputs.env_state.batch, world),
                names=names,
                times=np.arange(len(scores)) * env.period,
                scores=scores,
                poses=poses,
                loose=loose,
                goal=_goal_on_floor(inputs.env_state, world),
                end="",
            )
        return found

    def _moment(self, state: EnvState, world: int) -> tuple[float, np.ndarray, np.ndarray]:
        return float(np.asarray(state.score)[world]), *positions_of(self._env, state, world)


SENT_KINDS = (*messages.KINDS, "vector", "link")
"""Kinds of messages, by the numbers of `messages.of_options`; and links that begin, for whole maps."""


class SentMessage(NamedTuple):
    """A message from one robot to another.

    Attributes:
        kind: A name of `SENT_KINDS`.
        ends: Positions of sender and receiver [m] (2, 2).
    """

    kind: str
    ends: np.ndarray


def just_sent(task: GoalTeam, memory: TeamMemory, places: np.ndarray) -> Iterator[SentMessage]:
    """Yield the messages of a world's last step, between robots at places (robots, 3)."""
    # The step has been counted since.
    if (int(memory.step) - 1) % task.hold != task.hold // 2:
        return
    state = task.message_state(memory)
    kinds, _ = messages.of_options(state, state.chosen)
    for sender, receiver in np.argwhere(np.asarray(state.receivers)):
        yield SentMessage(SENT_KINDS[int(kinds[sender])], places[[sender, receiver], :2])


def begun_links(
    task: GoalTeam, scene: Scene, linked: np.ndarray, before: np.ndarray, places: np.ndarray
) -> Iterator[SentMessage]:
    """Yield the links of a world that have just begun, between robots at places (robots, 3).

    Args:
        task: The task.
        scene: Its scene.
        linked: Links now (robots, robots).
        before: Those of the last step.
        places: Where robots are: x, y [m] and yaw [rad].
    """
    allowed = task.recipients(scene)
    # A link goes both ways: a line for each pair.
    new = np.triu((linked & ~before) & (allowed | allowed.T))
    for pair in np.argwhere(new):
        yield SentMessage("link", places[pair, :2])


class TeamWays:
    """Tracks of each team's robots in world 0: a `watch` of `measure_teams`.

    Attributes:
        arena: Arena of world 0.
        ways: By team: x, y [m] and yaw [rad] of its robots at the begin of each step, [(robots, 3), ...].
        period: Length of a step [s].
        sent: By team: messages that its robots chose, or the fixed protocol; of whole maps, which are sent
            over each link in each step, the links that began.
        sent_counts: By team: number of `sent` by the begin of each step.
    """

    def __init__(self) -> None:
        self.arena: ArenaSpec | None = None
        self.ways: dict[str, list[np.ndarray]] = {}
        self.sent: dict[str, list[SentMessage]] = {}
        self.sent_counts: dict[str, list[int]] = {}
        self.period = 0.0
        self._linked: dict[str, np.ndarray] = {}

    def __call__(self, name: str, env: Env, state: EnvState) -> None:
        """Take down where they are, and what they have just sent."""
        if self.arena is None:
            self.arena, self.period = env.batch.arena_of(state.batch, WORLD), env.period
        places = positions_of(env, state)[0]
        self.ways.setdefault(name, []).append(places)
        sent = self.sent.setdefault(name, [])
        if isinstance(env.task, GoalTeam):
            sent.extend(self._sent_now(name, env, env.task, state, places))
        self.sent_counts.setdefault(name, []).append(len(sent))

    def _sent_now(
        self, name: str, env: Env, task: GoalTeam, state: EnvState, places: np.ndarray
    ) -> Iterator[SentMessage]:
        if task.parts:
            return just_sent(task, jax.tree.map(lambda x: x[WORLD], state.memory), places)
        links = state.batch.worlds.links
        linked = np.zeros((len(places),) * 2, bool) if links is None else np.asarray(links.in_range[WORLD])
        before = self._linked.get(name, np.zeros_like(linked))
        self._linked[name] = linked
        return begun_links(task, env.scene, linked, before, places)


def draw_messages(axes: Axes, sent: Sequence[SentMessage]) -> list[Artist]:
    """Draw messages as lines from senders (dots) to receivers, a colour for each kind, with a legend.

    Returns:
        The drawn parts.
    """
    drawn: list[Artist] = []
    for number, kind in enumerate(SENT_KINDS):
        ends = [one.ends for one in sent if one.kind == kind]
        if not ends:
            continue
        colour, label = PALETTE[-1 - number], f"{len(ends)} {kind}"
        # Matplotlib draws each column as a line: (x or y, sender or receiver, message).
        drawn += axes.plot(*np.stack(ends).transpose(2, 1, 0), color=colour, lw=0.5, alpha=0.5, zorder=7)
        drawn += axes.plot(*np.stack(ends)[:, 0].T, ".", color=colour, ms=2.0, zorder=7, label=label)
    if sent:
        # Above the plan, beside its title: inside it would cover walls.
        legend = axes.legend(
            loc="lower right",
            bbox_to_anchor=(1.0, 1.0),
            borderpad=0.0,
            ncols=len(SENT_KINDS),
            markerscale=3.0,
            handletextpad=0.0,
            columnspacing=0.5,
        )
        drawn.append(legend)
    return drawn


def draw_finds(axes: Axes, rows: Sequence[TeamResult], period: float) -> None:
    """Draw the points for finds over time, a line for each team, and the quarters of the time.

    The legend is above the panel, where it covers no line.
    """
    for number, row in enumerate(rows):
        # One more than there are steps: nothing is found before the first.
        times = period * np.arange(len(row.finds) + 1)
        label = f"{row.name}: score {row.score.value:.1f}"
        axes.plot(times, [0.0, *row.finds], color=PALETTE[number % len(PALETTE)], label=label)
    end = period * max(len(row.finds) for row in rows)
    for share in QUARTERS:
        axes.axvline(share * end, color="#999999", lw=0.8, ls=":")
    axes.set(xlim=(0, end), ylim=(0, None), xlabel="time [s]", ylabel="points for finds")
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=COLUMNS)


def draw_ways(axes: Axes, arena: ArenaSpec, way: Sequence[np.ndarray], name: str) -> None:
    """Draw an arena from above with the ways of a team's robots: from rings to dots."""
    draw_plan(axes, arena, words=False, starts=False)
    draw_tracks(axes, way)
    axes.set_title(name)


def draw_tracks(axes: Axes, way: Sequence[np.ndarray]) -> list[Artist]:
    """Draw the ways of a team's robots, from rings to dots; return what was drawn."""
    places, drawn = np.stack(way), list[Artist]()
    for robot in range(places.shape[1]):
        colour = PALETTE[robot % len(PALETTE)]
        drawn += axes.plot(places[:, robot, 0], places[:, robot, 1], color=colour, lw=0.9, zorder=8)
        drawn += axes.plot(*places[0, robot, :2], "o", mfc="none", color=colour, zorder=9)
        drawn += axes.plot(*places[-1, robot, :2], "o", color=colour, zorder=9)
    return drawn


def plot_teams(task: str, rows: Sequence[TeamResult], seen: TeamWays, out: Path) -> None:
    """Draw what teams found over time, and below it the ways and messages of each in world 0.

    Args:
        task: Its name.
        rows: One or more teams.
        seen: Has watched them.
        out: PNG, PDF, SVG or EPS file.

    Raises:
        ValueError: It has watched nobody.
        UsageError: Another suffix.
        WriteError: The file cannot be written.
    """
    if seen.arena is None:
        raise ValueError("no team has been watched")
    lines = -(-len(rows) // COLUMNS)
    tall = plan_height(seen.arena, PLAN_WIDTH) + 0.2
    with figure_style():
        figure = Figure(figsize=(PAGE, PANEL_HEIGHT + lines * tall), layout="constrained")
        grid = figure.add_gridspec(1 + lines, COLUMNS, height_ratios=[PANEL_HEIGHT, *[tall] * lines])
        draw_finds(figure.add_subplot(grid[0, :]), rows, seen.period)
        for index, row in enumerate(rows):
            axes = figure.add_subplot(grid[1 + index // COLUMNS, index % COLUMNS])
            draw_ways(axes, seen.arena, seen.ways[row.name], row.name)
            draw_messages(axes, seen.sent.get(row.name, ()))
        figure.suptitle(f"{task}; paths in {seen.arena.name}", x=0.01, ha="left", fontsize=8)
        save_figure(figure, out)
