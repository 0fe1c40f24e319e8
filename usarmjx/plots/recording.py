"""A recorded mission as a figure for a paper: plan, ways, scans, radio, victims met, and all over time."""

# Matplotlib leaves the types of keywords open.
# pyright: reportUnknownMemberType=false

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from usarmjx.base.backend import numpy_backend
from usarmjx.base.errors import UsageError
from usarmjx.base.files import atomic_write
from usarmjx.base.rotations import mat_from_quat
from usarmjx.comms.attenuation import RadioSettings
from usarmjx.models.compile.victims import victim_table
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.plots.films.codecs import write_mp4
from usarmjx.plots.floor_plan import draw_plan
from usarmjx.plots.picture import ARROW
from usarmjx.plots.play import EpisodeRecording, film_frames, save_gif
from usarmjx.plots.radio_map import MIN_STEP, power_map
from usarmjx.plots.style import PAGE, PALETTE, check_figure, figure_style, save_figure
from usarmjx.recording.foxglove import is_scanner
from usarmjx.recording.reader import Recording
from usarmjx.recording.source import RecordingSource
from usarmjx.view.drawing import Drawing, DrawnMount, Frame

MOST_SCANS = 400
"""Largest number of scans drawn, spread over the time."""
NEARLY = 0.995
"""Share of a scanner's range beyond which a reading is no hit."""
VICTIM_SENSOR = "VictSensor"


@dataclass
class RobotWay:
    """Track of a robot, and its remaining battery.

    Attributes:
        name: Its name.
        robot: Its class.
        times: When it was looked at [s].
        poses: Pose then: x, y [m] and yaw [rad].
        battery: For how long its battery lasted yet [s].
    """

    name: str
    robot: str
    times: list[float] = field(default_factory=list[float])
    poses: list[tuple[float, float, float]] = field(default_factory=list[tuple[float, float, float]])
    battery: list[float] = field(default_factory=list[float])


@dataclass(frozen=True, eq=False)
class RecordedMission:
    """A recorded mission.

    Attributes:
        arena: Its arena.
        ways: The robots' ways, in the order in which they came.
        scans: Ends of beams of plane scanners, on the floor plan [m] (points, 2).
        found: When each victim was met first [s], and by whom, by its place in the arena.
        scores: Times [s] and scores of a task.
        loose: Times [s] and where what lies loose was: x, y [m] (objects, 2).
    """

    arena: ArenaSpec
    ways: list[RobotWay]
    scans: np.ndarray
    found: dict[int, tuple[float, str]]
    scores: list[tuple[float, float]]
    loose: list[tuple[float, np.ndarray]]


def read_mission(recording: Recording, world: int, span: tuple[float, float]) -> RecordedMission:
    """Return a world of a recording in a span of time [s].

    Raises:
        UsageError: There is no such world, or the file does not say where it was.
    """
    if world not in recording.worlds:
        known = ", ".join(map(str, recording.worlds))
        raise UsageError(f"{recording.path}: has no world {world}; it has: {known}")
    setup = recording.setup(world)
    if not setup.arenas:
        raise UsageError(f"{recording.path}: does not have the arena: {setup.why_not}")
    # The sensor's rows are bones, several of one victim.
    owners = np.asarray(victim_table(setup.arenas[0].victims, setup.arenas[0].false_alarms).owner)
    reader = _Reader(owners)
    for message in recording.messages(("drawings", "frames", "readings", "score"), world):
        kind = message.channel.kind
        # Drawings before the span count, too: they say who its robots are.
        if kind == "drawings":
            reader.drawing = message.value
        elif span[0] <= message.time <= span[1]:
            if kind == "frames":
                reader.take_frame(message.value)
            elif kind == "score":
                reader.scores.append((message.time, message.value["score"]))
            else:
                reader.take_readings(message.time, message.value)
    if not reader.ways:
        raise UsageError(f"{recording.path}: no robots in that time of world {world}")
    scans = _scan_points(recording, world, reader.scans)
    ways = list(reader.ways.values())
    return RecordedMission(setup.arenas[0], ways, scans, reader.found, reader.scores, reader.loose)


@dataclass
class _Reader:
    """Goes through a recording; `owners` are the victims of the sensor's rows."""

    owners: np.ndarray
    drawing: Drawing | None = None
    ways: dict[str, RobotWay] = field(default_factory=dict[str, RobotWay])
    scans: list[tuple[float, int, int, np.ndarray]] = field(default_factory=list[Any])
    found: dict[int, tuple[float, str]] = field(default_factory=dict[int, tuple[float, str]])
    scores: list[tuple[float, float]] = field(default_factory=list[tuple[float, float]])
    loose: list[tuple[float, np.ndarray]] = field(default_factory=list[Any])

    def take_frame(self, frame: Frame) -> None:
        if self.drawing is None:
            return
        # Robots of a frame are in the drawing before it: a change of robots is recorded as a new drawing.
        for slot, robot in frame.robots.items():
            drawn = self.drawing.robots[slot]
            way = self.ways.setdefault(drawn.name, RobotWay(drawn.name, drawn.robot))
            mat = np.asarray(mat_from_quat(robot.quat))
            way.times.append(frame.time)
            way.poses.append((*robot.pos[:2].tolist(), float(np.arctan2(mat[1, 0], mat[0, 0]))))
            way.battery.append(robot.battery)
        lying = [n for n, body in enumerate(self.drawing.bodies) if body.name.startswith("loose/")]
        self.loose.append((frame.time, frame.pos[lying, :2]))

    def take_readings(self, time: float, said: dict[str, Any]) -> None:
        for slot, sensor, value in zip(said["slots"], said["sensors"], said["values"], strict=True):
            robot = None if self.drawing is None else self.drawing.robots.get(slot)
            if robot is None:
                continue
            if is_scanner(robot, sensor):
                self.scans.append((time, slot, sensor, value))
            elif robot.sensors[sensor].kind == VICTIM_SENSOR and len(value) == len(self.owners):
                for victim in np.unique(self.owners[(value[:, 0] > 0) & (self.owners >= 0)]).tolist():
                    # The first robot that meets a victim keeps it.
                    self.found.setdefault(victim, (time, robot.name))


def _scan_points(
    recording: Recording, world: int, scans: list[tuple[float, int, int, np.ndarray]]
) -> np.ndarray:
    """Return the end points of beams, seen from above (points, 2)."""
    source = RecordingSource(recording)
    points = [np.zeros((0, 2))]
    place = recording.worlds.index(world)
    # A reading has no pose: the source is moved to its time for that.
    for time, slot, sensor, value in scans[:: max(1, len(scans) // MOST_SCANS)]:
        source.seek(time)
        drawing, frame = source.drawing(place), source.frame(place)
        if slot in drawing.robots:
            points.append(_ends(drawing.robots[slot].sensors[sensor], frame, value))
    return np.concatenate(points)


def _ends(mount: DrawnMount, frame: Frame, value: np.ndarray) -> np.ndarray:
    """Return the end points of the beams of a scan that hit something (points, 2)."""
    settings, body = mount.settings[0], int(mount.body[0])
    ranges = np.asarray(value, float).reshape(-1)
    # Beams go counter-clockwise from the rightmost.
    angle = -float(settings["scan_fov"]) / 2 + np.arange(len(ranges)) * float(settings["resolution"])
    along, aside = ranges * np.cos(angle), ranges * np.sin(angle)
    # Without `yaw` the scanner sweeps in its upright plane.
    flat = settings.get("yaw", True)
    ends = np.stack([along, aside if flat else 0 * aside, 0 * aside if flat else aside], -1)
    ends = ends[ranges < NEARLY * float(settings["max_range"])]
    turn = np.asarray(mat_from_quat(frame.quat[body]))
    return ((mount.pos[0] + ends @ mount.mat[0].T) @ turn.T + frame.pos[body])[:, :2]


PICTURES_PER_SECOND = 20


def save_film(recording: Recording, path: Path, world: int = 0, speed: float = 2.0) -> None:
    """Write a world of a recording as a film from above.

    Args:
        recording: The recording.
        path: File to write, .gif or .mp4.
        world: Which world.
        speed: Of an MP4: how many seconds of the recording pass in one.

    Raises:
        UsageError: Another suffix, no such world, or ffmpeg is missing.
        WriteError: It cannot be written.
    """
    write = FILMS.get(path.suffix.lower())
    if write is None:
        raise UsageError(f"{path}: films end in {', '.join(FILMS)}")
    shown = _as_episode(read_mission(recording, world, (0.0, np.inf)), recording.path.stem)
    with atomic_write(path) as fresh:
        write(shown, fresh, speed)


def _as_episode(mission: RecordedMission, title: str) -> EpisodeRecording:
    """Return a mission as what films are drawn of; who was not there yet stands where it came."""
    times = np.unique(np.concatenate([way.times for way in mission.ways]))
    poses = np.zeros((len(times), len(mission.ways), 3))
    for place, way in enumerate(mission.ways):
        # The last pose at or before each time; before a robot came, its first.
        last = np.clip(np.searchsorted(way.times, times, side="right") - 1, 0, None)
        poses[:, place] = np.array(way.poses)[last]
    known, scores = zip(*(mission.scores or [(0.0, 0.0)]), strict=True)
    late = np.clip(np.searchsorted(known, times, side="right") - 1, 0, None)
    when, where = zip(*mission.loose, strict=True)
    seen = np.clip(np.searchsorted(when, times, side="right") - 1, 0, None)
    # Objects come and go in a served world; Matplotlib leaves out the dots of those that are not there.
    loose = np.full((len(where), max(map(len, where)), 2), np.nan)
    for row, places in zip(loose, where, strict=True):
        row[: len(places)] = places
    return EpisodeRecording(
        task=title,
        arena=mission.arena,
        names=tuple(way.name for way in mission.ways),
        times=times,
        scores=np.array(scores)[late],
        poses=poses,
        loose=loose[seen],
        goal=None,
        end="",
    )


def _save_gif(shown: EpisodeRecording, path: Path, speed: float) -> None:
    save_gif(shown, path, speed)


def _save_mp4(shown: EpisodeRecording, path: Path, speed: float) -> None:
    lasts = (shown.times[-1] - shown.times[0]) / speed
    count = max(2, round(lasts * PICTURES_PER_SECOND))
    wanted = np.asarray(np.linspace(shown.times[0], shown.times[-1], count), float)
    frames = np.asarray(np.clip(np.searchsorted(shown.times, wanted, side="right") - 1, 0, None), int)
    write_mp4(film_frames(shown, frames), path, PICTURES_PER_SECOND)


FILMS: dict[str, Callable[[EpisodeRecording, Path, float], None]] = {".gif": _save_gif, ".mp4": _save_mp4}
"""Writers of films, by the suffixes of files."""


SCAN, FOUND = "#0f8b8d", "#c4122f"
STATION = "ComStation"
"""The class of robot from which the radio's power is drawn; without one, from where the first began."""
INSIDE: dict[str, Any] = {"scalex": False, "scaley": False}
"""Options with which drawing leaves the limits of the axes."""
GRID_POINTS = 160
"""Points of the radio's map along the longer side of the arena."""
SMOOTHED = 1.0
"""Speeds are averaged over this time [s]."""


def plot_recording(
    recording: Recording, paths: Sequence[Path], world: int = 0, span: tuple[float, float] = (0.0, np.inf)
) -> list[Path]:
    """Draw a recorded mission; return the files.

    Args:
        recording: The recording.
        paths: PNG, PDF, SVG or EPS files.
        world: Which world.
        span: From when to when [s].

    Raises:
        UsageError: There is no such world, or nothing in it; a file has another suffix.
        WriteError: A file cannot be written.
    """
    # All names first: a wrong suffix is refused before the drawing, and before any file is written.
    for path in paths:
        check_figure(path)
    figure = mission_figure(read_mission(recording, world, span))
    for path in paths:
        save_figure(figure, path, Title=recording.path.stem)  # a PNG with notes keeps all its colours
    return [*paths]


def mission_figure(mission: RecordedMission) -> Figure:
    """Return the figure of a mission."""
    (x0, x1), (y0, y1) = mission.arena.extent
    tall = PAGE / 2 * min(1.4, max(0.5, (y1 - y0) / (x1 - x0)))
    with figure_style():
        figure = Figure(figsize=(PAGE, tall + 2.2))
        grid = figure.add_gridspec(2, 1, height_ratios=[tall, 1.9])
        above = grid[0].subgridspec(1, 2)
        _draw_ways(figure.add_subplot(above[0]), mission)
        _draw_power(figure, figure.add_subplot(above[1]), mission)
        panels = [_draw_distance, _draw_speed, _draw_battery]
        panels.append(_draw_score if mission.scores else _draw_found)
        below = grid[1].subgridspec(1, len(panels))
        for place, draw in enumerate(panels):
            axes = figure.add_subplot(below[place])
            draw(axes, mission)
            axes.set_xlabel("time [s]")
    return figure


def _colour(place: int) -> str:
    return PALETTE[place % len(PALETTE)]


def _draw_ways(axes: Axes, mission: RecordedMission) -> None:
    """Draw the plan, where beams ended, the robots' ways and the victims that were met."""
    draw_plan(axes, mission.arena, words=False, starts=False)
    # As pixels, since these points would make a vector file huge.
    axes.plot(*mission.scans.T, ".", ms=1.0, color=SCAN, alpha=0.4, zorder=6, rasterized=True, **INSIDE)
    for place, way in enumerate(mission.ways):
        _draw_way(axes, way, _colour(place))
    for victim, (time, _) in sorted(mission.found.items(), key=lambda item: item[1]):
        at = mission.arena.victims[victim].at[:2]
        axes.plot(*at, "o", ms=9, mfc="none", mec=FOUND, mew=1.2, zorder=10, **INSIDE)
        axes.annotate(
            f"{time:.0f} s", at, (8, 6), textcoords="offset points", fontsize=6, color=FOUND, zorder=10
        )
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=3)
    found = f", {len(mission.found)} of {len(mission.arena.victims)} victims met" if mission.found else ""
    axes.set_title(f"{mission.arena.name}: ways and scans{found}")


def _draw_way(axes: Axes, way: RobotWay, colour: str) -> None:
    poses = np.array(way.poses)
    axes.plot(*poses[:, :2].T, color=colour, lw=1.2, zorder=8, label=f"{way.name} ({way.robot})", **INSIDE)
    axes.plot(*poses[0, :2], "o", color=colour, ms=4, mec="white", mew=0.5, zorder=9, **INSIDE)
    cos, sin = np.cos(poses[-1, 2]), np.sin(poses[-1, 2])
    # Markers do not turn with the data, so their corners are turned.
    marker = ARROW @ np.array([[cos, sin], [-sin, cos]])
    axes.plot(*poses[-1, :2], marker=marker, color=colour, ms=8, mec="white", mew=0.5, zorder=9, **INSIDE)


def _draw_power(figure: Figure, axes: Axes, mission: RecordedMission) -> None:
    """Draw the radio's power all over the arena, from a station or from where the first robot began."""
    station = next((way for way in mission.ways if way.robot == STATION), mission.ways[0])
    source = station.poses[0][:2]
    step = max(MIN_STEP, np.ptp(mission.arena.extent, axis=1).max() / GRID_POINTS)
    with numpy_backend():  # compiled it would take longer
        drawn = power_map(mission.arena, source, step=step)
    draw_plan(axes, mission.arena, words=False, starts=False)
    # The few points right at the sender would take half of the colours.
    top = np.percentile(drawn.power, 99.5)
    colours = axes.pcolormesh(
        drawn.x,
        drawn.y,
        drawn.power,
        cmap="viridis",
        vmax=top,
        shading="nearest",
        alpha=0.55,
        zorder=5,
        rasterized=True,
    )
    cutoff = RadioSettings().cutoff
    if drawn.power.min() < cutoff < drawn.power.max():
        axes.contour(drawn.x, drawn.y, drawn.power, [cutoff], colors="#d1622b", linestyles="solid", zorder=6)
    for place, way in enumerate(mission.ways):
        axes.plot(*np.array(way.poses)[:, :2].T, color=_colour(place), lw=1.0, zorder=8, **INSIDE)
    axes.plot(*source, "*", color="white", mec="black", ms=10, zorder=9)
    figure.colorbar(colours, ax=axes, shrink=0.7, label="received power [dBm]")
    axes.set_title(f"radio power from {station.name}")


def _travelled(way: RobotWay) -> np.ndarray:
    """Return the distance that a robot has covered at each of its times [m]."""
    steps = np.linalg.norm(np.diff(np.array(way.poses)[:, :2], axis=0), axis=-1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _draw_distance(axes: Axes, mission: RecordedMission) -> None:
    for place, way in enumerate(mission.ways):
        axes.plot(way.times, _travelled(way), color=_colour(place), lw=1.2)
    axes.set_title("distance travelled [m]")


def _draw_speed(axes: Axes, mission: RecordedMission) -> None:
    for place, way in enumerate(mission.ways):
        times, gone = np.array(way.times), _travelled(way)
        # Interpolation holds the first value before the start, which the shorter time below makes up for.
        before = np.interp(times - SMOOTHED, times, gone)
        passed = np.minimum(times - times[0], SMOOTHED)
        axes.plot(times, (gone - before) / np.maximum(passed, 1e-9), color=_colour(place), lw=1.0)
    axes.set_title("speed [m/s]")


def _draw_battery(axes: Axes, mission: RecordedMission) -> None:
    for place, way in enumerate(mission.ways):
        axes.plot(way.times, np.array(way.battery) / 60.0, color=_colour(place), lw=1.2)
    axes.set_title("battery left [min]")
    axes.set_ylim(bottom=0)


def _draw_score(axes: Axes, mission: RecordedMission) -> None:
    times, scores = zip(*mission.scores, strict=True)
    axes.step(times, scores, where="post", color="#333333", lw=1.2)
    axes.set_title("score")


def _draw_found(axes: Axes, mission: RecordedMission) -> None:
    first, last = (pick(time for way in mission.ways for time in way.times) for pick in (min, max))
    times = sorted(time for time, _ in mission.found.values())
    # The line begins at 0 and goes on to the end of the mission.
    axes.step([first, *times, last], [*range(len(times) + 1), len(times)], where="post", color=FOUND, lw=1.4)
    axes.set_ylim(0, max(1, len(mission.arena.victims)))
    axes.set_title(f"victims met (of {len(mission.arena.victims)})")
