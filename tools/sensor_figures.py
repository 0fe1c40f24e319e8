"""Draw the pictures of docs/sensors.md: what sensors see, and how wrong they are.

`python tools/sensor_figures.py --out docs` draws all of them, with names before it only these.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np
import typer
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Polygon, Wedge

from usarmjx.base.clock import Clock, clock_at
from usarmjx.base.registry import Registry
from usarmjx.base.transforms import angles_from_mat
from usarmjx.cli.common import ErrorExit, announce
from usarmjx.models.arenas import ARENAS
from usarmjx.models.compile.kinematic_tree import forward_kinematics
from usarmjx.models.drives.base import RobotState
from usarmjx.models.robots import ROBOTS
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.types.arena import ArenaSpec, StartPose
from usarmjx.models.types.robot import Mount, options
from usarmjx.models.types.shapes import Shape
from usarmjx.plots.picture import PAPER, draw_shapes
from usarmjx.plots.style import save_small
from usarmjx.sensors.base import Sensor, SensorInput
from usarmjx.sensors.cameras.paint import (
    ARENA_LABEL,
    DOOR_LABEL,
    FALSE_ALARM_LABEL,
    LOOSE_LABEL,
    OUTSIDE_LABEL,
    ROBOT_LABEL,
    SKY_LABEL,
    VICTIM_LABEL,
    WATER_LABEL,
)
from usarmjx.sensors.cameras.picture import Picture
from usarmjx.sensors.gps import MAX_SATELLITES, GpsSettings, largest_error
from usarmjx.sensors.motion import InsSettings
from usarmjx.sensors.ranging import RangeSettings, SonarSettings, range_readings
from usarmjx.sensors.rays.raycast import NO_HITS, Hits
from usarmjx.sensors.rfid import RfidSettings, signal_strength
from usarmjx.sensors.suite import suite_of
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import build_scene
from usarmjx.sim.world import sense_self

START_HEIGHT = 0.188
"""Height of start poses above the ground (manual 5.3.5) [m]."""
PATH_LENGTH, PATH_HALF_WIDTH, PATH_PERIODS = 30.0, 7.0, 3
"""The winding way that is driven for the INS: length and half width [m], and how many times it swings."""
DRIVE_SECONDS = 300.0
"""How long that takes [s]."""


@dataclass(frozen=True, eq=False)
class RangeStudy:
    """Readings of a robot's range sensors at one position, in world axes.

    Attributes:
        pose: x, y [m] and yaw [rad] of the robot (3,).
        origin: Start of the laser's beams [m] (2,).
        ends: Their ends [m] (beams, 2).
        hit: Whether they met something (beams,).
        sonars: x, y [m] and yaw [rad] of the sonars (sonars, 3).
        echoes: Ranges [m] (sonars,).
        beam_angle: Full angle of each sonar's cone [rad] (sonars,).
        no_echo: Whether they heard nothing (sonars,).
    """

    pose: np.ndarray
    origin: np.ndarray
    ends: np.ndarray
    hit: np.ndarray
    sonars: np.ndarray
    echoes: np.ndarray
    beam_angle: np.ndarray
    no_echo: np.ndarray


def range_study(
    arena: ArenaSpec, at: tuple[float, float], yaw: float, robot: str = "P2AT", seed: int = 0
) -> RangeStudy:
    """Return what laser scanner and sonars of a robot read, once, that stands at x, y [m].

    Raises:
        UnknownNameError: No such robot, or it has no scanner or no sonars.
    """
    kept = tuple(m for m in ROBOTS.get(robot).sensors if m.kind in ("RangeScanner", "Sonar"))
    spec = replace(ROBOTS.get(robot), name=f"{robot} with ranges", sensors=kept)
    start = StartPose(tag="Here", at=(*at, START_HEIGHT), yaw=yaw)
    batch = Batch(build_scene(replace(arena, starts=(start,)), [spec]), engine="c", seed=seed)
    state, ((*readings,),) = batch.observe(batch.reset())
    group = batch.scene.groups[0]
    world, physics = jax.tree.map(lambda x: x[0], (state.worlds, batch.physics(state)))
    bodies = jax.tree.map(lambda x: x[0], sense_self(batch.scene, world, physics, group).bodies)
    scanner, ring = (group.suite.index(kind) for kind in ("RangeScanner", "Sonar"))
    beams, echoes = (np.asarray(readings[index].value)[0, 0] for index in (scanner, ring))
    origin, along = (np.asarray(v)[:, :2] for v in group.suite.sensors[scanner].rays(bodies))
    pos, mat = map(np.asarray, group.suite.sensors[ring].mount_poses(bodies))
    limit = group.suite.sensors[scanner].settings[0].max_range
    sonars = group.suite.sensors[ring].settings
    return RangeStudy(
        pose=np.array([*np.asarray(bodies.pos)[0, :2], angles_from_mat(np.asarray(bodies.mat)[0])[2]]),
        origin=origin[0],
        ends=origin + along * beams[:, None],
        hit=beams < limit,
        sonars=np.column_stack([pos[:, :2], angles_from_mat(mat)[:, 2]]),
        echoes=echoes,
        beam_angle=np.array([settings.beam_angle for settings in sonars]),
        no_echo=echoes >= np.array([settings.max_range for settings in sonars], np.float32),
    )


def camera_study(
    arena: ArenaSpec,
    at: tuple[float, float],
    yaw: float,
    robot: str,
    width: int,
    height: int,
    *,
    camera: int = 0,
) -> Picture:
    """Return what a camera of a robot sees (height, width, ...) that stands at x, y [m].

    Raises:
        UnknownNameError: No such robot or camera.
    """
    spec = replace(ROBOTS.get(robot), name=f"{robot} without sensors", sensors=())
    start = StartPose(tag="Here", at=(*at, START_HEIGHT), yaw=yaw)
    batch = Batch(build_scene(replace(arena, starts=(start,)), [spec]), engine="c")
    return jax.tree.map(np.asarray, batch.render_robot(batch.reset(), 0, 0, camera, width, height))


def single_sensor(kind: str, **settings: object) -> Sensor:
    """Return a sensor on the origin of a P2AT that has no other."""
    mount = Mount(kind=kind, name=kind, options=options(**settings))
    return suite_of(replace(P2AT, name=f"P2AT with {kind}", sensors=(mount,))).sensors[0]


def sensor_input_at(
    sensor: Sensor, pos: jax.Array, yaw: jax.Array, clock: Clock, hits: Hits = NO_HITS
) -> SensorInput:
    """Return what a sensor draws on at a position (3,) and with a heading (), the robot's wheels at rest."""
    joints = jnp.zeros(len(sensor.plan.parts) - 1)
    zero, turn = jnp.zeros(3), jnp.stack([jnp.cos(yaw / 2), 0.0 * yaw, 0.0 * yaw, jnp.sin(yaw / 2)])
    state = RobotState(pos=pos, quat=turn, linear=zero, angular=zero, joint_pos=joints, joint_vel=joints)
    return SensorInput(clock=clock, state=state, bodies=forward_kinematics(sensor.plan, state), hits=hits)


def winding_path(step: float) -> tuple[np.ndarray, np.ndarray]:
    """Return times [s] (n,) and x, y [m], yaw [rad] (n, 3) of a drive along a winding way."""
    times = np.arange(0.0, DRIVE_SECONDS + step / 2, step)
    share, swing = times / DRIVE_SECONDS, 2 * np.pi * PATH_PERIODS
    yaw = np.arctan2(PATH_HALF_WIDTH * swing * np.cos(swing * share), PATH_LENGTH)
    return times, np.column_stack([PATH_LENGTH * share, PATH_HALF_WIDTH * np.sin(swing * share), yaw])


def ins_paths(runs: int, seed: int = 0, **settings: object) -> np.ndarray:
    """Return where INS sensors believe that they are on the winding way: x, y [m] (runs, n, 2).

    Args:
        runs: Number of robots that drive it, each with noise and drift of its own.
        seed: Of the noise.
        **settings: Of the sensors.
    """
    sensor = single_sensor("INS", **settings)
    interval = float(sensor.settings[0].scan_interval)
    times, poses = (jnp.asarray(v, jnp.float32) for v in winding_path(interval))

    def run(key: jax.Array) -> jax.Array:
        def at(i: jax.Array) -> SensorInput:
            clock = Clock(step=jnp.asarray(i), period=interval)
            return sensor_input_at(sensor, jnp.append(poses[i, :2], 0.0), poses[i, 2], clock)

        def step(memory: object, i: jax.Array) -> tuple[object, jax.Array]:
            memory, value = sensor.read(at(i), memory, jax.random.fold_in(key, i))
            return memory, jnp.asarray(value)[:2]

        # The first reading is the truth, and its noise nothing: the robot has not moved yet.
        return jax.lax.scan(step, sensor.init_memory(at(jnp.int32(0)), key), jnp.arange(len(times)))[1]

    keys = jax.vmap(partial(jax.random.fold_in, jax.random.key(seed)))(jnp.arange(runs))
    return np.asarray(jax.jit(jax.vmap(run))(keys))


def gps_errors(satellites: int, readings: int, seed: int = 0, **settings: object) -> np.ndarray:
    """Return by how much a GPS is wrong that sees so many satellites: x, y [m] (readings, 2)."""
    sensor = single_sensor("GPS", **settings)
    seen = jnp.where(jnp.arange(MAX_SATELLITES) < satellites, jnp.inf, 1.0)
    hits = Hits(distance=seen, cosine=jnp.zeros(MAX_SATELLITES))
    inputs = sensor_input_at(sensor, jnp.zeros(3), jnp.float32(0.0), clock_at(0.0, 0.02), hits)
    keys = jax.random.split(jax.random.key(seed), readings)
    return np.asarray(jax.jit(jax.vmap(lambda key: sensor.read(inputs, (), key)[1][:2]))(keys))


def reported_ranges(distance: np.ndarray, settings: RangeSettings, seed: int = 0) -> np.ndarray:
    """Return what a range sensor reports of true distances [m] (n,), each measured for itself."""
    keys = jax.random.split(jax.random.key(seed), len(distance))
    return np.asarray(
        jax.vmap(lambda d, key: range_readings(d[None, None], (settings,), key)[0, 0])(distance, keys)
    )


def rfid_range(settings: RfidSettings, *, blocked: bool) -> float:
    """Return up to where a tag is read in the mode Attenuation [m] (manual 10.9.3.3, solved for d)."""
    loss = settings.tx_power_dbm - settings.rx_sensitivity_dbm
    return 10 ** (((loss - settings.obstacle_attenuation_db * blocked) / 20 - 5.25) / 2)


DPI = 100
BLUE, ORANGE, GREEN, PINK, GREY = "#1f5fa8", "#d1622b", "#2c8a4f", "#b5179e", "#8a857a"
BEAM = "#e9a3dc"
ROBOT_POSITION, ROBOT_YAW = (0.6, -3.0), math.radians(10)
"""Where in the yellow arena the robot stands that looks around."""
SONAR_VIEW = ((-2.6, 6.1), (-5.0, -0.9))
"""The part of the plan that sonars are shown on: x and y [m]."""
EXAMPLE_OUTPUT_CURVE = ((0.0, 0.0), (1.0, 1.6), (3.0, 2.4), (5.0, 5.0))
"""The distortion that is shown, in metres."""

ECHO_STYLE: dict[str, Any] = {"fc": "#f2b694", "ec": ORANGE}
NO_ECHO_STYLE: dict[str, Any] = {"fc": "none", "ec": GREY, "ls": ":", "lw": 0.8}
"""Cones of sonars with and without an echo."""

FigureDrawing = Callable[[Figure], None]
PLOTS: Registry[tuple[FigureDrawing, tuple[float, float]]] = Registry("plot")
"""What there is to draw: a function that fills a figure, and its size [inches]."""


def plot(name: str, folder: Path) -> Path:
    """Draw a plot as `sensor-<name>.png` in a folder, which is made if need be; return the file.

    Raises:
        UnknownNameError: No such plot; lists those there are.
    """
    draw, size = PLOTS.get(name)
    figure = Figure(figsize=size, dpi=DPI, facecolor="white", layout="constrained")
    draw(figure)
    path = folder / f"sensor-{name}.png"
    save_small(figure, path)
    return path


def _plan(axes: Axes, title: str) -> None:
    arena = ARENAS.get("yellow")
    (x0, x1), (y0, y1) = arena.extent
    axes.set(
        aspect="equal",
        facecolor=PAPER,
        xlim=(x0 - 0.2, x1 + 0.2),
        ylim=(y0 - 0.2, y1 + 0.2),
        xlabel="x [m]",
        ylabel="y [m]",
    )
    axes.set_title(title, loc="left", fontsize=11)
    draw_shapes(axes, arena)
    axes.spines[:].set_visible(False)


def _robot(axes: Axes, pose: np.ndarray) -> None:
    """Draw a P2AT from above, its front as a corner."""
    length, width = P2AT.dimensions[0] / 2, P2AT.dimensions[1] / 2
    hull = np.array(
        [(-length, -width), (0.4 * length, -width), (length, 0), (0.4 * length, width), (-length, width)]
    )
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    axes.add_patch(
        Polygon(hull @ np.array([[cos, sin], [-sin, cos]]) + pose[:2], fc=BLUE, ec="white", zorder=6)
    )


def draw_laser(axes: Axes, seen: RangeStudy) -> None:
    """Draw the beams of a laser scan and where they ended."""
    for end in seen.ends[seen.hit]:
        axes.plot(*np.stack([seen.origin, end]).T, color=BEAM, lw=0.5, zorder=3)
    axes.plot(*seen.ends[seen.hit].T, ".", color=PINK, ms=4, zorder=5)
    _robot(axes, seen.pose)


def draw_sonars(axes: Axes, seen: RangeStudy) -> None:
    """Draw the cones of sonars up to their echoes, or faint to their range where there is none."""
    for (x, y, yaw), echo, wide, deaf in zip(
        seen.sonars, seen.echoes, seen.beam_angle, seen.no_echo, strict=True
    ):
        low, high = math.degrees(yaw - wide / 2), math.degrees(yaw + wide / 2)
        style = NO_ECHO_STYLE if deaf else ECHO_STYLE
        axes.add_patch(Wedge((x, y), echo, low, high, alpha=0.85, zorder=4, **style))
        if not deaf:
            at = (x + (echo + 0.12) * math.cos(yaw), y + (echo + 0.12) * math.sin(yaw))
            text = axes.annotate(f"{echo:.2f}", at, fontsize=8, ha="center", va="center", zorder=7)
            text.set_bbox({"fc": "white", "ec": "none", "pad": 0.6, "alpha": 0.8})
    _robot(axes, seen.pose)


def _laser(figure: Figure) -> None:
    seen = range_study(ARENAS.get("yellow"), ROBOT_POSITION, ROBOT_YAW)
    axes = figure.add_subplot()
    _plan(axes, f"One scan of a P2AT's RangeScanner in the yellow arena: {len(seen.ends)} beams")
    draw_laser(axes, seen)


def _sonar(figure: Figure) -> None:
    seen = range_study(ARENAS.get("yellow"), ROBOT_POSITION, ROBOT_YAW)
    axes = figure.add_subplot()
    _plan(
        axes, "The sonars of a P2AT, and what they read [m], Noise=0.05, MaxIncidence=1.309; dotted: no echo"
    )
    axes.set(xlim=SONAR_VIEW[0], ylim=SONAR_VIEW[1])
    draw_sonars(axes, seen)


def _rfid(figure: Figure) -> None:
    settings, axes = RfidSettings(), figure.add_subplot()
    distance = np.linspace(0.3, 5.0, 400)
    for blocked, colour, label in ((False, BLUE, "nothing between"), (True, ORANGE, "behind an obstacle")):
        power = signal_strength(settings, distance, np.array(blocked), np)
        reach = rfid_range(settings, blocked=blocked)
        axes.plot(distance, power, color=colour, lw=2, label=label)
        axes.plot(reach, settings.rx_sensitivity_dbm, "o", color=colour, ms=7, zorder=5)
        axes.plot([reach, reach], [-130, settings.rx_sensitivity_dbm], ":", color=colour, lw=1.2)
        axes.annotate(
            f"{reach:.2f} m",
            (reach, -101),
            (7 if not blocked else -7, 0),
            textcoords="offset points",
            ha="left" if not blocked else "right",
            color=colour,
            fontsize=11,
        )
    axes.axhline(settings.rx_sensitivity_dbm, color=GREY, lw=1, ls="--")
    axes.annotate(
        f"dBmRXSensibility = {settings.rx_sensitivity_dbm:g} dBm",
        (5.0, settings.rx_sensitivity_dbm),
        (0, 4),
        textcoords="offset points",
        ha="right",
        color=GREY,
    )
    axes.set(
        xlim=(0, 5.05), ylim=(-104, -46), xlabel="distance of the tag [m]", ylabel="received power [dBm]"
    )
    axes.set_title("RFID, SensingMode=Attenuation: how far a tag is read", loc="left", fontsize=11)
    _plain(axes)
    axes.legend(frameon=False)


def _plain(axes: Axes) -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="#e4e0d6", lw=0.6, zorder=0)
    axes.set_axisbelow(True)


INS_RUNS, INS_SHOWN = 64, 5
"""INS sensors that are driven along the winding way, and how many of them are shown."""
INS_CASES: tuple[tuple[str, dict[str, Any], str], ...] = (
    ("Sigma=0.1, the default", {"Sigma": 0.1}, ORANGE),
    ("Sigma=0, Drifting, Precision=1000", {"Sigma": 0.0, "Drifting": True}, GREEN),
    ("Sigma=0, PolarStep=True", {"Sigma": 0.0, "PolarStep": True}, GREY),
)


def _ins(figure: Figure) -> None:
    *paths_axes, right = figure.subplots(1, 3, width_ratios=(1.1, 1.1, 1))
    times, truth = winding_path(InsSettings().scan_interval)
    for i, (label, settings, colour) in enumerate(INS_CASES):
        paths = ins_paths(INS_RUNS, **settings)
        error = np.linalg.norm(paths - truth[:, :2], axis=-1)
        right.plot(times, np.median(error, 0), color=colour, lw=1.8, label=label)
        if i < len(paths_axes):
            _draw_paths(paths_axes[i], paths[:INS_SHOWN], truth, colour)
            paths_axes[i].set_title(label, loc="left", fontsize=10)
    right.set(xlabel="time [s]", ylabel=f"median error of {INS_RUNS} INS [m]", xlim=(0, DRIVE_SECONDS))
    right.set_ylim(0, 1.35 * right.get_ylim()[1])
    right.legend(frameon=False, fontsize=8, loc="upper left")
    _plain(right)


def _draw_paths(axes: Axes, paths: np.ndarray, truth: np.ndarray, colour: str) -> None:
    for path in paths:
        axes.plot(*path.T, color=colour, lw=0.9)
        axes.plot(*path[-1], "s", color=colour, ms=4, zorder=4)
    axes.plot(*truth[:, :2].T, color="black", lw=1.6, label="true path")
    axes.plot([], [], "-s", color=colour, lw=0.9, ms=4, label=f"{len(paths)} INS and where they end")
    axes.plot(*truth[0, :2], "o", color="white", mec="black", ms=7, zorder=5)
    axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    axes.set(xlim=(-2, PATH_LENGTH + 4), ylim=(-PATH_HALF_WIDTH - 4, PATH_HALF_WIDTH + 7))
    axes.legend(frameon=False, fontsize=8, ncols=2, loc="upper center")
    _plain(axes)


def _noise(figure: Figure) -> None:
    left, right = figure.subplots(1, 2, sharey=True)
    true = np.linspace(0.0, 6.0, 900, dtype=np.float32)
    plain, curved = SonarSettings(), RangeSettings(noise=0.02, output_curve=EXAMPLE_OUTPUT_CURVE)
    for axes, settings, title in (
        (left, plain, "Noise=0.05"),
        (right, curved, "Noise=0.02, then an OutputCurve"),
    ):
        exact = reported_ranges(true, RangeSettings(output_curve=settings.output_curve))
        axes.plot(true, reported_ranges(true, settings), ".", color=ORANGE, ms=2.5, label="readings")
        axes.plot(true, exact, color=BLUE, lw=1.4, label="without noise")
        axes.set(xlabel="true distance [m]", xlim=(0, 6), ylim=(0, 5.6))
        axes.set_title(title, loc="left", fontsize=10)
        _plain(axes)
    right.plot(*np.array(EXAMPLE_OUTPUT_CURVE).T, "s", color=BLUE, ms=5, label="points of the curve")
    left.set_ylabel("reading [m]")
    left.annotate(
        "no return: MaxRange exactly", (5.95, 5.0), (0, 7), textcoords="offset points", ha="right", fontsize=9
    )
    for axes in (left, right):
        axes.legend(frameon=False, loc="upper left", fontsize=9)


def _gps(figure: Figure) -> None:
    settings = GpsSettings()
    for axes, satellites in zip(figure.subplots(1, 3, sharey=True), (12, 8, 4), strict=True):
        errors, largest = gps_errors(satellites, 400), float(largest_error(settings, np.array(satellites)))
        axes.plot(*errors.T, ".", color=BLUE, ms=3)
        corners = largest * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
        axes.add_patch(Polygon(corners, fc="none", ec=ORANGE, ls="--", lw=1.2))
        axes.plot(0, 0, "+", color="black", ms=12)
        axes.set(aspect="equal", xlim=(-2.8, 2.8), ylim=(-2.8, 2.8), xlabel="error of x (north) [m]")
        axes.set_title(f"{satellites} satellites: at most {largest:g} m", loc="left", fontsize=10)
        _plain(axes)
    figure.axes[0].set_ylabel("error of y (west) [m]")


BEFORE_SITTING_VICTIM = ((9.9, 2.55), math.radians(4))
BEFORE_LYING_VICTIM = ((2.1, 2.85), math.radians(185))
"""Where in the yellow arena pictures are taken: before a victim that sits, and one that lies."""
LABELS: dict[int, tuple[str, str]] = {
    OUTSIDE_LABEL: ("outside", "#000000"),
    SKY_LABEL: ("sky", "#bcd9ee"),
    ARENA_LABEL: ("arena", "#cdbf9f"),
    LOOSE_LABEL: ("loose object", "#e07b39"),
    DOOR_LABEL: ("door", "#7a4a1e"),
    VICTIM_LABEL: ("victim", "#c4122f"),
    FALSE_ALARM_LABEL: ("false alarm", "#e58fa0"),
    WATER_LABEL: ("water", "#4080a5"),
    ROBOT_LABEL: ("the robot", "#1f5fa8"),
}
"""What pixels show, by label, and the colour of each here; further robots are as the first."""


def label_indices(segmentation: np.ndarray) -> np.ndarray:
    """Return labels as indices in `LABELS`; all robots count as one."""
    return np.searchsorted(list(LABELS), np.minimum(segmentation, ROBOT_LABEL))


def _image(axes: Axes, title: str) -> None:
    axes.set_title(title, loc="left", fontsize=10)
    axes.set_anchor("N")
    axes.set_axis_off()


def _camera(figure: Figure) -> None:
    seen = camera_study(ARENAS.get("yellow"), *BEFORE_SITTING_VICTIM, "P2AT", 320, 240)
    rgb, depth, labels = figure.subplots(1, 3)
    rgb.imshow(seen.rgb)
    _image(rgb, "RGB")
    drawn = depth.imshow(np.where(np.isfinite(seen.depth), seen.depth, np.nan), cmap="viridis_r")
    figure.colorbar(drawn, ax=depth, label="depth [m]", orientation="horizontal", shrink=0.8, pad=0.04)
    _image(depth, "depth")
    numbers = label_indices(np.asarray(seen.segmentation))
    palette = ListedColormap([colour for _, colour in LABELS.values()])
    bounds = BoundaryNorm(np.arange(len(LABELS) + 1) - 0.5, len(LABELS))
    labels.imshow(numbers, cmap=palette, norm=bounds, interpolation="nearest")
    _image(labels, "segmentation")
    names = [list(LABELS.values())[number] for number in np.unique(numbers)]
    keys = [Patch(color=colour, label=name) for name, colour in names]
    labels.legend(handles=keys, loc="upper center", bbox_to_anchor=(0.5, -0.04), ncols=4, frameon=False)


def _stereo(figure: Figure) -> None:
    for i, (side, axes) in enumerate(zip(("left", "right"), figure.subplots(1, 2), strict=True)):
        seen = camera_study(ARENAS.get("yellow"), *BEFORE_SITTING_VICTIM, "StereoP2AT", 320, 240, camera=i)
        axes.imshow(seen.rgb)
        _image(axes, f"{side}: {ROBOTS.get('StereoP2AT').cameras[i].name}")


def _omni(figure: Figure) -> None:
    seen = camera_study(ARENAS.get("yellow"), *BEFORE_LYING_VICTIM, "OmniP2AT", 420, 420)
    axes = figure.add_subplot()
    axes.imshow(seen.rgb)
    axes.set_axis_off()


def _textures(figure: Figure) -> None:
    seen = camera_study(texture_wall(), (0.0, 0.0), math.pi, "P2AT", 640, 300)
    axes = figure.add_subplot()
    axes.imshow(seen.rgb)
    axes.set_axis_off()


def texture_wall() -> ArenaSpec:
    """Return an arena with a wall behind the origin, in the sun, that shows all textures, four to a row."""
    names, shapes = (
        ("brick", "wood", "concrete", "tiles", "chart:1", "hazmat:3", "tag:7", "tag:0"),
        list[Shape](),
    )
    for place, name in enumerate(names):
        row, column = divmod(place, 4)
        colour = (0.75, 0.5, 0.35, 1.0) if place < 2 else (0.75, 0.75, 0.75, 1.0)
        at = (-3.0, 0.81 * (2 * column / 3 - 1), 0.86 - 0.54 * row)
        like = Shape(kind="box", size=(0.1, 0.25, 0.25), at=at, surface="wall", rgba=colour)
        shapes.append(replace(like, texture=name))
    return ArenaSpec(name="DM-Textures", shapes=tuple(shapes), starts=(), extent=((-4.0, 1.0), (-2.0, 2.0)))


PLOTS.add("laser", (_laser, (9.0, 6.2)))
PLOTS.add("sonar", (_sonar, (9.5, 5.1)))
PLOTS.add("rfid", (_rfid, (8.0, 4.4)))
PLOTS.add("ins", (_ins, (12.0, 4.0)))
PLOTS.add("noise", (_noise, (9.5, 4.2)))
PLOTS.add("gps", (_gps, (10.5, 3.9)))
PLOTS.add("camera", (_camera, (10.5, 4.1)))
PLOTS.add("stereo", (_stereo, (8.4, 3.4)))
PLOTS.add("omni", (_omni, (4.6, 4.6)))
PLOTS.add("textures", (_textures, (6.4, 3.0)))


def main(
    out: Annotated[Path, typer.Option(help="Folder for the pictures.")],
    only: Annotated[list[str] | None, typer.Argument(help="Which of them; all without any.")] = None,
) -> None:
    """Draw what sensors see and how wrong they are: the pictures of docs/sensors.md."""
    with ErrorExit():
        announce("drawing what sensors see ...")
        for name in only or PLOTS.names():
            typer.echo(f"wrote {plot(name, out)}")


app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
app.command()(main)

if __name__ == "__main__":
    app()
