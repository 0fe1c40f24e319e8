"""Motor responses of robot classes, measured on engine `c` for engine `planar`.

Many robots of a class drive by random commands on an open floor; the figures of `Response` are those with
which the twists that `planar` makes of the same commands come nearest, by least squares.
"""

import json
import logging
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.backend import Array
from usarmjx.base.errors import SpecError, UsageError
from usarmjx.base.files import atomic_write
from usarmjx.base.rotations import mat_from_quat
from usarmjx.base.settings.json_file import as_mapping, kept_text, read_json
from usarmjx.engines.planar.drives import SideWheels, limited_lag, wheel_kinematics
from usarmjx.engines.planar.responses import (
    NUMERIC_FIELDS,
    Response,
    UncalibratedRobotError,
    description_key,
    override_response,
    read_response,
    response_entry,
    response_file,
    rolls,
    uncalibrated,
)
from usarmjx.models.drives.ground import OmniDrive, SkidSteer
from usarmjx.models.types.arena import ArenaSpec, StartPose
from usarmjx.models.types.robot import RobotSpec
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import Scene, build_scene

log = logging.getLogger(__name__)

START = StartPose(tag="S", at=(0.0, 0.0, 0.188), yaw=0.0)
OPEN_FLOOR = ArenaSpec(name="open-floor", starts=(START,), extent=((-50.0, 50.0), (-50.0, 50.0)))
SETTLING_STEPS = 25
"""Control steps in which robots come to rest before their first command."""
COMMAND_STEPS = (25, 100)
"""Shortest and longest duration of a command [control steps]."""
STRAIGHT_SHARE, SPINNING_SHARE = 0.25, 0.15
"""Shares of commands that go straight on, and that turn on the spot."""
MAX_CAR_SPEED = 4.0
"""Highest commanded speed of cars [m/s]: beyond that they skid through any bend."""
MAX_TURN_RATE = 12.0
"""Highest commanded rate of turn of skid-steered robots without slip, unless they go straight on [rad/s].

A Kurt can be commanded 32 and only slides then."""
HORIZONS = (1.0, 5.0, 20.0)
"""Times after which the error of the pose is stated [s]."""
LOWER_BOUNDS = np.array([0.2, 0.05, 1e-3, 1e-3, 0.05, 0.05, 0.2, -0.3])
UPPER_BOUNDS = np.array([1.5, 1.5, 1.5, 1.5, 50.0, 200.0, 50.0, 0.3])
"""Bounds of the fit, in the order of `NUMERIC_FIELDS`."""
SPIN_TOLERANCE = 0.06
"""Most that the rate of turn on the spot may differ from that on `c`, over it, if a data sheet limits it.

The fit weighs bends and turns on the spot alike; users compare the second with the data sheet."""
SPIN_SECONDS = 6.0
"""Duration of a turn on the spot [s]; its second half counts."""
MAX_COST_RATIO = 0.8
"""Sides answer by themselves if that leaves no more than this share of the cost of the simpler model."""


@dataclass(frozen=True, eq=False)
class DriveLog:
    """Commands to robots of a class, and the motion that followed on engine `c`.

    Attributes:
        period: Length of a control step [s].
        wheel_speeds: Commanded speeds of their wheels [rad/s] (steps, robots, wheels).
        joints: Positions of their joints, before each step (steps, robots, joints).
        twist: Forward speed, sideways speed, rate of turn after each (steps, robots, 3).
        pose: Position on the plan [m] and heading [rad] after each (steps, robots, 3).
    """

    period: float
    wheel_speeds: np.ndarray
    joints: np.ndarray
    twist: np.ndarray
    pose: np.ndarray


def random_commands(robot: RobotSpec, robots: int, steps: int, seed: int) -> np.ndarray:
    """Return random commands for robots of a class, by the keys of its drive (steps, robots, keys)."""
    rng, drive = np.random.default_rng(seed), robot.drive
    limits, commands = drive.limits, np.zeros((steps, robots, len(drive.keys)), np.float32)
    for number in range(robots):
        step = 0
        while step < steps:
            end = step + int(rng.integers(*COMMAND_STEPS))
            commands[step:end, number] = _random_command(drive, limits, rng)
            step = end
    if isinstance(drive, SkidSteer):
        bends = commands[..., :1] != commands[..., 1:2]
        # Straight drives keep the full speed: only bends would make the wheels slide.
        commands = np.where(bends, commands * min(1.0, MAX_TURN_RATE / _max_turn_rate(robot)), commands)
    return commands.astype(np.float32)


def _max_turn_rate(robot: RobotSpec) -> float:
    """Return the top rate of turn on the spot of a robot with wheels on two sides, without slip [rad/s]."""
    wheels, drive = wheel_kinematics(robot), robot.drive
    assert isinstance(wheels, SideWheels)
    assert isinstance(drive, SkidSteer)
    return 2.0 * drive.max_spin * wheels.radius / wheels.track


def _random_command(drive: Any, limits: np.ndarray, rng: np.random.Generator) -> np.ndarray:  # noqa: ANN401
    kind, values = rng.random(), rng.uniform(-1.0, 1.0, len(limits)) * limits
    if drive.applies_wrench:  # what flies or dives: anything
        return values.astype(np.float32)
    if isinstance(drive, OmniDrive):
        # Wheels that agree: all at one speed and one angle, or those ahead turned the other way.
        speeds = np.array([key.startswith("WheelSpeed") for key in drive.keys])
        # Keys are WheelSpeed1, WheelSteer1, ...: without these letters the wheel's number is left.
        sides = np.array([np.sign(drive.wheels[int(key.lstrip("WhelSpdtr"))].x) for key in drive.keys])
        angle = rng.uniform(-1.0, 1.0) * drive.max_steer * (sides if kind < 0.5 else 1.0)
        return np.where(speeds, rng.uniform(-1.0, 1.0) * drive.max_spin, angle).astype(np.float32)
    if drive.keys == ("Left", "Right"):
        if kind < STRAIGHT_SHARE:
            values[1] = values[0]
        elif kind < STRAIGHT_SHARE + SPINNING_SHARE:
            values[1] = -values[0]
    else:
        values[0] *= min(1.0, MAX_CAR_SPEED / drive.top_speed)
        # Keys after the first steer.
        values[1:] *= kind >= STRAIGHT_SHARE
    return values.astype(np.float32)


def record_drive(robot: RobotSpec, commands: np.ndarray, engine: str = "c") -> DriveLog:
    """Return the motion that follows commands (steps, robots, keys) on an open floor."""
    scene = build_scene(OPEN_FLOOR, [robot])
    # Each robot has a world of its own: they must not touch.
    batch, group = Batch(scene, worlds=commands.shape[1], engine=engine), scene.groups[0]
    drive, names = robot.drive, group.plan.parts[1:]
    kinematics = wheel_kinematics(robot)
    state = batch.reset()
    for _ in range(SETTLING_STEPS):
        state = batch.step(state)
    joints: list[np.ndarray] = []
    twist: list[np.ndarray] = []
    pose: list[np.ndarray] = []
    for number in range(len(commands)):
        # A command stays in force: to give it again in each step would only take time.
        if not number or (commands[number] != commands[number - 1]).any():
            values = {key: commands[number, :, None, i] for i, key in enumerate(drive.keys)}
            state = batch.drive(state, 0, values)
        # Before the step, as the engine itself has them when it computes the wheels' twist.
        joints.append(np.asarray(batch.physics(state).qpos)[:, group.qposadr[0]])
        state = batch.step(state)
        physics = batch.physics(state)
        qpos = np.asarray(physics.qpos)[:, group.root_qposadr[0]]
        qvel = np.asarray(physics.qvel)[:, group.root_dofadr[0]]
        mat = np.asarray(mat_from_quat(qpos[:, 3:]))
        # MuJoCo has a free joint's linear velocity in the world's axes, its angular one in the body's.
        body_velocity = np.einsum("nji,nj->ni", mat, qvel[:, :3])
        twist.append(np.column_stack([body_velocity[:, :2], qvel[:, 5]]))
        pose.append(np.column_stack([qpos[:, :2], np.arctan2(mat[:, 1, 0], mat[:, 0, 0])]))
    targets = np.asarray(drive.targets(commands))
    lower = [name.lower() for name in names]
    row = {lower.index(one.joint.lower()): i for i, one in enumerate(drive.joint_controls)}
    # Passive wheels have no command: zeros keep their columns.
    speeds = [
        targets[..., row[j]] if j in row else np.zeros(targets.shape[:2]) for j in kinematics.spin.tolist()
    ]
    return DriveLog(
        period=scene.physics.period,
        wheel_speeds=np.stack(speeds, -1),
        joints=np.array(joints),
        twist=np.array(twist),
        pose=np.array(pose),
    )


def spin_gains(robot: RobotSpec) -> tuple[float, float] | None:
    """Return the turn gains at which a class turns on the spot about as on engine `c`.

    None: no data sheet limits its rate of turn.
    """
    drive = robot.drive
    if not (isinstance(drive, SkidSteer) and np.isfinite(drive.max_turn)):
        return None
    # 0.02 s is the control period of the default physics, which `record_drive` uses.
    steps = round(SPIN_SECONDS / 0.02)
    command = np.array([-drive.max_spin, drive.max_spin], np.float32)
    log = record_drive(robot, np.tile(command, (steps, 1, 1)))
    commanded = wheel_kinematics(robot).twist(jnp.asarray(log.joints[-1]), jnp.asarray(log.wheel_speeds[-1]))
    # By the second half, as at first it gets up to speed.
    gain = float(log.twist[steps // 2 :, 0, 2].mean() / commanded[0, 2])
    return gain * (1.0 - SPIN_TOLERANCE), gain * (1.0 + SPIN_TOLERANCE)


def fit_response(
    robot: RobotSpec, log: DriveLog, turn_gains: tuple[float, float] | None = None
) -> tuple[Response, np.ndarray]:
    """Return the figures with which a log is explained best, and what is left of its twists (3,), rms.

    Args:
        robot: The class.
        log: Its drives.
        turn_gains: Least and largest turn gain; None: any.
    """
    best, residual_rms, cost = _fit(robot, log, turn_gains, sides_apart=False)
    if isinstance(robot.drive, SkidSteer):
        # The richer model must be clearly better: noise alone always makes it a little better.
        other = _fit(robot, log, turn_gains, sides_apart=True)
        if other[2] < MAX_COST_RATIO * cost:
            best, residual_rms, _ = other
    return best, residual_rms


def _fit(
    robot: RobotSpec, log: DriveLog, turn_gains: tuple[float, float] | None, *, sides_apart: bool
) -> tuple[Response, np.ndarray, float]:
    """Return the best figures of a model, what is left of the twists (3,), rms, and the cost of that."""
    from scipy.optimize import least_squares  # half a second, of which a calibrated robot has no need

    wheels = wheel_kinematics(robot)
    wheel_speeds, joints = jnp.asarray(log.wheel_speeds, jnp.float32), jnp.asarray(log.joints, jnp.float32)
    commanded = jax.vmap(wheels.twist)(joints, wheel_speeds)
    measured = jnp.asarray(log.twist, jnp.float32)
    # Rates of turn count as what they are at the rim of the robot, sideways motion as little as it matters.
    reach = max(np.hypot(*robot.dimensions[:2]) / 2, 0.1)
    weight = jnp.array([1.0, 0.3, reach])

    def residuals(values: Array) -> Array:
        return ((_twists(values, commanded, log.period, sides_apart) - measured) * weight).reshape(-1)

    residual = jax.jit(residuals)
    jacobian = jax.jit(partial(_jacobian, residuals))
    # In the order of `NUMERIC_FIELDS`.
    first = np.array([1.0, 0.7, 0.05, 0.05, 3.0, 6.0, 8.0, 0.0])
    low, high = LOWER_BOUNDS.copy(), UPPER_BOUNDS.copy()
    if turn_gains is not None:
        turn = NUMERIC_FIELDS.index("turn_gain")
        low[turn], high[turn] = turn_gains
        first[turn] = sum(turn_gains) / 2

    def residuals_at(values: np.ndarray) -> np.ndarray:
        return np.asarray(residual(jnp.asarray(values, jnp.float32)), float)

    def jacobian_at(values: np.ndarray) -> np.ndarray:
        return np.asarray(jacobian(jnp.asarray(values, jnp.float32)), float)

    # A robust loss: a robot that hops or tips over for a moment must not decide on the figures.
    solution: Any = least_squares(
        residuals_at,
        first,
        jacobian_at,
        bounds=(low, high),
        loss="soft_l1",
        # Beyond 0.1 m/s weighted errors count less than by their squares.
        f_scale=0.1,
        # Steps in units of the first guess: time constants and gains differ by a factor of a hundred.
        x_scale=np.maximum(np.abs(first), 0.05),
        max_nfev=60,
    )
    twists = _twists(jnp.asarray(solution.x, jnp.float32), commanded, log.period, sides_apart)
    residual_rms = np.sqrt((np.asarray(twists - measured) ** 2).mean((0, 1)))
    # Five digits: more would change with every version of the optimiser and mean nothing.
    figures = {name: float(f"{x:.5g}") for name, x in zip(NUMERIC_FIELDS, solution.x.tolist(), strict=True)}
    return Response(**figures, sides_apart=sides_apart), residual_rms, float(solution.cost)


def _twists(values: Array, commanded: Array, period: float, sides_apart: bool) -> Array:
    """Return the twists (steps, robots, 3) that a response makes of the commanded ones."""
    figures = dict(zip(NUMERIC_FIELDS, values, strict=True))
    response = Response(**figures, sides_apart=sides_apart)  # type: ignore - numbers that are traced

    def step(twist: Array, command: Array) -> tuple[Array, Array]:
        twist = limited_lag(response, twist, command, period)
        return twist, twist

    # From rest, as the log begins after the robots have settled.
    lagged = jax.lax.scan(step, jnp.zeros_like(commanded[0]), commanded)[1]
    # As `rolling` does it on the engine: first the lag, then gains, then the drift of bends.
    ahead, turn = response.gain * lagged[..., 0], response.turn_gain * lagged[..., 2]
    aside = response.gain * lagged[..., 1] + response.drift * ahead * turn
    return jnp.stack([ahead, aside, turn], -1)


def _jacobian(function: Callable[[Array], Array], values: Array) -> Array:
    """Return the Jacobian of a function (results, numbers)."""

    # Forward mode: there are eight numbers and thousands of residuals.
    def directional_derivative(direction: Array) -> Array:
        return jax.jvp(function, (values,), (direction,))[1]

    return jax.vmap(directional_derivative, out_axes=-1)(jnp.eye(len(values)))


def calibrate(robot: RobotSpec, robots: int = 24, seconds: float = 12.0, seed: int = 0) -> dict[str, Any]:
    """Measure a class that rolls on engine `c`, and let it answer so in `planar` from now on.

    Args:
        robot: Its description.
        robots: Robots that drive at once.
        seconds: For how long [s].
        seed: Seed of their commands.

    Returns:
        Entry for the file of measurements: the key of the description, the response, and the rms of what
        is left unexplained of forward speed [m/s], sideways speed [m/s] and rate of turn [rad/s].

    Raises:
        UsageError: It does not roll: there is nothing to measure.
    """
    if not rolls(robot.drive):
        raise UsageError(f"{robot.name} does not roll on wheels or tracks: there is nothing to calibrate")
    commands = random_commands(robot, robots, round(seconds / 0.02), seed)
    response, residual_rms = fit_response(robot, record_drive(robot, commands), spin_gains(robot))
    override_response(robot, response)
    names = ("forward_speed", "sideways_speed", "rate_of_turn")
    return response_entry(
        robot, response, left={k: float(f"{x:.3g}") for k, x in zip(names, residual_rms, strict=True)}
    )


def pose_errors(robot: RobotSpec, robots: int = 16, seed: int = 1) -> dict[str, dict[str, float]]:
    """Return the distance of robots on `planar` from those on `c` under the same random commands.

    Medians over robots of the distance [m] and of the difference in heading [rad], by the time [s].
    """
    # Other commands than those of the fit, whose seed is 0: on those the errors would look too small.
    commands = random_commands(robot, robots, round(HORIZONS[-1] / 0.02), seed)
    measured, planar = record_drive(robot, commands, "c"), record_drive(robot, commands, "planar")
    errors: dict[str, dict[str, float]] = {}
    for horizon in HORIZONS:
        step = round(horizon / measured.period) - 1
        difference = planar.pose[step] - measured.pose[step]
        # Through sine and cosine: a heading just below half a turn is near one just above it.
        turn = np.arctan2(np.sin(difference[:, 2]), np.cos(difference[:, 2]))
        path_length = np.linalg.norm(np.diff(measured.pose[: step + 1, :, :2], axis=0), axis=-1).sum(0)
        errors[f"{horizon:g} s"] = {
            "distance": float(f"{np.median(np.linalg.norm(difference[:, :2], axis=-1)):.3g}"),
            "heading": float(f"{np.median(np.abs(turn)):.3g}"),
            "way": float(f"{np.median(path_length):.3g}"),
        }
    return errors


def ensure_calibrated(robots: Scene | Iterable[RobotSpec], folder: Path | None = None) -> None:
    """Measure the robots that engine `planar` has no figures of, and keep the figures for other runs.

    A robot takes about ten seconds. `make` and the commands call it; a `Batch` refuses such robots.

    Args:
        robots: The robots, or a scene with them.
        folder: Folder of the figures; None: the cache of this user, if it is on.
    """
    given = (robot for robot, _ in robots.robots) if isinstance(robots, Scene) else robots
    for robot in uncalibrated(given, folder):
        log.warning("engine planar: measuring how a %s answers its motors, on engine c ...", robot.name)
        entry, file = calibrate(robot), response_file(robot, folder)
        if file is not None:
            with atomic_write(file) as fresh:
                fresh.write_text(kept_text(entry), encoding="utf-8")


Built = TypeVar("Built")


def build_calibrated(build: Callable[[], Built]) -> Built:
    """Return the result of a builder, after measuring robots that engine `planar` refuses as uncalibrated.

    Args:
        build: Builds a batch or an environment; called again after measuring.
    """
    try:
        return build()
    # Built at once and not checked before: only the builder knows which robots its engine needs figures of.
    except UncalibratedRobotError as error:
        missing = error.robots
    ensure_calibrated(missing)
    return build()


def measure_all(
    robots: Iterable[RobotSpec], file: Path | None = None, *, everything: bool = False
) -> Iterator[str]:
    """Measure classes one after the other, with the errors of their poses; yield a line for each.

    Args:
        robots: The classes.
        file: JSON file to keep the figures in after each; classes in it that have not changed are left.
        everything: Leave out what does not roll, instead of refusing it.

    Raises:
        UsageError: A class does not roll.
    """
    known: dict[str, dict[str, Any]] = {}
    if file is not None and file.exists():
        known = _measured(file)
    for robot in robots:
        if everything and not rolls(robot.drive):
            continue
        entry = known.get(robot.name)
        if entry is None or entry.get("key") != description_key(robot):
            entry = calibrate(robot)
            entry["errors"] = pose_errors(robot)
        known[robot.name] = entry
        if file is not None:
            with atomic_write(file) as fresh:
                # Sorted: the order in which robots are measured makes no other file.
                fresh.write_text(json.dumps(dict(sorted(known.items())), indent=1) + "\n", encoding="utf-8")
        yield _summary(robot.name, entry)


def _measured(file: Path) -> dict[str, dict[str, Any]]:
    """Return the entries of a file of measurements, by class.

    Raises:
        SpecError: It is no such file; names the entry.
    """
    content = as_mapping(read_json(file, finite=True))
    if content is None:
        raise SpecError(f"{file}: is no file of measured robots: expected a mapping of their names")
    for name, entry in content.items():
        read_response(entry, f"{file}: {name}")
        if not isinstance(entry.get("errors"), dict):
            raise SpecError(f"{file}: {name}: has no errors of poses; remove the entry to measure them")
    return content


def _summary(name: str, entry: dict[str, Any]) -> str:
    parts = [
        f"after {horizon} {error['distance']:.2f} m, {error['heading']:.2f} rad off, of {error['way']:.1f} m"
        for horizon, error in entry["errors"].items()
    ]
    return f"{name}: {'; '.join(parts)}"
